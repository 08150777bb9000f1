import math
from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from calcidem.analysis.correlation import correlate, seed_permutation_test


def table(**variables: NDArray[np.float64]) -> xr.Dataset:
    """Make a table along (seed, content) from arrays of that shape."""
    first = next(iter(variables.values()))
    return xr.Dataset(
        {name: (("seed", "content"), values) for name, values in variables.items()},
        coords={"seed": np.arange(first.shape[0]), "content": np.arange(first.shape[1], dtype=float)},
    )


def pair(found: xr.Dataset, name: str) -> float:
    """Read one number of the pair (x, y)."""
    return float(found[name].sel(variable="x", other="y"))


@pytest.fixture
def trending() -> xr.Dataset:
    """Give 200 seeds x 5 contents of two variables that have nothing in common but growth with content."""
    generator = np.random.default_rng(1)
    trend = 10.0 * np.arange(5)
    return table(x=trend + generator.normal(size=(200, 5)), y=3 * trend + generator.normal(size=(200, 5)))


def test_coefficients_and_interval_are_scipys() -> None:
    """Pearson's coefficient, its Fisher interval and Spearman's coefficient of all samples are SciPy's."""
    generator = np.random.default_rng(2)
    x = generator.normal(size=(30, 4))
    y = x + generator.exponential(size=(30, 4))
    found = correlate(table(x=x, y=y)).overall
    expected = stats.pearsonr(x.ravel(), y.ravel())
    assert pair(found, "pearson") == pytest.approx(expected.statistic)
    assert pair(found, "pearson_low") == pytest.approx(expected.confidence_interval(0.95).low)
    assert pair(found, "pearson_high") == pytest.approx(expected.confidence_interval(0.95).high)
    assert pair(found, "spearman") == pytest.approx(stats.spearmanr(x.ravel(), y.ravel()).statistic)


def test_a_common_trend_correlates_overall_but_not_within(trending: xr.Dataset) -> None:
    """Variables with nothing in common but content correlate by 0.99 overall and not at all within one."""
    found = correlate(trending)
    assert pair(found.overall, "pearson") > 0.99
    assert pair(found.within, "pearson_low") < 0 < pair(found.within, "pearson_high")


def test_within_is_the_mean_of_all_contents_whatever_their_scatter() -> None:
    """Contents count alike, also one whose values scatter a hundred times as much; so do their ranks."""
    generator = np.random.default_rng(3)
    x = generator.normal(loc=[0, 5, 9], size=(8, 3))
    y = [1.0, 1.0, 100.0] * (0.5 * x + generator.normal(size=(8, 3)))
    found = correlate(table(x=x, y=y)).within
    for name, coefficient in (("pearson", stats.pearsonr), ("spearman", stats.spearmanr)):
        expected = np.mean([coefficient(x[:, place], y[:, place]).statistic for place in range(3)])
        assert pair(found, name) == pytest.approx(expected)
    low = np.tanh(np.arctanh(pair(found, "pearson")) - stats.norm.ppf(0.975) / np.sqrt(24 - 2 - 3))
    assert pair(found, "pearson_low") == pytest.approx(low)


@pytest.mark.slow
def test_intervals_cover_as_promised(within_binomial: Callable[[int, int, float], bool]) -> None:
    """Of 300 tables with a true correlation of 0.6 at every content, 95 % have it in their interval."""
    hits = 0
    for trial in range(300):
        generator = np.random.default_rng(trial)
        x = generator.normal(size=(10, 4))
        y = 0.6 * x + 0.8 * generator.normal(size=(10, 4))
        trend = 7.0 * np.arange(4)
        found = correlate(table(x=x + trend, y=y + trend)).within
        hits += pair(found, "pearson_low") <= 0.6 <= pair(found, "pearson_high")
    assert within_binomial(hits, 300, 0.95)


@pytest.mark.full
@pytest.mark.parametrize("shared", [0.0, 0.8])
def test_intervals_by_seeds_cover_though_contents_share_their_seeds(
    shared: float, within_binomial: Callable[[int, int, float], bool]
) -> None:
    """Of 300 tables of 30 seeds, 95 % have the true 0.4, also where a seed's effect is 0.8 of the variance."""
    generator, hits = np.random.default_rng(9), 0
    for _ in range(300):
        x, own = (
            math.sqrt(shared) * generator.normal(size=(30, 1)) + math.sqrt(1 - shared) * generator.normal(size=(30, 5))
            for _ in range(2)
        )
        found = seed_permutation_test(table(x=x, y=0.4 * x + math.sqrt(1 - 0.4**2) * own), "y").sel(variable="x")
        hits += float(found["pearson_low"]) <= 0.4 <= float(found["pearson_high"])
    assert within_binomial(hits, 300, 0.95)


def test_samples_with_a_gap_are_left_out_and_counted(trending: xr.Dataset) -> None:
    """A sample that lacks one variable is in no matrix, and the counts say so."""
    gaps = trending.copy(deep=True)
    gaps["x"][3, 0] = np.nan
    gaps["y"][4, 0] = np.nan
    found = correlate(gaps)
    assert found.overall["n"] == 998
    x, y = (np.delete(trending[name].to_numpy().ravel(), [15, 20]) for name in ("x", "y"))
    assert pair(found.overall, "pearson") == pytest.approx(stats.pearsonr(x, y).statistic)


def test_a_variable_that_does_not_vary_has_no_correlation(trending: xr.Dataset) -> None:
    """Without cement all seeds have 0 cemented contacts, which gives NaN."""
    still = trending.isel(content=[0]).copy(deep=True)
    still["x"][:] = 0.0
    found = correlate(still).overall
    assert np.isnan(pair(found, "pearson"))
    assert np.isnan(pair(found, "spearman"))


def test_a_variable_correlates_with_itself_by_one(trending: xr.Dataset) -> None:
    """The diagonal is one with an interval of no width, and the matrix is symmetric."""
    found = correlate(trending).overall
    for name in ("pearson", "pearson_low", "pearson_high", "spearman"):
        np.testing.assert_array_equal(np.diag(found[name]), 1.0)
        np.testing.assert_allclose(found[name], found[name].to_numpy().T)


def test_an_empty_content_has_nan(trending: xr.Dataset) -> None:
    """A content with no complete sample, or with too few for an interval, gives NaN and the others stay."""
    gaps = trending.copy(deep=True)
    gaps["x"][:, 2] = np.nan
    gaps["x"][3:, 3] = np.nan
    assert np.isnan(pair(correlate(gaps.isel(content=[2])).overall, "pearson"))
    few = correlate(gaps.isel(content=[3])).overall
    assert np.isfinite(pair(few, "pearson"))
    assert np.isnan(pair(few, "pearson_low"))
    assert np.isfinite(pair(correlate(gaps).within, "pearson"))


def test_foreign_dimensions_are_refused(trending: xr.Dataset) -> None:
    """Each variable has a number for each seed and content."""
    with pytest.raises(ValueError, match="content"):
        correlate(trending.assign(z=("seed", np.zeros(200))))


def test_p_of_one_content_is_scipys_and_the_correction_is_for_all_variables() -> None:
    """With one content and one variable p is that of SciPy's permutation test; more variables raise it, as Sidak's."""
    generator = np.random.default_rng(5)
    y = generator.normal(size=(12, 1))
    x = 0.55 * y + generator.normal(size=(12, 1))
    (p,), (corrected,) = (seed_permutation_test(table(x=x, y=y), "y")[name].values for name in ("p", "p_corrected"))
    expected = stats.permutation_test(
        (x.ravel(),),
        lambda drawn, axis: np.sum(drawn * (y.ravel() - y.mean()), axis),  # a multiple of Pearson's coefficient
        vectorized=True,
        permutation_type="pairings",
        n_resamples=9999,
        rng=1,
    )
    assert 0.005 < p < 0.3  # neither clear nor absent
    assert p == pytest.approx(expected.pvalue, abs=0.015)  # three standard errors of each
    assert corrected == p
    noise = {f"noise{number}": generator.normal(size=(12, 1)) for number in range(7)}
    found = seed_permutation_test(table(x=x, y=y, **noise), "y").sel(variable="x")
    assert float(found["p"]) == pytest.approx(p, abs=0.015)
    assert float(found["p_corrected"]) == pytest.approx(1 - (1 - p) ** 8, abs=0.06)


def test_a_trend_with_content_and_seeds_that_were_not_analysed_do_not_count() -> None:
    """Common growth makes no small p-value; a variable that does not vary has none; empty seeds change nothing."""
    generator = np.random.default_rng(6)
    trend = 10.0 * np.arange(4)
    y, x = (trend + generator.normal(size=(20, 4)) for _ in range(2))
    flat = np.broadcast_to(trend, (20, 4))
    found = seed_permutation_test(table(x=x, flat=flat, y=y), "y")
    assert float(found["p"].sel(variable="x")) > 0.02
    within = correlate(table(x=x, y=y)).within
    assert float(found["pearson"].sel(variable="x")) == pytest.approx(pair(within, "pearson"))
    assert np.isnan(found.sel(variable="flat").to_array()).all()
    longer = [np.concatenate([values, np.full((30, 4), np.nan)]) for values in (x, y)]
    np.testing.assert_array_equal(
        seed_permutation_test(table(x=longer[0], y=longer[1]), "y")["p"],
        seed_permutation_test(table(x=x, y=y), "y")["p"],
    )
    with pytest.raises(ValueError, match="'vs' is not in list"):
        seed_permutation_test(table(x=x, y=y), "vs")


@pytest.mark.full
def test_false_alarms_are_as_rare_as_promised_though_contents_share_their_seeds() -> None:
    """Of 400 tables of eight unrelated variables, each alike at all contents, 5 % have a corrected p below 0.05."""
    generator = np.random.default_rng(8)
    alarms = 0
    for _ in range(400):
        variables = {f"x{n}": np.repeat(generator.normal(size=(15, 1)), 5, axis=1) for n in range(9)}
        alarms += bool((seed_permutation_test(table(**variables), "x0")["p_corrected"] < 0.05).any())
    assert alarms / 400 == pytest.approx(0.05, abs=0.033)  # three standard errors


def test_a_content_at_which_a_variable_is_constant_says_nothing_about_it() -> None:
    """Neither its coefficient within a content nor its interval; so it is for the test by seeds."""
    generator = np.random.default_rng(6)
    y = generator.normal(size=(20, 2))
    x = y.copy()
    x[:, 1] = 4.0
    found = correlate(table(x=x, y=y, z=generator.normal(size=y.shape))).within
    assert pair(found, "pearson") == pair(found, "spearman") == pytest.approx(1.0)
    x[:, 0] += generator.normal(size=20)
    found, only = (correlate(table(x=x[:, :some], y=y[:, :some])).within for some in (2, 1))
    for name in ("pearson", "pearson_low", "pearson_high", "spearman"):
        assert pair(found, name) == pytest.approx(pair(only, name), rel=1e-12)
    tested = seed_permutation_test(table(x=x, y=y, z=y + generator.normal(size=y.shape)), "y")
    assert float(tested["pearson"].sel(variable="x")) == pytest.approx(pair(only, "pearson"), rel=1e-12)
    tested, only = (seed_permutation_test(table(x=y[:, :some], y=x[:, :some]), "y") for some in (2, 1))
    xr.testing.assert_allclose(tested, only)  # nor does it where the target is the constant one


def test_few_seeds_have_no_interval_by_permutations() -> None:
    """Two seeds have two orders and three have six, whose coefficients scatter by far too little, or not at all."""
    x, y = np.random.default_rng(7).normal(size=(2, 4, 5))
    for seeds in (2, 3, 4):
        found = seed_permutation_test(table(x=x[:seeds], y=y[:seeds]), "y").sel(variable="x")
        assert np.isfinite(found[["pearson", "p"]].to_array()).all()
        assert (np.isfinite(found[["pearson_low", "pearson_high"]].to_array()) == (seeds == 4)).all()
