"""The master's end of a sweep: `master_exec` and `master_stop` mirror those of the worker.

There is no `master_join`: workers join while the sweep runs, whenever they are ready (`Crew.receive`).
"""

import time
from dataclasses import replace
from typing import Any

from mpi4py import MPI

from calcidem.sweep.batch import CellT
from calcidem.sweep.context import SweepContext
from calcidem.sweep.outcome import BatchOutcome
from calcidem.sweep.protocol import Backoff
from calcidem.sweep.signals import StopLevel
from calcidem.sweep.sweep_end import SweepEnd, SweepState
from calcidem.sweep.worker_pool import Crew, Loss

TICK = 0.5
"""Seconds between the signs of life that the progress display gets."""


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
    crew: Crew[CellT] = Crew(comm, options, fault_tolerant)
    try:
        state, detail = master_exec(crew, context)
    except BaseException as error:
        master_stop(crew, SweepEnd(SweepState.ERROR, detail=str(error)), options.hurry_grace)
        raise
    end = SweepEnd(state, detail, context.schedule.tally, time.monotonic() - start)
    return master_stop(crew, end, options.hurry_grace if context.stop_request.hurry() else options.stop_grace)


def master_exec(crew: Crew[CellT], context: SweepContext[CellT]) -> tuple[SweepState, str]:
    """Hand out batches and take in outcomes until there is a reason to end; return it."""
    backoff = Backoff()
    next_tick = 0.0
    while True:
        level = context.stop_request.level  # taken first, so that the last round misses nothing
        lost = crew.lost()
        outcomes = crew.receive()
        losses = crew.bury(lost)
        settled = (context.schedule.settle(outcome) for outcome in outcomes)
        final = [outcome for outcome in settled if outcome is not None]
        handed_out = level is StopLevel.NONE and _hand_out(crew, context)
        context.store(final)  # after handing out, so that no worker waits for it
        _account_for(losses, context)

        if (end := _reason_to_end(crew, context, level)) is not None:
            return end
        if time.monotonic() > next_tick:
            next_tick = time.monotonic() + TICK
            context.progress.tick(workers=len(crew.expected), running=crew.running)
        if outcomes or handed_out or losses:
            backoff.reset()
        backoff.sleep()


def master_stop(crew: Crew[CellT], end: SweepEnd, grace: float) -> SweepEnd:
    """Tell the workers how the sweep ended; return the end with the ranks that didn't answer."""
    return replace(end, unresponsive_ranks=crew.stop(end, grace))


def _hand_out(crew: Crew[CellT], context: SweepContext[CellT]) -> bool:
    """Give every idle worker a batch, as long as there is one; tell whether there was."""
    handed_out = False
    while crew.has_idle:
        batch = context.schedule.take()
        if batch is None:
            break
        crew.assign(batch)
        handed_out = True
    return handed_out


def _account_for(losses: list[Loss[CellT]], context: SweepContext[CellT]) -> None:
    """Store what the loss of workers means for the batches that they had."""
    for loss in losses:
        context.progress.lost(loss.place, loss.reason)
        # Once the sweep is to end at once, workers may be dying of the same signal: no cell is to blame.
        if loss.batch is None or context.stop_request.hurry():
            continue
        context.sink.lost(loss.batch.lost_once_more(), loss.reason)
        outcome: BatchOutcome[CellT, Any] | None = context.schedule.lose(
            loss.batch, loss.reason, loss.place, loss.seconds
        )
        context.store([outcome] if outcome is not None else [])


def _reason_to_end(crew: Crew[CellT], context: SweepContext[CellT], level: StopLevel) -> tuple[SweepState, str] | None:
    """Return why the sweep is over, or None if it isn't."""
    asked_by = context.stop_request.told
    if crew.running == 0 and len(context.schedule) == 0:
        return SweepState.COMPLETE, ""
    if level is StopLevel.HURRY:
        return SweepState.STOPPED, f"{asked_by}: running batches were dropped"
    if level is StopLevel.DRAIN and crew.running == 0:
        return SweepState.STOPPED, f"{asked_by}: running batches were finished"
    if not crew.expected:
        return SweepState.OUT_OF_WORKERS, "all workers are lost; run the same command again to continue"
    if crew.broken:
        return (
            SweepState.OUT_OF_WORKERS,
            "a worker is lost and MPI cannot go on without it; run the same command again to continue",
        )
    return None
