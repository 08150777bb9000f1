"""Predictions of Vs from features, on velocities whose law and noise are known."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from calcidem.analysis.fits import VelocityPredictor, check_samples
from calcidem.analysis.intervals import Interval

SLOPES = np.array([0.10, -0.05, 0.0])
NOISE = 0.05


def drawn(
    random: int, n: int, noise: float = NOISE, slopes: NDArray[np.float64] = SLOPES
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw three standard normal features, and velocities around 800 m/s exp(slopes . features)."""
    generator = np.random.default_rng(random)
    features = generator.normal(size=(n, 3))
    return features, 800.0 * np.exp(features @ slopes + generator.normal(0.0, noise, n))


def test_a_law_without_noise_is_given_back() -> None:
    """Exact velocities are predicted, and so is the median."""
    features, vs = drawn(1, 200, noise=0.0)
    fit = VelocityPredictor.fit(features, vs)
    np.testing.assert_allclose(fit.slopes, SLOPES, atol=1e-12)
    found = fit.predict([1.0, 1.0, 0.0])
    assert found.vs == pytest.approx(800.0 * np.exp(0.05), rel=1e-9)
    assert found.uses_features


def test_the_interval_is_that_of_the_noise() -> None:
    """From many samples the interval has the quantiles of the law's own noise: 1.96 standard deviations each way."""
    features, vs = drawn(2, 4000)
    interval = VelocityPredictor.fit(features, vs).predict([0.0, 0.0, 0.0]).interval
    # The quantile of 4,000 normal values has a standard error of 0.042 deviations; four of them.
    assert np.log([interval.low / 800.0, interval.high / 800.0]) / NOISE == pytest.approx([-1.96, 1.96], abs=0.17)


def test_the_extremes_of_39_errors_are_their_interval_and_fewer_are_taken_as_normal() -> None:
    """The smallest and the largest of n hold a new one with probability (n - 1) / (n + 1), 95 % for 39."""
    errors = np.random.default_rng(1).exponential(0.1, 39)
    interval = VelocityPredictor(0.0, np.zeros(0), errors, 0.95).predict().interval
    assert (interval.low, interval.high) == pytest.approx((np.exp(errors.min()), np.exp(errors.max())))
    fewer = VelocityPredictor(0.0, np.zeros(0), errors[:38], 0.95).predict().interval
    half = stats.t.ppf(0.975, 37) * errors[:38].std(ddof=1) * np.sqrt(39 / 38)
    assert (fewer.low, fewer.high) == pytest.approx(tuple(np.exp(errors[:38].mean() + half * np.array([-1.0, 1.0]))))


def test_skewed_scatter_makes_a_skewed_interval_that_is_never_negative() -> None:
    """Of exponential logarithms the lower end lies near the median and the upper one far, as their quantiles say."""
    generator = np.random.default_rng(3)
    vs = 100.0 * np.exp(generator.exponential(1.0, 4000))
    interval = VelocityPredictor.fit(np.empty((4000, 0)), vs).predict().interval
    assert np.log([interval.low / 100.0, interval.high / 100.0]) == pytest.approx(
        stats.expon.ppf([0.025, 0.975]), abs=0.35
    )
    assert interval.low >= 100.0


def test_new_samples_fall_into_their_intervals_as_promised(within_binomial: Callable[[int, int, float], bool]) -> None:
    """One new sample for each of 600 fits, to 60 samples (ranks) and to 12 (as normal): 95 % lie inside."""
    for n in (60, 12):
        hits = 0
        for random in range(600):
            features, vs = drawn(random, n + 1)
            hits += VelocityPredictor.fit(features[:-1], vs[:-1]).predict(features[-1]).interval.contains(vs[-1])
        # Errors without the sample are those of fits to one sample less: a little too wide for few samples.
        assert within_binomial(hits, 600, 0.95)


def test_errors_are_those_of_fits_without_the_sample() -> None:
    """Each error is that of least squares by hand on the other samples."""
    features, vs = drawn(4, 80)
    fit = VelocityPredictor.fit(features, vs)
    for out in (0, 17):
        design = np.column_stack([np.ones(79), np.delete(features, out, axis=0)])
        solution = np.linalg.lstsq(design, np.log(np.delete(vs, out)), rcond=None)[0]
        assert fit.errors[out] == pytest.approx(np.log(vs[out]) - solution @ [1.0, *features[out]], rel=1e-9)


def test_a_sample_that_alone_has_a_feature_is_predicted_from_the_others() -> None:
    """Its leverage is one and its residual zero, so nothing but the fit without it tells its error."""
    features, vs = drawn(5, 60)
    mark = np.zeros((60, 1))
    mark[8] = 1.0
    errors = VelocityPredictor.fit(np.hstack([features, mark]), vs).errors
    without = VelocityPredictor.fit(np.delete(features, 8, axis=0), np.delete(vs, 8))
    assert np.isfinite(errors).all()
    assert errors[8] == pytest.approx(np.log(vs[8]) - without.centre - features[8] @ without.slopes, rel=1e-9)


def test_features_that_depend_on_one_another_are_no_error() -> None:
    """A feature twice, or the sum of two others, changes no prediction: slopes are shared out among them."""
    features, vs = drawn(7, 60)
    more = np.column_stack([features, features[:, 0], features.sum(axis=1)])
    single, double = VelocityPredictor.fit(features, vs), VelocityPredictor.fit(more, vs)
    np.testing.assert_allclose(double.errors, single.errors, rtol=1e-9)
    assert double.predict(more[3]).vs == pytest.approx(single.predict(features[3]).vs)


def test_a_check_tells_the_gain_of_known_noise(within_binomial: Callable[[int, int, float], bool]) -> None:
    """Intervals shrink as the scatter does: to NOISE over that of content alone; both hold 95 % of left-out samples."""
    features, vs = drawn(6, 300)
    check, alone = check_samples(features, vs), check_samples(features[:, :0], vs)
    total = np.hypot(NOISE, np.linalg.norm(SLOPES))
    assert check[1].mean() / alone[1].mean() == pytest.approx(NOISE / total, rel=0.15)
    for inside, scores in (check, alone):
        assert within_binomial(int(inside.sum()), scores.size, 0.95)
    # The least possible: that of the true quantiles, 4.675 deviations of a normal value.
    assert alone[1].mean() == pytest.approx(4.675 * total * 800.0, rel=0.15)


def test_the_score_is_width_and_penalty() -> None:
    """Inside only the width counts; outside, 2 / (1 - level) times the distance is added."""
    interval = Interval(100.0, 300.0)
    assert interval.score(200.0, 0.95) == 200.0
    assert interval.score(90.0, 0.95) == pytest.approx(200.0 + 40.0 * 10.0)
    assert interval.score(301.0, 0.9) == pytest.approx(200.0 + 20.0 * 1.0)


def test_equal_velocities_and_constant_features_are_no_error() -> None:
    """Without cement all seeds are the same sample: the interval has no width, and the features no part."""
    found = VelocityPredictor.fit(np.ones((8, 2)), np.full(8, 201.0)).predict([1.0, 1.0])
    assert (found.vs, found.interval.low, found.interval.high) == pytest.approx((201.0, 201.0, 201.0))
    assert not found.uses_features


def test_too_few_samples_are_refused() -> None:
    """Two velocities have no scatter to speak of, and each needs its features."""
    with pytest.raises(ValueError, match="at least 3 more"):
        VelocityPredictor.fit(np.ones((2, 1)), [200.0, 210.0])
    with pytest.raises(ValueError, match="one row for each velocity"):
        VelocityPredictor.fit(np.ones((4, 1)), np.ones(5))
