"""Points of a study: configurations with other values of named parameters, each a campaign of one database."""

import math
import multiprocessing
import os
import re
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Self, get_type_hints

import numpy as np

from calcidem.app.campaign.run import run
from calcidem.app.config.checks import cross_check
from calcidem.app.config.reader import read_configuration
from calcidem.app.config.schema import SECTIONS, Configuration, ConfigurationError, Problem
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.packing import Packing
from calcidem.sweep.ranks import die_with_parent


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

    def start_value(self, configuration: Configuration, packing: Packing) -> float:
        """Initial value of a parameter, within its range; for a cluster's area that of Eq. 2 for a mean cluster.

        A key without a value starts at the geometric mean of its range. `ValueError` if there is neither.
        """
        attribute, key = _variable_keys()[self.name]
        value = getattr(getattr(configuration, attribute), key)
        if self.name == "pattern.cluster_area" and value is None:
            value = _area_of_clusters(configuration, packing)
        if not isinstance(value, float) or value <= 0.0:
            if not 0.0 < self.low < self.high < math.inf:
                raise ValueError(f"{self.name} = {value}: is not a positive start value; give a range low:high")
            value = math.sqrt(self.low * self.high)
        return float(np.clip(value, self.low, self.high))


def check_ranges(configuration: Configuration, ranges: Sequence[ParameterRange], source: str) -> None:
    """Refuse parameters that are not numbers of the wave stage, duplicates, and ranges that cannot be computed.

    `ConfigurationError` lists all problems; ``source`` names the origin of the ranges.
    """
    problems = [problem for chosen in ranges for problem in _range_problems(configuration, chosen)]
    names = [chosen.name for chosen in ranges]
    problems += [Problem(f"{name}: is named twice; remove one") for name in set(names) if names.count(name) > 1]
    if not names:
        problems.append(Problem("parameters = 0: name at least one, such as cement.bond_modulus"))
    if problems:
        raise ConfigurationError(source, problems)


def _range_problems(configuration: Configuration, chosen: ParameterRange) -> Iterator[Problem]:
    """Problems of one range."""
    name = chosen.name
    if name not in _variable_keys():
        yield Problem(
            f"{name}: is not a number in the configuration; choose among {', '.join(sorted(_variable_keys()))}", (name,)
        )
        return
    if not 0.0 <= chosen.low < chosen.high:
        yield Problem(
            f"{name} = {chosen.low:g}:{chosen.high:g}: give two increasing positive numbers, low:high", (name,)
        )
        return
    for value in (chosen.low, chosen.high):
        if 0.0 < value < math.inf:
            try:
                changed = with_values(configuration, {name: value})
            except ValueError as error:
                yield Problem(f"{name.split('.')[0]}.{error}", (name,))
                continue
            yield from (problem for problem in cross_check(changed) if name in problem.fields)
            if changed.packing_hash != configuration.packing_hash:
                yield Problem(f"{name}: every value changes the packing; vary a key of the wave stage", (name,))
                return


def _variable_keys() -> dict[str, tuple[str, str]]:
    """Attribute of `Configuration` and field in it, for each ``section.key`` of the wave stage that is a number."""
    return {
        f"{section}.{name}": (attribute, name)
        for section, types in SECTIONS.items()
        if section not in {"campaign", "packing", "run"}
        for attribute, kind in types.items()
        for name, hint in get_type_hints(kind).items()
        if hint in (float, float | None) and f"{section}.{name}" != "pattern.sand_density"  # the file has sand.density
    }


def with_values(configuration: Configuration, values: Mapping[str, float]) -> Configuration:
    """Configuration with changed parameters."""
    changed = configuration
    for name, value in values.items():
        attribute, key = _variable_keys()[name]
        changed = replace(changed, **{attribute: replace(getattr(changed, attribute), **{key: float(value)})})
    return changed


def _area_of_clusters(configuration: Configuration, packing: Packing) -> float:
    """Area of a cluster's calcite by Eq. 2 for the contacts of a mean cluster, m2."""
    ordering = configuration.experiment(packing).ordering(configuration.campaign.seed_numbers[0])
    cement = ordering.at(min(5.0, ordering.maximum_content))
    calcite = (cement.content_reached - configuration.pattern.threshold) / 100.0
    densities = configuration.pattern.sand_density / configuration.pattern.calcite_density
    return float(calcite * densities * np.pi * np.sum(packing.radius**2) / max(1, cement.clusters))


def text_with_values(text: str, values: Mapping[str, float]) -> str:
    """TOML text with these values: existing keys are replaced, others are added to their section."""
    for name, value in values.items():
        section, key = name.split(".")
        line = f"{key} = {value:.5g}  # calibrated"
        body = re.compile(rf"(?ms)^\[{section}\][^\n]*$(.*?)(?=^\[|\Z)")
        found = body.search(text)
        if found is None:
            text = f"{text.rstrip()}\n\n[{section}]\n{line}\n"
            continue
        inside, count = re.subn(rf"(?m)^[ \t]*{key}\s*=.*$", line, found.group(1))
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
        document = tomllib.loads(text_with_values(text, values))
    except ValueError as error:
        raise ConfigurationError(os.fspath(file), [Problem(problem)]) from error
    if read_configuration(document, os.fspath(file), file.parent).hash != with_values(configuration, rounded).hash:
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
