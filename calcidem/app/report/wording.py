"""Numbers and tables as text for people; loads no library of analysis."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

from calcidem.analysis.intervals import Interval

ABSENT = "\N{EN DASH}"


EXCEPTIONAL = frozenset({"broken_bonds"})
"""Quantities that are not shown if they are zero."""


@dataclass(frozen=True, slots=True)
class Table:
    """Table of a report."""

    caption: str
    """Caption: contents of the table, and how to read it."""
    header: tuple[str, ...]
    """Name of each column; units in brackets."""
    rows: tuple[tuple[str, ...], ...]
    """Cells as text, each row as long as the header."""
    marked: frozenset[int] = frozenset()
    """Indices of rows that need attention."""

    @classmethod
    def of(cls, caption: str, rows: Sequence[Mapping[str, str]], marked: Iterable[int] = ()) -> Self:
        """Table of rows, at least one, by the names of the columns."""
        return cls(caption, tuple(rows[0]), tuple(tuple(row.values()) for row in rows), frozenset(marked))


def decimal(value: float | None, decimals: int = 0) -> str:
    """Return a number with a fixed number of decimals; a dash if missing."""
    if value is None or not math.isfinite(value):
        return ABSENT
    return f"{value:.{decimals}f}".replace("-", "\N{MINUS SIGN}")


def significant(value: float | None, digits: int = 3) -> str:
    """Return a number with some significant digits, large and small ones with a power of ten."""
    if value is None or not math.isfinite(value):
        return ABSENT
    rounded = float(f"{value:.{digits}g}")
    if rounded == 0 or 1e-3 <= abs(rounded) < 1e5:
        text = f"{rounded:.12f}".rstrip("0").rstrip(".")
    else:
        mantissa, _, exponent = f"{rounded:.{digits - 1}e}".partition("e")
        mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        power = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        text = f"{mantissa} \N{MULTIPLICATION SIGN} 10{power}"
    return text.replace("-", "\N{MINUS SIGN}")


def bounds(interval: Interval, decimals: int = 0) -> str:
    """Return both ends of an interval; a dash if undefined."""
    if not math.isfinite(interval.low):
        return ABSENT
    return f"{decimal(interval.low, decimals)} to {decimal(interval.high, decimals)}"


def with_bounds(value: float, interval: Interval, decimals: int = 0) -> str:
    """Return a value with its interval in brackets."""
    return f"{decimal(value, decimals)} ({bounds(interval, decimals)})"


def readable_unit(unit: str) -> str:
    """Return a UDUNITS string for people; empty for pure numbers."""
    return {"1": "", "percent": "%", "m s-1": "m/s"}.get(unit, unit)
