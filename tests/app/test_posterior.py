"""The posterior of calibrated parameters against a linear model, whose posterior is known."""

import numpy as np
import pytest

from calcidem.app.studies.calibrate import draw_posterior
from calcidem.dem.kernels.layout import Floats

SLOPES = np.array([[1.0, 0.0], [0.5, 0.5], [0.0, -1.0], [0.2, 0.4]])
TRUTH = np.array([0.3, -0.2])
WIDE = np.array([[-5.0, 5.0], [-5.0, 5.0]])


def trials(draws: np.random.Generator, noise: float = 0.0) -> tuple[Floats, Floats]:
    """Twelve trials near the truth, and what the linear model gives, with noise."""
    points = TRUTH + 0.1 * draws.standard_normal((12, 2))
    return points, 6.0 + points @ SLOPES.T + noise * draws.standard_normal((12, 4))


def central(logarithms: Floats) -> Floats:
    """(2, ...) ends of 95 % intervals."""
    return np.exp(np.quantile(logarithms, [0.025, 0.975], axis=0))


def test_the_posterior_of_a_linear_model_is_the_one_of_least_squares() -> None:
    """Mode and covariance are those of weighted least squares, and a new campaign adds its own errors."""
    covariance, fresh = np.diag([0.02, 0.05, 0.03, 0.1]) ** 2, np.full(4, 0.04)
    points, predicted = draw_posterior(
        *trials(np.random.default_rng(1)), 6.0 + SLOPES @ TRUTH, covariance, fresh, WIDE, 20_000
    )
    spread = np.linalg.inv(SLOPES.T @ np.linalg.inv(covariance) @ SLOPES)
    np.testing.assert_allclose(points.mean(axis=0), TRUTH, atol=2e-3)
    np.testing.assert_allclose(np.cov(points.T), spread, rtol=0.06, atol=2e-5)
    expected = np.sqrt(np.diag(SLOPES @ spread @ SLOPES.T) + fresh**2)
    np.testing.assert_allclose(predicted.std(axis=0), expected, rtol=0.04)
    low, high = central(predicted)
    assert np.all((low < np.exp(6.0 + SLOPES @ TRUTH)) & (np.exp(6.0 + SLOPES @ TRUTH) < high))


def test_a_limit_cuts_the_posterior_off() -> None:
    """No draw lies beyond the range of a parameter, and ranges far away are refused in a sentence."""
    covariance, fresh = 0.05**2 * np.eye(4), np.full(4, 0.04)
    given = (*trials(np.random.default_rng(1)), 6.0 + SLOPES @ TRUTH, covariance, fresh)
    points, _ = draw_posterior(*given, np.array([[-5.0, 0.3], [-5.0, 5.0]]))
    assert points[:, 0].max() <= 0.3
    with pytest.raises(ValueError, match="widen them"):
        draw_posterior(*given, np.array([[3.0, 5.0], [-5.0, 5.0]]))
    with pytest.raises(ValueError, match="give 3 or more"):
        draw_posterior(given[0][:2], given[1][:2], *given[2:], WIDE)


def test_intervals_and_bands_hold_what_they_say() -> None:
    """Of 300 calibrations with noise in trials and targets, 95 % intervals hold the truth, and bands a new campaign."""
    held, met = np.zeros(2), np.zeros(4)
    errors = np.array([0.02, 0.05, 0.03, 0.1])
    for number in range(300):
        draws = np.random.default_rng([3, number])
        wanted = 6.0 + SLOPES @ TRUTH + errors * draws.standard_normal(4)
        points, predicted = draw_posterior(*trials(draws, 0.003), wanted, np.diag(errors**2), errors, WIDE, 1000)
        low, high = central(points)
        held += (low < np.exp(TRUTH)) & (np.exp(TRUTH) < high)
        new = np.exp(6.0 + SLOPES @ TRUTH + errors * draws.standard_normal(4))
        low, high = central(predicted)
        met += (low < new) & (new < high)
    assert np.all(np.abs(held / 300 - 0.95) < 0.045), held
    assert np.all(np.abs(met / 300 - 0.95) < 0.045), met
