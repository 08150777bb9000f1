"""Frozen dataclasses whose values pydantic checks as their annotations say, in Python as in a file.

The vocabulary is that of `annotated_types`: `Interval` and `Predicate` for bounds, `Unit` for units. A string in the
annotation describes the accepted values where bounds cannot. Numbers have to be finite without `pydantic.AllowInfNan`.
"""

import difflib
import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, wraps
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from annotated_types import Interval, Unit
from pydantic import BeforeValidator, TypeAdapter, ValidationError
from pydantic_core import ArgsKwargs

if TYPE_CHECKING:
    from _typeshed import DataclassInstance  # known to type checkers only

Settings = TypeVar("Settings", bound="DataclassInstance")

Positive = Annotated[float, Interval(gt=0.0)]
NotNegative = Annotated[float, Interval(ge=0.0)]
Part = Annotated[float, Interval(ge=0.0, le=1.0)]
PositivePart = Annotated[float, Interval(gt=0.0, le=1.0)]


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem of given values."""

    message: str
    """``field = value: problem; remedy``."""
    fields: tuple[str, ...] = ()
    """Fields that it concerns; the message begins with the first."""

    def within(self, place: str) -> "Problem":
        """Problem of a part of a larger whole, such as a section."""
        return Problem(f"{place}.{self.message}", tuple(f"{place}.{name}" for name in self.fields))


class FieldError(ValueError):
    """Refused values; the message has a sentence with field, value and remedy for each of the ``problems``."""

    def __init__(self, *problems: Problem) -> None:
        super().__init__(*problems)
        self.problems = problems

    def __str__(self) -> str:
        """All sentences."""
        return "\n".join(problem.message for problem in self.problems)


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
        raise FieldError(Problem(f"{name} = {value}: {cure}", (name, *others)))


def checked(kind: type[Settings]) -> type[Settings]:
    """Have each value of a dataclass checked against its annotation, before its `__post_init__`.

    Lists and arrays become tuples. A `FieldError` names all values that are refused.
    """
    kind.__pydantic_config__ = {"strict": True, "extra": "forbid", "allow_inf_nan": False}  # type: ignore[attr-defined]

    @cache  # made for the first instance, so that an import does not wait for it
    def adapter() -> TypeAdapter[Settings]:
        return TypeAdapter(kind)

    @wraps(kind.__init__)
    def initialise(self: Settings, /, *args: object, **named: object) -> None:
        hints = field_hints(kind)
        values = dict(zip(list(hints)[: len(args)], args, strict=True)) | named
        values = {name: _plain(value) for name, value in values.items()}
        try:
            adapter().validator.validate_python(ArgsKwargs((), values), self_instance=self)
        except ValidationError as error:
            raise FieldError(*_problems(hints, values, error)) from None

    kind.__init__ = initialise  # type: ignore[method-assign,assignment]
    return kind


def table_of(kind: type["DataclassInstance"]) -> BeforeValidator:
    """Annotation of a field that accepts a mapping in the place of an instance."""
    return BeforeValidator(lambda value: kind(**value) if isinstance(value, Mapping) else value)


def _plain(value: object) -> object:
    """A value with tuples instead of lists and arrays, and with numbers of Python."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(map(_plain, value)) if isinstance(value, list | tuple) else value


def _problems(hints: Mapping[str, Any], values: Mapping[str, object], error: ValidationError) -> Iterator[Problem]:
    """One problem for each refused value, and those that tables and combinations of values have."""
    seen = set()
    for detail in error.errors(include_url=False):
        name, cause = ".".join(map(str, detail["loc"][:1])), detail.get("ctx", {}).get("error")
        if isinstance(cause, FieldError):
            for inner in cause.problems:
                yield replace(whole := inner.within(name), fields=(*whole.fields, name)) if name else inner
        elif name not in hints:
            yield Problem(f"{name}: is unknown; {similar(name, hints)}", (name,))
        elif name not in values:
            yield Problem(f"{name}: is missing; add it", (name,))
        elif name not in seen:
            told = detail["msg"].removeprefix("Input should be ").replace("a valid boolean", "true or false")
            accepted = accepted_values(hints[name]) or told
            entry = next((f"entry {place + 1}: " for place in detail["loc"] if isinstance(place, int)), "")
            yield Problem(f"{name} = {quote(values[name])}: {entry}give {accepted}", (name,))
        seen.add(name)


def similar(name: str, known: Collection[str]) -> str:
    """Remedy for an unknown name: a known one that is written similarly, or all."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f'did you mean "{close[0]}"?' if close else f"there are {', '.join(known)}"


@cache
def field_hints(kind: type["DataclassInstance"]) -> dict[str, Any]:
    """Annotations of the fields of a class, with bounds and units."""
    return get_type_hints(kind, include_extras=True)


def accepted_values(hint: Any) -> str:  # noqa: ANN401 - a type hint has no type of its own
    """Values that an annotation accepts, worded to follow "give"; empty if it accepts all values of its type."""
    for note in _notes(hint):
        if isinstance(note, str):
            return note
    if get_origin(hint) is Literal:
        *first, last = map(quote, get_args(hint))
        return f"{', '.join(first)} or {last}"
    for bounds in _notes(hint):
        if isinstance(bounds, Interval):
            number = "whole number" if int in get_args(hint) else "number"
            low, high = (bounds.gt if bounds.ge is None else bounds.ge), (bounds.lt if bounds.le is None else bounds.le)
            if high is not None:
                opened, closed = "(" if bounds.ge is None else "[", ")" if bounds.le is None else "]"
                words = f"a {number} in {opened}{low:g}, {high:g}{closed}"
            else:
                words = f"a positive {number}" if bounds.gt == 0 else f"a {number} of {low:g} or more"
            return f"{words}, in {unit}" if (unit := unit_of(hint)) else words
    return ""


def unit_of(hint: Any) -> str:  # noqa: ANN401 - as above
    """Unit in an annotation; empty if there is none."""
    return next((note.unit for note in _notes(hint) if isinstance(note, Unit)), "")


def _notes(hint: Any) -> Iterator[object]:  # noqa: ANN401 - as above
    """All entries of an annotation except types: those of the whole first, then those of its parts."""
    yield from getattr(hint, "__metadata__", ())
    for inner in get_args(hint):
        yield from _notes(inner)


def quote(value: object) -> str:
    """Value as in `written`, cut if it is long."""
    text = written(value)
    return text if len(text) <= 200 else f"{text[:200]}..."


def written(value: object) -> str:
    """Value as written in a configuration: numbers with the fewest digits that are exact."""
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(written, value))}]"
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{name} = {written(inner)}' for name, inner in value.items())} }}"
    if isinstance(value, bool | str):
        return json.dumps(value, ensure_ascii=False)
    if not isinstance(value, float) or float(short := f"{value:g}") != value:
        return str(value)
    return short if set(short) & set(".en") else f"{short}.0"
