"""The four stages of growth of Vs with calcite content, and their rates (section 3.2.1)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class Stage:
    """A range of calcite content."""

    name: str
    """Roman numeral, as in the paper."""
    low: float
    high: float
    """First and last content, in percent of sand mass."""


STAGES = (
    Stage("I", 0.11, 0.66),
    Stage("II", 1.24, 3.17),
    Stage("III", 4.0, 6.0),
    Stage("IV", 7.0, 9.0),
)
"""Ranges whose end points give the printed growth rates. The text of the paper has other bounds (0.66, 2.55 and
6 %), which do not give these rates; see docs/reproduction/published_check.py."""


@dataclass(frozen=True, slots=True)
class StageGrowth:
    """Growth of mean Vs within one stage."""

    stage: Stage
    """The range."""
    contents: tuple[float, ...]
    """Contents of the campaign in this range, in percent."""
    end_point_slope: float
    """Difference of the means at the last and first content over the difference of content, in m/s per percent: the
    paper's rate.
    """
    least_squares_slope: float
    """Slope of the regression line through all means, in m/s per percent. Both are NaN with fewer than two contents."""


def growth_by_stage(
    content: ArrayLike, mean_vs: ArrayLike, stages: tuple[Stage, ...] = STAGES
) -> tuple[StageGrowth, ...]:
    """Return the growth rate of each stage from contents (%) and mean velocities (m/s), both (k,), without NaN."""
    contents, means = np.asarray(content, dtype=np.float64), np.asarray(mean_vs, dtype=np.float64)
    if contents.ndim != 1 or contents.shape != means.shape:
        raise ValueError(
            f"content has shape {contents.shape} and mean_vs {means.shape}; give one mean for each content"
        )
    order = np.argsort(contents)
    contents, means = contents[order], means[order]
    growth = []
    for stage in stages:
        # Contents are parsed from decimal text; a difference in the last bit must not exclude one.
        inside = (contents >= stage.low - 1e-9) & (contents <= stage.high + 1e-9) & np.isfinite(means)
        x, y = contents[inside], means[inside]
        enough = x.size > 1
        growth.append(
            StageGrowth(
                stage=stage,
                contents=tuple(x.tolist()),
                end_point_slope=float((y[-1] - y[0]) / (x[-1] - x[0])) if enough else math.nan,
                least_squares_slope=float(np.polyfit(x, y, 1)[0]) if enough else math.nan,
            )
        )
    return tuple(growth)
