"""Tops of a signal, how far they stand out, and how broad they are, in plain arithmetic.

They are what `scipy.signal` calls peaks, prominences and widths, to the last bit; it takes longer to load than a
campaign to start.
"""

import numpy as np

from calcidem.dem.kernels.layout import Floats, Integers


def find_tops(signal: Floats) -> Integers:
    """Samples of the local maxima of a signal (T,), in order; of a level one the middle, or the one before it."""
    changes = (signal[1:] != signal[:-1]).nonzero()[0]
    begin, end = np.concatenate([[0], changes + 1]), np.concatenate([changes, [len(signal) - 1]])
    level = signal[begin]
    above = (level[1:-1] > level[:-2]) & (level[1:-1] > level[2:])
    return np.asarray((begin[1:-1][above] + end[1:-1][above]) // 2)


def prominence(signal: Floats, top: int) -> float:
    """Height of a top over the higher of the deepest points on either side, as far as nothing there is higher."""
    height = signal[top]
    higher = signal > height
    # Distances to the nearest higher samples, 0 where there is none: the top is not higher than itself.
    before, behind = int(higher[top::-1].argmax()), int(higher[top:].argmax())
    left = signal[top + 1 - before if before else 0 : top + 1].min()
    right = signal[top : top + behind if behind else len(signal)].min()
    return float(height - max(left, right))


def half_height(signal: Floats, top: int) -> tuple[int, int]:
    """Samples before and behind a top to where a signal is first below half of its height, or to its ends."""
    low = signal < 0.5 * signal[top]
    before, behind = low[:top][::-1], low[top:]
    return (
        int(before.argmax()) if before.any() else len(before),
        int(behind.argmax()) if behind.any() else len(behind),
    )


def half_width(signal: Floats, top: int) -> tuple[float, float]:
    """Where a signal falls through half of a top's prominence, before it and behind it, in samples."""
    return falls_through(signal, top, float(signal[top] - 0.5 * prominence(signal, top)))


def falls_through(signal: Floats, top: int, level: float) -> tuple[float, float]:
    """Where a signal falls through a level on either side of a top, in samples; it does."""
    low = signal <= level
    left = top - int(low[top::-1].argmax())
    right = top + int(low[top:].argmax())
    before, behind = float(left), float(right)
    if signal[left] < level:
        before += float((level - signal[left]) / (signal[left + 1] - signal[left]))
    if signal[right] < level:
        behind -= float((level - signal[right]) / (signal[right - 1] - signal[right]))
    return before, behind


def find_high_tops(view: Floats, least: float) -> list[int]:
    """Samples of the tops that are at least so high."""
    tops = find_tops(view)
    return [int(top) for top in tops[view[tops] >= least]]


def parabola_vertex(signal: Floats, index: int) -> float:
    """Return where the parabola through a peak and its neighbours is highest, in samples from the peak."""
    left, middle, right = (float(value) for value in signal[index - 1 : index + 2])
    curvature = left - 2.0 * middle + right
    return 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
