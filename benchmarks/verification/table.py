"""The list of checks, and the table that is made of it."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass

_MODULES = ("impacts", "friction", "chains", "lattices", "modes", "bonded", "invariances", "twin", "cement")
_CROSS_CODE = "crosscode"
CHECKS: "list[Check]" = []


@dataclass(frozen=True, slots=True)
class Check:
    """One row of the table.

    Attributes
    ----------
    name
        What is checked; no other row has it.
    source
        Where the expected value comes from: a formula, a book, a DOI or a program.
    tolerance
        Largest error that passes.
    reason
        Why it is that large.
    measure
        Gives the measured error, as named in ``name`` or relative.
    quick
        Takes part in every run of the tests, too.
    program
        Other program that it needs; empty for none.
    """

    name: str
    source: str
    tolerance: float
    reason: str
    measure: Callable[[], float]
    quick: bool
    program: str


def check(
    name: str, *, source: str, tolerance: float, reason: str, quick: bool = False, program: str = ""
) -> Callable[[Callable[[], float]], Callable[[], float]]:
    """Put a function that gives an error on the list."""

    def register(measure: Callable[[], float]) -> Callable[[], float]:
        CHECKS.append(Check(name, source, tolerance, reason, measure, quick, program))
        return measure

    return register


def all_checks(*, cross_code: bool = True) -> list[Check]:
    """List of all checks, in the order of the table.

    The modules of those of other programs do not go together with those of the tests, hence the choice.
    """
    for module in (*_MODULES, *([_CROSS_CODE] if cross_code else [])):
        importlib.import_module(module)
    return CHECKS


def row_of(one: Check, error: str) -> str:
    """Line of the table."""
    return f"| {one.name} | {error} |"
