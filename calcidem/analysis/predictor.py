"""Prediction of Vs, with an interval, for samples that were not simulated, from content and features of the cement.

Each content has its own predictor, so the interval reflects the scatter of Vs there. The logarithm of Vs is linear in
the features (least squares). The interval uses quantiles of leave-one-out errors. It assumes no distribution and is
never negative.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from calcidem.analysis.intervals import Interval

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
        centred = x - x.mean(axis=0)
        scale = np.linalg.norm(centred, axis=0)
        varied = scale > 1e-12 * np.linalg.norm(x, axis=0)  # the others are constant up to rounding
        standard = centred[:, varied] / scale[varied]
        # Pseudo-inverse, since features may be linearly dependent: some of a path are sums of others.
        inverse = np.linalg.pinv(standard, rcond=1e-9)
        weights = inverse @ (y - y.mean())
        influence = np.einsum("ik,ki->i", standard, inverse) + 1.0 / y.size
        errors = (y - y.mean() - standard @ weights) / (1.0 - influence)
        slopes = np.zeros(x.shape[1])
        slopes[varied] = weights / scale[varied]
        return cls(float(y.mean() - x.mean(axis=0) @ slopes), slopes, errors, level)


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
