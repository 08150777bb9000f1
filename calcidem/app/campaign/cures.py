"""What may give a sample a velocity that has none: values of the configuration, computed from its scene.

Nothing here is certain before it is tried, see `calcidem.app.campaign.cure_trials.try_cures`.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calcidem.analysis.shear_wave import damping_ratio
from calcidem.app.config.reference import written
from calcidem.dem.wave.error_estimate import ErrorParts, largest_part, turning_error
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import LARGEST_BOUND
from calcidem.dem.wave.peak import PERIODS_ASKED
from calcidem.dem.wave.pick import PassedOver, PickFailure

_MARGIN = 1.1  # over the periods that the rule of reading asks for
_RATIO = 1.3  # from a frequency to another one, where the rule asks for no number
_PASSED_ON = 0.8  # of the cut-off frequency, up to which grains pass a wave on
_WORTH_TRYING = 1.05  # ratio of two values that differ enough to be tried
_WIDE = 0.05  # by which the way to the receiver's edge may be longer than to its middle; the presets' is 4.8 %
_EDGE = math.sqrt((1.0 + _WIDE) ** 2 - 1.0)  # half a receiver that wide over its distance
_NARROWEST = 3.0  # mean diameters that half a receiver has to hold
_ADDED_DAMPING, _MOST_DAMPING = 0.1, 0.6
_QUIETER, _LOUDER = 0.2, 5.0  # factors of the amplitude
_ENOUGH_PERIODS = 2.0  # on the way; then P wave, S wave and noise stand apart


@dataclass(frozen=True, slots=True)
class Cure:
    """A value of the configuration to try.

    Attributes
    ----------
    name
        ``section.key``.
    value
        To be set; a frequency is meant for the content of the cell.
    why
        What it does to this sample.
    """

    name: str
    value: float | str
    why: str

    def __str__(self) -> str:
        """As a configuration has it."""
        return f"{self.name} = {written(self.value)}"

    @property
    def needs_packing(self) -> bool:
        """Whether another packing has to be made: then the samples are other ones."""
        return self.name.startswith("packing.")

    def apply(self, experiment: Experiment) -> Experiment:
        """Experiment with this value; `ValueError` where it is impossible."""
        section, key = self.name.split(".")
        changed: dict[str, Any] = {key: self.value}
        if self.name == "wave.frequency":
            return replace(experiment, frequencies=((0.0, 100.0), (float(self.value),) * 2))
        if section == "wave":
            return replace(experiment, wave=replace(experiment.wave, **changed))
        if key == "method":
            return replace(experiment, **changed)
        return replace(experiment, pick=replace(experiment.pick, **changed))


@dataclass(frozen=True, slots=True, eq=False)
class Symptoms:
    """What is known of a sample without a velocity.

    Attributes
    ----------
    experiment, frequency
        What it was measured with; Hz.
    failure
        Why the reading failed; None if the wave could not be computed, or its numbers are not trusted.
    verdict
        Why the highest top was passed over, if there is one.
    travel
        Travel time that the wave has by the doubted peak, by what is expected or by the highest top, s; None without
        any of them.
    error
        Bound of the numerical error, and its parts, where that is the reason.
    unstable, broken
        Whether a guard ended the run, and whether it was for broken bonds.
    """

    experiment: Experiment
    frequency: float
    failure: PickFailure | None = None
    verdict: PassedOver | None = None
    travel: float | None = None
    error: tuple[float, ErrorParts] | None = None
    unstable: bool = False
    broken: bool = False

    @property
    def periods(self) -> float | None:
        """Periods of the pulse on the way."""
        return None if self.travel is None else self.frequency * self.travel

    @property
    def highest_frequency(self) -> float:
        """Frequency that grains surely pass on, Hz: a part of the cut-off of a chain, ``V / (pi d)``."""
        if self.travel is None:
            return math.inf
        diameter = 2.0 * float(np.mean(self.experiment.packing.radius))
        return _PASSED_ON * self.experiment.distance / self.travel / (math.pi * diameter)


def find_cures(symptoms: Symptoms) -> tuple[Cure, ...]:
    """What may help, the most promising first; always something."""
    found: dict[str, Cure] = {}
    if symptoms.unstable:
        remedies = _BY_FAILURE[PickFailure.NOT_FINITE]
    elif symptoms.error is not None:
        remedies = (_smaller_error,)
    else:
        remedies = _BY_FAILURE.get(symptoms.failure) or _BY_VERDICT.get(symptoms.verdict, _UNCLEAR)
    for remedy in remedies:
        for cure in remedy(symptoms):
            found.setdefault(str(cure), cure)
    if not found:
        found = {str(cure): cure for cure in (*_higher_frequency(symptoms), *_lower_frequency(symptoms))}
    return tuple(found.values())


def _needed_periods(symptoms: Symptoms) -> float:
    """Periods on the way that the rule of reading asks for, or that part the waves."""
    asked = None if symptoms.failure is None else PERIODS_ASKED.get(symptoms.failure)
    present = symptoms.periods or 0.0
    if asked is not None and asked > present:
        return _MARGIN * asked
    if symptoms.failure is None and present < _ENOUGH_PERIODS:
        return _MARGIN * _ENOUGH_PERIODS
    return _RATIO * present


def _round_up(value: float) -> float:
    """Two significant digits, not below the value."""
    place = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / place - 1e-9) * place:.2g}")


def _higher_frequency(symptoms: Symptoms) -> Iterator[Cure]:
    """More wavelengths on the way."""
    present = symptoms.periods
    wanted = symptoms.frequency * (_needed_periods(symptoms) / present if present else _RATIO)
    value = min(_round_up(wanted), float(f"{symptoms.highest_frequency:.2g}"))
    if value < _WORTH_TRYING * symptoms.frequency:
        return
    why = "more wavelengths on the way part the waves that arrive"
    if present:
        why = f"{present * value / symptoms.frequency:.1f} instead of {present:.1f} periods on the way part the waves"
    if value < wanted:
        why += "; grains pass hardly more on (lattice cut-off)"
    yield Cure("wave.frequency", value, why)


def _lower_frequency(symptoms: Symptoms) -> Iterator[Cure]:
    """Longer waves, which scatter less and are damped less."""
    wanted = min(symptoms.frequency / _RATIO, symptoms.highest_frequency)
    why = "longer waves scatter less at grains and cement"
    if symptoms.frequency > symptoms.highest_frequency:
        why = "grains do not pass higher ones on (lattice cut-off)"
    yield Cure("wave.frequency", float(f"{wanted:.2g}"), why)


def _receiver(symptoms: Symptoms) -> tuple[float, float, float]:
    """Half the receiver, that of the presets for this way, and by how much the way to its edge is longer."""
    half, distance = symptoms.experiment.wave.receiver_half_width, symptoms.experiment.distance
    diameter = 2.0 * float(np.mean(symptoms.experiment.packing.radius))
    wanted = max(_EDGE * distance, _NARROWEST * diameter)
    wanted = min(wanted, 0.4 * symptoms.experiment.packing.height)
    return half, float(f"{wanted:.2g}"), math.hypot(1.0, half / distance) - 1.0


def _narrower_receiver(symptoms: Symptoms) -> Iterator[Cure]:
    """A receiver all of whose disks have about the same way."""
    half, wanted, longer = _receiver(symptoms)
    if half > _WORTH_TRYING * wanted:
        now = math.hypot(1.0, wanted / symptoms.experiment.distance) - 1.0
        why = f"the way to its edge is {longer:.0%} longer than to its middle and blurs the peak; then {now:.0%}"
        yield Cure("wave.receiver_half_width", wanted, why)


def _other_receiver(symptoms: Symptoms) -> Iterator[Cure]:
    """A receiver of the presets' proportions."""
    half, wanted, _ = _receiver(symptoms)
    if wanted > _WORTH_TRYING * half:
        why = f"scattered waves average out over {wanted / half:.1f} times as many disks"
        yield Cure("wave.receiver_half_width", wanted, why)
    yield from _narrower_receiver(symptoms)


def _wider_box(symptoms: Symptoms) -> Iterator[Cure]:
    """As many wavelengths by a longer way."""
    present, width = symptoms.periods, symptoms.experiment.packing.width
    if present and (needed := _needed_periods(symptoms)) > _WORTH_TRYING * present:
        why = f"{needed:.1f} periods on the way at the same frequency; it makes another packing"
        yield Cure("packing.width", _round_up(width * needed / present), why)


def _less_damping(symptoms: Symptoms) -> Iterator[Cure]:
    """Half the damping."""
    damping, periods = symptoms.experiment.wave.damping, symptoms.periods
    if damping == 0.0:
        return
    value = float(f"{0.5 * damping:.2g}")
    why = "less of the wave is lost on the way"
    if periods:
        before, after = (math.exp(-2.0 * math.pi * damping_ratio(alpha) * periods) for alpha in (damping, value))
        why = f"about {after:.0%} instead of {before:.0%} of a wave gets there"
    yield Cure("wave.damping", value, f"{why}; Vs rises with it")


def _more_damping(symptoms: Symptoms) -> Iterator[Cure]:
    """More damping, for what comes late."""
    value = round(min(symptoms.experiment.wave.damping + _ADDED_DAMPING, _MOST_DAMPING), 3)
    if value > symptoms.experiment.wave.damping:
        yield Cure("wave.damping", value, "scattered waves have the longer way and lose more; Vs falls with it")


def _softer_pulse(symptoms: Symptoms) -> Iterator[Cure]:
    """A pulse at which fewer contacts slip; in the linear regime the amplitude only scales all signals."""
    if symptoms.experiment.wave.regime != "linear" or symptoms.unstable:
        value = float(f"{_QUIETER * symptoms.experiment.wave.amplitude:.2g}")
        yield Cure("wave.amplitude", value, "fewer contacts slip and open, which scatters and rattles less")


def _louder_pulse(symptoms: Symptoms) -> Iterator[Cure]:
    """A pulse above what unbalanced forces do."""
    if symptoms.experiment.wave.regime != "linear":
        value = float(f"{_LOUDER * symptoms.experiment.wave.amplitude:.2g}")
        yield Cure("wave.amplitude", value, "what unbalanced forces move is as small as before beside it")


def _longer_record(symptoms: Symptoms) -> Iterator[Cure]:
    """A record in which the slowest wave that is to be expected is settled."""
    rule, value = symptoms.experiment.wave, 0.5 * symptoms.experiment.wave.slowest
    if symptoms.travel is not None:
        value = min(value, 0.7 * symptoms.experiment.distance / symptoms.travel)
    why = f"the record waits for waves of this velocity, m/s, {rule.slowest / value:.1f} times as long"
    yield Cure("wave.slowest", float(f"{value:.2g}"), why)
    if value < symptoms.experiment.pick.slowest:
        yield Cure("pick.slowest", float(f"{0.5 * value:.2g}"), "the window of velocities ends there")


def _wider_window(symptoms: Symptoms) -> Iterator[Cure]:
    """A window that holds the velocity found."""
    rule = symptoms.experiment.pick
    velocity = symptoms.experiment.distance / symptoms.travel if symptoms.travel else rule.slowest
    why = f"if {velocity:.0f} m/s is the right one"
    if velocity >= rule.fastest:
        yield Cure("pick.fastest", _round_up(1.5 * velocity), why)
    elif velocity <= rule.slowest:
        yield Cure("pick.slowest", float(f"{0.5 * velocity:.2g}"), why)


def _read_the_peak(symptoms: Symptoms) -> Iterator[Cure]:
    """The reading that was right most often."""
    if symptoms.experiment.method != "peak":
        yield Cure("pick.method", "peak", "on signals with a known delay the peak was right most often")


def _smaller_step(symptoms: Symptoms) -> Iterator[Cure]:
    """A quarter of the step: half of it was tried by the run."""
    value = float(f"{0.25 * symptoms.experiment.wave.step_fraction:.2g}")
    yield Cure("wave.step_fraction", value, "half of the present step was tried, and did not help")


def _tolerated_breaking(symptoms: Symptoms) -> Iterator[Cure]:
    """Bonds that may break."""
    if symptoms.broken:
        most = max(0.01, 5.0 * symptoms.experiment.wave.most_broken_bonds)
        yield Cure("wave.most_broken_bonds", min(most, 1.0), "if the pulse is meant to break bonds")


def _smaller_error(symptoms: Symptoms) -> Iterator[Cure]:
    """What makes the largest part of the numerical error smaller."""
    if symptoms.error is None:
        return
    bound, parts = symptoms.error
    experiment, wave = symptoms.experiment, symptoms.experiment.wave
    part = largest_part(experiment, parts, LARGEST_BOUND)
    why = f"the bound of the error, {bound:.1%}, has to be below {LARGEST_BOUND:.0%}"
    quieter = float(f"{0.8 * wave.amplitude * LARGEST_BOUND / bound:.2g}")
    finer = Cure("wave.step_fraction", float(f"{0.5 * wave.step_fraction:.2g}"), why)
    if part == "sampling":
        yield Cure("wave.samples_per_period", 2 * wave.samples_per_period, why)
    elif part == "precision":
        yield Cure("wave.precision", "float64", why)
    elif part == "unbalanced":
        yield Cure("wave.amplitude", float(f"{1.25 * wave.amplitude * bound / LARGEST_BOUND:.2g}"), why)
    elif part == "breaking":
        yield Cure("wave.amplitude", quieter, f"{why}, and fewer bonds break")
    elif part in {"step", "chatter"}:
        yield finer
        if part == "chatter":
            yield from _less_damping(symptoms)
    else:
        if turning_error(experiment) <= LARGEST_BOUND:
            yield Cure("wave.amplitude", quieter, f"{why}, and goes with the amplitude")
        if part in {"regime", "slip"}:
            yield Cure("wave.regime", "finite", "contacts then slip, open and stiffen as they do; it takes longer")
        else:
            yield from _lower_frequency(symptoms)


_Remedy = Callable[[Symptoms], Iterator[Cure]]
_FEW_PERIODS = _higher_frequency, _wider_box, _narrower_receiver, _softer_pulse, _less_damping
_UNCLEAR = _higher_frequency, _lower_frequency, _other_receiver, _softer_pulse, _more_damping
_BY_FAILURE: dict[PickFailure | None, tuple[_Remedy, ...]] = {
    PickFailure.NOT_FINITE: (_smaller_step, _softer_pulse, _tolerated_breaking),
    PickFailure.BROAD: _FEW_PERIODS,
    PickFailure.NEAR: _FEW_PERIODS,
    PickFailure.PRECURSOR: _FEW_PERIODS,
    PickFailure.UNSURE: _UNCLEAR,
    PickFailure.TOO_SHORT: (_longer_record, _less_damping, _higher_frequency),
    PickFailure.SILENT: (_less_damping, _lower_frequency),
    PickFailure.NOISE: (_read_the_peak, _higher_frequency, _softer_pulse),
    PickFailure.DISAGREEMENT: (_read_the_peak, _higher_frequency),
    PickFailure.UNLIKE: (_read_the_peak, _lower_frequency),
    PickFailure.OUTSIDE_WINDOW: (_wider_window, _higher_frequency),
}
_BY_VERDICT: dict[PassedOver | None, tuple[_Remedy, ...]] = {
    PassedOver.NARROW: (_lower_frequency, _more_damping),
    PassedOver.FAINT: (_higher_frequency, _louder_pulse, _narrower_receiver),
    PassedOver.OUTSIDE: (_wider_window, _higher_frequency),
}
"""Kinds of cures that suit a reason, the most promising first; `NO_PEAK` has those of its highest top.

Tried on stiff cement in quartz (docs/how-to/no-velocity.md), another frequency cured most cells; another damping hardly
any, and it makes another sand.
"""
