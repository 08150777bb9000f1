"""Errors of one setting against the reference, cell by cell."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.measurement import Measurement
from calcidem.dem.wave.propagation import WaveRecord


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
    estimate
        The relative error the cell itself states.
    """

    setting: str
    seed: int
    content: float
    vs: float | None
    reference_vs: float | None
    vs_error: float | None
    arrival_error: float | None
    signal_error: float
    estimate: float | None


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
        vs_error=relative(found.vs, exact.vs),
        arrival_error=relative(first_arrival(found), first_arrival(exact)),
        signal_error=signal_distance(found.record, amplitude, exact.record, exact_amplitude),
        estimate=found.error_estimate,
    )


def relative(found: float | None, exact: float | None) -> float | None:
    """Relative deviation; None if either is missing."""
    return None if found is None or exact is None else found / exact - 1.0


def first_arrival(measurement: Measurement) -> float | None:
    """Travel time of the first arrival, s."""
    return None if measurement.picks is None else measurement.picks.first_arrival.travel_time


def signal_distance(found: WaveRecord, amplitude: float, exact: WaveRecord, exact_amplitude: float) -> float:
    """Normalised L2 distance of two received signals, each over its amplitude, on the time that both cover.

    ``||a - b|| / ||b||`` at the samples of the coarser record; the finer one is interpolated by a cubic spline.
    """
    times = [sample_times(record) for record in (found, exact)]
    coarser = max(times, key=lambda time: float(time[1] - time[0]))
    begin, end = max(time[0] for time in times), min(time[-1] for time in times)
    common = coarser[(coarser >= begin) & (coarser <= end)]
    first = at_times(common, times[0], found.velocity / amplitude)
    second = at_times(common, times[1], exact.velocity / exact_amplitude)
    return float(np.linalg.norm(first - second) / np.linalg.norm(second))


def at_times(wanted: Floats, time: Floats, values: Floats) -> Floats:
    """Values between samples, by a cubic spline; where they are not finite there is none."""
    if not np.all(np.isfinite(values)):
        return np.full(len(wanted), np.nan)
    return np.asarray(CubicSpline(time, values)(wanted))


def sample_times(record: WaveRecord) -> Floats:
    """Times of the samples of a record, s: velocities belong to half a step before."""
    return (np.arange(len(record.velocity)) + 1.0) * record.interval - 0.5 * record.time_step
