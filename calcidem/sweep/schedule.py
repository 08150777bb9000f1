"""Decisions about the next batch and about each outcome, without communication."""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic

from calcidem.ends import CellStatus
from calcidem.sweep.batch import Batch, CellT
from calcidem.sweep.outcome import BatchOutcome, ResultT

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
