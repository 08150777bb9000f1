"""Uncertainty of a calibration: posterior draws of the parameters, and bands of mean and scatter."""

import numpy as np
from scipy import stats

from calcidem.dem.kernels.layout import Floats


def linear_model(trials: Floats, statistics: Floats) -> tuple[Floats, Floats]:
    """Statistics (T, R) as linear functions of trials (T, P): constants and slopes (1 + P, R), residual variance (R,).

    `ValueError` if the trials do not determine all slopes.
    """
    count, parameters = trials.shape
    design = np.column_stack([np.ones(count), trials])
    line, _, rank, _ = np.linalg.lstsq(design, statistics, rcond=None)
    if rank <= parameters:
        raise ValueError(f"trials = {count}: give {parameters + 1} or more that differ in every parameter")
    return line, np.sum((statistics - design @ line) ** 2, axis=0) / max(1, count - parameters - 1)


def draw_posterior(
    trials: Floats,
    statistics: Floats,
    wanted: Floats,
    covariance: Floats,
    fresh: Floats,
    limits: Floats,
    draws: int = 4000,
) -> tuple[Floats, Floats]:
    """Draw parameters by importance sampling with a linear model of the trials of a calibration.

    Returns the logarithms of the parameters (D, P), with equal weights, and those of the means and standard deviations
    of a new campaign with them (D, R). `ValueError` unless there are more trials than parameters and they do not lie in
    a hyperplane.

    Parameters
    ----------
    trials
        (T, P) logarithms of the parameters of the trials.
    statistics
        (T, R) logarithms of their means and standard deviations.
    wanted
        (R,) logarithms of the targets.
    covariance
        (R, R) covariance of the errors of targets and trials, including the tolerance of the model.
    fresh
        (R,) standard errors of the statistics of a new campaign, in log.
    limits
        (P, 2) logarithms of the ranges, with a uniform prior between them.
    draws
        Number of draws.

    Notes
    -----
    The residual of the linear model counts as an additional independent error of each number. Importance weights are
    the posterior over a wider Student's t around its mode (Robert & Casella 2004, chapter 3); draws are resampled by
    them.
    """
    parameters, (line, missed) = trials.shape[1], linear_model(trials, statistics)
    inverse = np.linalg.inv(covariance + np.diag(missed))
    slopes = line[1:].T  # (R, P)
    spread = np.linalg.inv(slopes.T @ inverse @ slopes)
    mode = spread @ slopes.T @ inverse @ (wanted - line[0])
    generator = np.random.default_rng(20_250_601)
    # A proposal wider than the posterior of the linear model avoids a long tail of weights.
    proposal = stats.multivariate_t(mode, 1.3 * 0.5 * (spread + spread.T), df=5, seed=generator)
    found = np.atleast_2d(proposal.rvs(4 * draws)).reshape(-1, parameters)
    left = wanted - line[0] - found @ slopes.T
    inside = ((found >= limits[:, 0]) & (found <= limits[:, 1])).all(axis=1)
    logs = -0.5 * np.einsum("dr,rs,ds->d", left, inverse, left) - proposal.logpdf(found)
    if not inside.any():
        raise ValueError("limits: no draw lies within the ranges of the parameters: widen them")
    weights = np.where(inside, np.exp(logs - logs[inside].max()), 0.0)
    weights /= weights.sum()
    chosen = found[generator.choice(len(found), size=draws, p=weights)]
    noise = generator.standard_normal((draws, len(wanted))) * np.hypot(np.sqrt(missed), fresh)
    return chosen, line[0] + chosen @ slopes.T + noise
