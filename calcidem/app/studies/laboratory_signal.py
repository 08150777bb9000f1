"""Velocities from a transmitted and a received signal of a laboratory, such as those of bender elements."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from scipy.signal import correlate

from calcidem.analysis.figures.samples import METHOD_STYLES, Arrival, draw_signal_pair
from calcidem.analysis.figures.style import apply_style, new_panel
from calcidem.dem.engine.fields import require
from calcidem.dem.engine.portable import find_maxima, parabola_vertex
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.reading import smooth


@dataclass(frozen=True, slots=True, eq=False)
class SignalReading:
    """Velocities between two signals by three methods: ``peak``, ``first_arrival`` and ``cross_correlation``.

    Attributes
    ----------
    velocities
        m/s, by method.
    errors
        Standard errors from the noise of both signals alone, m/s, by method. Near field, dispersion and an unknown
        delay of the electronics are not in them.
    spread
        Largest difference between the methods over their mean: what near field and dispersion do to a reading.
    is_reversed
        Whether the received signal has the opposite sign of the transmitted one, as with an element that is turned.
    arrival
        Signals without offset, the received one with the sign of the transmitted one and less the delay.
    """

    velocities: Mapping[str, float]
    errors: Mapping[str, float]
    spread: float
    is_reversed: bool
    arrival: Arrival

    def __str__(self) -> str:
        """Give the velocities in lines."""
        lines = [f"{METHOD_STYLES[name][0]}: {self.label(name)}" for name in self.velocities]
        lines.append(f"The methods differ by {100.0 * self.spread:.2g} %; \u00b1 is the error by noise alone.")
        return "\n".join([*lines, *["The received signal is reversed."] * self.is_reversed])

    def label(self, method: str) -> str:
        """Velocity by a method with its standard error."""
        return f"{self.velocities[method]:.1f} \u00b1 {self.errors[method]:.1g} m/s"

    @apply_style
    def plot(self) -> Figure:
        """Draw both signals, each over its peak, with the three arrivals; `matplotlib` saves the figure."""
        figure, axes, _ = new_panel(height=2.6)
        draw_signal_pair(axes, self.arrival)
        begin, end = (float(self.arrival.time[place]) for place in (0, -1))
        axes.set_xlim(1e3 * begin, 1e3 * min(end, 2.0 * self.arrival.arrival_time("peak") - begin))  # ms
        for line, name in enumerate(self.velocities):
            text = f"{METHOD_STYLES[name][0]}:\n{self.label(name)}"
            axes.text(1.01, 1 - 0.3 * line, text, va="top", fontsize=8, transform=axes.transAxes)
        told = f"they differ by\n{100.0 * self.spread:.2g} %"
        axes.text(1.01, 0.1, told, va="top", fontsize=8, transform=axes.transAxes)
        axes.set_title("received signal reversed" if self.is_reversed else "")
        axes.set_xlabel("time (ms)")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=5)
        return figure


def read_signal(
    time: ArrayLike, transmitted: ArrayLike, received: ArrayLike, distance: float, *, delay: float = 0.0
) -> SignalReading:
    """Read the velocity of a wave from one pulse and its arrival, with errors.

    The lag of the largest cross-correlation, of either sign, selects the arrival. Both signals are smoothed over 0.6
    of the pulse's width at half its height, by the cubics of a campaign's reading. *Peak* is the time between both
    peaks, *first arrival* that between the last rises through a tenth of them. The noise is what smoothing removes.

    Parameters
    ----------
    time
        (T,) s, in equal steps.
    transmitted, received
        (T,) signals in any unit; their medians are taken as rest.
    distance
        Path of the wave, m; between the tips of bender elements.
    delay
        Delay of the electronics, s, which is subtracted from the travel time: the time between both signals when the
        elements touch each other.

    Raises `calcidem.dem.engine.fields.FieldError`, which is a `ValueError`, for invalid values and for a record
    without an arrival.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(0.0, 2e-3, 2e-6)
    >>> pulse = lambda start: np.where(abs(time - start) < 5e-5, np.cos(np.pi * (time - start) / 1e-4) ** 2, 0.0)
    >>> reading = calcidem.read_signal(time, pulse(2e-4), 0.1 * pulse(7e-4), 0.1)
    >>> round(reading.velocities["peak"], 3)
    200.0
    """
    when, sent, got = _checked(time, transmitted, received, distance)
    step, last = (when[-1] - when[0]) / (len(when) - 1), len(when) - 1
    sense = 1.0 if sent.max() >= 0.9 * -sent.min() else -1.0
    sent = sense * sent
    high = np.flatnonzero(sent < 0.5 * sent.max())
    top = int(sent.argmax())
    require(
        abs(sent[0]) < 0.3 * sent[top],
        "time",
        f"{when[0]:g} is within the pulse",
        "give a record that begins before it",
    )
    width = int(high[high > top].min(initial=last) - high[high < top].max(initial=0))
    enough = 4 < width < last // 4
    require(
        enough,
        "time",
        f"{width} samples in half of the pulse",
        "give a pulse of 5 samples or more, and a longer record",
    )
    correlation = correlate(got, sent)[last:]  # from lag 0
    turn = -1.0 if correlation[width + np.abs(correlation[width:]).argmax()] < 0.0 else 1.0
    got, correlation = turn * got, turn * correlation
    lag = width + int(correlation[width:].argmax())
    kernel = smooth(np.eye(1, 4 * width, 2 * width)[0], 0.6 * width)
    smooth_sent, smooth_got = (smooth(signal, 0.6 * width) for signal in (sent, got))
    noise_sent, noise_got = (
        _noise(signal, smoothed, kernel) for signal, smoothed in ((sent, smooth_sent), (got, smooth_got))
    )
    heard = width < lag < len(correlation) - 1 and correlation[lag] > 5.0 * noise_got * np.linalg.norm(sent)
    require(heard, "received", "no arrival above the noise", "record longer, or average more records")
    peak = int(smooth_sent.argmax())
    peaks = find_maxima(smooth_got)
    peaks = peaks[np.abs(peaks - peak - lag) < width]
    require(
        len(peaks) > 0, "received", "no peak where the correlation is largest", "record longer, or average more records"
    )
    arrived = int(peaks[np.abs(peaks - peak - lag).argmin()])
    rises = [_rise(smooth_sent, peak, kernel, noise_sent), _rise(smooth_got, arrived, kernel, noise_got)]
    tops = [_vertex(smooth_sent, peak, kernel, noise_sent), _vertex(smooth_got, arrived, kernel, noise_got)]
    lags = [(0.0, _vertex(correlation, lag, got, noise_sent)[1]), _vertex(correlation, lag, sent, noise_got)]
    velocities, errors = {}, {}
    for name, (began, ended) in zip(METHOD_STYLES, (tops, rises, lags), strict=True):
        travel = ended[0] - began[0] - delay / step
        require(travel > 0.0, "delay", delay, "give less than the travel time, s")
        velocities[name] = float(distance / (travel * step))
        errors[name] = float(velocities[name] * math.hypot(began[1], ended[1]) / travel)
    speed, speeds = velocities["cross_correlation"], [*velocities.values()]
    plausible = 5.0 < speed < 10_000.0  # m/s, from mud to rock
    require(plausible, "distance", f"{distance:g} gives {speed:.3g} m/s", "give distance in m and time in s", "time")
    arrival = Arrival(0, math.nan, when, sent, np.interp(when + delay, when, got), float(distance), velocities)
    spread = float(np.ptp(speeds) / np.mean(speeds))
    return SignalReading(velocities, errors, spread, sense * turn < 0.0, arrival)


def _checked(
    time: ArrayLike, transmitted: ArrayLike, received: ArrayLike, distance: float
) -> tuple[NDArray[np.float64], ...]:
    """Time, and both signals without offset; `FieldError` if they are none."""
    signals = {}
    for name, values in (("time", time), ("transmitted", transmitted), ("received", received)):
        signals[name] = found = np.array(values, dtype=np.float64)
        fits = found.ndim == 1 and found.size >= 32 and found.size == np.size(time)
        require(fits, name, f"{found.size} values", "give one for each time, at least 32", "time")
        require(bool(np.isfinite(found).all()), name, "not finite", "leave such samples out at both ends", "time")
        signals[name] = found if name == "time" else found - np.median(found)
        require(bool(np.ptp(found) > 0.0), name, f"{found[0]:g} always", "give a signal that changes")
    when = signals["time"]
    even = np.linspace(when[0], when[-1], when.size)
    is_even = when[-1] > when[0] and np.abs(when - even).max() <= 0.2 * (even[1] - even[0])
    require(bool(is_even), "time", f"{when[0]:g} to {when[-1]:g}", "give increasing times in equal steps, s")
    require(0.0 < distance < 100.0, "distance", distance, "give the path between the elements, m")
    return when, signals["transmitted"], signals["received"]


def _noise(signal: Floats, smoothed: Floats, kernel: Floats) -> float:
    """Standard deviation of white noise: from the median of what smoothing with a kernel removes, or of its digits."""
    removed = np.abs(signal[: len(smoothed)] - smoothed)
    left = 1.0 - 2.0 * float(kernel.max()) + float(kernel @ kernel)
    of_digits = float(np.diff(np.unique(signal)).min()) / math.sqrt(12.0)  # a coarse recorder is silent at rest
    return max(1.4826 * float(np.median(removed)) / math.sqrt(left), of_digits)  # of a normal distribution


def _vertex(signal: Floats, top: int, weights: Floats, noise: float) -> tuple[float, float]:
    """Place of a peak, and its standard error, in samples; the signal is a sum of noisy samples times weights."""
    left, middle, right = signal[top - 1 : top + 2]
    difference = np.convolve(weights, (1.0, 0.0, -1.0))
    return top + parabola_vertex(signal, top), 0.5 * noise * float(np.linalg.norm(difference)) / (
        2 * middle - left - right
    )


def _rise(signal: Floats, top: int, kernel: Floats, noise: float) -> tuple[float, float]:
    """Place of the last rise through a tenth of a peak, and its standard error, in samples."""
    level = 0.1 * signal[top]  # Viggiani and Atkinson 1995, doi:10.1680/geot.1995.45.1.149
    below = np.flatnonzero(signal[:top] < level)
    slope = signal[below[-1] + 1] - signal[below[-1]]
    error = noise * float(np.linalg.norm(kernel)) * math.hypot(1.0, 0.1) / slope
    return below[-1] + (level - signal[below[-1]]) / slope, error
