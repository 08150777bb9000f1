"""Numbers, counts and durations as text for people; loads no library."""

import math
from collections.abc import Sequence

ABSENT = "\N{EN DASH}"


EXCEPTIONAL = frozenset({"broken_bonds"})
"""Quantities that are not shown if they are zero."""


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


def readable_unit(unit: str) -> str:
    """Return a UDUNITS string for people; empty for pure numbers."""
    return {"1": "", "percent": "%", "m s-1": "m/s"}.get(unit, unit)


def number(value: float | None, form: str = ".1f") -> str:
    """Write a number in a format, or a hyphen for a missing one (None or not finite); for a terminal."""
    return "-" if value is None or not math.isfinite(value) else format(value, form)


def duration(seconds: float | None) -> str:
    """Return a duration as text: `42 s`, `7 min`, `3 h 20 min`, `2 d 4 h`, or `?` if it is unknown."""
    if seconds is None:
        return "?"
    if seconds < 100:  # two digits are enough for a person
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 100:  # as above
        return f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    if hours < 48:  # two days
        return f"{hours} h {minutes:02d} min"
    days, hours = divmod(hours, 24)
    return f"{days} d {hours} h"


def first_of(texts: Sequence[str], most: int = 10) -> list[str]:
    """Return the first of some texts, followed by how many more there are."""
    more = len(texts) - most
    return [*texts[:most], f"and {more} more"] if more > 0 else list(texts)


def pluralize(count: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun: `1 worker`, `2 workers`."""
    return f"{count} {noun}" if count == 1 else f"{count} {plural or f'{noun}s'}"
