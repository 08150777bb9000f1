"""Variance and correlation length of fields: input of random-field models of soil."""

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

_FieldArray: TypeAlias = NDArray[np.floating[Any]]


def _autocorrelation(fields: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Autocorrelation (L,) of fields (..., Y, X) along x (-1) or y (-2) for lags of 0, 1, 2, ... steps.

    NaN are left out. The mean of all fields is subtracted; the mean of each would remove wavelengths above its size.
    """
    centred = np.moveaxis(fields - np.nanmean(fields), axis, -1)
    known, values = np.isfinite(centred), np.nan_to_num(centred)
    count = centred.shape[-1]
    sums = np.array([(values[..., lag:] * values[..., : count - lag]).sum() for lag in range(count)])
    pairs = np.array([(known[..., lag:] & known[..., : count - lag]).sum() for lag in range(count)])
    with np.errstate(invalid="ignore", divide="ignore"):
        covariance = sums / pairs
        return np.asarray(covariance / covariance[0])


def _scale_of_fluctuation(correlations: NDArray[np.float64], step: float) -> float:
    """Return twice the area below an autocorrelation (L,) up to its first zero, in the unit of the step.

    Vanmarcke (1983), *Random Fields*, chapter 5. It is 2 / b for ``exp(-b x)``, and the side of the window for window
    averages of uncorrelated values. It is too small if the data end before the first zero. NaN if the correlation is
    undefined, as for equal values.
    """
    if not np.isfinite(correlations[0]):
        return np.nan
    beyond = np.flatnonzero(~(correlations > 0.0))
    if not len(beyond):
        return float(2.0 * step * _area(correlations))
    last = int(beyond[0])
    whole = _area(correlations[:last])
    if not np.isfinite(correlations[last]):
        return float(2.0 * step * whole)
    rest = 0.5 * correlations[last - 1] ** 2 / (correlations[last - 1] - correlations[last])
    return float(2.0 * step * (whole + rest))


def _area(values: NDArray[np.float64]) -> float:
    """Area below values one step apart, by the trapezoidal rule."""
    return float(values.sum() - 0.5 * (values[0] + values[-1]))


def describe_fields(
    fields: Mapping[tuple[int, float], tuple[_FieldArray, _FieldArray, _FieldArray]],
) -> xr.Dataset:
    """Collect positive fields of samples, and describe them as log-normal random fields.

    `fields` has at least one sample. By seed and content it gives x (X,) and y (Y,) of a common regular grid, m, and
    values (Y, X), NaN if missing. The result has `shear_modulus` (content, seed, y, x), Pa, NaN for missing samples.
    Along content: `geometric_mean`, `log_deviation` of the natural logarithm, `between` the part of its variance
    between samples, and the scales of fluctuation of the logarithm along x and y, `scale_x` and `scale_y`, m.
    `unknown` is the share of grid points without a value.
    """
    x, y, first = next(iter(fields.values()))
    seeds, contents = (np.unique([key[place] for key in fields]) for place in (0, 1))
    values = np.full((len(contents), len(seeds), *first.shape), np.nan)
    for (seed, content), (_, _, found) in fields.items():
        values[np.searchsorted(contents, content), np.searchsorted(seeds, seed)] = found
    steps = [float(places[1] - places[0]) if len(places) > 1 else np.nan for places in (x, y)]
    names = ("geometric_mean", "log_deviation", "between", "scale_x", "scale_y", "unknown")
    columns = zip(names, np.array([_field_numbers(logs, *steps) for logs in np.log(values)]).T, strict=True)
    units = dict.fromkeys(("scale_x", "scale_y"), "m") | {"geometric_mean": "Pa"}
    return xr.Dataset(
        {name: ("content", column, {"units": units.get(name, "1")}) for name, column in columns}
        | {
            "shear_modulus": (
                ("content", "seed", "y", "x"),
                values,
                {"units": "Pa", "long_name": "local shear modulus"},
            )
        },
        {
            "content": ("content", contents, {"units": "percent"}),
            "seed": seeds,
            "y": ("y", y, {"units": "m"}),
            "x": ("x", x, {"units": "m"}),
        },
    )


def _field_numbers(logs: NDArray[np.float64], step_x: float, step_y: float) -> tuple[float, ...]:
    """Statistics of one content from logarithms (S, Y, X)."""
    if not np.isfinite(logs).any():
        return (*(np.nan,) * 5, 1.0)
    variance, samples = float(np.nanvar(logs)), logs[np.isfinite(logs).any(axis=(1, 2))]
    means = np.nanmean(samples.reshape(len(samples), -1), axis=1)
    return (
        float(np.exp(np.nanmean(logs))),
        float(np.sqrt(variance)),
        float(np.var(means)) / variance if variance > 0.0 else np.nan,
        _scale_of_fluctuation(_autocorrelation(samples, -1), step_x),
        _scale_of_fluctuation(_autocorrelation(samples, -2), step_y),
        float(np.mean(~np.isfinite(samples))),
    )
