"""Canonical JSON of a configuration, its hash, and the differences of two configurations as text."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any


def canonical_json(config: Mapping[str, Any]) -> str:
    """Return JSON text that is the same for equal configurations: keys sorted, no spaces, shortest floats.

    `ValueError` for NaN and infinity.
    """
    return json.dumps(config, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def canonical_hash(config: Mapping[str, Any]) -> str:
    """Return the SHA-256 of `canonical_json`, as 64 hexadecimal digits."""
    return hashlib.sha256(canonical_json(config).encode()).hexdigest()


def config_difference(stored: str, given: str, *, shared_only: bool = False) -> list[str]:
    """List the differences of two configurations in JSON text, one line for each nested key.

    With ``shared_only`` keys that only one of both has are left out.

    Examples
    --------
    >>> config_difference('{"packing": {"friction": 0.2}}', '{"packing": {"friction": 0.5}}')
    ['packing.friction: 0.2 -> 0.5']
    """
    before, after = (flat_parameters(json.loads(text)) for text in (stored, given))
    shared, all_keys = before.keys() & after.keys(), before.keys() | after.keys()
    differing = {key for key in shared if before[key] != after[key]} | (set() if shared_only else all_keys - shared)

    def shown(values: Mapping[str, Any], key: str) -> str:
        return json.dumps(values[key], ensure_ascii=False) if key in values else "(not there)"

    return [f"{key}: {shown(before, key)} -> {shown(after, key)}" for key in sorted(differing)]


def flat_parameters(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested keys as one level, joined by points."""
    flat: dict[str, Any] = {}
    for key, value in config.items():
        if isinstance(value, dict) and value:
            flat |= flat_parameters(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat
