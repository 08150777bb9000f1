"""From a seed and a content to a shear-wave velocity: cement the packing, transmit the wave, read its section."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from statistics import fmean
from time import perf_counter

from calcidem.dem.kernels.compiling import seconds_compiling
from calcidem.dem.sample.cement import CementOrdering, PlacedCement
from calcidem.dem.wave.check import Check, check_content, from_other_side, reading_of, with_check
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.propagation import send_waves
from calcidem.dem.wave.reading import Reading, describe_refusal, read_section
from calcidem.dem.wave.section import Section, StripWave
from calcidem.ends import CellStatus, Verdict


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
    check: Check
    """Law, time step and errors of the content."""
    status: CellStatus = CellStatus.RUNNING
    reason: str = ""
    """Outcome of the sample, and the reason if there is no velocity; running until `interpret` read the section."""
    vs: float | None = None
    """Shear-wave velocity by the method of `PickRule`, m/s; None if it is unreliable."""
    reading: Reading | None = None
    """Complete reading with its standard error; None if the run was unstable, no wave was found, or the
    content has an unknown error."""
    other_wave: StripWave | None = None
    """Wave from the other side, if it was transmitted (`WaveRule.both_sides`) and found with an error."""
    seconds: float = 0.0
    """Share of the wall time of all that were measured with it, without compilation of kernels."""

    @property
    def effective_vs(self) -> float | None:
        """Effective velocity of the sample, m/s, see `StripWave`, the mean of both sides if known; None without."""
        return None if self.reading is None else fmean(wave.velocity for wave in self._waves(self.reading))

    @property
    def effective_error(self) -> float | None:
        """Its relative standard error: root of the sum of squares of fit, simulation and pulse.

        That of a fit is the larger one of two estimates: of its section, and of the content by both sides. Those of
        two sides are independent.
        """
        if self.reading is None:
            return None
        numerical, pulse, side = (
            part or 0.0 for part in (self.check.numerical_error, self.check.pulse_effect, self.check.side_error)
        )
        fits = [max(wave.error, side) for wave in self._waves(self.reading)]
        fit_square = sum(fit * fit for fit in fits) / len(fits) ** 2
        return math.sqrt(fit_square + numerical * numerical + pulse * pulse)

    def _waves(self, reading: Reading) -> tuple[StripWave, ...]:
        """Waves that count: those of one side or both whose error is known, else that of this side."""
        both = (reading.wave,) if self.other_wave is None else (reading.wave, self.other_wave)
        return tuple(wave for wave in both if wave.error < 1.0) or both[:1]


def measure(
    experiment: Experiment,
    content: float,
    seeds: Sequence[int],
    *,
    lanes: int = 8,
    raise_if_stopped: Callable[[], None] = lambda: None,
    ordering: Callable[[int], CementOrdering] | None = None,
    checked: Callable[[float], Check] | None = None,
) -> tuple[Measurement, ...]:
    """Measure the samples of any number of seeds at one content, as many side by side as the kernel is wide.

    The first call for a content computes its check samples, too (`check.check_content`).
    `CementCapacityError` if the content is more than the sample can hold.

    Parameters
    ----------
    experiment
        Common settings.
    content
        Percent of the sand's mass.
    seeds
        The result of a seed does not depend on the others.
    lanes
        Width of the kernel: 1, 2, 4, 8, 16 or 32.
    raise_if_stopped
        Called every fraction of a second; may raise to end the run.
    ordering
        Replaces `Experiment.ordering`; a cached one saves time if a seed is measured at many contents.
    checked
        Replaces `check_content`; a cached one saves time if other processes measure the same content.
    """
    placed = [(ordering or experiment.ordering)(seed).at(content) for seed in seeds]
    if experiment.is_checked:
        found = (
            checked(content)
            if checked
            else experiment.once(check_content, content, lanes, raise_if_stopped=raise_if_stopped)
        )
    else:
        found = Check(experiment.wave.contact_law, experiment.wave.step_fraction, None, None, None)
    began = perf_counter() - seconds_compiling()

    def sections(usual: Experiment) -> list[Section]:
        settings, frequency = with_check(usual, found), experiment.frequency(content)
        bonded = [cement.bonded for cement in placed]
        batches = (bonded[begin : begin + lanes] for begin in range(0, len(bonded), lanes))
        sent = (send_waves(settings, one, frequency, lanes=lanes, raise_if_stopped=raise_if_stopped) for one in batches)
        return [*chain.from_iterable(sent)]

    measured = [
        interpret(experiment, Measurement(seed, content, cement, section, found))
        for seed, cement, section in zip(seeds, placed, sections(experiment), strict=True)
    ]
    if experiment.wave.both_sides:
        others = (reading_of(section, experiment) for section in sections(experiment.once(from_other_side)))
        measured = [
            replace(one, other_wave=other.wave) if one.reading and other and other.wave.error < 1.0 else one
            for one, other in zip(measured, others, strict=True)
        ]
    seconds = (perf_counter() - seconds_compiling() - began) / len(seeds)
    return tuple(replace(one, seconds=seconds) for one in measured)


def interpret(experiment: Experiment, measurement: Measurement) -> Measurement:
    """Read the section of a measurement; unreliable results have a reason instead of a velocity."""
    section, check = measurement.section, measurement.check
    new = replace(measurement, status=CellStatus.NO_ARRIVAL, reason="", vs=None, reading=None)
    if section.problem:
        return replace(new, status=CellStatus.UNSTABLE, reason=section.problem)
    reading = read_section(section, experiment.clamp, experiment.pick)
    if isinstance(reading, Verdict):
        return replace(new, reason=describe_refusal(reading, section, experiment.pick))
    errors = {
        "other settings": check.numerical_error,
        "the pulse reversed": check.pulse_effect,
        "the wave from the other side": check.side_error,
    }
    if experiment.is_checked and (unknown := [name for name, error in errors.items() if error is None]):
        # Neither velocity is a measurement without its error, whatever the law.
        reason = f"with {' and '.join(unknown)} their waves do not all arrive"
        return replace(new, reason=f"{Verdict.INACCURATE}: {reason}")
    vs: float | None = getattr(reading, experiment.pick.method)
    if reading.verdict is not None:
        reason = describe_refusal(reading, section, experiment.pick)
    elif vs is None:
        reason = f'the {experiment.pick.method.replace("_", " ")} cannot be read; pick.method = "peak" can'
    elif (check.numerical_error or 0.0) > 0.05:  # then no Vs of the content is given
        reason = f"{Verdict.INACCURATE}: the standard error is {check.numerical_error:.1%}, 5 % are allowed"
    else:
        return replace(new, status=CellStatus.DONE, reading=reading, vs=vs)
    return replace(new, reason=reason, reading=reading)
