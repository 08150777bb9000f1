"""Every key of a configuration with its type, default, unit, meaning and bounds, taken from the classes that use it."""

import inspect
import re
import textwrap
import tomllib
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from functools import cache
from types import NoneType
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin, get_type_hints

from calcidem.app.config.presets import preset_text
from calcidem.app.config.reader import SECTIONS, TAKEN_FROM_ELSEWHERE, read_configuration

if TYPE_CHECKING:
    from _typeshed import DataclassInstance  # known to type checkers only

_UNIT = re.compile(r"(?<!\w)(m/s|m\^2|kg/m\^3|Pa|Hz|degrees|percent|seconds|m)(?!\w)", re.IGNORECASE)

_TRIED = {int: (-1, 0, 1, 10**12), float: (-1.0, 0.0, 1.0, 1e12), str: ("",)}
"""Values that show what a key refuses, by type."""

_WORDS = {int: "whole number", float: "number", bool: "true or false", str: "text"}


@dataclass(frozen=True, slots=True)
class KeyReference:
    """One key of a configuration.

    Attributes
    ----------
    section, name
        Of the key.
    kind
        What is written: ``number``, ``list of numbers``, or the choices there are.
    default
        What holds where the key is left out; None if nothing does.
    unit
        SI, or percent; empty for numbers without one.
    meaning
        What it is, from the docstring of the class that has it.
    accepted
        What that class says when it refuses a value.
    """

    section: str
    name: str
    kind: str
    default: Any
    unit: str
    meaning: str
    accepted: str = field(default="")


@cache
def key_references() -> tuple[KeyReference, ...]:
    """All keys in the order of their sections."""
    return tuple(key for section, kinds in SECTIONS.items() for kind in kinds.values() for key in _keys(section, kind))


def full_text(preset: str) -> str:
    """Text of an example configuration with every key, its meaning and what it takes."""
    text = preset_text(preset)
    configuration = read_configuration(tomllib.loads(text))
    lines = [line for line in text.partition("\n\n")[0].splitlines() if "left out" not in line]
    lines.append("# Keys that are commented out are not set; the text above them says what then applies.")
    for section, parts in SECTIONS.items():
        lines += ["", f"[{section}]"]
        for key in key_references():
            if key.section != section:
                continue
            owner = next(part for part, kind in parts.items() if key.name in {entry.name for entry in fields(kind)})
            value = getattr(getattr(configuration, owner), key.name)
            accepted = key.kind if '"' in key.kind else key.accepted
            words = key.meaning.replace("`", "") + (f" Accepted: {accepted}." if accepted else "")
            lines += textwrap.wrap(words, 110, initial_indent="# ", subsequent_indent="# ")
            lines.append(f"# {key.name} =" if value is None else f"{key.name} = {written(value)}")
    return "\n".join(lines) + "\n"


def written(value: object) -> str:
    """Value as a configuration has it: numbers in as few digits as say them exactly."""
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(written, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    short = f"{value:g}"
    if not isinstance(value, float) or float(short) != value:
        return str(value)
    return short if set(short) & set(".e") else f"{short}.0"


def _keys(section: str, kind: type["DataclassInstance"]) -> Iterator[KeyReference]:
    """Keys of one class."""
    meanings, hints = dict(_meanings(kind)), get_type_hints(kind)
    for entry in fields(kind):
        if f"{section}.{entry.name}" in TAKEN_FROM_ELSEWHERE:
            continue
        meaning = meanings[entry.name]
        found = _UNIT.search(meaning)
        default = entry.default if entry.default_factory is MISSING else entry.default_factory()
        yield KeyReference(
            section=section,
            name=entry.name,
            kind=_in_words(hints[entry.name]),
            default=default,
            unit="" if found is None else {"seconds": "s"}.get(found[0].lower(), found[0]),
            meaning=meaning,
            accepted="; ".join(_refusals(kind, entry.name, hints[entry.name], entry.metadata.get("cure"))),
        )


def _meanings(kind: type) -> Iterator[tuple[str, str]]:
    """Names and descriptions in the section Attributes of a docstring, one line each."""
    text = (inspect.getdoc(kind) or "").partition("Attributes\n----------\n")[2]
    for names, words in re.findall(r"^(\w[\w, ]*)\n((?: +.*\n?)+)", text, re.MULTILINE):
        for name in names.split(", "):
            yield name, " ".join(words.replace("``", "`").split())


def _in_words(hint: Any) -> str:  # noqa: ANN401 - a type hint has no type of its own
    """What is written for a type."""
    if hint in _WORDS:
        return _WORDS[hint]
    if is_dataclass(hint):
        return "table"
    inner = [argument for argument in get_args(hint) if argument not in (NoneType, ...)]
    if get_origin(hint) is Literal:
        return ", ".join(f'"{choice}"' for choice in inner)
    if get_origin(hint) is tuple:
        listed = {"whole number": "whole numbers", "number": "numbers", "text": "texts"}[_in_words(inner[0])]
        return f"list of {len(inner)} {listed}" if len(inner) > 1 else f"list of {listed}"
    return " or ".join(map(_in_words, inner))


def _refusals(kind: type, name: str, hint: Any, cure: str | None) -> Iterator[str]:  # noqa: ANN401 - as above
    """What a class says of impossible values of a key, without repetition."""
    said = set() if cure is None else {cure}
    yield from (_without_verb(words) for words in said)
    for value in _tried(hint):
        try:
            kind(**{name: value})
        except ValueError as error:
            words = str(error).partition(": ")[2]
            if words not in said:
                said.add(words)
                yield _without_verb(words)


def _without_verb(words: str) -> str:
    """A cure as a description of what may be given."""
    return words.removeprefix("give ").removeprefix("choose ")


def _tried(hint: Any) -> Iterator[object]:  # noqa: ANN401 - as above
    """Values of a type at and beyond its ends."""
    if hint in _TRIED:
        yield from _TRIED[hint]
    elif get_origin(hint) is tuple:
        inner = get_args(hint)
        yield from ((value,) * (1 if ... in inner else len(inner)) for value in _tried(inner[0]))
    elif get_origin(hint) is not Literal:
        for argument in get_args(hint):
            yield from _tried(argument)
