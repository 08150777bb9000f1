"""Where a mean, a standard deviation or one further sample lies.

Every function takes the values of one sample, shape (n,), finite and independent, in any unit, and returns an
`Interval` in the same unit. Its docstring names the assumption it rests on. Where an interval is undefined
(too few values) both ends are NaN. All values equal (the uncemented sample is the same for every seed) is no
error: the interval then has no width.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import scipy  # whose parts load when they are used: commands that answer at once and ranks need none of them
from numpy.typing import NDArray

BOOTSTRAP_SEED = 20_240_501
"""Resampling draws the same numbers in every run, so that a report can be reproduced to the last digit."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A closed interval.

    Attributes
    ----------
    low, high
        The two ends, in the unit of the quantity; NaN where the interval is undefined.
    """

    low: float
    high: float

    @property
    def half_width(self) -> float:
        """Half the distance between the ends."""
        return (self.high - self.low) / 2

    def contains(self, value: float) -> bool:
        """Say whether `value` lies between the ends, which belong to the interval."""
        return self.low <= value <= self.high


_LAST_STEP = 1e-14
"""Relative size of the step with which Newton's method ends: rounding alone."""

_FEWEST_FOR_KURTOSIS = 8
"""Below this the kurtosis of a sample is too uncertain to correct an interval for it."""

UNDEFINED = Interval(math.nan, math.nan)


def mean_interval(values: NDArray[np.float64], level: float = 0.95) -> Interval:
    """Give the confidence interval of the mean by Student's t, exact for normal values."""
    return _around_mean(values, level, lambda n: 1 / n)


def standard_deviation_interval(values: NDArray[np.float64], level: float = 0.95) -> Interval:
    """Give the confidence interval of the standard deviation: by chi-square below 8 values, by Bonett from there on.

    Chi-square is exact for normal values and misses more often the more the kurtosis exceeds 3, however large n is. The
    other is corrected for the sample's kurtosis (Bonett 2006, doi:10.1016/j.csda.2004.10.003). A percentile or BCa
    bootstrap of a few values covers far less than it promises: 57 % instead of 95 % of four normal values.
    """
    n = values.size
    if n <= 1:
        return UNDEFINED
    deviation = float(standard_deviation(values))
    if deviation == 0:
        return Interval(0.0, 0.0)
    if n < _FEWEST_FOR_KURTOSIS:
        tail = (1 - level) / 2
        low, high = np.sqrt((n - 1) / scipy.stats.chi2.ppf([1 - tail, tail], n - 1))
        return Interval(deviation * float(low), deviation * float(high))
    quantile = float(scipy.stats.norm.ppf((1 + level) / 2))
    trimmed = scipy.stats.trim_mean(values, 1 / (2 * math.sqrt(n - 4)))
    kurtosis = n * np.sum((values - trimmed) ** 4) / ((n - 1) * deviation**2) ** 2
    correction = n / (n - quantile)
    error = correction * math.sqrt(max(kurtosis - (n - 3) / n, 0.0) / (n - 1))
    low, high = np.sqrt(correction * np.exp([-quantile * error, quantile * error]))
    return Interval(deviation * float(low), deviation * float(high))


def prediction_interval(values: NDArray[np.float64], level: float = 0.95) -> Interval:
    """Give the interval in which one new value falls with probability `level`, if the values are normal.

    mean -/+ t s sqrt(1 + 1/n), with t the quantile of Student's distribution with n - 1 degrees of freedom.
    """
    return _around_mean(values, level, lambda n: 1 + 1 / n)


def difference_interval(values: NDArray[np.float64], references: NDArray[np.float64], level: float = 0.95) -> Interval:
    """Give the confidence interval of the mean of one sample less that of another one; the variances may differ.

    Welch (1947), doi:10.1093/biomet/34.1-2.28.
    """
    if min(values.size, references.size) <= 1:
        return UNDEFINED
    centre = float(mean(values) - mean(references))
    parts = [float(standard_deviation(sample)) ** 2 / sample.size for sample in (values, references)]
    variance = sum(parts)
    if variance == 0:
        return Interval(centre, centre)
    freedom = variance**2 / (parts[0] ** 2 / (values.size - 1) + parts[1] ** 2 / (references.size - 1))
    half = float(scipy.special.stdtrit(freedom, (1 + level) / 2)) * math.sqrt(variance)
    return Interval(centre - half, centre + half)


def _around_mean(values: NDArray[np.float64], level: float, variance: Callable[[int], float]) -> Interval:
    """Interval of Student's t around the mean, of a variance in units of that of the values."""
    n = values.size
    if n <= 1:
        return UNDEFINED
    half = _student_quantile(n - 1, (1 + level) / 2) * float(standard_deviation(values)) * math.sqrt(variance(n))
    centre = float(mean(values))
    return Interval(centre - half, centre + half)


def _student_quantile(freedom: int, probability: float) -> float:
    """Quantile of Student's t: that of `scipy.special.stdtrit`, which takes longer to load than a status to show.

    Newton's method begins at the normal quantile, which is smaller. From there on the distribution is concave, so that
    no step goes beyond the quantile.

    Parameters
    ----------
    freedom
        Degrees of freedom, a whole number of 1 or more.
    probability
        From 0.5 to below 1.

    Notes
    -----
    Abramowitz and Stegun (1964), 26.7.3 and 26.7.4.
    """
    quantile, odd = NormalDist().inv_cdf(probability), freedom % 2
    k = np.arange(1, (freedom - odd) // 2)
    ratios = 2 * k / (2 * k + 1) if odd else (2 * k - 1) / (2 * k)
    scale = math.lgamma((freedom + 1) / 2) - math.lgamma(freedom / 2) - math.log(freedom * math.pi) / 2
    step = math.inf
    while step > _LAST_STEP * quantile:
        angle = math.atan(quantile / math.sqrt(freedom))
        sine, cosine = math.sin(angle), math.cos(angle)
        series = 1.0 + float(np.sum(np.cumprod(ratios * cosine**2)))
        central = 2 / math.pi * (angle + (freedom > 1) * sine * cosine * series) if odd else sine * series
        density = math.exp(scale - (freedom + 1) / 2 * math.log1p(quantile**2 / freedom))
        step = (2 * probability - 1 - central) / (2 * density)
        quantile += step
    return quantile


def ordered_prediction_interval(values: NDArray[np.float64], level: float = 0.95) -> Interval:
    """Give a prediction interval for one new value that assumes no distribution, and holds at least `level`.

    A new value falls between the j-th smallest and the j-th largest of n with probability (n + 1 - 2 j) / (n + 1); the
    largest j that still gives `level` is taken (Wilks 1941, doi:10.1214/aoms/1177731788). Undefined below
    n = 2 / (1 - level) - 1 (39 values for 95 %).
    """
    n = values.size
    rank = math.floor((1 - level) * (n + 1) / 2 + 1e-9)  # 0.05 * 40 / 2 must give 1 in spite of round-off
    if rank < 1:
        return UNDEFINED
    ordered = np.sort(values)
    return Interval(float(ordered[rank - 1]), float(ordered[n - rank]))


def mean(values: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
    """Give the mean along an axis; of equal values exactly that value."""
    first = np.take(values, 0, axis)
    return np.asarray(first + np.mean(values - np.expand_dims(first, axis), axis=axis))


def standard_deviation(values: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
    """Give the standard deviation along an axis, with n - 1 in the denominator; of equal values exactly zero."""
    first = np.take(values, [0], axis)
    return np.asarray(np.std(values - first, axis=axis, ddof=1))
