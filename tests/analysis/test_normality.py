from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from calcidem.analysis.distribution import Distribution, _null_statistics, normality_of_moments


def test_moments_of_a_sample_counted_by_hand() -> None:
    """The values 0 0 0 4 have mean 1, central moments 3, 6 and 21, so skewness 6/3^1.5 and kurtosis 21/9."""
    values = np.array([0.0, 0.0, 0.0, 4.0])
    assert Distribution.of_sample(values).skewness == pytest.approx(6 / 3**1.5)
    assert Distribution.of_sample(values).kurtosis == pytest.approx(21 / 9)


@pytest.mark.parametrize("n", [3, 20, 116])
def test_statistic_and_asymptotic_p_are_scipys(n: int) -> None:
    """The statistic and its chi-square p-value are those of scipy.stats.jarque_bera."""
    values = np.random.default_rng(n).gumbel(1000, 100, n)
    expected = stats.jarque_bera(values)
    test = Distribution.of_sample(values)
    assert test.jarque_bera == pytest.approx(expected.statistic)
    assert test.p_asymptotic == pytest.approx(expected.pvalue)


def test_small_sample_p_is_scipys_monte_carlo_test() -> None:
    """The simulated p-value agrees with SciPy's own simulation within four standard errors of the two."""
    values = np.random.default_rng(7).gumbel(1000, 100, 30)
    replicates = 9999
    expected = stats.monte_carlo_test(
        values,
        np.random.default_rng(8).standard_normal,
        lambda sample, axis: stats.jarque_bera(sample, axis=axis).statistic,
        n_resamples=replicates,
        vectorized=True,
        alternative="greater",
    ).pvalue
    error = np.sqrt(expected * (1 - expected) * (1 / replicates + 1 / 20_000))
    assert Distribution.of_sample(values).p_small_sample == pytest.approx(expected, abs=4 * error)


def test_small_sample_p_rejects_as_often_as_promised(
    within_binomial: Callable[[int, int, float], bool],
) -> None:
    """Of 1000 normal samples of 20, the simulated p rejects 5 % and the asymptotic one too few."""
    samples = np.random.default_rng(9).standard_normal((1000, 20))
    moments = stats.skew(samples, axis=1), stats.kurtosis(samples, axis=1, fisher=False)
    _, asymptotic, small_sample = np.transpose([normality_of_moments(20, *one) for one in zip(*moments, strict=True)])
    assert within_binomial(int(np.sum(small_sample < 0.05)), 1000, 0.05)
    assert not within_binomial(int(np.sum(asymptotic < 0.05)), 1000, 0.05)


def test_skewed_values_are_rejected() -> None:
    """A hundred and sixteen exponential values are not normal by either p-value."""
    test = Distribution.of_sample(np.random.default_rng(10).exponential(1.0, 116))
    assert test.p_asymptotic < 1e-6
    assert test.p_small_sample < 1e-3


@given(shift=st.floats(-1e4, 1e4), scale=st.floats(0.1, 1e4))
@settings(max_examples=20, deadline=None)
def test_units_and_origin_do_not_matter(shift: float, scale: float) -> None:
    """Shifting and scaling the values leaves the statistic as it is, up to round-off of the shift."""
    values = np.random.default_rng(11).gumbel(0.0, 1.0, 40)
    expected = Distribution.of_sample(values).jarque_bera
    assert Distribution.of_sample(scale * values + shift).jarque_bera == pytest.approx(expected, rel=1e-6)


def test_moments_alone_give_the_same_test() -> None:
    """The test from printed moments is the test from the values."""
    values = np.random.default_rng(12).normal(0, 1, 50)
    found = Distribution.of_sample(values)
    expected = found.jarque_bera, found.p_asymptotic, found.p_small_sample
    assert normality_of_moments(50, found.skewness, found.kurtosis) == expected


@pytest.mark.parametrize("n", [25, 300])
def test_as_many_samples_are_simulated_for_every_size(n: int) -> None:
    """20,000, whether their values fit into one block of two million or not."""
    assert len(_null_statistics(n)) == 20_000


def test_the_simulation_is_done_once_for_a_size_and_is_the_same_every_time() -> None:
    """The simulated statistics of a size are kept, read-only, and come out alike when drawn again."""
    first = _null_statistics(25)
    assert _null_statistics(25) is first
    assert not first.flags.writeable
    _null_statistics.cache_clear()
    np.testing.assert_array_equal(_null_statistics(25), first)


@pytest.mark.parametrize("values", [[], [3.0], [5.0, 5.0, 5.0]])
def test_values_that_do_not_vary_have_no_test(values: list[float]) -> None:
    """No value, one value or equal values have neither moments nor a p-value."""
    test = Distribution.of_sample(np.array(values))
    assert np.isnan([test.jarque_bera, test.p_asymptotic, test.p_small_sample, test.skewness]).all()


def test_two_values_never_speak_against_normality() -> None:
    """All pairs have the same statistic, so the small-sample p is one; the asymptotic one cannot know."""
    assert Distribution.of_sample(np.array([1.0, 2.0])).p_small_sample == 1.0
