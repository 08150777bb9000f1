"""Errors of a configuration, with messages that name section, field, value and remedy."""

import json
from dataclasses import dataclass

from pydantic_core import ErrorDetails

_BY_ERROR_TYPE = {
    "float_type": ("is not a number", "write for example 0.5"),
    "int_type": ("is not a whole number", "write for example 4"),
    "bool_type": ("is neither true nor false", "write one of the two, without quotes"),
    "string_type": ("is not a string", 'put it in quotes "..."'),
    "tuple_type": ("is not a list", "write for example [1.0, 2.0]"),
    "finite_number": ("is not finite", "give a number"),
    "literal_error": ("is not one of the choices", ""),
    "missing": ("has the wrong number of entries", ""),
    "missing_key": ("is missing", "add it"),
    "too_long": ("has the wrong number of entries", ""),
    "unexpected_keyword_argument": ("is not known", "leave it out"),
    "extra_forbidden": ("is not known", "leave it out"),
}
"""Cause, and a remedy if the field has none, for each kind of pydantic's errors."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem of a configuration."""

    message: str
    """``section.field = value: problem; remedy``."""
    fields: tuple[str, ...] = ()
    """Fields that it concerns, as ``section.field``."""


class ConfigurationError(ValueError):
    """A configuration that cannot be computed; the message lists all its problems.

    Attributes
    ----------
    source
        Origin of the configuration, such as a file name.
    problems
        All problems, at least one.
    """

    def __init__(self, source: str, problems: list[Problem]) -> None:
        count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
        lines = "".join(f"\n  {problem.message}" for problem in problems)
        super().__init__(f"{source}: {count}, nothing was computed{lines}")
        self.source = source
        self.problems = problems

    def __reduce__(self) -> tuple[type["ConfigurationError"], tuple[str, list[Problem]]]:
        """Pickle with both arguments."""
        return type(self), (self.source, self.problems)


_LONGEST_QUOTE = 200
_MOST_ENTRIES = 20


def quote(value: object) -> str:
    """Value as written in a file; long values are cut."""
    if isinstance(value, tuple | list):
        shown = ", ".join(quote(item) for item in value[:_MOST_ENTRIES])
        return f"[{shown}]" if len(value) <= _MOST_ENTRIES else f"[{shown}, ... {len(value)} entries]"
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {quote(item)}' for key, item in value.items())} }}"
    if isinstance(value, int) and value.bit_length() > _LONGEST_QUOTE:
        return f"a whole number of {value.bit_length()} bits"  # Python refuses to write long numbers in decimal
    text = json.dumps(value, ensure_ascii=False) if isinstance(value, str | bool) else repr(value)
    return text if len(text) <= _LONGEST_QUOTE else f"{text[:_LONGEST_QUOTE]}..."


def phrase(error: ErrorDetails, accepted: str = "") -> str:
    """Problem and remedy of one of ``ValidationError.errors()``, in words; see `fields.accepted_values`."""
    lacks_key = error["type"] == "missing" and isinstance(error["loc"][-1], str)  # not an entry of a list
    kind = "missing_key" if lacks_key else error["type"]
    what, cure = _BY_ERROR_TYPE.get(kind, ("" if accepted else error["msg"], ""))
    entry = next((f"entry {word + 1} " for word in error["loc"] if isinstance(word, int)), "") if what else ""
    return "; ".join(filter(None, (entry + what, f"give {accepted}" if accepted else cure)))
