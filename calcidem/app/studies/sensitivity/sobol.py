"""Influence of jointly varied parameters of a campaign on mean, scatter and readability of Vs."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Self

import numpy as np
import xarray as xr

from calcidem.analysis.figures.sensitivity import draw_sobol
from calcidem.analysis.sensitivity import OUTPUTS, campaign_outputs, sobol_indices, sobol_points
from calcidem.app.config.errors import ConfigurationError, Problem
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.parameters import ParameterRange, check_ranges, with_values
from calcidem.app.studies.results import StudyResult, markdown_table
from calcidem.app.studies.sensitivity.plan import read_plan
from calcidem.app.studies.trials import check_cells, trial_workers
from calcidem.dem.sample.packing import Packing
from calcidem.storage.errors import CampaignMismatchError
from calcidem.storage.files import write_atomically
from calcidem.storage.netcdf.trial import refuse_unreadable

_SECONDS_BETWEEN_SAVES = 60.0

_NEGLIGIBLE = 0.05
"""Total index below which a parameter is negligible: a calibration cannot determine it besides all others."""

_FEWEST_TO_NEGLECT = 32
"""Fewest base points for a reliable narrow interval."""


@dataclass(frozen=True, slots=True)
class SobolPlan:
    """Varied parameters, and cells of every point."""

    configuration: Configuration
    """All other numbers, and the cells of every point, with the same seeds."""
    ranges: dict[str, tuple[float, float]]
    """Lowest and highest value of each parameter."""
    bases: int
    """Base points, a power of two; there are (parameters + 2) times as many points."""

    @classmethod
    def load(cls, path: str | os.PathLike[str], bases: int) -> Self:
        """Read a plan with the lowest and the highest value by ``section.key`` in the table ``[ranges]``.

        `ConfigurationError` lists all problems of the file, the ranges and the configuration.
        """
        listed, configuration = read_plan(path)
        ranges = [ParameterRange(name, low, high) for name, (low, high) in listed.ranges.items()]
        check_ranges(configuration, ranges, os.fspath(path))
        plan = cls(configuration, {varied.name: (varied.low, varied.high) for varied in ranges}, bases)
        try:
            sobol_points(plan.ranges, bases)
        except ValueError as error:
            raise ConfigurationError(os.fspath(path), [Problem(str(error))]) from error
        return plan

    @property
    def contents(self) -> tuple[float, ...]:
        """Contents of every point, percent."""
        return self.configuration.campaign.contents

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of every point."""
        return self.configuration.campaign.seed_numbers

    def evaluate(
        self, packing: Packing, file: Path, cores: int = 1, say: Callable[[str], None] = lambda _: None
    ) -> xr.Dataset:
        """Measure Vs at all points that the file lacks; the same call continues after a stop.

        The NetCDF file of the points is written every minute. ``say`` receives the forecast at the start, and then the
        progress. Returns ``vs`` (point, content, seed) in m/s, NaN if missing, ``value`` (point, parameter) and
        ``done`` (point). `ConfigurationError` if the packing cannot hold the cells; `CampaignMismatchError` if the file
        belongs to another plan.
        """
        check_cells(self.configuration, packing, self.contents, self.seeds)
        points = self.stored(file)
        left = np.flatnonzero(~points["done"].to_numpy())
        if not left.size:
            return points
        values = [dict(zip(self.ranges, row, strict=True)) for row in points["value"].to_numpy()[left].tolist()]
        tried = [with_values(self.configuration, changed) for changed in values]
        _save_points(points, file)  # report an unwritable file before hours of work
        saved = time.monotonic()
        with trial_workers(packing, self.contents, self.seeds, cores) as measure_trials:
            say(
                _forecast(
                    lambda: list(measure_trials([self.configuration])), len(left), len(self.contents) * len(self.seeds)
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

    def stored(self, file: Path) -> xr.Dataset:
        """Points that a file has; none if the file does not exist.

        `CampaignMismatchError` if the file belongs to another plan.
        """
        value = sobol_points(self.ranges, self.bases)
        shape = len(value), len(self.contents), len(self.seeds)
        empty = xr.Dataset(
            {
                "vs": (("point", "content", "seed"), np.full(shape, np.nan), {"units": "m s-1"}),
                "value": (("point", "parameter"), value),
                "done": ("point", np.zeros(len(value), dtype=bool)),
            },
            coords={"content": list(self.contents), "seed": list(self.seeds), "parameter": list(self.ranges)},
            attrs={"title": "Points of a Sobol plan", "calcidem_campaign_hash": self.configuration.hash},
        )
        if not file.exists():
            return empty
        refuse_unreadable(file)
        with xr.open_dataset(file, engine="netcdf4") as opened:
            found = opened.load()
        same = found.attrs.get("calcidem_campaign_hash") == self.configuration.hash
        if not same or any(
            name not in found or not found[name].equals(empty[name]) for name in (*empty.coords, "value")
        ):
            raise CampaignMismatchError(f"{file} holds points of another plan.", "Give another file with --db.")
        return found.assign(done=found["done"].astype(bool))

    def indices(self, points: xr.Dataset) -> xr.Dataset:
        """Sobol indices along (output, content, parameter), see `calcidem.analysis.sensitivity.sobol_indices`.

        ``lowest`` and ``highest`` are the extreme outputs over the points, along (output, content).
        """
        vs = points["vs"].transpose("point", "content", "seed").to_numpy()
        outputs = campaign_outputs(np.where(points["done"].to_numpy()[:, None, None], vs, np.nan))
        outputs["readable_share"] = np.where(points["done"].to_numpy()[:, None], outputs["readable_share"], np.nan)
        by_output = [
            xr.concat([sobol_indices(self.ranges, column) for column in values.T], dim="content")
            for values in outputs.values()
        ]
        coords = {"content": list(self.contents), "output": list(outputs)}
        values = np.stack(list(outputs.values()))
        lowest, highest = (
            np.where(np.isfinite(values).any(axis=1), found, np.nan)
            for found in (
                np.min(values, axis=1, initial=np.inf, where=np.isfinite(values)),
                np.max(values, axis=1, initial=-np.inf, where=np.isfinite(values)),
            )
        )
        both = ("output", "content")
        return (
            xr.concat(by_output, dim="output")
            .assign_coords(coords)
            .assign(lowest=(both, lowest), highest=(both, highest))
        )

    def result(self, points: xr.Dataset) -> StudyResult:
        """Table and figure of the `indices`."""
        indices = self.indices(points)
        return StudyResult(_sobol_table(indices), figures={"": partial(draw_sobol, indices)})


def _save_points(points: xr.Dataset, file: Path) -> None:
    """Write the points atomically."""
    with write_atomically(file, replaces_netcdf=True) as temporary:
        points.to_netcdf(temporary)


def _forecast(measure_once: Callable[[], object], points: int, cells: int) -> str:
    """Cost of the points, from the unchanged configuration; its first run loads the kernels and does not count."""
    measure_once()
    began = time.monotonic()
    measure_once()
    minutes = points * (time.monotonic() - began) / 60.0
    return f"{points} points of {cells} cells each: about {minutes:.1f} minutes on these cores."


def _sobol_table(indices: xr.Dataset) -> str:
    """Markdown table: a row for each output and parameter, a column for each content; first index, then total.

    Text below it lists negligible and undecided parameters.
    """
    contents = indices["content"].to_numpy()
    rows = []
    for output, label in OUTPUTS.items():
        chosen = indices.sel(output=output)
        rows.append((label, "range over all points", *(_range_entry(chosen.sel(content=each)) for each in contents)))
        for name in indices["parameter"].to_numpy().tolist():
            one = chosen.sel(parameter=name)
            rows.append((label, str(name), *(_index_entry(one.sel(content=each)) for each in contents)))
    table = markdown_table(("output", "parameter", *(f"{content:g} %" for content in contents)), rows)
    return "\n".join([table, "", *_verdicts(indices), ""])


def _range_entry(chosen: xr.Dataset) -> str:
    """Smallest and largest output over the points."""
    low, high = float(chosen["lowest"]), float(chosen["highest"])
    return "not read" if np.isnan(low) else f"{low:.3g} to {high:.3g}"


def _index_entry(chosen: xr.Dataset) -> str:
    """First and total index of one parameter, with half-widths of the intervals."""
    if np.isnan(float(chosen["total"])):
        return "does not vary" if int(chosen["bases"]) else "not read"
    parts = (f"{float(chosen[name]):.2f} ± {float(chosen[name + '_half_width']):.2f}" for name in ("first", "total"))
    return ", total ".join(parts)


def _verdicts(indices: xr.Dataset) -> list[str]:
    """List parameters that are negligible for mean and sd / mean at all contents, and undecided ones."""
    groups = _parameters_by_weight(indices)
    bases = int(indices["bases"].sel(output=["mean", "relative_deviation"]).max())
    found = []
    if groups["negligible"]:
        found.append(
            f"Negligible for mean and scatter (each 95 % interval of the total index ends below {_NEGLIGIBLE:g}): "
            f"{', '.join(groups['negligible'])}. A calibration on these contents cannot find them."
        )
    if groups["undecided"]:
        found.append(
            f"Not decided from {bases} base points: {', '.join(groups['undecided'])}. They may matter: an interval "
            f"of a total index reaches above {_NEGLIGIBLE:g}, or fewer than {_FEWEST_TO_NEGLECT} base points were "
            "read. Compute more base points."
        )
    return found


def _parameters_by_weight(indices: xr.Dataset) -> dict[str, list[str]]:
    """Important, negligible and undecided parameters, by the totals of mean and sd / mean at all contents.

    A parameter is important if the interval of a total lies above `_NEGLIGIBLE`. It is negligible if all intervals lie
    below it and there are enough base points.
    """
    decided = indices.sel(output=["mean", "relative_deviation"])
    groups: dict[str, list[str]] = {"matters": [], "negligible": [], "undecided": []}
    if not int(decided["bases"].max()):
        return groups
    low, high = (decided["total"] + sign * decided["total_half_width"] for sign in (-1, 1))
    matters = (low > _NEGLIGIBLE).any(("output", "content"))
    # A constant output at a content has no index there and does not affect the verdict.
    below = ((high < _NEGLIGIBLE) | high.isnull()).all(("output", "content"))
    enough = int(decided["bases"].where(decided["bases"] > 0).min()) >= _FEWEST_TO_NEGLECT
    for name in indices["parameter"].to_numpy().tolist():
        small = enough and bool(below.sel(parameter=name))
        groups["matters" if bool(matters.sel(parameter=name)) else "negligible" if small else "undecided"].append(name)
    return groups
