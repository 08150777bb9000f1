"""Vs at each calcite content: counts of cells, distribution and normality (sections 2.4 and 3.2 of the paper).

Also what changes them: a setting, for the same seeds, and the number of seeds.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Self

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from calcidem.analysis.intervals import (
    BOOTSTRAP_SEED,
    UNDEFINED,
    Interval,
    bounds_of_deviation,
    mean,
    mean_half_width,
    standard_deviation,
)
from calcidem.analysis.velocity import ErrorBudget, are_samples, error_budget
from calcidem.ends import CellStatus
from calcidem.storage.records import NOT_PLANNED, STATUS_CODES


def name_outcomes(codes: xr.DataArray) -> xr.DataArray:
    """Outcome of each cell as text along (seed, content), from its `STATUS_CODES`; empty if it has none yet."""
    names = np.full(max(STATUS_CODES.values()) + 1, "", dtype=object)
    for name, code in STATUS_CODES.items():
        if name != CellStatus.PENDING:
            names[code] = str(name)
    return xr.DataArray(names[codes.to_numpy()], codes.coords, codes.dims)


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
    """Interval for one new sample, for normal values."""

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
        centre = mean(sample) if sample.size else math.nan
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
    """Number of planned cells that are not computed yet."""
    failed: int
    """Number of cells computed without a usable velocity."""
    vs: Distribution
    """Distribution of the measured velocities, in m/s."""
    budget: ErrorBudget
    """Errors of these velocities."""


def describe_contents(cells: xr.Dataset, level: float = 0.95) -> tuple[ContentDistribution, ...]:
    """Describe the velocities of the distinct samples at every content of a campaign, and count the cells without one.

    A cell that was not computed yet carries no information about Vs. A failed cell may, since the arrival of slow
    samples is hard to pick. The two are therefore never added. Without cement all seeds are one sample and count once;
    the error of its velocity gives its interval.

    The cells have `BUDGET_QUANTITIES` and the status (`STATUS_CODES`) along seed and content, else `ValueError`.
    """
    found = []
    for content in cells["content"].to_numpy().tolist():
        here = cells.sel(content=content).transpose("seed")
        column, outcome = here["vs"].to_numpy(), name_outcomes(here["status"]).to_numpy()
        counted = are_samples(column, content)
        described = Distribution.of_sample(column[counted], level)
        missing = int(np.sum(outcome == ""))
        failed = int(np.sum(~np.isin(outcome, ("", "done", NOT_PLANNED))))
        if content == 0.0:  # the best outcome of any seed counts
            failed = int(failed > 0 and not counted.any())
            missing = int(missing > 0 and not failed and not counted.any())
            if counted.any():
                interval = Interval.of_velocity(described.mean, float(here["vs_error"][counted][0]), level)
                described = replace(described, mean_interval=interval)
        found.append(ContentDistribution(content, missing, failed, described, error_budget(here)))
    return tuple(found)


def tabulate(distributions: tuple[ContentDistribution, ...]) -> xr.Dataset:
    """Arrange distributions of contents as a table: a variable with units for each number.

    Errors of the velocities are those of `ErrorBudget`. Intervals have a further dimension `bound`.
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
    median = "median relative standard error of vs"
    for name, part, units, meaning in (
        ("vs_error", "total", "1", median),
        ("reading_error", "reading", "1", f"{median} by the reading"),
        ("numerical_error", "numerical", "1", f"{median} by the simulation"),
        ("pulse_effect", "pulse", "1", f"{median} by the pulse"),
        ("reading_scatter", "scatter", "m/s", "root mean square of the reading errors"),
    ):
        values = [getattr(row.budget, part) for row in distributions]
        table[name] = "content", values, {"units": units, "long_name": meaning}
    return table


def narrowing(values: ArrayLike, counts: Sequence[int]) -> xr.Dataset:
    """Forecast the half-widths of 95 % intervals of mean, standard deviation and skewness for at least 3 seeds.

    They are along `count`, the first two in the unit of the values (n,); NaN are left out. That of the mean is
    t s / sqrt(count). That of the standard deviation is the mean of `Interval.of_standard_deviation` over samples of
    `count` of the values, drawn with replacement. That of skewness is half the width of the central 95 % over such
    samples; few values underestimate it, since it depends on rare ones. `ValueError` for fewer than two values, or a
    count below 3.
    """
    sample = np.asarray(values, dtype=np.float64)
    sample = sample[np.isfinite(sample)]
    if sample.size <= 1:
        raise ValueError(f"{sample.size} values are not NaN; a standard deviation needs at least two")
    if min(counts, default=3) < 3:  # fewer values always have the same skewness
        raise ValueError(f"counts holds {min(counts)}; a standard deviation and a skewness need at least 3 seeds")
    deviation = float(standard_deviation(sample))
    level, generator = 0.95, np.random.default_rng(BOOTSTRAP_SEED)
    ends = [(1 - level) / 2, (1 + level) / 2]
    centre, spread, skew = [], [], []
    for count in counts:
        resampled = sample[generator.integers(sample.size, size=(2000, count))]
        varied = resampled[np.ptp(resampled, axis=1) > 0]  # equal values have no skewness
        centre.append(mean_half_width(deviation, count, level))
        spread.append(np.mean(np.diff(bounds_of_deviation(resampled[:500], level), axis=0)) / 2)
        skew.append(np.ptp(np.quantile(stats.skew(varied, axis=1), ends)) / 2 if len(varied) else math.nan)
    return xr.Dataset(
        {"mean": ("count", centre), "standard_deviation": ("count", spread), "skewness": ("count", skew)},
        coords={"count": list(counts)},
        attrs={"level": level, "present": sample.size},
    )


@dataclass(frozen=True, slots=True)
class Change:
    """Comparison of a variant with the same seeds of the reference at one content."""

    content: float
    """Percent."""
    planned: int
    measured: int
    """Number of cells of the variant, and of those with a velocity."""
    mean: float
    standard_deviation: float
    """Of all measured cells of the variant, m/s."""
    mean_ratio: float
    deviation_ratio: float
    """Mean and standard deviation over those of the reference, for seeds with a velocity in both."""
    deviation_ratio_interval: Interval
    """Bootstrap interval of the deviation ratio; the same seeds are drawn with replacement on both sides. With fewer
    than 20 seeds about 90 % of the intervals of 95 % hold the true ratio.
    """


def paired_changes(variant: xr.DataArray, reference: xr.DataArray) -> tuple[Change, ...]:
    """Compare two matrices of Vs (m/s) along (seed, content), NaN if missing, on their common seeds.

    Contents that the reference lacks are left out.
    """
    first, second = xr.align(variant, reference, join="inner")
    changes = []
    for content in first["content"].to_numpy().tolist():
        own = variant.sel(content=content).to_numpy()
        pair = np.stack([first.sel(content=content).to_numpy(), second.sel(content=content).to_numpy()])
        measured = own[np.isfinite(own)]
        mean_ratio, deviation_ratio, interval = _paired_ratios(pair[:, np.isfinite(pair).all(axis=0)])
        changes.append(
            Change(
                content=content,
                planned=own.size,
                measured=measured.size,
                mean=float(measured.mean()) if measured.size else math.nan,
                standard_deviation=float(standard_deviation(measured)) if measured.size > 1 else math.nan,
                mean_ratio=mean_ratio,
                deviation_ratio=deviation_ratio,
                deviation_ratio_interval=interval,
            )
        )
    return tuple(changes)


def _paired_ratios(pair: np.ndarray) -> tuple[float, float, Interval]:
    """Ratios of means and of standard deviations of two rows of equal seeds, (2, n); 95 % interval of the latter."""
    count = pair.shape[1]
    if count < 4:  # common seeds, for a meaningful ratio of standard deviations
        return math.nan, math.nan, UNDEFINED
    mean_ratio, (own, reference) = float(np.divide(*pair.mean(axis=1))), standard_deviation(pair)
    if not reference > 0.0:  # without cement
        return mean_ratio, math.nan, UNDEFINED
    drawn = pair[:, np.random.default_rng(BOOTSTRAP_SEED).integers(0, count, (4000, count))]
    with np.errstate(divide="ignore", invalid="ignore"):
        deviations = np.divide(*standard_deviation(drawn))
    ratio, finite = float(own / reference), deviations[np.isfinite(deviations)]
    low, high = np.quantile(finite, [(1 - 0.95) / 2, (1 + 0.95) / 2]).tolist()
    return mean_ratio, ratio, Interval(low, high)
