"""Comparison of a campaign with laboratory velocities."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calcidem.analysis.distribution import ContentDistribution


@dataclass(frozen=True, slots=True)
class Target:
    """Laboratory measurement at one content."""

    content: float
    """Percent."""
    vs: float
    """Mean, m/s."""
    sd: float | None = None
    """Standard deviation between samples, m/s; None if unknown or not to be fitted."""
    samples: int | None = None
    """Number of samples of both; None if they count as exact."""


@dataclass(frozen=True, slots=True)
class _Misfit:
    """Comparison of a campaign with a measurement at one content."""

    measured: Target
    """Measurement."""
    mean: float
    standard_deviation: float
    """Values of the campaign there, m/s, interpolated linearly between its contents."""
    interpolated: bool
    """True if the campaign lacks the content itself."""
    difference: float
    """Relative difference of the mean from the measured one."""
    standard_errors: float
    """Difference of both means over its standard error; NaN without scatter."""
    deviation_ratio: float
    """Standard deviation over the measured one; NaN if the latter is unknown."""


def misfits(distributions: Sequence[ContentDistribution], measured: Sequence[Target]) -> tuple[_Misfit, ...]:
    """Compare a campaign with measured velocities, except those outside the range of its contents.

    The distributions are in order of content; contents without a velocity do not count.
    """
    rows = [row for row in distributions if row.vs.n]
    contents = np.array([row.content for row in rows])
    return tuple(
        _misfit(rows, contents, target)
        for target in sorted(measured, key=lambda target: target.content)
        if contents.size and contents[0] - _EQUAL_CONTENTS <= target.content <= contents[-1] + _EQUAL_CONTENTS
    )


_EQUAL_CONTENTS = 1e-6
"""Largest difference of equal contents, percent, since they are parsed from text."""


def _misfit(rows: Sequence[ContentDistribution], contents: np.ndarray, target: Target) -> _Misfit:
    """Compare at one content."""
    here = [[row.vs.mean, row.vs.standard_deviation, row.vs.standard_deviation / math.sqrt(row.vs.n)] for row in rows]
    mean, deviation, error = (float(np.interp(target.content, contents, column)) for column in np.array(here).T)
    of_target = 0.0 if target.sd is None or target.samples is None else target.sd / math.sqrt(target.samples)
    both = math.hypot(0.0 if math.isnan(error) else error, of_target)
    return _Misfit(
        measured=target,
        mean=mean,
        standard_deviation=deviation,
        interpolated=bool(np.min(np.abs(contents - target.content)) > _EQUAL_CONTENTS),
        difference=mean / target.vs - 1.0,
        standard_errors=(mean - target.vs) / both if both else math.nan,
        deviation_ratio=math.nan if target.sd is None else deviation / target.sd,
    )


def root_mean_square_misfit(found: Sequence[_Misfit]) -> float:
    """Root mean square of the relative differences of the means; NaN if there are none."""
    return float(np.sqrt(np.mean([one.difference**2 for one in found]))) if found else math.nan
