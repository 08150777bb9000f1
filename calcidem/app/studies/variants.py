"""Variants of a configuration from a file: their configurations, computation and comparison."""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calcidem.analysis.distribution import Change, paired_changes
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.run import run
from calcidem.app.config.errors import ConfigurationError, Problem
from calcidem.app.config.reader import parse_file, read_configuration
from calcidem.app.config.schema import Configuration
from calcidem.app.report.wording import ABSENT
from calcidem.app.studies.results import StudyResult, markdown_table
from calcidem.storage.errors import UnknownCampaignError

REFERENCE = "reference"
"""Name of the unchanged configuration."""


class _ListedVariant(BaseModel):
    """One ``[[variant]]`` of the file: the choice and its value in words, and the changed keys."""

    model_config = ConfigDict(strict=True, extra="forbid")

    choice: str
    value: str
    change: dict[str, Any] = Field(default_factory=dict, alias="set")
    """New values by ``section.key``."""
    without: list[str] = Field(default_factory=list)
    """Keys to omit, so that they have their defaults."""
    against: str = REFERENCE
    """Name of the variant to compare with, if it is not the reference."""
    contents: list[float] | None = None
    seeds: int | None = Field(default=None, ge=2)

    @property
    def name(self) -> str:
        """Name of the variant, and of its campaign in the database."""
        return f"{self.choice}: {self.value}" if self.choice != REFERENCE else REFERENCE


class _ListedPlan(BaseModel):
    """Whole file: path of the varied TOML file relative to it, contents in percent, number of seeds, variants."""

    model_config = ConfigDict(strict=True, extra="forbid")

    configuration: str
    contents: list[float]
    seeds: int = Field(ge=2)
    variant: list[_ListedVariant] = Field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Variant:
    """Variant ready for computation."""

    name: str
    """Name of the variant and of its campaign in the database."""
    choice: str
    value: str
    """Choice and its value in words."""
    against: str
    """Name of the variant to compare with."""
    configuration: Configuration
    """Configuration to compute."""


def read_variants(path: str | os.PathLike[str], database: str) -> tuple[Variant, ...]:
    """Read a file (`_ListedPlan`): the variants of a configuration, with the same seeds; the reference comes first.

    The database stores each variant as a separate campaign. `ConfigurationError` lists all problems of the file and of
    the resulting configurations.
    """
    source = os.fspath(path)
    try:
        listed = _ListedPlan.model_validate(parse_file(Path(path))[0])
    except ValidationError as error:
        words = {"missing": "is missing; add it", "extra_forbidden": "is not known; leave it out"}
        found = (
            (".".join(map(str, detail["loc"])), words.get(detail["type"], detail["msg"])) for detail in error.errors()
        )
        raise ConfigurationError(source, [Problem(f"{place}: {words}") for place, words in found]) from None
    base, _ = parse_file(Path(path).parent / listed.configuration)
    _change(base, "run", {"database": database, "store_sections": False})
    known = {REFERENCE, *(variant.name for variant in listed.variant)}
    problems = [
        Problem(f'variant "{variant.name}": against = "{variant.against}" is none of the variants; correct it')
        for variant in listed.variant
        if variant.against not in known
    ]
    if len(known) != 1 + len(listed.variant):
        problems.append(Problem("two variants have the same choice and value; rename one"))
    if problems:
        raise ConfigurationError(source, problems)
    first = _ListedVariant(choice=REFERENCE, value="")
    return tuple(_variant(entry, base, listed, source) for entry in (first, *listed.variant))


def compute_variants(variants: Sequence[Variant], say: Callable[[str], None], executor: Executor | None = None) -> None:
    """Compute all cells that the database lacks, variant by variant; the same call continues after a stop.

    `CampaignMismatchError` if the database has a variant of that name with other parameters.
    """
    for number, variant in enumerate(variants, start=1):
        say(f"{number} of {len(variants)}: {variant.name}")
        run(variant.configuration, executor=executor).close()


def variant_changes(variants: Sequence[Variant]) -> dict[str, tuple[Change, ...]]:
    """Compare every computed variant with its reference variant, by its name."""
    found = {variant.name: _variant_velocities(variant) for variant in variants}
    compared = {}
    for variant in variants:
        own, other = found[variant.name], found.get(variant.against)
        if own is not None and other is not None:
            compared[variant.name] = paired_changes(own, other)
    return compared


def variant_table(variants: Sequence[Variant]) -> StudyResult:
    """Table of the `variant_changes`: a row for each variant, a column for each content of the reference.

    An entry has mean and standard deviation in m/s. Below them are the change of the mean, and the ratio of standard
    deviations with its 95 % interval, in bold if the interval excludes 1.
    """
    changes = variant_changes(variants)
    contents = [change.content for change in changes.get(REFERENCE, ())]
    rows = []
    former = ""
    for variant in variants:
        found = {change.content: change for change in changes.get(variant.name, ())}
        if not found:
            continue
        choice = variant.choice if variant.choice != former else ""
        former = variant.choice
        entries = [_table_entry(found.get(content), is_reference=variant.name == REFERENCE) for content in contents]
        value = variant.value if variant.against == REFERENCE else f"{variant.value} (against {variant.against})"
        rows.append((choice, value, *entries))
    header = ("choice", "value", *(f"{content:g} %" for content in contents))
    return StudyResult(markdown_table(header, rows) + "\n")


def _change(document: dict[str, Any], section: str, values: Mapping[str, Any], without: str = "") -> None:
    """Change keys of a section, and omit one; entries that are not tables are left for the reader to refuse."""
    table = document.setdefault(section, {})
    if isinstance(table, dict):
        table.update(values)
        table.pop(without, None)


def _variant(entry: _ListedVariant, base: Mapping[str, Any], plan: _ListedPlan, source: str) -> Variant:
    """Variant of the configuration ``base``."""
    document = deepcopy(dict(base))
    for place, value in entry.change.items():
        section, _, key = place.partition(".")
        _change(document, section, {key: value})
    for place in entry.without:
        section, _, key = place.partition(".")
        _change(document, section, {}, without=key)
    own = {"name": entry.name, "seeds": entry.seeds or plan.seeds, "contents": entry.contents or plan.contents}
    _change(document, "campaign", own)
    configuration = read_configuration(document, f"{source}, {entry.name}")
    return Variant(entry.name, entry.choice, entry.value, entry.against, configuration)


def _variant_velocities(variant: Variant) -> xr.DataArray | None:
    """Vs of the planned cells of a variant, m/s along (seed, content); None if none was computed."""
    plan = variant.configuration.campaign
    try:
        with open_campaign(variant.configuration.database, variant.name) as campaign:
            # A database may contain more cells from an earlier plan.
            return campaign.vs().reindex(seed=list(plan.seed_numbers), content=sorted(plan.contents))
    except UnknownCampaignError:
        return None


def _table_entry(change: Change | None, *, is_reference: bool) -> str:
    """One entry of the table."""
    if change is None or not change.measured:
        return ABSENT if change is None else f"none of {change.planned} read"
    text = f"{change.mean:.0f} ± {change.standard_deviation:.0f}"
    if not is_reference and math.isfinite(change.deviation_ratio):
        interval = change.deviation_ratio_interval
        scatter = f"x {change.deviation_ratio:.2f} ({interval.low:.2f} to {interval.high:.2f})"
        scatter = scatter if interval.contains(1.0) else f"**{scatter}**"
        text += f"<br>{100.0 * (change.mean_ratio - 1.0):+.1f} %, {scatter}"
    if change.measured < change.planned:
        text += f"<br>{change.measured} of {change.planned} read"
    return text
