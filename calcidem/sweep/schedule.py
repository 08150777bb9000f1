"""Decisions about the next batch and about each outcome, without communication."""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic

from calcidem.ends import CellStatus
from calcidem.sweep.batch import Batch, CellT
from calcidem.sweep.outcome import BatchOutcome, Failure, Place, ResultT

_LOSSES_BEFORE_SPLIT = 2
"""Number of lost workers after which a batch is split into single cells, to isolate the bad one."""

_LOSSES_BEFORE_QUARANTINE = 3
"""Number of lost workers after which a cell is not tried again."""


@dataclass(slots=True)
class Tally:
    """Counts of a sweep so far."""

    settled: int = 0
    """Number of cells with a final outcome of any kind."""
    failed: int = 0
    timed_out: int = 0
    quarantined: int = 0
    """Number of these cells without a result."""
    lost_workers: int = 0


@dataclass
class Schedule(Generic[CellT]):
    """Batches still to be handed out.

    Rules of parallel and serial runs:

    - Batches are handed out in the order given.
    - A batch of several cells that raised an exception is split, and its cells are computed next, one by one, so
      that only the bad cell fails. A batch that timed out is not split: its cells advance side by side, so each
      alone would take about as long.
    - A batch that lost its worker is handed out again after all others, so that a bad cell affects few of them;
      after `_LOSSES_BEFORE_SPLIT` losses as single cells.
    - A single cell with `_LOSSES_BEFORE_QUARANTINE` losses is quarantined.

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
        self._suspects: deque[Batch[CellT]] = deque()
        identifiers = {batch.identifier for batch in self._queue}
        if len(identifiers) != len(self._queue):
            raise ValueError("batches: two of them have the same identifier; number them from 0")
        self._next_identifier = max(identifiers, default=-1) + 1

    def __len__(self) -> int:
        """Return the number of waiting batches."""
        return len(self._queue) + len(self._suspects)

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
        for line in (self._queue, self._suspects):
            if line:
                return line.popleft()
        return None

    def settle(self, outcome: BatchOutcome[CellT, ResultT]) -> BatchOutcome[CellT, ResultT] | None:
        """Return an outcome if it is final, None if its cells are computed again."""
        cells = len(outcome.batch.cells)
        if outcome.failure is not None and outcome.failure.kind is CellStatus.FAILED and cells > 1:
            self._queue.extendleft(reversed(self._split(outcome.batch)))
            return None
        self.tally.settled += cells
        if outcome.failure is not None:
            if outcome.failure.kind is CellStatus.FAILED:
                self.tally.failed += cells
            elif outcome.failure.kind is CellStatus.TIMED_OUT:
                self.tally.timed_out += cells
        return outcome

    def lose(
        self, batch: Batch[CellT], reason: str, place: Place, seconds: float
    ) -> BatchOutcome[CellT, ResultT] | None:
        """Take back a batch whose worker was lost; return a final outcome if its only cell is quarantined.

        `batch.losses` already includes this loss.
        """
        if len(batch.cells) > 1:
            self._suspects.extend(self._split(batch) if batch.losses >= _LOSSES_BEFORE_SPLIT else (batch,))
            return None
        if batch.losses < _LOSSES_BEFORE_QUARANTINE:
            self._suspects.append(batch)
            return None
        self.tally.settled += 1
        self.tally.quarantined += 1
        message = f"took down {batch.losses} workers and is not tried again; the last one: {reason}"
        return BatchOutcome(batch, place, seconds, failure=Failure(CellStatus.QUARANTINED, message))

    def _split(self, batch: Batch[CellT]) -> tuple[Batch[CellT], ...]:
        parts = batch.split(self._next_identifier)
        self._next_identifier += len(parts)
        return parts
