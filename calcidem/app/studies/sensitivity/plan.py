"""File of variants of a configuration, and the resulting configurations."""

import os
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calcidem.app.config.errors import ConfigurationError, Problem, phrase
from calcidem.app.config.reader import parse_file, read_configuration
from calcidem.app.config.schema import Configuration

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
    ranges: dict[str, Annotated[list[float], Field(min_length=2, max_length=2)]] = Field(default_factory=dict)
    """Lowest and highest value by ``section.key``, for Sobol indices."""


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


def load_plan(path: str | os.PathLike[str], database: str) -> tuple[Variant, ...]:
    """Read a file of variants (`_ListedPlan`); the reference comes first.

    The database stores each variant as a separate campaign. `ConfigurationError` lists all problems of the file and of
    the resulting configurations.
    """
    source = os.fspath(path)
    listed = _parse_plan(path)
    base = parse_file(Path(path).parent / listed.configuration)
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


def read_plan(path: str | os.PathLike[str]) -> tuple[_ListedPlan, Configuration]:
    """Read a file of variants or ranges, and its configuration with its cells; errors as for `load_plan`."""
    listed = _parse_plan(path)
    base = parse_file(Path(path).parent / listed.configuration)
    _change(base, "campaign", {"seeds": listed.seeds, "contents": listed.contents})
    return listed, read_configuration(base, os.fspath(path))


def _parse_plan(path: str | os.PathLike[str]) -> _ListedPlan:
    """Read the file."""
    source = os.fspath(path)
    try:
        return _ListedPlan.model_validate(parse_file(Path(path)))
    except ValidationError as error:
        found = ((".".join(map(str, detail["loc"])), phrase(detail)) for detail in error.errors())
        raise ConfigurationError(source, [Problem(f"{place}: {words}") for place, words in found]) from None


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
