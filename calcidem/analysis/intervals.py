"""Intervals of a mean, a standard deviation or one further sample, bias by failed cells, and number of seeds needed.

Every interval takes finite and independent values of one sample, shape (n,), in any unit, and is in the same unit. Its
docstring names its assumption. If an interval is undefined (too few values) both ends are NaN.
"""

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Self

import numpy as np
import scipy  # loads its submodules on use: quick commands and ranks need none of them
from numpy.typing import ArrayLike, NDArray

BOOTSTRAP_SEED = 20_240_501
"""Seed of resampling, which makes reports reproducible to the last digit."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A closed interval, and the intervals of a sample at a level of confidence."""

    low: float
    high: float
    """Ends, in the unit of the quantity; NaN if the interval is undefined."""

    @property
    def half_width(self) -> float:
        """Half the distance between the ends."""
        return (self.high - self.low) / 2

    def contains(self, value: float) -> bool:
        """Return whether `value` lies in the interval, ends included."""
        return self.low <= value <= self.high

    def score(self, value: float, level: float) -> float:
        """Width of an interval plus 2 / (1 - level) times the distance of a value outside; smaller is better.

        Gneiting & Raftery (2007), doi:10.1198/016214506000001437, Eq. 43; its mean is smallest for the true quantiles.
        """
        outside = max(0.0, self.low - value, value - self.high)
        return self.high - self.low + 2.0 / (1.0 - level) * outside

    @classmethod
    def of_mean(cls, values: NDArray[np.float64], level: float = 0.95) -> Self:
        """Return the confidence interval of the mean by Student's t, exact for normal values."""
        return cls._around_mean(values, level, 1.0)

    @classmethod
    def of_velocity(cls, vs: float, error: float, level: float = 0.95) -> Self:
        """Return the interval of one velocity with a relative standard error, for normal errors."""
        half = NormalDist().inv_cdf((1 + level) / 2) * error * vs
        return cls(vs - half, vs + half)

    @classmethod
    def of_standard_deviation(cls, values: NDArray[np.float64], level: float = 0.95) -> Self:
        """Return the confidence interval of the standard deviation: chi-square below 8 values, Bonett from 8 on.

        Chi-square is exact for normal values; for any n its coverage falls as the kurtosis exceeds 3. Bonett's interval
        is corrected for the sample's kurtosis (Bonett 2006, doi:10.1016/j.csda.2004.10.003). A percentile or BCa
        bootstrap of few values has far too little coverage: 57 % instead of 95 % for four normal values.
        """
        if values.size <= 1:
            return cls(math.nan, math.nan)
        low, high = bounds_of_deviation(values, level)
        return cls(float(low), float(high))

    @classmethod
    def of_prediction(cls, values: NDArray[np.float64], level: float = 0.95) -> Self:
        """Return the interval that contains one new value with probability `level`, for normal values.

        It is mean -/+ t s sqrt(1 + 1/n) with the quantile t of Student's distribution with n - 1 degrees of freedom.
        """
        return cls._around_mean(values, level, math.sqrt(1 + values.size))

    @classmethod
    def _around_mean(cls, values: NDArray[np.float64], level: float, factor: float) -> Self:
        """Interval of the mean, wider by a factor."""
        if values.size <= 1:
            return cls(math.nan, math.nan)
        half = factor * mean_half_width(float(standard_deviation(values)), values.size, level)
        centre = mean(values)
        return cls(centre - half, centre + half)


UNDEFINED = Interval(math.nan, math.nan)


def _student_quantile(freedom: int, probability: float) -> float:
    """Quantile of Student's t, as `scipy.special.stdtrit`, which loads too slowly for the status.

    Newton's method starts at the normal quantile, which is smaller. From there on the distribution is concave, so no
    step overshoots the quantile.

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
    while step > 1e-14 * quantile:  # the level of rounding
        angle = math.atan(quantile / math.sqrt(freedom))
        sine, cosine = math.sin(angle), math.cos(angle)
        series = 1.0 + float(np.sum(np.cumprod(ratios * cosine**2)))
        central = 2 / math.pi * (angle + (freedom > 1) * sine * cosine * series) if odd else sine * series
        density = math.exp(scale - (freedom + 1) / 2 * math.log1p(quantile**2 / freedom))
        step = (2 * probability - 1 - central) / (2 * density)
        quantile += step
    return quantile


def mean(values: NDArray[np.float64]) -> float:
    """Return the mean of values (n,); exact for equal values."""
    return float(values[0] + np.mean(values - values[0]))


def standard_deviation(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard deviation along the last axis, with denominator n - 1; exactly zero for equal values."""
    return np.asarray(np.std(values - values[..., :1], axis=-1, ddof=1))


def bounds_of_deviation(samples: NDArray[np.float64], level: float) -> NDArray[np.float64]:
    """Ends (2, ...) of `Interval.of_standard_deviation` of samples (..., n) of at least two values."""
    n, deviation = samples.shape[-1], standard_deviation(samples)
    if n < 8:  # the kurtosis of so few is too uncertain
        tail = (1 - level) / 2
        low, high = np.sqrt((n - 1) / scipy.stats.chi2.ppf([1 - tail, tail], n - 1))
        return np.array([deviation * low, deviation * high])
    quantile = float(scipy.stats.norm.ppf((1 + level) / 2))
    trimmed = np.expand_dims(scipy.stats.trim_mean(samples, 1 / (2 * math.sqrt(n - 4)), axis=-1), -1)
    fourth = n * np.sum((samples - trimmed) ** 4, axis=-1)
    kurtosis = np.divide(fourth, ((n - 1) * deviation**2) ** 2, out=np.zeros_like(fourth), where=deviation > 0)
    correction = n / (n - quantile)
    error = correction * np.sqrt(np.maximum(kurtosis - (n - 3) / n, 0.0) / (n - 1))
    return np.asarray(deviation * np.sqrt(correction * np.exp([-quantile * error, quantile * error])))


def bias_of_failed(measured: int, failed: int) -> float:
    """Largest bias of a mean by failed cells, over the standard deviation of all cells; some are measured, some failed.

    A normal distribution that loses the share p = failed / (measured + failed) at one end has the bias
    ``phi(z) / (1 - p)``, where p lies beyond z (N. L. Johnson et al., Continuous Univariate Distributions 1, 1994,
    section 13.10.1). Failure depends on the signal, so failed cells may be the slowest or the fastest.
    """
    share, normal = failed / (measured + failed), NormalDist()
    return normal.pdf(normal.inv_cdf(share)) / (1.0 - share)


def is_in_doubt(measured: int, failed: int) -> bool:
    """Whether failed cells may bias a mean by more than its standard error, so that its interval is too narrow.

    This starts at 2 failed of 8, 4 of 48 or 5 of 116 cells.
    """
    return failed > 0 and (measured == 0 or bias_of_failed(measured, failed) > 1.0 / math.sqrt(measured))


FEWEST_READ = 0.5
"""Smallest share of seeds with a velocity; below it, more seeds do not determine the mean of all."""


def next_seed_count(values: ArrayLike, most: int, *, mean: float | None = None, sd: float | None = None) -> int:
    """Return the next number of seeds of a content on the way to the requested intervals.

    It stays at the number n of values (NaN if a seed gave none) once the intervals suffice or n reaches `most`.
    Otherwise the present intervals suggest it, up to twice n. The result depends only on the values. If fewer than half
    of the seeds have a value, no more are added. ``mean`` and ``sd`` are the largest relative half-widths of the 95 %
    intervals of mean and standard deviation; None for any.

    Repeated checks favour stopping at an interval that is narrow by chance (Chow & Robbins 1965,
    doi:10.1214/aoms/1177700156). From 8 seeds on it still contains the mean, or the standard deviation, in 93 to 96 %
    of cases (normal and log-normal, sd/mean .05 to .25; tests/analysis/test_planning.py).
    """
    sample = np.asarray(values, dtype=np.float64)
    count, known = sample.size, sample[np.isfinite(sample)]
    if known.size < max(2, FEWEST_READ * count):
        return count
    centre, deviation = abs(float(np.mean(known))), float(standard_deviation(known))
    pairs = ((mean, Interval.of_mean(known), centre), (sd, Interval.of_standard_deviation(known), deviation))
    excess = [
        found.half_width / (wanted * size) if found.half_width else 0.0
        for wanted, found, size in pairs
        if wanted is not None
    ]
    if max(excess) <= 1.0:
        return count
    factor = min(2.0, max(excess) ** 2)
    needed = math.ceil(factor * count / 8) * 8  # to fill the lanes of a batch
    return max(count, min(most, max(count + 1, needed)))


def mean_half_width(deviation: float, n: int, level: float) -> float:
    """Half-width of the interval of the mean of n samples, in the unit of the deviation."""
    return _student_quantile(n - 1, (1 + level) / 2) * deviation / math.sqrt(n)
