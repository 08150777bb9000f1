"""Command `calcidem accuracy`: a study of the configuration's scenes, as tables, figure and JSON."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from calcidem.analysis.figures.style import save
from calcidem.app.campaign.opened import open_campaign_of
from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.accuracy.questions import Findings, answer_questions
from calcidem.app.studies.accuracy.report import accuracy_page, draw_error_against_run_time
from calcidem.app.studies.accuracy.settings import DEFAULT, Setting, settings
from calcidem.app.studies.accuracy.study import run_study
from calcidem.dem.wave.experiment import Experiment
from calcidem.storage.files import write_text_atomically


@dataclass(frozen=True, slots=True, eq=False)
class AccuracyTask:
    """Cells to measure with every setting."""

    configuration: Configuration
    """Configuration of the campaign."""
    experiment: Experiment
    contents: Sequence[float]
    seeds: Sequence[int]
    """Cells; contents in percent."""
    stored: Mapping[float, Sequence[float]] | None = None
    """Velocities of a stored campaign at each content, m/s; None measures a few samples instead."""

    @classmethod
    def plan(
        cls,
        configuration: Configuration,
        contents: Sequence[float],
        seeds: int,
        database: str | os.PathLike[str] | None,
        progress: Callable[[str], None],
    ) -> Self:
        """Plan to measure the given contents, by default all of the campaign, with its first seeds.

        A database supplies the campaign's packing, and its velocities for the scatter of samples.
        `CampaignMismatchError` if its campaign has another configuration.
        """
        contents = contents or sorted(configuration.campaign.contents)
        velocities = None
        if database is None:
            packing = provide_packing(configuration, None, progress)
        else:
            with open_campaign_of(configuration, database) as campaign:
                packing, vs = campaign.experiment().packing, campaign.vs()
            known = [value for value in contents if value in vs.content.to_numpy()]
            velocities = {value: vs.sel(content=value).dropna("seed").to_numpy().tolist() for value in known}
        chosen = configuration.campaign.seed_numbers[:seeds]
        return cls(configuration, configuration.experiment(packing), contents, chosen, velocities)

    def choose_settings(self, only: Sequence[str]) -> list[Setting]:
        """Return the default and the settings of these names; `ValueError` for an unknown name."""
        known = {setting.name: setting for setting in settings(self.experiment)}
        for name in only:
            if name not in known:
                raise ValueError(f"only = {name}: choose among {', '.join(known)}")
        return [known[DEFAULT], *(known[name] for name in only if name != DEFAULT)]

    def measure(
        self,
        *,
        only: Sequence[str] = (),
        out: Path | None = None,
        progress: Callable[[str], None] = lambda _: None,
    ) -> Findings:
        """Measure error over run time.

        With names of settings in ``only``, only these and the default are compared with the reference; `ValueError` for
        an unknown name. The folder ``out`` receives the figure, ``accuracy.md`` and ``accuracy.json``.
        """
        compared, rounds = (self.choose_settings(only), {"rounds": 1}) if only else (None, {})
        lanes = self.configuration.run.lanes
        study = run_study(
            self.experiment, self.contents, self.seeds, compared=compared, lanes=lanes, progress=progress, **rounds
        )
        findings = Findings(self.configuration.hash, self.experiment.packing.content_hash, study)
        if not only:
            cells = self.contents, self.seeds
            findings = answer_questions(findings, self.configuration, self.experiment, *cells, self.stored, progress)
        if out is not None:
            save(draw_error_against_run_time(findings.study), out, "accuracy", ("png",))
            write_text_atomically(out / "accuracy.md", accuracy_page(findings))
            write_text_atomically(out / "accuracy.json", findings.as_json())
        return findings


def parse_target(text: str) -> float:
    """Parse ``0.5%`` or ``0.005`` as 0.005."""
    digits, scale = (text[:-1], 0.01) if text.rstrip().endswith("%") else (text, 1.0)
    try:
        value = float(digits) * scale
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise ValueError(f"target = {text}: give a part of Vs such as 0.5% or 0.005")
    return value
