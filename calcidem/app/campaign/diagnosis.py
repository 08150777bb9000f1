"""Why cells have no velocity, and what may give them one.

Nothing is written to the database. What a cell lacks, such as signals that were not stored, is computed again: the same
seed and content give the same bits.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from calcidem.analysis.unread_signal import SignalTop, UnreadSignal
from calcidem.app.campaign.cures import Cure, Symptoms, find_cures
from calcidem.app.campaign.identity import refuse_other_physics
from calcidem.app.campaign.patterns import stored_experiment
from calcidem.app.campaign.status import UNREAD
from calcidem.dem.sample.settling import SettlingError
from calcidem.dem.wave.arrival import read_travel_times
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.main_peak import judge_tops
from calcidem.dem.wave.measurement import measure_all, numerical_error, signals_of
from calcidem.dem.wave.peak import MainPeak
from calcidem.dem.wave.pick import PassedOver, Reading
from calcidem.dem.wave.prepared import PreparedSignals, prepare_signals
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
        if experiment.stations:
            return _stored_diagnosis(cell, record, experiment, frequency)
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
        return measure_all(experiment, cell.key.content, [cell.key.seed])[0].record

    def _expected(self, key: CellKey, experiment: Experiment) -> tuple[tuple[float, float] | None, str]:
        """Slowest and fastest S wave that is expected of a cell, m/s, and how that is known."""
        known = self.readable(key.content)
        if known:
            return (min(known), max(known)), f"the {pluralize(len(known), 'readable seed')} of this content"
        try:
            speed = static_speed(experiment, experiment.ordering(key.seed).at(key.content).bonded).speed
        except (ValueError, SettlingError):
            return None, ""
        return (_SLOWED * speed, speed), f"the stiffness of the sample at rest ({speed:.0f} m/s for long waves)"


def _stored_diagnosis(cell: CellResult, record: WaveRecord, experiment: Experiment, frequency: float) -> Diagnosis:
    """What was stored of a cell that was read with stations.

    Their signals are not stored, and the rule without them gives reasons and remedies that are not this cell's.
    """
    symptoms = Symptoms(experiment, frequency, travel=None, unstable=cell.status is CellStatus.UNSTABLE)
    note = f"It was read with {len(experiment.stations)} stations whose signals are not stored: no remedy is proposed."
    return Diagnosis(
        key=cell.key,
        status=cell.status,
        reason=cell.reason,
        finding=f"{_finding(symptoms, record, None, '')} {note}",
        cures=(),
        frequency=frequency,
        signal=_unread_signal(cell, record, prepare_signals(signals_of(record, experiment), experiment.pick), (), None),
    )


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
