"""Text for people: numbers, counts and durations, and sentences; loads no library.

A sentence is a record of the logger ``calcidem``, and a terminal is one of its handlers.
"""

import logging
import math
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import IO

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


def first_of(texts: Sequence[str]) -> list[str]:
    """Return the first ten of some texts, followed by how many more there are."""
    more = len(texts) - 10
    return [*texts[:10], f"and {more} more"] if more > 0 else list(texts)


def pluralize(count: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun: `1 worker`, `2 workers`."""
    return f"{count} {noun}" if count == 1 else f"{count} {plural or f'{noun}s'}"


_ESCAPES = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) not in "\n\t"}
"""Control characters (Unicode category Cc, ECMA-48), which move the cursor, colour, or make a terminal respond."""

_LOGGER = logging.getLogger("calcidem")
_LOGGER.addHandler(logging.NullHandler())  # otherwise Python would write advice a second time


class CampaignWarning(UserWarning):
    """Advice about a campaign, such as a wave that its grains scatter. It is also in `Campaign.notes`."""


def tell(text: str, level: int = logging.INFO) -> None:
    """Log a sentence; at level ERROR a quiet command writes it, too."""
    _LOGGER.log(level, "%s", text)


def advise(text: str) -> None:
    """Log advice, level WARNING, and warn with a `CampaignWarning`."""
    _LOGGER.warning("%s", text)
    warnings.warn(text, CampaignWarning, stacklevel=3)


class _Listener(logging.Handler):
    """Passes sentences on to a function."""

    def __init__(self, write: Callable[[str], object], *, with_advice: bool) -> None:
        super().__init__()
        self._write, self._with_advice, self._advice = write, with_advice, set[str]()

    def emit(self, record: logging.LogRecord) -> None:
        """Pass it on, the same advice once; an error of the function is that of the sender, as of any output."""
        told = record.getMessage()
        if record.levelno != logging.WARNING:
            self._write(told)
        elif self._with_advice and told not in self._advice:
            self._advice.add(told)
            self._write(f"Warning: {told}")


@contextmanager
def listening(write: Callable[[str], object], *, with_advice: bool = True, least: int = logging.INFO) -> Iterator[None]:
    """Let a function of the terminal receive the sentences, within this context instead of that of an outer one.

    Without advice where Python writes its warnings, and without what is below the ``least`` level.
    """
    outer, level = [one for one in _LOGGER.handlers if isinstance(one, _Listener)], _LOGGER.level
    inner = _Listener(write, with_advice=with_advice)
    inner.setLevel(least)
    _LOGGER.handlers = [inner, *(one for one in _LOGGER.handlers if one not in outer)]
    _LOGGER.setLevel(min(_LOGGER.getEffectiveLevel(), logging.INFO))
    try:
        yield
    finally:
        _LOGGER.handlers = [*outer, *(one for one in _LOGGER.handlers if one is not inner)]
        _LOGGER.setLevel(level)


def printable(text: object) -> str:
    """Text with control characters, except line feed and tab, as escapes, so that it cannot control a terminal."""
    return str(text).translate(_ESCAPES)


def send_nowhere(stream: IO[str]) -> None:
    """Let what is written to a stream without a reader go nowhere."""
    with suppress(OSError, ValueError):  # a stream without a file has no reader
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
