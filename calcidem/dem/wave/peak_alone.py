"""What a top can be where the receiver alone was recorded: by the speeds and signs of P and S waves."""

from itertools import chain

import numpy as np

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.peak import APART, CUTTING, ENOUGH, FASTEST_P, MainPeak, doubts_about, largest_bump, noise_level
from calcidem.dem.wave.pick import PassedOver, PickFailure
from calcidem.dem.wave.prepared import PreparedSignals
from calcidem.dem.wave.tops import find_high_tops, half_width, parabola_vertex, prominence
from calcidem.dem.wave.without_p import top_without_p

_PERIODS_FOR_NOISE = 0.5  # over the periods on the way: in fewer than two there is too little to tell noise by
_BEFORE_P = 0.75  # periods between the beginning and the top of a P wave, which widened on its way
_LATE = 0.2  # periods by which the S wave's top may come later than the fastest P wave's tells
_OUT_OF_CODA = 0.5  # of the prominence that is asked for; behind a large P wave scattered ones run into the S wave
_RINGING = 0.6  # of a top; a P wave of the same sign swings back by less before the S wave comes
_TROUGH = 1.6  # over the height of a top; what goes deeper behind it is no part of the same pulse, or ringing
_FOOT = 0.15  # of the main peak; an earlier top like that, with ringing behind it, may be the S wave
_TWIN = 0.05  # of the height of a top; step and regime change signals by a third of that (docs/accuracy.md)
_SCATTERED = 0.2  # of what comes behind the S wave at most, where a larger P wave came before it
_EARLIER = 0.5  # of the main peak; a top between a P wave and it, which it cannot be told from, is as large


def judge_alone(record: PreparedSignals, index: int) -> MainPeak | PickFailure | PassedOver:
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
    if behind_p and travel < CUTTING * record.period:  # swing and top may be one broad P wave's: the S wave is larger
        far = max(far, int(np.ceil(sent + rule.horizon * travel)))
    if height < max(ENOUGH * largest, _SCATTERED * float(smooth[:far].max())):
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
    quiet = min(travel / FASTEST_P, trough - _BEFORE_P * record.period if behind_p else np.inf)
    noise = noise_level(record, horizon, quiet)
    began, ended = half_width(view, index)
    width = (ended - began) / (record.period / 2.0)
    heard = height * min(1.0, _PERIODS_FOR_NOISE * travel / record.period)
    if width < rule.width or heard <= rule.signal_to_noise * noise:
        return PassedOver.NARROW if width < rule.width else PassedOver.FAINT
    precursor = largest_bump(view[: index + 1]) / height
    if behind_p:
        time = top_without_p(smooth[:end], trough, index)
    doubts = chain(
        [PickFailure.UNSURE] if _may_be_another(record, view, index, behind_p=behind_p, ringing=ringing) else [],
        doubts_about(record, view, index, time, behind_p=behind_p),
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


def _may_be_another(record: PreparedSignals, view: Floats, index: int, *, behind_p: bool, ringing: bool) -> bool:
    """Whether another top than the main peak may as well be the S wave's."""
    height, apart, trough = float(view[index]), APART * (index - record.sent_peak), int(np.argmin(view[: index + 1]))
    foot, swing = float(view[: trough + 1].max()), -float(view[trough])
    if foot > _FOOT * height and swing > _RINGING * foot:
        return True
    if not behind_p:  # a swing that is as deep but too long ago is no P wave that came with this peak
        before = view[:index] if ringing else view
        return swing > record.rule.precursor * height or _has_twin(before, (1.0 - _TWIN) * height, index, apart)
    # With ringing behind it the peak may be the back-swing of the P wave itself.
    return ringing or _has_twin(view[trough:index], _EARLIER * height, index - trough, apart)


def _has_twin(view: Floats, least: float, index: int, apart: float) -> bool:
    """Whether a top at least so high lies further from a sample than so many others."""
    return any(abs(top - index) > apart for top in find_high_tops(view, least))


def least_height_alone(record: PreparedSignals, known: Floats) -> float:
    """Height below which `judge_alone` passes over every top behind the known part of a record.

    Each condition is one of that; quiet part, largest value and trough only grow with the record.
    """
    travel, trough = len(known) - record.sent_peak, int(np.argmin(known))
    quiet = min(travel / FASTEST_P, trough - _BEFORE_P * record.period)
    noise = float(np.abs(known[: max(1, int(max(quiet, record.earliest)))]).max())
    return max(ENOUGH * float(known.max()), record.rule.signal_to_noise * noise)
