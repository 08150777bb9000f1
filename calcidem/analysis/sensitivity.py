"""Effect of a setting on mean and scatter of Vs, for the same seeds."""

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr

from calcidem.analysis.intervals import BOOTSTRAP_SEED, UNDEFINED, Interval


@dataclass(frozen=True, slots=True)
class Change:
    """Comparison of a variant with the same seeds of the reference at one content."""

    content: float
    """Percent."""
    planned: int
    measured: int
    """Number of cells of the variant, and of those with a velocity."""
    mean: float
    standard_deviation: float
    """Of all measured cells of the variant, m/s."""
    mean_ratio: float
    deviation_ratio: float
    """Mean and standard deviation over those of the reference, for seeds with a velocity in both."""
    deviation_ratio_interval: Interval
    """Bootstrap interval of the deviation ratio; the same seeds are drawn with replacement on both sides."""


def paired_changes(variant: xr.DataArray, reference: xr.DataArray, level: float = 0.95) -> tuple[Change, ...]:
    """Compare two matrices of Vs (m/s) along (seed, content), NaN if missing, on their common seeds.

    Contents that the reference lacks are left out.
    """
    first, second = xr.align(variant, reference, join="inner")
    changes = []
    for content in first["content"].to_numpy().tolist():
        own = variant.sel(content=content).to_numpy()
        pair = np.stack([first.sel(content=content).to_numpy(), second.sel(content=content).to_numpy()])
        measured = own[np.isfinite(own)]
        mean_ratio, deviation_ratio, interval = _paired_ratios(pair[:, np.isfinite(pair).all(axis=0)], level)
        changes.append(
            Change(
                content=content,
                planned=own.size,
                measured=measured.size,
                mean=float(measured.mean()) if measured.size else math.nan,
                standard_deviation=float(measured.std(ddof=1)) if measured.size > 1 else math.nan,
                mean_ratio=mean_ratio,
                deviation_ratio=deviation_ratio,
                deviation_ratio_interval=interval,
            )
        )
    return tuple(changes)


def _paired_ratios(pair: np.ndarray, level: float) -> tuple[float, float, Interval]:
    """Ratios of means and of standard deviations of two rows of equal seeds, shape (2, n); interval of the latter."""
    count = pair.shape[1]
    if count < 4:  # common seeds, for a meaningful ratio of standard deviations
        return math.nan, math.nan, UNDEFINED
    drawn = pair[:, np.random.default_rng(BOOTSTRAP_SEED).integers(0, count, (4000, count))]
    # A reference without scatter (no cement, one packing) has no deviation ratio.
    with np.errstate(divide="ignore", invalid="ignore"):
        deviations = drawn[0].std(axis=1) / drawn[1].std(axis=1)
        ratio = float(np.divide(*pair.std(axis=1)))
    mean_ratio, finite = float(np.divide(*pair.mean(axis=1))), deviations[np.isfinite(deviations)]
    if not finite.size:
        return mean_ratio, ratio, UNDEFINED
    low, high = np.quantile(finite, [(1 - level) / 2, (1 + level) / 2]).tolist()
    return mean_ratio, ratio, Interval(low, high)
