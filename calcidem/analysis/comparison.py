"""Comparison of campaigns: means, scatter, and differences from the first campaign with intervals."""

import math
from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from calcidem.analysis.intervals import (
    UNDEFINED,
    Interval,
    mean,
    standard_deviation,
)
from calcidem.analysis.sensitivity import paired_changes

_FEWEST_FOR_CORRELATION = 3

_COMPARED = {
    "n": ("1", "samples with a velocity"),
    "mean": ("m/s", "mean of Vs"),
    "standard_deviation": ("m/s", "standard deviation of Vs"),
    "difference": ("m/s", "mean of Vs minus that of the first campaign"),
    "pairs": ("1", "seeds with a velocity in this campaign and in the first"),
    "paired_difference": ("m/s", "mean difference of Vs to the first campaign over these seeds"),
    "deviation_ratio": ("1", "standard deviation of Vs over that of the first campaign, over these seeds"),
    "pair_correlation": ("1", "Pearson's correlation of Vs with the first campaign over these seeds"),
}
_INTERVALS = ("mean", "standard_deviation", "difference", "paired_difference", "deviation_ratio")


def compare_velocities(velocities: Mapping[str, xr.DataArray], level: float = 0.95) -> xr.Dataset:
    """Compare the velocities of several named campaigns with those of the first, content by content.

    Vs is in m/s along (seed, content), NaN if missing. The result is along (campaign, content), intervals also along
    `bound`. It has the contents of all campaigns; missing values are NaN. ``difference``
    assumes independent samples (Welch's interval). ``paired_difference`` uses common seeds. It cancels the effect of
    the cement's places, so it is the narrower one if equal seeds have equal places (``pair_correlation``). Both are NaN
    for the first campaign. `ValueError` for fewer than two campaigns.
    """
    if len(velocities) <= 1:
        raise ValueError(f"{len(velocities)} campaigns are given; a comparison needs two or more")
    contents = np.unique(np.concatenate([vs["content"].to_numpy() for vs in velocities.values()]))
    first = next(iter(velocities.values()))
    cells = [
        [_compare_content(vs, None if vs is first else first, float(content), level) for content in contents]
        for vs in velocities.values()
    ]
    table = xr.Dataset(coords={"campaign": list(velocities), "content": contents, "bound": ["low", "high"]})
    table["content"].attrs = {"units": "%", "long_name": "calcite content by sand mass"}
    for name, (unit, text) in _COMPARED.items():
        table[name] = ("campaign", "content"), [[numbers[name] for numbers, _ in row] for row in cells]
        table[name].attrs = {"units": unit, "long_name": text}
    for name in _INTERVALS:
        bounds = [[(found[name].low, found[name].high) for _, found in row] for row in cells]
        table[f"{name}_interval"] = ("campaign", "content", "bound"), bounds
        table[f"{name}_interval"].attrs = {
            "units": _COMPARED[name][0],
            "long_name": f"interval of {name.replace('_', ' ')}",
        }
    return table.assign_attrs(level=level)


def _compare_content(
    vs: xr.DataArray, first: xr.DataArray | None, content: float, level: float
) -> tuple[dict[str, float], dict[str, Interval]]:
    """Return numbers and intervals of one campaign at one content; `first` is None for the first campaign itself."""
    here = _values_of(vs, content)
    values = np.array(list(here.values()))
    numbers: dict[str, float] = dict.fromkeys(_COMPARED, math.nan) | {"n": len(values)}
    intervals = dict.fromkeys(_INTERVALS, UNDEFINED)
    if len(values):
        numbers["mean"], intervals["mean"] = float(mean(values)), Interval.of_mean(values, level)
    if len(values) > 1:
        numbers["standard_deviation"] = float(standard_deviation(values))
        intervals["standard_deviation"] = Interval.of_standard_deviation(values, level)
    if first is None:
        return numbers, intervals
    there = _values_of(first, content)
    references = np.array(list(there.values()))
    if len(values) and len(references):
        numbers["difference"] = float(mean(values) - mean(references))
        intervals["difference"] = Interval.of_difference(values, references, level)
    shared = [seed for seed in here if seed in there]
    numbers["pairs"] = len(shared)
    if len(shared) > 1:
        pairs = np.array([(here[seed], there[seed]) for seed in shared])
        differences = pairs[:, 0] - pairs[:, 1]
        numbers["paired_difference"] = float(mean(differences))
        intervals["paired_difference"] = Interval.of_mean(differences, level)
        numbers["pair_correlation"] = _correlation(pairs)
        (change,) = paired_changes(vs.sel(content=[content]), first.sel(content=[content]), level)
        numbers["deviation_ratio"] = change.deviation_ratio if math.isfinite(change.deviation_ratio) else math.nan
        intervals["deviation_ratio"] = change.deviation_ratio_interval
    return numbers, intervals


def _values_of(vs: xr.DataArray, content: float) -> dict[int, float]:
    """Velocities of a content by seed; empty if the campaign lacks it."""
    if content not in vs["content"]:
        return {}
    column = vs.sel(content=content).dropna("seed")
    return dict(zip(column["seed"].to_numpy().tolist(), column.to_numpy().tolist(), strict=True))


def _correlation(pairs: NDArray[np.float64]) -> float:
    """Pearson's correlation of two columns; NaN for few pairs or a constant column."""
    if len(pairs) < _FEWEST_FOR_CORRELATION or not standard_deviation(pairs, axis=0).all():
        return math.nan
    return float(np.corrcoef(*pairs.T).item(1))
