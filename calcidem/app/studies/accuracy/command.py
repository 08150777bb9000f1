"""Command `calcidem accuracy`: a study of the configuration's scenes, as tables, figure and JSON."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from calcidem.analysis.figures.style import save
from calcidem.app.campaign.opened import open_campaign_of
from calcidem.app.campaign.packing import new_packing, provide_packing
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.accuracy.questions import (
    SCATTER_SEEDS,
    Findings,
    amplitude_rows,
    equilibrium_rows,
    scatter_rows,
)
from calcidem.app.studies.accuracy.reference import Convergence, measure_cells
from calcidem.app.studies.accuracy.report import accuracy_page, draw_error_against_run_time
from calcidem.app.studies.accuracy.settings import DEFAULT, Setting, settings
from calcidem.app.studies.accuracy.study import Study, run_study
from calcidem.dem.engine.scene import Regime
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import Experiment
from calcidem.storage.files import write_text_atomically

_CONVERGENCE_CASES: tuple[tuple[bool, Regime], ...] = ((True, "linear"), (False, "linear"), (False, "finite"))


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
            findings = _answer_questions(self, findings, progress)
        if out is not None:
            save(draw_error_against_run_time(findings.study), out, "accuracy", ("png",))
            write_text_atomically(out / "accuracy.md", accuracy_page(findings))
            write_text_atomically(out / "accuracy.json", findings.as_json())
        return findings


def _answer_questions(task: AccuracyTask, findings: Findings, progress: Callable[[str], None]) -> Findings:
    """Add the results that have their own reference."""
    configuration, experiment, contents, seeds = task.configuration, task.experiment, task.contents, task.seeds
    lanes, all_seeds = configuration.run.lanes, configuration.campaign.seed_numbers

    def packing_of(ratio: float) -> Packing:
        # A stored packing may come from another version and then be another sample, not the same at another ratio.
        rule = replace(configuration.packing, unbalanced_force_ratio=ratio)
        return new_packing(replace(configuration, packing=rule), progress)

    orders = _orders(task, findings.study, progress)
    velocities = task.stored
    if velocities is None:
        progress("scatter of the samples")
        velocities = {}
        for content in contents:
            cells = measure_cells(experiment, content, all_seeds[:SCATTER_SEEDS], lanes).values()
            velocities[content] = [cell.vs for cell in cells if cell.vs is not None]
    return replace(
        findings,
        convergence=orders,
        amplitudes=amplitude_rows(experiment, contents, seeds, lanes=lanes, progress=progress),
        equilibrium=equilibrium_rows(experiment, contents, seeds, packing_of, lanes=lanes, progress=progress),
        scatter=scatter_rows(findings.study.cells, velocities, len(all_seeds)),
    )


def _orders(task: AccuracyTask, study: Study, progress: Callable[[str], None]) -> tuple[Convergence, ...]:
    """Order of convergence at each content with a velocity of the reference."""
    orders, own = [], task.experiment.wave.regime
    for content in dict.fromkeys(cell.content for cell in study.references if cell.vs is not None):
        slowest = min(cell.vs for cell in study.references if cell.content == content and cell.vs is not None)
        # The linear regime refuses a strong pulse, so the configuration's regime replaces it.
        cases = ((damped, own if regime == "linear" else regime) for damped, regime in _CONVERGENCE_CASES)
        for damped, regime in dict.fromkeys(cases):
            progress(f"{content:g} %: order of convergence, {'damped' if damped else 'undamped'}, {regime}")
            lanes = task.configuration.run.lanes
            orders.append(
                Convergence.measure(
                    task.experiment, content, task.seeds, slowest, damped=damped, regime=regime, lanes=lanes
                )
            )
    return tuple(orders)


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
