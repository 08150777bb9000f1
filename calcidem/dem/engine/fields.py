"""Bounds and units of dataclass fields, declared in their annotations and checked from there.

The vocabulary is that of `annotated_types`, which pydantic also understands: `Interval` and `Predicate` for bounds,
`Unit` for units. A string in the annotation describes the accepted values where bounds cannot.
"""

import math
import operator
from collections.abc import Iterator
from dataclasses import is_dataclass
from functools import cache
from numbers import Real
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Interval, Predicate, Unit

if TYPE_CHECKING:
    from _typeshed import DataclassInstance  # known to type checkers only

Positive = Annotated[float, Interval(gt=0.0), Predicate(math.isfinite)]
NotNegative = Annotated[float, Interval(ge=0.0), Predicate(math.isfinite)]
Part = Annotated[float, Interval(ge=0.0, le=1.0)]
PositivePart = Annotated[float, Interval(gt=0.0, le=1.0)]


class FieldError(ValueError):
    """Refused values; the message names field, value and remedy.

    Attributes
    ----------
    fields
        Names of the fields that the rule concerns; the message begins with the first.
    """

    def __init__(self, message: str, *fields: str) -> None:
        super().__init__(message, *fields)
        self.fields = fields

    def __str__(self) -> str:
        """The message alone."""
        return str(self.args[0])


def require(condition: bool, name: str, value: object, cure: str, *others: str) -> None:
    """Raise a `FieldError` that names the field, its value and the remedy, unless the condition holds.

    Parameters
    ----------
    condition, name, value, cure
        Condition that must hold, and the parts of the message if it does not.
    others
        Further fields in the condition.
    """
    if not condition:
        raise FieldError(f"{name} = {value}: {cure}", name, *others)


def require_fields(owner: "DataclassInstance") -> None:
    """Raise a `FieldError` if an annotation does not accept its field's value."""
    for name, hint in field_hints(type(owner)).items():
        value = getattr(owner, name)
        require(_fits(hint, value), name, value, f"give {accepted_values(hint)}")


@cache
def field_hints(kind: type["DataclassInstance"]) -> dict[str, Any]:
    """Annotations of the fields of a class, with bounds and units."""
    return get_type_hints(kind, include_extras=True)


def accepted_values(hint: Any) -> str:  # noqa: ANN401 - a type hint has no type of its own
    """Values that an annotation accepts, worded to follow "give"; empty if it accepts all values of its type."""
    notes = tuple(_notes(hint))
    words = [note for note in notes if isinstance(note, str)]
    bounds = [note for note in notes if isinstance(note, Interval)]
    if not words and bounds:
        unit = unit_of(hint)
        words = [
            _in_words(bounds[0], "whole number" if int in get_args(hint) else "number") + (unit and f", in {unit}")
        ]
    if get_origin(hint) is Literal:
        *first, last = (f'"{choice}"' for choice in get_args(hint))
        words = [f"{', '.join(first)} or {last}"]
    return words[0] if words else ""


def unit_of(hint: Any) -> str:  # noqa: ANN401 - as above
    """Unit in an annotation; empty if there is none."""
    return next((note.unit for note in _notes(hint) if isinstance(note, Unit)), "")


def _notes(hint: Any) -> Iterator[object]:  # noqa: ANN401 - as above
    """All entries of an annotation except types: those of the whole first, then those of its parts."""
    yield from getattr(hint, "__metadata__", ())
    for inner in get_args(hint):
        yield from _notes(inner)


def _in_words(bounds: Interval, number: str) -> str:
    """Describe an interval."""
    low, high = (bounds.gt if bounds.ge is None else bounds.ge), (bounds.lt if bounds.le is None else bounds.le)
    if high is not None:
        return f"a {number} in {'(' if bounds.ge is None else '['}{low:g}, {high:g}{')' if bounds.le is None else ']'}"
    return f"a positive {number}" if bounds.gt == 0 else f"a {number} of {low:g} or more"


def _fits(hint: Any, value: object) -> bool:  # noqa: ANN401 - as above
    """Whether an annotation accepts a value; type checkers and pydantic check its type."""
    arguments = get_args(hint)
    match get_origin(hint):
        case origin if origin is Annotated:
            return _fits(arguments[0], value) and all(_meets(note, value) for note in hint.__metadata__)
        case origin if origin is Literal:
            return value in arguments
        case origin if origin in {Union, UnionType}:
            return any(_fits(arm, value) for arm in arguments)
        case origin if origin is tuple and isinstance(value, tuple):
            items = arguments[:1] * len(value) if ... in arguments else arguments
            return len(items) == len(value) and all(map(_fits, items, value))
    is_checked = isinstance(hint, type) and (hint is NoneType or is_dataclass(hint))
    return not is_checked or isinstance(value, hint)


def _meets(note: object, value: Any) -> bool:  # noqa: ANN401 - of any field
    """Whether a value satisfies one entry of an annotation."""
    if isinstance(note, Predicate):
        return bool(note.func(value))
    if not isinstance(note, Interval):
        return True
    ends = ((operator.gt, note.gt), (operator.ge, note.ge), (operator.lt, note.lt), (operator.le, note.le))
    return isinstance(value, Real) and all(end is None or compare(value, end) for compare, end in ends)
