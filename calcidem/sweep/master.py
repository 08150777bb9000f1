"""The master's end of a sweep: `_master_exec` and `_master_stop` mirror those of the worker.

There is no `master_join`: workers join while the sweep runs, whenever they are ready (`WorkerPool.receive`).
"""

import time
from dataclasses import replace
from typing import Any

from mpi4py import MPI

from calcidem.sweep.batch import CellT
from calcidem.sweep.channel import tell_command
from calcidem.sweep.context import SweepContext
from calcidem.sweep.group_commit import GroupCommit
from calcidem.sweep.outcome import BatchOutcome
from calcidem.sweep.protocol import Backoff
from calcidem.sweep.signals import StopLevel
from calcidem.sweep.sweep_end import SweepEnd, SweepState
from calcidem.sweep.worker_pool import Loss, WorkerPool

_HEARTBEAT_INTERVAL = 0.5
"""Seconds between two heartbeats, for the command that started the ranks and for the progress display."""


def run_master(comm: MPI.Comm, context: SweepContext[CellT], fault_tolerant: bool) -> SweepEnd:
    """Have the batches computed by the workers and store what becomes of them.

    `fault_tolerant` tells whether the MPI library goes on when a rank is lost (ULFM).

    Raises
    ------
    Exception
        Whatever the sink raises, after the workers have been told to stop.
    """
    start = time.monotonic()
    options = context.options
    tell_command("sweeping")
    pool: WorkerPool[CellT] = WorkerPool(comm, options, fault_tolerant)
    try:
        with GroupCommit(context) as commits:
            state, detail = _master_exec(pool, context, commits)
            tell_command("pause")  # what still waits is stored
    except BaseException as error:
        _master_stop(pool, SweepEnd(SweepState.ERROR, detail=str(error)), options.hurry_grace)
        raise
    end = SweepEnd(state, detail, context.schedule.tally, time.monotonic() - start)
    return _master_stop(pool, end, options.hurry_grace if context.stop_request.hurry() else options.stop_grace)


def _master_exec(
    pool: WorkerPool[CellT], context: SweepContext[CellT], commits: GroupCommit[CellT]
) -> tuple[SweepState, str]:
    """Hand out batches and take in outcomes until there is a reason to end; return it."""
    backoff = Backoff()
    next_heartbeat = 0.0
    while True:
        level = context.stop_request.level  # taken first, so that the last round misses nothing
        lost = pool.find_lost()
        outcomes = pool.receive()
        losses = pool.remove(lost)
        settled = (context.schedule.settle(outcome) for outcome in outcomes)
        commits.add(*(outcome for outcome in settled if outcome is not None))
        handed_out = level is StopLevel.NONE and not commits.is_full and _hand_out(pool, context)
        commits.advance()
        _account_for(losses, context, commits)

        if (end := _reason_to_end(pool, context, level)) is not None:
            return end
        if time.monotonic() > next_heartbeat:
            next_heartbeat = time.monotonic() + _HEARTBEAT_INTERVAL
            tell_command("beat")
            context.progress.on_heartbeat(workers=len(pool.expected), running=pool.running)
        if outcomes or handed_out or losses:
            backoff.reset()
        backoff.sleep()


def _master_stop(pool: WorkerPool[CellT], end: SweepEnd, grace: float) -> SweepEnd:
    """Tell the workers how the sweep ended; return the end with the ranks that didn't answer."""
    return replace(end, unresponsive_ranks=pool.stop(end, grace))


def _hand_out(pool: WorkerPool[CellT], context: SweepContext[CellT]) -> bool:
    """Give every idle worker a batch, as long as there is one; tell whether there was."""
    handed_out = False
    while pool.has_idle:
        batch = context.schedule.take()
        if batch is None:
            break
        pool.assign(batch)
        handed_out = True
    return handed_out


def _account_for(losses: list[Loss[CellT]], context: SweepContext[CellT], commits: GroupCommit[CellT]) -> None:
    """Store what the loss of workers means for the batches that they had."""
    for loss in losses:
        context.progress.on_loss(loss.place, loss.reason)
        # Once the sweep is to end at once, workers may be dying of the same signal: no cell is to blame.
        if loss.batch is None or context.stop_request.hurry():
            continue
        commits.add_loss(loss.batch.with_another_loss(), loss.reason)
        outcome: BatchOutcome[CellT, Any] | None = context.schedule.lose(
            loss.batch, loss.reason, loss.place, loss.seconds
        )
        if outcome is not None:
            commits.add(outcome)


def _reason_to_end(
    pool: WorkerPool[CellT], context: SweepContext[CellT], level: StopLevel
) -> tuple[SweepState, str] | None:
    """Return why the sweep is over, or None if it isn't."""
    asked_by = context.stop_request.explanation
    if pool.running == 0 and len(context.schedule) == 0:
        return SweepState.COMPLETE, ""
    if level is StopLevel.HURRY:
        return SweepState.STOPPED, f"{asked_by}: running batches were dropped"
    if level is StopLevel.DRAIN and pool.running == 0:
        return SweepState.STOPPED, f"{asked_by}: running batches were finished"
    if not pool.expected:
        return SweepState.OUT_OF_WORKERS, "all workers are lost; run the same command again to continue"
    if pool.broken:
        return (
            SweepState.OUT_OF_WORKERS,
            "a worker is lost and MPI cannot go on without it; run the same command again to continue",
        )
    return None
