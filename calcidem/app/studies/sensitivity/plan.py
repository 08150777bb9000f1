"""The file that lists variants of a configuration, and the configurations that come of it."""

import os
import tomllib
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calcidem.app.config.errors import ConfigurationError, Problem, phrase
from calcidem.app.config.reader import read_configuration
from calcidem.app.config.schema import Configuration

REFERENCE = "reference"
"""Name of the configuration as it stands."""


class _ListedVariant(BaseModel):
    """One ``[[variant]]`` of the file.

    Attributes
    ----------
    choice, value
        What is chosen, and how, in words.
    change
        New values by ``section.key``.
    without
        Keys to leave out, so that they have their defaults.
    against
        Name of another variant to compare with, for one that is an alternative only together with that.
    contents, seeds
        Instead of those of the file, for variants that cost much.
    """

    model_config = ConfigDict(strict=True, extra="forbid")

    choice: str
    value: str
    change: dict[str, Any] = Field(default_factory=dict, alias="set")
    without: list[str] = Field(default_factory=list)
    against: str = REFERENCE
    contents: list[float] | None = None
    seeds: int | None = Field(default=None, ge=2)

    @property
    def name(self) -> str:
        """Name of the variant, and of its campaign in the database."""
        return f"{self.choice}: {self.value}"


class _ListedPlan(BaseModel):
    """The whole file.

    Attributes
    ----------
    configuration
        TOML file that is varied; a relative name counts from the folder of this file.
    contents
        Percent.
    seeds
        Number of seeds of each content, the same in every variant.
    variant
        The variants.
    """

    model_config = ConfigDict(strict=True, extra="forbid")

    configuration: str
    contents: list[float]
    seeds: int = Field(ge=2)
    variant: list[_ListedVariant] = Field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Variant:
    """A variant ready to be computed.

    Attributes
    ----------
    name
        Of the variant, and of its campaign in the database.
    choice, value, against
        See `_ListedVariant`.
    configuration
        What is computed.
    """

    name: str
    choice: str
    value: str
    against: str
    configuration: Configuration


def load_plan(path: str | os.PathLike[str], database: str) -> tuple[Variant, ...]:
    """Read a file of variants; the reference comes first.

    Parameters
    ----------
    path
        TOML file, see `_ListedPlan`.
    database
        Where the cells of all of them go, each variant as a campaign of its own.

    Raises
    ------
    ConfigurationError
        With everything that is wrong with the file or with a configuration that comes of it.
    """
    source = os.fspath(path)
    listed = _read(_ListedPlan, path)
    base = _document(Path(path).parent / listed.configuration)
    base["run"] = {**base.get("run", {}), "database": database, "store_signals": False}
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


def _variant(entry: _ListedVariant, base: Mapping[str, Any], plan: _ListedPlan, source: str) -> Variant:
    name = REFERENCE if entry.choice == REFERENCE else entry.name
    document = deepcopy(dict(base))
    for place, value in entry.change.items():
        section, _, key = place.partition(".")
        document.setdefault(section, {})[key] = value
    for place in entry.without:
        section, _, key = place.partition(".")
        document.get(section, {}).pop(key, None)
    own = {"name": name, "seeds": entry.seeds or plan.seeds, "contents": entry.contents or plan.contents}
    document["campaign"] = {**document.get("campaign", {}), **own}
    configuration = read_configuration(document, f"{source}, {name}")
    return Variant(name, entry.choice, entry.value, entry.against, configuration)


def _read(model: type[_ListedPlan], path: str | os.PathLike[str]) -> _ListedPlan:
    try:
        return model.model_validate(_document(Path(path)))
    except ValidationError as error:
        problems = [
            Problem(f"{'.'.join(str(part) for part in detail['loc'])}: {phrase(detail)}") for detail in error.errors()
        ]
        raise ConfigurationError(os.fspath(path), problems) from None


def _document(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigurationError(str(path), [Problem("the file does not exist; check the name")]) from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(str(path), [Problem(f"not TOML: {error}")]) from None
