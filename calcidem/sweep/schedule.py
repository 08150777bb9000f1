"""Decisions about the next batch and about each outcome, without communication; end and progress of a sweep."""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Generic

from calcidem.ends import CellStatus
from calcidem.sweep.batch import Batch, BatchOutcome, CellT, ResultT

LOSSES_BEFORE_QUARANTINE = 3
"""Number of times that a run died while a cell was computed, after which the cell is not tried again."""


@dataclass(slots=True)
class Tally:
    """Counts of a sweep so far."""

    settled: int = 0
    """Number of cells with a final outcome of any kind."""
    failed: int = 0
    timed_out: int = 0
    quarantined: int = 0
    """Number of these cells without a result."""


@dataclass
class Schedule(Generic[CellT]):
    """Batches still to be handed out.

    Rules, the same for every executor:

    - Batches are handed out in the order given.
    - A batch of several cells that raised an exception or took down its workers is split, and its cells are computed
      next, one by one, so that only the bad cell fails. A batch that timed out is not split: its cells advance side by
      side, so each alone would take about as long.

    Raises
    ------
    ValueError
        If two batches have the same identifier.
    """

    batches: Sequence[Batch[CellT]]
    """Batches in the order of computation; the identifiers must differ."""
    tally: Tally = field(default_factory=Tally)

    def __post_init__(self) -> None:
        """Queue the batches."""
        self._queue: deque[Batch[CellT]] = deque(self.batches)
        identifiers = {batch.identifier for batch in self._queue}
        if len(identifiers) != len(self._queue):
            raise ValueError("batches: two of them have the same identifier; number them from 0")
        self._next_identifier = max(identifiers, default=-1) + 1

    def __len__(self) -> int:
        """Return the number of waiting batches."""
        return len(self._queue)

    def extend(self, batches: Iterable[Batch[CellT]]) -> tuple[Batch[CellT], ...]:
        """Queue further batches after the others; return them with their new numbers."""
        further = tuple(
            replace(batch, identifier=number) for number, batch in enumerate(batches, self._next_identifier)
        )
        self._queue.extend(further)
        self._next_identifier += len(further)
        return further

    def take(self) -> Batch[CellT] | None:
        """Remove and return the next batch, or None if there is none."""
        return self._queue.popleft() if self._queue else None

    def settle(self, outcome: BatchOutcome[CellT, ResultT]) -> BatchOutcome[CellT, ResultT] | None:
        """Return an outcome if it is final, None if its cells are computed again."""
        cells = len(outcome.batch.cells)
        kind = None if outcome.failure is None else outcome.failure.kind
        if kind in {CellStatus.FAILED, CellStatus.QUARANTINED} and cells > 1:
            parts = outcome.batch.split(self._next_identifier)
            self._next_identifier += len(parts)
            self._queue.extendleft(reversed(parts))
            return None
        self.tally.settled += cells
        if kind is not None:
            setattr(self.tally, kind.value, getattr(self.tally, kind.value) + cells)
        return outcome


EXIT_COMPLETE = 0
"""All cells have outcomes."""

EXIT_ERROR = 1
"""Error that the same command would meet again."""

EXIT_RESUMABLE = 75
"""Stopped early with all finished cells stored; the same command continues (EX_TEMPFAIL of sysexits.h)."""


class SweepError(Exception):
    """Base class of errors of a whole sweep."""


class LaunchError(SweepError):
    """The program was started in a manner that does not allow the requested run."""


class WorkersLostError(SweepError):
    """A worker died or hung before all cells were computed; computed cells are stored."""


class SweepState(StrEnum):
    """Reason for the end of a sweep."""

    COMPLETE = "complete"
    """Every batch has a final outcome."""
    STOPPED = "stopped"
    """A signal requested it."""
    CUT_OFF = "cut off"
    """A worker died or hangs."""
    ERROR = "error"
    """An error of the master, most likely while storing."""


@dataclass(frozen=True, slots=True)
class SweepEnd:
    """End of a sweep."""

    state: SweepState
    """Reason for the end."""
    detail: str = ""
    """One sentence for the user; may be empty."""
    tally: Tally = field(default_factory=Tally)
    """Numbers of cells."""
    seconds: float = 0.0
    """Wall time of the sweep in s."""

    @property
    def exit_code(self) -> int:
        """Exit code: 0 complete, 75 stopped but resumable, 1 error."""
        return {SweepState.COMPLETE: EXIT_COMPLETE, SweepState.ERROR: EXIT_ERROR}.get(self.state, EXIT_RESUMABLE)


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
