"""What studies share: cells measured with one experiment after another, deviations, and the result in all forms."""

import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any, Self, TypeVar

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from pydantic import TypeAdapter
from scipy.interpolate import CubicSpline

from calcidem.analysis.figures.style import save
from calcidem.app.campaign.identity import refuse_other_physics
from calcidem.app.campaign.packing import provide_packing, stored_packing
from calcidem.app.config.checks import check_against_packing
from calcidem.app.config.schema import Configuration
from calcidem.dem.kernels.compiling import seconds_compiling
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.check import check_content
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement, measure_all
from calcidem.dem.wave.section import Section
from calcidem.input_file import read_text
from calcidem.storage.errors import OutputRefusedError
from calcidem.storage.files import write_text_atomically
from calcidem.storage.netcdf import write_netcdf
from calcidem.storage.sql.store import Store

_Kind = TypeVar("_Kind")


@dataclass(frozen=True, slots=True, eq=False)
class StudyResult:
    """Results of a study."""

    text: str
    """Markdown tables to show."""
    page: str = ""
    """Tables for the file, if they differ from those to show."""
    rows: Sequence[Mapping[str, Any]] = ()
    """One for each case, for CSV and Parquet."""
    json: str = ""
    """All results, for programs."""
    dataset: xr.Dataset | None = None
    """All results, for NetCDF."""
    figures: Mapping[str, Callable[[], Figure]] = field(default_factory=dict)
    """Draws each figure by its name; without a name it has that of the table."""
    formats: tuple[str, ...] = ("png",)
    """Formats of the figures."""
    is_wrong: bool = False
    """Whether the program was wrong without saying so."""

    def write(self, table: Path) -> Iterator[Path]:
        """Write the tables, after NetCDF, figures and JSON beside them; yields each file."""
        table.parent.mkdir(parents=True, exist_ok=True)
        if self.dataset is not None:
            write_netcdf(self.dataset, table.with_suffix(".nc"))
            yield table.with_suffix(".nc")
        for name, draw in self.figures.items():
            yield from save(draw(), table.parent, name or table.stem, self.formats)
        if self.json:
            write_text_atomically(table.with_suffix(".json"), self.json)
            yield table.with_suffix(".json")
        write_text_atomically(table, self.page or self.text)
        yield table


def read_former(file: Path, identity: Mapping[str, object], name: str, kind: type[_Kind]) -> _Kind:
    """Results ``name`` of an earlier start in a JSON file; `OutputRefusedError` if they are not of the same study."""
    try:
        told = json.loads(read_text(file, 100_000_000))  # bytes; 100 settings of 1,000 cells have fewer
        results = TypeAdapter(kind).validate_python(told[name])
        other = [key.replace("_", " ") for key, value in identity.items() if told[key] != value]
    except (ValueError, LookupError, TypeError) as error:
        raise OutputRefusedError(f"{file} is not a file of this command.", "Give another folder.") from error
    if other:
        raise OutputRefusedError(
            f"{file} has the results of another study: {', '.join(other)} differ.",
            "Give another folder, or the same configuration, database, seeds and settings to continue.",
        )
    return results


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Table with a line for each row; empty if there are no rows. Numbers with a point have two digits."""
    entries = [[number(entry) if isinstance(entry, float | None) else str(entry) for entry in row] for row in rows]
    lines = [f"| {' | '.join(row)} |" for row in entries]
    return "\n".join([f"| {' | '.join(header)} |", f"|{'---|' * len(header)}", *lines]) if lines else ""


def number(value: float | None, form: str = ".1e") -> str:
    """Format a number, or a dash if it is missing or not finite."""
    return "-" if value is None or not math.isfinite(value) else format(value, form)


ROUNDS = 3

CellsFound = Mapping[tuple[int, float], Measurement]
"""Measurements by seed and content in percent."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Cells of a campaign that a study measures with one experiment after another."""

    experiment: Experiment
    """Experiment of the campaign."""
    contents: Sequence[float]
    """Percent."""
    seeds: Sequence[int]
    lanes: int = 8
    """Width of the kernel; fewer seeds use a narrower one."""
    progress: Callable[[str], None] = lambda _: None
    """Receives a message before each part of a study."""

    @classmethod
    def of_campaign(
        cls,
        configuration: Configuration,
        seeds: int,
        database: str | os.PathLike[str] | None,
        progress: Callable[[str], None],
    ) -> Self:
        """Cells of all contents and the first seeds of a campaign, whose packing a database may supply.

        `CampaignMismatchError`, with both hashes, if the database's campaign, the only one or the one of that name, has
        another configuration.
        """
        plan = configuration.campaign
        if database is None:
            packing = provide_packing(configuration, None)
        else:
            with Store(database, read_only=True) as store:
                record = store.use_campaign(plan.name if len(store.campaigns()) > 1 else None)
                refuse_other_physics(record, configuration)
                packing = stored_packing(store.packing())
        check_against_packing(configuration, packing)
        experiment, lanes = configuration.experiment(packing), configuration.run.lanes
        return cls(experiment, sorted(plan.contents), plan.seed_numbers[:seeds], lanes, progress)

    def measure(self, experiment: Experiment, contents: Sequence[float] = (), seeds: Sequence[int] = ()) -> CellsFound:
        """Measure all cells, or those of some contents and seeds; `ValueError` if the experiment refuses one."""
        seeds = seeds or self.seeds
        lanes = self._width(seeds)
        return {
            (cell.seed, content): cell
            for content in contents or self.contents
            for cell in measure_all(experiment, content, seeds, lanes=lanes)
        }

    def _width(self, seeds: Sequence[int]) -> int:
        """Width of the kernel for some seeds."""
        return min(self.lanes, 1 << (len(seeds) - 1).bit_length())

    def measure_and_time(
        self, experiment: Experiment, content: float, seeds: Sequence[int] = ()
    ) -> tuple[CellsFound, float]:
        """Measure the cells of a content, and return also the processor time of a cell, s.

        It is repeated if kernels were compiled, and leaves out the check samples. Unlike the wall time of a
        `Measurement`, processor time excludes other programs on a shared machine.
        """
        if experiment.is_checked:
            experiment.once(check_content, content, self._width(seeds or self.seeds))
        while True:
            compiled, began = seconds_compiling(), process_time()
            found = self.measure(experiment, [content], seeds)
            seconds = (process_time() - began) / len(found)
            if seconds_compiling() == compiled:
                return found, seconds

    def take_turns(
        self, experiments: Mapping[str, Experiment], content: float, rounds: int = ROUNDS
    ) -> tuple[dict[str, CellsFound], dict[str, float]]:
        """Measure and time experiments alternately at a content, so that other load of the machine affects all alike.

        Returns cells, and median processor times of a cell, s, by name. A refused experiment is in neither.
        `ValueError` if the first is refused, with which the others are compared.
        """
        found: dict[str, CellsFound] = {}
        times: dict[str, list[float]] = {}
        first = next(iter(experiments))
        for number in range(rounds):
            for name, experiment in experiments.items():
                # An experiment that takes three times as long as the first is timed only once.
                if number and (name not in times or times[name][0] > 3.0 * times[first][0]):
                    continue
                if not number:
                    self.progress(f"{content:g} %: {name}")
                try:
                    found[name], seconds = self.measure_and_time(experiment, content)
                except ValueError as refused:
                    if name == first:
                        raise
                    self.progress(f"{name} at {content:g} %: {refused}")
                    continue
                times.setdefault(name, []).append(seconds)
        return found, {name: median(values) for name, values in times.items()}


def relative_deviation(found: float | None, exact: float | None) -> float | None:
    """Relative deviation; None if either is missing."""
    return None if found is None or exact is None else found / exact - 1.0


def signal_distance(found: Section, exact: Section) -> float:
    """Normalised L2 distance of two received signals, each over its pulse's amplitude, in their common time.

    It is ``||a - b|| / ||b||`` at the samples of the coarser record; a cubic spline interpolates the finer one.
    """
    sections = found, exact
    first, second = at_common_times(
        [section.times for section in sections],
        [section.received / section.amplitude for section in sections],
        max((section.times for section in sections), key=lambda time: float(time[1] - time[0])),
    )
    return float(np.linalg.norm(first - second) / np.linalg.norm(second))


def at_common_times(times: Sequence[Floats], signals: Sequence[Floats], wanted: Floats) -> list[Floats]:
    """Signals at those of the wanted times that all cover, by a cubic spline; NaN if a signal is not finite."""
    begin, end = max(time[0] for time in times), min(time[-1] for time in times)
    common = wanted[(wanted >= begin) & (wanted <= end)]
    return [
        np.asarray(CubicSpline(time, signal)(common) if np.all(np.isfinite(signal)) else np.full(len(common), np.nan))
        for time, signal in zip(times, signals, strict=True)
    ]
