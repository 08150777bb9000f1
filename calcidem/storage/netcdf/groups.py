"""Columns in a group of a NetCDF file, appended block by block to keep memory small.

Arrays of different lengths lie one after the other along a dimension, and a count for each of them tells
how many elements are whose (the contiguous ragged arrays of the CF conventions, section 9.3.3).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Group = Any
"""A netCDF4.Dataset or netCDF4.Group; that library has no types."""

Column = tuple[str, str, NDArray[Any]]
"""Unit ("" for texts), long name and values of a variable."""

COUNT = "_count"


def append(group: Group, dimension: str, columns: Mapping[str, Column]) -> None:
    """Append columns of equal length along an unlimited dimension, creating what isn't there yet.

    A column named ``<other dimension>_count`` tells how many elements of that dimension belong to each
    element of this one.
    """
    if dimension not in group.dimensions:
        group.createDimension(dimension, None)
    start = len(group.dimensions[dimension])
    for name, (unit, long_name, values) in columns.items():
        if name not in group.variables:
            is_text = values.dtype.kind == "O"
            options = {} if is_text else {"compression": "zlib", "complevel": 4, "shuffle": True}
            variable = group.createVariable(name, str if is_text else values.dtype, (dimension,), **options)
            variable.long_name = long_name
            if unit:
                variable.units = unit
            if name.endswith(COUNT):
                variable.sample_dimension = name.removesuffix(COUNT)
        group.variables[name][start : start + len(values)] = values


def read_columns(group: Group, dimension: str, rows: slice = slice(None)) -> dict[str, NDArray[Any]]:
    """Read all columns along a dimension, or some of their rows."""
    return {
        name: np.asarray(variable[rows])
        for name, variable in group.variables.items()
        if variable.dimensions == (dimension,)
    }


def counted_slices(counts: NDArray[np.integer[Any]]) -> list[slice]:
    """Return where the elements of each owner are.

    Examples
    --------
    >>> counted_slices(np.array([2, 0, 3]))
    [slice(0, 2, None), slice(2, 2, None), slice(2, 5, None)]
    """
    ends = np.cumsum(counts).tolist()
    return [slice(end - count, end) for end, count in zip(ends, counts.tolist(), strict=True)]


def texts(values: list[str | None]) -> NDArray[np.object_]:
    """Texts as a column; a missing one is empty."""
    return np.array([value or "" for value in values], dtype=object)


def optional_texts(values: NDArray[Any]) -> list[str | None]:
    """Inverse of `texts`."""
    return [value or None for value in values.tolist()]
