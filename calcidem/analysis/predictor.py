"""Vs of a sample that was not simulated, and an interval: from its content, and from features of its cement.

Each content has a predictor of its own, so that the interval is as wide as Vs scatters there. The logarithm of Vs is
linear in the features (least squares). The interval has the quantiles of the errors of samples that the regression has
not seen. It assumes no distribution and is never negative.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from calcidem.analysis.intervals import Interval

FEWEST_ROWS = 3
"""Samples that a predictor needs beside one for each feature."""

_CONSTANT = 1e-12
"""Relative size below which a feature does not vary."""

Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Prediction:
    """Vs of a sample that was not simulated.

    Attributes
    ----------
    vs
        Its median, m/s.
    interval
        In which it falls with the given probability, m/s.
    uses_features
        Whether features had a part in it; otherwise the content alone made it.
    """

    vs: float
    interval: Interval
    uses_features: bool


@dataclass(frozen=True, slots=True, eq=False)
class VelocityPredictor:
    """A predictor for one content; see `fit_predictor`.

    Attributes
    ----------
    centre, slopes
        Logarithm of Vs (m/s) where all features are zero, and its change with each, shape (k,).
    errors
        Logarithm of Vs of each sample less that predicted without it, shape (n,).
    level
        Probability of the intervals.
    """

    centre: float
    slopes: Matrix
    errors: Matrix
    level: float

    def predict(self, features: ArrayLike = ()) -> Prediction:
        """Predict a sample from its features, shape (k,), in the order of those fitted."""
        logarithm = self.centre + float(np.asarray(features, dtype=np.float64) @ self.slopes)
        low, middle, high = np.exp(logarithm + self._quantiles()).tolist()
        return Prediction(middle, Interval(low, high), bool(self.slopes.any()))

    def _quantiles(self) -> Matrix:
        """Ends of the interval and median of an error.

        A new error falls below the j-th smallest of n with probability j / (n + 1), and ranks between whole ones are
        interpolated (Hyndman & Fan 1996, doi:10.1080/00031305.1996.10473566, definition 6). Too few errors to have
        such ranks are taken as normal.
        """
        tail, count = (1.0 - self.level) / 2.0, self.errors.size
        if tail * (count + 1) >= 1.0 - 1e-9:
            return np.asarray(np.quantile(self.errors, [tail, 0.5, 1.0 - tail], method="weibull"))
        half = float(stats.t.ppf(1.0 - tail, count - 1)) * self.errors.std(ddof=1) * math.sqrt(1.0 + 1.0 / count)
        return float(self.errors.mean()) + np.array([-half, 0.0, half])


def fit_predictor(features: ArrayLike, vs: ArrayLike, level: float = 0.95) -> VelocityPredictor:
    """Fit the predictor of one content by least squares to features (n, k) and positive velocities (n,), m/s.

    With k of 0 the content alone is left, and so are features that do not vary. `ValueError` if there are fewer than
    three samples more than features, or lengths differ. The error of a left-out sample is that of the fit to all over
    one less its own influence (Allen 1974, doi:10.1080/00401706.1974.10489157).
    """
    x, y = np.asarray(features, dtype=np.float64), np.log(np.asarray(vs, dtype=np.float64))
    if x.ndim != 2 or len(x) != len(y) or len(y) < FEWEST_ROWS + x.shape[1]:  # noqa: PLR2004 - a table
        fewest = f"at least {FEWEST_ROWS} more than features"
        raise ValueError(f"features {x.shape} and vs {y.shape}: give one row for each velocity, and {fewest}")
    centred = x - x.mean(axis=0)
    scale = np.linalg.norm(centred, axis=0)
    varied = scale > _CONSTANT * np.linalg.norm(x, axis=0)
    standard = centred[:, varied] / scale[varied]
    # The pseudo-inverse, since features may depend on one another: some of a path are sums of others.
    inverse = np.linalg.pinv(standard, rcond=1e-9)
    weights = inverse @ (y - y.mean())
    influence = np.einsum("ik,ki->i", standard, inverse) + 1.0 / y.size
    errors = (y - y.mean() - standard @ weights) / (1.0 - influence)
    slopes = np.zeros(x.shape[1])
    slopes[varied] = weights / scale[varied]
    return VelocityPredictor(float(y.mean() - x.mean(axis=0) @ slopes), slopes, errors, level)


def interval_score(interval: Interval, value: float, level: float) -> float:
    """Width of an interval, and 2 / (1 - level) times the distance of a value that lies outside; smaller is better.

    Gneiting & Raftery (2007), doi:10.1198/016214506000001437, Eq. 43; it is least on average for the true quantiles.
    """
    outside = max(0.0, interval.low - value, value - interval.high)
    return interval.high - interval.low + 2.0 / (1.0 - level) * outside


@dataclass(frozen=True, slots=True, eq=False)
class PredictorCheck:
    """How the predictor of a content fares on samples that it was not fitted to.

    Attributes
    ----------
    inside
        Whether each sample lay in its interval, shape (n,).
    scores
        Interval score of each in m/s, shape (n,).
    """

    inside: NDArray[np.bool_]
    scores: Matrix

    @property
    def n(self) -> int:
        """Number of samples, each of a seed of its own."""
        return self.scores.size

    @property
    def coverage(self) -> float:
        """Share of the samples in their interval."""
        return float(self.inside.mean())

    @property
    def score(self) -> float:
        """Mean interval score in m/s."""
        return float(self.scores.mean())


def check_predictor(features: ArrayLike, vs: ArrayLike, level: float = 0.95) -> PredictorCheck:
    """Predict each sample of one content from all others; arguments and errors of `fit_predictor`, one sample more."""
    x, y = np.asarray(features, dtype=np.float64), np.asarray(vs, dtype=np.float64)
    intervals = [
        fit_predictor(np.delete(x, out, axis=0), np.delete(y, out), level).predict(x[out]).interval
        for out in range(len(y))
    ]
    pairs = list(zip(intervals, y.tolist(), strict=True))
    return PredictorCheck(
        np.array([interval.contains(value) for interval, value in pairs]),
        np.array([interval_score(interval, value, level) for interval, value in pairs]),
    )
