"""A sweep under MPI: state of the other ranks on rank 0 (idle, computing or lost), and the loop of a computing rank."""

import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Generic

from mpi4py import MPI

from calcidem.ends import CellStatus
from calcidem.launch.channel import command_listens, lost_according_to_command
from calcidem.sweep.attempt import Compute, Deadline, SweepInterrupted, attempt, hard_stop
from calcidem.sweep.backoff import Backoff, wait_until
from calcidem.sweep.batch import Batch, CellT
from calcidem.sweep.options import SweepOptions
from calcidem.sweep.outcome import BatchOutcome, Failure, Place, ResultT
from calcidem.sweep.processes import ProcessIdentity, ProcessWatch
from calcidem.sweep.protocol import MASTER, Incoming, Ranks, Tag
from calcidem.sweep.signals import leave_signals_to_master
from calcidem.sweep.sweep_end import MasterLostError, SweepEnd
from calcidem.sweep.workers import Loss

_WATCHDOG_INTERVAL = 0.25
"""Seconds between two checks for workers past their limit; a check of all of them takes time."""

_KILL_PATIENCE = 1.0
"""Seconds within which a killed process must end."""

_LAST_WORD = 0.5
"""Seconds in which the command has to report how a lost process ended, which only its starter can observe."""


@dataclass(slots=True)
class _Worker(Generic[CellT]):
    """State of a worker on the master."""

    place: Place
    """Its rank and host."""
    batch: Batch[CellT] | None = None
    """Batch that it computes; None while it waits."""
    since: float = 0.0
    """Time at which the batch was handed out, s on the monotonic clock."""
    task: MPI.Request | None = None
    """Request that sends the batch."""


class MPIWorkers(Generic[CellT]):
    """All other ranks of a communicator; they join the running sweep once they are ready.

    With ``fault_tolerant`` the MPI library continues when a rank is lost (ULFM).
    """

    def __init__(self, comm: MPI.Comm, options: SweepOptions, fault_tolerant: bool) -> None:
        self._ranks = Ranks(comm)
        self._size = comm.Get_size()
        self._options = options
        self._slowest = 0.0  # seconds for a unit of cost
        self._next_watchdog = 0.0
        self._fault_tolerant = fault_tolerant
        self._workers: dict[int, _Worker[CellT]] = {}
        self._idle: deque[int] = deque()
        self._incoming: list[Incoming] = []
        self._watch = ProcessWatch()
        self._known_failed: frozenset[int] = frozenset()
        self._given_up: set[int] = set()
        self._first_missed: dict[int, float] = {}
        self._expected = set(range(self._size)) - {MASTER}  # ranks not lost, whether they have reported or not

    @property
    def count(self) -> int:
        """Number of ranks not lost, whether they have reported yet or not."""
        return len(self._expected)

    @property
    def exhausted(self) -> str:
        """Reason to stop: all workers are lost, or one is and MPI cannot continue without it; else empty."""
        if not self._expected:
            return "all workers are lost"
        broken = not self._fault_tolerant and self.count < self._size - 1
        return "a worker is lost and MPI cannot continue without it" if broken else ""

    @property
    def running(self) -> int:
        """Number of computing workers."""
        return len(self._workers) - len(self._idle)

    @property
    def wants_batch(self) -> bool:
        """Whether a worker waits for a batch."""
        return bool(self._idle)

    def submit(self, batch: Batch[CellT]) -> None:
        """Hand a batch to a worker that waits for one."""
        rank = self._idle.popleft()
        worker = self._workers[rank]
        worker.batch = batch
        worker.since = time.monotonic()
        worker.task = self._send(batch, rank, Tag.TASK)

    def poll(self) -> tuple[list[BatchOutcome[CellT, Any]], list[Loss[CellT]]]:
        """Return new outcomes and lost workers."""
        lost = self._find_lost()  # before the outcomes, since an outcome sent before the death counts
        outcomes = self._receive()
        return outcomes, self._remove(lost)

    def _receive(self) -> list[BatchOutcome[CellT, Any]]:
        """Receive messages: register new workers, return the outcomes."""
        while (message := self._probe()) is not None:
            self._incoming.append(message)
        outcomes: list[BatchOutcome[CellT, Any]] = []
        on_their_way: list[Incoming] = []
        for message in self._incoming:
            try:
                arrived = message.arrived()
            except MPI.Exception:
                continue  # the sender died while sending; it is removed soon
            if not arrived:
                on_their_way.append(message)
            elif message.tag is Tag.HELLO:
                self._join(message)
            elif message.source in self._workers:  # else it was given up and its batch handed out again
                outcomes.append(self._outcome(message))
        self._incoming = on_their_way
        return outcomes

    def _find_lost(self) -> dict[int, str]:
        """Return lost ranks with reasons; they stay among the workers until `_remove`."""
        told = lost_according_to_command()
        reasons = {rank: reason for rank, reason in told.items() if rank in self._expected}
        failed = self._failed()
        if failed != self._known_failed:
            self._known_failed = failed
            self._ranks.acknowledge_failures()
        silent = dict.fromkeys(failed & self._expected, "MPI reports that its process failed")
        silent |= dict.fromkeys(self._watch.find_ended(), "its process ended")
        now = time.monotonic()
        patience = _LAST_WORD if command_listens() else 0.0
        for rank, reason in silent.items():
            if now - self._first_missed.setdefault(rank, now) >= patience:
                reasons.setdefault(rank, reason)
        if now >= self._next_watchdog:
            self._next_watchdog = now + _WATCHDOG_INTERVAL
            for rank, worker in self._workers.items():
                if worker.batch is not None and now - worker.since > (
                    limit := self._options.patience(worker.batch.cost, self._slowest)
                ):
                    reasons.setdefault(rank, f"no answer within {limit:.3g} s")
        return reasons

    def _remove(self, lost: dict[int, str]) -> list[Loss[CellT]]:
        """Remove lost workers and kill those that still run; return their losses."""
        losses: list[Loss[CellT]] = []
        for rank, reason in lost.items():
            self._expected.discard(rank)
            worker = self._workers.pop(rank, None)
            # Without ULFM a kill would also end the master; the session aborts all ranks instead.
            gone = rank in self._gone() or (self._fault_tolerant and self._watch.kill(rank))
            if not gone:
                self._given_up.add(rank)
            self._watch.remove(rank)
            if worker is None:  # it died before reporting
                losses.append(Loss(Place(rank, "unknown host"), None, reason, 0.0))
                continue
            if worker.batch is None:
                self._idle.remove(rank)
            seconds = time.monotonic() - worker.since
            losses.append(Loss(worker.place, worker.batch, self._explain(reason, seconds), seconds))
        return losses

    def stop(self, end: SweepEnd, grace: float) -> frozenset[int]:
        """Send the end of the sweep to all workers; return those that do not answer and may still be running."""
        sends = {rank: self._send(end, rank, Tag.STOP) for rank in self._expected}
        requests = {rank: request for rank, request in sends.items() if request is not None}

        def all_stopped() -> bool:
            self._receive()  # a worker that joins only now first waits until its message is received
            for rank in [rank for rank, request in requests.items() if self._ranks.is_over(request)]:
                del requests[rank]
            return requests.keys() <= self._gone()

        if not wait_until(all_stopped, grace) and self._fault_tolerant:
            for rank in requests:
                self._watch.kill(rank)
            wait_until(all_stopped, _KILL_PATIENCE)
        silent = (self._given_up | requests.keys()) - self._gone()
        for rank in self._workers:
            self._watch.remove(rank)
        return frozenset(silent)

    def _explain(self, reason: str, seconds: float) -> str:
        """Add to the reason of a loss that the hard limit of the worker was reached."""
        hard, watchdog = self._options.hard_limit, self._options.watchdog_limit
        if hard is None or watchdog is None or not hard <= seconds < watchdog:
            return reason
        return f"{reason} at the hard time limit of {hard:g} s"

    def _gone(self) -> set[int]:
        return self._watch.find_ended() | self._failed()

    def _failed(self) -> frozenset[int]:
        # Without ULFM there are none, and some MPI libraries lack the call.
        return self._ranks.failed() if self._fault_tolerant else frozenset()

    def _send(self, value: Any, rank: int, tag: Tag) -> MPI.Request | None:  # noqa: ANN401 - any picklable
        """Begin to send; return None if the receiver has just died, as `_find_lost` will report."""
        try:
            return self._ranks.send(value, rank, tag)
        except MPI.Exception as error:
            self._raise_unless_rank_failed(error)
            return None

    def _probe(self) -> Incoming | None:
        try:
            return self._ranks.receive(MPI.ANY_SOURCE)
        except MPI.Exception as error:
            self._raise_unless_rank_failed(error)
            self._ranks.acknowledge_failures()
            return None

    def _raise_unless_rank_failed(self, error: MPI.Exception) -> None:
        classes = (MPI.ERR_PROC_FAILED, MPI.ERR_PROC_FAILED_PENDING)
        if not self._fault_tolerant or error.Get_error_class() not in classes:
            raise error

    def _join(self, message: Incoming) -> None:
        if message.source not in self._expected:
            return
        identity: ProcessIdentity = message.value()
        self._workers[message.source] = _Worker(Place(message.source, identity.host))
        self._idle.append(message.source)
        self._watch.add(message.source, identity)

    def _outcome(self, message: Incoming) -> BatchOutcome[CellT, Any]:
        worker = self._workers[message.source]
        batch, worker.batch = worker.batch, None
        if batch is None or worker.task is None:
            raise RuntimeError(f"rank {message.source} sent an outcome without having a batch")
        worker.task.Wait()  # complete, since the batch was computed; this only frees the request
        self._idle.append(message.source)
        try:
            outcome: BatchOutcome[CellT, Any] = message.value()
        except Exception as error:  # noqa: BLE001 - unpickling runs code of the result's class
            failure = Failure.from_exception(CellStatus.FAILED, error)
            return BatchOutcome(batch, worker.place, time.monotonic() - worker.since, failure=failure)
        if outcome.failure is None:
            self._slowest = max(self._slowest, outcome.seconds / batch.cost)
        return outcome


def run_worker(comm: MPI.Comm, compute: Compute[CellT, ResultT], options: SweepOptions) -> SweepEnd:
    """Compute batches for the master until it sends STOP; return how the sweep ended.

    `MasterLostError` if rank 0 has died (with ULFM; else the launcher ends the job).
    """
    leave_signals_to_master()
    ranks, place = Ranks(comm), Place.here(comm.Get_rank())

    def is_stopped() -> bool:
        return comm.Iprobe(MASTER, Tag.STOP)

    try:
        wait_until(ranks.send(ProcessIdentity.of_this_process(), MASTER, Tag.HELLO).Test)
        message = _next_message(ranks)
        while message.tag is not Tag.STOP:
            batch: Batch[CellT] = message.value()
            deadline = Deadline(options.time_limit, is_stopped)
            with suppress(SweepInterrupted):  # by the STOP that follows
                with hard_stop(options.hard_limit):
                    outcome = attempt(batch, compute, deadline, place)
                request = _send_outcome(ranks, outcome)
                wait_until(lambda: is_stopped() or request.Test())  # noqa: B023 - called before the next batch
            message = _next_message(ranks)
    except MPI.Exception as error:
        raise MasterLostError(f"rank 0 has ended ({error}); run the same command again to continue") from error
    end: SweepEnd = message.value()
    return end


def _next_message(ranks: Ranks) -> Incoming:
    """Wait for the next message of the master, and receive it."""
    backoff = Backoff()
    while (message := ranks.receive(MASTER)) is None:
        backoff.sleep()
    wait_until(message.arrived)
    return message


def _send_outcome(ranks: Ranks, outcome: BatchOutcome[CellT, ResultT]) -> MPI.Request:
    """Begin to send the outcome; if it cannot be pickled, this failure."""
    start = time.monotonic()
    try:
        return ranks.send(outcome, MASTER, Tag.OUTCOME)
    except MPI.Exception:
        raise
    except Exception as error:  # noqa: BLE001 - pickling runs code of the result's class
        failure = Failure.from_exception(CellStatus.FAILED, error)
        seconds = outcome.seconds + time.monotonic() - start
        unsent: BatchOutcome[CellT, ResultT] = BatchOutcome(outcome.batch, outcome.place, seconds, failure=failure)
        return ranks.send(unsent, MASTER, Tag.OUTCOME)
