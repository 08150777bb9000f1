"""How a sweep puts its facts into words."""

from typing import Any

from calcidem.sweep.outcome import BatchOutcome, Place
from calcidem.sweep.sweep_end import SweepEnd


def duration(seconds: float | None) -> str:
    """Return a duration for a person: `42 s`, `7 min`, `3 h 20 min`, `2 d 4 h`, or `?` if it is unknown."""
    if seconds is None:
        return "?"
    if seconds < 100:  # noqa: PLR2004 - two digits are enough for a person
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 100:  # noqa: PLR2004 - as above
        return f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    if hours < 48:  # noqa: PLR2004 - two days
        return f"{hours} h {minutes:02d} min"
    days, hours = divmod(hours, 24)
    return f"{days} d {hours} h"


def failure_line(outcome: BatchOutcome[Any, Any]) -> str:
    """Return one line about a batch that failed."""
    if outcome.failure is None:
        raise ValueError(f"batch {outcome.batch.identifier} has not failed")
    cells = ", ".join(str(cell) for cell in outcome.batch.cells)
    place = outcome.place
    return f"{outcome.failure.kind}: {cells} on rank {place.rank} ({place.host}): {outcome.failure.message}"


def loss_line(place: Place, reason: str) -> str:
    """Return one line about a lost worker."""
    return f"lost rank {place.rank} ({place.host}): {reason}"


def end_line(end: SweepEnd) -> str:
    """Return one line about how a sweep ended."""
    tally = end.tally
    parts = [
        f"{end.state} after {duration(end.seconds)}",
        f"{tally.settled} cells settled",
        f"{tally.failed} failed" if tally.failed else "",
        f"{tally.timed_out} timed out" if tally.timed_out else "",
        f"{tally.quarantined} quarantined" if tally.quarantined else "",
        f"{count(tally.lost_workers, 'worker')} lost" if tally.lost_workers else "",
        end.detail,
    ]
    return ", ".join(part for part in parts if part)


def count(number: int, noun: str) -> str:
    """Return a number with its noun: `1 worker`, `2 workers`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
