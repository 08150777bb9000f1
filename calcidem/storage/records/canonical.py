"""Canonical JSON of a configuration, its hash, and the readable difference of two configurations."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any


def canonical_json(config: Mapping[str, Any]) -> str:
    """Return JSON text that is the same for equal configurations: keys sorted, no spaces, shortest floats.

    Raises
    ------
    ValueError
        For NaN and infinity.
    """
    return json.dumps(config, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def canonical_hash(config: Mapping[str, Any]) -> str:
    """Return the SHA-256 of `canonical_json`, as 64 hexadecimal digits."""
    return hashlib.sha256(canonical_json(config).encode()).hexdigest()


def config_difference(stored: str, given: str) -> list[str]:
    """List what differs between two configurations in JSON text.

    Returns
    -------
    list of str
        One line per nested key, such as ``packing.friction: 0.2 -> 0.5``.

    Examples
    --------
    >>> config_difference('{"packing": {"friction": 0.2}}', '{"packing": {"friction": 0.5}}')
    ['packing.friction: 0.2 -> 0.5']
    """
    before, after = (
        {key: json.dumps(value, ensure_ascii=False) for key, value in flat_parameters(json.loads(text)).items()}
        for text in (stored, given)
    )
    absent = "(not there)"
    return [
        f"{key}: {before.get(key, absent)} -> {after.get(key, absent)}"
        for key in sorted(before.keys() | after.keys())
        if before.get(key, absent) != after.get(key, absent)
    ]


def flat_parameters(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested keys as one level, joined by points."""
    flat: dict[str, Any] = {}
    for key, value in config.items():
        if isinstance(value, dict) and value:
            flat |= flat_parameters(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat
