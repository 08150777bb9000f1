"""Progress of a running sweep, and texts for durations and numbers."""

from collections.abc import Sequence
from typing import Any

from calcidem.sweep.batch import Batch
from calcidem.sweep.outcome import BatchOutcome
from calcidem.sweep.sweep_end import SweepEnd


class Progress:
    """Receiver of the progress of a sweep, on rank 0 only; this base class shows nothing."""

    def on_start(self, batches: Sequence[Batch[Any]], workers: int) -> None:
        """Receive the batches of the sweep and the number of workers, before the first is handed out."""

    def on_outcome(self, outcome: BatchOutcome[Any, Any]) -> None:
        """Receive a stored outcome."""

    def on_heartbeat(self) -> None:
        """Called twice a second during the sweep."""

    def on_end(self, end: SweepEnd) -> None:
        """Receive the end of the sweep."""


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


def pluralize(number: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun: `1 worker`, `2 workers`."""
    return f"{number} {noun}" if number == 1 else f"{number} {plural or f'{noun}s'}"
