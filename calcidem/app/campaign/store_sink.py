"""Where the outcomes of a sweep go: the store, with the attempts counted and the lease kept alive."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any, TypeVar

from calcidem.app.campaign.packing import Tell
from calcidem.storage.errors import StoreLockedError
from calcidem.storage.records import AttemptCount, CellKey, CellResult, CellStatus, PackedResult
from calcidem.storage.sql.rows import pack_result
from calcidem.storage.sql.store import Store
from calcidem.sweep import Batch, BatchOutcome, Cell, Place, Progress, SweepEnd

_RENEWAL_INTERVAL = 30.0
"""Seconds between two renewals of the lease; half of what the store asks for."""

LOCK_PAUSE = 1.0
"""Seconds until a lock is asked for again; SQLite itself has waited for half a minute by then."""

MOST_PATIENCE = 600.0
"""Seconds for which a lock of another process is waited for."""


T = TypeVar("T")


class StoreSink:
    """`calcidem.sweep.Sink` that writes into a store.

    Parameters
    ----------
    store
        With the campaign chosen.
    keys
        The cells that will be computed.
    tell
        Takes sentences for the user.
    """

    def __init__(self, store: Store, keys: Sequence[CellKey], tell: Tell = lambda _: None) -> None:
        self._store, self._tell = store, tell
        self.busy = Lock()
        """Held while another thread than the master's uses the store."""
        self._counts = store.attempt_counts(keys) if keys else {}

    @property
    def losses(self) -> dict[Cell, int]:
        """Workers that each cell has taken down so far."""
        return {(key.seed, key.content): count.losses for key, count in self._counts.items()}

    def store(self, outcomes: Sequence[BatchOutcome[Cell, PackedResult]], /) -> None:
        """Write the outcomes in one transaction."""
        results = [result for outcome in outcomes for result in self._results(outcome)]
        self._with_patience(lambda: self._store.record_results(results))
        for result in results:
            losses = self._counts.get(result.key, AttemptCount()).losses
            self._counts[result.key] = AttemptCount(result.attempt, losses)

    def store_loss(self, batch: Batch[Cell], reason: str, /) -> None:
        """Count a lost attempt for each cell."""
        keys = [CellKey(*cell) for cell in batch.cells]
        self._counts |= self._with_patience(lambda: self._store.record_lost(keys, reason))

    def _with_patience(self, write: Callable[[], T]) -> T:
        """Write, and wait for another process that has locked the database: nothing that is computed is dropped.

        Raises
        ------
        StoreLockedError
            If it keeps the lock for more than ten minutes.
        """
        deadline = time.monotonic() + MOST_PATIENCE
        with self.busy:
            while True:
                try:
                    return write()
                except StoreLockedError as error:
                    if time.monotonic() > deadline:
                        raise
                    self._tell(f"Waiting for another process that has locked the database ({error.problem})")
                    time.sleep(LOCK_PAUSE)

    def _results(self, outcome: BatchOutcome[Cell, PackedResult]) -> list[PackedResult]:
        found = list(outcome.results or ())
        if outcome.failure is not None:
            status, seconds = CellStatus(outcome.failure.kind.value), outcome.seconds / len(outcome.batch.cells)
            reason = f"{outcome.failure.message}\n{outcome.failure.traceback}".strip()
            keys = [CellKey(*cell) for cell in outcome.batch.cells]
            found = [pack_result(CellResult(key, status, reason, seconds=seconds)) for key in keys]
        place = outcome.place
        return [
            replace(
                result,
                rank=place.rank,
                host=place.host,
                attempt=self._counts.get(result.key, AttemptCount()).attempts + 1,
            )
            for result in found
        ]


class LeaseKeeper:
    """Renews the lease of the master, for other machines that might want to take the campaign over.

    Parameters
    ----------
    store
        Whose lease this process holds.
    busy
        Held while another thread uses the store.
    """

    def __init__(self, store: Store, busy: Lock) -> None:
        self._store, self._busy = store, busy
        self._next = time.monotonic() + _RENEWAL_INTERVAL

    def __call__(self) -> None:
        """Renew the lease if it is time to; storing outcomes renews it as well."""
        if time.monotonic() > self._next and self._busy.acquire(blocking=False):
            try:
                self._next = time.monotonic() + _RENEWAL_INTERVAL
                with suppress(StoreLockedError):  # who has the lock can't take the lease either
                    self._store.renew_lease()
            finally:
                self._busy.release()


@dataclass(frozen=True, slots=True)
class HeartbeatProgress(Progress):
    """Progress display that keeps the lease alive, for other machines, and otherwise is the one it wraps.

    Attributes
    ----------
    shown
        The display that it wraps.
    lease_keeper
        What is kept alive.
    """

    shown: Progress
    lease_keeper: LeaseKeeper

    def on_start(self, batches: Sequence[Batch[Any]], workers: int) -> None:
        """Pass it on."""
        self.shown.on_start(batches, workers)

    def on_outcome(self, outcome: BatchOutcome[Any, Any]) -> None:
        """Pass it on."""
        self.shown.on_outcome(outcome)

    def on_loss(self, place: Place, reason: str) -> None:
        """Pass it on."""
        self.shown.on_loss(place, reason)

    def on_heartbeat(self, workers: int, running: int) -> None:
        """Renew the lease, and pass it on."""
        self.lease_keeper()
        self.shown.on_heartbeat(workers, running)

    def on_end(self, end: SweepEnd) -> None:
        """Pass it on."""
        self.shown.on_end(end)
