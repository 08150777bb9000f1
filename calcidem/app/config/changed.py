"""A configuration with some values changed by the names of their keys, as `calcidem.run(set=...)` takes them."""

import os
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from calcidem.app.config.reader import SECTIONS, parse_file, read_configuration
from calcidem.app.config.schema import Configuration

_NOT_TO_BE_READ = {"file", "file_sha256", "sand_density"}
"""What a configuration in memory has from elsewhere: the content of a file, or another key."""


def change_configuration(origin: Configuration | str | os.PathLike[str], values: Mapping[str, object]) -> Configuration:
    """Read a configuration, or the TOML file that it is in, again with other values, all checks included.

    They are by section and key, such as ``{"wave.amplitude": 1e-4}``. `ConfigurationError` with everything that is
    wrong.
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
    """Sections and keys of a configuration as a file has them."""
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
    """Put each value in the place of its name."""
    for name, value in values.items():
        *sections, key = name.split(".")
        table = document
        for section in sections:
            inner = table.setdefault(section, {})
            table[section] = table = inner if isinstance(inner, dict) else {}
        table[key] = _as_written(value)


def _as_written(value: object) -> object:
    """A value with lists in place of arrays, at all levels."""
    if isinstance(value, Mapping):
        return {key: _as_written(inner) for key, inner in value.items()}
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
