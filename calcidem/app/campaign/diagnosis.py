"""Reasons why cells have no velocity, and values of the configuration that give one.

The cell is computed again with all trial values: a plane wave, a wide and deep receiver, a long record. The remedies
are the fewest values for which Vs agrees with this velocity or with the static speed. A section that is not stored is
computed again: the same seed and content give the same bits.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache, lru_cache
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from calcidem.app.campaign.identity import refuse_other_physics
from calcidem.app.campaign.patterns import section_of, stored_experiment
from calcidem.app.campaign.status import UNREAD
from calcidem.dem.engine.fields import written
from calcidem.dem.sample.judgement import judge_disks
from calcidem.dem.sample.settling import SettlingError
from calcidem.dem.wave.experiment import WAVELENGTHS, Experiment, suitable_frequency
from calcidem.dem.wave.measurement import LARGEST_BOUND, measure
from calcidem.dem.wave.reading import (
    LEAST_COHERENCE,
    SILENCE,
    PickRule,
    Reading,
    Verdict,
    find_candidates,
    read_section,
)
from calcidem.dem.wave.section import RESOLUTION, Section
from calcidem.dem.wave.static_speed import static_speed
from calcidem.storage.records import CellKey, CellResult, CellStatus
from calcidem.storage.sql.store import Store
from calcidem.storage.store import Selection

if TYPE_CHECKING:
    from matplotlib.figure import Figure  # takes a second to load, needed only for drawing

_Range = tuple[float, float]
_NewValues = dict[str, Any]  # value by ``section.key``

_EXPECTED = 1.25  # ratio to the static speed, to either side, within which Vs is expected
_AGREES = 1.15  # ratio to Vs with all trial values, to either side, within which both are one velocity
_OTHER_WAVE = 2.1  # ratio to the static speed beyond which Vs may be that of another wave, such as P
_AS_GOOD = 0.2  # logarithm of the ratio of two numbers of wavelengths on the path with which sections are read as well
_MOST_NAMED = 4  # values that are added because the reasons of trials name them

_WHY = {  # meaning of a remedy; other remedies are named by the reason
    "wave.slowest": "the record ended before the slowest expected wave",
    "wave.frequency": f"{WAVELENGTHS:g} wavelengths on the path: with fewer P and S wave overlap; shorter waves decay",
    "wave.receiver_half_width": "few grains at the receiver oscillated on their own",
    "wave.listening_depth": "few grains at the receiver oscillated on their own",
    "wave.transmitter_half_width": "a narrow transmitter acts as a line source",
    "wave.transmitter": "the wall transmitted too little of the pulse, or grains slipped along it",
    "wave.damping": "the amplitude decreased along the path; Vs increases with less damping",
    "pick.largest_error": "the error of the velocity is larger than allowed",
}

_NAMED = {  # words of a reason, the key that they name, and its value or a factor on it
    "the record ends": ("wave.slowest", 0.5),
    "raise amplitude": ("wave.amplitude", 10.0),
    "stronger pulse": ("wave.amplitude", 10.0),
    "r amplitude": ("wave.amplitude", 0.1),  # lower amplitude; step_fraction or amplitude
    "'finite'": ("wave.regime", "finite"),
    "'float64'": ("wave.precision", "float64"),
    "step_fraction": ("wave.step_fraction", 0.5),
    "samples_per_period": ("wave.samples_per_period", 2.0),
    "pick.method": ("pick.method", "peak"),
}


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """Reason why a cell has no velocity, and remedies."""

    key: CellKey
    status: CellStatus
    reason: str
    """The cell, its outcome, and the reason."""
    finding: str
    """Value that caused the refusal, and other measurements; first the packing if all cells of this content failed."""
    remedies: _NewValues
    vs: float | None
    """Values of the configuration that together give a velocity, and this velocity, m/s; empty and None without any."""
    experiment: Experiment
    section: Section
    reading: Reading | Verdict
    """Experiment, section and reading of the cell, or why there is none."""
    expected: tuple[float, float]
    """Slowest and fastest S wave expected from the static stiffness of the sample, m/s."""

    def describe_remedies(self) -> Iterator[str]:
        """Lines with Vs and with each value that gives it, and what this shows."""
        if self.vs is not None:
            yield f"Vs is {self.vs:.0f} m/s with"
        for name, value in self.remedies.items():
            yield f"{name} = {written(value)}".ljust(36) + _WHY.get(name, "a reason names it")

    def as_row(self) -> dict[str, Any]:
        """Row of the cell for tables."""
        said = {"status": str(self.status), "reason": self.reason, "finding": self.finding, "vs": self.vs}
        return asdict(self.key) | said | {"remedies": "; ".join(self.describe_remedies())}

    def draw(self) -> "Figure":
        """Picture of the section with the line of each candidate, and its velocity spectrum."""
        from calcidem.app.campaign.plots import draw_diagnosis  # noqa: PLC0415 - loads matplotlib

        return draw_diagnosis(self)


def diagnose(store: Store, selection: Selection) -> Iterator[Diagnosis]:
    """Explain why selected cells have no velocity, and find values that give one.

    Each cell is computed again, up to about twenty times. `UnknownCellError` if there is no such content;
    `CampaignMismatchError` for another version of the physics; `StoreError` if the campaign lacks its packing.
    """
    experiment = lru_cache(lambda index: stored_experiment(store, index))
    readable = {content for content, status in store.status_counts() if status is CellStatus.DONE}
    for cell in list(store.results(Selection(selection.seeds, selection.contents, UNREAD), with_arrays=True)):
        refuse_other_physics(store.record)
        yield _diagnose(cell, experiment(cell.packing_index), cell.key.content in readable)


def _diagnose(cell: CellResult, experiment: Experiment, others_are_read: bool) -> Diagnosis:
    """Diagnose one cell; ``others_are_read`` if its content has velocities."""
    if (stored := cell.section) is None:
        (found,) = measure(experiment, cell.key.content, [cell.key.seed])
    section = found.section if stored is None else section_of(stored)
    reading, finding = read_section(section, experiment.pick), []
    if not others_are_read:
        finding.append(f"All cells failed. Look at the packing first: {_judged_packing(experiment)}")
    if cell.status is not CellStatus.UNSTABLE:
        finding.append(_explain_refusal(experiment, section, reading, cell.error_bound))
    try:
        speed, uneven = static_speed(experiment, experiment.ordering(cell.key.seed).at(cell.key.content).bonded)
    except (ValueError, SettlingError):
        speed, expected = math.nan, (0.0, math.inf)
        finding.append("The sample has no static stiffness.")
    else:
        expected = speed / _EXPECTED * math.sqrt(1.0 - experiment.wave.damping), speed * _EXPECTED
        finding.append(
            f"By static stiffness long waves have {speed:.0f} m/s (+-{uneven:.0%}) and S waves {expected[0]:.0f} to "
            f"{expected[1]:.0f} m/s: {section.frequency * section.distance / speed:.2g} wavelengths on the path."
        )
    compared, vs, remedies = _find_remedies(experiment, cell, section, speed, expected)
    known = cell.key, cell.status, cell.reason, " ".join([*finding, compared])
    return Diagnosis(*known, remedies, vs, experiment, section, reading, expected)


def _find_remedies(
    experiment: Experiment, cell: CellResult, section: Section, speed: float, expected: _Range
) -> tuple[str, float | None, _NewValues]:
    """Compare Vs of all trial values with the static speed (m/s); return a text, Vs (m/s) and fewest values."""

    @cache
    def attempt(*values: tuple[str, Any]) -> tuple[float | None, str]:
        try:
            (found,) = measure(_experiment_with(experiment, dict(values)), cell.key.content, [cell.key.seed])
        except (ValueError, SettlingError) as error:
            return None, str(error)
        return found.vs, found.reason

    values = _named_value(experiment, {}, cell.reason) | _trial_values(experiment, section, speed)
    damped, (best, reason) = {"wave.damping": _two_digits(0.5 * experiment.wave.damping)}, attempt(*values.items())
    for _ in range(_MOST_NAMED):
        if best is not None:
            break
        values = values | (_named_value(experiment, values, reason) or damped)
        best, reason = attempt(*values.items())
    text, wanted = f"All trial values together give no velocity: {reason}.", [expected]
    if best is not None:
        ratio = f", {best / speed:.2f} times the static speed" if speed > 0.0 else ""
        text = f"All trial values together give {best:.0f} m/s{ratio}."
        if 1.0 / _OTHER_WAVE < best / speed < _OTHER_WAVE:
            wanted.append((best / _AGREES, best * _AGREES))
    if fewest := _fewest_values(attempt, values, wanted):
        return text, attempt(*fewest.items())[0], fewest
    read = ", ".join(f"{vs:.0f} m/s" for vs, _ in map(attempt, values.items()) if vs is not None)
    tried = ", ".join(f"{name} = {written(value)}" for name, value in values.items())
    return f"{text} They are {tried}. Velocities with one of them: {read or 'none'}.", None, {}


def _fewest_values(
    attempt: Callable[..., tuple[float | None, str]], values: _NewValues, wanted: list[_Range]
) -> _NewValues:
    """One value, else several without superfluous ones, with which Vs is in a wanted range, m/s; empty without any."""

    def gives(chosen: Iterable[tuple[str, Any]], ranges: list[_Range]) -> bool:
        vs, _ = attempt(*chosen)
        return vs is not None and any(low <= vs <= high for low, high in ranges)

    items = list(values.items())
    starts = [([item], ranges) for ranges in (wanted[:1], wanted) for item in items]
    starts += [(items[:number], wanted) for number in range(len(items), 1, -1)]
    fewest, last = next((dict(start) for start, ranges in starts if gives(start, ranges)), {}), _NewValues()
    while len(fewest) > 1 and fewest != last:  # a value may be superfluous only without another one
        last = fewest
        for name in reversed(last):
            fewer = {other: value for other, value in fewest.items() if other != name}
            fewest = fewer if gives(fewer.items(), wanted) else fewest
    return fewest


def _trial_values(experiment: Experiment, section: Section, speed: float) -> _NewValues:
    """Values that make more signals readable; ``speed`` is the static speed of the sample, m/s, NaN without one."""
    wave, box, waves = experiment.wave, experiment.packing, section.frequency * section.distance / speed
    trial = {
        "pick.method": "peak",
        "wave.slowest": min(wave.slowest, _two_digits(0.3 * speed)),
        "wave.receiver_half_width": max(wave.receiver_half_width, _two_digits(0.4 * box.height)),
        "wave.listening_depth": max(wave.listening_depth, _two_digits(0.2 * box.width)),
        "wave.transmitter_half_width": max(wave.transmitter_half_width, _two_digits(0.47 * box.height)),
        "wave.transmitter": "driven",
        "pick.largest_error": max(experiment.pick.largest_error, PickRule().largest_error),
    }
    trial = {name: value for name, value in trial.items() if value != attrgetter(name)(experiment)}
    return {"wave.frequency": "auto"} | trial if abs(math.log(waves / WAVELENGTHS)) > _AS_GOOD else trial


def _named_value(experiment: Experiment, values: _NewValues, reason: str) -> _NewValues:
    """Value that a reason names, preferably one not among ``values``; empty without any."""
    for words, (name, change) in sorted(_NAMED.items(), key=lambda one: one[1][0] in values):
        if words in reason and (isinstance(change, float) or name not in values):
            old = values.get(name, attrgetter(name)(experiment))
            return {name: change if isinstance(change, str) else type(old)(_two_digits(change * old))}
    return {}


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")


def _experiment_with(experiment: Experiment, values: _NewValues) -> Experiment:
    """Experiment with these values; `ValueError` if they are impossible."""
    for name, value in values.items():
        section, key = name.split(".")
        changed = {section: replace(getattr(experiment, section), **{key: value})} if key != "frequency" else {}
        experiment = replace(experiment, **(changed or {"frequencies": suitable_frequency}))
    return experiment


def _judged_packing(experiment: Experiment) -> str:
    """Description of a packing and its faults, in sentences."""
    packing, report = experiment.packing, experiment.packing.report
    text = (
        f"Porosity {report.porosity:.3f}; {report.coordination_number_without_rattlers:.2f} contacts per disk without"
    )
    text += f" rattlers; largest overlap {report.largest_overlap / np.mean(packing.radius):.2g} of the mean radius; "
    text += f"stress {max(report.wall_stress) / 1e3:.3g} kPa."
    return " ".join([text, *(f"packing.{fault.text}." for fault in judge_disks(packing, experiment.sand))])


def _explain_refusal(experiment: Experiment, section: Section, reading: Reading | Verdict, bound: float | None) -> str:
    """Return a sentence with the value that caused the refusal; ``bound`` is that of the numerical error."""
    pick, ms, candidates = experiment.pick, 1e3 * section.duration, find_candidates(section, experiment.pick.smoothing)
    if reading is Verdict.SILENT:
        largest = float(np.abs(section.across[:, -1]).max(initial=0)) * RESOLUTION
        return f"In {ms:.3g} ms the receiver reaches {largest:.2%} of v0, with no peak above {SILENCE:.1%}."
    if reading is Verdict.TOO_SHORT:
        late = min(one.decided for one in candidates if one.decided > section.duration)
        return f"A peak is decided at {1e3 * late:.3g} ms; the record ends at {ms:.3g} ms."
    if reading is Verdict.NO_LINE:
        best = max(candidates, key=lambda candidate: candidate.coherence)
        text = f"The best of {len(candidates)} peaks, {section.distance / best.travel_time:.0f} m/s, has a coherence of"
        return f"{text} {best.coherence:.3f}; {max(best.rival, LEAST_COHERENCE):.3f} is needed."
    if isinstance(reading, Reading) and reading.error > pick.largest_error:
        text = f"The standard error of the reading is {reading.error:.1%}; {pick.largest_error:.1%} is allowed"
        return f"{text} (pick.largest_error)."
    if bound is not None and bound > LARGEST_BOUND:
        return f"The bound of the numerical error is {bound:.1%}; {LARGEST_BOUND:.0%} is allowed."
    return f"The {pick.method.replace('_', ' ')} is more than a quarter of a period from the stacked arrival."
