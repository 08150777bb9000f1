"""Converged reference of each cell, error of other settings, and order of convergence."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from calcidem.app.studies.accuracy.settings import REFERENCE_SAMPLES, with_wave
from calcidem.app.studies.cells import Cells, CellsFound, at_common_times, relative_deviation, signal_distance
from calcidem.dem.engine.scene import Regime
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement
from calcidem.dem.wave.reading import smooth
from calcidem.dem.wave.rule import WHOLE_DOMAIN
from calcidem.dem.wave.section import Section

HALVING = 1.0e-4  # largest relative change of Vs by halving the step
COARSEST = 0.4  # first step over the limit
_FINEST = 0.05  # smallest step over the limit
CONVERGENCE_STEPS = (0.8, 0.4, 0.2, 0.1)  # steps over the limit; each is half of the previous one


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
    """Relative, signed; None unless both have a velocity."""
    arrival_error: float | None
    """Relative error of the travel time of the first arrival, signed; None unless both have one."""
    signal_error: float
    """See `signal_distance`."""
    expected: float | None
    bound: float | None
    """Relative error estimated by the cell itself, and its bound."""

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
            arrival_error=relative_deviation(exact_arrival, arrival),
            signal_error=signal_distance(found.section, exact.section),
            expected=found.expected_error,
            bound=found.error_bound,
        )


@dataclass(frozen=True, slots=True)
class Convergence:
    """Convergence of the signal at a content, medians over its cells."""

    content: float
    """Percent."""
    damped: bool
    """True with the experiment's local damping, False without damping."""
    regime: Regime
    """``linear``, or a regime with contact histories."""
    changes: tuple[float, ...]
    """Change of the signal by each halving of the step: normalised L2, at the sampling times of the largest step."""
    orders: tuple[float, ...]
    """Logarithm to base 2 of each change over the next: the order, without an exact solution."""

    @classmethod
    def measure(cls, cells: Cells, content: float, velocity: float, *, damped: bool, regime: Regime = "linear") -> Self:
        """Measure it at one content, with records until a wave with two thirds of ``velocity`` (m/s) has arrived.

        Local damping opposes the velocity half a step before, whose sign changes within a step: an error of first
        order. The shear-force increment of a sticking contact with changing stiffness, as in the small and finite
        regimes, has the same order. All other errors are of second order, as the linear regime without damping shows.
        """
        even = with_wave(
            cells.experiment,
            regime=regime,
            precision="float64",
            samples_per_period=REFERENCE_SAMPLES,
            slowest=velocity / 1.5,
            **({} if damped else {"damping": 0.0, "boundary_damping": 0.0}),
        )
        even = replace(even, early_stop=False, installation="preserve")
        runs = [cells.measure(with_wave(even, step_fraction=step), [content]) for step in CONVERGENCE_STEPS]
        sections = [[run[seed, content].section for run in runs] for seed in cells.seeds]
        changes = np.median([_signal_changes(cell, even.pick.smoothing) for cell in sections], axis=0)
        orders = np.log2(changes[:-1] / changes[1:])
        return cls(content, damped, regime, tuple(changes.tolist()), tuple(orders.tolist()))


def find_reference(
    cells: Cells, content: float, coarsest: float = COARSEST
) -> tuple[CellsFound, tuple[ReferenceCell, ...], float]:
    """Measure a content accurately: the step of each cell is halved until its Vs changes by less than `HALVING`.

    A cell that still changes at `_FINEST` keeps this step and records its change. Returns the measurements, their
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
            if change is None or abs(change) < HALVING or step <= _FINEST:
                done[seed] = cell, ReferenceCell(seed, content, cell.vs, step, change), seconds
        waiting = [seed for seed in waiting if seed not in done]
        before = now
    found = {(seed, content): done[seed][0] for seed in cells.seeds}
    return found, tuple(done[seed][1] for seed in cells.seeds), float(np.mean([one[2] for one in done.values()]))


def _signal_changes(sections: Sequence[Section], smoothing: float) -> Floats:
    """Change from each section to the next, at the times of the first.

    Smoothing removes the quantisation of recorded velocities, which is as large as the smallest change.
    """
    signals = [smooth(section.received, smoothing * section.period) for section in sections]
    times = [section.times[: len(signal)] for section, signal in zip(sections, signals, strict=True)]
    signals = at_common_times(times, signals, times[0])
    size = np.linalg.norm(signals[-1])
    return np.array([np.linalg.norm(fine - coarse) / size for coarse, fine in itertools.pairwise(signals)])


def _reference_experiment(experiment: Experiment, step_fraction: float) -> Experiment:
    """Return the experiment at the highest accuracy: float64, finite displacement, all disks, dense samples.

    Early stop keeps its setting; as a separate knob it is shown to change no reading.
    """
    return with_wave(
        experiment,
        precision="float64",
        regime="finite",
        keep=(WHOLE_DOMAIN,),
        step_fraction=step_fraction,
        samples_per_period=max(REFERENCE_SAMPLES, experiment.wave.samples_per_period),
    )
