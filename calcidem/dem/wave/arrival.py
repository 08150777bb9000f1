"""Reading the travel time of a pulse from what was sent and what was received.

Three methods (paper, section 3.1.1): from peak to peak, by first arrival, and by cross-correlation. All lean
on one search for the main peak, because bare rules fail on real records: the largest value may be a
reflection, and the first one above some level a precursor (a P wave of the near field) or noise. The search
looks no further than a horizon behind the peak it takes, so a simulation that stops when `arrived` says so
gives the same readings, to the last bit, as one that goes on.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt
from scipy.signal import correlate, find_peaks, peak_prominences, peak_widths, savgol_filter

Floats = npt.NDArray[np.float64]

PULSE_FLOOR = 1e-6  # of the sent peak; less is taken for rest
PULSE_START = 1e-2  # of the sent peak; a record that starts or ends higher has missed a part of the pulse
TWIN = 0.03  # of the height of a top; step and regime change signals by half of that (docs/accuracy.md)
APART = 0.05  # of the travel time; tops that are nearer to each other do not make a velocity wrong


class PickFailure(StrEnum):
    """Why a travel time cannot be trusted, in words for the user."""

    NOT_FINITE = "the received signal has values that are not finite"
    SILENT = "nothing above the noise was received"
    TOO_SHORT = "the record ends before the main peak is certain: record for longer"
    NO_PEAK = "no peak stands out of the received signal"
    PRECURSOR = "an earlier swing is nearly as large as the main peak"
    UNSURE = "two tops are of nearly the same height, either may be the peak: use the cross-correlation"
    NOISE = "noise hides the first arrival"
    OUTSIDE_WINDOW = "the velocity is outside the window of possible ones"
    UNLIKE = "the received signal does not resemble the sent pulse"


@dataclass(frozen=True, slots=True)
class PickRule:
    """What counts as an arrival.

    Attributes
    ----------
    slowest, fastest
        Window of possible velocities, m/s. What is recorded before the fastest wave is there tells the zero
        line and the noise, so it pays not to set the latter higher than needed.
    significance
        Smallest height of the main peak, relative to the largest value up to the horizon.
    prominence
        Smallest prominence of the main peak, relative to the same.
    width
        Smallest width of the main peak at half its prominence, relative to the sent pulse's: grains widen a
        pulse, and what is much narrower is noise.
    precursor
        Earlier swings of this size, relative to the main peak, make it doubtful.
    horizon
        How far the record is judged, as a multiple of the travel time of a peak, but at least one period
        behind it. P waves are 1.4 to 1.5 times as fast as S waves in packings with k_s / k_n of 1 to 0.86, so
        a P wave is not taken for the S wave that is still to come.
    onset
        Level of the first arrival, relative to the peak.
    signal_to_noise
        Smallest ratio of the main peak to the noise.
    correlation
        Smallest normalised correlation that is still a resemblance.
    smoothing
        Width of the cubic smoothing (Savitzky-Golay, without delay) before peaks are searched for, as a part
        of the sent period.
    """

    slowest: float = 20.0
    fastest: float = 5000.0
    significance: float = 0.5
    prominence: float = 0.5
    width: float = 0.4
    precursor: float = 0.8
    horizon: float = 1.5
    onset: float = 0.1
    signal_to_noise: float = 3.0
    correlation: float = 0.5
    smoothing: float = 0.25

    def __post_init__(self) -> None:
        """Refuse rules that pick nothing or anything."""
        if not 0.0 < self.slowest < self.fastest < np.inf:
            raise ValueError(f"slowest = {self.slowest}, fastest = {self.fastest} m/s: give 0 < slowest < fastest")
        for name in ("significance", "prominence", "width", "precursor", "correlation", "smoothing"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"{name} = {getattr(self, name)}: give a part in (0, 1]")
        if not PULSE_START <= self.onset < 1.0:
            raise ValueError(f"onset = {self.onset}: give a part of the peak in [{PULSE_START:g}, 1)")
        for name in ("horizon", "signal_to_noise"):
            if not 1.0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} = {getattr(self, name)}: give a finite number of 1 or more")


DEFAULT_RULE = PickRule()


@dataclass(frozen=True, slots=True)
class Reading:
    """Travel time by one method, or why there is none.

    Attributes
    ----------
    travel_time
        s; None if it cannot be trusted.
    velocity
        Distance over travel time, m/s; None with it.
    quality
        From 0 (no pick) to 1 (beyond doubt); what it measures depends on the method, see `Picks`.
    failure
        None for a trusted pick.
    """

    travel_time: float | None = None
    velocity: float | None = None
    quality: float = 0.0
    failure: PickFailure | None = None


@dataclass(frozen=True, slots=True)
class Picks:
    """Travel time by three methods.

    Attributes
    ----------
    peak
        From the peak sent to the main peak received, unless a slightly different signal would have another one.
        Quality: how far that peak stands out (its prominence, not counting what lies below zero, over the largest
        absolute value up to the horizon), times how little came before (one less the largest earlier swing over
        the peak).
    first_arrival
        From the sent to the received signal's last rise through the onset level before their peaks. Using
        the same level on both takes out the delay that a level has. Quality: how little came before.
    cross_correlation
        Lag of the largest correlation of both signals. Quality: the correlation coefficient there, between
        the sent pulse and the part of the record under it.
    """

    peak: Reading
    first_arrival: Reading
    cross_correlation: Reading


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """What was sent and what was received.

    Attributes
    ----------
    time_step
        Time between two samples, s. A hundred samples in a period are plenty: picks lie between samples.
    sent
        (S,) velocity of the transmitter, m/s: one positive pulse, from rest to rest.
    received
        (T,) signal of the receiver from the same time on, of any length and in any unit, positive where it
        follows the sent pulse.
    distance
        Between transmitter and receiver, m.
    floor
        Peaks up to this value count as silence, in the unit of ``received``. Give what the receiver does
        without a pulse, or about a thousandth of what is sent: a ripple long before the pulse looks like an
        arrival until the pulse is there, and a simulation also passes on what no instrument would see.
    """

    time_step: float
    sent: Floats
    received: Floats
    distance: float
    floor: float

    def __post_init__(self) -> None:
        """Refuse signals that do not match or hold no pulse."""
        if not (self.time_step > 0.0 and self.distance > 0.0 and self.floor >= 0.0):
            raise ValueError(
                f"time_step = {self.time_step} s, distance = {self.distance} m, floor = {self.floor}: "
                "give a positive step and distance, and a floor of 0 or more"
            )
        if np.ndim(self.received) != 1 or np.size(self.received) == 0:
            raise ValueError(f"received {np.shape(self.received)}: give a one-dimensional array of samples")
        if np.ndim(self.sent) != 1 or np.size(self.sent) == 0:
            raise ValueError(f"sent {np.shape(self.sent)}: give a one-dimensional array of samples")
        if not max(self.sent[0], self.sent[-1]) < PULSE_START * np.max(self.sent):
            raise ValueError("sent: give one whole positive pulse, which starts and ends at rest")


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """Signals made ready for picking; times are counted in samples and may lie between two.

    ``received`` is without its zero line; ``smooth`` is the same smoothed, so that a value depends on ``reach``
    later ones. ``sent_top`` is the sample and ``sent_peak`` the time of the sent peak, ``period`` the duration
    of the sent pulse: twice its width at half height. ``earliest`` and ``latest`` are the window's travel times.
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
        travel_time = float(samples * self.signals.time_step)
        return Reading(travel_time, self.signals.distance / travel_time, quality)


@dataclass(frozen=True, slots=True)
class MainPeak:
    """Main peak of a record: nearest sample, time in samples, height, noise, earlier swings over it, quality.

    ``twin`` is how far its farthest twin is away, in samples. ``end`` is the number of samples on which all this, and
    every other reading, depends.
    """

    index: int
    time: float
    height: float
    noise: float
    precursor: float
    quality: float
    twin: int
    end: int


def read_arrival(signals: Signals, rule: PickRule = DEFAULT_RULE) -> Picks:
    """Read the travel time of a pulse by three methods.

    Without a trusted main peak all three readings fail, for the same reason.
    """
    record = prepare(signals, rule)
    main = find_main_peak(record)
    if isinstance(main, PickFailure):
        failed = Reading(failure=main)
        return Picks(failed, failed, failed)
    return Picks(
        peak=read_peak(record, main),
        first_arrival=read_first_arrival(record, main),
        cross_correlation=read_cross_correlation(record, main),
    )


def arrived(signals: Signals, rule: PickRule = DEFAULT_RULE) -> bool:
    """Return whether the main peak is settled, so that a longer record of this sample changes no reading."""
    return isinstance(find_main_peak(prepare(signals, rule)), MainPeak)


def record_duration(distance: float, velocity: float, frequency: float, rule: PickRule = DEFAULT_RULE) -> float:
    """Return the length of record, s, in which a pulse without dispersion is settled; SI units."""
    travel, period = distance / velocity, 1.0 / frequency
    return 0.5 * period + travel + max((rule.horizon - 1.0) * travel, period) + rule.smoothing * period


def prepare(signals: Signals, rule: PickRule) -> Record:
    """Take off the zero line, smooth, and measure the sent pulse."""
    sent, received = np.asarray(signals.sent, dtype=float), np.asarray(signals.received, dtype=float)
    top = int(np.argmax(sent))
    period = 2.0 * float(peak_widths(sent, [top], rel_height=0.5)[0][0])
    earliest = signals.distance / (rule.fastest * signals.time_step)
    # No straight line is taken off: the short quiet part at the start cannot tell how it would go on.
    received = np.asarray(received - np.median(received[: max(1, int(earliest))]))
    smooth, reach = received, int(rule.smoothing * period / 2.0)
    # A cubic through fewer than five samples smooths nothing.
    if reach > 1 and 2 * reach < len(received) and np.isfinite(received).all():
        smooth = np.asarray(savgol_filter(received, 2 * reach + 1, 3))
    return Record(
        signals=signals,
        rule=rule,
        sent=sent,
        received=received,
        smooth=smooth,
        sent_top=top,
        sent_peak=top + vertex(sent, top),
        period=period,
        earliest=earliest,
        latest=signals.distance / (rule.slowest * signals.time_step),
        reach=reach,
    )


def find_main_peak(record: Record) -> MainPeak | PickFailure:
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
        time = index + vertex(smooth, index)
        horizon = int(np.ceil(time + max((rule.horizon - 1.0) * (time - record.sent_peak), record.period)))
        if horizon + record.reach > len(smooth):
            return PickFailure.PRECURSOR if doubtful else why_no_peak(record, cut_off=True)
        peak = judge(record, index, time, horizon)
        if peak is not None and peak.precursor >= rule.precursor:
            doubtful = max(doubtful, peak.height)
        elif peak is not None:
            return peak if doubtful < rule.significance * peak.height else PickFailure.PRECURSOR
    return PickFailure.PRECURSOR if doubtful else why_no_peak(record, cut_off=False)


def judge(record: Record, index: int, time: float, horizon: int) -> MainPeak | None:
    """Weigh a peak against the record up to its horizon; None if it cannot be the main one."""
    rule, view = record.rule, record.smooth[:horizon]
    height, largest = float(view[index]), float(view.max())
    noise = noise_level(record, horizon)
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
        twin=farthest_twin(view, index, (1.0 + TWIN) * rule.prominence * largest),
        end=horizon + record.reach,
    )


def farthest_twin(view: Floats, index: int, prominence: float) -> int:
    """Return the number of samples to the farthest top that a slightly different signal would have as its main peak.

    The lower of two tops loses its prominence to the higher one, unless the dip between them is deep enough.
    """
    height = float(view[index])
    farthest = 0
    for top in find_peaks(view, height=(1.0 - TWIN) * height)[0].tolist():
        between = view[min(top, index) : max(top, index) + 1]
        if height - float(between.min()) < prominence:
            farthest = max(farthest, abs(top - index))
    return farthest


def noise_level(record: Record, horizon: int) -> float:
    """Return the larger of what was there before any wave, and of what smoothing takes away (rms)."""
    quiet = np.abs(record.smooth[: max(1, int(record.earliest))]).max()
    rough = np.std(record.received[:horizon] - record.smooth[:horizon])
    return float(max(quiet, rough))


def why_no_peak(record: Record, cut_off: bool) -> PickFailure:
    """Tell silence, a record that ends too early, and a record without a clear peak apart."""
    smooth, noise = record.smooth, noise_level(record, len(record.smooth))
    if np.abs(smooth).max() <= max(record.signals.floor, record.rule.signal_to_noise * noise):
        return PickFailure.SILENT
    rising = np.argmax(smooth) >= len(smooth) - record.period
    return PickFailure.TOO_SHORT if cut_off or rising else PickFailure.NO_PEAK


def read_peak(record: Record, main: MainPeak) -> Reading:
    """Read the time between both peaks."""
    travel = main.time - record.sent_peak
    if main.twin > APART * travel:
        return Reading(failure=PickFailure.UNSURE)
    return record.reading(travel, main.quality)


def read_first_arrival(record: Record, main: MainPeak) -> Reading:
    """Read the time between the last rises through the onset level before both peaks."""
    onset, sent = record.rule.onset, record.sent
    if main.noise >= onset * main.height:
        return Reading(failure=PickFailure.NOISE)
    began = last_rise(sent, record.sent_top, onset * float(sent[record.sent_top]))
    ended = last_rise(record.smooth, main.index, onset * main.height)
    return record.reading(ended - began, 1.0 - main.precursor)


def read_cross_correlation(record: Record, main: MainPeak) -> Reading:
    """Read the lag at which the sent pulse fits the received signal best."""
    sent, received = record.sent, record.received[: main.end]
    support = np.flatnonzero(np.abs(sent) > PULSE_FLOOR * sent[record.sent_top])
    begin = int(support[0])
    pulse = sent[begin : int(support[-1]) + 1]
    if len(pulse) > len(received):
        return Reading(failure=PickFailure.TOO_SHORT)
    products = correlate(received, pulse, mode="valid")
    best = int(np.argmax(products))
    if not 0 < best < len(products) - 1:
        return Reading(failure=PickFailure.OUTSIDE_WINDOW)
    energy = np.sum(pulse**2) * np.sum(received[best : best + len(pulse)] ** 2)
    coefficient = min(1.0, float(products[best] / np.sqrt(energy)))
    if coefficient < record.rule.correlation:
        return Reading(failure=PickFailure.UNLIKE)
    return record.reading(best + vertex(products, best) - begin, coefficient)


def last_rise(signal: Floats, top: int, level: float) -> float:
    """Return the time in samples at which a signal last rises through a level before its peak."""
    below = int(np.flatnonzero(signal[: top + 1] < level)[-1])
    low, high = signal[below], signal[below + 1]
    return below + float((level - low) / (high - low))


def vertex(signal: Floats, index: int) -> float:
    """Return where the parabola through a peak and its neighbours is highest, in samples from the peak."""
    left, middle, right = (float(value) for value in signal[index - 1 : index + 2])
    curvature = left - 2.0 * middle + right
    return 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
