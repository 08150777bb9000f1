"""Why a section gave no velocity, in one number, and the values of the configuration that may give it one.

Nothing here is certain before it is tried, see `calcidem.app.campaign.remedy_trials.try_remedies`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calcidem.app.config.reference import written
from calcidem.dem.sample.judgement import ISOSTATIC, LARGEST_OVERLAP
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.error_estimate import NumericalError, cure_of, largest_part, turning_error
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import LARGEST_BOUND
from calcidem.dem.wave.reading import (
    LEAST_COHERENCE,
    P_TO_S,
    SILENCE,
    Candidate,
    Reading,
    Verdict,
    reading_error_parts,
    slowest_in_record,
)
from calcidem.dem.wave.section import RESOLUTION, Section

_CUT_OFF = 0.8  # part of the cut-off frequency up to which grains transmit a wave
_ENOUGH = 2.0  # wavelengths on the path, above which P and S wave arrive apart
_RATIO = 1.3  # from a frequency to another one to try
_WORTH_TRYING = 1.05  # ratio of two values that differ enough
_MARGIN = 0.9  # of what is allowed, that a remedy aims at
_DENSE = 0.17  # porosity of a dense random packing of disks


@dataclass(frozen=True, slots=True)
class Remedy:
    """A value of the configuration to try.

    Attributes
    ----------
    name, value
        ``section.key`` and its new value; a frequency is meant for the content of the cell.
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
        """Whether it makes another packing, and so other samples."""
        return self.name.startswith("packing.")

    def apply(self, experiment: Experiment) -> Experiment:
        """Experiment with this value; `ValueError` where it is impossible."""
        section, key = self.name.split(".")
        changed: dict[str, Any] = {key: self.value}
        if key == "frequency":
            return replace(experiment, frequencies=((0.0, 100.0), (float(self.value),) * 2))
        if section == "wave":
            return replace(experiment, wave=replace(experiment.wave, **changed))
        return replace(experiment, pick=replace(experiment.pick, **changed))


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A cell without a velocity.

    Attributes
    ----------
    experiment, section
        What it was measured with, and what was recorded.
    reading, candidates
        Result of reading the section.
    expected
        Slowest and fastest S wave that is expected, m/s; None if that is not known.
    error
        Numerical error, where that is the reason.
    problem
        Why a guard ended the run; empty if none did.
    """

    experiment: Experiment
    section: Section
    reading: Reading
    candidates: tuple[Candidate, ...]
    expected: tuple[float, float] | None
    error: NumericalError | None = None
    problem: str = ""

    @property
    def best(self) -> Candidate | None:
        """The most coherent candidate."""
        return max(self.candidates, key=lambda candidate: candidate.coherence, default=None)

    @property
    def travel_time(self) -> float:
        """That of the arrival, of the expected wave, of the best candidate, or as long as the record, s."""
        if self.reading.arrival is not None:
            return self.reading.arrival.travel_time
        if self.expected is not None:
            return self.section.distance * 2.0 / sum(self.expected)
        return self.section.duration if self.best is None else self.best.travel_time

    @property
    def wavelengths(self) -> float:
        """Wavelengths on the path."""
        return self.section.frequency * self.travel_time


def explain_refusal(case: Case) -> tuple[str, tuple[Remedy, ...]]:
    """Return the number that refused a cell, in a sentence, and what may help, the most promising first."""
    verdict, pick = case.reading.verdict, case.experiment.pick
    if case.problem:
        number, found = f"A guard ended the run: {case.problem}.", _steadier_run(case)
    elif verdict is Verdict.SILENT:
        largest = float(case.section.across[:, -1].max(initial=0)) * RESOLUTION
        number = f"The receiver moves at most at {largest:.2%} of the pulse's amplitude; {SILENCE:.1%} is needed."
        found = _louder_arrival(case)
    elif verdict is Verdict.TOO_SHORT:
        ended = case.section.duration
        late = min(candidate.decided for candidate in case.candidates if candidate.decided > ended)
        number = f"The first open peak is decided at {1e3 * late:.3g} ms; the record ends at {1e3 * ended:.3g} ms."
        found = _longer_record(case, late)
    elif verdict is Verdict.NO_LINE:
        number, found = _incoherence(case), _other_frequencies(case)
    elif verdict is Verdict.UNCERTAIN:
        number, found = _uncertainty(case)
    elif case.error is not None:
        part = largest_part(case.experiment, case.error.parts, LARGEST_BOUND)
        number = (
            f"The bound of the numerical error is {case.error.bound:.1%}; {LARGEST_BOUND:.0%} is allowed. Its largest"
        )
        number += f" part is {part} ({getattr(case.error.parts, part):.1%})."
        found = _smaller_error(case, case.error, part)
    else:
        number = f"The {pick.method.replace('_', ' ')} is more than a quarter of a period from the stacked arrival."
        found = iter([Remedy("pick.method", "peak", "the peak can be read")])
    return number, tuple(found) or tuple(_lower_frequency(case))


def look_at_packing(packing: Packing, shear_modulus: float) -> tuple[str, tuple[Remedy, ...]]:
    """Return what a packing is like, in sentences, and what makes it better if it cannot carry a wave."""
    report, radius = packing.report, float(np.mean(packing.radius))
    deep, stress = report.largest_overlap / radius, max(report.wall_stress)
    contacts = report.coordination_number_without_rattlers
    text = (
        f"Porosity {report.porosity:.3f}; {contacts:.2f} contacts per disk without rattlers; largest overlap "
        f"{deep:.2g} of the mean radius; stress {stress / 1e3:.3g} kPa, "
        f"{stress / shear_modulus:.2g} of the sand's shear modulus."
    )
    found = []
    if deep > LARGEST_OVERLAP:  # an overlap of Hertz goes with the power 2/3 of the force
        why = f"the largest overlap is above {LARGEST_OVERLAP:g} of the mean radius, where Hertz's law does not hold"
        found.append(Remedy("packing.stress", float(f"{stress * (_MARGIN * LARGEST_OVERLAP / deep) ** 1.5:.2g}"), why))
    if contacts < ISOSTATIC:
        why = f"with fewer than {ISOSTATIC:g} contacts per disk the packing hardly resists shear"
        found.append(Remedy("packing.porosity", _DENSE, why))
    return " ".join([text, *(f"{remedy}: {remedy.why}." for remedy in found)]), tuple(found)


def _round_up(value: float) -> float:
    """Two significant digits, not below the value."""
    place = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / place - 1e-9) * place:.2g}")


def _highest_frequency(case: Case) -> float:
    """Frequency that the grains transmit, Hz: a part of the cut-off of a chain of disks, ``V / (pi d)``."""
    diameter = 2.0 * float(np.mean(case.experiment.packing.radius))
    return _CUT_OFF * case.section.distance / case.travel_time / (math.pi * diameter)


def _higher_frequency(case: Case, factor: float) -> Iterator[Remedy]:
    """More wavelengths on the path; where grains do not transmit them, a longer path."""
    frequency, highest = case.section.frequency, _highest_frequency(case)
    value = min(_round_up(factor * frequency), float(f"{highest:.2g}"))
    if value >= _WORTH_TRYING * frequency:
        why = f"{case.wavelengths * value / frequency:.2g} instead of {case.wavelengths:.2g} wavelengths on the path"
        yield Remedy("wave.frequency", value, why)
    if factor * frequency > highest:
        why = f"{factor * case.wavelengths:.1f} wavelengths on the path; more is close to the grains' cut-off"
        yield Remedy("packing.width", _round_up(factor * case.experiment.packing.width), why)


def _lower_frequency(case: Case) -> Iterator[Remedy]:
    """Longer waves."""
    highest = _highest_frequency(case)
    why = "longer waves scatter less at grains and cement"
    if case.section.frequency > highest:
        why = f"the grains hardly transmit more than {highest / 1e3:.2g} kHz"
    yield Remedy("wave.frequency", float(f"{min(case.section.frequency / _RATIO, highest):.2g}"), why)


def _other_frequencies(case: Case) -> Iterator[Remedy]:
    """Above and below: higher first where few wavelengths are on the path, lower first where waves scatter."""
    few = case.wavelengths < _ENOUGH
    higher = list(_higher_frequency(case, _ENOUGH / case.wavelengths if few else _RATIO))
    lower = list(_lower_frequency(case))
    yield from (*higher, *lower) if few else (*lower, *(one for one in higher if not one.needs_packing))


def _incoherence(case: Case) -> str:
    """Why the best candidate is not on a line."""
    if case.best is None:
        return "The receiver has no peak."
    velocity = case.section.distance / case.best.travel_time
    text = (
        f"The best of {len(case.candidates)} peaks, {velocity:.0f} m/s, has a coherence of {case.best.coherence:.2f}; "
    )
    if case.best.coherence < LEAST_COHERENCE:
        return f"{text}{LEAST_COHERENCE:g} is needed."
    return f"{text}another peak has {case.best.rival:.2f}."


def _uncertainty(case: Case) -> tuple[str, Iterator[Remedy]]:
    """Which part of the reading error is the largest, and how many times higher a frequency makes it small enough."""
    arrival, allowed = case.reading.arrival, case.experiment.pick.largest_error
    if arrival is None or case.reading.error is None:
        raise ValueError("an uncertain reading has an arrival and an error")
    parts, error = reading_error_parts(arrival, case.section.frequency), case.reading.error
    name = max(parts._fields, key=lambda field: getattr(parts, field))
    words = {
        "p_left": "P wave left in",
        "near_field": "near field",
        "early": "a crest that left before the pulse",
        "tie": "another peak as coherent",
        "least": "dispersion",
    }
    number = (
        f"The standard error of the reading is {error:.1%}; {allowed:.1%} is allowed. Its largest part is "
        f"{words[name]} ({getattr(parts, name):.1%}) over {case.wavelengths:.1f} wavelengths."
    )

    def remedies() -> Iterator[Remedy]:
        factor = np.geomspace(_WORTH_TRYING, 8.0, 100)
        shape = math.sqrt(parts.p_left**2 + parts.early**2 + parts.tie**2) / factor
        enough = parts.least**2 + shape**2 + (parts.near_field / factor**2.5) ** 2 < (_MARGIN * allowed) ** 2
        yield from _higher_frequency(case, float(factor[enough.argmax()]) if enough.any() else 8.0)
        value = _round_up(error)
        if value <= 1.0:
            yield Remedy("pick.largest_error", value, f"if a standard error of {error:.1%} is acceptable")

    return number, remedies()


def _longer_record(case: Case, needed: float) -> Iterator[Remedy]:
    """A record of this length, s, or of that which the slowest expected wave needs."""
    section, slowest = case.section, case.experiment.wave.slowest
    smoothing = case.experiment.pick.smoothing
    velocities = [
        _MARGIN * slowest,
        slowest_in_record(needed / _MARGIN, section.distance, section.frequency, smoothing),
    ]
    if case.expected is not None:
        velocities.append(_MARGIN * case.expected[0])
    value = float(f"{min(velocities):.2g}")
    yield Remedy(
        "wave.slowest", value, f"the record waits for waves of this velocity, {slowest / value:.1f} times as long"
    )


def _louder_arrival(case: Case) -> Iterator[Remedy]:
    """A record in which the expected wave is, and less loss on the path."""
    if case.reading.arrival is None and case.section.duration < P_TO_S * case.travel_time:
        yield from _longer_record(case, P_TO_S * case.travel_time)
    yield from _lower_frequency(case)
    damping = case.experiment.wave.damping
    if damping > 0.0:
        before, after = (math.exp(-2.0 * factor * damping * case.wavelengths) for factor in (1.0, 0.5))
        why = f"about {after:.1%} instead of {before:.1%} of the amplitude arrives; Vs rises with it"
        yield Remedy("wave.damping", float(f"{0.5 * damping:.2g}"), why)


def _steadier_run(case: Case) -> Iterator[Remedy]:
    """A quarter of the step, since half of it was tried; a smaller pulse; more bonds that may break."""
    wave = case.experiment.wave
    yield Remedy("wave.step_fraction", float(f"{0.25 * wave.step_fraction:.2g}"), "half of the step did not help")
    yield Remedy("wave.amplitude", float(f"{0.2 * wave.amplitude:.2g}"), "fewer contacts slip, open or break")
    if "bonds broke" in case.problem and wave.most_broken_bonds < 1.0:
        value = min(max(0.01, 5.0 * wave.most_broken_bonds), 1.0)
        yield Remedy("wave.most_broken_bonds", value, "if the pulse is meant to break bonds")


def _smaller_error(case: Case, error: NumericalError, part: str) -> Iterator[Remedy]:
    """What makes the largest part of the numerical error smaller."""
    wave, why = case.experiment.wave, cure_of(case.experiment, error.parts, LARGEST_BOUND)
    quieter = float(f"{0.8 * wave.amplitude * LARGEST_BOUND / error.bound:.2g}")
    if part == "sampling":
        yield Remedy("wave.samples_per_period", 2 * wave.samples_per_period, why)
    elif part == "precision":
        yield Remedy("wave.precision", "float64", why)
    elif part == "unbalanced":
        yield Remedy("wave.amplitude", float(f"{wave.amplitude * error.bound / LARGEST_BOUND / 0.8:.2g}"), why)
    elif part in {"step", "chatter"}:
        yield Remedy("wave.step_fraction", float(f"{0.5 * wave.step_fraction:.2g}"), why)
    else:
        if part != "regime" or turning_error(case.experiment) <= LARGEST_BOUND:
            yield Remedy("wave.amplitude", quieter, why)
        if part in {"regime", "slip"}:
            yield Remedy("wave.regime", "finite", "contacts then slip, open and stiffen; the run takes longer")
        elif part == "noise":
            yield from _lower_frequency(case)
