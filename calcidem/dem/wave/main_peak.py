"""The main peak of a received signal, on which every reading of a travel time leans.

Bare rules fail on real records: the largest value may be a reflection, and the first one above some level a precursor
(a P wave of the near field) or noise. This search looks no further than a horizon behind the peak it takes.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import find_peaks, peak_prominences, peak_widths

from calcidem.dem.engine.portable import smooth_cubically
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.pick import PickFailure, PickRule, Reading, Signals

_TWIN = 0.03  # of the height of a top; step and regime change signals by half of that (docs/accuracy.md)


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
        Nearest sample, and time in samples.
    height, noise
        In the unit of the received signal.
    precursor
        Largest earlier swing over the height.
    quality
        See `Picks`.
    twin
        Number of samples to its farthest twin, see `_farthest_twin`.
    end
        Number of samples on which all this, and every other reading, depends.
    """

    index: int
    time: float
    height: float
    noise: float
    precursor: float
    quality: float
    twin: int
    end: int


def prepare_signals(signals: Signals, rule: PickRule) -> PreparedSignals:
    """Take off the zero line, smooth, and measure the sent pulse."""
    sent, received = np.asarray(signals.sent, dtype=float), np.asarray(signals.received, dtype=float)
    top = int(np.argmax(sent))
    period = 2.0 * float(peak_widths(sent, [top], rel_height=0.5)[0][0])
    earliest = signals.distance / (rule.fastest * signals.sampling_interval)
    # No straight line is taken off: the short quiet part at the start cannot tell how it would go on.
    received = np.asarray(received - np.median(received[: max(1, int(earliest))]))
    smooth, reach = received, int(rule.smoothing * period / 2.0)
    # A cubic through fewer than five samples smooths nothing.
    if reach > 1 and 2 * reach < len(received) and np.isfinite(received).all():
        smooth = smooth_cubically(received, reach)
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
    )


def find_main_peak(record: PreparedSignals) -> MainPeak | PickFailure:
    """Find the first peak that nothing up to its horizon outshines.

    A peak with earlier swings as large is passed over: ripples before the pulse look like that. It spoils the
    record only if no later peak makes it small.
    """
    rule, smooth = record.rule, record.smooth
    if not np.isfinite(record.received).all():
        return PickFailure.NOT_FINITE
    peaks, found = find_peaks(smooth, height=record.signals.floor, prominence=0.0)
    # Of the whole record, and so at least as large as in the view up to the horizon.
    stands_out = found["prominences"] >= rule.prominence * found["peak_heights"]
    travel = peaks - record.sent_peak
    doubtful = 0.0
    for index in peaks[stands_out & (travel > record.earliest) & (travel < record.latest)].tolist():
        time = index + parabola_vertex(smooth, index)
        horizon = int(np.ceil(time + max((rule.horizon - 1.0) * (time - record.sent_peak), record.period)))
        if horizon + record.reach > len(smooth):
            return PickFailure.PRECURSOR if doubtful else _why_no_peak(record, cut_off=True)
        peak = _judge_peak(record, index, time, horizon)
        if peak is not None and peak.precursor >= rule.precursor:
            doubtful = max(doubtful, peak.height)
        elif peak is not None:
            return peak if doubtful < rule.significance * peak.height else PickFailure.PRECURSOR
    return PickFailure.PRECURSOR if doubtful else _why_no_peak(record, cut_off=False)


def _judge_peak(record: PreparedSignals, index: int, time: float, horizon: int) -> MainPeak | None:
    """Weigh a peak against the record up to its horizon; None if it cannot be the main one."""
    rule, view = record.rule, record.smooth[:horizon]
    height, largest = float(view[index]), float(view.max())
    noise = _noise_level(record, horizon)
    prominence = float(peak_prominences(view, [index])[0][0])
    width = float(peak_widths(view, [index], rel_height=0.5)[0][0])
    if (
        height < rule.significance * largest
        or prominence < rule.prominence * largest
        or width < rule.width * record.period / 2.0
        or height <= rule.signal_to_noise * noise
    ):
        return None
    before = view[: index + 1]
    bumps = find_peaks(before, prominence=0.0)[1]["prominences"]
    precursor = max(0.0, -float(before.min()), float(bumps.max(initial=0.0))) / height
    stands_out = min(prominence, height) / float(np.abs(view).max())
    return MainPeak(
        index=index,
        time=time,
        height=height,
        noise=noise,
        precursor=precursor,
        quality=stands_out * max(0.0, 1.0 - precursor),
        twin=_farthest_twin(view, index, (1.0 + _TWIN) * rule.prominence * largest),
        end=horizon + record.reach,
    )


def _farthest_twin(view: Floats, index: int, prominence: float) -> int:
    """Return the number of samples to the farthest top that a slightly different signal would have as its main peak.

    The lower of two tops loses its prominence to the higher one, unless the dip between them is deep enough.
    """
    height = float(view[index])
    farthest = 0
    for top in find_peaks(view, height=(1.0 - _TWIN) * height)[0].tolist():
        between = view[min(top, index) : max(top, index) + 1]
        if height - float(between.min()) < prominence:
            farthest = max(farthest, abs(top - index))
    return farthest


def _noise_level(record: PreparedSignals, horizon: int) -> float:
    """Return the larger of what was there before any wave, and of what smoothing takes away (rms)."""
    quiet = np.abs(record.smooth[: max(1, int(record.earliest))]).max()
    rough = np.std(record.received[:horizon] - record.smooth[:horizon])
    return float(max(quiet, rough))


def _why_no_peak(record: PreparedSignals, cut_off: bool) -> PickFailure:
    """Tell silence, a record that ends too early, and a record without a clear peak apart."""
    smooth, noise = record.smooth, _noise_level(record, len(record.smooth))
    if np.abs(smooth).max() <= max(record.signals.floor, record.rule.signal_to_noise * noise):
        return PickFailure.SILENT
    rising = np.argmax(smooth) >= len(smooth) - record.period
    return PickFailure.TOO_SHORT if cut_off or rising else PickFailure.NO_PEAK


def parabola_vertex(signal: Floats, index: int) -> float:
    """Return where the parabola through a peak and its neighbours is highest, in samples from the peak."""
    left, middle, right = (float(value) for value in signal[index - 1 : index + 2])
    curvature = left - 2.0 * middle + right
    return 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
