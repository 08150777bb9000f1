"""From a TOML file to a `Configuration`, or to a list of everything that is wrong with it."""

import difflib
import math
import os
import re
import tomllib
import unicodedata
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from calcidem.app.config.checks import cross_check
from calcidem.app.config.errors import ConfigurationError, Problem, phrase, quote
from calcidem.app.config.own_disks import take_own_disks
from calcidem.app.config.schema import (
    Bonding,
    Calibration,
    CampaignPlan,
    Configuration,
    Excitation,
    PackingDraw,
    RunOptions,
    VelocityChoice,
)
from calcidem.dem.engine.material import Cement, Sand
from calcidem.dem.sample.cement import CementRule
from calcidem.dem.sample.packing import PackingRule
from calcidem.dem.wave.pick import PickRule
from calcidem.dem.wave.rule import WaveRule

if TYPE_CHECKING:
    from _typeshed import DataclassInstance  # known to type checkers only


_STRICT = ConfigDict(strict=True, allow_inf_nan=False)

SECTIONS: dict[str, dict[str, type["DataclassInstance"]]] = {
    "campaign": {"campaign": CampaignPlan},
    "packing": {"packing": PackingRule, "packing_draw": PackingDraw},
    "sand": {"sand": Sand, "calibration": Calibration},
    "cement": {"cement": Cement, "bonding": Bonding},
    "pattern": {"pattern": CementRule},
    "wave": {"wave": WaveRule, "excitation": Excitation},
    "pick": {"pick": PickRule, "velocity_choice": VelocityChoice},
    "run": {"run": RunOptions},
}
"""Sections of the file, and the attributes of `Configuration` that each one gives, with their types."""

_LARGEST_FILE = 4_000_000
"""Bytes: 100,000 listed seeds have room, and no device or data file fills the memory."""

_DEEPEST = 8
"""Levels of tables and lists in one another that a file may have; four are needed."""

_LARGEST_WHOLE_NUMBER = 2**63 - 1
"""Of TOML (https://toml.io/en/v1.0.0#integer) and of databases."""

_SMALLEST_NUMBER, _LARGEST_NUMBER = 1e-30, 1e30
"""In SI units; the products of several such numbers and their reciprocals are still finite."""

TAKEN_FROM_ELSEWHERE = {"pattern.sand_density": "sand.density", "packing.file_sha256": "packing.file"}
"""Keys that a file does not have, because another one says the same."""


def load_configuration(path: str | os.PathLike[str], overrides: Mapping[str, Any] | None = None) -> Configuration:
    """Read and check a configuration.

    Parameters
    ----------
    path
        TOML file.
    overrides
        Values of section ``[run]`` that replace those of the file; None leaves the file's.

    Raises
    ------
    ConfigurationError
        With everything that is wrong.
    """
    document = parse_file(Path(path))
    given = {key: value for key, value in (overrides or {}).items() if value is not None}
    if given and isinstance(document.setdefault("run", {}), dict):
        document["run"] |= given
    return read_configuration(document, os.fspath(path), Path(path).parent)


def parse_file(path: Path) -> dict[str, Any]:
    """Sections of a TOML file, or a `ConfigurationError` that says why there are none."""
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
    except (ValueError, RecursionError) as error:  # what TOML forbids, numbers too long for Python, brackets too deep
        problem = f'not TOML: {error}; numbers are written 1.5, strings "...", lists [1, 2]'
    raise ConfigurationError(str(path), [Problem(problem)])


def _is_deeper(value: object, levels: int) -> bool:
    """Whether tables and lists are nested deeper than so many levels."""
    inner = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
    return any(levels == 0 or _is_deeper(item, levels - 1) for item in inner)


def read_configuration(
    document: Mapping[str, Any], source: str = "configuration", folder: Path = Path()
) -> Configuration:
    """Turn a mapping of sections into a checked configuration; other files that it names are relative to the folder.

    Raises
    ------
    ConfigurationError
        With everything that is wrong.
    """
    problems = [_unknown_name(name, "section", list(SECTIONS)) for name in document if name not in SECTIONS]
    parts: dict[str, Any] = {}
    for name, types in SECTIONS.items():
        values = document.get(name, {})
        if not isinstance(values, Mapping):
            cure = f"write [{name}] and its keys below it"
            problems.append(Problem(f"{name} = {quote(values)}: is not a section; {cure}", (name,)))
            values = {}
        problems += _read_section(name, values, types, parts)
        if name == "packing":
            problems += take_own_disks(parts, values, folder)
    configuration = Configuration(**parts)
    configuration = replace(
        configuration, pattern=replace(configuration.pattern, sand_density=configuration.sand.density)
    )
    # A field that is wrong by itself was replaced by its default, with which nothing else should be compared.
    broken = {field for problem in problems for field in problem.fields}
    problems += [problem for problem in cross_check(configuration) if not broken & set(problem.fields)]
    if problems:
        raise ConfigurationError(source, problems)
    return configuration


def _read_section(
    section: str, values: Mapping[str, Any], types: Mapping[str, type["DataclassInstance"]], parts: dict[str, Any]
) -> list[Problem]:
    """Read one section into objects of its types, put them into ``parts``, and return what is wrong.

    What is wrong is replaced by its default, so that reading goes on and finds all problems.
    """
    owner = {
        field.name: kind
        for kind in types.values()
        for field in fields(kind)
        if f"{section}.{field.name}" not in TAKEN_FROM_ELSEWHERE
    }
    problems: list[Problem] = []
    good: dict[str, Any] = {}
    for key, value in values.items():
        if key not in owner:
            problems.append(_unknown_name(key, f"key of [{section}]", list(owner), section))
            continue
        good |= _read_value(section, key, value, owner[key], problems)
    for attribute, kind in types.items():
        own = {key: value for key, value in good.items() if owner[key] is kind}
        parts[attribute] = _build(section, kind, own, problems)
    return problems


def _read_value(
    section: str, key: str, value: object, kind: type["DataclassInstance"], problems: list[Problem]
) -> dict[str, Any]:
    """Read the value of a key; an empty mapping, and a problem more, if it has the wrong type."""
    hint = get_type_hints(kind)[key]
    place = f"{section}.{key}"
    table = next((choice for choice in get_args(hint) if is_dataclass(choice)), None)
    if isinstance(value, Mapping) and isinstance(table, type):
        found: dict[str, Any] = {}
        wrong = _read_section(place, value, {key: table}, found)
        problems += [Problem(problem.message, (place, *problem.fields)) for problem in wrong]
        return {} if wrong else found
    if words := _impossible(value):
        problems.append(Problem(f"{place} = {quote(value)}: {words}", (place,)))
        return {}
    try:
        return {key: TypeAdapter(hint, config=_STRICT).validate_python(_freeze_lists(value))}
    except ValidationError as error:
        cure = next(field for field in fields(kind) if field.name == key).metadata.get("cure")
        words = cure or "; ".join(phrase(detail) for detail in error.errors())
        problems.append(Problem(f"{place} = {quote(value)}: {words}", (place,)))
        return {}


def _impossible(value: object) -> str:
    """Problem and cure of a value that no field can have, whatever its type; empty for all others."""
    if isinstance(value, list):
        return next(filter(None, map(_impossible, value)), "")
    if isinstance(value, int) and abs(value) > _LARGEST_WHOLE_NUMBER:
        return f"has more than 64 bits; give at most {_LARGEST_WHOLE_NUMBER}"
    # NaN and infinity are the type's business.
    if isinstance(value, float) and (0.0 < abs(value) < _SMALLEST_NUMBER or _LARGEST_NUMBER < abs(value) < math.inf):
        return f"is out of range; give 0, or a number of {_SMALLEST_NUMBER:g} to {_LARGEST_NUMBER:g} in SI units"
    if isinstance(value, str) and any(unicodedata.category(character) == "Cc" for character in value):
        return "has control characters; write it without"
    return ""


def _build(
    section: str, kind: type["DataclassInstance"], values: dict[str, Any], problems: list[Problem]
) -> "DataclassInstance | None":
    """Make the object; a value that it refuses becomes a problem, and then its default is taken instead."""
    required = [field.name for field in fields(kind) if field.default is MISSING]
    missing = [name for name in required if name not in values]
    problems += [Problem(f"{section}.{name}: is missing; add it", (f"{section}.{name}",)) for name in missing]
    while all(name in values for name in required):
        try:
            return kind(**values)
        except ValueError as error:
            message = str(error)
            # Several fields may be compared with one another, and the one that is named may not be the wrong one.
            named = [key for key in values if re.search(rf"\b{key}\b", message)] or list(values)
            problems.append(Problem(f"{section}.{message}", tuple(f"{section}.{key}" for key in named)))
            values = {key: value for key, value in values.items() if key not in named}
    return None


def _unknown_name(name: str, what: str, known: list[str], section: str = "") -> Problem:
    """Problem of a name that is not known, with the one that may be meant."""
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


def _freeze_lists(value: object) -> object:
    """Lists as tuples, all the way down: what is frozen stays as it is."""
    return tuple(_freeze_lists(item) for item in value) if isinstance(value, list) else value
