"""Every key of a configuration with its type, default, unit, meaning and bounds, from the classes that use it."""

import inspect
import json
import re
import textwrap
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin

from calcidem.app.config.presets import preset_text
from calcidem.app.config.reader import SECTIONS, TAKEN_FROM_ELSEWHERE, read_configuration
from calcidem.dem.engine.fields import accepted_values, field_hints, unit_of

if TYPE_CHECKING:
    from _typeshed import DataclassInstance  # known to type checkers only

_WORDS = {int: "whole number", float: "number", bool: "true or false", str: "text"}


@dataclass(frozen=True, slots=True)
class KeyReference:
    """One key of a configuration."""

    section: str
    name: str
    """Section and name of the key."""
    kind: str
    """Type in words: ``number``, ``list of numbers``, ``text``."""
    default: Any
    """Default; None without one."""
    unit: str
    """Unit, SI or percent; empty without one."""
    meaning: str
    """Meaning, from the docstring of its class."""
    accepted: str
    """Accepted values, in the words of the error message; empty if all values of its type are accepted."""


@cache
def key_references() -> tuple[KeyReference, ...]:
    """All keys in the order of their sections."""
    return tuple(key for section, kinds in SECTIONS.items() for kind in kinds.values() for key in _keys(section, kind))


def full_text(preset: str) -> str:
    """Text of an example configuration with every key, its meaning and accepted values."""
    text = preset_text(preset)
    configuration = read_configuration(tomllib.loads(text))
    lines = [line for line in text.partition("\n\n")[0].splitlines() if "left out" not in line]
    lines.append("# Keys that are commented out are not set; the text above them describes the default.")
    for section, parts in SECTIONS.items():
        lines += ["", f"[{section}]"]
        for key in key_references():
            if key.section != section:
                continue
            owner = next(part for part, kind in parts.items() if key.name in {entry.name for entry in fields(kind)})
            value = getattr(getattr(configuration, owner), key.name)
            words = key.meaning.replace("`", "") + (f" Accepted: {key.accepted}." if key.accepted else "")
            lines += textwrap.wrap(words, 110, initial_indent="# ", subsequent_indent="# ")
            lines.append(f"# {key.name} =" if value is None else f"{key.name} = {written(value)}")
    return "\n".join(lines) + "\n"


def written(value: object) -> str:
    """Value as written in a configuration: numbers with the fewest digits that are exact."""
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(written, value))}]"
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{name} = {written(inner)}' for name, inner in value.items())} }}"
    if isinstance(value, bool | str):
        return json.dumps(value, ensure_ascii=False)
    short = f"{value:g}"
    if not isinstance(value, float) or float(short) != value:
        return str(value)
    return short if set(short) & set(".e") else f"{short}.0"


def _keys(section: str, kind: type["DataclassInstance"]) -> Iterator[KeyReference]:
    """Keys of one class."""
    meanings, hints = dict(_meanings(kind)), field_hints(kind)
    for entry in fields(kind):
        if f"{section}.{entry.name}" not in TAKEN_FROM_ELSEWHERE:
            hint = hints[entry.name]
            words = _kind_in_words(hint), entry.default, unit_of(hint), meanings[entry.name], accepted_values(hint)
            yield KeyReference(section, entry.name, *words)


def _meanings(kind: type) -> Iterator[tuple[str, str]]:
    """Names and descriptions in the section Attributes of a docstring, one line each."""
    text = (inspect.getdoc(kind) or "").partition("Attributes\n----------\n")[2]
    for names, words in re.findall(r"^(\w[\w, ]*)\n((?: +.*\n?)+)", text, re.MULTILINE):
        for name in names.split(", "):
            yield name, " ".join(words.replace("``", "`").split())


def _kind_in_words(hint: Any) -> str:  # noqa: ANN401 - a type hint has no type of its own
    """Name of a type in words."""
    if is_dataclass(hint):
        return "table"
    inner = [argument for argument in get_args(hint) if argument not in (NoneType, ...)]
    if get_origin(hint) is Annotated:
        return _kind_in_words(inner[0])
    if get_origin(hint) is tuple:
        count = f"{len(inner)} " if len(inner) > 1 else ""
        return f"list of {count}{_kind_in_words(inner[0])}s"
    return _WORDS.get(hint) or " or ".join(dict.fromkeys(_WORDS.get(type(arm)) or _kind_in_words(arm) for arm in inner))
