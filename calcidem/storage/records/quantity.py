"""The notes from which the catalogue of quantities is made: they stand in the annotations of the frozen records.

A field of a record that is one number or text of a cell is annotated with a `Quantity`, a field that is an array with
`Along`. Tables, checks, filters, files and the page of reference are made from these notes, so a stored quantity is
added by a field here, and by a value where the record is made.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from types import NoneType
from typing import Any, Literal, get_args, get_type_hints


class Bound(StrEnum):
    """What numbers a quantity may be, besides being finite; the value is the cure for the others."""

    POSITIVE = "give a positive number, or None if there is none"
    NOT_NEGATIVE = "give a number of 0 or more, or None"
    NONE = ""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number or a text that each cell has, or lacks."""

    unit: str
    """UDUNITS string; empty for text."""
    meaning: str
    """Long name in files and tables."""
    origin: str = "campaign"
    """What it comes from, such as ``"reading"``."""
    bound: Bound = Bound.NONE
    is_exact: bool = False
    """Whether it is equal, to the last bit, wherever the same campaign is computed."""
    is_needed: bool = False
    """Whether a done cell must have it."""
    is_brief: bool = False
    """Whether it is one of the few that status and velocities need: they have a checksum of their own."""
    name: str = ""
    kind: Literal["real", "whole", "text"] = "real"
    is_optional: bool = False
    """Of the field and its type; filled in by `quantities_of`."""
    needs: tuple[str, ...] = ()
    """Stored quantities that it is derived from; empty for a stored one."""
    formula: Callable[..., Any] | None = None
    """Gives its value from a square root and the values of these, be they numbers, arrays or columns of a database."""


@dataclass(frozen=True, slots=True)
class Along:
    """An array with one row for each element of a dimension, whose length differs from cell to cell."""

    dimension: str
    unit: str
    """UDUNITS string."""
    meaning: str
    """Long name in files."""
    columns: str = ""
    """Dimension of its columns, if their number differs from cell to cell, too; empty if it does not."""

    @property
    def elements(self) -> str:
        """Dimension along which files have it: row after row where its columns have a dimension."""
        return f"{self.dimension}_{self.columns}" if self.columns else self.dimension


def quantities_of(record: type) -> tuple[Quantity, ...]:
    """Return the quantities of a record class, in the order of its fields."""
    return _quantities_of(record)


@cache
def _quantities_of(record: type) -> tuple[Quantity, ...]:
    return tuple(
        replace(note, name=name, kind=_kind_of(hint), is_optional=NoneType in get_args(get_args(hint)[0]))
        for name, hint, note in _annotated_fields(record)
        if isinstance(note, Quantity)
    )


def array_fields(record: type) -> dict[str, Along]:
    """Return the arrays of a record class, by name."""
    return {name: note for name, _, note in _annotated_fields(record) if isinstance(note, Along)}


def _annotated_fields(record: type) -> list[tuple[str, Any, Any]]:
    hints = get_type_hints(record, include_extras=True)
    return [(name, hint, note) for name, hint in hints.items() for note in getattr(hint, "__metadata__", ())]


def _kind_of(hint: Any) -> Literal["real", "whole", "text"]:  # noqa: ANN401 - a type hint
    plain = get_args(hint)[0]
    (kind,) = {choice for choice in get_args(plain) or (plain,) if choice is not NoneType}
    return "text" if issubclass(kind, str) else "whole" if issubclass(kind, int) else "real"


def check_bounds(record: object) -> None:
    """Refuse numbers out of the bounds of their quantities; `ValueError`, naming the field, the value and the cure."""
    for quantity in quantities_of(type(record)):
        if quantity.bound is not Bound.NONE:
            value = getattr(record, quantity.name)
            if value is not None and (value < 0 or (value == 0 and quantity.bound is Bound.POSITIVE)):
                raise ValueError(f"{type(record).__name__}.{quantity.name} is {value}; {quantity.bound}.")
