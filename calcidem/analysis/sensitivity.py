"""Effect of settings on mean and scatter of Vs: one at a time for the same seeds, or all by Sobol indices."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from calcidem.analysis.intervals import BOOTSTRAP_SEED, UNDEFINED, Interval
from calcidem.storage.errors import StoreError

_RESAMPLES = 1000

_FEWEST_BASES = 4
"""Fewest base points for meaningful indices."""

OUTPUTS = {"mean": "mean Vs (m/s)", "relative_deviation": "sd / mean", "readable_share": "readable share"}
"""Outputs of `campaign_outputs` for each content, and their names in figures and tables."""


def sobol_points(ranges: Mapping[str, tuple[float, float]], bases: int) -> NDArray[np.float64]:
    """Return the points at which to evaluate a model, shape (bases (P + 2), P), the same in every call.

    Each of the P parameters is uniform in its range; ``bases`` is a power of two, else `ValueError`. `StoreError` if
    SALib is not installed. The points are a scrambled Sobol sequence, each base point with its P crossings (Saltelli
    2010, doi:10.1016/j.cpc.2009.09.018).
    """
    if bases < _FEWEST_BASES or bases & (bases - 1):
        raise ValueError(f"bases = {bases}: give a power of two of at least {_FEWEST_BASES}, such as 32")
    points = _salib("sample").sample(_problem(ranges), bases, calc_second_order=False, seed=BOOTSTRAP_SEED)
    return np.asarray(points, dtype=np.float64)


def sobol_indices(ranges: Mapping[str, tuple[float, float]], output: ArrayLike, level: float = 0.95) -> xr.Dataset:
    """Estimate first and total Sobol indices from a model's output at `sobol_points`, NaN if missing.

    Base points with a missing crossing are left out. Returns along parameter ``first`` and ``total``, the shares of
    variance due to the parameter alone and with all others, and the half-widths ``first_half_width`` and
    ``total_half_width`` of their bootstrap intervals. ``bases`` is the number of used base points, 0 if fewer than
    four. In that case, or for constant output, all indices are NaN.
    """
    rows = np.asarray(output, dtype=np.float64).reshape(-1, len(ranges) + 2)
    whole = rows[np.isfinite(rows).all(axis=1)]
    whole = whole[: len(whole) if len(whole) >= _FEWEST_BASES else 0]
    names = {"first": "S1", "first_half_width": "S1_conf", "total": "ST", "total_half_width": "ST_conf"}
    found = dict.fromkeys(names.values(), np.full(len(ranges), math.nan))
    if len(whole) and np.ptp(whole) > 1e-12 * np.abs(whole).max():
        options: dict[str, Any] = {"calc_second_order": False, "num_resamples": _RESAMPLES, "conf_level": level}
        found = _salib("analyze").analyze(_problem(ranges), whole.ravel(), **options, seed=BOOTSTRAP_SEED)
    variables = {name: ("parameter", np.asarray(found[key], dtype=np.float64)) for name, key in names.items()}
    return xr.Dataset(variables | {"bases": len(whole)}, coords={"parameter": list(ranges)})


def campaign_outputs(vs: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Mean (m/s), relative standard deviation, and readable share of samples, each with the leading shape of ``vs``.

    Velocities are in m/s, NaN if missing, with seeds along the last axis. Fewer than two give no mean, since its seeds
    would differ from those elsewhere.
    """
    read = np.isfinite(vs)
    count = read.sum(axis=-1)
    enough = count > 1
    mean = np.where(enough, np.sum(vs, axis=-1, where=read) / np.maximum(count, 1), math.nan)
    squares = np.sum((vs - mean[..., None]) ** 2, axis=-1, where=read)
    deviation = np.sqrt(squares / np.maximum(count - 1, 1))
    return {"mean": mean, "relative_deviation": deviation / mean, "readable_share": count / vs.shape[-1]}


def _problem(ranges: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
    """Parameters in SALib's format."""
    return {"num_vars": len(ranges), "names": list(ranges), "bounds": [list(limits) for limits in ranges.values()]}


def _salib(part: str) -> Any:  # noqa: ANN401 - a module of an optional library, without types
    """SALib's module for Sobol sampling ("sample") or indices ("analyze")."""
    try:
        return import_module(f"SALib.{part}.sobol")
    except ModuleNotFoundError as error:
        raise StoreError(
            "Sobol indices need the library SALib.", "Install it: pip install 'calcidem[sobol]'."
        ) from error


_REPLICATES = 4000
_FEWEST_PAIRS = 4
"""Fewest common seeds for a meaningful ratio of standard deviations."""


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
    if count < _FEWEST_PAIRS:
        return math.nan, math.nan, UNDEFINED
    drawn = pair[:, np.random.default_rng(BOOTSTRAP_SEED).integers(0, count, (_REPLICATES, count))]
    # A reference without scatter (no cement, one packing) has no deviation ratio.
    with np.errstate(divide="ignore", invalid="ignore"):
        deviations = drawn[0].std(axis=1) / drawn[1].std(axis=1)
        ratio = float(np.divide(*pair.std(axis=1)))
    return float(np.divide(*pair.mean(axis=1))), ratio, _percentiles(deviations, level)


def _percentiles(values: np.ndarray, level: float = 0.95) -> Interval:
    """Central interval of bootstrap replicates."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return UNDEFINED
    low, high = np.quantile(finite, [(1 - level) / 2, (1 + level) / 2])
    return Interval(float(low), float(high))
