"""Sobol indices: share of the variance of an output due to each uncertain parameter."""

import math
from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from calcidem.analysis.intervals import BOOTSTRAP_SEED
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
