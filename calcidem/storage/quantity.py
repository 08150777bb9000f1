"""Annotations of the fields of records, from which the catalogue of quantities is made.

A field with one number or text of a cell is annotated with a `Quantity`, a field with an array with `Along`. Tables,
checks, filters, files and the reference page follow from these annotations. So the code of a new stored quantity is a
field and a value (CONTRIBUTING.md lists the files to make anew). Databases without its column are refused; NetCDF files
without it are read.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from functools import cache
from types import NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

_NO_NUMBER = -1  # stands for None among whole numbers in files; real values are 0 or more


Kind = Literal["real", "whole", "text"]


class Bound(StrEnum):
    """Bound of a quantity, besides being finite; the value is the remedy in messages."""

    POSITIVE = "give a positive number, or None if there is none"
    NOT_NEGATIVE = "give a number of 0 or more, or None"
    NONE = ""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number or text of each cell, which may be missing."""

    unit: str
    """UDUNITS string; empty for text."""
    meaning: str
    """Long name in files and tables."""
    origin: str = "campaign"
    """Origin, such as ``"reading"``."""
    bound: Bound = Bound.NONE
    is_exact: bool = False
    """Whether it has the same bits wherever the campaign is computed."""
    is_needed: bool = False
    """Whether a done cell must have it."""
    name: str = ""
    kind: Kind = "real"
    is_optional: bool = False
    """Name and type of the field; set by `Record.quantities`."""
    needs: tuple[str, ...] = ()
    """Stored quantities from which it is derived; empty for a stored one."""
    formula: Callable[..., Any] | None = None
    """Value from a square-root function and the values of these: numbers, arrays or columns of a database."""
    codes: Mapping[str, int] | None = None
    """Whole numbers for its texts in files (CF flags)."""
    ancillary: str = ""
    """Quantities that qualify it (CF), separated by spaces."""
    symbol: str = ""
    """Symbol in tables and figures; empty if it has none."""

    def attributes(self) -> dict[str, Any]:
        """CF attributes of a variable."""
        attributes: dict[str, Any] = {"long_name": self.meaning}
        if self.kind != "text":
            attributes["units"] = self.unit
        if self.ancillary:
            attributes["ancillary_variables"] = self.ancillary
        if self.codes is not None:
            attributes["standard_name"] = "status_flag"
            attributes["flag_values"] = np.array(list(self.codes.values()), dtype=np.int8)
            attributes["flag_meanings"] = " ".join(self.codes)
        return attributes

    @property
    def gap(self) -> Any:  # noqa: ANN401 - text or number
        """Value of missing entries in a file."""
        return {"text": "", "whole": _NO_NUMBER, "real": np.nan}[self.kind]

    def as_column(self, values: Sequence[Any] | NDArray[Any]) -> NDArray[Any]:
        """Values for a file, from values with None or NaN where missing."""
        if self.codes is not None:
            return np.array([self.codes[text] for text in values], dtype=np.int8)
        if self.kind == "text":
            return np.array([text or "" for text in values], dtype=object)
        numbers = np.array(values, dtype=np.float64)
        if self.kind == "real":
            return numbers
        return np.where(np.isnan(numbers), _NO_NUMBER, numbers).astype(np.int64)

    def as_values(self, column: NDArray[Any]) -> NDArray[np.object_]:
        """Inverse of `as_column`: Python's own int, float or str, None where missing."""
        if self.codes is not None:
            names: NDArray[np.object_] = np.array(list(self.codes), dtype=object)
            return np.take(names, column)
        plain = column.astype(object)
        missing = {"text": plain == "", "whole": column == _NO_NUMBER, "real": column != column}[self.kind]  # noqa: PLR0124 - NaN
        if self.is_optional:
            plain[missing] = None
        return plain


@dataclass(frozen=True, slots=True)
class Along:
    """Array with one row for each element of a dimension whose length differs between cells."""

    dimension: str
    unit: str
    """UDUNITS string."""
    meaning: str
    """Long name in files."""
    columns: str = ""
    """Dimension of its columns if their number also differs between cells; else empty."""
    width: int = 0
    """Number of its columns if it is the same in all cells."""

    @property
    def elements(self) -> str:
        """Dimension in files; row after row if its columns have a dimension."""
        return f"{self.dimension}_{self.columns}" if self.columns else self.dimension


class Record:  # noqa: PLW1641 - records that are keys have the hash that `dataclasses` makes
    """Base of the annotated frozen dataclasses: numbers within bounds, arrays read-only and compared by value.

    A class with arrays is declared with ``@dataclass(frozen=True, slots=True, eq=False)``, since the generated
    comparison fails for arrays.
    """

    __slots__ = ()

    @classmethod
    @cache
    def quantities(cls) -> tuple[Quantity, ...]:
        """Return the quantities, in the order of the fields."""
        found = []
        for name, hint, note in _annotated_fields(cls):
            if isinstance(note, Quantity):
                plain = get_args(hint)[0]
                (kind,) = {*(get_args(plain) or (plain,))} - {NoneType}
                word: Kind = "text" if issubclass(kind, str) else "whole" if issubclass(kind, int) else "real"
                found.append(replace(note, name=name, kind=word, is_optional=kind is not plain))
        return tuple(found)

    @classmethod
    def arrays(cls) -> dict[str, Along]:
        """Return the annotations of the arrays, by name."""
        return {name: note for name, _, note in _annotated_fields(cls) if isinstance(note, Along)}

    def __post_init__(self) -> None:
        """Convert NumPy scalars to Python numbers, for database drivers, and copy arrays.

        `ValueError`, naming the field, for NaN and infinity, numbers out of bounds, and arrays of another shape or with
        values that their type cannot hold.
        """
        owner: Any = type(self)
        names, bounds, arrays = _checked(owner)
        for name in names:
            value = getattr(self, name)
            if isinstance(value, np.generic):
                value = value.item()
                object.__setattr__(self, name, value)
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(
                    f"{owner.__name__}.{name} is {value}; a missing number is None, never NaN or infinity."
                )
        for name, bound in bounds:
            value = getattr(self, name)
            if value is not None and (value < 0 or (value == 0 and bound is Bound.POSITIVE)):
                raise ValueError(f"{owner.__name__}.{name} is {value}; {bound}.")
        lengths: dict[str, int] = {}
        for name, element, along in arrays:
            array = _freeze(f"{owner.__name__}.{name}", getattr(self, name), element, along, lengths)
            object.__setattr__(self, name, array)

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        owner: Any = type(self)
        pairs = ((getattr(self, name), getattr(other, name)) for name in _checked(owner)[0])
        # The arrays of a field have one type, see `_freeze`.
        return all(np.array_equal(one, two) if isinstance(one, np.ndarray) else one == two for one, two in pairs)


def _freeze(field: str, values: object, element: type[Any], along: Along, lengths: dict[str, int]) -> Any:  # noqa: ANN401 - an array
    """Return a contiguous read-only copy; the first array along a dimension determines the length of the others."""
    given = np.asarray(values)
    array = np.array(given, dtype=element, order="C", copy=True)
    dimensions = [name for name in (along.dimension, along.columns) if name]
    lengths |= {name: n for name, n in zip(dimensions, array.shape, strict=False) if name not in lengths}
    shape = (*(lengths.get(name) for name in dimensions), *((along.width,) if along.width else ()))
    if array.shape != shape:
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise ValueError(f"{field} has shape {array.shape}; give an array of shape {wanted}.")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError(f"{field} holds NaN or infinity; store finite numbers or None.")
    if array.dtype.kind in "iu" and not np.array_equal(array, given):
        raise ValueError(f"{field} holds values that {array.dtype} can't represent.")
    array.setflags(write=False)
    return array


@cache  # cached for millions of records
def _checked(
    record: type[Any],
) -> tuple[tuple[str, ...], tuple[tuple[str, Bound], ...], tuple[tuple[str, type[Any], Along], ...]]:
    """Names of all fields; bounds; element type and annotation of each array (bytes are no array)."""
    arrays = [(name, get_args(hint)[0], note) for name, hint, note in _annotated_fields(record)]
    return (
        tuple(field.name for field in fields(record)),
        tuple((q.name, q.bound) for q in record.quantities() if q.bound is not Bound.NONE),
        tuple(
            (name, get_args(get_args(kind)[1])[0], note)
            for name, kind, note in arrays
            if isinstance(note, Along) and get_origin(kind) is np.ndarray
        ),
    )


def _annotated_fields(record: type) -> list[tuple[str, Any, Any]]:
    hints = get_type_hints(record, include_extras=True)
    return [(name, hint, note) for name, hint in hints.items() for note in getattr(hint, "__metadata__", ())]
