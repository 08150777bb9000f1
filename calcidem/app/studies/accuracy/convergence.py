"""Observed order of convergence of the received signal in the time step."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calcidem.app.studies.accuracy.batches import fitting_lanes
from calcidem.app.studies.accuracy.comparison import at_times, sample_times
from calcidem.app.studies.accuracy.settings import REFERENCE_SAMPLES, with_wave
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure_all
from calcidem.dem.wave.propagation import WaveRecord

STEPS = (0.8, 0.4, 0.2, 0.1)  # over the limit; each half of the one before


@dataclass(frozen=True, slots=True)
class Convergence:
    """How the signal of a content converges, in the linear regime, medians over its cells.

    Attributes
    ----------
    content
        Percent.
    damped
        With the experiment's local damping, or without any.
    changes
        Change of the signal by each halving of the step: normalised L2, at the times of the largest step's samples.
    orders
        Logarithm to base 2 of each change over the next: the order, without needing an exact solution.
    """

    content: float
    damped: bool
    changes: tuple[float, ...]
    orders: tuple[float, ...]


def convergence(
    experiment: Experiment, content: float, seeds: Sequence[int], velocity: float, *, damped: bool, lanes: int = 8
) -> Convergence:
    """Measure the order at one content.

    Local damping pushes against the sign of the velocity half a step before, and that sign turns over at some instant
    within a step: an error of first order. The rest of the scheme is of second order, which shows without damping.

    Parameters
    ----------
    experiment, content, seeds
        What to measure.
    velocity
        Shear-wave velocity, m/s; records end when a wave of two thirds of it has been heard.
    damped
        See `Convergence`.
    lanes
        Width of the kernel.
    """
    even = with_wave(
        experiment,
        regime="linear",
        precision="float64",
        samples_per_period=REFERENCE_SAMPLES,
        slowest=velocity / 1.5,
        **({} if damped else {"damping": 0.0, "boundary_damping": 0.0}),
    )
    even = replace(even, early_stop=False, installation="preserve")
    width = fitting_lanes(seeds, lanes)
    runs = [measure_all(with_wave(even, step_fraction=step), content, seeds, lanes=width) for step in STEPS]
    changes = np.median([signal_changes([run[cell].record for run in runs]) for cell in range(len(seeds))], axis=0)
    orders = np.log2(changes[:-1] / changes[1:])
    return Convergence(content, damped, tuple(changes.tolist()), tuple(orders.tolist()))


def signal_changes(records: Sequence[WaveRecord]) -> Floats:
    """Change from each record to the next, at the times of the first."""
    times = [sample_times(record) for record in records]
    begin, end = max(time[0] for time in times), min(time[-1] for time in times)
    common = times[0][(times[0] >= begin) & (times[0] <= end)]
    signals = [at_times(common, time, record.velocity) for time, record in zip(times, records, strict=True)]
    size = np.linalg.norm(signals[-1])
    return np.array([np.linalg.norm(fine - coarse) / size for coarse, fine in itertools.pairwise(signals)])
