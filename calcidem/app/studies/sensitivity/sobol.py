"""Which open numbers of a campaign decide mean, scatter and readability of Vs, all varied together."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from calcidem.analysis.sobol import OUTPUTS, campaign_outputs, sobol_indices, sobol_points
from calcidem.app.config.errors import ConfigurationError, Problem
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.parameters import ParameterRange, check_ranges, with_values
from calcidem.app.studies.sensitivity.plan import read_plan
from calcidem.app.studies.trials import check_cells, trial_workers
from calcidem.dem.sample.packing import Packing
from calcidem.storage.errors import CampaignMismatchError
from calcidem.storage.files import write_atomically
from calcidem.storage.netcdf.trial import refuse_unreadable

_SECONDS_BETWEEN_SAVES = 60.0

_NEGLIGIBLE = 0.02
"""Share of a variance with which a parameter is not found beside others that make all the rest."""


@dataclass(frozen=True, slots=True)
class SobolPlan:
    """What is varied, and where it is looked at.

    Attributes
    ----------
    configuration
        All other numbers, and the cells of every point: the seeds are the same in all of them.
    ranges
        Lowest and highest value of each parameter.
    bases
        Base points, a power of two; there are (parameters + 2) times as many points.
    """

    configuration: Configuration
    ranges: dict[str, tuple[float, float]]
    bases: int

    @property
    def contents(self) -> tuple[float, ...]:
        """Contents of every point, percent."""
        return self.configuration.campaign.contents

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of every point."""
        return self.configuration.campaign.seed_numbers


def load_sobol_plan(path: str | os.PathLike[str], bases: int) -> SobolPlan:
    """Read a plan whose table ``[ranges]`` has the lowest and the highest value by ``section.key``.

    Raises
    ------
    ConfigurationError
        With everything that is wrong with the file, the ranges or the configuration.
    """
    listed, configuration = read_plan(path)
    ranges = [ParameterRange(name, low, high) for name, (low, high) in listed.ranges.items()]
    check_ranges(configuration, ranges, os.fspath(path))
    plan = SobolPlan(configuration, {varied.name: (varied.low, varied.high) for varied in ranges}, bases)
    try:
        sobol_points(plan.ranges, bases)
    except ValueError as error:
        raise ConfigurationError(os.fspath(path), [Problem(str(error))]) from error
    return plan


def evaluate_points(
    plan: SobolPlan, packing: Packing, file: Path, cores: int = 1, say: Callable[[str], None] = lambda _: None
) -> xr.Dataset:
    """Measure Vs at all points of a plan, or at those that the file lacks; the same call goes on after a stop.

    Parameters
    ----------
    plan
        What to measure.
    packing
        Of the configuration.
    file
        NetCDF file of the points, written every minute.
    cores
        Batches of seeds that are computed at a time.
    say
        Told the forecast before the points begin, and how far they are.

    Returns
    -------
    xarray.Dataset
        ``vs`` (point, content, seed) in m/s, NaN where there is none, ``value`` (point, parameter), ``done`` (point).

    Raises
    ------
    ConfigurationError
        If the packing cannot hold the cells.
    CampaignMismatchError
        If the file is of another plan.
    """
    check_cells(plan.configuration, packing, plan.contents, plan.seeds)
    points = stored_points(plan, file)
    left = np.flatnonzero(~points["done"].to_numpy())
    if not left.size:
        return points
    values = [dict(zip(plan.ranges, row, strict=True)) for row in points["value"].to_numpy()[left].tolist()]
    tried = [with_values(plan.configuration, changed) for changed in values]
    _save_points(points, file)  # a place that cannot be written is told before hours of work
    saved = time.monotonic()
    with trial_workers(packing, plan.contents, plan.seeds, cores) as measure_trials:
        say(
            _forecast(
                lambda: list(measure_trials([plan.configuration])), len(left), len(plan.contents) * len(plan.seeds)
            )
        )
        for count, (place, vs) in enumerate(zip(left, measure_trials(tried), strict=True), start=1):
            points["vs"][place] = vs.T
            points["done"][place] = True
            if time.monotonic() - saved > _SECONDS_BETWEEN_SAVES or count == len(left):
                saved = time.monotonic()
                _save_points(points, file)
                say(f"{count} of {len(left)} points")
    return points


def _save_points(points: xr.Dataset, file: Path) -> None:
    """Write the points in one step."""
    with write_atomically(file, replaces_netcdf=True) as temporary:
        points.to_netcdf(temporary)


def _forecast(measure_once: Callable[[], object], points: int, cells: int) -> str:
    """What the points cost, from the configuration as it stands; its first run loads the kernels and does not count."""
    measure_once()
    began = time.monotonic()
    measure_once()
    minutes = points * (time.monotonic() - began) / 60.0
    return f"{points} points of {cells} cells each: about {minutes:.1f} minutes on these cores."


def stored_points(plan: SobolPlan, file: Path) -> xr.Dataset:
    """Points of a plan as far as its file has them; none of a file that is not there.

    Raises
    ------
    CampaignMismatchError
        If the file is of another plan.
    """
    value = sobol_points(plan.ranges, plan.bases)
    shape = len(value), len(plan.contents), len(plan.seeds)
    empty = xr.Dataset(
        {
            "vs": (("point", "content", "seed"), np.full(shape, np.nan), {"units": "m s-1"}),
            "value": (("point", "parameter"), value),
            "done": ("point", np.zeros(len(value), dtype=bool)),
        },
        coords={"content": list(plan.contents), "seed": list(plan.seeds), "parameter": list(plan.ranges)},
        attrs={"title": "Points of a Sobol plan", "calcidem_campaign_hash": plan.configuration.hash},
    )
    if not file.exists():
        return empty
    refuse_unreadable(file)
    with xr.open_dataset(file, engine="netcdf4") as opened:
        found = opened.load()
    same = found.attrs.get("calcidem_campaign_hash") == plan.configuration.hash
    if not same or any(name not in found or not found[name].equals(empty[name]) for name in (*empty.coords, "value")):
        raise CampaignMismatchError(f"{file} holds points of another plan.", "Give another file with --db.")
    return found.assign(done=found["done"].astype(bool))


def indices_of_points(plan: SobolPlan, points: xr.Dataset) -> xr.Dataset:
    """Sobol indices along (output, content, parameter), see `calcidem.analysis.sobol.sobol_indices`."""
    vs = points["vs"].transpose("point", "content", "seed").to_numpy()
    outputs = campaign_outputs(np.where(points["done"].to_numpy()[:, None, None], vs, np.nan))
    outputs["readable_share"] = np.where(points["done"].to_numpy()[:, None], outputs["readable_share"], np.nan)
    by_output = [
        xr.concat([sobol_indices(plan.ranges, column) for column in values.T], dim="content")
        for values in outputs.values()
    ]
    coords = {"content": list(plan.contents), "output": list(outputs)}
    return xr.concat(by_output, dim="output").assign_coords(coords)


def sobol_table(indices: xr.Dataset) -> str:
    """Table in Markdown: a row for each output and parameter, a column for each content; first index, then total.

    Below it stands which parameters no calibration on these contents can find.
    """
    contents = [f"{content:g} %" for content in indices["content"].to_numpy()]
    lines = [f"| {' | '.join(['output', 'parameter', *contents])} |", f"|{'---|' * (2 + len(contents))}"]
    for output, label in OUTPUTS.items():
        for name in indices["parameter"].to_numpy().tolist():
            chosen = indices.sel(output=output, parameter=name)
            entries = [_index_entry(chosen.sel(content=content)) for content in indices["content"]]
            lines.append(f"| {' | '.join([label, str(name), *entries])} |")
    lost = ", ".join(_parameters_out_of_reach(indices))
    verdict = f"Mean and scatter hardly depend on {lost}: no calibration on these contents can find them."
    return "\n".join([*lines, "", *([verdict] if lost else []), ""])


def _index_entry(chosen: xr.Dataset) -> str:
    """First and total index of one parameter, with half-widths of their intervals."""
    if np.isnan(float(chosen["total"])):
        return "does not vary" if int(chosen["bases"]) else "not read"
    parts = (f"{float(chosen[name]):.2f} ± {float(chosen[name + '_half_width']):.2f}" for name in ("first", "total"))
    return ", total ".join(parts)


def _parameters_out_of_reach(indices: xr.Dataset) -> list[str]:
    """Parameters whose total index is surely above `_NEGLIGIBLE` neither for mean nor for sd / mean at any content."""
    decided = indices.sel(output=["mean", "relative_deviation"])
    if not int(decided["bases"].max()):
        return []
    reached = (decided["total"] - decided["total_half_width"] > _NEGLIGIBLE).any(("output", "content"))
    return [str(name) for name in indices["parameter"].to_numpy()[~reached.to_numpy()]]
