"""The law Vs = a C^b + c of all contents (Table 4 of the paper), and a predictor of Vs for each content.

Both predict samples that were not simulated, with an interval. The law needs the connectivity C_d,n. A predictor takes
any features of the cement: the logarithm of Vs is linear in them (least squares), and the interval, from quantiles of
leave-one-out errors, reflects the scatter of Vs at its content, assumes no distribution and is never negative.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, stats

from calcidem.analysis.intervals import Interval

_PARAMETER_COUNT = 3
"""The law has the three parameters a, b and c."""


@dataclass(frozen=True, slots=True, eq=False)
class PowerLawFit:
    """A fitted law Vs = a C^b + c; C is dimensionless, Vs, a and c are in m/s."""

    a: float
    b: float
    c: float
    """The parameters."""
    a_interval: Interval
    b_interval: Interval
    c_interval: Interval
    """Their confidence intervals."""
    covariance: NDArray[np.float64]
    """Covariance of (a, b, c), shape (3, 3). The three are strongly correlated, so the intervals alone do not suffice.
    """
    residuals: NDArray[np.float64]
    """Measured minus fitted velocity of each used sample, in m/s, shape (n,)."""
    residual_standard_deviation: float
    """Standard deviation of the residuals with n - 3 degrees of freedom, in m/s."""
    n: int
    """Number of samples used."""

    def predict(self, connectivity: ArrayLike) -> NDArray[np.float64]:
        """Return the velocity in m/s for positive values of C_d,n, any shape."""
        x = np.asarray(connectivity, dtype=np.float64)
        velocity: NDArray[np.float64] = power_law(x, self.a, self.b, self.c)
        return velocity

    def prediction_bounds(self, connectivity: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the bounds, in m/s, that contain the velocity of a new sample with a probability of 95 %.

        They combine scatter of a sample and uncertainty of the curve (delta method) with Student's t. C_d,n is
        positive, of any shape, and the scatter is assumed equal for all. If it is not, `leave_one_seed_out` gives the
        true coverage.
        """
        x = np.asarray(connectivity, dtype=np.float64)
        gradient = _power_law_gradient(x, self.a, self.b, self.c)
        curve = np.einsum("...i,ij,...j->...", gradient, self.covariance, gradient)
        quantile = float(stats.t.ppf(0.975, self.n - _PARAMETER_COUNT))
        half = quantile * np.sqrt(self.residual_standard_deviation**2 + curve)
        centre = self.predict(x)
        return centre - half, centre + half


@dataclass(frozen=True, slots=True, eq=False)
class LeaveOneSeedOut:
    """Prediction errors of the law for seeds left out of the fit."""

    errors: NDArray[np.float64]
    """Measured minus predicted velocity in m/s of every used sample, shape (n,)."""
    root_mean_square_error: float
    """Root mean square of these errors, in m/s."""
    coverage: float
    """Share of samples inside their prediction interval, for comparison with its level."""


def fit_power_law(connectivity: ArrayLike, vs: ArrayLike, seed: ArrayLike | None = None) -> PowerLawFit:
    """Fit Vs = a C^b + c by least squares to positive C_d,n and velocities (m/s), both (n,), NaN if unknown.

    The parameters' intervals are those of 95 %. Without seeds they are for errors of equal variance that do not depend
    on each other. With the seed of each sample, (n,), errors of a seed may depend on each other, since its samples
    share their cement, and their variance may depend on C (Liang and Zeger 1986, doi:10.1093/biomet/73.1.13).

    `ValueError` if shapes disagree, a connectivity is not positive, there are fewer than four samples or three
    different connectivities, or the fit does not converge.
    """
    x, y = np.asarray(connectivity, dtype=np.float64), np.asarray(vs, dtype=np.float64)
    if x.ndim != 1 or x.shape != y.shape:
        raise ValueError(f"connectivity has shape {x.shape} and vs {y.shape}; give one of each for every sample")
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    if (x <= 0).any():
        raise ValueError(
            f"connectivity {x.min()} is not positive, so a power of it does not exist; "
            "check the distance and median diameter it was normalised with"
        )
    if x.size <= _PARAMETER_COUNT or np.unique(x).size < _PARAMETER_COUNT:
        raise ValueError(
            f"{x.size} samples with {np.unique(x).size} different connectivities: the law has three "
            "parameters and needs at least four samples with three different ones"
        )
    try:
        parameters, covariance = optimize.curve_fit(power_law, x, y, p0=_starting_point(x, y), jac=_power_law_gradient)
    except RuntimeError as error:
        raise ValueError(
            f"the fit of Vs = a C^b + c did not converge for {x.size} samples ({error}); "
            "use samples over a wider range of connectivity"
        ) from error
    residuals = y - power_law(x, *parameters)
    freedom = x.size - _PARAMETER_COUNT
    if seed is not None:
        names, member = np.unique(np.asarray(seed)[known], return_inverse=True)
        gradient, scores = _power_law_gradient(x, *parameters), np.zeros((names.size, _PARAMETER_COUNT))
        np.add.at(scores, member, gradient * residuals[:, None])
        bread, freedom = np.linalg.pinv(gradient.T @ gradient), names.size - 1
        covariance = names.size / max(freedom, 1) * bread @ (scores.T @ scores) @ bread
    quantile = float(stats.t.ppf(0.975, freedom))  # NaN for a single seed
    intervals = [
        Interval(float(value - quantile * error), float(value + quantile * error))
        for value, error in zip(parameters, np.sqrt(np.diag(covariance)), strict=True)
    ]
    a, b, c = parameters.tolist()
    return PowerLawFit(
        a=a,
        b=b,
        c=c,
        a_interval=intervals[0],
        b_interval=intervals[1],
        c_interval=intervals[2],
        covariance=covariance,
        residuals=residuals,
        residual_standard_deviation=float(np.sqrt(residuals @ residuals / (x.size - _PARAMETER_COUNT))),
        n=x.size,
    )


def leave_one_seed_out(connectivity: ArrayLike, vs: ArrayLike, seed: ArrayLike) -> LeaveOneSeedOut:
    """Predict the samples of each seed from a law fitted to all other seeds; errors as for `fit_power_law`.

    All contents of a seed are left out together, because they share their cement. The coverage is that of prediction
    intervals of 95 %.
    """
    x, y = np.asarray(connectivity, dtype=np.float64), np.asarray(vs, dtype=np.float64)
    seeds = np.asarray(seed)
    known = np.isfinite(x) & np.isfinite(y)
    x, y, seeds = x[known], y[known], seeds[known]
    predicted, low, high = np.empty_like(y), np.empty_like(y), np.empty_like(y)
    for name in np.unique(seeds):
        out = seeds == name
        fit = fit_power_law(x[~out], y[~out])
        predicted[out] = fit.predict(x[out])
        low[out], high[out] = fit.prediction_bounds(x[out])
    errors = y - predicted
    return LeaveOneSeedOut(
        errors=errors,
        root_mean_square_error=float(np.sqrt(np.mean(errors**2))),
        coverage=float(np.mean((low <= y) & (y <= high))),
    )


def power_law(x: NDArray[np.float64], a: float, b: float, c: float) -> NDArray[np.float64]:
    """Return a x^b + c for positive x."""
    with np.errstate(over="ignore"):  # far trial values of a fit
        return np.asarray(a * x**b + c)


def _power_law_gradient(x: NDArray[np.float64], a: float, b: float, c: float) -> NDArray[np.float64]:  # noqa: ARG001 - curve_fit's signature
    """Return the derivatives of the law with respect to a, b and c, shape (..., 3)."""
    power = x**b
    return np.stack([power, a * power * np.log(x), np.ones_like(x)], axis=-1)


def _starting_point(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Start from the best of several exponents, each with optimal linear parameters a and c."""
    best, smallest = np.zeros(3), np.inf
    # Without 0, at which a C^b and c would be the same term.
    for exponent in (*np.arange(-4.0, 0.0, 0.25), *np.arange(0.25, 4.25, 0.25)):
        design = np.stack([x**exponent, np.ones_like(x)], axis=1)
        (a, c), *_ = np.linalg.lstsq(design, y, rcond=None)
        error = float(np.sum((design @ (a, c) - y) ** 2))
        if error < smallest:
            best, smallest = np.array([a, exponent, c]), error
    return best


FEWEST_ROWS = 3
"""Samples that a predictor needs in addition to one for each feature."""

Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Prediction:
    """Prediction of Vs for a sample that was not simulated."""

    vs: float
    """Median, m/s."""
    interval: Interval
    """Interval with the given probability, m/s."""
    uses_features: bool
    """False if the prediction depends on the content alone."""


@dataclass(frozen=True, slots=True, eq=False)
class VelocityPredictor:
    """Predictor for one content."""

    centre: float
    slopes: Matrix
    """Logarithm of Vs (m/s) at zero features, and its slope with each feature, shape (k,)."""
    errors: Matrix
    """Logarithm of Vs of each sample minus its prediction without this sample, shape (n,)."""
    level: float
    """Probability of the intervals."""

    def predict(self, features: ArrayLike = ()) -> Prediction:
        """Predict a sample from its features, shape (k,), in the order of the fit."""
        logarithm = self.centre + float(np.asarray(features, dtype=np.float64) @ self.slopes)
        low, middle, high = np.exp(logarithm + self._quantiles()).tolist()
        return Prediction(middle, Interval(low, high), bool(self.slopes.any()))

    def _quantiles(self) -> Matrix:
        """Quantiles of the errors for the interval and the median.

        A new error falls below the j-th smallest of n with probability j / (n + 1); fractional ranks are interpolated
        (Hyndman & Fan 1996, doi:10.1080/00031305.1996.10473566, definition 6). With too few errors for such ranks, a
        normal distribution is assumed.
        """
        tail, count = (1.0 - self.level) / 2.0, self.errors.size
        if tail * (count + 1) >= 1.0 - 1e-9:
            return np.asarray(np.quantile(self.errors, [tail, 0.5, 1.0 - tail], method="weibull"))
        half = float(stats.t.ppf(1.0 - tail, count - 1)) * self.errors.std(ddof=1) * math.sqrt(1.0 + 1.0 / count)
        return float(self.errors.mean()) + np.array([-half, 0.0, half])

    @classmethod
    def fit(cls, features: ArrayLike, vs: ArrayLike, level: float = 0.95) -> Self:
        """Fit the predictor of one content by least squares to features (n, k) and positive velocities (n,), m/s.

        For k = 0 or constant features the content alone is used. `ValueError` if there are fewer than k + 3 samples, or
        lengths differ. The error of a left-out sample is its residual in the full fit over one minus its leverage
        (Allen 1974, doi:10.1080/00401706.1974.10489157).
        """
        x, y = np.asarray(features, dtype=np.float64), np.log(np.asarray(vs, dtype=np.float64))
        if x.ndim != 2 or len(x) != len(y) or len(y) < FEWEST_ROWS + x.shape[1]:  # a table
            fewest = f"at least {FEWEST_ROWS} more than features"
            raise ValueError(f"features {x.shape} and vs {y.shape}: give one row for each velocity, and {fewest}")
        centre, slopes, leverage = _least_squares(x, y)
        alone = leverage > 1.0 - 1e-9  # a sample that alone decides a slope: its residual is zero, whatever its Vs
        errors = (y - centre - x @ slopes) / np.where(alone, np.nan, 1.0 - leverage)
        for row in np.flatnonzero(alone).tolist():
            others = np.arange(len(y)) != row
            without, slopes_without, _ = _least_squares(x[others], y[others])
            errors[row] = y[row] - without - x[row] @ slopes_without
        return cls(centre, slopes, errors, level)


def _least_squares(x: Matrix, y: Matrix) -> tuple[float, Matrix, Matrix]:
    """Fit y (n,) = centre + x (n, k) slopes; returns centre, slopes (k,) and the leverage of each row (n,).

    Slopes of constant features are zero.
    """
    centred = x - x.mean(axis=0)
    scale = np.linalg.norm(centred, axis=0)
    varied = scale > 1e-12 * np.linalg.norm(x, axis=0)  # the others are constant up to rounding
    standard = centred[:, varied] / scale[varied]
    # Pseudo-inverse, since features may be linearly dependent: some of a path are sums of others.
    inverse = np.linalg.pinv(standard, rcond=1e-9)
    slopes = np.zeros(x.shape[1])
    slopes[varied] = inverse @ (y - y.mean()) / scale[varied]
    leverage = np.einsum("ik,ki->i", standard, inverse) + 1.0 / y.size
    return float(y.mean() - x.mean(axis=0) @ slopes), slopes, leverage


def check_samples(features: ArrayLike, vs: ArrayLike, level: float = 0.95) -> tuple[NDArray[np.bool_], Matrix]:
    """Predict each sample of one content from all others: one more is needed than for `VelocityPredictor.fit`.

    Returns whether each lies in its interval, and its interval score (`Interval.score`) in m/s, both (n,).
    """
    x, y = np.asarray(features, dtype=np.float64), np.asarray(vs, dtype=np.float64)
    pairs = [
        (VelocityPredictor.fit(np.delete(x, out, axis=0), np.delete(y, out), level).predict(x[out]).interval, value)
        for out, value in enumerate(y.tolist())
    ]
    inside = np.array([interval.contains(value) for interval, value in pairs])
    return inside, np.array([interval.score(value, level) for interval, value in pairs])
