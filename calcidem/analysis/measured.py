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
    here = [[row.vs.mean, row.vs.standard_deviation, row.vs.standard_deviation / math.sqrt(row.vs.n)] for row in rows]
    equal = 1e-6  # percent: contents are parsed from text
    found = []
    for target in sorted(measured, key=lambda target: target.content):
        if not rows or not contents[0] - equal <= target.content <= contents[-1] + equal:
            continue
        mean, deviation, error = (float(np.interp(target.content, contents, column)) for column in np.array(here).T)
        of_target = 0.0 if target.sd is None or target.samples is None else target.sd / math.sqrt(target.samples)
        both = math.hypot(0.0 if math.isnan(error) else error, of_target)
        found.append(
            _Misfit(
                measured=target,
                mean=mean,
                standard_deviation=deviation,
                interpolated=bool(np.min(np.abs(contents - target.content)) > equal),
                difference=mean / target.vs - 1.0,
                standard_errors=(mean - target.vs) / both if both else math.nan,
                deviation_ratio=math.nan if target.sd is None else deviation / target.sd,
            )
        )
    return tuple(found)


def root_mean_square_misfit(found: Sequence[_Misfit]) -> float:
    """Root mean square of the relative differences of the means; NaN if there are none."""
    return float(np.sqrt(np.mean([one.difference**2 for one in found]))) if found else math.nan
