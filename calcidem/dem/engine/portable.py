"""Elementary functions with identical bits on every processor.

NumPy and the C library select their sine, arcsine or power by processor (SIMD width, FMA). The results differ in the
last bit, and in a chaotic packing such a difference leads to another sample. IEEE 754 fixes ``+ - * /`` and the square
root to the last bit. Functions that use only these, in a fixed order, therefore agree on every processor. Stored
numbers that are exact depend only on such lengths, powers, angles and sums of products: no BLAS, no LAPACK, no FFT.
NumPy sums a contiguous array in a fixed (pairwise) order, which a test checks.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from calcidem.dem.kernels.layout import Floats, Integers


def length(x: Floats, y: Floats) -> Floats:
    """Length of vectors, ``sqrt(x^2 + y^2)``, to 1 unit in the last place; squares must not over- or underflow."""
    return np.asarray(np.sqrt(x * x + y * y))


def three_halves(value: Floats) -> Floats:
    """Power 1.5 of non-negative values, to 1.5 units in the last place."""
    return np.asarray(value * np.sqrt(value))


def root(value: Floats, degree: int) -> Floats:
    """Root of small degree of non-negative values, to 2 units in the last place.

    Newton's iteration starts from a straight line over one power of two; 6 steps suffice up to degree 5.
    """
    part, exponent = np.frexp(np.asarray(value, dtype=float))
    whole = -(-exponent // degree)
    rest = np.ldexp(part, exponent - degree * whole)  # between 2^-degree and 1; the other factor is exact
    estimate = 0.5 + 0.5 * rest
    for _ in range(6):
        power = estimate
        for _ in range(degree - 2):
            power = power * estimate
        estimate = ((degree - 1) * estimate + rest / power) / degree
    return np.asarray(np.where(part > 0.0, np.ldexp(estimate, whole), 0.0))


def _horner(coefficients: Sequence[float], x: Floats) -> Floats:
    """Polynomial in x, coefficients in ascending order of powers."""
    total = x * coefficients[-1]
    for coefficient in coefficients[-2:0:-1]:
        total += coefficient
        total *= x
    return np.asarray(total + coefficients[0])


def sine_of_turns(turns: npt.ArrayLike) -> Floats:
    """``sin(2 pi t)`` of a number of turns t from -1 to 1, to 2 units in the last place; exact at multiples of 1/4."""
    t = np.asarray(turns, dtype=float)
    size = np.abs(t)
    # Each of these differences is exact in its range.
    half = np.where(size > 0.5, size - 0.5, size)  # half a turn
    quarter = np.where(half > 0.25, 0.5 - half, half)  # a quarter
    beyond = quarter > 0.125  # an eighth
    angle = 2.0 * np.pi * np.where(beyond, 0.25 - quarter, quarter)
    square = angle * angle
    sine = angle + angle * square * _horner(_SINE, square)
    cosine = 1.0 - 0.5 * square + square * square * _horner(_COSINE, square)
    result = np.where(beyond, cosine, sine)
    return np.asarray(np.where((size > 0.5) != (t < 0.0), -result, result))  # half a turn


def cosine_and_sine(turns: npt.ArrayLike) -> tuple[Floats, Floats]:
    """``cos(2 pi t)`` and ``sin(2 pi t)`` of any number of turns t, to 2 units in the last place of t's fraction."""
    part = np.asarray(turns, dtype=float)
    part = part - np.floor(part)
    return sine_of_turns(part - np.where(part > 0.75, 0.75, -0.25)), sine_of_turns(part)


def exponential(value: npt.ArrayLike) -> Floats:
    """``exp(x)``, to 2 units in the last place; x from -700 to 700.

    The argument is reduced to half of ln 2 on either side; the product of its leading bits is exact.
    """
    x = np.asarray(value, dtype=float)
    power = np.rint(x * 1.4426950408889634)  # 1 / ln 2
    rest = (x - power * 0.693145751953125) - power * 1.4286068203094173e-6  # ln 2 in two parts
    return np.asarray(np.ldexp(1.0 + rest * _horner(_EXPONENTIAL, rest), power.astype(int)))


def arc_sine(value: npt.ArrayLike) -> Floats:
    """Arcsine in [0, pi / 2] of values in [0, 1], to 3 units in the last place.

    Power series up to 1/2, ``pi / 2 - 2 arcsin(sqrt((1 - x) / 2))`` above.
    """
    x = np.asarray(value, dtype=float)
    large = x > 0.5  # as above
    reduced = np.where(large, np.sqrt(np.maximum(0.5 * (1.0 - x), 0.0)), x)
    square = reduced * reduced
    angle = reduced + reduced * square * _horner(_ARC, square)
    return np.asarray(np.where(large, np.pi / 2.0 - 2.0 * angle, angle))


def tangent_of_degrees(degrees: float) -> float:
    """Tangent of an angle in [0, 90) degrees, to a relative error of 1e-13."""
    turns = degrees / 360.0
    return float(sine_of_turns(turns) / sine_of_turns(0.25 - turns))


def interpolate(x: float, places: Sequence[float], values: Sequence[float]) -> float:
    """Linear interpolation in a table of increasing places; constant beyond its ends."""
    if x <= places[0]:
        return float(values[0])
    for left, right, low, high in zip(places[:-1], places[1:], values[:-1], values[1:], strict=True):
        if x < right:
            return float(low + (high - low) * ((x - left) / (right - left)))
    return float(values[-1])


def sliding_products(signal: Floats, weights: Floats) -> Floats:
    """Sliding dot product of weights with a signal (T, ...), at each place where the weights fit."""
    places = len(signal) - len(weights) + 1
    total: Floats = np.zeros((max(0, places), *signal.shape[1:]))
    product = np.empty_like(total)
    for shift, weight in enumerate(weights.tolist()):
        np.multiply(signal[shift : shift + places], weight, out=product)
        total += product
    return total


def find_maxima(signal: Floats) -> Integers:
    """Samples of the local maxima of a signal (T,), in order; of a plateau the middle, rounded down.

    Those of `scipy.signal`, whose loading takes longer than starting a campaign.
    """
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


# Series to a remainder below 1e-17: of sine and cosine at an eighth of a turn, of the arcsine at 1/2, of the
# exponential at half of ln 2.
_SINE = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(1, 9))
_COSINE = tuple((-1) ** k / math.factorial(2 * k) for k in range(2, 10))
_ARC = tuple(math.comb(2 * k, k) / (4**k * (2 * k + 1)) for k in range(1, 27))
_EXPONENTIAL = tuple(1.0 / math.factorial(k + 1) for k in range(15))
