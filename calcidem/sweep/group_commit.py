"""Outcomes are stored in groups, beside the exchange of messages: no worker waits for the disk."""

import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from types import TracebackType
from typing import Any, Generic, Protocol, Self

from calcidem.sweep.batch import Batch, CellT
from calcidem.sweep.outcome import BatchOutcome
from calcidem.sweep.progress import Progress

_INTERVAL = 0.1
"""Seconds between the beginnings of two groups: a transaction costs as much as the rows of two or three batches."""

_MOST_WAITING = 512
"""Outcomes that may wait for the store before no more batches are handed out; some 200 kB each."""


class Sink(Protocol):
    """Receiver of the outcomes of a sweep, given by its caller; its storing methods run on one thread of their own.

    An outcome is acknowledged once `store` has returned, so it must be on disk by then. A sweep that was
    killed may have stored a batch that it computes again later: storing twice must equal storing once.
    An exception of the sink ends the sweep and is passed on.
    """

    def store(self, outcomes: Sequence[BatchOutcome[Any, Any]], /) -> None:
        """Keep final outcomes, one or several."""

    def store_loss(self, batch: Batch[Any], reason: str, /) -> None:
        """Store that a worker was lost over a batch; `batch.losses` counts this loss already.

        To be given back as `losses` when the same cells are planned again after a restart.
        """

    def keep_alive(self) -> None:
        """Called on the main thread twice a second while the sweep runs; returns at once."""


class GroupCommit(Generic[CellT]):
    """Stores final outcomes on a thread of its own, in the order given, and acknowledges them once they are stored.

    While a group is stored the next one gathers. As a context manager it stores the remaining outcomes on exit,
    unless the sink has failed. The display receives stored outcomes only.
    """

    def __init__(self, sink: Sink, progress: Progress) -> None:
        self._sink, self._progress = sink, progress
        self._thread = ThreadPoolExecutor(1, "store")
        self._waiting: list[BatchOutcome[CellT, Any]] = []
        self._groups: deque[tuple[Future[None], list[BatchOutcome[CellT, Any]]]] = deque()
        self._next_begin = 0.0

    @property
    def is_full(self) -> bool:
        """Whether too many outcomes wait to hand out more batches."""
        return len(self._waiting) > _MOST_WAITING

    def add(self, *outcomes: BatchOutcome[CellT, Any]) -> None:
        """Queue outcomes, which are stored soon in a group."""
        self._waiting.extend(outcomes)

    def add_loss(self, batch: Batch[CellT], reason: str) -> None:
        """Queue the loss of a worker, after all outcomes so far."""
        self._begin()
        self._groups.append((self._thread.submit(self._sink.store_loss, batch, reason), []))

    def advance(self) -> None:
        """Acknowledge stored outcomes, and begin the next group if it is due; does not wait.

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
        """Return once all is stored and acknowledged; raises what `advance` does."""
        self._begin()
        while self._groups:
            self._acknowledge()

    def _begin(self) -> None:
        """Let the thread store the waiting outcomes after the group before."""
        if self._waiting:
            self._next_begin = time.monotonic() + _INTERVAL
            group, self._waiting = self._waiting, []
            self._groups.append((self._thread.submit(self._sink.store, group), group))

    def _acknowledge(self) -> None:
        """Wait for the oldest group, and show its outcomes."""
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
