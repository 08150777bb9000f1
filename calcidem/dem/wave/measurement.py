"""From a seed and a content to a shear-wave velocity: cement the packing, transmit the wave, pick its arrival."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from time import perf_counter

import numpy as np

from calcidem.dem.kernels.compiling import seconds_compiling
from calcidem.dem.sample.cement import CementOrdering, PlacedCement
from calcidem.dem.wave.error_estimate import NumericalError, chatters, cure_of, estimate_error, shift_by_change
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.propagation import send_waves, stiffness_contrast, with_half_step
from calcidem.dem.wave.reading import Reading, ShearArrival, describe_refusal, is_settled, read_section
from calcidem.dem.wave.recorder import WaveRecord
from calcidem.ends import Verdict

LARGEST_BOUND = 0.05  # bound of the numerical error above which a velocity is rejected
_INEXACT = "the numerical error may be above 5 %"


class Outcome(StrEnum):
    """Outcome of a sample."""

    DONE = "done"
    NO_ARRIVAL = "no_arrival"
    UNSTABLE = "unstable"


@dataclass(frozen=True, slots=True)
class Interpretation:
    """Interpretation of a record."""

    outcome: Outcome
    reason: str = ""
    """Outcome of the sample, and the reason if there is no velocity."""
    vs: float | None = None
    """Shear-wave velocity by the method of `PickRule`, m/s; None if it is unreliable."""
    reading: Reading | None = None
    """Complete reading with its standard error; None if the run was unstable."""
    error: NumericalError | None = None
    """Numerical error; None without a reading."""


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """Measurement of one sample."""

    seed: int
    content: float
    """Identity of the sample; requested content in percent of the sand's mass."""
    result: Interpretation
    """See its class."""
    frequency: float
    """Excitation frequency, Hz."""
    cement: PlacedCement
    """Placed cement."""
    record: WaveRecord
    """Section and time step."""
    seconds: float
    """Share of the batch's wall time, without compilation of kernels."""

    @property
    def vs(self) -> float | None:
        """Shear-wave velocity, m/s; see `Interpretation`."""
        return self.result.vs


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

    For a sample that `chatters`, the wave is repeated with half the step; its velocity counts.
    `CementCapacityError` if the content is more than the sample can hold.

    Parameters
    ----------
    experiment
        Common settings.
    content
        Percent of the sand's mass.
    seeds
        At most ``lanes`` seeds. The result of a seed does not depend on the others.
    lanes
        Width of the kernel: 1, 2, 4, 8, 16 or 32.
    check
        Called every fraction of a second; may raise to end the run.
    ordering
        Replaces `Experiment.ordering`; a cached one saves time if a seed is measured at many contents.
    """
    began = perf_counter() - seconds_compiling()
    placed = [(ordering or experiment.ordering)(seed).at(content) for seed in seeds]
    frequency = experiment.frequency(content)

    def stop_when(record: WaveRecord) -> bool:
        transmitted = record.section.duration * frequency > 1.0
        return (
            experiment.early_stop
            and transmitted
            and is_settled(record.section, experiment.pick, record.remaining_speed)
        )

    bonded = [cement.bonded for cement in placed]
    records = send_waves(experiment, bonded, frequency, stop_when=stop_when, lanes=lanes, check=check)
    results = [interpret_record(experiment, record) for record in records]
    damping = experiment.wave.damping
    unruly = [i for i, record in enumerate(records) if chatters(damping, stiffness_contrast(experiment, record))]
    for sample in (i for i in unruly if records[i].retry):
        # Its step is half already, and a guard ended the full step: nothing to compare with.
        ended = replace(records[sample], problem=records[sample].retry)
        results[sample] = interpret_record(experiment, records[sample], ended)
    if unruly := [i for i in unruly if not records[i].retry]:
        finer = with_half_step(experiment)
        again = send_waves(finer, [bonded[i] for i in unruly], frequency, stop_when=stop_when, lanes=lanes, check=check)
        for sample, record in zip(unruly, again, strict=True):
            results[sample] = interpret_record(finer, record, records[sample])
            records[sample] = record
    seconds = (perf_counter() - seconds_compiling() - began) / len(seeds)
    return tuple(
        Measurement(seed, content, result, frequency, cement, record, seconds)
        for seed, result, cement, record in zip(seeds, results, placed, records, strict=True)
    )


def measure_all(
    experiment: Experiment,
    content: float,
    seeds: Sequence[int],
    *,
    lanes: int = 8,
    ordering: Callable[[int], CementOrdering] | None = None,
) -> tuple[Measurement, ...]:
    """Measure any number of seeds at one content, in batches of kernel width; see `measure`."""
    found: list[Measurement] = []
    for begin in range(0, len(seeds), lanes):
        found += measure(experiment, content, seeds[begin : begin + lanes], lanes=lanes, ordering=ordering)
    return tuple(found)


def interpret_record(experiment: Experiment, record: WaveRecord, coarser: WaveRecord | None = None) -> Interpretation:
    """Interpret a record; unreliable results have a reason instead of a velocity.

    ``coarser`` is the record of the same sample with twice the step; the difference of both counts as an error.
    """
    if record.problem:
        return Interpretation(Outcome.UNSTABLE, record.problem)
    reading = read_section(record.section, experiment.pick)
    if reading.arrival is None or reading.verdict is not None:
        reason = describe_refusal(reading.verdict or Verdict.SILENT, record.section, experiment.pick, reading.error)
        return Interpretation(Outcome.NO_ARRIVAL, reason, reading=reading)
    change = None if coarser is None else _change_by_halving(experiment, record, reading.arrival, coarser)
    error = estimate_error(experiment, record, reading.arrival, change)
    vs: float | None = getattr(reading, experiment.pick.method)
    if vs is None:
        reason = f'the {experiment.pick.method.replace("_", " ")} cannot be read; pick.method = "peak" can'
        return Interpretation(Outcome.NO_ARRIVAL, reason, reading=reading, error=error)
    if error.bound > LARGEST_BOUND:
        reason = f"{_INEXACT}: {cure_of(experiment, error.parts, LARGEST_BOUND)}"
        return Interpretation(Outcome.NO_ARRIVAL, reason, reading=reading, error=error)
    return Interpretation(Outcome.DONE, "", vs, reading, error)


def _change_by_halving(experiment: Experiment, record: WaveRecord, arrival: ShearArrival, coarser: WaveRecord) -> float:
    """Relative change of a travel time by halving the step; 1 if that of the full step is unknown.

    Two steps may take the same wrong peak. So the change is at least the shift of a peak by the change of the signal
    near it, within half a period.
    """
    before = None if coarser.problem else read_section(coarser.section, experiment.pick).arrival
    if before is None:
        return 1.0
    fine, coarse = record.section, coarser.section
    reach = int(0.5 * fine.period)
    near = np.arange(max(0, arrival.index - reach), min(len(arrival.clean), arrival.index + reach + 1))
    signal, last = before.clean[:, -1], len(before.clean) - 1
    place = np.clip((fine.times[near] - coarse.start_time) / coarse.sampling_interval, 0.0, last)
    left = np.minimum(place.astype(int), last - 1)
    change = signal[left] + (place - left) * (signal[left + 1] - signal[left]) - arrival.clean[near, -1]
    largest = float(np.abs(change).max() / arrival.clean[arrival.index, -1])
    return max(abs(before.travel_time / arrival.travel_time - 1.0), shift_by_change(fine, arrival) * largest)
