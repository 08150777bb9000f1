"""Reference of every cell, and the error of every setting against it."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from calcidem.app.studies.accuracy.settings import DEFAULT, REFERENCE_SAMPLES, Setting, settings
from calcidem.app.studies.study import ROUNDS, Cells, CellsFound, relative_deviation, signal_distance
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement
from calcidem.dem.wave.rule import WHOLE_DOMAIN
from calcidem.storage.records.error_budget import NORMAL_95

HALVING = 1.0e-4  # largest relative change of Vs by halving the step
FINEST = 0.05  # smallest step of a reference over the limit


@dataclass(frozen=True, slots=True)
class ReferenceCell:
    """Reference of one cell."""

    seed: int
    content: float
    """The cell; content in percent."""
    vs: float | None
    """m/s; None if the reference has no reliable pick either."""
    step_fraction: float
    """Step over the stability limit."""
    halving: float | None
    """Relative change of Vs by halving twice this step; None without a velocity."""


@dataclass(frozen=True, slots=True)
class CellError:
    """Deviation of one cell with one setting from the reference."""

    setting: str
    """`Setting.name`."""
    seed: int
    content: float
    """The cell; content in percent."""
    vs: float | None
    reference_vs: float | None
    """m/s; None without a reliable pick."""
    vs_error: float | None
    effective_error: float | None
    """Relative errors of Vs and of the effective velocity, signed; None unless both have one."""
    arrival_error: float | None
    """Relative error of the travel time of the first arrival, signed; None unless both have one."""
    signal_error: float
    """See `signal_distance`."""
    stated: float | None
    """Relative standard error of both by the numerics, as the check of the content measured it; None without it."""

    @classmethod
    def compare(cls, setting: str, found: Measurement, exact: Measurement) -> Self:
        """Compare a cell with the reference of the same cell."""
        readings = (exact.reading, found.reading)
        exact_arrival, arrival = (None if one is None else one.first_arrival for one in readings)
        return cls(
            setting=setting,
            seed=found.seed,
            content=found.content,
            vs=found.vs,
            reference_vs=exact.vs,
            vs_error=relative_deviation(found.vs, exact.vs),
            effective_error=relative_deviation(found.effective_vs, exact.effective_vs),
            arrival_error=relative_deviation(exact_arrival, arrival),
            signal_error=signal_distance(found.section, exact.section),
            stated=found.check.numerical_error,
        )


@dataclass(frozen=True, slots=True)
class Summary:
    """Absolute relative errors of one setting over its cells."""

    setting: str
    numerical: bool
    """See `Setting`."""
    cells: int
    """Compared cells; 0 if the setting was refused."""
    lost: int
    """Cells with a velocity only in the reference."""
    median: float
    worst: float
    effective_median: float
    effective_worst: float
    """Errors of Vs, and of the effective velocity."""
    arrival: float
    signal: float
    """Medians of the errors of the first arrival and of the whole signal."""
    seconds: float
    """Processor time of a cell."""
    change: float
    """Largest relative change of Vs against the experiment's own setting."""
    adds: str = ""
    why: str = ""
    """See `Setting`."""


@dataclass(frozen=True, slots=True)
class Study:
    """Results of a study."""

    cells: tuple[CellError, ...]
    """Every cell of every setting."""
    summaries: tuple[Summary, ...]
    """One for each setting, over all contents; the experiment's own first."""
    references: tuple[ReferenceCell, ...]
    """One for each cell."""
    reference_seconds: float
    """Processor time of a cell of the reference."""
    seconds: Mapping[str, Mapping[float, float]]
    """Processor time of a cell by setting and content."""

    def cheapest(self, target: float) -> Summary | None:
        """Cheapest numerical setting whose worst relative error of Vs meets a target; None if there is none."""
        meeting = [
            row for row in self.summaries if row.numerical and row.cells and not row.lost and row.worst <= target
        ]
        return min(meeting, key=lambda row: row.seconds, default=None)

    def cheapest_in_words(self, target: float) -> str:
        """Name and cost of the `cheapest`."""
        row = self.cheapest(target)
        return "none of those measured" if row is None else f"{row.setting}, {row.seconds:.2f} s a cell"

    @property
    def pareto(self) -> tuple[Summary, ...]:
        """Settings that no other beats in both median error and run time (Pareto front), fastest first."""
        front: list[Summary] = []
        for row in sorted((s for s in self.summaries if s.numerical and s.cells), key=lambda s: (s.seconds, s.median)):
            if not front or row.median < front[-1].median:
                front.append(row)
        return tuple(front)


def run_study(
    cells: Cells,
    *,
    compared: Iterable[Setting] | None = None,
    coarsest: float = 0.4,
    rounds: int = ROUNDS,
    tell: Callable[[Study], object] = lambda _: None,
) -> Study:
    """Measure the errors of settings.

    The experiment's own setting comes first in ``compared``, by default all of `settings.settings`. The search for the
    reference starts at a step of ``coarsest`` times the limit. Settings are timed alternately in ``rounds``. ``tell``
    receives the results after each content. A refused content has none; `ValueError` if all are refused.
    """
    compared = tuple(settings(cells.experiment, cells.contents) if compared is None else compared)
    errors: list[CellError] = []
    references: list[ReferenceCell] = []
    reference_seconds: list[float] = []
    seconds: dict[str, dict[float, float]] = defaultdict(dict)

    def study() -> Study:
        own = {(cell.seed, cell.content): cell.vs for cell in errors if cell.setting == DEFAULT}
        summaries = (
            _summary_of(one, [cell for cell in errors if cell.setting == one.name], own, seconds.get(one.name, {}))
            for one in compared
        )
        mean = float(np.mean(reference_seconds))
        return Study(tuple(errors), tuple(summaries), tuple(references), mean, dict(seconds))

    for content in cells.contents:
        cells.progress(f"{content:g} %: reference")
        try:
            exact, exact_cells, taken = find_reference(cells, content, coarsest)
            found, times = cells.take_turns({one.name: one.experiment for one in compared}, content, rounds)
        except ValueError as refused:
            cells.progress(f"{content:g} %: {refused}")
            if content == cells.contents[-1] and not references:
                raise
            continue
        references += exact_cells
        reference_seconds.append(taken)
        errors += [CellError.compare(name, own[key], exact[key]) for name, own in found.items() for key in exact]
        for name, value in times.items():
            seconds[name][content] = value
        tell(study())
    return study()


def _summary_of(
    setting: Setting,
    cells: Sequence[CellError],
    own: Mapping[tuple[int, float], float | None],
    seconds: Mapping[float, float],
) -> Summary:
    """Summary of the cells of one setting; ``own`` are the default's velocities, ``seconds`` times at each content."""
    errors = [abs(cell.vs_error) for cell in cells if cell.vs_error is not None]
    effective = [abs(cell.effective_error) for cell in cells if cell.effective_error is not None]
    arrivals = [abs(cell.arrival_error) for cell in cells if cell.arrival_error is not None]
    changes = [relative_deviation(cell.vs, own.get((cell.seed, cell.content))) for cell in cells]

    def middle(values: Sequence[float]) -> float:
        return float(np.median(values)) if values else np.inf

    return Summary(
        setting=setting.name,
        numerical=setting.numerical,
        cells=len(errors),
        lost=sum(cell.vs is None and cell.reference_vs is not None for cell in cells),
        median=middle(errors),
        worst=max(errors, default=np.inf),
        effective_median=middle(effective),
        effective_worst=max(effective, default=np.inf),
        arrival=middle(arrivals),
        signal=middle([cell.signal_error for cell in cells if np.isfinite(cell.signal_error)]),
        seconds=float(np.mean(list(seconds.values()))) if seconds else np.inf,
        change=max((abs(change) for change in changes if change is not None), default=np.inf),
        adds=setting.adds,
        why=setting.why,
    )


def covered_share(errors: Iterable[float | None], stated: Iterable[float | None]) -> float:
    """Share of errors within the 95 % interval of their stated standard error, of those with both; NaN of none."""
    known = [
        abs(error) <= NORMAL_95 * own
        for error, own in zip(errors, stated, strict=True)
        if error is not None and own is not None
    ]
    return float(np.mean(known)) if known else np.nan


def find_reference(
    cells: Cells, content: float, coarsest: float = 0.4
) -> tuple[CellsFound, tuple[ReferenceCell, ...], float]:
    """Measure a content accurately: the step of each cell is halved until its Vs changes by less than `HALVING`.

    A cell that still changes at `FINEST` keeps this step and records its change. Returns the measurements, their
    reference cells, and the mean processor time of a cell, s.
    """
    step, waiting = coarsest, list(cells.seeds)
    before = cells.measure(_reference_experiment(cells.experiment, step), [content])
    done: dict[int, tuple[Measurement, ReferenceCell, float]] = {}
    while waiting:
        step /= 2.0
        now, seconds = cells.measure_and_time(_reference_experiment(cells.experiment, step), content, waiting)
        for seed in waiting:
            cell = now[seed, content]
            change = relative_deviation(cell.vs, before[seed, content].vs)
            if change is None or abs(change) < HALVING or step <= FINEST:
                done[seed] = cell, ReferenceCell(seed, content, cell.vs, step, change), seconds
        waiting = [seed for seed in waiting if seed not in done]
        before = now
    found = {(seed, content): done[seed][0] for seed in cells.seeds}
    return found, tuple(done[seed][1] for seed in cells.seeds), float(np.mean([one[2] for one in done.values()]))


def _reference_experiment(experiment: Experiment, step_fraction: float) -> Experiment:
    """Return the experiment at the highest accuracy: float64, finite displacement, all disks, dense samples."""
    return replace(experiment, is_checked=False).with_wave(
        precision="float64",
        law="finite",
        keep=(WHOLE_DOMAIN,),
        step_fraction=step_fraction,
        samples_per_period=max(REFERENCE_SAMPLES, experiment.wave.samples_per_period),
    )
