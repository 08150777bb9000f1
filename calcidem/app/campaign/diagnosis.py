"""Why cells have no velocity: the section of each, the number that refused it, and remedies.

Nothing is written to the database. A section that is not stored is computed again: the same seed and content give the
same bits.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from calcidem.app.campaign.identity import refuse_other_physics
from calcidem.app.campaign.patterns import section_of, stored_experiment
from calcidem.app.campaign.remedies import Case, Remedy, explain_refusal, look_at_packing
from calcidem.app.campaign.status import UNREAD
from calcidem.dem.sample.settling import SettlingError
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement, measure_all
from calcidem.dem.wave.reading import LEAST_COHERENCE, find_candidates, prepare, read_section, velocity_spectrum
from calcidem.dem.wave.static_speed import static_speed
from calcidem.storage.records import CellKey, CellResult, CellStatus
from calcidem.storage.sql.store import Store
from calcidem.storage.store import ALL_CELLS, Selection
from calcidem.sweep.progress import pluralize

if TYPE_CHECKING:
    from matplotlib.figure import Figure  # takes a second, which only those wait for who draw

_SLOWED = 0.5  # least part of the static speed at which waves were found to travel (docs/velocity.md)
_SPECTRUM_POINTS = 240  # of the spectrum


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
        Remedies, the most promising first.
    case
        Section, reading and expected velocity.
    """

    key: CellKey
    status: CellStatus
    reason: str
    packing: str
    finding: str
    remedies: tuple[Remedy, ...]
    case: Case

    def draw(self) -> "Figure":
        """Picture of the section with the line of each candidate, and its velocity spectrum."""
        text = "\n".join(filter(None, (f"No velocity: {self.reason}.", self.finding)))
        return _draw_case(self.case, f"{self.key.content:g} %, seed {self.key.seed}", text)


def _draw_case(case: Case, title: str, text: str) -> "Figure":
    """Draw the section of a cell, with or without a velocity."""
    from calcidem.analysis.figures.sections import SectionPicture, draw_section  # noqa: PLC0415 - loads matplotlib

    section, smoothing, arrival = case.section, case.experiment.pick.smoothing, case.reading.arrival
    prepared = prepare(section, smoothing)
    chosen = [k for k, one in enumerate(case.candidates) if arrival is not None and one.index == arrival.index]
    best = case.candidates[chosen[0]] if chosen else case.best
    times = section.times[: len(prepared.across)]
    slowest = section.distance / max(float(times[-1]), 1.0 / section.frequency)
    velocities = np.geomspace(slowest, 0.5 * _SPECTRUM_POINTS * slowest, _SPECTRUM_POINTS)
    if case.candidates or case.expected:
        travels = [one.travel_time for one in case.candidates]
        fastest = max([section.distance / travel for travel in travels] + list(case.expected or ()))
        velocities = np.geomspace(slowest, 2.0 * fastest, _SPECTRUM_POINTS)
    picture = SectionPicture(
        title=title,
        text=text,
        times=times,
        places=np.array(section.places),
        across=prepared.across,
        clean=prepared.across if best is None else best.clean,
        p_waves=np.where(prepared.p_peak >= 0, times[prepared.p_peak], np.nan),
        transmitted_peak=0.5 / section.frequency,
        candidates=tuple((one.travel_time, one.coherence) for one in case.candidates),
        chosen=chosen[0] if chosen else None,
        velocities=velocities,
        spectrum=velocity_spectrum(section, smoothing, velocities),
        least_coherence=LEAST_COHERENCE,
        expected=case.expected,
    )
    return draw_section(picture)


def diagnose(
    store: Store,
    selection: Selection = ALL_CELLS,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Diagnosis, ...]:
    """Say of the selected cells without a velocity why they have none, and what may help.

    ``progress`` is told what is being computed. `UnknownCellError` if there is no such content; `CampaignMismatchError`
    if a cell has to be computed again, and was computed with another version of the physics; `StoreError` if the
    campaign lacks what its cells are computed from.
    """
    examiner = _Examiner(store, progress)
    cells = store.results(Selection(selection.seeds, selection.contents, UNREAD), with_arrays=True)
    return tuple(examiner.diagnose(cell) for cell in list(cells))


class _Examiner:
    """A campaign with the data that its diagnoses share."""

    def __init__(self, store: Store, progress: Callable[[str], None]) -> None:
        self.store = store
        self.progress = progress
        self.experiment = lru_cache(lambda index: stored_experiment(store, index))
        self.readable = lru_cache(
            lambda content: [
                cell.vs for cell in store.results(Selection(contents=content, statuses=CellStatus.DONE)) if cell.vs
            ]
        )

    def diagnose(self, cell: CellResult) -> Diagnosis:
        """Diagnose one cell."""
        experiment, measured = self.experiment(cell.packing_index), None
        if cell.section is not None:
            section = section_of(cell.section)
        else:
            measured = self._measure(cell, experiment)
            section = measured.record.section
        reading, pick = read_section(section, experiment.pick), experiment.pick
        problem = cell.reason if cell.status is CellStatus.UNSTABLE else ""
        error = None
        if not problem and reading.verdict is None and getattr(reading, pick.method) is not None:
            error = (measured or self._measure(cell, experiment)).result.error
        expected, source = self._expected(cell.key, experiment)
        candidates = find_candidates(section, pick.smoothing)
        case = Case(experiment, section, reading, candidates, expected, error, problem)
        number, remedies = explain_refusal(case)
        packing = ""
        if not self.readable(cell.key.content):
            packing, better = look_at_packing(experiment.packing, experiment.stiffen()[1].shear_modulus)
            remedies = (*better, *remedies)
        finding = f"{number} {_measured(case, source)}"
        return Diagnosis(cell.key, cell.status, cell.reason, packing, finding, remedies, case)

    def _measure(self, cell: CellResult, experiment: Experiment) -> Measurement:
        """Compute a cell again."""
        refuse_other_physics(self.store.record)
        self.progress(f"Computing seed {cell.key.seed} at {cell.key.content:g} % again")
        return measure_all(experiment, cell.key.content, [cell.key.seed])[0]

    def _expected(self, key: CellKey, experiment: Experiment) -> tuple[tuple[float, float] | None, str]:
        """Slowest and fastest S wave that is expected of a cell, m/s, and the source of this range."""
        known = self.readable(key.content)
        if known:
            return (min(known), max(known)), f"the {pluralize(len(known), 'readable seed')} of this content"
        try:
            speed = static_speed(experiment, experiment.ordering(key.seed).at(key.content).bonded).speed
        except (ValueError, SettlingError):
            return None, ""
        return (_SLOWED * speed, speed), f"the static stiffness of the sample ({speed:.0f} m/s for long waves)"


def _measured(case: Case, source: str) -> str:
    """Pulse, path, record and expected velocity."""
    section = case.section
    text = f"The pulse of {section.frequency:g} Hz has about {case.wavelengths:.1f} wavelengths on the path of "
    text += f"{1e3 * section.distance:.1f} mm; {1e3 * section.duration:.3g} ms were recorded."
    if case.expected is None:
        return text
    low, high = (f"{velocity:.0f}" for velocity in case.expected)
    return f"{text} Expected: {low if low == high else f'{low} to {high}'} m/s, from {source}."
