"""Writes the outcomes of a sweep into the store, counts the attempts and keeps the lease alive."""

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from threading import Lock
from typing import TypeVar

from calcidem.app.campaign.notices import tell
from calcidem.ends import DECIDED_BY_PHYSICS
from calcidem.storage.errors import StoreLockedError
from calcidem.storage.records import AttemptCount, CellKey, CellResult, PackedResult
from calcidem.storage.sql.store import Store
from calcidem.storage.store import Selection
from calcidem.sweep.batch import Batch, BatchOutcome, Cell

T = TypeVar("T")


class StoreSink:
    """`calcidem.sweep.group_commit.Sink` that writes into a store.

    Parameters
    ----------
    store
        Store with the campaign chosen.
    keys
        Cells that will be computed.
    """

    def __init__(self, store: Store, keys: Sequence[CellKey]) -> None:
        self._store = store
        self.busy = Lock()
        """Lock held while a thread uses the store."""
        self.patience = 600.0
        """Longest wait for a lock of another process, s."""
        self._next_renewal = 0.0
        self._counts = store.attempt_counts(keys) if keys else {}
        self._bare = [key for key in keys if key.content == 0.0]
        self._running: set[CellKey] = set()
        self._unplanned: deque[CellKey] = deque()

    @property
    def losses(self) -> dict[Cell, int]:
        """Number of earlier runs that died while each cell was computed."""
        return {(key.seed, key.content): count.losses for key, count in self._counts.items()}

    def plan(self, keys: Iterable[CellKey]) -> None:
        """Plan cells in the transaction of the next stored outcomes; does not wait."""
        self._unplanned.extend(keys)

    def repeat_stored(self) -> set[CellKey]:
        """Store cells without cement as an earlier run computed their common sample; return them."""
        if self._bare:
            done = Selection(contents=0.0, statuses=DECIDED_BY_PHYSICS)
            computed = next(self._store.results(done, with_arrays=True), None)
            repeated = [] if computed is None else self._repetitions(computed.packed())
            self._store.record_results(repeated)
            return {result.key for result in repeated}
        return set()

    def mark(self, batches: Sequence[Batch[Cell]], /) -> None:
        """Begin an attempt for each cell of these batches; a batch that is computed again is marked already."""
        self._plan_further()
        keys = [key for batch in batches for cell in batch.cells if (key := CellKey(*cell)) not in self._running]
        self._counts |= self._with_patience(lambda: self._store.record_running(keys))
        self._running.update(keys)

    def store(self, outcomes: Sequence[BatchOutcome[Cell, PackedResult]], /) -> None:
        """Write the outcomes in one transaction."""
        self._plan_further()
        results = [result for outcome in outcomes for result in self._results(outcome)]
        self._with_patience(lambda: self._store.record_results(results))
        for result in results:
            losses = self._counts.get(result.key, AttemptCount()).losses
            self._counts[result.key] = AttemptCount(result.attempt, losses)
            self._running.discard(result.key)

    def keep_alive(self) -> None:
        """Renew the lease if due, for other machines; storing outcomes also renews it."""
        if time.monotonic() > self._next_renewal and self.busy.acquire(blocking=False):
            try:
                self._next_renewal = time.monotonic() + 30.0  # s, half of the interval that the store requires
                with suppress(StoreLockedError):  # a process with the lock cannot take the lease meanwhile
                    self._store.renew_lease()
            finally:
                self.busy.release()

    def _plan_further(self) -> None:
        if new := [self._unplanned.popleft() for _ in range(len(self._unplanned))]:
            self._with_patience(lambda: self._store.plan(new))

    def _with_patience(self, write: Callable[[], T]) -> T:
        """Write, and wait while another process has locked the database, so that no computed cell is lost.

        `StoreLockedError` if the lock remains for longer than `patience`.
        """
        deadline = time.monotonic() + self.patience
        with self.busy:
            while True:
                try:
                    return write()
                except StoreLockedError as error:  # after half a minute in which SQLite itself has waited
                    if time.monotonic() > deadline:
                        raise
                    tell(f"Waiting for another process that has locked the database ({error.problem})")
                    time.sleep(1.0)

    def _results(self, outcome: BatchOutcome[Cell, PackedResult]) -> list[PackedResult]:
        found = list(outcome.results or ())
        if outcome.failure is not None:
            seconds = outcome.seconds / len(outcome.batch.cells)
            reason = f"{outcome.failure.message}\n{outcome.failure.traceback}".strip()
            keys = [CellKey(*cell) for cell in outcome.batch.cells]
            found = [CellResult(key, outcome.failure.kind, reason, seconds=seconds).packed() for key in keys]
        origin = {"rank": outcome.rank, "host": outcome.host}
        found = [
            replace(result, columns=result.columns | origin | {"attempt": self._attempt_of(result.key)})
            for result in found
        ]
        return found + [
            repeated for result in found if result.key.content == 0.0 for repeated in self._repetitions(result)
        ]

    def _repetitions(self, computed: PackedResult) -> list[PackedResult]:
        """Outcome of a sample without cement for the other seeds to be stored, which are the same sample.

        They have no computing time, rank or host, and a velocity with the reason that it is that of another seed.
        """
        told = (
            computed.columns["reason"]
            or f"without cement all seeds are one sample, computed as seed {computed.key.seed}"
        )
        changed = {"reason": told, "seconds": None, "rank": None, "host": None}
        return [
            replace(computed, key=key, columns=computed.columns | changed | {"attempt": self._attempt_of(key)})
            for key in self._bare
            if key != computed.key
        ]

    def _attempt_of(self, key: CellKey) -> int:
        """Number of the attempt that gave an outcome: of the one that was marked, or the next."""
        return self._counts.get(key, AttemptCount()).attempts + (key not in self._running)
