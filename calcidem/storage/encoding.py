"""Configurations as canonical JSON with a hash, and arrays as compressed bytes: what the store has no columns for."""

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calcidem.input_file import zip_members


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


def pack_arrays(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Compress named arrays into the bytes of a NumPy ``.npz`` file.

    Any later reader can open this format: ``numpy.load(io.BytesIO(blob))``. It is that of `numpy.savez_compressed`,
    except for the level of compression, which that function does not offer.
    """
    buffer = io.BytesIO()
    # For cement patterns the usual level of zlib, 6, takes four times as long and saves 4 % of the bytes.
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            file = io.BytesIO()  # members written piece by piece take longer
            np.lib.format.write_array(file, array, allow_pickle=False)
            member = zipfile.ZipInfo(f"{name}.npy")  # which has no time of its own
            archive.writestr(member, file.getvalue(), zipfile.ZIP_DEFLATED, 1)
    return buffer.getvalue()


def unpack_arrays(blob: bytes) -> dict[str, NDArray[Any]]:
    """Inverse of `pack_arrays`; the arrays are read-only. `ValueError` for other or damaged bytes."""
    arrays: dict[str, NDArray[Any]] = {}
    for name, content in zip_members(blob).items():  # as `numpy.load` reads them
        start = 10 + int.from_bytes(content[8:10], "little")  # version 1: the header's length is before the header
        shape, is_fortran, dtype = _read_header(content[:start])
        values = np.frombuffer(content, dtype, offset=start)
        arrays[name.removesuffix(".npy")] = values.reshape(shape, order="F" if is_fortran else "C")
    return arrays


@lru_cache(1024)  # cached, since parsing takes longest and most cells have the same headers
def _read_header(header: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and type in the header of an ``.npy`` file of version 1."""
    file = io.BytesIO(header)
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError("no array that `pack_arrays` wrote")
    found: tuple[tuple[int, ...], bool, np.dtype[Any]] = np.lib.format.read_array_header_1_0(file)
    return found
