"""Arrays in records and in the database: read-only copies, comparison by value, compressed blobs."""

import dataclasses
import io
import math
import zipfile
from collections.abc import Mapping
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_COMPRESSION_LEVEL = 1
"""Of zlib. On cement patterns level 6, the usual one, takes four times as long and saves 4 % of the bytes."""

_HEADER_LENGTH_END = 10
"""Bytes of an ``.npy`` file of version 1 up to its header, whose length the last two tell."""


class ComparedByValue:
    """Base of frozen dataclasses that hold arrays: equal when all fields are, arrays element by element.

    The comparison that `dataclasses` generates fails on arrays, because ``a == b`` is an array then.
    Declare such a class with ``@dataclass(frozen=True, slots=True, eq=False)``.
    """

    __slots__ = ()

    __hash__ = None  # type: ignore[assignment]  # compared by value and holding arrays: not hashable

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        names = [field.name for field in dataclasses.fields(self)]  # type: ignore[arg-type]  # see the class
        return all(_same(getattr(self, name), getattr(other, name)) for name in names)


def _same(first: object, second: object) -> bool:
    if isinstance(first, np.ndarray) and isinstance(second, np.ndarray):
        return first.dtype == second.dtype and np.array_equal(first, second)
    return bool(first == second)


def freeze_array(owner: str, name: str, values: object, dtype: DTypeLike, shape: tuple[int | None, ...]) -> Any:  # noqa: ANN401 - the element type is the caller's `dtype`
    """Return `values` as a contiguous read-only copy of a shape, None for any length along an axis.

    Errors name the field of the owner: `ValueError` for another shape, for NaN or infinity, and for values that `dtype`
    can't hold.
    """
    given = np.asarray(values)
    array = np.array(given, dtype=dtype, order="C", copy=True)
    fits = array.ndim == len(shape) and all(want in (None, have) for have, want in zip(array.shape, shape, strict=True))
    if not fits:
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise ValueError(f"{owner}.{name} has shape {array.shape}; give an array of shape {wanted}.")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError(f"{owner}.{name} holds NaN or infinity; store finite numbers or None.")
    if array.dtype.kind in "iu" and not np.array_equal(array, given):
        raise ValueError(f"{owner}.{name} holds values that {array.dtype} can't represent.")
    array.setflags(write=False)
    return array


def normalize_numbers(record: object) -> None:
    """Turn NumPy scalars in a record's fields into Python numbers; `ValueError` for NaN and infinity.

    Database drivers don't know NumPy's scalars, and a missing number is None.
    """
    for name in _field_names(type(record)):  # type: ignore[arg-type]  # a class is hashable, whatever its objects are
        value = getattr(record, name)
        if isinstance(value, np.generic):
            value = value.item()
            object.__setattr__(record, name, value)
        if isinstance(value, float) and not math.isfinite(value):
            owner = type(record).__name__
            raise ValueError(f"{owner}.{name} is {value}; a missing number is None, never NaN or infinity.")


@cache  # a million records use it
def _field_names(kind: type) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(kind))


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
