"""Every key of a configuration with its type, default, unit, meaning and bounds, from the classes that use it."""

import inspect
import re
import textwrap
import tomllib
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from types import NoneType
from typing import Annotated, Any, get_args, get_origin

from calcidem.app.config.presets import PRESETS, preset_text
from calcidem.app.config.reader import read_configuration
from calcidem.app.config.schema import SECTIONS, TAKEN_FROM_ELSEWHERE, Configuration
from calcidem.dem.engine.fields import accepted_values, field_hints, unit_of, written

CALIBRATED = (
    "sand.wave_stiffness_factor",
    "pattern.p_share",
    "pattern.p_patch_diameter",
    "pattern.cluster_area",
)
"""Keys that the comments of the examples call calibrated."""


@dataclass(frozen=True, slots=True)
class KeyReference:
    """One key of a configuration."""

    section: str
    name: str
    """Section and name of the key."""
    attribute: str
    """Attribute of `Configuration` that has it."""
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
    keys = []
    for section, kinds in SECTIONS.items():
        for attribute, kind in kinds.items():
            attributes = (inspect.getdoc(kind) or "").partition("Attributes\n----------\n")[2]
            meanings = {
                name: " ".join(words.replace("``", "`").split())
                for names, words in re.findall(r"^(\w[\w, ]*)\n((?: +.*\n?)+)", attributes, re.MULTILINE)
                for name in names.split(", ")
            }
            for entry in fields(kind):
                if f"{section}.{entry.name}" not in TAKEN_FROM_ELSEWHERE:
                    hint = field_hints(kind)[entry.name]
                    words = _kind_in_words(hint), entry.default, unit_of(hint), meanings[entry.name]
                    keys.append(KeyReference(section, entry.name, attribute, *words, accepted_values(hint)))
    return tuple(keys)


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
    words = {int: "whole number", float: "number", bool: "true or false", str: "text"}
    return words.get(hint) or " or ".join(
        dict.fromkeys(words.get(type(arm)) or _kind_in_words(arm) for arm in inner)  # choices are texts
    )


def full_text(preset: str) -> str:
    """Text of an example configuration with every key, its meaning and accepted values."""
    text = preset_text(preset)
    configuration = read_configuration(tomllib.loads(text))
    lines = [line for line in text.partition("\n\n")[0].splitlines() if "left out" not in line]
    lines.append("# Keys that are commented out are not set; the text above them describes the default.")
    for section in SECTIONS:
        lines += ["", f"[{section}]"]
        for key in (key for key in key_references() if key.section == section):
            value = getattr(getattr(configuration, key.attribute), key.name)
            words = key.meaning.replace("`", "") + (f" Accepted: {key.accepted}." if key.accepted else "")
            lines += textwrap.wrap(words, 110, initial_indent="# ", subsequent_indent="# ")
            lines.append(f"# {key.name} =" if value is None else f"{key.name} = {written(value)}")
    return "\n".join(lines) + "\n"


def calibration_note(configuration: Configuration) -> str:
    """Message about values of an example that were calibrated for another material; empty without any."""

    def values(owner: Configuration, *names: str) -> dict[str, Any]:
        """None where a later key has its default, which campaigns do not store."""
        return {name: owner.physics[name.split(".")[0]].get(name.split(".")[1]) for name in names}

    material = ("sand.shear_modulus", "sand.poisson_ratio", "cement.bond_modulus", "cement.linear_modulus")
    given, own = values(configuration, *CALIBRATED).items(), values(configuration, *material)
    for preset in PRESETS:
        fitted = read_configuration(tomllib.loads(preset_text(preset)))
        kept = given & values(fitted, *CALIBRATED).items() - values(Configuration(), *CALIBRATED).items()
        changed = values(fitted, *material).items() - own.items()
        if kept and changed:
            return (
                f"Note: {', '.join(f'{name} = {written(value)}' for name, value in sorted(kept))}: calibrated with "
                f"{', '.join(f'{name} = {written(value)}' for name, value in sorted(changed))} (preset {preset}), but "
                f"here that is {', '.join(written(own[name]) for name, _ in sorted(changed))}. Leave the calibrated "
                "values out, or fit them to measurements of this material with 'calcidem calibrate'."
            )
    return ""
