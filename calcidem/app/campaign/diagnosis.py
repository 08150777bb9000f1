"""Why cells have no velocity: the number that refused each, its section, and the remedies that this supports.

The wave is followed from the transmitter along the path to the receiver. Each remedy is for a place where it is lost.
Where the numbers of a run were at fault, not its wave, the stored reason has the remedy. Nothing is written to the
database. A section that is not stored is computed again: the same seed and content give the same bits.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
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

_EXPECTED = (0.5, 1.5)  # slowest and fastest Vs over the static speed of a sample
_AS_GOOD = 1.5  # ratio of two numbers of wavelengths on the path with which sections are read as well
_CUT_OFF = 0.8  # part of the cut-off frequency up to which grains transmit a wave
_FADED = 10.0  # motion of the last station over `SILENCE`, below which the path took the wave, not the receiver


@dataclass(frozen=True, slots=True)
class Remedy:
    """A value of the configuration to try.

    Attributes
    ----------
    name, value
        ``section.key`` and its new value.
    why
        What the section shows.
    """

    name: str
    value: float | str
    why: str

    def __str__(self) -> str:
        """As a configuration has it."""
        return f"{self.name} = {written(self.value)}"

    def apply(self, experiment: Experiment) -> Experiment:
        """Experiment with this value; `ValueError` where it is impossible, or needs another packing."""
        section, key = self.name.split(".")
        if section != "wave":
            raise ValueError(f"{self.name}: it makes another packing, and so other samples")
        changed: dict[str, Any] = {key: self.value}
        if key == "frequency":
            return replace(experiment, frequencies=suitable_frequency)
        return replace(experiment, wave=replace(experiment.wave, **changed))


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """Why a cell has no velocity, and remedies.

    Attributes
    ----------
    key, status, reason
        The cell, its outcome, and the reason.
    packing
        Description of the packing, if all cells of this content failed; else empty.
    finding
        The number that refused it, and other measurements, in sentences.
    remedies
        In the order in which they are added to one another.
    experiment, section, reading
        What it was measured with, and what was recorded and read.
    expected
        Slowest and fastest S wave that the static stiffness of the sample lets expect, m/s; None if it has none.
    """

    key: CellKey
    status: CellStatus
    reason: str
    packing: str
    finding: str
    remedies: tuple[Remedy, ...]
    experiment: Experiment
    section: Section
    reading: Reading
    expected: tuple[float, float] | None

    def draw(self) -> "Figure":
        """Picture of the section with the line of each candidate, and its velocity spectrum."""
        from calcidem.app.campaign.section_picture import draw_diagnosis  # noqa: PLC0415 - loads matplotlib

        return draw_diagnosis(self)

    def try_remedies(self) -> Iterator[tuple[Remedy, float | None, str]]:
        """Add the remedies to one another until Vs is as expected; give Vs, m/s, and why it is none, or unexpected."""
        experiment, (low, high) = self.experiment, self.expected or (0.0, math.inf)
        for remedy in self.remedies:
            try:
                experiment = remedy.apply(experiment)
                (found,) = measure(experiment, self.key.content, [self.key.seed])
            except (ValueError, SettlingError) as error:
                yield remedy, None, str(error)
                return
            if found.vs is not None and low <= found.vs <= high:
                yield remedy, found.vs, ""
                return
            yield remedy, found.vs, found.result.reason or "not as expected"


def diagnose(store: Store, selection: Selection) -> tuple[Diagnosis, ...]:
    """Say of the selected cells without a velocity why they have none, and what may help.

    `UnknownCellError` if there is no such content; `CampaignMismatchError` if a cell has to be computed again, and was
    computed with another version of the physics; `StoreError` if the campaign lacks what its cells are computed from.
    """
    experiment = lru_cache(lambda index: stored_experiment(store, index))
    readable = {content for content, status in store.status_counts() if status is CellStatus.DONE}
    cells = list(store.results(Selection(selection.seeds, selection.contents, UNREAD), with_arrays=True))
    if any(cell.section is None for cell in cells):
        refuse_other_physics(store.record)
    return tuple(_diagnose(cell, experiment(cell.packing_index), cell.key.content in readable) for cell in cells)


def _diagnose(cell: CellResult, experiment: Experiment, others_are_read: bool) -> Diagnosis:
    """Diagnose one cell; ``others_are_read`` tells whether its content has velocities."""
    if cell.section is None:
        section = measure(experiment, cell.key.content, [cell.key.seed])[0].record.section
    else:
        section = section_of(cell.section)
    reading, speed, expected = read_section(section, experiment.pick), math.nan, None
    verdict, finding = reading.verdict, _explain_refusal(experiment, section, reading, cell.error_bound)
    if cell.status is CellStatus.UNSTABLE:
        verdict, finding = None, "A guard ended the run."
    try:
        speed = static_speed(experiment, experiment.ordering(cell.key.seed).at(cell.key.content).bonded).speed
    except (ValueError, SettlingError):
        finding += " The sample has no static stiffness."
    else:
        expected = _EXPECTED[0] * speed, _EXPECTED[1] * speed
        finding += (
            f" By static stiffness long waves have {speed:.0f} m/s, so that {expected[0]:.0f} to {expected[1]:.0f} m/s "
            f"are expected, and {section.frequency * section.distance / speed:.2g} wavelengths on the path of "
            f"{1e3 * section.distance:.1f} mm; {1e3 * section.duration:.3g} ms were recorded."
        )
    remedies = tuple(_find_remedies(experiment, section, verdict, speed))
    known = cell.key, cell.status, cell.reason, "" if others_are_read else _judged_packing(experiment)
    return Diagnosis(*known, finding, remedies, experiment, section, reading, expected)


def _judged_packing(experiment: Experiment) -> str:
    """What a packing is like, and what is wrong with it, in sentences."""
    report, radius = experiment.packing.report, float(np.mean(experiment.packing.radius))
    text = (
        f"Porosity {report.porosity:.3f}; {report.coordination_number_without_rattlers:.2f} contacts per disk without "
        f"rattlers; largest overlap {report.largest_overlap / radius:.2g} of the mean radius; stress "
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


def _find_remedies(experiment: Experiment, section: Section, verdict: Verdict | None, speed: float) -> Iterator[Remedy]:
    """Follow the wave to where it is lost; ``speed`` is the static speed of the sample, m/s, NaN if it has none."""
    wave, packing, silent = experiment.wave, experiment.packing, verdict is Verdict.SILENT
    motion = section.across.max(axis=0, initial=0) * RESOLUTION
    if silent and motion[0] < SILENCE:
        yield Remedy("wave.transmitter_half_width", 2.0 * wave.transmitter_half_width, "the first station is at rest")
    waves = section.frequency * section.distance / speed
    few, many = waves < WAVELENGTHS / _AS_GOOD, waves > WAVELENGTHS * _AS_GOOD and verdict is not None
    late = wave.slowest > _EXPECTED[0] * speed
    if (late and silent) or (verdict is Verdict.TOO_SHORT and (late or not few)):
        value = float(f"{min(0.5 * wave.slowest, 0.9 * _EXPECTED[0] * speed):.2g}")
        yield Remedy("wave.slowest", value, "the record ends before the slowest wave that is expected")
    # A chain of disks transmits up to V / (pi d).
    most = _CUT_OFF * section.distance / (2.0 * math.pi * float(np.mean(packing.radius)))
    if few and most < WAVELENGTHS / _AS_GOOD:
        value = float(f"{packing.width * WAVELENGTHS / most:.2g}")
        yield Remedy("packing.width", value, f"grains transmit at most {most:.1f} wavelengths on this path")
    if few or many:
        why = "P and S wave are one" if few else "grains hardly transmit these"
        yield Remedy("wave.frequency", "auto", f"{WAVELENGTHS:g} instead of {waves:.2g} wavelengths on the path: {why}")
    if silent and motion[-2] < _FADED * SILENCE and wave.damping > 0.0:
        yield Remedy("wave.damping", 0.5 * wave.damping, "the amplitude falls along the path; Vs rises with less")
    elif verdict is not None:
        for key, largest in (("listening_depth", 0.28 * packing.width), ("receiver_half_width", 0.4 * packing.height)):
            value = float(f"{min(2.0 * getattr(wave, key), largest):.2g}")
            if value > getattr(wave, key):
                yield Remedy(f"wave.{key}", value, "few grains at the receiver swing by themselves")
