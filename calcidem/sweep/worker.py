"""A rank of MPI that computes batches for rank 0, which sees it as one of its `MPIWorkers`."""

import time
from contextlib import suppress

from mpi4py import MPI

from calcidem.sweep.attempt import Compute, Deadline, SweepInterrupted, attempt, hard_stop
from calcidem.sweep.backoff import Backoff, wait_until
from calcidem.sweep.batch import Batch, CellT
from calcidem.sweep.options import SweepOptions
from calcidem.sweep.outcome import BatchOutcome, Failure, FailureKind, Place, ResultT
from calcidem.sweep.processes import ProcessIdentity
from calcidem.sweep.protocol import MASTER, Incoming, Ranks, Tag
from calcidem.sweep.signals import leave_signals_to_master
from calcidem.sweep.sweep_end import MasterLostError, SweepEnd


def run_worker(comm: MPI.Comm, compute: Compute[CellT, ResultT], options: SweepOptions) -> SweepEnd:
    """Compute batches for the master until it says stop; return how the sweep ended.

    `MasterLostError` if rank 0 has died (with ULFM; else the launcher ends the job).
    """
    leave_signals_to_master()
    ranks, place = Ranks(comm), Place.here(comm.Get_rank())
    try:
        wait_until(ranks.send(ProcessIdentity.of_this_process(), MASTER, Tag.HELLO).Test)
        message = _next_message(ranks)
        while message.tag is not Tag.STOP:
            batch: Batch[CellT] = message.value()
            deadline = Deadline(options.time_limit, lambda: comm.Iprobe(MASTER, Tag.STOP))
            with suppress(SweepInterrupted):  # by the STOP, which comes next
                with hard_stop(options.hard_limit):
                    outcome = attempt(batch, compute, deadline, place)
                _send_outcome(comm, outcome)
            message = _next_message(ranks)
    except MPI.Exception as error:
        raise MasterLostError(f"rank 0 has ended ({error}); run the same command again to continue") from error
    end: SweepEnd = message.value()
    return end


def _next_message(ranks: Ranks) -> Incoming:
    """Wait for the next message of the master and receive it."""
    backoff = Backoff()
    while (message := ranks.receive(MASTER)) is None:
        backoff.sleep()
    wait_until(message.arrived)
    return message


def _send_outcome(comm: MPI.Comm, outcome: BatchOutcome[CellT, ResultT]) -> None:
    """Send the outcome, unless a STOP comes before the master receives it."""
    start = time.monotonic()
    try:
        request = Ranks(comm).send(outcome, MASTER, Tag.OUTCOME)
    except MPI.Exception:
        raise
    except Exception as error:  # noqa: BLE001 - pickling runs code of the result's class
        failure = Failure.from_exception(FailureKind.FAILED, error)
        seconds = outcome.seconds + time.monotonic() - start
        unsent: BatchOutcome[CellT, ResultT] = BatchOutcome(outcome.batch, outcome.place, seconds, failure=failure)
        request = Ranks(comm).send(unsent, MASTER, Tag.OUTCOME)
    wait_until(lambda: comm.Iprobe(MASTER, Tag.STOP) or request.Test())
