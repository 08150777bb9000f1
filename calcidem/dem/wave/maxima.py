"""Local maxima of a signal and their widths, in plain arithmetic.

They are what `scipy.signal` calls peaks and widths, to the last bit; it takes longer to load than a campaign to start.
"""

import numpy as np

from calcidem.dem.kernels.layout import Floats, Integers


def find_maxima(signal: Floats) -> Integers:
    """Samples of the local maxima of a signal (T,), in order; of a level one the middle, or the one before it."""
    changes = (signal[1:] != signal[:-1]).nonzero()[0]
    begin, end = np.concatenate([[0], changes + 1]), np.concatenate([changes, [len(signal) - 1]])
    level = signal[begin]
    above = (level[1:-1] > level[:-2]) & (level[1:-1] > level[2:])
    return np.asarray((begin[1:-1][above] + end[1:-1][above]) // 2)


def falls_through(signal: Floats, peak: int, level: float) -> tuple[float, float]:
    """Where a signal falls through a level on either side of a peak, in samples; its ends where it does not."""
    low = signal <= level
    left = peak - int(low[peak::-1].argmax()) if low[: peak + 1].any() else 0
    right = peak + int(low[peak:].argmax()) if low[peak:].any() else len(signal) - 1
    before, behind = float(left), float(right)
    if signal[left] < level:
        before += float((level - signal[left]) / (signal[left + 1] - signal[left]))
    if signal[right] < level:
        behind -= float((level - signal[right]) / (signal[right - 1] - signal[right]))
    return before, behind


def parabola_vertex(signal: Floats, index: int) -> float:
    """Return where the parabola through a peak and its neighbours is highest, in samples from the peak."""
    left, middle, right = (float(value) for value in signal[index - 1 : index + 2])
    curvature = left - 2.0 * middle + right
    return 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
