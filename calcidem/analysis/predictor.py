"""Vs of a sample that was not simulated, and an interval: from what its content alone says, and from its path.

Each content has a predictor of its own, so that the interval is as wide as Vs scatters there. The logarithm of Vs is
linear in the features (ridge regression), and the interval has the quantiles of the errors of samples that the
regression has not seen: it assumes no distribution and is never negative. Features count only where they make these
errors smaller than chance does; otherwise the content alone is left. Where sets of features are to choose from, the one
with the smallest errors is taken.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from calcidem.analysis.intervals import Interval

_PENALTIES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Tried for the ridge, relative to the variance of a feature."""

_BEYOND_CHANCE = 1.645
"""Standard errors that a normal variable exceeds in one of 20 cases."""

_FEWEST_ROWS = 3

Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Prediction:
    """Vs of a sample that was not simulated.

    Attributes
    ----------
    vs
        Its median, m/s.
    interval
        In which it falls with the probability asked for, m/s.
    uses_features
        Whether the features had a part in it; where they add nothing, the content alone made it.
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
        Logarithm of Vs (m/s) where all features are zero, and its change with each, shape (k,); slopes of zero where
        features add nothing.
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


def fit_predictor(
    features: ArrayLike, vs: ArrayLike, level: float = 0.95, choices: Sequence[Sequence[int]] | None = None
) -> VelocityPredictor:
    """Fit the predictor of one content.

    Parameters
    ----------
    features
        Of each sample, shape (n, k); with k of 0 the content alone is left.
    vs
        Velocity of each in m/s, positive, shape (n,).
    level
        Probability of the intervals.
    choices
        Sets of columns of ``features`` of which the best is taken; all columns are the only one if not given.

    Raises
    ------
    ValueError
        If there are fewer than three samples, or lengths differ.

    Notes
    -----
    Ridge regression (Hoerl & Kennard 1970, doi:10.1080/00401706.1970.10488634) of standardised features, with the
    columns and the penalty whose squared errors of left-out samples are least. What they take off the squared errors of
    the content alone has to be more than chance gives in 19 of 20 cases.
    """
    x, y = np.asarray(features, dtype=np.float64), np.log(np.asarray(vs, dtype=np.float64))
    if y.size < _FEWEST_ROWS or x.ndim != 2 or len(x) != len(y):  # noqa: PLR2004 - a table
        raise ValueError(f"features {x.shape} and vs {y.shape}: give one row for each velocity, and at least 3 of them")
    alone = (y - y.mean()) * y.size / (y.size - 1)
    nothing = VelocityPredictor(float(y.mean()), np.zeros(x.shape[1]), alone, level)
    sets = [range(x.shape[1])] if choices is None else choices
    fits = [fit for columns in sets if (fit := _best_ridge(x, y, columns)) is not None]
    if not fits:
        return nothing
    errors, slopes = min(fits, key=lambda fit: float(fit[0] @ fit[0]))
    gain = alone**2 - errors**2
    if gain.mean() <= _BEYOND_CHANCE * gain.std(ddof=1) / math.sqrt(y.size):
        return nothing
    return VelocityPredictor(float(y.mean() - x.mean(axis=0) @ slopes), slopes, errors, level)


def _best_ridge(x: Matrix, y: Matrix, columns: Sequence[int]) -> tuple[Matrix, Matrix] | None:
    """Errors of left-out samples (n,) and slopes (k,) with some columns and the best penalty; None if none varies."""
    scale, wanted = x.std(axis=0), np.isin(np.arange(x.shape[1]), columns)
    varied = wanted & (scale > 1e-12 * np.abs(x).max(axis=0, initial=0.0))
    if not varied.any():
        return None
    standard = (x[:, varied] - x[:, varied].mean(axis=0)) / scale[varied]
    left, values, right = np.linalg.svd(standard, full_matrices=False)
    errors, weights = min(
        (_left_out_errors(left, values, y, penalty) for penalty in _PENALTIES),
        key=lambda found: float(found[0] @ found[0]),
    )
    slopes = np.zeros(x.shape[1])
    slopes[varied] = right.T @ weights / scale[varied]
    return errors, slopes


def _left_out_errors(left: Matrix, values: Matrix, y: Matrix, penalty: float) -> tuple[Matrix, Matrix]:
    """Errors of samples left out one by one, (n,), and weights of the right singular vectors.

    From one fit: each error of a linear smoother is that of the fit over one less its own influence (Allen 1974,
    doi:10.1080/00401706.1974.10489157).
    """
    centred = y - y.mean()
    shrunk = values**2 / (values**2 + penalty * y.size)
    part = left.T @ centred
    influence = (left**2) @ shrunk + 1.0 / y.size
    return (centred - left @ (shrunk * part)) / (1.0 - influence), values * part / (values**2 + penalty * y.size)


def _interval_score(interval: Interval, value: float, level: float) -> float:
    """Width of an interval, and 2 / (1 - level) times the distance of a value that lies outside; smaller is better.

    Gneiting & Raftery (2007), doi:10.1198/016214506000001437, Eq. 43; it is least on average for the true quantiles.
    """
    outside = max(0.0, interval.low - value, value - interval.high)
    return interval.high - interval.low + 2.0 / (1.0 - level) * outside


@dataclass(frozen=True, slots=True)
class PredictorCheck:
    """How the predictor of a content fares on samples that it was not fitted to.

    Attributes
    ----------
    n
        Number of samples, each of a seed of its own.
    coverage, score
        Share of them in their interval, and mean interval score in m/s.
    content_coverage, content_score
        The same of a predictor that knows only the content.
    used
        Columns of the features that the predictor fitted to all of them uses.
    """

    n: int
    coverage: float
    score: float
    content_coverage: float
    content_score: float
    used: tuple[int, ...]

    @property
    def features_help(self) -> bool:
        """Whether features make the intervals better at this content."""
        return bool(self.used) and self.score < self.content_score


def check_predictor(
    features: ArrayLike, vs: ArrayLike, level: float = 0.95, choices: Sequence[Sequence[int]] | None = None
) -> PredictorCheck:
    """Predict each sample of one content from all others, choice of features and penalty included.

    Parameters
    ----------
    features, vs, level, choices
        As for `fit_predictor`; one sample more is needed.

    Raises
    ------
    ValueError
        As `fit_predictor`.
    """
    x, y = np.asarray(features, dtype=np.float64), np.asarray(vs, dtype=np.float64)
    found = []
    for out in range(len(y)):
        others, known = np.delete(x, out, axis=0), np.delete(y, out)
        fitted = fit_predictor(others, known, level, choices), fit_predictor(others[:, :0], known, level)
        for predictor, own in zip(fitted, (x[out], ()), strict=True):
            interval = predictor.predict(own).interval
            found.append((interval.contains(y[out]), _interval_score(interval, y[out], level)))
    (coverage, score), (content_coverage, content_score) = (
        np.mean(found[first::2], axis=0).tolist() for first in (0, 1)
    )
    used = tuple(np.flatnonzero(fit_predictor(x, y, level, choices).slopes).tolist())
    return PredictorCheck(len(y), coverage, score, content_coverage, content_score, used)
