"""The file that lists variants of a configuration, and the configurations that come of it."""

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
"""Name of the configuration as it stands."""


class _ListedVariant(BaseModel):
    """One ``[[variant]]`` of the file: what is chosen, and how, in words and in values."""

    model_config = ConfigDict(strict=True, extra="forbid")

    choice: str
    value: str
    change: dict[str, Any] = Field(default_factory=dict, alias="set")
    """New values by ``section.key``."""
    without: list[str] = Field(default_factory=list)
    """Keys to leave out, so that they have their defaults."""
    against: str = REFERENCE
    """Name of another variant to compare with, for one that is an alternative only together with that."""
    contents: list[float] | None = None
    seeds: int | None = Field(default=None, ge=2)

    @property
    def name(self) -> str:
        """Name of the variant, and of its campaign in the database."""
        return f"{self.choice}: {self.value}" if self.choice != REFERENCE else REFERENCE


class _ListedPlan(BaseModel):
    """The whole file: a TOML file, relative to this one, that is varied; percents, number of seeds; what is varied."""

    model_config = ConfigDict(strict=True, extra="forbid")

    configuration: str
    contents: list[float]
    seeds: int = Field(ge=2)
    variant: list[_ListedVariant] = Field(default_factory=list)
    ranges: dict[str, Annotated[list[float], Field(min_length=2, max_length=2)]] = Field(default_factory=dict)
    """Lowest and highest value by ``section.key``, for Sobol indices."""


@dataclass(frozen=True, slots=True)
class Variant:
    """A variant ready to be computed.

    Attributes
    ----------
    name
        Of the variant, and of its campaign in the database.
    choice, value
        What is chosen, and how, in words.
    against
        Name of the variant to compare with.
    configuration
        What is computed.
    """

    name: str
    choice: str
    value: str
    against: str
    configuration: Configuration


def load_plan(path: str | os.PathLike[str], database: str) -> tuple[Variant, ...]:
    """Read a file of variants (`_ListedPlan`); the reference comes first.

    The cells of all of them go into the database, each variant as a campaign of its own. `ConfigurationError` with
    everything that is wrong with the file or with a configuration that comes of it.
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
    """Read a file of variants or ranges, and its configuration with its cells; errors as `load_plan`."""
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
    """Change keys of a section, and leave one out; what is no table stays for the reader to refuse."""
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
