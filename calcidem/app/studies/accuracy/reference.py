"""The converged reference of each cell, the error of other settings, and the order of convergence."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import process_time

import numpy as np
from scipy.interpolate import CubicSpline

from calcidem.app.studies.accuracy.settings import REFERENCE_SAMPLES, reference_experiment, with_wave
from calcidem.dem.engine.scene import Regime
from calcidem.dem.kernels.compiling import seconds_compiling
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement, measure_all
from calcidem.dem.wave.reading import smooth
from calcidem.dem.wave.recorder import WaveRecord

HALVING = 1.0e-4  # relative change of Vs by which halving the step may move it
COARSEST = 0.4  # step over the limit that is tried first
_FINEST = 0.05  # and that is not gone below
CONVERGENCE_STEPS = (0.8, 0.4, 0.2, 0.1)  # over the limit; each half of the one before


@dataclass(frozen=True, slots=True)
class ReferenceCell:
    """Reference of one cell.

    Attributes
    ----------
    seed, content
        The cell; content in percent.
    vs
        m/s; None where the reference has no trusted pick either.
    step_fraction
        Its step over the stability limit.
    halving
        Relative change of Vs when a step twice as large was halved to that step; None without a velocity.
    """

    seed: int
    content: float
    vs: float | None
    step_fraction: float
    halving: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Reference of all cells of a content.

    Attributes
    ----------
    measurements, cells
        Measurement of each cell, and what is said of it.
    seconds
        Processor time of a cell.
    """

    measurements: tuple[Measurement, ...]
    cells: tuple[ReferenceCell, ...]
    seconds: float


@dataclass(frozen=True, slots=True)
class CellError:
    """How far one cell of one setting is from the reference.

    Attributes
    ----------
    setting
        `Setting.name`.
    seed, content
        The cell; content in percent.
    vs, reference_vs
        m/s; None where there is no trusted pick.
    vs_error
        Relative, signed; None unless both have a velocity.
    arrival_error
        Relative, of the travel time of the first arrival, signed; None unless both have one.
    signal_error
        See `signal_distance`.
    expected, bound
        Relative error that the cell itself expects, and its bound.
    """

    setting: str
    seed: int
    content: float
    vs: float | None
    reference_vs: float | None
    vs_error: float | None
    arrival_error: float | None
    signal_error: float
    expected: float | None
    bound: float | None


@dataclass(frozen=True, slots=True)
class Convergence:
    """How the signal of a content converges, medians over its cells.

    Attributes
    ----------
    content
        Percent.
    damped
        With the experiment's local damping, or without any.
    regime
        ``linear``, or another in which contacts keep a history.
    changes
        Change of the signal by each halving of the step: normalised L2, at the times of the largest step's samples.
    orders
        Logarithm to base 2 of each change over the next: the order, without needing an exact solution.
    """

    content: float
    damped: bool
    regime: Regime
    changes: tuple[float, ...]
    orders: tuple[float, ...]


def find_reference(
    experiment: Experiment, content: float, seeds: Sequence[int], lanes: int, coarsest: float = COARSEST
) -> Reference:
    """Measure a content exactly: the step of each cell is halved until its Vs changes by less than `HALVING`.

    A cell that is still moving at `_FINEST` stays with that, and says by how much.
    """
    step, waiting = coarsest, list(seeds)
    before, _ = _measure_by_seed(experiment, step, content, waiting, lanes)
    done: dict[int, tuple[Measurement, ReferenceCell, float]] = {}
    while waiting:
        step /= 2.0
        now, seconds = _measure_by_seed(experiment, step, content, waiting, lanes)
        for seed in waiting:
            change = relative_deviation(now[seed].vs, before[seed].vs)
            if change is None or abs(change) < HALVING or step <= _FINEST:
                done[seed] = now[seed], ReferenceCell(seed, content, now[seed].vs, step, change), seconds
        waiting = [seed for seed in waiting if seed not in done]
        before = now
    rows = [done[seed] for seed in seeds]
    return Reference(tuple(row[0] for row in rows), tuple(row[1] for row in rows), float(np.mean([r[2] for r in rows])))


def _measure_by_seed(
    experiment: Experiment, step: float, content: float, seeds: Sequence[int], lanes: int
) -> tuple[dict[int, Measurement], float]:
    """Measurements with a step, and processor time of a cell, s."""
    found, seconds = measure_and_time(
        reference_experiment(experiment, step), content, seeds, fitting_lanes(seeds, lanes)
    )
    return {cell.seed: cell for cell in found}, seconds


def measure_and_time(
    experiment: Experiment, content: float, seeds: Sequence[int], lanes: int
) -> tuple[tuple[Measurement, ...], float]:
    """Measure, and give the processor time of a cell, s; what had to compile its kernels is measured a second time.

    Processor time leaves out what other programs take of a shared machine, unlike the wall time of a `Measurement`.
    """
    compiled = seconds_compiling()
    found, seconds = _measure_once(experiment, content, seeds, lanes)
    return (found, seconds) if seconds_compiling() == compiled else _measure_once(experiment, content, seeds, lanes)


def _measure_once(
    experiment: Experiment, content: float, seeds: Sequence[int], lanes: int
) -> tuple[tuple[Measurement, ...], float]:
    """Measure, and give the processor time of a cell, s."""
    began = process_time()
    found = measure_all(experiment, content, seeds, lanes=lanes)
    return found, (process_time() - began) / len(seeds)


def fitting_lanes(seeds: Sequence[int], lanes: int) -> int:
    """Width of the kernel that these seeds fill: the smallest power of two, at most ``lanes``."""
    return min(lanes, 1 << (len(seeds) - 1).bit_length())


def cell_error(
    setting: str, found: Measurement, amplitude: float, exact: Measurement, exact_amplitude: float
) -> CellError:
    """Compare a cell with the reference of the same cell; amplitudes of the pulses in m/s."""
    return CellError(
        setting=setting,
        seed=found.seed,
        content=found.content,
        vs=found.vs,
        reference_vs=exact.vs,
        vs_error=relative_deviation(found.vs, exact.vs),
        arrival_error=relative_deviation(_first_arrival(exact), _first_arrival(found)),
        signal_error=signal_distance(found.record, amplitude, exact.record, exact_amplitude),
        expected=found.result.error and found.result.error.expected,
        bound=found.result.error and found.result.error.bound,
    )


def relative_deviation(found: float | None, exact: float | None) -> float | None:
    """Relative deviation; None if either is missing."""
    return None if found is None or exact is None else found / exact - 1.0


def _first_arrival(measurement: Measurement) -> float | None:
    """Velocity by the first arrival, m/s."""
    return None if measurement.result.reading is None else measurement.result.reading.first_arrival


def signal_distance(found: WaveRecord, amplitude: float, exact: WaveRecord, exact_amplitude: float) -> float:
    """Normalised L2 distance of two received signals, each over its amplitude, on the time that both cover.

    ``||a - b|| / ||b||`` at the samples of the coarser record; the finer one is interpolated by a cubic spline.
    """
    times = [record.section.times for record in (found, exact)]
    coarser = max(times, key=lambda time: float(time[1] - time[0]))
    begin, end = max(time[0] for time in times), min(time[-1] for time in times)
    common = coarser[(coarser >= begin) & (coarser <= end)]
    first = _at_times(common, times[0], found.section.received / amplitude)
    second = _at_times(common, times[1], exact.section.received / exact_amplitude)
    return float(np.linalg.norm(first - second) / np.linalg.norm(second))


def _at_times(wanted: Floats, time: Floats, values: Floats) -> Floats:
    """Values between samples, by a cubic spline; where they are not finite there is none."""
    if not np.all(np.isfinite(values)):
        return np.full(len(wanted), np.nan)
    return np.asarray(CubicSpline(time, values)(wanted))


def measure_convergence(
    experiment: Experiment,
    content: float,
    seeds: Sequence[int],
    velocity: float,
    *,
    damped: bool,
    regime: Regime = "linear",
    lanes: int = 8,
) -> Convergence:
    """Measure the order at one content.

    Local damping pushes against the sign of the velocity half a step before, and that sign turns over at some instant
    within a step: an error of first order. So is the increment of a shear force in a contact that sticks while its
    stiffness changes, as in the small and finite regimes. The rest is of second order, which shows in the linear regime
    without damping.

    Parameters
    ----------
    experiment, content, seeds
        What to measure.
    velocity
        Shear-wave velocity, m/s; records end when a wave of two thirds of it has been received.
    damped, regime
        See `Convergence`.
    lanes
        Width of the kernel.
    """
    even = with_wave(
        experiment,
        regime=regime,
        precision="float64",
        samples_per_period=REFERENCE_SAMPLES,
        slowest=velocity / 1.5,
        **({} if damped else {"damping": 0.0, "boundary_damping": 0.0}),
    )
    even = replace(even, early_stop=False, installation="preserve")
    width = fitting_lanes(seeds, lanes)
    runs = [measure_all(with_wave(even, step_fraction=step), content, seeds, lanes=width) for step in CONVERGENCE_STEPS]
    records = [[run[cell].record for run in runs] for cell in range(len(seeds))]
    changes = np.median([_signal_changes(cell, even.pick.smoothing) for cell in records], axis=0)
    orders = np.log2(changes[:-1] / changes[1:])
    return Convergence(content, damped, regime, tuple(changes.tolist()), tuple(orders.tolist()))


def _signal_changes(records: Sequence[WaveRecord], smoothing: float) -> Floats:
    """Change from each record to the next, at the times of the first.

    Smoothing removes the steps in which velocities are recorded, which are as large as the smallest change.
    """
    sections = [record.section for record in records]
    signals = [smooth(section.received, smoothing * section.period) for section in sections]
    times = [section.times[: len(signal)] for section, signal in zip(sections, signals, strict=True)]
    begin, end = max(time[0] for time in times), min(time[-1] for time in times)
    common = times[0][(times[0] >= begin) & (times[0] <= end)]
    signals = [_at_times(common, time, signal) for time, signal in zip(times, signals, strict=True)]
    size = np.linalg.norm(signals[-1])
    return np.array([np.linalg.norm(fine - coarse) / size for coarse, fine in itertools.pairwise(signals)])
