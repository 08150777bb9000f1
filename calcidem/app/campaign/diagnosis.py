"""Why cells have no velocity, what may give them one, and whether it does when it is tried.

Nothing is written to the database. What a cell lacks, such as signals that were not stored, is computed again: the same
seed and content give the same bits.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from calcidem.analysis.unread_signal import SignalTop, UnreadSignal
from calcidem.app.campaign.cures import Cure, Symptoms, find_cures
from calcidem.app.campaign.identity import refuse_other_physics
from calcidem.app.campaign.patterns import stored_experiment
from calcidem.app.campaign.status import UNREAD
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.settling import SettlingError
from calcidem.dem.wave.arrival import read_travel_times
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.main_peak import MainPeak, PreparedSignals, judge_tops, prepare_signals
from calcidem.dem.wave.measurement import measure_all, numerical_error, signals_of
from calcidem.dem.wave.pick import PassedOver, Reading
from calcidem.dem.wave.recorder import WaveRecord
from calcidem.dem.wave.static_speed import static_speed
from calcidem.storage.campaign import StoredCampaign
from calcidem.storage.records import CellKey, CellResult, CellStatus
from calcidem.sweep.progress import pluralize

if TYPE_CHECKING:
    from matplotlib.figure import Figure  # takes a second, which only those wait for who draw

_MOST_TOPS = 8
"""Tops that are explained, the highest of a record."""

_LEAST_FASTER = 1.3
"""P waves are at least so many times as fast as S waves, see `calcidem.dem.wave.pick.PickRule`."""

_SLOWED = 0.5
"""Least part of the static speed at which waves were found to travel (docs/velocity.md)."""

_RIVAL, _RIVALS = 0.95, "about as high as the main peak before it"
"""Height of a later top over that of the main peak from which on it is shown, and what is said of it."""

_LEAST_MOVED, _SAME_VS = 0.02, 0.1
"""Relative changes: of the neighbours' mean Vs that is too much for a cure, and of a cell's Vs from cure to cure."""

_BATCH = 8
"""Cells that are tried side by side: those without velocity, and readable ones for comparison."""


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """Why a cell has no velocity, and what may give it one.

    Attributes
    ----------
    key, status, reason
        Which cell, its outcome, and why.
    finding
        What was measured of it, in sentences.
    cures
        What may help, the most promising first.
    frequency
        It was measured with, Hz.
    signal
        What arrived, and why its tops were not read.
    """

    key: CellKey
    status: CellStatus
    reason: str
    finding: str
    cures: tuple[Cure, ...]
    frequency: float
    signal: UnreadSignal

    def draw(self) -> "Figure":
        """Picture of the signal with its windows and the tops that were looked at."""
        from calcidem.analysis.figures.unread_signal import draw_unread_signal  # noqa: PLC0415 - loads matplotlib

        return draw_unread_signal(self.signal)


@dataclass(frozen=True, slots=True)
class CureTrial:
    """What a cure gave on cells of one content.

    Attributes
    ----------
    content
        Percent.
    cure
        What was set.
    velocities
        Vs by seed of the cells that had none, m/s; None where they still have none.
    neighbours
        Vs by seed of readable cells before and with the cure, m/s; None where it is not readable any more.
    refusal
        Why it cannot be set, and then nothing was computed; empty otherwise.
    """

    content: float
    cure: Cure
    velocities: Mapping[int, float | None]
    neighbours: Mapping[int, tuple[float, float | None]]
    refusal: str = ""

    @property
    def cured(self) -> int:
        """How many cells have a velocity now."""
        return sum(vs is not None for vs in self.velocities.values())

    @property
    def change(self) -> float:
        """Mean relative change of Vs of the neighbours that are still readable; NaN without any."""
        ratios = [after / before for before, after in self.neighbours.values() if after is not None]
        return float(np.mean(ratios)) - 1.0 if ratios else math.nan

    @property
    def lost(self) -> int:
        """How many neighbours are not readable any more."""
        return sum(after is None for _, after in self.neighbours.values())

    @property
    def verdict(self) -> "Verdict":
        """What came of it."""
        if self.refusal:
            return Verdict.REFUSED
        if self.lost >= self.cured:
            return Verdict.LOSES if self.cured else Verdict.FAILED
        if abs(self.change) > _LEAST_MOVED:
            return Verdict.MOVES
        if math.isnan(self.change):
            return Verdict.UNCHECKED
        return Verdict.WORKS if self.cured == len(self.velocities) and not self.lost else Verdict.HELPS


class Verdict(StrEnum):
    """What came of a cure that was tried, the best first."""

    WORKS = "works"
    HELPS = "helps some"
    UNCHECKED = "no neighbour to compare"
    MOVES = "moves other Vs"
    LOSES = "loses as many"
    FAILED = "failed"
    REFUSED = "refused"


def rank_trials(trials: Iterable[CureTrial]) -> list[CureTrial]:
    """Trials content by content, those that work best first."""
    order = list(Verdict)

    def badness(trial: CureTrial) -> tuple[float, int, int, float]:
        change = 0.0 if math.isnan(trial.change) else abs(trial.change)
        return trial.content, order.index(trial.verdict), trial.lost - trial.cured, change

    return sorted(trials, key=badness)


def contradicted_cells(trials: Iterable[CureTrial]) -> set[tuple[float, int]]:
    """Content and seed of cells to which cures give velocities that differ by more than a tenth.

    What a cure does to the neighbours is taken off before.
    """
    given: defaultdict[tuple[float, int], list[float]] = defaultdict(list)
    for trial in trials:
        scale = 1.0 if math.isnan(trial.change) else 1.0 + trial.change
        for seed, vs in trial.velocities.items():
            if vs is not None:
                given[trial.content, seed].append(vs / scale)
    return {cell for cell, found in given.items() if max(found) > (1.0 + _SAME_VS) * min(found)}


def diagnose(
    campaign: StoredCampaign,
    *,
    seed: int | Collection[int] | None = None,
    content: float | Collection[float] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Diagnosis, ...]:
    """Say of cells without a velocity why they have none, and what may help.

    Parameters
    ----------
    campaign
        An open campaign.
    seed, content
        Only these cells; content in percent.
    progress
        Told what is being computed.

    Raises
    ------
    UnknownCellError
        If there is no such content.
    CampaignMismatchError
        If a cell has to be computed again, and was computed with another version of the physics.
    StoreError
        If the campaign lacks what its cells are computed from.
    """
    if content is not None:
        campaign.refuse_unknown_contents(content if isinstance(content, Collection) else (content,))
    cells = list(campaign.select(seed=seed, content=content, status=UNREAD, with_arrays=True))
    examiner = _Examiner(campaign, progress)
    return tuple(examiner.diagnose(cell) for cell in cells)


class _Examiner:
    """A campaign with what its diagnoses share."""

    def __init__(self, campaign: StoredCampaign, progress: Callable[[str], None]) -> None:
        self.campaign = campaign
        self.progress = progress
        self.experiment = lru_cache(lambda index: stored_experiment(campaign, index))
        self.readable = lru_cache(
            lambda content: [cell.vs for cell in campaign.select(content=content, status=CellStatus.DONE) if cell.vs]
        )

    def diagnose(self, cell: CellResult) -> Diagnosis:
        """Diagnose one cell."""
        experiment = self.experiment(cell.packing_index)
        record = _stored_record(cell) or self._record(cell)
        frequency = cell.frequency or experiment.frequency(cell.key.content)
        expected, source = self._expected(cell.key, experiment)
        prepared = prepare_signals(signals_of(record, experiment), experiment.pick)
        tops = _judged_tops(prepared)
        travel = _travel_time(prepared, tops, expected)
        symptoms = Symptoms(experiment, frequency, travel=travel, unstable=cell.status is CellStatus.UNSTABLE)
        if not symptoms.unstable:
            symptoms = self._symptoms_of_reading(cell, symptoms, prepared, tops)
        else:
            symptoms = replace(symptoms, broken="bonds broke" in cell.reason)
        return Diagnosis(
            key=cell.key,
            status=cell.status,
            reason=cell.reason,
            finding=_finding(symptoms, record, expected, source),
            cures=find_cures(symptoms),
            frequency=frequency,
            signal=_unread_signal(cell, record, prepared, tops, expected),
        )

    def _symptoms_of_reading(
        self, cell: CellResult, symptoms: Symptoms, prepared: PreparedSignals, tops: Sequence[tuple[int, object]]
    ) -> Symptoms:
        """Why the record gave no velocity: its reading failed, is of low quality, or its numbers are not trusted."""
        experiment, frequency = symptoms.experiment, symptoms.frequency
        picks = read_travel_times(prepared.signals, experiment.pick)
        reading: Reading = getattr(picks, experiment.method)
        if reading.failure is not None or reading.travel_time is None:
            passed = [(prepared.smooth[index], verdict) for index, verdict in tops if isinstance(verdict, PassedOver)]
            verdict = max(passed, key=lambda top: float(top[0]))[1] if passed else None
            return replace(symptoms, failure=reading.failure, verdict=verdict)
        if reading.quality < experiment.least_quality:
            return symptoms
        full = self._record(cell)  # what is stored of it does not tell its errors
        given = full, signals_of(full, experiment), picks, reading.travel_time
        _, bound, parts = numerical_error(experiment, frequency, *given)
        return replace(symptoms, error=(bound, parts))

    def _record(self, cell: CellResult) -> WaveRecord:
        """Compute a cell again."""
        refuse_other_physics(self.campaign.record)
        self.progress(f"Computing seed {cell.key.seed} at {cell.key.content:g} % again")
        experiment = self.experiment(cell.packing_index)
        return measure_all(experiment, cell.key.content, [cell.key.seed], lanes=_BATCH)[0].record

    def _expected(self, key: CellKey, experiment: Experiment) -> tuple[tuple[float, float] | None, str]:
        """Slowest and fastest S wave that is expected of a cell, m/s, and how that is known."""
        known = self.readable(key.content)
        if known:
            return (min(known), max(known)), f"the {pluralize(len(known), 'readable seed')} of this content"
        try:
            speed = static_speed(experiment, experiment.ordering(key.seed).at(key.content).bonded)
        except (ValueError, SettlingError):
            return None, ""
        return (_SLOWED * speed, speed), f"the stiffness of the sample at rest ({speed:.0f} m/s for long waves)"


def _stored_record(cell: CellResult) -> WaveRecord | None:
    """Record of a cell as far as it is stored; None without signals."""
    signal, step = cell.signal, cell.time_step
    if signal is None or step is None:
        return None
    return WaveRecord(
        time_step=step,
        stride=round(signal.sampling_interval / step),
        sent=signal.sent_velocity,
        force=signal.received_force,
        velocity=signal.received_velocity,
        stability_limit=cell.stability_limit or math.nan,
        steps=cell.steps or 0,
    )


def _judged_tops(prepared: PreparedSignals) -> list[tuple[int, object]]:
    """Tops that were looked at, up to the main peak, and what rivals that."""
    if not np.isfinite(prepared.received).all():
        return []
    found: list[tuple[int, object]] = []
    judged = judge_tops(prepared)
    for index, verdict in judged:
        found.append((index, verdict))
        if isinstance(verdict, MainPeak):
            least, end = _RIVAL * verdict.height, verdict.end
            found += [(later, _RIVALS) for later, _ in judged if later < end and prepared.smooth[later] > least]
        elif not isinstance(verdict, PassedOver):
            break
    return found


def _travel_time(
    prepared: PreparedSignals, tops: Sequence[tuple[int, object]], expected: tuple[float, float] | None
) -> float | None:
    """Travel time of the doubted peak, else that of the expected wave, else that of the highest top, s."""
    interval = prepared.signals.sampling_interval
    for index, verdict in tops:
        if isinstance(verdict, MainPeak):
            return (index - prepared.sent_peak) * interval
    if expected is not None:
        return prepared.signals.distance / (0.5 * (expected[0] + expected[1]))
    later = [index for index, _ in tops if index > prepared.sent_peak]
    if not later:
        return None
    return (max(later, key=lambda index: float(prepared.smooth[index])) - prepared.sent_peak) * interval


def _finding(symptoms: Symptoms, record: WaveRecord, expected: tuple[float, float] | None, source: str) -> str:
    """What was measured, in sentences."""
    distance, travel = symptoms.experiment.distance, symptoms.travel
    parts = [f"Sent {symptoms.frequency:g} Hz over {1e3 * distance:.1f} mm, recorded {1e3 * record.duration:.3g} ms."]
    if symptoms.periods is not None and travel is not None:
        parts.append(f"About {symptoms.periods:.1f} periods of the pulse are on the way.")
    if expected is not None:
        span = f"{expected[0]:.0f}" if expected[0] == expected[1] else f"{expected[0]:.0f} to {expected[1]:.0f}"
        parts.append(f"Expected are {span} m/s, by {source}.")
    return " ".join(parts)


def _unread_signal(
    cell: CellResult,
    record: WaveRecord,
    prepared: PreparedSignals,
    tops: Sequence[tuple[int, object]],
    expected: tuple[float, float] | None,
) -> UnreadSignal:
    """What the picture shows."""
    interval, start, distance = record.sampling_interval, record.start_time, prepared.signals.distance
    highest = sorted(tops, key=lambda top: -float(prepared.smooth[top[0]]))[:_MOST_TOPS]
    shown = []
    for index, verdict in sorted(highest, key=lambda top: top[0]):
        main = isinstance(verdict, MainPeak)
        words = "the main peak, whose time cannot be trusted" if main else str(verdict)
        travel = (index - prepared.sent_peak) * interval
        velocity = distance / travel if travel > 0.0 else math.inf
        shown.append(SignalTop(start + index * interval, float(prepared.smooth[index]), velocity, words, main))
    return UnreadSignal(
        title=f"{cell.key.content:g} %, seed {cell.key.seed}",
        reason=cell.reason,
        time=np.asarray(record.times, dtype=np.float64),
        sent=np.asarray(record.sent, dtype=np.float64),
        received=np.asarray(prepared.received, dtype=np.float64),
        smooth=np.asarray(prepared.smooth, dtype=np.float64),
        sent_peak=start + prepared.sent_peak * interval,
        distance=distance,
        possible=(prepared.rule.slowest, prepared.rule.fastest),
        expected=expected,
        faster=(_LEAST_FASTER, prepared.rule.horizon),
        tops=tuple(shown),
    )


def try_cures(
    campaign: StoredCampaign,
    diagnoses: Sequence[Diagnosis],
    count: int,
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[CureTrial]:
    """Compute cells without a velocity again with each of their cures, beside readable ones of the same content.

    Parameters
    ----------
    campaign
        An open campaign; nothing is written to it.
    diagnoses
        Of its cells, from `diagnose`.
    count
        How many of these cells, spread over the contents. Of the values of a key that the cells of a content ask for,
        the most extreme are tried on all.
    progress
        Told what is being computed.

    Yields
    ------
    CureTrial
        Content by content, for each cure that needs no other packing.

    Raises
    ------
    CampaignMismatchError
        If the campaign was computed with another version of the physics.
    """
    refuse_other_physics(campaign.record)
    experiment = stored_experiment(campaign)
    ordering = lru_cache(experiment.ordering)
    for content, chosen in sorted(_spread_over_contents(diagnoses, count).items()):
        seeds = [diagnosis.key.seed for diagnosis in chosen]
        readable = campaign.select(content=content, status=CellStatus.DONE)
        known = {cell.key.seed: cell.vs for cell in readable if cell.vs is not None and cell.packing_index == 0}
        near = sorted(known, key=lambda seed: min(abs(seed - other) for other in seeds))
        near = near[: max(1, _BATCH - len(seeds))]
        of_content = [diagnosis for diagnosis in diagnoses if diagnosis.key.content == content]
        for cure in _strongest_cures(of_content, experiment):
            progress(f"Trying {cure} at {content:g} %")
            try:
                found = measure_all(cure.apply(experiment), content, [*seeds, *near], lanes=_BATCH, ordering=ordering)
            except (ValueError, SettlingError) as error:
                yield CureTrial(content, cure, {}, {}, str(error))
                continue
            vs = {measured.seed: measured.vs for measured in found}
            after = {seed: (known[seed], vs[seed]) for seed in near}
            yield CureTrial(content, cure, {seed: vs[seed] for seed in seeds}, after)


def _spread_over_contents(diagnoses: Sequence[Diagnosis], count: int) -> dict[float, list[Diagnosis]]:
    """So many cells of the first packing, one of each content in turn."""
    waiting: defaultdict[float, list[Diagnosis]] = defaultdict(list)
    for diagnosis in diagnoses:
        waiting[diagnosis.key.content].append(diagnosis)
    ranked = sorted((place, content) for content, cells in waiting.items() for place in range(len(cells)))
    chosen: defaultdict[float, list[Diagnosis]] = defaultdict(list)
    for place, content in ranked[:count]:
        chosen[content].append(waiting[content][place])
    return dict(chosen)


def _strongest_cures(diagnoses: Sequence[Diagnosis], experiment: Experiment) -> list[Cure]:
    """Cures of cells of one content that can be tried; of several values of a key the highest and the lowest."""
    found: dict[tuple[str, bool], Cure] = {}
    for diagnosis in diagnoses:
        for cure in diagnosis.cures:
            if cure.needs_packing:
                continue
            key = cure.name.split(".")[1]
            present = getattr(experiment.wave, key, getattr(experiment.pick, key, diagnosis.frequency))
            rises = not isinstance(cure.value, str) and cure.value > present
            other = found.setdefault((cure.name, rises), cure)
            if not isinstance(cure.value, str) and not isinstance(other.value, str):
                found[cure.name, rises] = (max if rises else min)(other, cure, key=lambda one: float(one.value))
    return list(found.values())


def frequency_table(
    campaign: StoredCampaign, diagnoses: Sequence[Diagnosis], trials: Sequence[CureTrial] = ()
) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Contents (percent) and frequencies (Hz) of a campaign, with the highest that is the first cure of a cell.

    Where cures were tried it is the frequency that was best, if it helps. None where no other frequency is left.
    """
    present = Configuration.from_physics(campaign.config).excitation.table.at
    wanted: defaultdict[float, list[float]] = defaultdict(list)
    tried = {trial.content for trial in trials}
    for diagnosis in diagnoses:
        if diagnosis.key.content not in tried and diagnosis.cures[0].name == "wave.frequency":
            wanted[diagnosis.key.content].append(float(diagnosis.cures[0].value))
    for trial in rank_trials(trials):
        if trial.cure.name == "wave.frequency" and trial.verdict in {Verdict.WORKS, Verdict.HELPS}:
            wanted[trial.content] = wanted[trial.content] or [float(trial.cure.value)]
    contents = campaign.record.contents
    return (contents, tuple(max(wanted.get(at) or [present(at)]) for at in contents)) if wanted else None
