"""Reads a TOML file as a `Configuration`, or lists all its problems."""

import difflib
import itertools
import json
import math
import os
import tomllib
import unicodedata
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass, replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from calcidem.app.config.checks import cross_check
from calcidem.app.config.errors import ConfigurationError, Problem, phrase, quote
from calcidem.app.config.schema import (
    SETTLED_BY_FILE,
    Bonding,
    Calibration,
    CampaignPlan,
    Configuration,
    Excitation,
    PackingDraw,
    RunOptions,
)
from calcidem.dem.engine.fields import accepted_values, field_hints
from calcidem.dem.engine.material import Cement, Sand
from calcidem.dem.sample.cement import CementRule
from calcidem.dem.sample.packing import PackingRule
from calcidem.dem.sample.packing_file import checked_disks
from calcidem.dem.wave.reading import PickRule
from calcidem.dem.wave.rule import WaveRule

if TYPE_CHECKING:
    from _typeshed import DataclassInstance  # known to type checkers only


SECTIONS: dict[str, dict[str, type["DataclassInstance"]]] = {
    "campaign": {"campaign": CampaignPlan},
    "packing": {"packing": PackingRule, "packing_draw": PackingDraw},
    "sand": {"sand": Sand, "calibration": Calibration},
    "cement": {"cement": Cement, "bonding": Bonding},
    "pattern": {"pattern": CementRule},
    "wave": {"wave": WaveRule, "excitation": Excitation},
    "pick": {"pick": PickRule},
    "run": {"run": RunOptions},
}
"""Sections of the file, with the attributes of `Configuration` from each, and their types."""

_LARGEST_FILE = 4_000_000
"""Largest size in bytes; it allows 100,000 listed seeds, but no device or data file can fill the memory."""

_DEEPEST = 8
"""Largest depth of nested tables and lists; four levels are needed."""

_LARGEST_WHOLE_NUMBER = 2**63 - 1
"""Largest whole number of TOML (https://toml.io/en/v1.0.0#integer) and of databases."""

_SMALLEST_NUMBER, _LARGEST_NUMBER = 1e-30, 1e30
"""In SI units; products and reciprocals of several such numbers are still finite."""

TAKEN_FROM_ELSEWHERE = {"pattern.sand_density": "sand.density", "packing.file_sha256": "packing.file"}
"""Keys that files do not have, since another key has the same meaning."""


_CONCERNED = ("packing.file", *(f"packing.{key}" for key in SETTLED_BY_FILE))
"""Fields excluded from other checks if the file has problems."""


_NOT_TO_BE_READ = {"file", "file_sha256", "sand_density"}
"""Fields that a configuration gets from the content of a file or from another key."""


def load_configuration(path: str | os.PathLike[str], overrides: Mapping[str, Any] | None = None) -> Configuration:
    """Read and check a configuration in a TOML file; `ConfigurationError` with all its problems.

    ``overrides`` are values of section ``[run]`` that replace those of the file; None keeps the value of the file.
    """
    document = parse_file(Path(path))
    given = {key: value for key, value in (overrides or {}).items() if value is not None}
    if given and isinstance(document.setdefault("run", {}), dict):
        document["run"] |= given
    return read_configuration(document, os.fspath(path), Path(path).parent)


def parse_file(path: Path) -> dict[str, Any]:
    """Sections of a TOML file, or a `ConfigurationError` with the reason."""
    try:
        with path.open("rb") as file:
            content = file.read(_LARGEST_FILE + 1)
        document = tomllib.loads(content.decode("utf-8-sig")) if len(content) <= _LARGEST_FILE else None
        if document is None:
            problem = f"has more than {_LARGEST_FILE} bytes, which no configuration needs; check the name"
        elif not document:
            problem = "the file is empty; write an example with 'calcidem init' and change it"
        elif _is_deeper(document, _DEEPEST):
            problem = f"has tables or lists in one another, {_DEEPEST} deep; no key has such a value, leave them out"
        else:
            return document
    except FileNotFoundError:
        problem = "the file does not exist; check the name, or write an example with 'calcidem init'"
    except IsADirectoryError:
        problem = "this is a folder; give the name of a TOML file"
    except OSError as error:
        problem = f"the file cannot be read ({error.strerror}); give one that can"
    except UnicodeDecodeError as error:
        problem = f"byte {error.start + 1} is not UTF-8 text; save the file as UTF-8"
    except (ValueError, RecursionError) as error:  # invalid TOML, too long numbers, too deep brackets
        problem = f'not TOML: {error}; numbers are written 1.5, strings "...", lists [1, 2]'
    raise ConfigurationError(str(path), [Problem(problem)])


def _is_deeper(value: object, levels: int) -> bool:
    """Whether tables and lists are nested more deeply than this."""
    inner = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
    return any(levels == 0 or _is_deeper(item, levels - 1) for item in inner)


def read_configuration(
    document: Mapping[str, Any], source: str = "configuration", folder: Path = Path()
) -> Configuration:
    """Convert a mapping of sections to a checked configuration; file names in it are relative to the folder.

    `ConfigurationError` with all problems.
    """
    problems = [_unknown_name(name, "section", list(SECTIONS)) for name in document if name not in SECTIONS]
    given: dict[str, dict[str, Any]] = {part: {} for parts in SECTIONS.values() for part in parts}
    for section, parts in SECTIONS.items():
        values = document.get(section, {})
        if not isinstance(values, Mapping):
            cure = f"write [{section}] and its keys below it"
            problems.append(Problem(f"{section} = {quote(values)}: is not a section; {cure}", (section,)))
            continue
        owner = {name: part for part, kind in parts.items() for name in field_hints(kind)}
        known = [name for name in owner if f"{section}.{name}" not in TAKEN_FROM_ELSEWHERE]
        for key, value in values.items():
            if key not in known:
                problems.append(_unknown_name(key, f"key of [{section}]", known, section))
            elif words := _impossible(value):
                problems.append(Problem(f"{section}.{key} = {quote(value)}: {words}", (f"{section}.{key}",)))
            else:
                given[owner[key]][key] = value
    configuration, wrong = _validate(given)
    problems += wrong
    if configuration.packing_draw.file is not None:
        configuration, wrong = _take_own_disks(configuration, document["packing"], folder)
        problems += wrong
    configuration = replace(
        configuration, pattern=replace(configuration.pattern, sand_density=configuration.sand.density)
    )
    # A wrong field was replaced by its default, which should not be compared with other fields.
    broken = {field for problem in problems for field in problem.fields}
    problems += [problem for problem in cross_check(configuration) if not broken & set(problem.fields)]
    if problems:
        raise ConfigurationError(source, problems)
    return configuration


def _validate(given: dict[str, dict[str, Any]]) -> tuple[Configuration, list[Problem]]:
    """Make a configuration from the values of its parts, and list their problems.

    Wrong values are replaced by their defaults until none is left, since a class checks combinations of fields only
    when each field is valid.
    """
    problems: list[Problem] = []
    while True:
        # A file has JSON types. For Python objects pydantic's strict mode would accept only instances.
        text = json.dumps(given)
        try:
            return _validator().validate_json(text), problems
        except ValidationError as error:
            found = error.errors(include_url=False)
        for (part, *key), details in itertools.groupby(found, key=lambda detail: detail["loc"][:2]):
            section = next(section for section, parts in SECTIONS.items() if part in parts)
            if key:
                hint = field_hints(SECTIONS[section][part])[key[0]]
                new = _value_problems(f"{section}.{key[0]}", given[part].pop(key[0]), hint, list(details))
            else:
                new = [_refusal(section, detail) for detail in details]
                named = {name.rpartition(".")[2] for problem in new for name in problem.fields}
                given[part] = {name: value for name, value in given[part].items() if name not in named}
            problems += new


@cache
def _validator() -> TypeAdapter[Configuration]:
    """Pydantic's adapter of the classes; cached, since making it takes a moment."""
    return TypeAdapter(Configuration)


def _refusal(place: str, detail: ErrorDetails) -> Problem:
    """Problem of a combination of values that a class refuses."""
    refused = detail["ctx"]["error"]
    return Problem(f"{place}.{refused}", tuple(f"{place}.{name}" for name in refused.fields))


def _value_problems(place: str, value: object, hint: Any, details: list[ErrorDetails]) -> list[Problem]:  # noqa: ANN401 - a type hint
    """Problems of one value; for a table those of its keys."""
    table = _table_in(hint)
    if table is None or not isinstance(value, dict):
        branches = {word for detail in details for word in detail["loc"][2:3] if isinstance(word, str)}
        accepted = accepted_values(hint)
        words = [f"give {accepted}"] if len(branches) > 1 else [phrase(detail, accepted) for detail in details]
        return [Problem(f"{place} = {quote(value)}: {'; '.join(dict.fromkeys(words))}", (place,))]
    problems = []
    # With several possible types the type is named.
    own = [detail for detail in details if table.__name__ in detail["loc"][2:3]]
    for detail in own or details:
        inner = detail["loc"][3 if own else 2 :]
        key = str(inner[0]) if inner else ""
        if not key:
            problem = _refusal(place, detail)
        elif key not in field_hints(table):
            problem = _unknown_name(key, f"key of [{place}]", list(field_hints(table)), place)
        elif key not in value:
            problem = Problem(f"{place}.{key}: is missing; add it", (f"{place}.{key}",))
        else:
            problem = _value_problems(f"{place}.{key}", value[key], field_hints(table)[key], [detail])[0]
        problems.append(replace(problem, fields=(place, *problem.fields)))
    return problems


def _table_in(hint: Any) -> type["DataclassInstance"] | None:  # noqa: ANN401 - as above
    """Class of the tables that an annotation accepts."""
    if is_dataclass(hint) and isinstance(hint, type):
        return hint
    return next(filter(None, map(_table_in, get_args(hint))), None)


def _impossible(value: object) -> str:
    """Problem and remedy of a value that no field can have; empty for all others."""
    if isinstance(value, list | tuple | dict):
        return next(filter(None, map(_impossible, value.values() if isinstance(value, dict) else value)), "")
    if not isinstance(value, str | int | float | None):
        return f"is a {type(value).__name__}, which no key takes; give a number, true or false, text or a list"
    if isinstance(value, int) and abs(value) > _LARGEST_WHOLE_NUMBER:
        return f"has more than 64 bits; give at most {_LARGEST_WHOLE_NUMBER}"
    # The type checks NaN and infinity.
    if isinstance(value, float) and (0.0 < abs(value) < _SMALLEST_NUMBER or _LARGEST_NUMBER < abs(value) < math.inf):
        return f"is out of range; give 0, or a number of {_SMALLEST_NUMBER:g} to {_LARGEST_NUMBER:g} in SI units"
    if isinstance(value, str) and any(unicodedata.category(character) in {"Cc", "Cs"} for character in value):
        return "has control characters; write it without"
    return ""


def _unknown_name(name: str, what: str, known: list[str], section: str = "") -> Problem:
    """Problem of an unknown name, with a similar known one."""
    place = f"{section}.{name}" if section else name
    other = TAKEN_FROM_ELSEWHERE.get(place)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    if other:
        cure = f"{other} says it"
    elif close:
        cure = f'did you mean "{close[0]}"?'
    else:
        cure = f"there are {', '.join(known)}"
    return Problem(f"{place}: unknown {what}; {cure}", (place,))


def _take_own_disks(
    configuration: Configuration, given: Mapping[str, Any], folder: Path
) -> tuple[Configuration, list[Problem]]:
    """Read the file of ``[packing]``, and put the values that it determines into the configuration.

    ``given`` is the section as given; the name of the file is relative to ``folder``. Return the configuration with the
    size of box and disks, if the file is valid, and problems of the file or contradictions to it.
    """
    problems = [
        Problem(
            f"packing.{key} = {quote(given[key])}: the disks in packing.file settle it; leave one of the two out",
            (f"packing.{key}", "packing.file"),
        )
        for key in SETTLED_BY_FILE
        if key in given
    ]
    rule, draw = configuration.packing, configuration.packing_draw
    try:
        path = (folder / Path(str(draw.file)).expanduser()).absolute()
        _, y, radius = checked_disks(path, rule.width)
        smallest, largest = (2.0 * float(value) for value in (radius.min(), radius.max()))
        rule = replace(rule, height=float(np.max(y + radius)), diameter=(smallest, largest))
        draw = replace(draw, file=str(path), file_sha256=sha256(path.read_bytes()).hexdigest())
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError if ~ has no folder
        problems.append(Problem(f"packing.file = {quote(draw.file)}: {error}", _CONCERNED))
    return replace(configuration, packing=rule, packing_draw=draw), problems


def change_configuration(origin: Configuration | str | os.PathLike[str], values: Mapping[str, object]) -> Configuration:
    """Read a configuration, or its TOML file, again with other values, with all checks.

    ``values`` are by section and key, such as ``{"wave.amplitude": 1e-4}``. `ConfigurationError` with all problems.
    """
    if not isinstance(origin, Configuration):
        document = parse_file(Path(origin))
        _put_values(document, values)
        return read_configuration(document, os.fspath(origin), Path(origin).parent)
    document = _as_document(origin)
    _put_values(document, values)
    found = read_configuration(document)
    if "packing.file" in values:
        return found
    draw = replace(found.packing_draw, file=origin.packing_draw.file, file_sha256=origin.packing_draw.file_sha256)
    return replace(found, packing_draw=draw)


def _as_document(configuration: Configuration) -> dict[str, Any]:
    """Sections and keys of a configuration for a file."""
    return {
        section: {
            key: value
            for attribute in types
            for key, value in asdict(getattr(configuration, attribute)).items()
            if value is not None and key not in _NOT_TO_BE_READ
        }
        for section, types in SECTIONS.items()
    }


def _put_values(document: dict[str, Any], values: Mapping[str, object]) -> None:
    """Set each value by its name."""
    for name, value in values.items():
        *sections, key = name.split(".")
        table = document
        for section in sections:
            inner = table.setdefault(section, {})
            table[section] = table = inner if isinstance(inner, dict) else {}
        table[key] = _as_written(value)


def _as_written(value: object) -> object:
    """A value with lists instead of arrays, at all levels."""
    if isinstance(value, Mapping):
        return {key: _as_written(inner) for key, inner in value.items()}
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
