"""From a seed and a content to a shear-wave velocity: cement the packing, send the wave, read its arrival."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from time import perf_counter

import numpy as np

from calcidem.dem.kernels.compiling import seconds_compiling
from calcidem.dem.sample.cement import CementOrdering, PlacedCement
from calcidem.dem.wave.arrival import is_settled, read_travel_times
from calcidem.dem.wave.error_estimate import ErrorParts, cure_of, estimate_error
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.pick import PickFailure, Picks, Signals
from calcidem.dem.wave.propagation import send_waves
from calcidem.dem.wave.recorder import WaveRecord

LARGEST_BOUND = 0.05  # of the error, above which a velocity is not trusted
_INEXACT = "the numerical error may be above 5 %"
_SILENT = 1e-3  # received velocity over the amplitude of the pulse; real arrivals are above 2e-2
_MUTED = 1e-2  # the same where damping leaves so little of a pulse that its remains have several tops
_MUTING = 0.6  # sample damping above which that is so: scenes with 0.62 and 0.68 changed Vs by 8 and 11 % with the step


class Outcome(StrEnum):
    """What became of a sample."""

    DONE = "done"
    NO_ARRIVAL = "no_arrival"
    UNSTABLE = "unstable"


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """What one sample gave.

    Attributes
    ----------
    seed, content
        Its identity; content in percent of the sand's mass, as wanted.
    outcome, reason
        What became of it, and why if there is no velocity.
    vs
        Shear-wave velocity by the experiment's method, m/s; None without a trusted pick.
    picks
        All readings, of the experiment's signal; None if the run was unstable.
    expected_error, error_bound
        Relative error of ``vs`` to expect, and its bound, see `error_estimate`; None without ``vs``.
    frequency
        Excitation, Hz.
    distance
        Way of the wave that ``vs`` is over its travel time, m; see `Experiment.distance`.
    cement
        Where the cement is.
    record
        Signals and time step.
    seconds
        Wall time of this sample's share of its batch, without that of compiling kernels.
    """

    seed: int
    content: float
    outcome: Outcome
    reason: str
    vs: float | None
    picks: Picks | None
    expected_error: float | None
    error_bound: float | None
    frequency: float
    distance: float
    cement: PlacedCement
    record: WaveRecord
    seconds: float


def measure(
    experiment: Experiment,
    content: float,
    seeds: Sequence[int],
    *,
    lanes: int = 8,
    check: Callable[[], None] = lambda: None,
    ordering: Callable[[int], CementOrdering] | None = None,
) -> tuple[Measurement, ...]:
    """Measure the samples of several seeds at one content, side by side.

    Parameters
    ----------
    experiment
        What they share.
    content
        Percent of the sand's mass.
    seeds
        At most ``lanes`` of them. What a seed gives does not depend on the others.
    lanes
        Width of the kernel: 1, 2, 4, 8, 16 or 32.
    check
        Called every fraction of a second; may raise to end the run.
    ordering
        Stands for `Experiment.ordering`; one that remembers saves time where a seed is measured at many contents.

    Raises
    ------
    CementCapacityError
        If the content is more than the sample can hold.
    """
    began = perf_counter() - seconds_compiling()
    placed = [(ordering or experiment.ordering)(seed).at(content) for seed in seeds]
    frequency = experiment.frequency(content)

    def stop_when(record: WaveRecord) -> bool:
        if not experiment.early_stop or record.duration <= 1.0 / frequency:
            return False
        loudest = record.remaining_speed if experiment.signal == "velocity" else np.inf
        return is_settled(signals_of(record, experiment), experiment.pick, loudest=loudest)

    bonded = [cement.bonded for cement in placed]
    records = send_waves(experiment, bonded, frequency, stop_when=stop_when, lanes=lanes, check=check)
    seconds = (perf_counter() - seconds_compiling() - began) / len(seeds)
    given = frequency, experiment.distance
    return tuple(
        Measurement(seed, content, *interpret_record(experiment, frequency, record), *given, cement, record, seconds)
        for seed, cement, record in zip(seeds, placed, records, strict=True)
    )


def measure_all(
    experiment: Experiment,
    content: float,
    seeds: Sequence[int],
    *,
    lanes: int = 8,
    ordering: Callable[[int], CementOrdering] | None = None,
) -> tuple[Measurement, ...]:
    """Measure any number of seeds at one content, in batches as wide as the kernel; see `measure`."""
    found: list[Measurement] = []
    for begin in range(0, len(seeds), lanes):
        found += measure(experiment, content, seeds[begin : begin + lanes], lanes=lanes, ordering=ordering)
    return tuple(found)


def signals_of(record: WaveRecord, experiment: Experiment) -> Signals:
    """Signals of a record as the picking wants them.

    A received velocity below a small part of the sent one is silence. The force that belongs to it is that of a wave
    of the slowest velocity that is looked for, ``rho V v`` times the length of the receiver.
    """
    wave = experiment.wave
    floor = (_MUTED if wave.damping > _MUTING else _SILENT) * wave.amplitude
    if experiment.signal == "velocity":
        given = record.sampling_interval, record.sent, record.velocity, experiment.distance, floor
        return Signals(*given, record.stations, experiment.stations, record.along)
    floor *= experiment.sand.density * experiment.pick.slowest * 2.0 * wave.receiver_half_width
    return Signals(record.sampling_interval, record.sent, record.force, experiment.distance, floor)


def interpret_record(
    experiment: Experiment, frequency: float, record: WaveRecord
) -> tuple[Outcome, str, float | None, Picks | None, float | None, float | None]:
    """Outcome, reason, vs, picks, expected error and its bound; what cannot be trusted has a reason, never a number."""
    if record.problem:
        return Outcome.UNSTABLE, record.problem, *(None,) * 4
    signals = signals_of(record, experiment)
    picks = read_travel_times(signals, experiment.pick)
    unread = None, picks, None, None
    reading = getattr(picks, experiment.method)
    if reading.velocity is None or reading.travel_time is None:
        return Outcome.NO_ARRIVAL, str(reading.failure), *unread
    if reading.quality < experiment.least_quality:
        reason = f"quality {reading.quality:.2f} of the pick is below {experiment.least_quality}"
        return Outcome.NO_ARRIVAL, reason, *unread
    expected, bound, parts = numerical_error(experiment, frequency, record, signals, picks, reading.travel_time)
    if bound > LARGEST_BOUND:
        return Outcome.NO_ARRIVAL, f"{_INEXACT}: {cure_of(experiment, parts, LARGEST_BOUND)}", *unread
    return Outcome.DONE, "", reading.velocity, picks, expected, bound


def numerical_error(
    experiment: Experiment, frequency: float, record: WaveRecord, signals: Signals, picks: Picks, travel_time: float
) -> tuple[float, float, ErrorParts]:
    """Relative error of a velocity to expect, its bound, and the parts of that; Hz and s."""
    noisy = picks.first_arrival.failure == PickFailure.NOISE
    return estimate_error(experiment, record, signals, frequency, travel_time, noisy=noisy)
