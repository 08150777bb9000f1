"""What studies share: their points, the cells that they measure, and their result in all forms.

A point is a configuration with other values of named parameters, a campaign of one database. Cells are measured with
one experiment after another. Values are written into a configuration, and processes are started for all points.
"""

import json
import math
import multiprocessing
import os
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
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
from calcidem.app.campaign.packing import provide_packing, stored_packing
from calcidem.app.campaign.run import run
from calcidem.app.config.checks import check_against_packing
from calcidem.app.config.examples import KeyReference, key_references
from calcidem.app.config.reader import change_configuration, read_configuration
from calcidem.app.config.schema import Configuration, ConfigurationError, Problem, refuse_other_physics
from calcidem.dem.kernels.compiling import seconds_compiling
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.check import check_content
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement, measure
from calcidem.dem.wave.section import Section
from calcidem.input_file import as_text, read_input
from calcidem.storage.errors import OutputRefusedError
from calcidem.storage.files import write_text_atomically
from calcidem.storage.netcdf import write_netcdf
from calcidem.storage.sql.store import Store
from calcidem.sweep.ranks import die_with_parent
from calcidem.wording import number

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


def read_former(file: Path | None, identity: Mapping[str, object], name: str, kind: type[_Kind]) -> _Kind:
    """Results ``name`` of an earlier start in a JSON file, none without a file.

    `OutputRefusedError` if they are not of the same study.
    """
    if file is None or not file.exists():
        return kind()
    try:
        told = json.loads(as_text(read_input(file, 100_000_000), file))  # bytes; 100 settings of 1,000 cells have fewer
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
    entries = [
        [number(entry, ".1e") if isinstance(entry, float | None) else str(entry) for entry in row] for row in rows
    ]
    lines = [f"| {' | '.join(row)} |" for row in entries]
    return "\n".join([f"| {' | '.join(header)} |", f"|{'---|' * len(header)}", *lines]) if lines else ""


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
            for cell in measure(experiment, content, seeds, lanes=lanes)
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
        for turn in range(rounds):
            for name, experiment in experiments.items():
                # An experiment that takes three times as long as the first is timed only once.
                if turn and (name not in times or times[name][0] > 3.0 * times[first][0]):
                    continue
                if not turn:
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


@dataclass(frozen=True, slots=True)
class ParameterRange:
    """Parameter of the configuration and its range."""

    name: str
    """``section.key`` of the configuration."""
    low: float = 0.0
    high: float = math.inf
    """Limits in the unit of the key, positive."""

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``section.key`` or ``section.key=low:high``.

        `ConfigurationError` if the limits are not increasing positive numbers.
        """
        name, _, limits = text.partition("=")
        if not limits:
            return cls(name.strip())
        try:
            low, high = (float(limit) for limit in limits.split(":"))
        except ValueError:
            low, high = math.nan, math.nan
        return cls(name.strip(), low, high)

    def problems(self, configuration: Configuration) -> Iterator[Problem]:
        """Why it is not a number of the wave stage, or its limits cannot be computed."""
        if self.name not in _variable_keys():
            known = ", ".join(sorted(_variable_keys()))
            yield Problem(f"{self.name}: is not a number in the configuration; choose among {known}", (self.name,))
            return
        if not 0.0 <= self.low < self.high:
            limits = f"{self.low:g}:{self.high:g}"
            yield Problem(f"{self.name} = {limits}: give two increasing positive numbers, low:high", (self.name,))
            return
        for value in (self.low, self.high):
            if 0.0 < value < math.inf:
                try:
                    changed = change_configuration(configuration, {self.name: value})
                except ConfigurationError as error:
                    yield from (problem for problem in error.problems if self.name in problem.fields)
                    continue
                if changed.packing_hash != configuration.packing_hash:
                    cure = "every value changes the packing; vary a key of the wave stage"
                    yield Problem(f"{self.name}: {cure}", (self.name,))
                    return

    def start_value(self, configuration: Configuration, packing: Packing) -> float:
        """Initial value of a parameter, within its range; for a cluster's area that of Eq. 2 for a mean cluster.

        A key without a value starts at the geometric mean of its range. `ValueError` if there is neither.
        """
        key = _variable_keys()[self.name]
        value = getattr(getattr(configuration, key.attribute), key.name)
        if self.name == "pattern.cluster_area" and value is None:
            ordering = configuration.experiment(packing).ordering(configuration.campaign.seed_numbers[0])
            cement, pattern = ordering.at(min(5.0, ordering.maximum_content)), configuration.pattern
            calcite = (cement.content_reached - pattern.threshold) / 100.0
            densities = pattern.sand_density / pattern.calcite_density
            value = float(calcite * densities * np.pi * np.sum(packing.radius**2) / max(1, cement.clusters))
        if not isinstance(value, float) or value <= 0.0:
            if not 0.0 < self.low < self.high < math.inf:
                raise ValueError(f"{self.name} = {value}: is not a positive start value; give a range low:high")
            value = math.sqrt(self.low * self.high)
        return float(np.clip(value, self.low, self.high))


def _variable_keys() -> dict[str, KeyReference]:
    """Each ``section.key`` of the wave stage that is a number."""
    return {
        f"{key.section}.{key.name}": key
        for key in key_references()
        if key.kind == "number" and key.section not in {"campaign", "packing", "run"}
    }


def text_with_values(text: str, values: Mapping[str, float | str]) -> str:
    """TOML text with these values: existing keys are replaced, others are added to their section."""
    for name, value in values.items():
        section, key = name.split(".")
        line = f"{key} = {json.dumps(value) if isinstance(value, str) else f'{value:.5g}  # calibrated'}"
        body = re.compile(rf"(?ms)^\[{section}\][^\n]*$(.*?)(?=^\[|\Z)")
        found = body.search(text)
        if found is None:
            text = f"{text.rstrip()}\n\n[{section}]\n{line}\n"
            continue
        inside, count = re.subn(rf"(?m)^[ \t]*{key}\s*=.*$", lambda _, line=line: line, found.group(1))
        if not count:
            inside = f"{inside.rstrip()}\n{line}\n\n"
        text = text[: found.start(1)] + inside + text[found.end(1) :]
    return text


def refuse_unwritable(text: str, configuration: Configuration, values: Mapping[str, float], file: Path) -> None:
    """Refuse a text that `text_with_values` could not change, or that would be another campaign in that file.

    `ConfigurationError`, also if a file that the text names does not exist beside ``file``.
    """
    rounded = {name: float(f"{value:.5g}") for name, value in values.items()}
    problem = f"{', '.join(values)}: cannot be written; give each section as [section], with a line for each key"
    try:
        document = tomllib.loads(text_with_values(text, {"campaign.name": file.stem, **values}))
    except ValueError as error:
        raise ConfigurationError(os.fspath(file), [Problem(problem)]) from error
    if (
        read_configuration(document, os.fspath(file), file.parent).hash
        != change_configuration(configuration, rounded).hash
    ):
        raise ConfigurationError(os.fspath(file), [Problem(problem)])


@contextmanager
def study_workers(cores: int) -> Iterator[Executor | None]:
    """Processes for the campaigns of a study, until the block ends; None for a single core."""
    if cores == 1:
        yield None
        return
    # Fresh processes: a fork would share open resources of libraries. They would outlive a command that is killed.
    ending = partial(die_with_parent, os.getpid()) if sys.platform == "linux" else None
    with ProcessPoolExecutor(cores, multiprocessing.get_context("spawn"), ending) as pool:
        yield pool


def point_of_study(
    configuration: Configuration, database: Path, contents: Sequence[float], seeds: Sequence[int]
) -> Configuration:
    """The same physics as a campaign of the study's database, named by its hash; `ValueError` for impossible cells."""
    # Only Vs is compared.
    configuration = replace(configuration, wave=replace(configuration.wave, both_sides=False))
    name = f"point {configuration.hash[:16]}"
    campaign = replace(configuration.campaign, name=name, contents=tuple(contents), seeds=tuple(seeds), until=None)
    run_options = replace(
        configuration.run, database=str(database), output=str(database.parent), store_sections=False, part=None
    )
    return replace(configuration, campaign=campaign, run=run_options)


def point_velocities(point: Configuration, executor: Executor | None = None) -> Floats:
    """Vs of the planned cells, m/s, (seeds, contents), NaN if missing; cells that the database has are not computed.

    A content that the configuration makes impossible has no velocity: other values of the study may allow it.
    """
    plan = point.campaign
    try:
        with run(point, progress=False, executor=executor) as campaign:
            vs = campaign.vs().reindex(seed=list(plan.seed_numbers), content=list(plan.contents))
            return np.asarray(vs.transpose("seed", "content"), dtype=float)
    except ConfigurationError:
        if len(plan.contents) == 1:
            return np.full((len(plan.seed_numbers), 1), np.nan)
    single = (replace(point, campaign=replace(plan, contents=(content,))) for content in plan.contents)
    return np.hstack([point_velocities(one, executor) for one in single])
