"""Arrays in the database: compressed blobs."""

import io
import zipfile
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

_COMPRESSION_LEVEL = 1
"""Of zlib. On cement patterns level 6, the usual one, takes four times as long and saves 4 % of the bytes."""

_HEADER_LENGTH_END = 10
"""Bytes of an ``.npy`` file of version 1 up to its header, whose length the last two tell."""


def pack_arrays(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Compress named arrays into the bytes of a NumPy ``.npz`` file.

    The format is chosen because any later reader can open it: ``numpy.load(io.BytesIO(blob))``. It is what
    `numpy.savez_compressed` writes, but for the level of compression, which that function doesn't let one choose.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=_COMPRESSION_LEVEL) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, array, allow_pickle=False)
    return buffer.getvalue()


def unpack_arrays(blob: bytes) -> dict[str, NDArray[Any]]:
    """Inverse of `pack_arrays`; the arrays are read-only."""
    with zipfile.ZipFile(io.BytesIO(blob)) as archive:
        return {info.filename.removesuffix(".npy"): _read_array(archive.read(info)) for info in archive.infolist()}


def _read_array(content: bytes) -> NDArray[Any]:
    """Array of an ``.npy`` file, as `numpy.load` reads it."""
    start = _HEADER_LENGTH_END + int.from_bytes(content[_HEADER_LENGTH_END - 2 : _HEADER_LENGTH_END], "little")
    shape, is_fortran, dtype = _read_header(content[:start])
    values = np.frombuffer(content, dtype, offset=start)
    return values.reshape(shape, order="F" if is_fortran else "C")


@lru_cache(1024)  # parsing it takes longer than all the rest, and cells have much the same ones
def _read_header(header: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and type in the header of an ``.npy`` file of version 1."""
    file = io.BytesIO(header)
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError("no array that `pack_arrays` wrote")
    found: tuple[tuple[int, ...], bool, np.dtype[Any]] = np.lib.format.read_array_header_1_0(file)
    return found
