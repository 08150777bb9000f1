"""Runs a study: the reference, every setting against it, convergence, and the scatter of the samples beside it."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from calcidem.app.accuracy.comparison import CellError, cell_error
from calcidem.app.accuracy.settings import DEFAULT, REFERENCE_STEP, Setting, reference, settings, with_wave
from calcidem.dem.measurement import Experiment, Measurement, measure

HALVING = 1.0e-4  # relative change of Vs by which halving the reference's step may move it


@dataclass(frozen=True, slots=True)
class Summary:
    """Errors of one setting over some cells: absolute values, relative.

    Attributes
    ----------
    setting, numerical
        See `Setting`.
    cells
        Compared; 0 if the setting was refused.
    lost
        Cells that only the reference could read.
    median, worst
        Of Vs.
    arrival, signal
        Medians of the errors of the first arrival and of the whole signal.
    seconds
        Wall time of a cell.
    """

    setting: str
    numerical: bool
    cells: int
    lost: int
    median: float
    worst: float
    arrival: float
    signal: float
    seconds: float


@dataclass(frozen=True, slots=True)
class Study:
    """What was measured.

    Attributes
    ----------
    cells
        Every cell of every setting.
    summaries
        One for each setting, over all contents.
    reference_seconds
        Wall time of a cell of the reference.
    halving
        Largest relative change of Vs when the step of the reference is halved.
    """

    cells: tuple[CellError, ...]
    summaries: tuple[Summary, ...]
    reference_seconds: float
    halving: float


def run_study(
    experiment: Experiment,
    contents: Sequence[float],
    seeds: Sequence[int],
    *,
    chosen: Iterable[Setting] | None = None,
    reference_step: float = REFERENCE_STEP,
    lanes: int = 8,
    progress: Callable[[str], None] = lambda _: None,
) -> Study:
    """Measure the errors of settings.

    Parameters
    ----------
    experiment
        Whose own settings are the default.
    contents
        Percent.
    seeds
        Samples at each content.
    chosen
        Settings to compare; all of `settings.settings` by default.
    reference_step
        Step of the reference as a part of the stability limit.
    lanes
        Width of the kernel.
    progress
        Told what is done.
    """
    compared = tuple(settings(experiment) if chosen is None else chosen)
    exact_way = reference(experiment, reference_step)
    exact: dict[float, tuple[Measurement, ...]] = {}
    halving = 0.0
    for content in contents:
        progress(f"reference at {content:g} %")
        warm_up(exact_way, content, seeds, lanes)
        exact[content] = in_batches(exact_way, content, seeds, lanes)
        halving = max(halving, halved_step(exact_way, content, seeds, lanes))
    cells: list[CellError] = []
    for setting in compared:
        progress(setting.name)
        for content in contents:
            try:
                warm_up(setting.experiment, content, seeds, lanes)
                found = in_batches(setting.experiment, content, seeds, lanes)
            except ValueError as refused:
                progress(f"{setting.name} at {content:g} %: {refused}")
                continue
            amplitudes = setting.experiment.wave.amplitude, exact_way.wave.amplitude
            cells += [
                cell_error(setting.name, cell, amplitudes[0], other, amplitudes[1])
                for cell, other in zip(found, exact[content], strict=True)
            ]
    return Study(
        cells=tuple(cells),
        summaries=summarised(cells, compared),
        reference_seconds=float(np.mean([cell.seconds for row in exact.values() for cell in row])),
        halving=halving,
    )


def in_batches(experiment: Experiment, content: float, seeds: Sequence[int], lanes: int) -> tuple[Measurement, ...]:
    """Measure any number of seeds."""
    found: list[Measurement] = []
    for start in range(0, len(seeds), lanes):
        found += measure(experiment, content, seeds[start : start + lanes], lanes=lanes)
    return tuple(found)


def warm_up(experiment: Experiment, content: float, seeds: Sequence[int], lanes: int) -> None:
    """Compile the kernel this way of computing needs, so that no run time contains it."""

    class CompiledError(Exception):
        """Ends the run once the kernel has run."""

    calls = 0

    def stop() -> None:
        nonlocal calls
        calls += 1
        if calls > 1:
            raise CompiledError

    try:
        measure(experiment, content, seeds[:1], lanes=lanes, check=stop)
    except CompiledError:
        return


def halved_step(exact_way: Experiment, content: float, seeds: Sequence[int], lanes: int) -> float:
    """Largest relative change of Vs when the step of the reference is halved.

    Measured in the linear regime, which has the same step and costs a fraction: what the step does to a wave is the
    same in both.
    """
    linear = with_wave(exact_way, regime="linear")
    finer = with_wave(linear, step_fraction=0.5 * linear.wave.step_fraction)
    pairs = zip(in_batches(linear, content, seeds, lanes), in_batches(finer, content, seeds, lanes), strict=True)
    changes = [abs(a.vs / b.vs - 1.0) for a, b in pairs if a.vs is not None and b.vs is not None]
    return max(changes, default=0.0)


def summarised(cells: Iterable[CellError], compared: Iterable[Setting]) -> tuple[Summary, ...]:
    """Summaries of the settings, in their order."""
    rows = defaultdict(list)
    for cell in cells:
        rows[cell.setting].append(cell)
    return tuple(summary(setting.name, setting.numerical, rows[setting.name]) for setting in compared)


def summary(name: str, numerical: bool, cells: Sequence[CellError]) -> Summary:
    """Summary of the cells of one setting."""
    errors = [abs(cell.vs_error) for cell in cells if cell.vs_error is not None]
    arrivals = [abs(cell.arrival_error) for cell in cells if cell.arrival_error is not None]
    return Summary(
        setting=name,
        numerical=numerical,
        cells=len(errors),
        lost=sum(cell.vs is None and cell.reference_vs is not None for cell in cells),
        median=float(np.median(errors)) if errors else np.inf,
        worst=max(errors, default=np.inf),
        arrival=float(np.median(arrivals)) if arrivals else np.inf,
        signal=float(np.median([cell.signal_error for cell in cells])) if cells else np.inf,
        seconds=float(np.mean([cell.seconds for cell in cells])) if cells else np.inf,
    )


def cheapest(study: Study, target: float) -> Summary | None:
    """Cheapest numerical setting whose worst error of Vs meets a target (relative), None if there is none."""
    meeting = [row for row in study.summaries if row.numerical and row.cells and not row.lost and row.worst <= target]
    return min(meeting, key=lambda row: row.seconds, default=None)


def pareto(summaries: Iterable[Summary]) -> tuple[Summary, ...]:
    """Settings that no other beats in both median error and run time, fastest first."""
    front: list[Summary] = []
    for row in sorted((s for s in summaries if s.numerical and s.cells), key=lambda s: (s.seconds, s.median)):
        if not front or row.median < front[-1].median:
            front.append(row)
    return tuple(front)


def default_of(study: Study) -> Summary:
    """Summary of the experiment's own setting."""
    return next(row for row in study.summaries if row.setting == DEFAULT)
