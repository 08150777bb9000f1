"""The workers of a `concurrent.futures.Executor`, in other processes and on other machines.

An executor does not report the number or names of its workers, nor when one begins a batch. So each outcome names its
worker, and more batches are submitted than there are known workers. A new worker computes one of these and counts from
its first outcome.

The computation, with the packing, is pickled once and sent with the first batches. A process keeps it by its hash. A
process that lacks it reports this, and the batch is submitted again with the computation.
"""

import os
import pickle
import platform
import threading
import time
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from dataclasses import dataclass
from hashlib import sha256
from queue import SimpleQueue
from typing import Any, Generic, TypeAlias

from calcidem.ends import CellStatus
from calcidem.sweep.attempt import Compute, Deadline, attempt, hard_stop
from calcidem.sweep.batch import Batch, CellT
from calcidem.sweep.environment import available_cores
from calcidem.sweep.options import SweepOptions
from calcidem.sweep.outcome import BatchOutcome, Failure, Place
from calcidem.sweep.sweep_end import SweepEnd, SweepError
from calcidem.sweep.workers import Loss

_BEFORE_IN_QUEUE = 2
"""Batches that a worker may have to finish before a new one, see `ExecutorWorkers.wants_batch`."""

_MEMORY = 60.0
"""Seconds without an outcome after which a worker no longer counts; ten batches if these take longer."""

_Identity: TypeAlias = tuple[str, int, int]
"""Host, process and thread."""


@dataclass(slots=True)
class _Flight(Generic[CellT]):
    """A batch in flight."""

    batch: Batch[CellT]
    since: float
    """Time of submission, s on the monotonic clock."""
    alone: bool
    """Whether no other batch was in flight."""


class ExecutorWorkers(Generic[CellT]):
    """Workers of an executor, which stays open.

    A batch that has lost a worker is computed alone. Some executors end with their first lost process
    (`ProcessPoolExecutor`). Then all submitted batches count a loss, and computing them alone isolates the bad cell.
    Dask tries a batch on four workers before it raises `KilledWorker`. The computation must be picklable.

    Attributes
    ----------
    exhausted
        Reason why the executor accepts no more batches; else empty.
    """

    def __init__(self, executor: Executor, compute: Compute[CellT, Any], options: SweepOptions) -> None:
        self._executor, self._options = executor, options
        self._computation = pickle.dumps(compute, pickle.HIGHEST_PROTOCOL)
        self._key = sha256(self._computation).hexdigest()
        self._under_way: dict[Future[bytes], _Flight[CellT]] = {}
        self._done: SimpleQueue[Future[bytes]] = SimpleQueue()
        self._held: Batch[CellT] | None = None
        self._given_up: set[Future[bytes]] = set()
        self._rank_of: dict[_Identity, int] = {}
        self._last_answer: dict[_Identity, float] = {}
        self._slowest = 0.0  # seconds for a unit of cost
        self._longest = 0.0  # seconds of a batch
        self._start = time.monotonic()
        self._stranded = 0  # batches neither computed nor lost when the executor ended
        self._blamed = 0  # batches that may have caused the loss of the process with which the executor ended
        self.exhausted = ""

    @property
    def count(self) -> int:
        """Number of workers with a recent outcome."""
        oldest = time.monotonic() - max(_MEMORY, 10.0 * self._longest)
        return sum(answer > oldest for answer in self._last_answer.values())

    @property
    def running(self) -> int:
        """Number of batches submitted, held back, or not computed by an executor that ended."""
        return len(self._under_way) + (self._held is not None) + self._stranded

    @property
    def wants_batch(self) -> bool:
        """Whether fewer batches are submitted than two for each worker and some for workers that may join."""
        if self.exhausted or self._held is not None or any(flight.batch.losses for flight in self._under_way.values()):
            return False
        enough = _BEFORE_IN_QUEUE * self.count + 2 if self._rank_of else available_cores() + 2
        return len(self._under_way) + len(self._given_up) < enough

    def submit(self, batch: Batch[CellT]) -> None:
        """Submit a batch; one that has lost a worker waits until no other is running."""
        if batch.losses and self._under_way:
            self._held = batch
        else:
            self._submit(batch, with_computation=not self._rank_of)

    def poll(self) -> tuple[list[BatchOutcome[CellT, Any]], list[Loss[CellT]]]:
        """Receive outcomes; `SweepError` if a worker cannot load the computation."""
        outcomes: list[BatchOutcome[CellT, Any]] = []
        losses: list[Loss[CellT]] = []
        while not self._done.empty():
            future = self._done.get_nowait()
            self._given_up.discard(future)
            if (flight := self._under_way.pop(future, None)) is None:
                continue
            try:
                outcome = self._answer(future.result(), flight)
            except Exception as error:  # noqa: BLE001 - each executor has its own
                losses += self._losses(error, flight)
            else:
                if outcome is None:
                    self._submit(flight.batch, with_computation=True)
                else:
                    outcomes.append(outcome)
        losses += self._find_silent()
        if self._held is not None and not self._under_way:
            batch, self._held = self._held, None
            self._submit(batch, with_computation=False)
        return outcomes, losses

    def stop(self, _end: SweepEnd, _grace: float) -> frozenset[int]:
        """Cancel batches not yet begun; the results of running ones are ignored."""
        for future in self._under_way:
            future.cancel()
        return frozenset()

    def _submit(self, batch: Batch[CellT], *, with_computation: bool) -> None:
        computation = self._computation if with_computation else None
        flight = _Flight(batch, time.monotonic(), alone=not self._under_way)
        try:
            future = self._executor.submit(_compute_batch, self._key, computation, batch, self._options)
        except Exception as error:  # noqa: BLE001 - each executor has its own
            self._end(f"the executor takes no more batches ({type(error).__name__}: {error})")
            self._stranded += 1
        else:
            self._under_way[future] = flight
            future.add_done_callback(self._done.put)

    def _answer(self, answer: bytes, flight: _Flight[CellT]) -> BatchOutcome[CellT, Any] | None:
        """Outcome returned by a worker; None if the worker lacks the computation."""
        worker: _Identity
        worker, packed = pickle.loads(answer)  # noqa: S301 - written by a worker of the same program
        self._last_answer[worker] = time.monotonic()
        place = Place(self._rank_of.setdefault(worker, len(self._rank_of) + 1), worker[0])
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
        return BatchOutcome(flight.batch, place, seconds, results, failure)

    def _losses(self, error: Exception, flight: _Flight[CellT]) -> list[Loss[CellT]]:
        """Interpret the exception of a batch: a loss, or the end of the executor.

        `SweepError` if the worker could not load the computation.
        """
        reason, workers = f"{type(error).__name__}: {error}", 1
        if type(error).__name__ == "KilledWorker":  # an exception of Dask, which is not imported for this
            # A single cell may only have waited on the same workers as the cell that killed them.
            if flight.alone or len(flight.batch.cells) > 1:
                workers = int(getattr(error, "allowed_failures", 0)) + 1
        elif isinstance(error, BrokenExecutor):
            if not self.exhausted:  # batches are computed in order of submission: later ones had not begun
                self._blamed = self.count + 1 if self._rank_of else available_cores() + 2
            self._end(f"a process of the executor was lost ({error})")
            self._blamed -= 1
            if self._blamed < 0:
                self._stranded += 1
                return []
        elif isinstance(error, CancelledError | OSError):
            self._end(f"the executor has ended ({reason})")
            self._stranded += 1
            return []
        else:
            raise SweepError(
                f"A worker of the executor could not compute a batch ({reason}): install the same calcidem for all "
                "workers, and look at what they wrote"
            ) from error
        return [Loss(Place(0, "unknown host"), flight.batch, reason, time.monotonic() - flight.since, workers)]

    def _find_silent(self) -> list[Loss[CellT]]:
        """Give up batches without an outcome for long, and then the executor."""
        now = time.monotonic()
        if not self._rank_of:
            limit = 10.0 * self._options.silence_floor
            if self._under_way and now - self._start > limit:
                self._end(f"no worker of the executor has answered within {limit:.3g} s")
            return []
        late = [
            future
            for future, flight in self._under_way.items()
            # Other batches may have been ahead of it in the queue.
            if now - flight.since > (1 + _BEFORE_IN_QUEUE) * self._options.patience(flight.batch.cost, self._slowest)
        ]
        losses = []
        for future in late:
            flight = self._under_way.pop(future)
            if not future.cancel():
                self._given_up.add(future)
            seconds = now - flight.since
            losses.append(Loss(Place(0, "unknown host"), flight.batch, f"no answer within {seconds:.3g} s", seconds))
        if self._given_up and len(self._given_up) >= self.count:
            self._end("the workers of the executor no longer answer")
        return losses

    def _end(self, reason: str) -> None:
        self.exhausted = self.exhausted or reason


_computations: dict[str, Compute[Any, Any]] = {}
"""The computation of the latest sweep in this process, by its hash."""

_loading = threading.Lock()


def _compute_batch(key: str, computation: bytes | None, batch: Batch[Any], options: SweepOptions) -> bytes:
    """Compute a batch in a worker.

    Return the worker's identity and, if it has the computation, seconds, results and failure.
    """
    worker: _Identity = (platform.node(), os.getpid(), threading.get_ident())
    with _loading:
        if key not in _computations:
            if computation is None:
                return pickle.dumps((worker, None))
            _computations.clear()
            _computations[key] = pickle.loads(computation)  # noqa: S301 - written by the master of the same program
        compute = _computations[key]
    place = Place(0, worker[0])  # the master sets the rank
    with hard_stop(options.hard_limit):
        outcome = attempt(batch, compute, Deadline(options.time_limit, lambda: False), place)
    results, failure = None, outcome.failure
    if failure is None:
        try:
            results = pickle.dumps(outcome.results, pickle.HIGHEST_PROTOCOL)
        except Exception as error:  # noqa: BLE001 - pickling runs code of the result's class
            failure = Failure.from_exception(CellStatus.FAILED, error)
    return pickle.dumps((worker, (outcome.seconds, results, failure)))
