"""Shape of the distributions, and what seeds can tell of it: `python docs/reproduction/shapes.py CAMPAIGN.db`."""

import argparse
from collections.abc import Callable

import numpy as np
import xarray as xr
from laws import show_header
from published_check import check_verdicts
from scipy import stats

from calcidem.analysis.distribution import Distribution
from calcidem.analysis.measured import published_study
from calcidem.app.campaign.opened import open_campaign

SIGNIFICANCE = 0.05
NORMAL = float(stats.norm.ppf(0.975))
SEED = 35
POWER_SEED = 19_870_555


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("database")
    with open_campaign(parser.parse_args().database) as campaign:
        vs = campaign.vs()
        printed = {round(row.content, 6): row.vs for row in campaign.analyse().distributions}
    print_shapes(vs, printed)
    print_middles(vs)
    print_power()


def print_shapes(vs: xr.DataArray, here: dict[float, Distribution]) -> None:
    """Print skewness with its interval, kurtosis, and the outcome of Jarque and Bera's test."""
    by_moments = {check.content: check for check in check_verdicts()}
    show_header(
        "%",
        "skewness (95 %)",
        "published",
        "kurtosis",
        "published",
        "normal here",
        "printed",
        "by printed moments",
    )
    agree, rows = 0, published_study().velocities
    for content, printed in rows:
        found = here[round(content, 6)]
        values = vs.sel(content=content).dropna("seed").to_numpy()
        interval = bootstrap(values, stats.skew)
        normal = found.p_asymptotic >= SIGNIFICANCE
        agree += normal == printed.normal
        by_table = by_moments[content].computed_normal
        print(
            f"| {content:g} | {found.skewness:.2f} ({interval[0]:.2f} to {interval[1]:.2f}) | {printed.skewness:.2f} "
            f"| {found.kurtosis:.2f} | {printed.kurtosis:.2f} "
            f"| {word(normal)} | {word(printed.normal)} | {word(by_table)} |"
        )
    print(f"\noutcomes that agree with the printed ones: {agree} of {len(rows)}")


def print_middles(vs: xr.DataArray) -> None:
    """Print how far the median lies below the mean."""
    show_header("%", "median below mean, of the sd (95 %)")
    for content in vs["content"].to_numpy()[1:]:
        values = vs.sel(content=content).dropna("seed").to_numpy()
        low, high = bootstrap(values, lag_of_median)
        print(f"| {content:g} | {lag_of_median(values):+.2f} ({low:+.2f} to {high:+.2f}) |")


def jarque_bera_power(n: int, skewness: float, level: float = 0.05, samples: int = 4000) -> float:
    """Return the share of samples of n values of a skewed distribution that the asymptotic test rejects.

    They are drawn from a gamma distribution of this non-negative skewness with the kurtosis 3 + 1.5 skewness^2. For 0
    it is normal, and the result is the share of false alarms. The standard error of the share is at most
    0.5 / sqrt(samples).
    """
    generator = np.random.default_rng([POWER_SEED, n])
    drawn = generator.gamma(4 / skewness**2, size=(samples, n)) if skewness else generator.normal(size=(samples, n))
    return float(np.mean(stats.jarque_bera(drawn, axis=1).pvalue < level))


def print_power() -> None:
    """Print how often the test finds a skewness, and how many seeds a statement needs."""
    show_header("seeds", "skewness 0", "0.25", "0.5", "0.75", "1")
    for n in (24, 116, 232, 464, 1000):
        shares = [jarque_bera_power(n, skewness) for skewness in (0.0, 0.25, 0.5, 0.75, 1.0)]
        print(f"| {n} | {' | '.join(f'{100 * share:.0f} %' for share in shares)} |")
    show_header(
        "sd / mean",
        "mean within 2 %",
        "sd within 10 %, kurtosis 3",
        "sd within 10 %, kurtosis 6",
        "skewness within 0.25",
    )
    for scatter in (0.05, 0.10, 0.20):
        needed = (
            (NORMAL * scatter / 0.02) ** 2,
            *((NORMAL / 0.10) ** 2 * (kurtosis - 1) / 4 for kurtosis in (3, 6)),
            6 * (NORMAL / 0.25) ** 2,
        )
        print(f"| {scatter:g} | {' | '.join(f'{np.ceil(number):.0f}' for number in needed)} |")


def bootstrap(values: np.ndarray, statistic: Callable[..., np.ndarray]) -> tuple[float, float]:
    """95 % interval by percentiles of resampled seeds."""
    drawn = stats.bootstrap(
        (values,), statistic, n_resamples=2000, method="percentile", vectorized=True, rng=np.random.default_rng(SEED)
    )
    return float(drawn.confidence_interval.low), float(drawn.confidence_interval.high)


def lag_of_median(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """Mean less median over the standard deviation."""
    return (values.mean(axis=axis) - np.median(values, axis=axis)) / values.std(axis=axis, ddof=1)


def word(normal: bool) -> str:
    """Outcome of a test in a word."""
    return "yes" if normal else "no"


if __name__ == "__main__":
    main()
