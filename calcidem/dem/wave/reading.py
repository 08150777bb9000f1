"""Travel time of the shear wave from a space-time section.

1. **The P wave is subtracted.** It arrives first and moves grains along the path. In uneven cement it arrives at an
   angle, so a part of its motion is across the path and resembles an early S wave. This part is proportional to the
   motion along. Regression over the first swing along gives its share at each station (polarisation analysis:
   Montalbetti and Kanasewich 1970, doi:10.1111/j.1365-246X.1970.tb01771.x).
2. **The section is stacked along straight lines** from the transmitted peak to each peak of the receiver (slant stack:
   Stoffa et al. 1981, Geophysics 46:255). The S wave is the first peak whose stack is at least `LEAST_COHERENCE`
   and the largest of all peaks up to the arrival of any slower S wave.
3. **Its time is the receiver's own peak**, as in the paper (section 3.1.1).

A candidate depends on no sample beyond its horizon, so a record cut there gives the same bits.
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, final

import numpy as np

from calcidem.dem.engine.fields import PositivePart, checked
from calcidem.dem.engine.portable import arc_sine, find_maxima, parabola_vertex, sliding_products
from calcidem.dem.kernels.layout import Floats, Integers
from calcidem.dem.wave.section import RESOLUTION, Section
from calcidem.ends import Verdict

Method = Literal["peak", "first_arrival", "cross_correlation"]

SILENCE = 0.001
"""Velocity over v0 below which nothing is picked; the presets have at least 0.017, small stiff samples maybe less."""

_STEEPEST = 0.5
"""Largest ratio of motion across to motion along in a P wave: it then arrives at 27 degrees to the path."""

LEAST_COHERENCE = 0.5
"""Smallest stack of an S wave: mean over all stations of its amplitude over the station's largest."""

_P_TO_S = 2.1
"""Largest ratio of P to S wave speed: the S wave arrives within this multiple of the P wave's travel time."""

_STRETCH = 0.04
"""Relative tolerance of a line's velocity: the last grains delay or advance the receiver."""

ONSET = 0.1
"""Level of the first arrival, relative to the peak (Viggiani and Atkinson 1995, doi:10.1680/geot.1995.45.1.149)."""


@checked
@dataclass(frozen=True, slots=True)
class PickRule:
    """Criteria of an arrival.

    Attributes
    ----------
    method
        Reading that becomes Vs, see `Reading`.
    smoothing
        Half-width of the window in which cubics are fitted to the signals, over the period.
    largest_error
        Relative standard error above which a reading is refused.
    """

    method: Method = "peak"
    smoothing: PositivePart = 0.3  # little of shorter duration propagates through grains
    largest_error: PositivePart = 0.25  # a smaller value refuses more fast samples than slow ones


@final
@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """S wave in a section, and the velocities read from it."""

    travel_time: float
    """From the transmitted to the received peak, s."""
    coherence: float
    """Stack of the section along its line, from `LEAST_COHERENCE` to 1."""
    shifted: float
    """Relative change of the travel time by subtracting the P wave."""
    early: float
    """Relative amount by which the crest between the stations is slower than the travel time to the receiver implies.
    Such a crest would have left before the transmitted peak. Zero if it is faster or unknown.
    """
    tie: float
    """Rms distance of the other peaks from this one, weighted by their odds of being the S wave, over the travel time;
    see `_tie`.
    """
    roughness: float
    """Rms motion of the receiver that smoothing removes, until a period after the peak, over its amplitude."""
    path_scatter: float | None
    """Relative standard error of `path` from the scatter of the stations about their line."""
    index: int
    """Sample of the peak."""
    clean: Floats
    """(H, X) smoothed motion across without the P wave, up to the horizon, over v0."""
    error: float = 1.0
    """Relative standard error of the velocities to the receiver, see `reading_error`; 1 is unknown."""
    verdict: Verdict | None = None
    """`Verdict.UNCERTAIN` if this error is too large; None if the velocities are known."""
    peak: float | None = None
    first_arrival: float | None = None
    cross_correlation: float | None = None
    """Velocities by three methods, m/s: from peak to peak, from the last rise through `ONSET` before both peaks, and
    from the lag of the best fit of the pulse. The latter two are None if they differ from the first by more than a
    quarter of a period.
    """
    path: float | None = None
    path_error: float | None = None
    """Velocity of the crest from station to station, without receiver and transmitter, m/s, and its relative standard
    error; None with too few stations or an error above `PickRule.largest_error`.
    """


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """Peak of the receiver that may be the S wave."""

    index: int
    """Sample of the peak."""
    travel_time: float
    """From the transmitted peak to this one, s."""
    decided: float
    """Length of record that decides whether it is the S wave, s."""
    coherence: float
    """Stack of the section along its line, within that length."""
    rival: float
    """Largest coherence of another peak within that length."""
    clean: Floats
    """(T, X) smoothed motion across without the P wave before the line, over v0."""


class _Prepared(NamedTuple):
    """Smoothed section, in units of v0 and samples."""

    across: Floats
    along: Floats
    """(T, X) samples that a longer record does not change."""
    parts: Floats
    """(X,) places over the distance."""
    period: float
    peak: float
    """Duration of the pulse and time of its peak."""
    p_peak: Integers
    p_end: Integers
    p_share: Floats
    """(X,) peak and end of the P wave's first swing, and its ratio of motion across to along; -1 if there is none yet.
    """


def prepare(section: Section, smoothing: float) -> _Prepared:
    """Smooth a section and find the first swing of the P wave at each station."""
    half = smoothing * section.period
    across, along = (smooth(motion * RESOLUTION, half) for motion in (section.across, section.along))
    swings = [_first_swing(u, a, section.period) for u, a in zip(across.T, along.T, strict=True)]
    peak, end, share = (np.array(column) for column in zip(*swings, strict=True))
    parts = np.array(section.places) / section.distance
    return _Prepared(across, along, parts, section.period, section.transmitted_peak, peak, end, share)


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


def _first_swing(across: Floats, along: Floats, period: float) -> tuple[int, int, float]:
    """Peak, end and share of the first swing along the path at one station; -1 if none is known yet."""
    swing, soon = np.abs(along), int(period)
    if swing.max(initial=0.0) < SILENCE:
        return -1, -1, 0.0  # most stations at most looks at a record
    for peak in find_maxima(swing).tolist():
        if swing[peak] < SILENCE or peak + soon >= len(swing):
            continue
        # A swing is a precursor if one three times as large follows within a period.
        if swing[peak : peak + soon].max() > 3.0 * swing[peak]:
            continue
        # The last sample counts in part, as the peak lies behind it, so the share does not jump with the sampling.
        weight = along[: peak + 1].copy()
        weight[-1] *= 0.5 + parabola_vertex(swing, peak)
        share = np.sum(weight * across[: peak + 1]) / np.sum(weight * along[: peak + 1])
        over = along[peak:] * along[peak] <= 0.0
        end = peak + int(over.argmax()) if over.any() else len(along)
        return peak, end, float(np.clip(share, -_STEEPEST, _STEEPEST))
    return -1, -1, 0.0


def _without_p(prepared: _Prepared, before: Floats) -> Floats:
    """Motion across (T, X) without first swings of P that peak before the samples ``before`` (X,)."""
    sample = np.arange(len(prepared.across))[:, None]
    taken = (prepared.p_peak >= 0) & (prepared.p_peak <= before) & (sample < prepared.p_end)
    return prepared.across - np.where(taken, prepared.p_share * prepared.along, 0.0)


def _receiver_peaks(prepared: _Prepared) -> list[int]:
    """Peaks of the receiver after the transmitted one; those after the peak of the P wave exclude it."""
    clean = _without_p(prepared, np.full(len(prepared.parts), np.inf))[:, -1]
    peak, whole = int(prepared.p_peak[-1]), prepared.across[:, -1]
    found = [i for i in find_maxima(whole).tolist() if (peak < 0 or i < peak) and whole[i] > SILENCE]
    found += [i for i in find_maxima(clean).tolist() if i >= peak >= 0 and clean[i] > SILENCE]
    return [i for i in found if i > prepared.peak + 1.0]  # the peak itself may lie half a sample earlier


def read_section(section: Section, rule: PickRule = PickRule()) -> Reading | Verdict:
    """Pick the travel time of the shear wave.

    The verdict is `Verdict.TOO_SHORT` if only a longer record can decide. A reading with too large an error has no
    velocities.
    """
    found = _find_arrival(prepare(section, rule.smoothing), section)
    if isinstance(found, Verdict):
        return found
    error = reading_error(found, section.frequency)
    if error > rule.largest_error:
        return replace(found, error=error, verdict=Verdict.UNCERTAIN, path=None)
    others = (_read_first_arrival(section, found), _read_cross_correlation(section, found))
    near = 0.25 / section.frequency
    first, correlated = (
        section.distance / time if time is not None and abs(time - found.travel_time) < near else None
        for time in others
    )
    path, path_error = found.path, None
    if found.path_scatter is not None:
        # The fitted standard error is 1.8 times the estimate from the scatter.
        path_error = float(np.sqrt(error * error + (1.8 * found.path_scatter) ** 2))
        path, path_error = (path, path_error) if path_error <= rule.largest_error else (None, None)
    return replace(
        found,
        error=error,
        peak=section.distance / found.travel_time,
        first_arrival=first,
        cross_correlation=correlated,
        path=path,
        path_error=path_error,
    )


def record_duration(distance: float, velocity: float, frequency: float) -> float:
    """Length of record needed to pick a pulse without dispersion, s; SI units."""
    travel, period = distance / velocity, 1.0 / frequency
    return max(_P_TO_S * travel, travel + period) + (0.5 + 2.0 * PickRule().smoothing) * period


def is_settled(section: Section, rule: PickRule, remaining_speed: float) -> bool:
    """Return whether a longer record would not change the reading.

    Parameters
    ----------
    section, rule
        Section so far, and criteria of its reading.
    remaining_speed
        Bound of all later velocities of the section, m/s.

    Notes
    -----
    Either the S wave is found, or the stack of any later peak would be too small. On its line each station is later
    than on the present line, so its known motion and ``remaining_speed`` bound the stack.
    """
    # At most looks the receiver alone, a tenth of the section, shows that the record is too short.
    alone = replace(section, places=section.places[-1:], across=section.across[:, -1:], along=section.along[:, -1:])
    receiver = prepare(alone, rule.smoothing)
    loudest = float(np.sqrt(1.0 + _STEEPEST * _STEEPEST)) * remaining_speed / section.amplitude
    tail = np.abs(section.across[len(receiver.across) :]).max(axis=0, initial=0) * RESOLUTION
    is_quiet = max(loudest, float(tail[-1])) < SILENCE
    peaks = _receiver_peaks(receiver)
    if not peaks and (is_quiet or receiver.p_peak[0] < 0):
        return is_quiet
    if peaks and _horizon(receiver, _line_to(receiver, peaks[0])[1] - receiver.peak) > len(receiver.across):
        return False
    prepared = prepare(section, rule.smoothing)
    found = _find_arrival(prepared, section)
    if isinstance(found, Reading) or found is Verdict.TOO_SHORT:
        return isinstance(found, Reading)
    if is_quiet or (prepared.p_peak < 0).any():
        return is_quiet
    clean = _without_p(prepared, np.full(len(prepared.parts), np.inf))
    now = (1.0 - _STRETCH) * (len(clean) - 1 - prepared.peak) * prepared.parts + prepared.peak
    later = np.arange(len(clean))[:, None] >= now
    highest = np.maximum(np.where(later, clean, 0.0).max(axis=0), np.maximum(tail, loudest))
    return float(np.minimum(highest / _largest(clean), 1.0).mean()) < LEAST_COHERENCE


def _find_arrival(prepared: _Prepared, section: Section) -> Reading | Verdict:
    """Find the S wave; `Verdict.TOO_SHORT` if only a longer record can decide."""
    peaks = _receiver_peaks(prepared)
    if not peaks:
        return Verdict.SILENT
    for peak in peaks:
        found = _judge(prepared, section, peak)
        if found is not None:
            return found
    return Verdict.NO_LINE


def _judge(prepared: _Prepared, section: Section, index: int) -> Reading | Verdict | None:
    """Judge a peak of the receiver; None if it is not the S wave."""
    early, time = _line_to(prepared, index)
    travel = time - prepared.peak
    horizon = _horizon(prepared, travel)
    if horizon > len(early):
        return Verdict.TOO_SHORT
    clean = early[:horizon]
    largest = _largest(clean)
    coherence, rivals = _coherence(prepared, clean, largest, travel), _rivals(prepared, clean, largest, index)
    if coherence < LEAST_COHERENCE or any(other > coherence for _, other in rivals):
        return None
    whole = prepared.across[:horizon, -1]
    with_p = [i + parabola_vertex(whole, i) for i in find_maxima(whole).tolist() if i > prepared.peak]
    shifted = min((abs(other - time) for other in with_p), default=travel) / travel
    rough = (section.across[:horizon, -1] * RESOLUTION - whole)[: index + int(prepared.period)]
    crest, interval = _crest(prepared, clean, travel), section.sampling_interval
    return Reading(
        travel_time=travel * interval,
        coherence=coherence,
        shifted=shifted,
        early=0.0 if crest is None else max(0.0, 1.0 - travel / crest[0]),
        tie=_tie(coherence, travel, rivals),
        roughness=float(np.sqrt(np.mean(rough * rough)) / clean[index, -1]),
        path=None if crest is None else section.distance / (crest[0] * interval),
        path_scatter=None if crest is None else crest[1],
        index=index,
        clean=clean,
    )


def find_candidates(section: Section, smoothing: float) -> tuple[Candidate, ...]:
    """Peaks of the receiver that may be the S wave, in order, as judged by `_find_arrival`.

    A record too short to decide is judged in its length.
    """
    prepared = prepare(section, smoothing)
    found = []
    for index in _receiver_peaks(prepared):
        clean, time = _line_to(prepared, index)
        travel = time - prepared.peak
        horizon = _horizon(prepared, travel)
        seen = clean[:horizon]
        largest = _largest(seen)
        coherence = _coherence(prepared, seen, largest, travel)
        rival = max((other for _, other in _rivals(prepared, seen, largest, index)), default=0.0)
        decided = (horizon + int(smoothing * section.period)) * section.sampling_interval
        found.append(Candidate(index, travel * section.sampling_interval, decided, coherence, rival, clean))
    return tuple(found)


def describe_refusal(found: Reading | Verdict, section: Section, rule: PickRule) -> str:
    """Return the verdict on a section, or on a reading with too large an error, and the numbers behind it."""
    if isinstance(found, Reading):
        return f"{Verdict.UNCERTAIN}: it is {found.error:.1%}, {rule.largest_error:.1%} is allowed"
    candidates, end = find_candidates(section, rule.smoothing), f"{1e3 * section.duration:.3g} ms"
    if found is Verdict.SILENT:
        largest = float(np.abs(section.across[:, -1]).max(initial=0)) * RESOLUTION
        return f"{found}: the receiver reaches {largest:.2%} of v0 in {end}"
    if found is Verdict.TOO_SHORT:
        late = min(one.decided for one in candidates if one.decided > section.duration)
        return f"{found}: a peak is decided at {1e3 * late:.3g} ms, the record ends at {end}"
    best = max(candidates, key=lambda one: one.coherence)
    text = f"the best of {len(candidates)}, {section.distance / best.travel_time:.0f} m/s, has a coherence of"
    return f"{found}: {text} {best.coherence:.3f}, {max(best.rival, LEAST_COHERENCE):.3f} is needed"


def velocity_spectrum(section: Section, smoothing: float, velocities: Floats) -> Floats:
    """Coherence of peaks at these velocities, m/s: stack of a section along the lines of such waves.

    NaN for waves that arrive after the end of the record.
    """
    prepared = prepare(section, smoothing)
    stack = np.full(len(velocities), np.nan)
    for place, travel in enumerate((section.distance / velocities / section.sampling_interval).tolist()):
        if prepared.peak + travel <= len(prepared.across) - 1:
            clean = _without_p(prepared, prepared.peak + travel * prepared.parts)[: _horizon(prepared, travel)]
            stack[place] = _coherence(prepared, clean, _largest(clean), travel)
    return stack


def _line_to(prepared: _Prepared, index: int) -> tuple[Floats, float]:
    """Motion across (T, X) without P waves before the line to a peak of the receiver, and its travel time, samples."""
    clean = _without_p(prepared, prepared.peak + (index - prepared.peak) * prepared.parts)
    return clean, index + parabola_vertex(clean[:, -1], index)


def _horizon(prepared: _Prepared, travel: float) -> int:
    """Samples that decide whether a peak with this travel time is the S wave; a slower one would arrive by then."""
    return int(prepared.peak + max(_P_TO_S * travel, travel + prepared.period)) + 1


def _largest(clean: Floats) -> Floats:
    """(X,) largest motion of each station, of either sign; reverberations are small beside it."""
    return np.asarray(np.maximum(np.abs(clean).max(axis=0), SILENCE * RESOLUTION))


def _rivals(prepared: _Prepared, clean: Floats, largest: Floats, index: int) -> list[tuple[float, float]]:
    """All peaks of the receiver but one: their travel times, samples, and the coherence of their lines."""
    rivals = []
    for other in find_maxima(clean[:, -1]).tolist():
        if other > prepared.peak and clean[other, -1] > SILENCE and other != index:
            travel = other + parabola_vertex(clean[:, -1], other) - prepared.peak
            rivals.append((travel, _coherence(prepared, clean, largest, travel)))
    return rivals


def _tie(coherence: float, travel: float, rivals: list[tuple[float, float]]) -> float:
    """Rms distance of the other peaks, weighted by odds that fall from 1/2 at equal coherence to 0."""
    total = 0.0
    for other_travel, other in rivals:
        # Small changes of a signal change a coherence by less than 0.05.
        odds = 0.5 * max(0.0, 1.0 - (coherence - other) / 0.05)
        apart = other_travel / travel - 1.0
        total += odds * apart * apart
    return float(np.sqrt(total))


def _coherence(prepared: _Prepared, clean: Floats, largest: Floats, travel: float) -> float:
    """Stack of a section along a line from the transmitted peak, each station normalised by its largest value."""
    stretch = np.linspace(1.0 - _STRETCH, 1.0 + _STRETCH, 9)[:, None]
    time = prepared.peak + travel * stretch * prepared.parts
    left = np.clip(time.astype(int), 0, len(clean) - 2)
    share, station = time - left, np.arange(len(prepared.parts))
    value = (1.0 - share) * clean[left, station] + share * clean[left + 1, station]
    return float(np.clip(value / largest, -1.0, 1.0).mean(axis=1).max())


def _crest(prepared: _Prepared, clean: Floats, travel: float) -> tuple[float, float] | None:
    """Travel time of the whole distance from the crest between stations, samples, and its relative standard error."""
    place, time = [], []
    for station, part in enumerate(prepared.parts[:-1].tolist()):
        wanted = prepared.peak + travel * part
        peaks = [i + parabola_vertex(clean[:, station], i) for i in find_maxima(clean[:, station]).tolist()]
        near = [peak for peak in peaks if abs(peak - wanted) < 0.25 * prepared.period]
        if near:
            place.append(part)
            time.append(min(near, key=lambda peak: abs(peak - wanted)))
    if len(place) < 4:  # fewer cannot tell a line from a curve
        return None
    x, t = np.array(place), np.array(time)
    first, second = np.triu_indices(len(x), 1)
    slope = _median((t[second] - t[first]) / (x[second] - x[first]))  # Theil and Sen: robust against one outlier
    rest = np.abs(t - slope * x - _median(t - slope * x))
    spread = 1.4826 * _median(rest) * np.sqrt(len(x) / (len(x) - 2.0))
    error = float(spread / np.sqrt(np.sum((x - x.mean()) * (x - x.mean()))))
    return (slope, error / slope) if slope > 0.0 else None


def _median(values: Floats) -> float:
    """Median; NumPy's takes five times as long for few values."""
    ordered, count = np.sort(values), len(values)
    return float((ordered[(count - 1) // 2] + ordered[count // 2]) / 2.0)


def reading_error(found: Reading, frequency: float) -> float:
    """Relative standard error of a picked velocity: root of the sum of squares of independent parts.

    The subtraction may leave a part of the P wave. On a path of few wavelengths P and S wave overlap (Arroyo et al.
    2003, Geotechnique 53:337). Their peak is early, so the crest between the stations seems to leave before the
    transmitted peak; this difference counts in full. If another peak continues the section nearly as well, either may
    be the S wave. The error is at most 1: nothing is known. The factors were fitted to sections with a known delay
    (docs/reading.md).
    """
    periods = found.travel_time * frequency
    parts = (
        0.019,  # dispersion and scattering shift any peak by this much
        0.75 * found.shifted,  # rest of the P wave
        0.04 / (periods * periods * float(np.sqrt(periods))),  # P and S wave overlap, as on a path of one wavelength
        found.early,
        found.tie,
    )
    return float(min(1.0, np.sqrt(sum(part * part for part in parts))))


def _read_first_arrival(section: Section, found: Reading) -> float | None:
    """Time between the last rises through the onset level before both peaks, s."""
    received = found.clean[: found.index + 1, -1]
    level = ONSET * float(received[-1])
    below = np.flatnonzero(received < level)
    if not len(below):
        return None
    last = int(below[-1])
    low, high = received[last], received[last + 1]
    arrived = section.start_time + (last + float((level - low) / (high - low))) * section.sampling_interval
    # 1 - cos 2 pi f t = 2 ONSET
    return arrived - float(arc_sine(np.sqrt(ONSET))) / (np.pi * section.frequency)


def _read_cross_correlation(section: Section, found: Reading) -> float | None:
    """Lag of the best fit of the pulse to the received signal, within half a period of the peak's, s."""
    pulse = section.transmitted[: int(section.period)]
    received, lag = found.clean[:, -1], round(found.travel_time / section.sampling_interval)
    begin = max(0, lag - int(section.period / 2.0))
    products = sliding_products(received[begin : lag + int(1.5 * section.period)], pulse)
    best = int(np.argmax(products)) if len(products) else 0
    if not 0 < best < len(products) - 1:
        return None
    return float((begin + best + parabola_vertex(products, best)) * section.sampling_interval)
