"""Signals made ready for picking: without their zero line and the P wave's share, and smoothed."""

from dataclasses import dataclass

import numpy as np

from calcidem.dem.engine.portable import smooth_cubically
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.pick import PickFailure, PickRule, Reading, Signals
from calcidem.dem.wave.polarisation import find_p_waves
from calcidem.dem.wave.tops import half_width, parabola_vertex


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


def prepare_signals(signals: Signals, rule: PickRule) -> PreparedSignals:
    """Take off the zero line, smooth, and measure the sent pulse."""
    sent, received = np.asarray(signals.sent, dtype=float), np.asarray(signals.received, dtype=float)
    top = int(np.argmax(sent))
    began, ended = half_width(sent, top)
    period = 2.0 * (ended - began)
    earliest = signals.distance / (rule.fastest * signals.sampling_interval)
    reach = int(rule.smoothing * period / 2.0)

    section, places, along, along_known = None, None, None, True
    if signals.stations is not None:
        section, places = _smooth_all(signals.stations, reach), np.append(signals.places, 1.0)
    if section is not None and signals.along is not None:
        along, across = _smooth_all(signals.along, reach), np.column_stack([section, _smoothed(received, reach)])
        shares, known = find_p_waves(across, along, max(1, len(received) - reach), float(sent[top]), period)
        section, along_known = section - shares[:, :-1] * along[:, :-1], bool(known.all())
        received = received - shares[:, -1] * signals.along[:, -1]
    # No straight line is taken off: the short quiet part at the start cannot tell how it would go on.
    received = np.asarray(received - _median(received[: max(1, int(earliest))]))
    smooth = _smoothed(received, reach)
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


def _smooth_all(signals: Floats, reach: int) -> Floats:
    """Signals (T, X), each smoothed."""
    return np.column_stack([_smoothed(np.ascontiguousarray(one, float), reach) for one in signals.T])


def _smoothed(signal: Floats, reach: int) -> Floats:
    """Signal smoothed over so many samples before and behind each; a cubic through fewer than five smooths nothing."""
    possible = reach > 1 and 2 * reach < len(signal) and bool(np.isfinite(signal).all())
    return smooth_cubically(signal, reach) if possible else signal


def _median(values: Floats) -> float:
    """Median of some values, as NumPy's, which takes five times as long for few."""
    ordered, count = np.sort(values), len(values)
    return float((ordered[(count - 1) // 2] + ordered[count // 2]) / 2.0)
