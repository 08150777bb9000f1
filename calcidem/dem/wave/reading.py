"""Velocities from a space-time section.

1. **A damped wave is fitted to the section** (`StripWave`). Its velocity is the effective velocity of the sample.
2. **The S wave of a receiver is the peak next to that of the fitted wave.** The time between the transmitted and this
   peak gives Vs, as in the paper (section 3.1.1). First arrival and cross-correlation are read beside it.
3. **Its error is measured.** The peaks at the far stations and the receiver scatter about those of the fitted wave.
   Another peak of the receiver may be the S wave: the more so, the larger that scatter and the fitted wave's error.
"""

from dataclasses import dataclass, replace
from typing import Literal, final

import numpy as np

from calcidem.dem.engine.fields import PositivePart, checked
from calcidem.dem.engine.portable import exponential, find_maxima, parabola_vertex, sliding_products
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.section import (
    P_OVER_S,
    RESOLUTION,
    Section,
    StripWave,
    far_stations,
    fit_velocity,
    fit_wave,
    waveform,
)
from calcidem.ends import Verdict

Method = Literal["peak", "first_arrival", "cross_correlation"]

SILENCE = 0.001
"""Velocity over v0 below which nothing is read; the presets have at least 0.017, small stiff samples maybe less."""

_ONSET = 0.1
"""Level of the first arrival, relative to the peak (Viggiani and Atkinson 1995, doi:10.1680/geot.1995.45.1.149)."""


@checked
@dataclass(frozen=True, slots=True)
class PickRule:
    """Criteria of a reading.

    Attributes
    ----------
    method
        Reading that becomes Vs.
    smoothing
        Half-width, over the period, of the window in which cubics are fitted to the signals to read their peaks.
    largest_error
        Relative standard error above which a velocity is refused.
    """

    method: Method = "peak"
    smoothing: PositivePart = 0.3  # little of shorter duration propagates through grains
    largest_error: PositivePart = 0.5  # refusing at less would bias means: fast samples have the larger errors


@final
@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Wave of a section, and the velocities read from it."""

    wave: StripWave
    """Wave that fits the section best."""
    travel_time: float
    """From the transmitted to the received peak, s; NaN without such a peak."""
    index: int
    """Sample of the received peak."""
    signal: Floats
    """(T,) smoothed motion of the receiver across the path, over v0."""
    bias: float
    """Velocity of the fitted wave's peak over its effective velocity, less 1: on a short path the peak of a wave in a
    strip is early. It is no error of the reading, and is known.
    """
    error: float
    """Relative standard error of the velocities to the receiver, over the travel time; 1 if it is unknown.

    Its square is the sum of two variances of the arrival: of the peaks beyond half of the path about those of the
    fitted wave, and of the choice among the peaks of the receiver (`_variance_of_choice`).
    """
    verdict: Verdict | None = None
    """Reason why there is no velocity to the receiver; None if there is one."""
    peak: float | None = None
    first_arrival: float | None = None
    cross_correlation: float | None = None
    """Velocities by three methods, m/s: from peak to peak, from the last rise through a tenth of both peaks, and from
    the lag of the best fit of the pulse. The latter two are None if they differ from the first by more than a quarter
    of a period.
    """


def record_duration(distance: float, velocity: float, frequency: float) -> float:
    """Length of a record that decides on a wave of this velocity, s; SI units.

    A fast wave may be the P wave. So the record lasts until the peak of an S wave that is `P_OVER_S` times slower,
    and most of a period longer.
    """
    return P_OVER_S * distance / velocity + 1.35 / frequency


def is_settled(section: Section, clamp: float, remaining_speed: float) -> bool:
    """Return whether a record is long enough: for the wave that fits it, or because nothing more can arrive.

    Parameters
    ----------
    section
        Section so far.
    clamp
        K of the strip, see `StripWave`, 1/m.
    remaining_speed
        Bound of all later velocities of the section, m/s.
    """
    largest = _largest(section)
    if largest < SILENCE:
        is_sent = section.times[-1] > 1.0 / section.frequency  # until then the pulse adds motion
        return bool(is_sent) and remaining_speed < SILENCE * section.amplitude
    velocity = fit_velocity(section, clamp)
    if velocity is None or not _is_decided(section, velocity):
        return False
    if remaining_speed < largest * section.amplitude:
        return True  # nothing as large as what has come can come any more, even if this fits no wave
    # Before the S wave comes, its forerunners fit any fast wave, none of them well: their errors mostly 0.3 and more.
    wave = fit_wave(section, clamp)
    return wave is not None and wave.error < 0.15


def _largest(section: Section) -> float:
    """Largest motion of the receiver across the path, over v0."""
    return float(np.abs(section.across[:, -1]).max(initial=0)) * RESOLUTION


def _is_decided(section: Section, velocity: float) -> bool:
    """Whether the record is long enough for a wave of this velocity, m/s."""
    return bool(section.times[-1] >= record_duration(section.distance, velocity, section.frequency))


def read_section(section: Section, clamp: float, rule: PickRule = PickRule()) -> Reading | Verdict:
    """Read the velocities of a section; a verdict if there is no wave.

    Parameters
    ----------
    section
        Complete section.
    clamp
        K of the strip, see `StripWave`, 1/m.
    rule
        Criteria.
    """
    wave = None if _largest(section) < SILENCE else fit_wave(section, clamp)
    if wave is None:
        return Verdict.SILENT
    if not _is_decided(section, wave.velocity):
        return Verdict.TOO_SHORT
    far = far_stations(section.places)
    half_width = rule.smoothing * section.period
    smoothed = smooth(section.across[:, -len(far) :] * RESOLUTION, half_width)
    signal, expected = smoothed[:, -1], _peaks_of_wave(section, wave, far)
    if not np.isfinite(expected[-1]):
        return Verdict.NO_PEAK  # so slow a wave does not pass this strip
    peaks = [_peaks(motion) for motion in smoothed.T]
    late = [_nearest(own, when, section.period) - when for own, when in zip(peaks, expected, strict=True)]
    fitted = (expected[-1] - section.transmitted_peak) * section.sampling_interval  # travel time of its peak, s
    bias = section.distance / (fitted * wave.velocity) - 1.0
    travel = fitted + late[-1] * section.sampling_interval
    apart = np.array([one for one in late if np.isfinite(one)]) * section.sampling_interval
    if not travel > 0.0:  # also NaN
        return Reading(wave, np.nan, 0, signal, bias, 1.0, Verdict.NO_PEAK)
    peak, error = expected[-1] + late[-1], 1.0
    if len(apart) > 2:
        scatter = float((apart * apart).sum()) / (len(apart) - 1.0)  # s^2, as the next
        unknown = scatter + (wave.error * travel) * (wave.error * travel)
        choice = _variance_of_choice(peaks[-1], peak, expected[-1], unknown / section.sampling_interval**2)
        error = float(np.sqrt(scatter + choice * section.sampling_interval**2)) / travel
    index = round(peak)
    found = Reading(wave, travel, index, signal, bias, min(1.0, error))
    if error > rule.largest_error:
        return replace(found, verdict=Verdict.UNCERTAIN)
    others = (_read_first_arrival(section, found, half_width), _read_cross_correlation(section, found))
    near = 0.25 / section.frequency
    first, correlated = (
        section.distance / time if time is not None and abs(time - travel) < near else None for time in others
    )
    return replace(found, peak=section.distance / travel, first_arrival=first, cross_correlation=correlated)


def _peaks_of_wave(section: Section, wave: StripWave, places: tuple[float, ...]) -> list[float]:
    """Samples of the peak of a wave at places, m: of its crests the one next to the arrival at the wave's velocity.

    The highest may be a later one on a path of a wavelength, where two are nearly equal.
    """
    # The pulse has its peak half a period after it begins.
    arrival = [(place / wave.velocity - section.start_time) / section.sampling_interval for place in places]
    begin = np.array([int(one) - 1 for one in arrival])
    sample = begin[:, None] + np.arange(int(section.period) + 4)
    motion = waveform(wave, section.frequency, places, section.start_time + section.sampling_interval * sample)
    return [
        _nearest(first + _peaks(signal), one + 0.5 * section.period, section.period)
        for signal, one, first in zip(motion, arrival, begin.tolist(), strict=True)
    ]


def _nearest(peaks: Floats, when: float, period: float) -> float:
    """Peak of some (P,) next to a sample; NaN if none is within half a period."""
    near = [peak for peak in peaks.tolist() if abs(peak - when) < 0.5 * period]
    return min(near, key=lambda peak: abs(peak - when), default=np.nan)


def _peaks(signal: Floats) -> Floats:
    """Samples of the peaks of a signal (T,), in order."""
    return np.array([i + parabola_vertex(signal, i) for i in find_maxima(signal).tolist() if signal[i] > SILENCE])


def _variance_of_choice(peaks: Floats, chosen: float, expected: float, variance: float) -> float:
    """Variance of an arrival, samples^2, since another of the peaks (P,) of a signal may be the S wave.

    It is the mean square distance of all peaks from the chosen one. Each counts by its likelihood, whatever its height:
    the S wave has a normal distribution about the expected sample, with a variance in samples^2.
    """
    away = (peaks - expected) * (peaks - expected) / (2.0 * max(variance, 1e-12))  # no peak is known to 1e-6 samples
    likelihood = exponential(-np.minimum(away - away.min(), 700.0))
    return float((likelihood * (peaks - chosen) * (peaks - chosen)).sum() / likelihood.sum())


def describe_refusal(found: Reading | Verdict, section: Section, rule: PickRule) -> str:
    """Return the verdict on a section or a reading, and the numbers behind it."""
    if isinstance(found, Reading):
        if found.verdict is Verdict.UNCERTAIN:
            return f"{found.verdict}: it is {found.error:.1%}, {rule.largest_error:.1%} is allowed"
        return (
            f"{found.verdict}: the wave of {found.wave.velocity:.0f} m/s has a coherence of {found.wave.coherence:.2f}"
        )
    end = f"{1e3 * section.duration:.3g} ms"
    if found is Verdict.TOO_SHORT:
        return f"{found}: the record ends at {end}"
    return f"{found}: the receiver reaches {_largest(section):.2%} of v0 in {end}"


def smooth(motion: Floats, half_width: float) -> Floats:
    """Values of cubics fitted to each sample (T, ...) and its neighbours; the last ``half_width`` samples have none.

    The weights of neighbours are ``(1 - (j / half_width)^2)^2`` (local regression: Cleveland 1979,
    doi:10.1080/01621459.1979.10481038). They vary smoothly with the sampling. Before the record all is at rest.
    """
    reach = int(half_width)
    if reach < 1:
        return np.asarray(motion, dtype=float)
    square = np.arange(-reach, reach + 1.0) ** 2
    near = 1.0 - square / (half_width * half_width)
    weight = near * near
    sums = [float(np.sum(weight * power)) for power in (np.ones_like(square), square, square * square)]
    weight = weight * (sums[2] - sums[1] * square) / (sums[0] * sums[2] - sums[1] * sums[1])
    rest = np.zeros((reach, *motion.shape[1:]))
    return sliding_products(np.concatenate([rest, motion]), weight)


def arrival_shift(section: Section, other: Section, travel_time: float, rule: PickRule = PickRule()) -> float:
    """Time by which the received wave of another section is later, s: the lag of their best correlation.

    Half a period before and after the arrival is compared, or less if a record ends there; the lag is at most half a
    period. NaN if the other record ends within half a period after the arrival.

    Parameters
    ----------
    section, other
        Two sections of a sample, whose sampling may differ.
    travel_time
        Between the transmitted and the received peak, s.
    rule
        Smoothing of the signals.
    """
    half = int(0.5 * section.period)
    arrival = max(half, round(travel_time / section.sampling_interval + section.transmitted_peak))
    first, second = (smooth(one.across[:, -1] * RESOLUTION, rule.smoothing * one.period) for one in (section, other))
    sample = np.arange(arrival - 2 * half, arrival + 2 * half + 1)
    place = (section.start_time - other.start_time + sample * section.sampling_interval) / other.sampling_interval
    place = place[place < len(second) - 1]
    low = np.maximum(0, place.astype(int))
    # Before the record all is at rest.
    second = np.where(place < 0.0, 0.0, second[low] + (place - low) * (second[low + 1] - second[low]))
    wave = first[arrival - half : arrival - half + max(0, len(second) - 2 * half)]
    if len(wave) < half:
        return np.nan
    second = second[: len(wave) + 2 * half]
    strength = np.sqrt(sliding_products(second * second, np.ones_like(wave)))
    likeness = sliding_products(second, wave) / np.maximum(strength, SILENCE)
    best = int(likeness.argmax())
    inside = 0 < best < len(likeness) - 1
    return (best - half + (parabola_vertex(likeness, best) if inside else 0.0)) * section.sampling_interval


def _read_first_arrival(section: Section, found: Reading, half_width: float) -> float | None:
    """Time between the last rises before both peaks, s, of the received signal and of the pulse smoothed likewise."""
    # Smoothing begins a rise earlier: of the received signal alone it would make the velocity too high.
    pulse = smooth(section.until(int(section.period)).transmitted, half_width)
    sent = _last_rise(pulse[: int(pulse.argmax()) + 1])
    arrived = _last_rise(found.signal[: found.index + 1])
    return None if sent is None or arrived is None else (arrived - sent) * section.sampling_interval


def _last_rise(signal: Floats) -> float | None:
    """Last sample of a signal that ends with its peak at which it rises through the onset level."""
    level = _ONSET * float(signal[-1])
    below = np.flatnonzero(signal < level)
    if not len(below):
        return None
    last = int(below[-1])
    low, high = float(signal[last]), float(signal[last + 1])
    return last + (level - low) / (high - low)


def _read_cross_correlation(section: Section, found: Reading) -> float | None:
    """Lag of the best fit of the pulse to the received signal, within half a period of the peak's, s."""
    pulse = section.until(int(section.period)).transmitted
    lag = round(found.travel_time / section.sampling_interval)
    begin = max(0, lag - int(section.period / 2.0))
    products = sliding_products(found.signal[begin : lag + int(1.5 * section.period)], pulse)
    best = int(np.argmax(products)) if len(products) else 0
    if not 0 < best < len(products) - 1:
        return None
    return float((begin + best + parabola_vertex(products, best)) * section.sampling_interval)
