from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import optimize

from calcidem.analysis.fits import _power_law_gradient, fit_power_law, leave_one_seed_out, power_law

LAW = (623.0, -1.01, -338.0)
"""The paper's law for weights by physical meaning."""


def noisy(
    random: int, n: int = 80, noise: float = 60.0, law: tuple[float, float, float] = LAW
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw connectivities over the range of a campaign and velocities around a law."""
    generator = np.random.default_rng(random)
    x = generator.uniform(0.25, 1.3, n)
    return x, power_law(x, *law) + generator.normal(0, noise, n)


@given(a=st.floats(200, 2000), b=st.floats(-2.5, -0.3), c=st.floats(-1000, 500))
@settings(max_examples=40, deadline=None)
def test_an_exact_law_is_given_back(a: float, b: float, c: float) -> None:
    """Without scatter the fit returns the law it was drawn from, up to what least squares resolves."""
    x = np.linspace(0.2, 1.5, 40)
    fit = fit_power_law(x, power_law(x, a, b, c))
    assert (fit.a, fit.b, fit.c) == pytest.approx((a, b, c), rel=1e-4, abs=0.1)


def test_a_rising_law_is_found_as_well() -> None:
    """The sign of the exponent is found, not assumed."""
    x = np.linspace(0.2, 1.5, 40)
    assert fit_power_law(x, power_law(x, 500.0, 1.7, 20.0)).b == pytest.approx(1.7, rel=1e-4)


def test_three_different_connectivities_are_fitted_if_there_are_more_points() -> None:
    """Three means determine three parameters; two do not."""
    x = np.array([0.3, 0.3, 0.7, 1.3])
    assert fit_power_law(x, power_law(x, *LAW)).b == pytest.approx(LAW[1], rel=1e-4)
    with pytest.raises(ValueError, match="different"):
        fit_power_law(x[[0, 1, 2, 2]], power_law(x, *LAW))


def test_no_other_parameters_fit_better() -> None:
    """SciPy's global search over the parameters finds no smaller sum of squares."""
    x, y = noisy(1)
    fit = fit_power_law(x, y)
    best = optimize.differential_evolution(
        lambda p: float(np.sum((y - power_law(x, *p)) ** 2)), [(1, 5000), (-4, -0.05), (-5000, 2000)], rng=2
    )
    assert float(fit.residuals @ fit.residuals) == pytest.approx(best.fun, rel=1e-6)


def test_the_gradient_is_the_derivative() -> None:
    """Central differences of the law by each parameter agree with the gradient."""
    x = np.linspace(0.2, 1.5, 5)
    for index, step in enumerate((1e-2, 1e-5, 1e-2)):
        up, down = np.array(LAW), np.array(LAW)
        up[index] += step
        down[index] -= step
        numeric = (power_law(x, *up) - power_law(x, *down)) / (2 * step)
        np.testing.assert_allclose(_power_law_gradient(x, *LAW)[:, index], numeric, rtol=1e-6)


def test_parameter_and_prediction_intervals_cover_as_promised(
    within_binomial: Callable[[int, int, float], bool],
) -> None:
    """Of 300 noisy samples, 95 % have a, b, c and one further velocity inside their intervals."""
    hits = np.zeros(4, dtype=int)
    for trial in range(300):
        x, y = noisy(trial)
        fit = fit_power_law(x[:-1], y[:-1])
        low, high = fit.prediction_bounds(x[-1])
        hits += (
            fit.a_interval.contains(LAW[0]),
            fit.b_interval.contains(LAW[1]),
            fit.c_interval.contains(LAW[2]),
            bool(low <= y[-1] <= high),
        )
    assert all(within_binomial(int(count), 300, 0.95) for count in hits)


def test_residuals_are_measured_minus_fitted() -> None:
    """Curve and residuals add up to the measured values, and the deviation has n - 3 degrees of freedom."""
    x, y = noisy(3)
    fit = fit_power_law(x, y)
    np.testing.assert_allclose(fit.predict(x) + fit.residuals, y)
    assert fit.residual_standard_deviation == pytest.approx(np.sqrt(np.sum(fit.residuals**2) / (80 - 3)))


def test_predicted_bounds_lie_around_the_curve_and_widen_outside_the_data() -> None:
    """The interval is centred on the curve and grows where there are no samples."""
    fit = fit_power_law(*noisy(4))
    low, high = fit.prediction_bounds([0.6, 0.1])
    np.testing.assert_allclose((low + high) / 2, fit.predict([0.6, 0.1]))
    assert (high - low)[1] > 2 * (high - low)[0]


def test_left_out_seeds_are_predicted_by_the_others() -> None:
    """The error of a seed's samples is that of a fit made by hand without this seed."""
    x, y = noisy(5)
    seeds = np.repeat(np.arange(10), 8)
    study = leave_one_seed_out(x, y, seeds)
    by_hand = fit_power_law(x[8:], y[8:])
    np.testing.assert_allclose(study.errors[:8], y[:8] - by_hand.predict(x[:8]))
    assert study.root_mean_square_error == pytest.approx(np.sqrt(np.mean(study.errors**2)))
    assert study.root_mean_square_error > np.sqrt(np.mean(fit_power_law(x, y).residuals ** 2))


def test_coverage_of_left_out_samples_is_near_the_level(
    within_binomial: Callable[[int, int, float], bool],
) -> None:
    """With even scatter, 95 % of 800 left-out velocities lie in their prediction interval."""
    x, y = noisy(6, n=800)
    study = leave_one_seed_out(x, y, np.repeat(np.arange(40), 20))
    assert within_binomial(round(study.coverage * 800), 800, 0.95)


def test_seeds_with_an_effect_of_their_own_are_harder_to_predict() -> None:
    """When a seed shifts all its samples alike, leaving it out shows a larger error than the residuals do."""
    x, y = noisy(7, n=60, noise=5.0)
    seeds = np.repeat(np.arange(4), 15)
    shifted = y + np.array([-150.0, -50.0, 50.0, 150.0])[seeds]
    study = leave_one_seed_out(x, shifted, seeds)
    assert study.root_mean_square_error > 1.1 * fit_power_law(x, shifted).residual_standard_deviation


def test_gaps_are_left_out_and_counted() -> None:
    """Samples without velocity or connectivity change nothing but the count."""
    x, y = noisy(8)
    gaps_x, gaps_y = np.append(x, [np.nan, 0.5]), np.append(y, [500.0, np.nan])
    fit, expected = fit_power_law(gaps_x, gaps_y), fit_power_law(x, y)
    assert (fit.a, fit.n) == (expected.a, 80)
    study = leave_one_seed_out(gaps_x, gaps_y, np.append(np.repeat(np.arange(10), 8), [0, 1]))
    assert study.errors.size == 80


def test_intervals_hold_the_law_though_samples_of_a_seed_are_alike(
    within_binomial: Callable[[int, int, float], bool],
) -> None:
    """Errors of a seed have a part in common and grow with Vs, as in a campaign; without seeds four fifths are held."""
    held, alone, count = 0, 0, 150
    for trial in range(count):
        generator = np.random.default_rng(trial)
        seeds = np.repeat(np.arange(60), 8)
        x = np.tile(np.linspace(0.3, 1.3, 8), 60) * np.exp(0.1 * generator.standard_normal(480))
        vs, fastest = power_law(x, *LAW), power_law(np.array(0.3), *LAW)
        error = generator.standard_normal(60)[seeds] + 0.5 * generator.standard_normal(480)
        vs = vs + 0.1 * vs**2 / fastest * error
        held += fit_power_law(x, vs, seeds).b_interval.contains(LAW[1])
        alone += fit_power_law(x, vs).b_interval.contains(LAW[1])
    assert within_binomial(held, count, 0.95)
    assert alone < 0.85 * count


def test_one_seed_gives_a_law_without_intervals() -> None:
    """Nothing tells how much its samples have in common."""
    x, y = noisy(8)
    fit = fit_power_law(x, y, np.zeros(80))
    assert fit.b == fit_power_law(x, y).b
    assert np.isnan(fit.b_interval.low)


def test_what_cannot_be_fitted_is_refused() -> None:
    """Connectivities that are not positive, too few of them and unequal lengths are refused with a cure."""
    x, y = noisy(9)
    with pytest.raises(ValueError, match="not positive"):
        fit_power_law(x - 0.5, y)
    with pytest.raises(ValueError, match="at least four samples"):
        fit_power_law(x[:3], y[:3])
    with pytest.raises(ValueError, match="2 different connectivities"):
        fit_power_law(np.repeat([0.3, 0.6], 40), y)
    with pytest.raises(ValueError, match="one of each"):
        fit_power_law(x, y[1:])
