"""Peaks of a signal, in plain arithmetic.

Results equal those of `scipy.signal` to the last bit; loading it takes longer than starting a campaign.
"""

import numpy as np

from calcidem.dem.kernels.layout import Floats, Integers


def find_maxima(signal: Floats) -> Integers:
    """Samples of the local maxima of a signal (T,), in order; of a plateau the middle, rounded down."""
    changes = (signal[1:] != signal[:-1]).nonzero()[0]
    begin, end = np.concatenate([[0], changes + 1]), np.concatenate([changes, [len(signal) - 1]])
    level = signal[begin]
    above = (level[1:-1] > level[:-2]) & (level[1:-1] > level[2:])
    return np.asarray((begin[1:-1][above] + end[1:-1][above]) // 2)


def parabola_vertex(signal: Floats, index: int) -> float:
    """Return the vertex of the parabola through a peak and its neighbours, in samples from the peak."""
    left, middle, right = (float(value) for value in signal[index - 1 : index + 2])
    curvature = left - 2.0 * middle + right
    return 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
