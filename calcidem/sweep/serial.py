"""A sweep in one process, with the same rules as the parallel one and without any MPI library."""

import time
from typing import TypeVar

from calcidem.sweep.attempt import Compute, attempt
from calcidem.sweep.batch import CellT
from calcidem.sweep.context import SweepContext
from calcidem.sweep.deadline import Deadline, SweepInterrupted
from calcidem.sweep.outcome import Place
from calcidem.sweep.signals import StopLevel
from calcidem.sweep.sweep_end import SweepEnd, SweepState

ResultT = TypeVar("ResultT")


def run_serial(context: SweepContext[CellT], compute: Compute[CellT, ResultT]) -> SweepEnd:
    """Compute and store one batch after the other.

    The hard limit does not apply: the process that it would kill is the only one there is.

    Raises
    ------
    Exception
        Whatever the sink raises.
    """
    schedule, stop_request = context.schedule, context.stop_request
    start = time.monotonic()
    place = Place.here(rank=0)

    def end(state: SweepState, detail: str = "") -> SweepEnd:
        return SweepEnd(state, detail, schedule.tally, time.monotonic() - start)

    while stop_request.level is StopLevel.NONE:
        batch = schedule.take()
        if batch is None:
            return end(SweepState.COMPLETE)
        context.progress.tick(workers=1, running=1)
        try:
            deadline = Deadline(context.options.time_limit, stop_request.hurry)
            outcome = attempt(batch, compute, deadline, place)
        except SweepInterrupted:
            return end(SweepState.STOPPED, f"{stop_request.told}: the running batch was dropped")
        final = schedule.settle(outcome)
        context.store([final] if final is not None else [])
    if len(schedule) == 0:
        return end(SweepState.COMPLETE)
    return end(SweepState.STOPPED, f"{stop_request.told}: the running batch was finished")
