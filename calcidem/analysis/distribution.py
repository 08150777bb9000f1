"""Vs at each calcite content: its distribution and normality (sections 2.4 and 3.2 of the paper)."""

import math
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Self

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from calcidem.analysis.error_budget import are_samples, error_budget
from calcidem.analysis.intervals import (
    Interval,
    mean,
    standard_deviation,
)
from calcidem.analysis.outcomes import arrange_matrix, count_outcomes


def normality_of_moments(n: int, skewness: float, kurtosis: float) -> tuple[float, float, float]:
    """Jarque-Bera test of a sample of n values from its population moments, Eqs. 6 and 7, such as those of a table.

    Returns the statistic (Eq. 5), its p-value from the chi-square distribution with 2 degrees of freedom, valid for n
    towards infinity, and the p-value among simulated normal samples of the same size, valid for every n. The paper
    calls a sample not normal if the first is below 0.05. NaN if a moment is.

    Jarque and Bera (1987), doi:10.2307/1403192.
    """
    statistic = n * (skewness**2 / 6 + (kurtosis - 3) ** 2 / 24)
    in_the_limit = float(stats.chi2.sf(statistic, 2))
    # From 10,000 values on the limit suffices: the error of p is 0.002 at 0.05, 0.001 at 0.01.
    if math.isnan(statistic) or n >= 10_000:
        return statistic, in_the_limit, in_the_limit
    null = _null_statistics(n)
    # The relative tolerance makes statistics equal despite round-off. The two ones count the sample itself, so p is
    # never zero (Davison and Hinkley 1997, section 4.2).
    at_least = null.size - int(np.searchsorted(null, statistic * (1 - 1e-12)))
    return statistic, in_the_limit, (1 + at_least) / (1 + null.size)


@lru_cache(maxsize=256)
def _null_statistics(n: int) -> NDArray[np.float64]:
    """Draw the sorted statistics (Eq. 5) of normal samples of size n; every call returns the same numbers."""
    generator = np.random.default_rng([19_870_555, n])
    total = 20_000  # samples: a p-value of 0.05 has the standard error 0.0015
    rows = max(1, 2_000_000 // n)  # 16 MB at a time
    parts = []
    for start in range(0, total, rows):
        samples = generator.standard_normal((min(rows, total - start), n))
        # Four times as fast as `scipy.stats.jarque_bera`.
        centred = samples - samples.mean(axis=1, keepdims=True)
        squares = centred * centred
        variance, third = np.mean(squares, axis=1), np.mean(squares * centred, axis=1)
        fourth = np.mean(squares * squares, axis=1)
        parts.append(n * (third**2 / variance**3 / 6 + (fourth / variance**2 - 3) ** 2 / 24))
    null = np.sort(np.concatenate(parts))
    null.flags.writeable = False
    return null


@dataclass(frozen=True, slots=True)
class Distribution:
    """Estimates of a distribution from a sample of its values."""

    n: int
    """Number of values."""
    mean: float
    standard_deviation: float
    """The deviation has the denominator n - 1."""
    skewness: float
    kurtosis: float
    """Population moments, Eqs. 6 and 7 (0 and 3 for a normal distribution)."""
    jarque_bera: float
    p_asymptotic: float
    p_small_sample: float
    """Test of normality, see `normality_of_moments`."""
    mean_interval: Interval
    """Confidence interval of the mean by Student's t."""
    standard_deviation_interval: Interval
    """Confidence interval of the standard deviation, see `Interval.of_standard_deviation`."""
    prediction_interval: Interval
    prediction_interval_ordered: Interval
    """Interval for one new sample, for normal values and without this assumption from the ordered values."""
    normal_fit_largest_distance: float
    """Largest distance between the sample's cumulative distribution and the normal one with its mean and deviation
    (Kolmogorov's statistic, between 0 and 1).
    """

    @classmethod
    def of_sample(cls, values: ArrayLike, level: float = 0.95) -> Self:
        """Describe one sample of finite values (n,), with intervals at a level; `ValueError` for other shapes or NaN.

        Results that are undefined for few or equal values are NaN.
        """
        sample = np.asarray(values, dtype=np.float64)
        if sample.ndim != 1 or not np.isfinite(sample).all():
            raise ValueError(
                f"values must be finite numbers along one dimension, got shape {sample.shape}; drop NaN first"
            )
        centre = float(mean(sample)) if sample.size else math.nan
        deviation = float(standard_deviation(sample)) if sample.size > 1 else math.nan
        varied = deviation > 0
        skewness = float(stats.skew(sample)) if varied else math.nan
        kurtosis = float(stats.kurtosis(sample, fisher=False)) if varied else math.nan
        statistic, p_asymptotic, p_small_sample = normality_of_moments(sample.size, skewness, kurtosis)
        return cls(
            n=sample.size,
            mean=centre,
            standard_deviation=deviation,
            skewness=skewness,
            kurtosis=kurtosis,
            jarque_bera=statistic,
            p_asymptotic=p_asymptotic,
            p_small_sample=p_small_sample,
            mean_interval=Interval.of_mean(sample, level),
            standard_deviation_interval=Interval.of_standard_deviation(sample, level),
            prediction_interval=Interval.of_prediction(sample, level),
            prediction_interval_ordered=Interval.of_ordered_prediction(sample, level),
            normal_fit_largest_distance=(
                float(stats.kstest(sample, stats.norm(centre, deviation).cdf).statistic) if varied else math.nan
            ),
        )

    def normal_density(self, values: ArrayLike) -> NDArray[np.float64]:
        """Probability density at values of the normal distribution with this mean and deviation, in inverse units."""
        return np.asarray(stats.norm.pdf(np.asarray(values, dtype=np.float64), self.mean, self.standard_deviation))


@dataclass(frozen=True, slots=True)
class ContentDistribution:
    """Distribution at one calcite content, and numbers of cells without a velocity."""

    content: float
    """Calcite content in percent of sand mass."""
    missing: int
    """Number of cells not computed."""
    failed: int
    """Number of cells computed without a usable velocity."""
    vs: Distribution
    """Distribution of the measured velocities, in m/s."""


def describe_contents(
    vs: xr.DataArray, status: xr.DataArray | None = None, level: float = 0.95, error: xr.DataArray | None = None
) -> tuple[ContentDistribution, ...]:
    """Describe the velocities of the distinct samples at every content of a campaign.

    Arguments and errors of `count_outcomes`; ``error`` has the relative standard errors of the velocities. That of the
    one sample without cement gives its interval.
    """
    counts = count_outcomes(vs, status)
    columns = arrange_matrix(vs).to_numpy().T
    errors = np.full_like(columns, np.nan) if error is None else arrange_matrix(error).to_numpy().T
    return tuple(
        ContentDistribution(
            content=float(content),
            missing=int(missing),
            failed=int(failed),
            vs=_describe_content(content, column, of_column, level),
        )
        for content, missing, failed, column, of_column in zip(
            vs["content"].to_numpy(),
            counts["missing"].to_numpy(),
            counts["failed"].to_numpy(),
            columns,
            errors,
            strict=True,
        )
    )


def _describe_content(
    content: float, vs: NDArray[np.float64], error: NDArray[np.float64], level: float
) -> Distribution:
    """Distribution of the distinct samples of a content."""
    counted = are_samples(vs, content)
    found = Distribution.of_sample(vs[counted], level)
    if content > 0.0 or not counted.any():
        return found
    return replace(found, mean_interval=Interval.of_velocity(found.mean, float(error[counted][0]), level))


def tabulate(distributions: tuple[ContentDistribution, ...]) -> xr.Dataset:
    """Arrange distributions of contents as a table: a variable with units for each number of `Distribution`.

    Intervals have a further dimension `bound`.
    """
    table = xr.Dataset(coords={"content": [row.content for row in distributions], "bound": ["low", "high"]})
    table["content"].attrs = {"units": "%", "long_name": "calcite content by sand mass"}
    table["missing"] = "content", [row.missing for row in distributions]
    table["failed"] = "content", [row.failed for row in distributions]
    for name in (field.name for field in fields(Distribution)):
        values = [getattr(row.vs, name) for row in distributions]
        if values and isinstance(values[0], Interval):
            table[name] = ("content", "bound"), [(value.low, value.high) for value in values]
        else:
            table[name] = "content", values
        units = "m/s" if name.startswith(("mean", "standard_deviation", "prediction")) else "1"
        table[name].attrs = {"units": units, "long_name": name.replace("_", " ")}
    return table


def budget_dataset(cells: xr.Dataset) -> xr.Dataset:
    """Arrange the error budgets of the contents of a campaign along content."""
    budgets = [error_budget(cells.sel(content=content)) for content in cells["content"]]
    named = {
        "vs_error": ("1", "median relative standard error of vs", [one.total for one in budgets]),
        "reading_error": ("1", "median relative standard error of vs by the reading", [one.reading for one in budgets]),
        "numerical_error": (
            *("1", "median relative standard error of vs by the simulation"),
            [one.numerical for one in budgets],
        ),
        "reading_scatter": ("m/s", "root mean square of the reading errors", [one.scatter for one in budgets]),
        "pulse_effect": ("1", "median relative standard error of vs by the pulse", [one.pulse for one in budgets]),
    }
    return xr.Dataset(
        {name: ("content", values, {"units": unit, "long_name": text}) for name, (unit, text, values) in named.items()},
        coords={"content": cells["content"]},
    )
