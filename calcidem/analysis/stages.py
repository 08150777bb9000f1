"""The four stages in which Vs grows with calcite content, and how fast it grows in each (section 3.2.1)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class Stage:
    """A range of calcite content.

    Attributes
    ----------
    name
        Roman numeral, as in the paper.
    low, high
        First and last content that belong to it, in percent of sand mass.
    """

    name: str
    low: float
    high: float


STAGES = (
    Stage("I", 0.11, 0.66),
    Stage("II", 1.24, 3.17),
    Stage("III", 4.0, 6.0),
    Stage("IV", 7.0, 9.0),
)
"""The ranges whose end points give the growth rates that the paper prints. Its text draws other borders
(0.66, 2.55 and 6 %), and with those its rates do not come out; see docs/reproduction/published_check.py."""


@dataclass(frozen=True, slots=True)
class StageGrowth:
    """How mean Vs grows within one stage.

    Attributes
    ----------
    stage
        The range.
    contents
        The contents of the campaign that fall into it, in percent.
    end_point_slope
        Difference of the mean at the last and the first of them over the difference of content, in m/s per
        percent: the paper's rate.
    least_squares_slope
        Slope of the straight line through all their means, in m/s per percent. Both are NaN with fewer than two
        contents.
    """

    stage: Stage
    contents: tuple[float, ...]
    end_point_slope: float
    least_squares_slope: float


def growth_by_stage(
    content: ArrayLike, mean_vs: ArrayLike, stages: tuple[Stage, ...] = STAGES
) -> tuple[StageGrowth, ...]:
    """Give the growth rate of each stage from contents (%) and mean velocities (m/s), both (k,); NaN is left out."""
    contents, means = np.asarray(content, dtype=np.float64), np.asarray(mean_vs, dtype=np.float64)
    if contents.ndim != 1 or contents.shape != means.shape:
        raise ValueError(
            f"content has shape {contents.shape} and mean_vs {means.shape}; give one mean for each content"
        )
    order = np.argsort(contents)
    contents, means = contents[order], means[order]
    growth = []
    for stage in stages:
        # Contents come out of text files and databases as decimals; a last-bit difference must not exclude one.
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
