"""Sentences for people: each is a record of the logger ``calcidem``, and a terminal is one of its handlers."""

import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

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
