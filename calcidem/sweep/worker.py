"""The worker's end of a sweep: `_worker_join`, `_worker_exec`, `_worker_stop`, mirrored by the master."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

from mpi4py import MPI

from calcidem.sweep.attempt import Compute, Deadline, SweepInterrupted, attempt
from calcidem.sweep.batch import Batch, CellT
from calcidem.sweep.options import SweepOptions
from calcidem.sweep.outcome import BatchOutcome, Failure, FailureKind, Place, ResultT
from calcidem.sweep.processes import ProcessIdentity
from calcidem.sweep.protocol import MASTER, Backoff, Incoming, Tag, start_receive, start_send, wait_until
from calcidem.sweep.signals import leave_signals_to_master
from calcidem.sweep.sweep_end import MasterLostError, SweepEnd


def run_worker(comm: MPI.Comm, compute: Compute[CellT, ResultT], options: SweepOptions) -> SweepEnd:
    """Compute batches for the master until it says stop; return how the sweep ended.

    Raises
    ------
    MasterLostError
        If rank 0 has died (with ULFM; else the launcher ends the job).
    """
    leave_signals_to_master()
    try:
        _worker_join(comm)
        return _worker_stop(_worker_exec(comm, compute, options))
    except MPI.Exception as error:
        raise MasterLostError(f"rank 0 is gone ({error}); run the same command again to continue") from error


def _worker_join(comm: MPI.Comm) -> None:
    """Report to the master, with what it needs to watch this process."""
    request = start_send(comm, ProcessIdentity.of_this_process(), MASTER, Tag.HELLO)
    wait_until(request.Test)


def _worker_exec(comm: MPI.Comm, compute: Compute[CellT, ResultT], options: SweepOptions) -> Incoming:
    """Compute one batch after the other; return the message that says stop."""
    place = Place.here(comm.Get_rank())
    while True:
        message = _next_message(comm)
        if message.tag is Tag.STOP:
            return message
        batch: Batch[CellT] = message.value()
        deadline = Deadline(options.time_limit, lambda: comm.Iprobe(MASTER, Tag.STOP))
        try:
            with _hard_stop(options.hard_limit):
                outcome = attempt(batch, compute, deadline, place)
        except SweepInterrupted:
            continue  # the next message is the STOP that interrupted the batch
        stop = _send_outcome(comm, outcome)
        if stop is not None:
            return stop


def _worker_stop(message: Incoming) -> SweepEnd:
    """Return how the sweep ended, as the master's last message says."""
    end: SweepEnd = message.value()
    return end


@contextmanager
def _hard_stop(limit: float | None) -> Iterator[None]:
    """Let the kernel kill this process if the block takes longer than `limit` seconds.

    The default action of SIGALRM works inside compiled code too, where no Python handler would ever run.
    """
    if limit is None:
        yield
        return
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, limit)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _next_message(comm: MPI.Comm) -> Incoming:
    """Wait for the next message of the master and receive it."""
    backoff = Backoff()
    while (message := start_receive(comm, MASTER)) is None:
        backoff.sleep()
    wait_until(message.arrived)
    return message


def _send_outcome(comm: MPI.Comm, outcome: BatchOutcome[CellT, ResultT]) -> Incoming | None:
    """Send the outcome; return a STOP that came before the master wanted it, else None."""
    start = time.monotonic()
    try:
        request = start_send(comm, outcome, MASTER, Tag.OUTCOME)
    except MPI.Exception:
        raise
    except Exception as error:  # noqa: BLE001 - pickling runs code of the result's class
        failure = Failure.from_exception(FailureKind.FAILED, error)
        seconds = outcome.seconds + time.monotonic() - start
        unsent: BatchOutcome[CellT, ResultT] = BatchOutcome(outcome.batch, outcome.place, seconds, failure=failure)
        request = start_send(comm, unsent, MASTER, Tag.OUTCOME)
    stopped = False

    def sent_or_stopped() -> bool:
        nonlocal stopped
        stopped = comm.Iprobe(MASTER, Tag.STOP)
        return stopped or request.Test()

    wait_until(sent_or_stopped)
    return _next_message(comm) if stopped else None
