"""Number of seeds that a campaign needs: Monte-Carlo error over number of samples."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from calcidem.analysis.intervals import (
    BOOTSTRAP_SEED,
    Interval,
    standard_deviation,
)
from calcidem.analysis.intervals import mean as mean_of


@dataclass(frozen=True, slots=True)
class SeedPlan:
    """Number of seeds for a requested confidence interval of a mean."""

    half_width: float
    """Requested half-width, in the unit of the values."""
    present: int
    present_half_width: float
    """Present seeds with a velocity, and their half-width."""
    unreadable: int
    """Seeds without a readable velocity."""
    needed: int
    """Total seeds with a velocity needed, for the measured standard deviation."""
    needed_low: int
    needed_high: int
    """The same at both ends of the confidence interval of the standard deviation."""

    @property
    def more(self) -> int:
        """Seeds still to be computed, if the same share as so far gives no velocity."""
        return math.ceil(max(0, self.needed - self.present) * (self.present + self.unreadable) / self.present)

    @classmethod
    def of_values(cls, values: ArrayLike, half_width: float, level: float = 0.95, unreadable: int = 0) -> Self:
        """Plan the seeds of one content from its values (n,), without NaN, and its seeds without a velocity.

        ``level`` applies to the planned interval and to the interval of the deviation, which gives the range of the
        plan. `ValueError` for fewer than two values, or if the half-width, in their unit, is not positive.
        """
        sample = _finite_values(values)
        deviation = float(standard_deviation(sample))
        spread = Interval.of_standard_deviation(sample, level)
        return cls(
            half_width=half_width,
            present=sample.size,
            present_half_width=mean_half_width(deviation, sample.size, level),
            unreadable=unreadable,
            needed=_seeds_needed(deviation, half_width, level),
            needed_low=_seeds_needed(spread.low, half_width, level),
            needed_high=_seeds_needed(spread.high, half_width, level),
        )


def _seeds_needed(standard_deviation: float, half_width: float, level: float = 0.95) -> int:
    """Smallest number of seeds for an interval of the mean of at most this half-width, in the unit of the deviation."""
    if not (math.isfinite(standard_deviation) and standard_deviation >= 0):
        raise ValueError(f"standard_deviation is {standard_deviation}; it must be a finite number, not negative")
    if not half_width > 0:
        raise ValueError(f"half_width is {half_width}; it must be positive")
    # The normal quantile gives two or three too few, since Student's is larger.
    quantile = float(stats.norm.ppf((1 + level) / 2))
    n = max(2, math.ceil((quantile * standard_deviation / half_width) ** 2))
    while mean_half_width(standard_deviation, n, level) > half_width:
        n += 1
    return n


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
    centre, deviation = abs(float(mean_of(known))), float(standard_deviation(known))
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


def narrowing(values: ArrayLike, counts: Sequence[int], level: float = 0.95, replicates: int = 2000) -> xr.Dataset:
    """Forecast the half-widths of mean, standard deviation and skewness for at least 3 seeds.

    They are along `count`, the first two in the unit of the values (n,); NaN are left out. That of the mean is
    t s / sqrt(count). The other two are bootstrap results without assumed distribution: half the width of the central
    `level` over samples of `count` values. Few values underestimate the half-width of skewness, which depends on rare
    values. `ValueError` for fewer than two values, or a count below 3.
    """
    sample = _finite_values(values)
    if min(counts, default=3) < 3:  # fewer values always have the same skewness
        raise ValueError(f"counts holds {min(counts)}; a standard deviation and a skewness need at least 3 seeds")
    deviation = float(standard_deviation(sample))
    generator = np.random.default_rng(BOOTSTRAP_SEED)
    mean, spread, skew = [], [], []
    for count in counts:
        resampled = sample[generator.integers(sample.size, size=(replicates, count))]
        varied = resampled[np.ptp(resampled, axis=1) > 0]  # equal values have no skewness
        mean.append(mean_half_width(deviation, count, level))
        spread.append(_half_of_central(np.std(resampled, axis=1, ddof=1), level))
        skew.append(_half_of_central(stats.skew(varied, axis=1), level) if len(varied) else math.nan)
    return xr.Dataset(
        {"mean": ("count", mean), "standard_deviation": ("count", spread), "skewness": ("count", skew)},
        coords={"count": list(counts)},
        attrs={"level": level, "present": sample.size},
    )


def mean_half_width(deviation: float, n: int, level: float) -> float:
    """Half-width of the interval of the mean of n samples, in the unit of the deviation."""
    return float(stats.t.ppf((1 + level) / 2, n - 1)) * deviation / math.sqrt(n)


def _half_of_central(replicates: NDArray[np.float64], level: float) -> float:
    low, high = np.quantile(replicates, [(1 - level) / 2, (1 + level) / 2])
    return float(high - low) / 2


def _finite_values(values: ArrayLike) -> NDArray[np.float64]:
    sample = np.asarray(values, dtype=np.float64)
    sample = sample[np.isfinite(sample)]
    if sample.size <= 1:
        raise ValueError(f"{sample.size} values are not NaN; a standard deviation needs at least two")
    return sample
