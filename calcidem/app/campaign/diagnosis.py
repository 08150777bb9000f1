"""Why cells have no velocity: the number that refused each, its section, and values that give one.

A value is a remedy only after the wave was computed with it in this sample and had a velocity that the static stiffness
lets expect. A section that is not stored is computed again: the same seed and content give the same bits.
"""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from calcidem.app.campaign.identity import refuse_other_physics
from calcidem.app.campaign.patterns import section_of, stored_experiment
from calcidem.app.campaign.status import UNREAD
from calcidem.app.config.reference import written
from calcidem.dem.sample.judgement import judge_disks
from calcidem.dem.sample.settling import SettlingError
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.first_look import WAVELENGTHS, suitable_frequency
from calcidem.dem.wave.measurement import LARGEST_BOUND, measure
from calcidem.dem.wave.reading import (
    LEAST_COHERENCE,
    SILENCE,
    PickRule,
    Reading,
    Verdict,
    find_candidates,
    read_section,
    reading_error_parts,
)
from calcidem.dem.wave.section import RESOLUTION, Section
from calcidem.dem.wave.static_speed import static_speed
from calcidem.storage.records import CellKey, CellResult, CellStatus
from calcidem.storage.sql.store import Store
from calcidem.storage.store import Selection

if TYPE_CHECKING:
    from matplotlib.figure import Figure  # takes a second, which only those wait for who draw

_NewValues = dict[str, Any]  # ``section.key`` and its value

_EXPECTED = (0.6, 1.5)  # slowest Vs over the static speed times sqrt(1 - damping), and fastest over the static speed
_SURE = 1.2  # ratio to both bounds from which on no other trial is made
_AS_GOOD = 0.2  # logarithm of the ratio of two numbers of wavelengths on the path with which sections are read as well
_FEWER = 0.1  # logarithm of a ratio of velocities that is worth one value less
_MOST_NAMED = 3  # values that are added because the reason of a trial names them

_WHY = {
    "wave.slowest": "the record ended before the slowest wave that is expected",
    "wave.frequency": f"{WAVELENGTHS:g} wavelengths on the path: with fewer P and S wave are one, shorter waves fade",
    "wave.receiver_half_width": "few grains at the receiver swung by themselves",
    "wave.listening_depth": "few grains at the receiver swung by themselves",
    "wave.transmitter_half_width": "the wave spread from few grains",
    "wave.damping": "the amplitude fell along the path; Vs rises with less damping",
    "pick.largest_error": "the velocity is known no better",
}
"""What a value shows that gives a velocity; others are named by the reason."""

_NAMED = {
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
"""Words of a reason, the key that they name, and its value or a factor on it."""


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """Why a cell has no velocity, and what gives it one."""

    key: CellKey
    status: CellStatus
    reason: str
    """The cell, its outcome, and the reason."""
    finding: str
    """The packing, if all cells of this content failed; the number that refused it, other measurements, and what was
    tried in vain, in sentences.
    """
    remedies: _NewValues
    vs: float | None
    """Values of the configuration that together give a velocity, and this, m/s; none and None without any."""
    experiment: Experiment
    section: Section
    reading: Reading
    """What it was measured with, and what was recorded and read."""
    expected: tuple[float, float]
    """Slowest and fastest S wave that the static stiffness of the sample lets expect, m/s."""

    def describe_remedies(self) -> Iterator[str]:
        """Vs, each value that gives it as a configuration has it, and what this shows."""
        if self.vs is not None:
            yield f"Vs is {self.vs:.0f} m/s with"
        for name, value in self.remedies.items():
            yield f"{name} = {written(value)}".ljust(36) + _WHY.get(name, "a reason asks for it")

    def as_row(self) -> dict[str, Any]:
        """What is said of the cell, for tables."""
        said = {"status": str(self.status), "reason": self.reason, "finding": self.finding, "vs": self.vs}
        return asdict(self.key) | said | {"remedies": "; ".join(self.describe_remedies())}

    def draw(self) -> "Figure":
        """Picture of the section with the line of each candidate, and its velocity spectrum."""
        from calcidem.app.campaign.section_picture import draw_diagnosis  # noqa: PLC0415 - loads matplotlib

        return draw_diagnosis(self)


def diagnose(store: Store, selection: Selection) -> Iterator[Diagnosis]:
    """Say of the selected cells without a velocity why they have none, and what gives them one.

    Each is computed again up to some twenty times. `UnknownCellError` if there is no such content;
    `CampaignMismatchError` for another version of the physics; `StoreError` if the campaign lacks its packing.
    """
    experiment = lru_cache(lambda index: stored_experiment(store, index))
    readable = {content for content, status in store.status_counts() if status is CellStatus.DONE}
    for cell in list(store.results(Selection(selection.seeds, selection.contents, UNREAD), with_arrays=True)):
        refuse_other_physics(store.record)
        yield _diagnose(cell, experiment(cell.packing_index), cell.key.content in readable)


def _diagnose(cell: CellResult, experiment: Experiment, others_are_read: bool) -> Diagnosis:
    """Diagnose one cell; ``others_are_read`` tells whether its content has velocities."""
    if (stored := cell.section) is None:
        (found,) = measure(experiment, cell.key.content, [cell.key.seed])
    section = found.record.section if stored is None else section_of(stored)
    reading, finding, distance = read_section(section, experiment.pick), [], section.distance
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
        expected = _EXPECTED[0] * speed * math.sqrt(1.0 - experiment.wave.damping), _EXPECTED[1] * speed
        finding.append(
            f"By static stiffness long waves have {speed:.0f} m/s (+-{uneven:.0%}) and S waves {expected[0]:.0f} to "
            f"{expected[1]:.0f} m/s: {section.frequency * distance / speed:.2g} wavelengths on the path of "
            f"{1e3 * distance:.1f} mm. {1e3 * section.duration:.3g} ms were recorded."
        )
    better = _better_values(experiment, section, reading, speed)
    trials = list(_try_values(experiment, cell, better, expected))
    good = [(vs, values) for values, vs, reason in trials if vs is not None and not reason]
    vs, remedies = min(good, key=lambda it: abs(math.log(it[0] / speed)) + _FEWER * len(it[1]), default=(None, {}))
    if vs is None:
        read = ", ".join(f"{vs:.0f}" for _, vs, _ in trials if vs is not None)
        finding.append(f"No trial of {', '.join(better)}, alone or together, gives a velocity as expected.")
        last = f"All together: {trials[-1][2]}." if trials else ""
        finding.append(f"They read {read} m/s: another path or wave." if read else last)
    known = cell.key, cell.status, cell.reason, " ".join(finding)
    return Diagnosis(*known, remedies, vs, experiment, section, reading, expected)


def _better_values(experiment: Experiment, section: Section, reading: Reading, speed: float) -> _NewValues:
    """Values that better the record; ``speed`` is the static speed of the sample, m/s, NaN if it has none."""
    wave, packing, better = experiment.wave, experiment.packing, dict[str, Any]()
    if wave.slowest > _EXPECTED[0] * speed:
        better["wave.slowest"] = float(f"{min(0.5 * wave.slowest, 0.45 * speed):.2g}")
    if abs(math.log(section.frequency * section.distance / speed / WAVELENGTHS)) > _AS_GOOD:
        better["wave.frequency"] = "auto"
    for key, largest in (
        ("receiver_half_width", 0.4 * packing.height),
        ("listening_depth", 0.28 * packing.width),
        ("transmitter_half_width", 0.47 * packing.height),
    ):
        value = float(f"{min(2.0 * getattr(wave, key), largest):.2g}")
        if value > getattr(wave, key):
            better[f"wave.{key}"] = value
    if wave.damping > 0.0:
        better["wave.damping"] = float(f"{0.5 * wave.damping:.2g}")
    if experiment.pick.largest_error < (reading.error or 0.0) < PickRule().largest_error:
        better["pick.largest_error"] = PickRule().largest_error
    return better


def _try_values(
    experiment: Experiment, cell: CellResult, better: _NewValues, expected: tuple[float, float]
) -> Iterator[tuple[_NewValues, float | None, str]]:
    """Try values alone, then together, until Vs, m/s, is surely as expected; a value that a reason names is added."""
    given, items = dict[str, Any](), list(better.items())
    together = (items[:number] for number in range(2, len(items) + 1))
    for chosen in ([], *([one] for one in items), *together):
        values, reason, vs = given | dict(chosen), cell.reason if not chosen else "", None
        for _ in range(_MOST_NAMED + 1):
            if not reason:
                try:
                    (found,) = measure(_experiment_with(experiment, values), cell.key.content, [cell.key.seed])
                    vs, reason = found.vs, found.result.reason
                except (ValueError, SettlingError) as error:
                    vs, reason = None, str(error)
                if vs is not None and not expected[0] <= vs <= expected[1]:
                    reason = "not as expected"
                yield values, vs, reason
                if vs is not None and expected[0] * _SURE <= vs <= expected[1] / _SURE:
                    return
            if not (named := [change for words, change in _NAMED.items() if words in reason]):
                break
            name, change = min(named, key=lambda one: one[0] in values)  # first those that were not tried
            section, key = name.split(".")
            old = values.get(name, getattr(getattr(experiment, section), key))
            new = change if isinstance(change, str) else type(old)(float(f"{change * old:.2g}"))
            values, reason = values | {name: new}, ""
        else:
            del values[name]  # it was in vain
        given = given if chosen else values


def _experiment_with(experiment: Experiment, values: _NewValues) -> Experiment:
    """Experiment with these values; `ValueError` where they are impossible."""
    for name, value in values.items():
        section, key = name.split(".")
        changed: _NewValues = {"frequencies": suitable_frequency}
        if key != "frequency":
            changed = {section: replace(getattr(experiment, section), **{key: value})}
        experiment = replace(experiment, **changed)
    return experiment


def _judged_packing(experiment: Experiment) -> str:
    """What a packing is like, and what is wrong with it, in sentences."""
    report, overlap = experiment.packing.report, experiment.packing.report.largest_overlap
    text = (
        f"Porosity {report.porosity:.3f}; {report.coordination_number_without_rattlers:.2f} contacts per disk without "
        f"rattlers; largest overlap {overlap / np.mean(experiment.packing.radius):.2g} of the mean radius; stress "
        f"{max(report.wall_stress) / 1e3:.3g} kPa."
    )
    return " ".join([text, *(f"packing.{fault.text}." for fault in judge_disks(experiment.packing, experiment.sand))])


def _explain_refusal(experiment: Experiment, section: Section, reading: Reading, bound: float | None) -> str:
    """Return the number that refused a cell, in a sentence; ``bound`` is that of the numerical error."""
    pick, candidates = experiment.pick, find_candidates(section, experiment.pick.smoothing)
    if reading.verdict is Verdict.SILENT:
        largest = float(section.across[:, -1].max(initial=0)) * RESOLUTION
        return f"The receiver moves at most at {largest:.2%} of the pulse's amplitude; {SILENCE:.1%} is needed."
    if reading.verdict is Verdict.TOO_SHORT:
        late = min(one.decided for one in candidates if one.decided > section.duration)
        return f"A peak is decided at {1e3 * late:.3g} ms; the record ends at {1e3 * section.duration:.3g} ms."
    if reading.verdict is Verdict.NO_LINE:
        best = max(candidates, key=lambda candidate: candidate.coherence)
        text = f"The best of {len(candidates)} peaks, {section.distance / best.travel_time:.0f} m/s, has a coherence of"
        return f"{text} {best.coherence:.2f}; {LEAST_COHERENCE:g} is needed, and no other peak may have more."
    if reading.arrival is not None and reading.error is not None and reading.error > pick.largest_error:
        parts = reading_error_parts(reading.arrival, section.frequency)
        part = max(parts._fields, key=lambda field: getattr(parts, field)).replace("_", " ")
        text = f"The standard error of the reading is {reading.error:.1%}; {pick.largest_error:.1%} is allowed"
        return f"{text} (pick.largest_error). Its largest part is '{part}'."
    if bound is not None and bound > LARGEST_BOUND:
        return f"The bound of the numerical error is {bound:.1%}; {LARGEST_BOUND:.0%} is allowed."
    return f"The {pick.method.replace('_', ' ')} is more than a quarter of a period from the stacked arrival."
