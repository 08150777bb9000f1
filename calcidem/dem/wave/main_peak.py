"""The main peak of a received signal, on which every reading of a travel time leans.

Bare rules fail on real records: the largest value may be a reflection, and the first one above some level a precursor
(a P wave of the near field) or noise. This search takes the first peak that nothing exceeds up to a horizon behind it,
and looks no further. Its bounds were set on synthetic signals with a known delay (docs/reading.md).
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import find_peaks, peak_prominences, peak_widths

from calcidem.dem.engine.portable import smooth_cubically
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.pick import PickFailure, PickRule, Reading, Signals

_FASTEST_P = 2.2  # speed over that of the S wave; before such a wave there is nothing but noise
_PERIODS_FOR_NOISE = 0.5  # over the periods on the way: in fewer than two there is too little to tell noise by
_BEHIND_P = 0.5  # of the largest value; the first peak as high as this behind a P wave of opposite sign is the S wave
_TROUGH = 1.6  # over the height of a peak; what goes deeper behind it is no part of the same pulse
_TWIN = 0.05  # of the height of a top; step and regime change signals by a third of that (docs/accuracy.md)
_APART = 0.05  # of the travel time; tops that are nearer to each other do not make a velocity wrong
_BLUR = 0.14  # of the travel time that half the additional width of a peak may be ...
_BLURRED = 1.4  # ... in records with fewer periods on the way
_SWING_REACH = 0.8  # periods between a swing and the peak that it runs into, or ...
_BROAD_REACH = 0.65  # ... of the width of a broader peak, where it is more ...
_RUNNING_INTO = 2.1  # ... in records with fewer periods on the way


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
    """Find the first peak that nothing up to its horizon exceeds, by more than twice if a deep swing came before it.

    A deep swing of opposite sign is the P wave; what follows it is the S wave, and what is larger still a reflection.
    """
    rule, smooth = record.rule, record.smooth
    if not np.isfinite(record.received).all():
        return PickFailure.NOT_FINITE
    peaks, found = find_peaks(smooth, height=record.signals.floor, prominence=0.0)
    # Of the whole record, and so at least as large as in the view up to the horizon.
    stands_out = found["prominences"] >= rule.prominence * found["peak_heights"]
    travel = peaks - record.sent_peak
    for index in peaks[stands_out & (travel > record.earliest) & (travel < record.latest)].tolist():
        time = index + parabola_vertex(smooth, index)
        horizon = int(np.ceil(time + max((rule.horizon - 1.0) * (time - record.sent_peak), record.period)))
        if horizon + record.reach > len(smooth):
            return _why_no_peak(record, cut_off=True)
        peak = _judge_peak(record, index, time, horizon)
        if peak is not None:
            return peak
    return _why_no_peak(record, cut_off=False)


def _judge_peak(record: PreparedSignals, index: int, time: float, horizon: int) -> MainPeak | None:
    """Weigh a peak against the record up to its horizon; None if it cannot be the main one."""
    rule, view, periods = record.rule, record.smooth[:horizon], (time - record.sent_peak) / record.period
    height = float(view[index])
    trough = int(np.argmin(view[: index + 1]))
    behind_p = -float(view[trough]) > rule.precursor * height
    if height < float(view.max()) * (_BEHIND_P if behind_p else 1.0) or -float(view[index:].min()) > _TROUGH * height:
        return None
    noise = _noise_level(record, horizon, periods * record.period / _FASTEST_P)
    prominence = float(peak_prominences(view, [index])[0][0])
    width = float(peak_widths(view, [index], rel_height=0.5)[0][0]) / (record.period / 2.0)
    if (
        prominence < rule.prominence * height
        or width < rule.width
        or height * min(1.0, _PERIODS_FOR_NOISE * periods) <= rule.signal_to_noise * noise
    ):
        return None
    precursor = float(find_peaks(view[: index + 1], prominence=0.0)[1]["prominences"].max(initial=0.0)) / height
    doubt = None
    if _has_twin(view[:index] if behind_p else view, height, index, _APART * periods * record.period):
        doubt = PickFailure.UNSURE
    elif periods < _BLURRED and 0.5 * (width - 1.0) > _BLUR * periods:
        doubt = PickFailure.BROAD
    elif (
        behind_p
        and periods < _RUNNING_INTO
        and index - trough < max(_SWING_REACH, _BROAD_REACH * width) * record.period
    ):
        doubt = PickFailure.PRECURSOR
    return MainPeak(
        index=index,
        time=time,
        height=height,
        noise=noise,
        precursor=precursor,
        quality=min(prominence, height) / float(np.abs(view).max()) * max(0.0, 1.0 - precursor),
        doubt=doubt,
        end=horizon + record.reach,
    )


def _has_twin(view: Floats, height: float, index: int, apart: float) -> bool:
    """Whether a slightly different signal would have its largest value elsewhere, further away than so many samples."""
    tops = find_peaks(view, height=(1.0 - _TWIN) * height)[0]
    return bool(np.any(np.abs(tops - index) > apart))


def _noise_level(record: PreparedSignals, horizon: int, quiet: float) -> float:
    """Return the larger of what was there in the first samples, and of what smoothing takes away (rms)."""
    swing = np.abs(record.smooth[: max(1, int(max(quiet, record.earliest)))]).max()
    rough = np.std(record.received[:horizon] - record.smooth[:horizon])
    return float(max(swing, rough))


def _why_no_peak(record: PreparedSignals, cut_off: bool) -> PickFailure:
    """Tell silence, a record that ends too early, and a record without a clear peak apart."""
    smooth = record.smooth
    noise = _noise_level(record, len(smooth), (int(np.argmax(smooth)) - record.sent_peak) / _FASTEST_P)
    if np.abs(smooth).max() <= max(record.signals.floor, record.rule.signal_to_noise * noise):
        return PickFailure.SILENT
    rising = np.argmax(smooth) >= len(smooth) - record.period
    return PickFailure.TOO_SHORT if cut_off or rising else PickFailure.NO_PEAK


def parabola_vertex(signal: Floats, index: int) -> float:
    """Return where the parabola through a peak and its neighbours is highest, in samples from the peak."""
    left, middle, right = (float(value) for value in signal[index - 1 : index + 2])
    curvature = left - 2.0 * middle + right
    return 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
