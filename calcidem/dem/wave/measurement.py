"""From a seed and a content to a shear-wave velocity: cement the packing, transmit the wave, pick its arrival."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from calcidem.dem.kernels.compiling import seconds_compiling
from calcidem.dem.sample.cement import CementOrdering, PlacedCement
from calcidem.dem.wave.error_estimate import ErrorParts, chatters, cure_of, estimate_error, shift_by_change
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.propagation import send_waves, stiffness_contrast, with_half_step
from calcidem.dem.wave.reading import Reading, describe_refusal, is_settled, read_section
from calcidem.dem.wave.section import Section
from calcidem.ends import CellStatus, Verdict

LARGEST_BOUND = 0.05  # bound of the numerical error above which a velocity is rejected


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """Measurement of one sample."""

    seed: int
    content: float
    """Identity of the sample; requested content in percent of the sand's mass."""
    cement: PlacedCement
    """Placed cement."""
    section: Section
    """Record of the wave, and how it was computed."""
    status: CellStatus = CellStatus.RUNNING
    reason: str = ""
    """Outcome of the sample, and the reason if there is no velocity; running until `interpret` read the section."""
    vs: float | None = None
    """Shear-wave velocity by the method of `PickRule`, m/s; None if it is unreliable."""
    reading: Reading | None = None
    """Complete reading with its standard error; None if the run was unstable or no S wave was found."""
    expected_error: float | None = None
    """Order of magnitude of the relative numerical error, which ranks cells; None without velocities."""
    error_bound: float | None = None
    error_parts: ErrorParts | None = None
    """Bound of this error, and bounds of its parts."""
    seconds: float = 0.0
    """Share of the batch's wall time, without compilation of kernels."""


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

    def stop_when(section: Section) -> bool:
        transmitted = section.duration * frequency > 1.0
        return experiment.early_stop and transmitted and is_settled(section, experiment.pick, section.remaining_speed)

    bonded = [cement.bonded for cement in placed]
    sections = send_waves(experiment, bonded, frequency, stop_when=stop_when, lanes=lanes, check=check)
    found = [
        interpret(experiment, Measurement(seed, content, cement, section))
        for seed, cement, section in zip(seeds, placed, sections, strict=True)
    ]
    damping = experiment.wave.damping
    unruly = [i for i, section in enumerate(sections) if chatters(damping, stiffness_contrast(experiment, section))]
    for sample in (i for i in unruly if sections[i].retry):
        # Its step is half already, and a guard ended the full step: nothing to compare with.
        found[sample] = interpret(experiment, found[sample], replace(sections[sample], problem=sections[sample].retry))
    if unruly := [i for i in unruly if not sections[i].retry]:
        finer = with_half_step(experiment)
        again = send_waves(finer, [bonded[i] for i in unruly], frequency, stop_when=stop_when, lanes=lanes, check=check)
        for sample, section in zip(unruly, again, strict=True):
            found[sample] = interpret(finer, replace(found[sample], section=section), sections[sample])
    seconds = (perf_counter() - seconds_compiling() - began) / len(seeds)
    return tuple(replace(one, seconds=seconds) for one in found)


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


def interpret(experiment: Experiment, measurement: Measurement, coarser: Section | None = None) -> Measurement:
    """Read the section of a measurement; unreliable results have a reason instead of a velocity.

    ``coarser`` is the section of the same sample with twice the step; the difference of both counts as an error.
    """
    section = measurement.section
    new = Measurement(measurement.seed, measurement.content, measurement.cement, section, CellStatus.NO_ARRIVAL)
    if section.problem:
        return replace(new, status=CellStatus.UNSTABLE, reason=section.problem)
    reading = read_section(section, experiment.pick)
    if isinstance(reading, Verdict):
        return replace(new, reason=describe_refusal(reading, section, experiment.pick))
    if reading.verdict is not None:
        return replace(new, reason=describe_refusal(reading, section, experiment.pick), reading=reading)
    change = None if coarser is None else _change_by_halving(experiment, section, reading, coarser)
    expected, bound, parts = estimate_error(experiment, section, reading, change)
    new = replace(new, reading=reading, expected_error=expected, error_bound=bound, error_parts=parts)
    vs: float | None = getattr(reading, experiment.pick.method)
    if vs is None:
        reason = f'the {experiment.pick.method.replace("_", " ")} cannot be read; pick.method = "peak" can'
        return replace(new, reason=reason)
    if bound > LARGEST_BOUND:
        cure = cure_of(experiment, parts, LARGEST_BOUND)
        return replace(new, reason=f"the numerical error may be above 5 %: {cure}")
    return replace(new, status=CellStatus.DONE, vs=vs)


def _change_by_halving(experiment: Experiment, fine: Section, reading: Reading, coarse: Section) -> float:
    """Relative change of a travel time by halving the step; 1 if that of the full step is unknown.

    Two steps may take the same wrong peak. So the change is at least the shift of a peak by the change of the signal
    near it, within half a period.
    """
    before = None if coarse.problem else read_section(coarse, experiment.pick)
    if not isinstance(before, Reading):
        return 1.0
    reach = int(0.5 * fine.period)
    near = np.arange(max(0, reading.index - reach), min(len(reading.clean), reading.index + reach + 1))
    signal, last = before.clean[:, -1], len(before.clean) - 1
    place = np.clip((fine.times[near] - coarse.start_time) / coarse.sampling_interval, 0.0, last)
    left = np.minimum(place.astype(int), last - 1)
    change = signal[left] + (place - left) * (signal[left + 1] - signal[left]) - reading.clean[near, -1]
    largest = float(np.abs(change).max() / reading.clean[reading.index, -1])
    return max(abs(before.travel_time / reading.travel_time - 1.0), shift_by_change(fine, reading) * largest)
