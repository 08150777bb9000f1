"""Outcomes are stored in groups by a separate thread, so that no worker waits for the disk."""

import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from types import TracebackType
from typing import Any, Generic, Protocol, Self

from calcidem.sweep.batch import Batch, BatchOutcome, CellT
from calcidem.sweep.schedule import Progress


class Sink(Protocol):
    """Receiver of the outcomes of a sweep, given by its caller; its storing methods run on a separate thread.

    An outcome counts as stored once `store` has returned, so it must be on disk by then. After a kill a stored batch
    may be computed again, so storing twice must have the same effect as storing once. An exception of the sink ends the
    sweep and is raised again.
    """

    def store(self, outcomes: Sequence[BatchOutcome[Any, Any]], /) -> None:
        """Store one or several final outcomes."""

    def mark(self, batches: Sequence[Batch[Any]], /) -> None:
        """Store that these batches are being computed.

        A mark without an outcome tells the next run that this one died meanwhile; it counts for `Batch.losses`.
        """

    def keep_alive(self) -> None:
        """Called on the main thread twice a second during the sweep; returns at once."""


class GroupCommit(Generic[CellT]):
    """Stores marks and final outcomes on a separate thread, in the order given, and shows outcomes once stored.

    Outcomes that arrive while a group is stored form the next group. As a context manager it stores the remaining
    outcomes on exit, unless the sink has failed. The display receives only stored outcomes.
    """

    def __init__(self, sink: Sink, progress: Progress) -> None:
        self._sink, self._progress = sink, progress
        self._thread = ThreadPoolExecutor(1, "store")
        self._marks: list[Batch[CellT]] = []
        self._waiting: list[BatchOutcome[CellT, Any]] = []
        self._groups: deque[tuple[Future[None], list[BatchOutcome[CellT, Any]]]] = deque()
        self._next_begin = 0.0

    @property
    def is_full(self) -> bool:
        """Whether so many outcomes wait, some 200 kB each, that no more batches should be handed out."""
        return len(self._waiting) > 512

    def add(self, *outcomes: BatchOutcome[CellT, Any]) -> None:
        """Queue outcomes for the next group."""
        self._waiting.extend(outcomes)

    def mark(self, *batches: Batch[CellT]) -> None:
        """Queue marks of batches that are being computed for the next group."""
        self._marks.extend(batches)

    def advance(self) -> None:
        """Show stored outcomes, and begin the next group if it is due; does not wait.

        Raises
        ------
        Exception
            Any exception of the sink; the waiting outcomes are dropped.
        """
        while self._groups and self._groups[0][0].done():
            self._acknowledge()
        if not self._groups and time.monotonic() >= self._next_begin:
            self._begin()

    def flush(self) -> None:
        """Return once all is stored and shown; raises the exceptions of `advance`."""
        self._begin()
        while self._groups:
            self._acknowledge()

    def _begin(self) -> None:
        """Let the thread store marks and waiting outcomes after the previous group."""
        if self._waiting or self._marks:
            self._next_begin = (
                time.monotonic() + 0.1
            )  # s; a transaction costs as much as the rows of two or three batches
            group, self._waiting = self._waiting, []
            marks, self._marks = self._marks, []
            self._groups.append((self._thread.submit(_store_all, self._sink, marks, group), group))

    def _acknowledge(self) -> None:
        """Wait for the oldest group; show its outcomes."""
        stored, group = self._groups.popleft()
        try:
            stored.result()
        except BaseException:
            self._waiting.clear()
            self._groups.clear()
            self._thread.shutdown(wait=False, cancel_futures=True)
            raise
        for outcome in group:
            self._progress.on_outcome(outcome)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Store the waiting outcomes; a pending error is raised first."""
        with self._thread, suppress(*(() if error is None else (Exception,))):
            self.flush()


def _store_all(sink: Sink, marks: Sequence[Batch[Any]], outcomes: Sequence[BatchOutcome[Any, Any]]) -> None:
    """Store marks before outcomes, which complete them."""
    if marks:
        sink.mark(marks)
    if outcomes:
        sink.store(outcomes)
