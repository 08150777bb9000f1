"""Computes batches on MPI ranks, on an executor or in this process: it knows batches, a computation and a sink.

with Session() as session:
    ...                                     # prepare, session.broadcast(...)
    end = run_sweep(session.comm, batches, compute, sink, stop_request=session.stop_request)
    session.end(end.exit_code, end)
"""

from calcidem.sweep.attempt import Compute, SweepInterrupted, TimeLimitReached
from calcidem.sweep.batch import Batch, Cell, plan_batches
from calcidem.sweep.environment import refuse_singletons
from calcidem.sweep.group_commit import Sink
from calcidem.sweep.options import SweepOptions
from calcidem.sweep.outcome import BatchOutcome, Failure, FailureKind, Place
from calcidem.sweep.processes import keep_freed_memory
from calcidem.sweep.progress import Progress
from calcidem.sweep.run import run_sweep
from calcidem.sweep.schedule import Tally
from calcidem.sweep.session import Session
from calcidem.sweep.signals import StopLevel, StopRequest
from calcidem.sweep.sweep_end import (
    EXIT_COMPLETE,
    EXIT_ERROR,
    EXIT_RESUMABLE,
    LaunchError,
    MasterLostError,
    SweepEnd,
    SweepError,
    SweepState,
    WorkersLostError,
)

__all__ = [
    "EXIT_COMPLETE",
    "EXIT_ERROR",
    "EXIT_RESUMABLE",
    "Batch",
    "BatchOutcome",
    "Cell",
    "Compute",
    "Failure",
    "FailureKind",
    "LaunchError",
    "MasterLostError",
    "Place",
    "Progress",
    "Session",
    "Sink",
    "StopLevel",
    "StopRequest",
    "SweepEnd",
    "SweepError",
    "SweepInterrupted",
    "SweepOptions",
    "SweepState",
    "Tally",
    "TimeLimitReached",
    "WorkersLostError",
    "keep_freed_memory",
    "plan_batches",
    "refuse_singletons",
    "run_sweep",
]
