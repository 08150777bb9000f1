"""What a top is by the way its wave has come, where stations recorded it."""

from collections.abc import Iterator

import numpy as np

from calcidem.dem.kernels.layout import Floats, Integers
from calcidem.dem.wave.on_the_way import denied_doubts
from calcidem.dem.wave.peak import APART, BLURRED, ENOUGH, FASTEST_P, MainPeak, doubts_about, largest_bump, noise_level
from calcidem.dem.wave.pick import PassedOver, PickFailure
from calcidem.dem.wave.polarisation import STEEPEST, along_over_across
from calcidem.dem.wave.prepared import PreparedSignals
from calcidem.dem.wave.ridge import Ridge, follow_ridge
from calcidem.dem.wave.tops import find_high_tops, half_width, parabola_vertex
from calcidem.dem.wave.without_p import top_without_p

_EARLY = 0.15  # of a peak on the ridge that may be there before any wave, on less than BLURRED periods ...
_EARLIEST = 0.05  # ... and on less than one
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
_P_MOTION = 1.0 / STEEPEST  # of grains along the way over that across, from which on a top is a P wave's ...
_S_MOTION = 0.5  # ... and below which it is the S wave's, whatever else came; ...
_NO_P_MOTION = 1.0  # ... below this one it is no P wave's, if no later one is so clearly the S wave's, ...
_MOTION_WITHIN = 0.15  # ... within so many periods before and behind its path, in the median of the stations ...
_MOTION_FROM = 0.25  # ... from this part of the way on, where the waves begin to part


def judge_on_ridge(record: PreparedSignals, index: int) -> MainPeak | PickFailure | PassedOver:
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
    if height < max(ENOUGH * float(view[index:].max()), _REMAINS * float(view[:index].max())):
        return PassedOver.SMALL
    ends = np.array([top for top in find_high_tops(view, record.signals.floor) if top - sent > record.earliest])
    ridge = follow_ridge(section[:horizon], places, ends, sent, record.period)
    end = int(np.flatnonzero(ends == index)[0])
    motion, away = _motion_along(record, ridge, end), np.abs(ends - index) > APART * travel
    passed_over = _weigh_paths(record, ridge, ends, end, np.flatnonzero(away), motion)
    if passed_over is not None:
        return passed_over
    trough = int(np.argmin(view[: index + 1]))
    behind_p = -float(view[trough]) > rule.precursor * height and trough > sent
    without_p = top_without_p(view, trough, index) if behind_p else time
    noise = noise_level(record, horizon, travel / FASTEST_P)
    doubts = [
        *doubts_about(record, view, index, without_p, behind_p=behind_p),
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
        precursor=largest_bump(view[: index + 1]) / height,
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
    """Motion along the way over that across it on a path, in the median of the farther stations.

    If it was not recorded it is 1, by which no wave is told from another.
    """
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


def _doubts_on_short_way(record: PreparedSignals, view: Floats, index: int, noise: float) -> Iterator[PickFailure]:
    """Tell why a main peak on the ridge may be only what another wave left of it."""
    travel, height = index - record.sent_peak, float(view[index])
    if travel >= BLURRED * record.period:
        return
    if noise > (_EARLIEST if travel < record.period else _EARLY) * height:
        yield PickFailure.BROAD
    began, ended = half_width(view, index)
    narrow = ended - began - record.period / 2.0 < _NARROW * travel
    if narrow and -float(view[: index + 1].min()) > _SWING * height:
        yield PickFailure.PRECURSOR


def least_height_on_ridge(known: Floats) -> float:
    """Height below which `judge_on_ridge` passes over every top behind the known part of a record."""
    return _REMAINS * float(known.max())
