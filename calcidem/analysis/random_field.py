"""Variance and correlation length of fields: what a random-field model of a soil takes in."""

import numpy as np
import xarray as xr
from numpy.typing import NDArray


def correlation(fields: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Give the autocorrelation of fields along one of their axes.

    Parameters
    ----------
    fields
        (..., Y, X) realizations on a regular grid; NaN are left out.
    axis
        -1 for x, -2 for y.

    Returns
    -------
    ndarray
        (L,) for lags of 0, 1, 2, ... steps; NaN where no two values are so far apart.

    Notes
    -----
    The mean is that of all fields together: the mean of each would take away what is longer than a sample.
    """
    centred = np.moveaxis(fields - np.nanmean(fields), axis, -1)
    known, values = np.isfinite(centred), np.nan_to_num(centred)
    count = centred.shape[-1]
    sums = np.array([(values[..., lag:] * values[..., : count - lag]).sum() for lag in range(count)])
    pairs = np.array([(known[..., lag:] & known[..., : count - lag]).sum() for lag in range(count)])
    with np.errstate(invalid="ignore", divide="ignore"):
        covariance = sums / pairs
        return np.asarray(covariance / covariance[0])


def scale_of_fluctuation(correlations: NDArray[np.float64], step: float) -> float:
    """Give twice the area below an autocorrelation (L,) up to its first zero, in the unit of the step.

    Vanmarcke (1983), *Random Fields*, chapter 5. It is 2 / b for ``exp(-b x)``, and the side of the window for
    uncorrelated values that are averaged over a window. Where it ends before its first zero, it is too small. NaN
    without any correlation, as for equal values.
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


def field_statistics(fields: xr.DataArray) -> xr.Dataset:
    """Describe positive fields at each content as random-field models take them: log-normal, with a length.

    Parameters
    ----------
    fields
        Dimensions (content, seed, y, x), coordinates x and y in m on a regular grid; NaN where there is no value.

    Returns
    -------
    xarray.Dataset
        Along content: `geometric_mean` in the unit of the fields, `log_deviation` of the natural logarithm, `between`
        the part of its variance that is between the means of samples, and the scales of fluctuation of the logarithm
        along x and y, `scale_x` and `scale_y`, m. `unknown` is the part of the places without a value.
    """
    steps = {axis: float(np.diff(fields[axis])[0]) if fields.sizes[axis] > 1 else np.nan for axis in ("x", "y")}
    rows = []
    for content in fields["content"].to_numpy():
        values = fields.sel(content=content).transpose("seed", "y", "x").to_numpy()
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.where(values > 0.0, np.log(values), np.nan)
        if not np.isfinite(logs).any():
            rows.append((*(np.nan,) * 5, 1.0))
            continue
        variance = float(np.nanvar(logs))
        means = np.nanmean(logs.reshape(len(logs), -1), axis=1)
        rows.append(
            (
                float(np.exp(np.nanmean(logs))),
                float(np.sqrt(variance)),
                float(np.var(means)) / variance if variance > 0.0 else np.nan,
                scale_of_fluctuation(correlation(logs, -1), steps["x"]),
                scale_of_fluctuation(correlation(logs, -2), steps["y"]),
                float(np.mean(~np.isfinite(logs))),
            )
        )
    names = ("geometric_mean", "log_deviation", "between", "scale_x", "scale_y", "unknown")
    columns = dict(zip(names, np.array(rows).T, strict=True))
    return xr.Dataset({name: ("content", values) for name, values in columns.items()}, {"content": fields["content"]})
