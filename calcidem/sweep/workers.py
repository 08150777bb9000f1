"""Workers of `concurrent.futures`, or this process, that compute batches; a worker that is silent too long is given up.

An executor does not report the number or names of its workers. So each outcome names its worker, and more batches are
submitted than there are known workers. A new worker computes one of these and counts from its first outcome.

The computation, with the packing, is pickled once and sent with the first batches. A process keeps it by its hash. A
process that lacks it reports this, and the batch is submitted again with the computation.
"""

import multiprocessing
import os
import pickle
import platform
import threading
import time
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from queue import Empty, SimpleQueue
from typing import Any, Generic, TypeAlias

from calcidem.ends import CellStatus
from calcidem.sweep.ranks import available_cores, end_after, own_rank
from calcidem.sweep.schedule import (
    EXIT_RESUMABLE,
    Batch,
    BatchOutcome,
    CellT,
    Compute,
    Failure,
    SweepError,
    SweepInterrupted,
    attempt,
)

_Identity: TypeAlias = tuple[str, int, int, int | None]
"""Host, process, thread and MPI rank (None without MPI)."""


class ThisProcess(Executor):
    """Executor that computes in the calling thread: `submit` returns a finished future."""

    num_workers = 1

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":  # noqa: ANN401 - as in the base class
        """Call the function at once."""
        future: Future[Any] = Future()
        future.set_running_or_notify_cancel()
        try:
            future.set_result(function(*args, **kwargs))
        except SweepInterrupted as interrupt:
            future.set_exception(interrupt)
        return future


@dataclass(slots=True)
class _Flight(Generic[CellT]):
    """A batch in flight."""

    batch: Batch[CellT]
    patience: float
    """Seconds after its begin at which the worker counts as hanging."""
    is_first: bool
    """Whether no worker had answered when it was submitted, so that its worker may have to load its libraries."""
    is_marked: bool = False
    """Whether its mark was stored before it was submitted."""
    begun: float | None = None
    """Time of its begin as far as the executor tells, s on the monotonic clock."""


class Workers(Generic[CellT]):
    """Workers of an executor, which stays open.

    A process that dies ends its executor (`ProcessPoolExecutor`). Then `exhausted` says why, and the sweep ends; the
    same command continues. Under MPI it ends the whole job: rank 0 gets a SIGTERM, see `StopRequest.has_lost`. Dask
    alone goes on: it tries a batch on four workers before it raises `KilledWorker`. The computation must be picklable
    unless `ThisProcess` is the executor.

    Parameters
    ----------
    time_limit
        Seconds for a batch. Its own check ends it there; a worker that does not answer for three times as long hangs.
        A pool of one process calls two more batches running, which wait for the first.
    silence_floor
        Without a time limit a worker hangs after 20 times the slowest batch so far, scaled by cost, but not before
        these seconds. The first one has as long in addition to load its libraries and to compile, the others 10 times
        as long as the first took.

    Attributes
    ----------
    exhausted
        Reason why no more batches can be computed; else empty.
    last_dropped
        Time at which a worker was known to have dropped a batch because of a signal; None if none has.
    """

    def __init__(
        self, executor: Executor, compute: Compute[CellT, Any], time_limit: float | None, silence_floor: float
    ) -> None:
        self._executor, self._time_limit, self._silence_floor = executor, time_limit, silence_floor
        pickled = b"" if self.are_here else pickle.dumps(compute, pickle.HIGHEST_PROTOCOL)
        self._computation, self._key = pickled or compute, sha256(pickled).hexdigest()
        self._in_flight: dict[Future[bytes], _Flight[CellT]] = {}
        self._lost: list[Batch[CellT]] = []  # whose processes died before they were seen to begin
        self._done: SimpleQueue[Future[bytes]] = SimpleQueue()
        self._rank_of: dict[_Identity, int] = {}
        self._last_answer: dict[_Identity, float] = {}
        self._last_event = time.monotonic()  # a submission or an answer
        self._next_look = 0.0
        self._loading = silence_floor  # seconds that a worker may need in addition for its first batch
        self._slowest = 0.0  # seconds for a unit of cost
        self._longest = 0.0  # seconds of a batch
        self._tells_begin = False  # a future of Dask never says that it runs, and one that does can be cancelled
        self._finishing: list[Future[bytes]] | None = None  # what may run of such an executor
        self.exhausted = ""
        self.last_dropped: float | None = None

    @property
    def are_here(self) -> bool:
        """Whether this process computes, during `submit`."""
        return isinstance(self._executor, ThisProcess)

    @property
    def count(self) -> int:
        """Number of workers: as the executor tells, else those with an outcome in the last minute or so."""
        if self._told_count:
            return self._told_count
        oldest = time.monotonic() - max(60.0, 10.0 * self._longest)
        return sum(answer > oldest for answer in self._last_answer.values())

    @property
    def _told_count(self) -> int:
        """Number of workers as the executor tells; 0 if it does not."""
        return int(getattr(self._executor, "num_workers", None) or getattr(self._executor, "_max_workers", None) or 0)

    @property
    def running(self) -> int:
        """Number of batches submitted."""
        return len(self._in_flight)

    @property
    def wants_batch(self) -> bool:
        """Whether fewer batches are submitted than two for each worker and some for workers that may join."""
        if self.exhausted:
            return False
        if self.are_here:
            return not self._in_flight
        if any(flight.batch.is_alone for flight in self._in_flight.values()):
            return False
        return len(self._in_flight) < 2 * (self.count or available_cores()) + 2

    def submit(self, batch: Batch[CellT], *, is_marked: bool = False) -> None:
        """Submit a batch, whose mark may have been stored already."""
        self._submit(batch, with_computation=not self._rank_of, is_marked=is_marked)

    def begun(self) -> list[Batch[CellT]]:
        """Batches, not marked yet, whose computation has begun since the last call, as far as the executor tells."""
        now, found, self._lost = time.monotonic(), self._lost, []
        for future, flight in self._in_flight.items():
            # An executor that is gone has not told what ran.
            is_gone = future.done() and (future.cancelled() or isinstance(future.exception(), CancelledError | OSError))
            if flight.begun is None and (future.running() or (future.done() and not is_gone)):
                flight.begun = now
                self._tells_begin |= future.running()
                if not flight.is_marked:
                    found.append(flight.batch)
        return found

    def poll(self, wait: float) -> list[BatchOutcome[CellT, Any]]:
        """Receive outcomes; wait for the first one up to some seconds.

        `SweepError` if a worker cannot load the computation.
        """
        outcomes: list[BatchOutcome[CellT, Any]] = []
        while True:
            try:
                future = self._done.get(timeout=wait)
            except Empty:
                break
            wait = 0.0
            flight = self._in_flight.pop(future, None)
            if flight is None:
                continue
            try:
                outcome = self._answer(future.result(), flight)
            except SweepInterrupted:
                self.last_dropped = time.monotonic()
                continue
            except Exception as error:  # noqa: BLE001 - each executor has its own
                outcome = self._failure(error, flight)
                if outcome is None:
                    continue
            if outcome is None:
                self._submit(flight.batch, with_computation=True, is_marked=flight.is_marked)
            else:
                outcomes.append(outcome)
        if time.monotonic() > self._next_look:
            self._find_hanging()
        return outcomes

    def cancel(self, *, finishes: bool = False) -> list[Batch[CellT]]:
        """Take batches back that have not begun.

        With ``finishes`` those stay that were submitted first to an executor that does not tell: one for each worker,
        or all if it does not tell their number either.
        """
        if finishes and self._finishing is None and not self._tells_begin:
            self._finishing = [future for future in self._in_flight if not future.done()][: self._told_count or None]
        kept = (self._finishing or []) if finishes else []
        given_up = [future for future in self._in_flight if future not in kept and future.cancel()]
        return [self._in_flight.pop(future).batch for future in given_up]

    def _submit(self, batch: Batch[CellT], *, with_computation: bool, is_marked: bool) -> None:
        if self._time_limit is not None:
            patience = 3.0 * self._time_limit + 5.0  # a check may be late by seconds on a loaded machine
        elif self._slowest:
            patience = max(self._silence_floor, 20.0 * self._slowest * batch.cost)
        else:
            patience = 10.0 * self._silence_floor
        computation = self._computation if with_computation or self.are_here else None
        try:
            future = self._executor.submit(_compute_batch, self._key, computation, batch, self._time_limit)
        except Exception as error:  # noqa: BLE001 - each executor has its own
            self._end(f"the executor takes no more batches ({type(error).__name__}: {error})")
        else:
            self._in_flight[future] = _Flight(batch, patience, not self._last_answer, is_marked)
            self._last_event = time.monotonic()
            future.add_done_callback(self._done.put)

    def _answer(self, answer: bytes, flight: _Flight[CellT]) -> BatchOutcome[CellT, Any] | None:
        """Outcome returned by a worker; None if the worker lacks the computation."""
        worker: _Identity
        worker, packed = pickle.loads(answer)  # noqa: S301 - written by a worker of the same program
        now = time.monotonic()
        if not self._last_answer and flight.begun is not None:
            self._loading = min(self._silence_floor, 10.0 * (now - flight.begun))
        self._last_answer[worker] = self._last_event = now
        rank = worker[3] if worker[3] is not None else len(self._rank_of) + (worker[1] != os.getpid())
        rank = self._rank_of.setdefault(worker, rank)
        if packed is None:
            return None
        seconds, results, failure = packed
        if results is not None:
            try:
                results = pickle.loads(results)  # noqa: S301 - as above
            except Exception as error:  # noqa: BLE001 - unpickling runs code of the result's class
                results, failure = None, Failure.from_exception(CellStatus.FAILED, error)
            else:
                self._slowest = max(self._slowest, seconds / flight.batch.cost)
                self._longest = max(self._longest, seconds)
        return BatchOutcome(flight.batch, seconds, results, failure, rank, worker[0])

    def _failure(self, error: Exception, flight: _Flight[CellT]) -> BatchOutcome[CellT, Any] | None:
        """Outcome of a batch that took down workers of Dask; None if the executor has ended.

        `SweepError` if the worker could not load the computation.
        """
        reason = f"{type(error).__name__}: {error}".removesuffix(": ")  # some have no words
        if type(error).__name__ == "KilledWorker":  # an exception of Dask, which is not imported for this
            failure = Failure(CellStatus.QUARANTINED, f"took down its workers and is not tried again: {reason}")
            return BatchOutcome(flight.batch, 0.0, failure=failure, host="unknown host")
        if isinstance(error, BrokenExecutor | CancelledError | OSError):
            is_seen = flight.is_marked or flight.begun is not None
            if isinstance(error, BrokenExecutor) and not is_seen and len(self._lost) < self.count:
                self._lost.append(flight.batch)  # in the order of submission, in which workers take them
            self._end(f"a worker was lost ({reason})")
            return None
        raise SweepError(
            f"A worker of the executor could not compute a batch ({reason}): install the same calcidem for all "
            "workers, and look at what they wrote"
        ) from error

    def _find_hanging(self) -> None:
        """End the sweep if a batch has had no outcome for too long, or if there are no workers."""
        now = time.monotonic()
        self._next_look = now + 0.5
        longest = max((flight.patience for flight in self._in_flight.values()), default=0.0)
        for flight in self._in_flight.values():
            allowed = flight.patience + (self._loading if flight.is_first else 0.0)
            if flight.begun is not None and now - flight.begun > allowed:
                cells = ", ".join(map(str, flight.batch.cells[:3]))
                cure = "if one needs longer, give time_limit"
                self._end(f"a worker has not answered within {allowed:.3g} s (cells {cells} ...); {cure}")
        if self._in_flight and now - self._last_event > longest + 10.0 * self._silence_floor:
            self._end(f"no worker has answered within {now - self._last_event:.3g} s")

    def _end(self, reason: str) -> None:
        self.exhausted = self.exhausted or reason


_latest = threading.local()
"""The computation that this thread of an executor got last, and its hash: several may work for several sweeps."""


@cache  # one thread for all computations; a forked process inherits the entries of its parent, which has another one
def _end_with(master: int) -> None:
    """End this worker after its master: without one it would wait for ever."""
    end_after(master, 1.0, EXIT_RESUMABLE)


def _compute_batch(
    key: str, computation: bytes | Compute[Any, Any] | None, batch: Batch[Any], time_limit: float | None
) -> bytes:
    """Compute a batch in a worker, or in the process of the sweep, whose computation is not pickled.

    Return the worker's identity and, if it has the computation, seconds, results and failure.
    """
    worker: _Identity = (platform.node(), os.getpid(), threading.get_ident(), own_rank())
    if not callable(computation) and key != getattr(_latest, "key", None):
        if computation is None:
            return pickle.dumps((worker, None))
        if (parent := multiprocessing.parent_process()) is not None and parent.pid is not None:
            _end_with(parent.pid)
        _latest.compute = pickle.loads(computation)  # noqa: S301 - written by the master of the same program
        _latest.key = key
    outcome = attempt(batch, computation if callable(computation) else _latest.compute, time_limit)
    results, failure = None, outcome.failure
    if failure is None:
        try:
            results = pickle.dumps(outcome.results, pickle.HIGHEST_PROTOCOL)
        except Exception as error:  # noqa: BLE001 - pickling runs code of the result's class
            failure = Failure.from_exception(CellStatus.FAILED, error)
    return pickle.dumps((worker, (outcome.seconds, results, failure)))
