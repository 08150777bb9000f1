"""The command `calcidem accuracy`: a study of the configuration's own scenes, as tables, figure and JSON."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import xarray as xr

from calcidem.analysis.figures.style import save
from calcidem.app.campaign.opened import open_campaign_of
from calcidem.app.campaign.packing import new_packing, provide_packing
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.accuracy.amplitudes import amplitude_rows
from calcidem.app.studies.accuracy.equilibrium import equilibrium_rows
from calcidem.app.studies.accuracy.findings import Findings, findings_json
from calcidem.app.studies.accuracy.reference import measure_convergence
from calcidem.app.studies.accuracy.report import accuracy_page, draw_error_against_run_time
from calcidem.app.studies.accuracy.scatter import SCATTER_SEEDS, quick_campaign, scatter_rows
from calcidem.app.studies.accuracy.settings import DEFAULT, Setting, settings
from calcidem.app.studies.accuracy.study import Study, run_study
from calcidem.dem.engine.scene import Regime
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import Experiment
from calcidem.storage.files import write_text_atomically

_CONVERGENCE_CASES: tuple[tuple[bool, Regime], ...] = ((True, "linear"), (False, "linear"), (False, "finite"))


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """What is to be measured.

    Attributes
    ----------
    experiment, contents, seeds
        The cells; contents in percent.
    campaign_hash
        Identity of the campaign's physics.
    campaign_seeds
        All seeds of the campaign.
    packing_of
        Makes the campaign's packing for an unbalanced-force ratio.
    stored
        Velocities of a stored campaign at each content, m/s; None measures some samples instead.
    lanes
        Width of the kernel.
    """

    experiment: Experiment
    contents: Sequence[float]
    seeds: Sequence[int]
    campaign_hash: str
    campaign_seeds: Sequence[int]
    packing_of: Callable[[float], Packing]
    stored: Mapping[float, Sequence[float]] | None = None
    lanes: int = 8


def plan_task(
    configuration: Configuration,
    contents: Sequence[float],
    seeds: int,
    database: str | os.PathLike[str] | None,
    progress: Callable[[str], None],
) -> Task:
    """Plan to measure some contents and the first seeds of a campaign.

    Parameters
    ----------
    configuration
        Of the campaign.
    contents
        Percent; all of the campaign if there are none.
    seeds
        How many.
    database
        Where the campaign is stored: its packing is taken, and its velocities for the scatter of its samples. None
        takes the packing from the cache, or makes it.
    progress
        Told what is done.

    Raises
    ------
    CampaignMismatchError
        If the database has a campaign of another configuration.
    """
    plan = configuration.campaign
    contents = contents or sorted(plan.contents)
    velocities = None
    if database is None:
        packing = provide_packing(configuration, None, progress)
    else:
        with open_campaign_of(configuration, database) as campaign:
            packing = campaign.experiment().packing
            velocities = _stored_velocities(campaign.vs(), contents)

    def packing_of(ratio: float) -> Packing:
        # A packing that is kept may have been made by another version: another sample, not the same at another ratio.
        rule = replace(configuration.packing, unbalanced_force_ratio=ratio)
        return new_packing(replace(configuration, packing=rule), progress)

    return Task(
        experiment=configuration.experiment(packing),
        contents=contents,
        seeds=plan.seed_numbers[:seeds],
        campaign_hash=configuration.hash,
        campaign_seeds=plan.seed_numbers,
        packing_of=packing_of,
        stored=velocities,
        lanes=configuration.run.lanes,
    )


def _stored_velocities(vs: xr.DataArray, contents: Sequence[float]) -> dict[float, list[float]]:
    """Velocities of a stored campaign at those of some contents that it has, m/s."""
    known = [value for value in contents if value in vs.content.to_numpy()]
    return {value: vs.sel(content=value).dropna("seed").to_numpy().tolist() for value in known}


def accuracy(
    task: Task,
    *,
    only: Sequence[str] = (),
    out: Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Findings:
    """Measure error against run time.

    Parameters
    ----------
    task
        What to measure.
    only
        Names of settings; with any, these and the default are compared with the reference and nothing else is measured.
    out
        Folder for the figure, ``accuracy.md`` and ``accuracy.json``.
    progress
        Told what is done.

    Raises
    ------
    ValueError
        If there is no setting of a name.
    """
    findings = _compare_some(task, only, progress) if only else _measure_everything(task, progress)
    if out is not None:
        save(draw_error_against_run_time(findings.study), out, "accuracy", ("png",))
        write_text_atomically(out / "accuracy.md", accuracy_page(findings))
        write_text_atomically(out / "accuracy.json", findings_json(findings))
    return findings


def _compare_some(task: Task, only: Sequence[str], progress: Callable[[str], None]) -> Findings:
    """Compare the default and some settings with the reference."""
    study = run_study(
        task.experiment,
        task.contents,
        task.seeds,
        compared=choose_settings(task.experiment, only),
        lanes=task.lanes,
        rounds=1,
        progress=progress,
    )
    return Findings(task.campaign_hash, task.experiment.packing.content_hash, study)


def choose_settings(experiment: Experiment, only: Sequence[str]) -> list[Setting]:
    """Give the default and the settings of these names; `ValueError` if there is none of a name."""
    known = {setting.name: setting for setting in settings(experiment)}
    for name in only:
        if name not in known:
            raise ValueError(f"only = {name}: choose among {', '.join(known)}")
    return [known[DEFAULT], *(known[name] for name in only if name != DEFAULT)]


def _measure_everything(task: Task, progress: Callable[[str], None]) -> Findings:
    """Measure everything."""
    experiment, contents, seeds, lanes = task.experiment, task.contents, task.seeds, task.lanes
    study = run_study(experiment, contents, seeds, lanes=lanes, progress=progress)
    orders = []
    for content, velocity in _slowest_velocities(study).items():
        # The linear regime refuses a loud pulse, so the configuration's own takes its place.
        own = experiment.wave.regime
        cases = ((damped, own if regime == "linear" else regime) for damped, regime in _CONVERGENCE_CASES)
        for damped, regime in dict.fromkeys(cases):
            progress(f"{content:g} %: order of convergence, {'damped' if damped else 'undamped'}, {regime}")
            orders.append(
                measure_convergence(experiment, content, seeds, velocity, damped=damped, regime=regime, lanes=lanes)
            )
    velocities = task.stored
    if velocities is None:
        progress("scatter of the samples")
        velocities = quick_campaign(experiment, contents, task.campaign_seeds[:SCATTER_SEEDS], lanes)
    return Findings(
        task.campaign_hash,
        experiment.packing.content_hash,
        study,
        tuple(orders),
        amplitude_rows(experiment, contents, seeds, lanes=lanes, progress=progress),
        equilibrium_rows(experiment, contents, seeds, task.packing_of, lanes=lanes, progress=progress),
        scatter_rows(study.cells, velocities, len(task.campaign_seeds)),
    )


def _slowest_velocities(study: Study) -> dict[float, float]:
    """Smallest velocity of the reference at each content that has one, m/s."""
    slowest: dict[float, float] = {}
    for cell in study.references:
        if cell.vs is not None:
            slowest[cell.content] = min(cell.vs, slowest.get(cell.content, cell.vs))
    return slowest


def parse_target(text: str) -> float:
    """Turn ``0.5%`` or ``0.005`` into 0.005."""
    number, scale = (text[:-1], 0.01) if text.rstrip().endswith("%") else (text, 1.0)
    try:
        value = float(number) * scale
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise ValueError(f"target = {text}: give a part of Vs such as 0.5% or 0.005")
    return value
