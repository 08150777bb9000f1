"""Writes the outcomes of a sweep into the store, counts the attempts and keeps the lease alive."""

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from threading import Lock
from typing import TypeVar

from calcidem.app.campaign.packing import Tell
from calcidem.app.campaign.workers import describe_unlike, group_workers
from calcidem.storage.errors import StoreLockedError
from calcidem.storage.records import AttemptCount, CellKey, CellResult, PackedResult, WorkerRecord
from calcidem.storage.sql.store import Store
from calcidem.sweep.batch import Batch, Cell
from calcidem.sweep.outcome import BatchOutcome

_RENEWAL_INTERVAL = 30.0
"""Seconds between two renewals of the lease; half of the interval that the store requires."""

_LOCK_PAUSE = 1.0
"""Seconds until the next attempt to lock; SQLite itself has waited half a minute before."""

_MOST_PATIENCE = 600.0
"""Longest wait for a lock of another process, s."""


T = TypeVar("T")


class StoreSink:
    """`calcidem.sweep.group_commit.Sink` that writes into a store.

    Parameters
    ----------
    store
        Store with the campaign chosen.
    keys
        Cells that will be computed.
    tell
        Takes sentences for the user.
    workers
        Descriptions of the workers; those of an executor are unknown before their first results.
    """

    def __init__(
        self,
        store: Store,
        keys: Sequence[CellKey],
        tell: Tell = lambda _: None,
        workers: Sequence[WorkerRecord] = (),
    ) -> None:
        self._store, self._tell, self._workers = store, tell, tuple(workers)
        self.busy = Lock()
        """Lock held while a thread uses the store."""
        self._next_renewal = time.monotonic() + _RENEWAL_INTERVAL
        self._counts = store.attempt_counts(keys) if keys else {}
        self._unplanned: deque[CellKey] = deque()

    @property
    def losses(self) -> dict[Cell, int]:
        """Number of workers lost so far while computing each cell."""
        return {(key.seed, key.content): count.losses for key, count in self._counts.items()}

    def plan(self, keys: Iterable[CellKey]) -> None:
        """Plan cells in the transaction of the next stored outcomes; does not wait."""
        self._unplanned.extend(keys)

    def store(self, outcomes: Sequence[BatchOutcome[Cell, PackedResult]], /) -> None:
        """Write new kinds of workers, and then the outcomes in one transaction."""
        self._note_workers(outcomes)
        new = [self._unplanned.popleft() for _ in range(len(self._unplanned))]
        if new:
            self._with_patience(lambda: self._store.plan(new))
        results = [result for outcome in outcomes for result in self._results(outcome)]
        self._with_patience(lambda: self._store.record_results(results))
        for result in results:
            losses = self._counts.get(result.key, AttemptCount()).losses
            self._counts[result.key] = AttemptCount(result.attempt, losses)

    def _note_workers(self, outcomes: Sequence[BatchOutcome[Cell, PackedResult]]) -> None:
        """Add new kinds of workers to the run, and warn if bits could depend on them."""
        known = {rank for worker in self._workers for rank in worker.ranks}
        new = {
            outcome.place.rank: replace(outcome.results[0].worker, ranks=(outcome.place.rank,))
            for outcome in outcomes
            if outcome.place.rank not in known and outcome.results and outcome.results[0].worker
        }
        if not new:
            return
        before, self._workers = describe_unlike(self._workers), group_workers((*self._workers, *new.values()))
        self._with_patience(lambda: self._store.note_workers(self._workers))
        if (unlike := describe_unlike(self._workers)) and not before:
            self._tell(unlike)

    def keep_alive(self) -> None:
        """Renew the lease if due, for other machines; storing outcomes also renews it."""
        if time.monotonic() > self._next_renewal and self.busy.acquire(blocking=False):
            try:
                self._next_renewal = time.monotonic() + _RENEWAL_INTERVAL
                with suppress(StoreLockedError):  # a process with the lock cannot take the lease meanwhile
                    self._store.renew_lease()
            finally:
                self.busy.release()

    def store_loss(self, batch: Batch[Cell], reason: str, /) -> None:
        """Count a lost attempt for each cell."""
        keys = [CellKey(*cell) for cell in batch.cells]
        self._counts |= self._with_patience(lambda: self._store.record_lost(keys, reason))

    def _with_patience(self, write: Callable[[], T]) -> T:
        """Write, and wait while another process has locked the database, so that no computed cell is lost.

        `StoreLockedError` if the lock remains for more than ten minutes.
        """
        deadline = time.monotonic() + _MOST_PATIENCE
        with self.busy:
            while True:
                try:
                    return write()
                except StoreLockedError as error:
                    if time.monotonic() > deadline:
                        raise
                    self._tell(f"Waiting for another process that has locked the database ({error.problem})")
                    time.sleep(_LOCK_PAUSE)

    def _results(self, outcome: BatchOutcome[Cell, PackedResult]) -> list[PackedResult]:
        found = list(outcome.results or ())
        if outcome.failure is not None:
            seconds = outcome.seconds / len(outcome.batch.cells)
            reason = f"{outcome.failure.message}\n{outcome.failure.traceback}".strip()
            keys = [CellKey(*cell) for cell in outcome.batch.cells]
            found = [CellResult(key, outcome.failure.kind, reason, seconds=seconds).packed() for key in keys]
        origin = {"rank": outcome.place.rank, "host": outcome.place.host}
        return [
            replace(
                result,
                columns=result.columns
                | origin
                | {"attempt": self._counts.get(result.key, AttemptCount()).attempts + 1},
            )
            for result in found
        ]
