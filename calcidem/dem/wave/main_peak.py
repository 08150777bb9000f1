"""The main peak of a received signal, on which every reading of a travel time leans.

Bare rules fail on real records: the largest value may be a reflection or ringing, and the first one above some level a
precursor (a P wave of the near field) or noise. This search asks of each top in turn what it can be by the speeds and
signs of P and S waves, and looks no further than it has to. Its bounds were set on synthetic signals with a known delay
(docs/reading.md).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from calcidem.dem.engine.portable import smooth_cubically
from calcidem.dem.kernels.layout import Floats, Integers
from calcidem.dem.wave.on_the_way import denied_doubts
from calcidem.dem.wave.pick import PassedOver, PickFailure, PickRule, Reading, Signals
from calcidem.dem.wave.polarisation import along_over_across, find_p_waves
from calcidem.dem.wave.ridge import Ridge, follow_ridge
from calcidem.dem.wave.tops import find_tops, half_height, half_width, prominence

_FASTEST_P = 2.2  # speed over that of the S wave; before such a wave there is nothing but noise
_PERIODS_FOR_NOISE = 0.5  # over the periods on the way: in fewer than two there is too little to tell noise by
_BEFORE_P = 0.75  # periods between the beginning and the top of a P wave, which widened on its way
_LATE = 0.2  # periods by which the S wave's top may come later than the fastest P wave's tells
_ENOUGH = 0.5  # of the largest value; behind a P wave of opposite sign, or before ringing, the first such top is read
_OUT_OF_CODA = 0.5  # of the prominence that is asked for; behind a large P wave scattered ones run into the S wave
_RINGING = 0.6  # of a top; a P wave of the same sign swings back by less before the S wave comes
_TROUGH = 1.6  # over the height of a top; what goes deeper behind it is no part of the same pulse, or ringing
_FOOT = 0.15  # of the main peak; an earlier top like that, with ringing behind it, may be the S wave
_TWIN = 0.05  # of the height of a top; step and regime change signals by a third of that (docs/accuracy.md)
_SCATTERED = 0.2  # of what comes behind the S wave at most, where a larger P wave came before it
_EARLIER = 0.5  # of the main peak; a top between a P wave and it, which it cannot be told from, is as large
_APART = 0.05  # of the travel time; tops that are nearer to each other do not make a velocity wrong
_BLUR = 0.14  # of the travel time that the additional width of a peak may be ...
_BLUR_BEFORE = 0.06  # ... and that of its rising half alone ...
_BLURRED = 1.4  # ... in records with fewer periods on the way
_FEWEST_PERIODS = 0.75  # on the way; with fewer, a faster wave need not begin much earlier
_SHIFT = 0.05  # of the travel time by which a P wave of opposite sign may have moved the peak
_LEAN = 0.05  # periods by which a peak may be steeper before its top, or a P wave has cut it ...
_CUTTING = 1.6  # ... in records with fewer periods on the way
_CUTTING_ON_RIDGE = 1.85  # the same where stations tell which top it is, and nothing else is asked of it
_EARLY = 0.15  # of a peak on the ridge that may be there before any wave, on less than _BLURRED periods ...
_EARLIEST = 0.05  # ... and on less than one
_BLUR_ON_RIDGE = 0.22  # as _BLUR, where stations tell which top it is: it may be one wave that took several ways
_LEAN_ON_RIDGE = 0.15  # periods by which a broad peak on the ridge is longer before its top, if it is one wave
_SWING = 0.3  # of it that may come before it with the other sign ...
_NARROW = 0.07  # ... where it is not wider than the sent one by this part of its travel time
_REMAINS = 0.1  # of an earlier value; a later top that is lower is what is left of a wave that has gone
_LATER_ON_RIDGE = 1.5  # periods behind a top in which the stations look for a wave on a slower way
_LEAST_SCORE = 0.5  # of the path that leads to the main peak, see `ridge`
_LEAST_LEAD = 0.02  # of that score over that of the path to any other top ...
_LEAD_OVER_HIGHER = 0.15  # ... over one that is higher and comes later by the next factor, since the first may be P ...
_P_AHEAD = 1.3  # ... times the travel time ...
_LEAD_OVER_HIGH = 0.1  # ... and over one that is at least the next part as high, and as late; ...
_HIGH = 0.75  # ... it may lag by the larger lead ...
_TOGETHER = 0.1  # periods within which two paths are one; where they are still one ...
_ONE_WAY = 0.5  # ... behind this part of the way, the later top has come from the first one's wave
_LOW = 0.6  # ... behind one that comes later and is lower than this part of it: that is what was scattered
_P_MOTION = 1.75  # of grains along the way over that across, from which on a top is a P wave's ...
_S_MOTION = 0.5  # ... and below which it is the S wave's, whatever else came; ...
_NO_P_MOTION = 1.0  # ... below this one it is no P wave's, if no later one is so clearly the S wave's, ...
_MOTION_WITHIN = 0.15  # ... within so many periods before and behind its path, in the median of the stations ...
_MOTION_FROM = 0.25  # ... from this part of the way on, where the waves begin to part

PERIODS_ASKED = {PickFailure.BROAD: _BLURRED, PickFailure.NEAR: _BLURRED, PickFailure.PRECURSOR: _CUTTING}
"""Periods of the pulse on the way from which on these reasons do not occur, or mostly not."""


@dataclass(frozen=True, slots=True, eq=False)
class PreparedSignals:
    """Signals made ready for picking; times are counted in samples and may lie between two.

    Attributes
    ----------
    signals, rule
        Where they come from, and how they are to be picked.
    sent
        (S,) as given.
    received
        (T,) without its zero line.
    smooth
        (T,) the same smoothed (Savitzky and Golay 1964, doi:10.1021/ac60214a047).
    sent_top, sent_peak
        Sample and time of the sent peak.
    period
        Duration of the sent pulse: twice its width at half height.
    earliest, latest
        Travel times at the ends of the rule's window.
    reach
        Number of later samples on which a smoothed one depends.
    section, places
        (T, X + 1) smoothed signals of the stations and of the receiver, and (X + 1,) their places as parts of the
        distance; None without stations.
    along
        (T, X + 1) smoothed motion along the way, None without. What it tells to be P wave is taken off all others.
    along_known
        Whether what was taken off stays the same in a longer record.
    """

    signals: Signals
    rule: PickRule
    sent: Floats
    received: Floats
    smooth: Floats
    sent_top: int
    sent_peak: float
    period: float
    earliest: float
    latest: float
    reach: int
    section: Floats | None = None
    places: Floats | None = None
    along: Floats | None = None
    along_known: bool = True

    def reading(self, samples: float, quality: float) -> Reading:
        """Turn a travel time in samples into a reading."""
        if not self.earliest <= samples <= self.latest:
            return Reading(failure=PickFailure.OUTSIDE_WINDOW)
        travel_time = float(samples * self.signals.sampling_interval)
        return Reading(travel_time, self.signals.distance / travel_time, quality)


@dataclass(frozen=True, slots=True)
class MainPeak:
    """Main peak of a record.

    Attributes
    ----------
    index, time
        Its sample, and its time in samples; behind a P wave of opposite sign that of the peak without that wave.
    height, noise
        In the unit of the received signal.
    precursor
        Largest earlier bump of the same sign over the height.
    quality
        See `Picks`.
    doubt
        Why its time cannot be trusted; None if it can.
    end
        Number of samples on which all this, and every other reading, depends.
    """

    index: int
    time: float
    height: float
    noise: float
    precursor: float
    quality: float
    doubt: PickFailure | None
    end: int


def prepare_signals(signals: Signals, rule: PickRule) -> PreparedSignals:
    """Take off the zero line, smooth, and measure the sent pulse."""
    sent, received = np.asarray(signals.sent, dtype=float), np.asarray(signals.received, dtype=float)
    top = int(np.argmax(sent))
    began, ended = half_width(sent, top)
    period = 2.0 * (ended - began)
    earliest = signals.distance / (rule.fastest * signals.sampling_interval)
    reach = int(rule.smoothing * period / 2.0)

    def smoothed(signal: Floats) -> Floats:
        # A cubic through fewer than five samples smooths nothing.
        possible = reach > 1 and 2 * reach < len(signal) and bool(np.isfinite(signal).all())
        return smooth_cubically(signal, reach) if possible else signal

    def all_smoothed(station_signals: Floats) -> Floats:
        return np.column_stack([smoothed(np.ascontiguousarray(one, float)) for one in station_signals.T])

    section, places, along, along_known = None, None, None, True
    if signals.stations is not None:
        section, places = all_smoothed(signals.stations), np.append(signals.places, 1.0)
    if section is not None and signals.along is not None:
        along, across = all_smoothed(signals.along), np.column_stack([section, smoothed(received)])
        shares, known = find_p_waves(across, along, max(1, len(received) - reach), float(sent[top]), period)
        section, along_known = section - shares[:, :-1] * along[:, :-1], bool(known.all())
        received = received - shares[:, -1] * signals.along[:, -1]
    # No straight line is taken off: the short quiet part at the start cannot tell how it would go on.
    received = np.asarray(received - _median(received[: max(1, int(earliest))]))
    smooth = smoothed(received)
    if section is not None:
        section = np.column_stack([section, smooth])
    return PreparedSignals(
        signals=signals,
        rule=rule,
        sent=sent,
        received=received,
        smooth=smooth,
        sent_top=top,
        sent_peak=top + parabola_vertex(sent, top),
        period=period,
        earliest=earliest,
        latest=signals.distance / (rule.slowest * signals.sampling_interval),
        reach=reach,
        section=section,
        places=places,
        along=along,
        along_known=along_known,
    )


def _median(values: Floats) -> float:
    """Median of some values, as NumPy's, which takes five times as long for few."""
    ordered, count = np.sort(values), len(values)
    return float((ordered[(count - 1) // 2] + ordered[count // 2]) / 2.0)


def find_main_peak(record: PreparedSignals) -> MainPeak | PickFailure:
    """Find the first top that can be the S wave's, looking no further than its horizon."""
    found = settled_peak(record)
    if found is None or found is PickFailure.TOO_SHORT:
        return _why_no_peak(record, cut_off=found is not None)
    return found


def settled_peak(record: PreparedSignals) -> MainPeak | PickFailure | None:
    """Main peak, or why there is none however the record goes on; None if nothing is there yet.

    `PickFailure.TOO_SHORT` if only a longer record could tell.
    """
    if not np.isfinite(record.received).all():
        return PickFailure.NOT_FINITE
    for _, verdict in judge_tops(record):
        if verdict is PassedOver.TIED:  # what comes later unties nothing
            return PickFailure.LOST
        if not isinstance(verdict, PassedOver):
            return verdict
    return None


def judge_tops(record: PreparedSignals) -> Iterator[tuple[int, MainPeak | PickFailure | PassedOver]]:
    """Sample of each top of a finite record that is above its floor, from left to right, and what the top is.

    The main peak, the reason why it is passed over, or `PickFailure.TOO_SHORT` if only a longer record could tell.
    """
    for index in _find_high_tops(record.smooth, record.signals.floor):
        possible = record.earliest < index - record.sent_peak < record.latest
        judge = _judge_peak if record.section is None else _judge_on_ridge
        yield index, judge(record, index) if possible else PassedOver.OUTSIDE


def least_later_height(record: PreparedSignals) -> float:
    """Height above zero below which a top behind a finite record, which holds the whole pulse, is passed over.

    Each condition is one of `_judge_peak` or `_judge_on_ridge`; quiet part, largest value and trough only grow with the
    record.
    """
    offset = abs(float(record.signals.received[0] - record.received[0]))
    known = record.smooth[: max(1, len(record.smooth) - record.reach)]
    if record.section is not None:
        return max(record.signals.floor, _REMAINS * float(known.max())) - offset
    travel, trough = len(known) - record.sent_peak, int(np.argmin(known))
    quiet = min(travel / _FASTEST_P, trough - _BEFORE_P * record.period)
    noise = float(np.abs(known[: max(1, int(max(quiet, record.earliest)))]).max())
    height = max(record.signals.floor, _ENOUGH * float(known.max()), record.rule.signal_to_noise * noise)
    return height - offset


def _judge_peak(record: PreparedSignals, index: int) -> MainPeak | PickFailure | PassedOver:
    """Weigh a top against the record up to its horizon."""
    rule, smooth, sent = record.rule, record.smooth, record.sent_peak
    time, height = index + parabola_vertex(smooth, index), float(smooth[index])
    travel = time - sent
    trough = int(np.argmin(smooth[: index + 1]))
    s_wave = rule.horizon * (trough - sent)  # latest travel time if the trough is a P wave
    behind_p = -float(smooth[trough]) > rule.precursor * height and travel <= s_wave + _LATE * record.period
    until = (
        max(s_wave, travel + 0.5 * record.period) if behind_p else max(rule.horizon * travel, travel + record.period)
    )
    horizon = int(np.ceil(sent + until))
    low = index + int(np.argmin(smooth[index:horizon]))
    ringing = -float(smooth[low]) > _TROUGH * height
    if ringing:  # or a P wave whose foot the top is: look until the S wave has come
        horizon = int(np.ceil(sent + rule.horizon * (low - sent)))
    view = smooth[:horizon]
    largest, prominent = float(view.max()), prominence(view, index)
    far = horizon
    if behind_p and travel < _CUTTING * record.period:  # swing and top may be one broad P wave's: the S wave is larger
        far = max(far, int(np.ceil(sent + rule.horizon * travel)))
    if height < max(_ENOUGH * largest, _SCATTERED * float(smooth[:far].max())):
        return PassedOver.SMALL  # which a longer record cannot change
    least = rule.prominence * height * (_OUT_OF_CODA if behind_p else 1.0)
    end = max(far, int(np.ceil(time + record.period)))
    cut_off = end + record.reach > len(smooth)
    if prominent < least and not (cut_off and _may_stand_out(view, index, least)):
        return PassedOver.NOT_PROMINENT
    if cut_off:
        return PickFailure.TOO_SHORT
    if not ringing and float(view[index:].max()) > height:
        larger = index + int(np.argmax(view[index:] > height))
        ringing = -float(view[index:larger].min()) > _RINGING * height
    if height < largest and not (behind_p or ringing):
        return PassedOver.LARGER_FOLLOWS
    quiet = min(travel / _FASTEST_P, trough - _BEFORE_P * record.period if behind_p else np.inf)
    noise = _noise_level(record, horizon, quiet)
    began, ended = half_width(view, index)
    width = (ended - began) / (record.period / 2.0)
    heard = height * min(1.0, _PERIODS_FOR_NOISE * travel / record.period)
    if width < rule.width or heard <= rule.signal_to_noise * noise:
        return PassedOver.NARROW if width < rule.width else PassedOver.FAINT
    before = view[: index + 1]
    precursor = max((prominence(before, top) for top in find_tops(before).tolist()), default=0.0) / height
    if behind_p:
        time = _top_without_p(smooth[:end], trough, index)
    doubts = chain(
        [PickFailure.UNSURE] if _may_be_another(record, view, index, behind_p=behind_p, ringing=ringing) else [],
        _doubts(record, view, index, time, behind_p=behind_p),
    )
    return MainPeak(
        index=index,
        time=time,
        height=height,
        noise=noise,
        precursor=precursor,
        quality=min(prominent, height) / largest * max(0.0, 1.0 - precursor),
        doubt=next(doubts, None),
        end=end + record.reach,
    )


def _may_stand_out(view: Floats, index: int, least: float) -> bool:
    """Whether a top has the prominence ``least`` if what follows the view goes deep enough."""
    ending = np.append(view[: index + 1], -np.inf)
    return float(view[index:].max()) <= view[index] and prominence(ending, index) >= least


def _judge_on_ridge(record: PreparedSignals, index: int) -> MainPeak | PickFailure | PassedOver:
    """Weigh a top by what the stations saw on the way, against all tops up to its horizon."""
    rule, smooth, sent, section, places = record.rule, record.smooth, record.sent_peak, record.section, record.places
    assert section is not None  # noqa: S101 - for the type checker
    assert places is not None  # noqa: S101 - for the type checker
    time, height = index + parabola_vertex(smooth, index), float(smooth[index])
    travel = time - sent
    horizon = int(np.ceil(sent + max(rule.horizon * travel, travel + _LATER_ON_RIDGE * record.period)))
    if horizon + record.reach > len(smooth):
        return PickFailure.TOO_SHORT
    view = smooth[:horizon]
    # The higher top may lie behind the horizon, where no path leads to it.
    if height < max(_ENOUGH * float(view[index:].max()), _REMAINS * float(view[:index].max())):
        return PassedOver.SMALL
    ends = np.array([top for top in _find_high_tops(view, record.signals.floor) if top - sent > record.earliest])
    ridge = follow_ridge(section[:horizon], places, ends, sent, record.period)
    end = int(np.flatnonzero(ends == index)[0])
    motion, away = _motion_along(record, ridge, end), np.abs(ends - index) > _APART * travel
    passed_over = _weigh_paths(record, ridge, ends, end, np.flatnonzero(away), motion)
    if passed_over is not None:
        return passed_over
    trough = int(np.argmin(view[: index + 1]))
    behind_p = -float(view[trough]) > rule.precursor * height and trough > sent
    without_p = _top_without_p(view, trough, index) if behind_p else time
    before, noise = view[: index + 1], _noise_level(record, horizon, travel / _FASTEST_P)
    doubts = [
        *_doubts(record, view, index, without_p, behind_p=behind_p),
        *_doubts_on_short_way(record, view, index, noise),
    ]
    if doubts:
        denied = denied_doubts(section[:horizon], places, ridge.path_to(end), sent, record.period)
        if motion < _NO_P_MOTION:  # whatever made its shape, it was no P wave
            denied |= {PickFailure.BROAD, PickFailure.PRECURSOR}
        doubts = [doubt for doubt in doubts if doubt not in denied]
    return MainPeak(
        index=index,
        time=time,
        height=height,
        noise=noise,
        precursor=max((prominence(before, top) for top in find_tops(before).tolist()), default=0.0) / height,
        quality=float(ridge.scores[end]),
        doubt=next(iter(doubts), None),
        end=horizon + record.reach,
    )


def _weigh_paths(
    record: PreparedSignals, ridge: Ridge, ends: Integers, end: int, others: Integers, motion: float
) -> PassedOver | None:
    """Why the path to a top, of this motion along, is not the S wave's, weighed against others; None if it is."""
    scores, score = ridge.scores, float(ridge.scores[end])
    if score >= _LEAST_SCORE and motion > _P_MOTION:
        return PassedOver.P_WAVE
    ahead = scores + _leads(record, ridge, ends, end)
    if score >= max(_LEAST_SCORE, float(ahead[others].max(initial=-1.0))):
        return None
    if score < max(_LEAST_SCORE, float(scores[others].max(initial=-1.0)) - _LEAST_LEAD):
        return PassedOver.OFF_RIDGE
    if motion < _S_MOTION:  # of S waves on several ways the first is read
        return None
    later = others[(scores[others] >= score - _LEAST_LEAD) & (ends[others] > ends[end])]
    if any(_motion_along(record, ridge, other) < _S_MOTION for other in later.tolist()):
        return PassedOver.P_WAVE
    return None if motion < _NO_P_MOTION else PassedOver.TIED


def _motion_along(record: PreparedSignals, ridge: Ridge, end: int) -> float:
    """Motion along the way over that across it on a path, in the median of the farther stations; 1 if not recorded."""
    if record.section is None or record.along is None:
        return 1.0
    reach = int(_MOTION_WITHIN * record.period)
    shares = along_over_across(record.section, record.along, ridge.path_to(end), reach)
    return float(np.median(shares[ridge.places >= _MOTION_FROM]))


def _leads(record: PreparedSignals, ridge: Ridge, ends: Integers, end: int) -> Floats:
    """(E,) lead in score that one top must have over each other, by which is the higher and which comes first."""
    index = int(ends[end])
    heights, travel = record.smooth[ends] / record.smooth[index], ends - record.sent_peak
    p_first = travel > _P_AHEAD * (index - record.sent_peak)
    kinds = [p_first & (heights > 1.0), p_first & (heights > _HIGH), (ends > index) & (heights < _LOW)]
    leads = np.select(kinds, [_LEAD_OVER_HIGHER, _LEAD_OVER_HIGH, -_LEAD_OVER_HIGHER], _LEAST_LEAD)
    ahead = ridge.scores + leads > ridge.scores[end]
    for other in np.flatnonzero(ahead & (leads > _LEAST_LEAD)).tolist():
        apart = np.abs(ridge.path_to(other) - ridge.path_to(end))
        if (apart[ridge.places >= _ONE_WAY] < _TOGETHER * record.period).any():
            leads[other] = _LEAST_LEAD
    return leads


def _doubts(record: PreparedSignals, view: Floats, index: int, time: float, *, behind_p: bool) -> Iterator[PickFailure]:
    """Tell why the time of a main peak, or without its P wave, would be chance."""
    travel, alone = index - record.sent_peak, record.section is None
    lean = _lean(view, index) / record.period
    # On the ridge a peak that is longer before its top is one S wave that took several ways, and not cut by another.
    if travel < _BLURRED * record.period and _is_broad(record, view, index) and (alone or lean > -_LEAN_ON_RIDGE):
        yield PickFailure.BROAD
    cut = travel < (_CUTTING if alone else _CUTTING_ON_RIDGE) * record.period and lean > _LEAN
    if behind_p and (cut or index - time > _SHIFT * travel):
        yield PickFailure.PRECURSOR
    if travel < record.rule.fewest_periods * record.period:
        yield PickFailure.NEAR


def _doubts_on_short_way(record: PreparedSignals, view: Floats, index: int, noise: float) -> Iterator[PickFailure]:
    """Tell why a main peak on the ridge may be only what another wave left of it."""
    travel, height = index - record.sent_peak, float(view[index])
    if travel >= _BLURRED * record.period:
        return
    if noise > (_EARLIEST if travel < record.period else _EARLY) * height:
        yield PickFailure.BROAD
    began, ended = half_width(view, index)
    narrow = ended - began - record.period / 2.0 < _NARROW * travel
    if narrow and -float(view[: index + 1].min()) > _SWING * height:
        yield PickFailure.PRECURSOR


def _may_be_another(record: PreparedSignals, view: Floats, index: int, *, behind_p: bool, ringing: bool) -> bool:
    """Whether another top than the main peak may as well be the S wave's."""
    height, apart, trough = float(view[index]), _APART * (index - record.sent_peak), int(np.argmin(view[: index + 1]))
    foot, swing = float(view[: trough + 1].max()), -float(view[trough])
    if foot > _FOOT * height and swing > _RINGING * foot:
        return True
    if not behind_p:  # a swing that is as deep but too long ago is no P wave that came with this peak
        before = view[:index] if ringing else view
        return swing > record.rule.precursor * height or _has_twin(before, (1.0 - _TWIN) * height, index, apart)
    # With ringing behind it the peak may be the back-swing of the P wave itself.
    return ringing or _has_twin(view[trough:index], _EARLIER * height, index - trough, apart)


def _lean(view: Floats, index: int) -> int:
    """Samples by which a peak is longer behind its top than before it, at half its height."""
    before, behind = half_height(view, index)
    return behind - before - 1


def _is_broad(record: PreparedSignals, view: Floats, index: int) -> bool:
    """Whether a faster wave may be part of a peak: it began too early, and not only ended late."""
    began, ended = half_width(view, index)
    travel = index - record.sent_peak
    before = index - began - record.period / 4.0
    blur = _BLUR if record.section is None else _BLUR_ON_RIDGE
    wide = ended - began - record.period / 2.0 > blur * travel
    return wide and (before > _BLUR_BEFORE * travel or travel < _FEWEST_PERIODS * record.period)


def _top_without_p(view: Floats, trough: int, index: int) -> float:
    """Time of the peak once the P wave before it is taken off.

    What leads a P wave is free of the S wave, and what trails an S wave free of the P wave. With pulses that are the
    same before and after their tops, each is its free half and the mirror image of that, taken off the record in turn.
    """
    trailing: Floats = np.zeros(len(view))
    for _ in range(2):
        rest = view - trailing
        trough = int(np.argmin(rest[: index + 1]))
        alone = view + _mirrored(-rest, trough)
        # From the top that was: a large P wave that is not symmetric leaves larger ones near its own.
        index = _nearest_top(alone, trough, index)
        trailing = _mirrored(alone[::-1], len(view) - 1 - index)[::-1]
    return index + (parabola_vertex(alone, index) if 0 < index < len(alone) - 1 else 0.0)


def _nearest_top(view: Floats, begin: int, index: int) -> int:
    """Sample of the top that is reached from one sample by climbing, to the next one or back to ``begin`` at most."""
    if view[index + 1] > view[index]:
        return index + 1
    rising = np.flatnonzero(np.diff(view[begin : index + 1]) > 0.0)
    return begin + (int(rising[-1]) + 1 if len(rising) else 0)


def _mirrored(signal: Floats, top: int) -> Floats:
    """Pulse that is the lobe of a signal before a top, and its mirror image behind it."""
    reach = min(top, len(signal) - 1 - top)
    below = np.flatnonzero(signal[top - reach : top] <= 0.0)
    begin = top - reach + (int(below[-1]) + 1 if len(below) else 0)
    pulse, lobe = np.zeros(len(signal)), signal[begin : top + 1]
    pulse[begin : top + 1] = lobe
    pulse[top : 2 * top - begin + 1] = lobe[::-1]
    return pulse


def _has_twin(view: Floats, least: float, index: int, apart: float) -> bool:
    """Whether a top at least so high lies further from a sample than so many others."""
    return any(abs(top - index) > apart for top in _find_high_tops(view, least))


def _find_high_tops(view: Floats, least: float) -> list[int]:
    """Samples of the tops that are at least so high."""
    tops = find_tops(view)
    return [int(top) for top in tops[view[tops] >= least]]


def _noise_level(record: PreparedSignals, horizon: int, quiet: float) -> float:
    """Return the larger of what was there in the first samples, and of what smoothing takes away (rms)."""
    swing = np.abs(record.smooth[: max(1, int(max(quiet, record.earliest)))]).max()
    rough = np.std(record.received[:horizon] - record.smooth[:horizon])
    return float(max(swing, rough))


def _why_no_peak(record: PreparedSignals, cut_off: bool) -> PickFailure:
    """Tell silence, a record that ends too early, and a record without a clear peak apart."""
    smooth, least = record.smooth, record.signals.floor
    if record.section is None:
        noise = _noise_level(record, len(smooth), (int(np.argmax(smooth)) - record.sent_peak) / _FASTEST_P)
        least = max(least, record.rule.signal_to_noise * noise)
    if np.abs(smooth).max() <= least:
        return PickFailure.SILENT
    if cut_off or np.argmax(smooth) >= len(smooth) - record.period:
        return PickFailure.TOO_SHORT
    passed_over = () if record.section is None else {why for _, why in judge_tops(record)}
    followed = {PassedOver.OFF_RIDGE, PassedOver.P_WAVE} & set(passed_over)
    return PickFailure.LOST if followed else PickFailure.NO_PEAK


def parabola_vertex(signal: Floats, index: int) -> float:
    """Return where the parabola through a peak and its neighbours is highest, in samples from the peak."""
    left, middle, right = (float(value) for value in signal[index - 1 : index + 2])
    curvature = left - 2.0 * middle + right
    return 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
