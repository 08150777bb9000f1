"""Arrays in the database: compressed blobs."""

import io
import zipfile
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calcidem.input_file import zip_members


def pack_arrays(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Compress named arrays into the bytes of a NumPy ``.npz`` file.

    Any later reader can open this format: ``numpy.load(io.BytesIO(blob))``. It is that of `numpy.savez_compressed`,
    except for the level of compression, which that function does not offer.
    """
    buffer = io.BytesIO()
    # For cement patterns the usual level of zlib, 6, takes four times as long and saves 4 % of the bytes.
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, array, allow_pickle=False)
    return buffer.getvalue()


def unpack_arrays(blob: bytes) -> dict[str, NDArray[Any]]:
    """Inverse of `pack_arrays`; the arrays are read-only. `ValueError` for other or damaged bytes."""
    return {name.removesuffix(".npy"): _read_array(content) for name, content in zip_members(blob).items()}


def _read_array(content: bytes) -> NDArray[Any]:
    """Array of an ``.npy`` file, as `numpy.load` reads it."""
    start = 10 + int.from_bytes(content[8:10], "little")  # version 1: the header's length is before the header
    shape, is_fortran, dtype = _read_header(content[:start])
    values = np.frombuffer(content, dtype, offset=start)
    return values.reshape(shape, order="F" if is_fortran else "C")


@lru_cache(1024)  # cached, since parsing takes longest and most cells have the same headers
def _read_header(header: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and type in the header of an ``.npy`` file of version 1."""
    file = io.BytesIO(header)
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError("no array that `pack_arrays` wrote")
    found: tuple[tuple[int, ...], bool, np.dtype[Any]] = np.lib.format.read_array_header_1_0(file)
    return found
