"""Error of a velocity from its two parts, and the difference of the two velocities of a cell.

Each formula is written once, for numbers, arrays and columns of a database: its first argument is the square root.
"""

from collections.abc import Callable
from typing import Any

from calcidem.storage.records.quantity import Quantity

NORMAL_95 = 1.96
"""Half-width of the 95 % interval of a normal variable, in standard errors."""

_COVERED_95 = 1.5
"""Multiple of the expected numerical error within which 95.3 % of 253 random cells lay (docs/reading.md)."""

MOST_DEPARTURE = 2.0
"""`path_departure` above which a cell is marked."""

Root = Callable[[Any], Any]


def _numerical_error(_root: Root, expected_error: Any) -> Any:  # noqa: ANN401 - number, array or column
    """Standard error whose 95 % interval is that of the numerical errors."""
    return (_COVERED_95 / NORMAL_95) * expected_error


def _vs_error(root: Root, expected_error: Any, reading_error: Any) -> Any:  # noqa: ANN401 - as above
    """Total of two independent parts."""
    numerical = _numerical_error(root, expected_error)
    return root(numerical * numerical + reading_error * reading_error)


def _path_departure(root: Root, vs: Any, path_vs: Any, reading_error: Any, path_error: Any) -> Any:  # noqa: ANN401
    """Difference of two velocities over its standard error."""
    difference = (path_vs - vs) / vs
    variance = reading_error * reading_error + path_error * path_error + 1e-30  # finite for two exact velocities
    return root(difference * difference / variance)


DERIVED_QUANTITIES = (
    Quantity(
        *("1", "relative standard error of vs by the simulation", "error budget"),
        name="numerical_error",
        is_optional=True,
        needs=("expected_error",),
        formula=_numerical_error,
    ),
    Quantity(
        *("1", "relative standard error of vs by simulation and reading", "error budget"),
        name="vs_error",
        is_optional=True,
        needs=("expected_error", "reading_error"),
        formula=_vs_error,
    ),
    Quantity(
        *("1", "difference of path_vs and vs over its standard error", "error budget"),
        name="path_departure",
        is_optional=True,
        needs=("vs", "path_vs", "reading_error", "path_error"),
        formula=_path_departure,
    ),
)
"""Quantities that are not stored; each follows from stored ones, and is missing if one of these is."""


def departs(path_departure: Any) -> Any:  # noqa: ANN401 - number or array
    """Whether path_vs differs significantly from vs; False without path_vs (NaN)."""
    return path_departure > MOST_DEPARTURE
