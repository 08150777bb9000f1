"""`run_sweep`: compute all batches, on many ranks or in this process, and store what becomes of them."""

import time
from collections.abc import Iterable
from contextlib import nullcontext
from typing import TYPE_CHECKING

from calcidem.sweep.attempt import Compute, Deadline, SweepInterrupted, attempt
from calcidem.sweep.batch import Batch, CellT
from calcidem.sweep.context import Sink, SweepContext
from calcidem.sweep.environment import fault_tolerance_enabled
from calcidem.sweep.options import SweepOptions
from calcidem.sweep.outcome import Place, ResultT
from calcidem.sweep.progress import Progress
from calcidem.sweep.schedule import Schedule
from calcidem.sweep.signals import StopLevel, StopRequest
from calcidem.sweep.sweep_end import SweepEnd, SweepState

if TYPE_CHECKING:
    from mpi4py import MPI  # importing it starts MPI, which a serial run must do without


def run_sweep(
    comm: "MPI.Comm | None",
    batches: Iterable[Batch[CellT]],
    compute: Compute[CellT, ResultT],
    sink: Sink | None,
    *,
    options: SweepOptions | None = None,
    progress: Progress | None = None,
    stop_request: StopRequest | None = None,
) -> SweepEnd:
    """Compute all batches and store what becomes of them.

    To be called on all ranks of `comm`. Rank 0 hands out the batches and stores the outcomes; it sleeps most
    of the time, so start one rank more than there are cores. All other ranks compute. With one rank, or
    without a communicator, the same happens in this process.

    Parameters
    ----------
    comm
        Communicator whose ranks take part, or None. Nothing else may be sent over it during the sweep.
    batches
        What to compute, in the order in which to hand it out; used on rank 0 only.
    compute
        Computes a batch; used on the workers. See `Compute` for what it has to keep to.
    sink
        Keeps the outcomes; used on rank 0 only, may be None elsewhere.
    options
        Limits, the same on all ranks.
    progress
        Display, used on rank 0 only; silent by default.
    stop_request
        Signals as noted since the start of the program (`Session` has one); by default they are noted during
        the sweep only. Used on rank 0 only.

    Returns
    -------
    SweepEnd
        How the sweep ended, on all ranks; `exit_code` is what the program should return.

    Raises
    ------
    ValueError
        On rank 0, if there is no sink or two batches have the same identifier.
    MasterLostError
        On a worker, if rank 0 has died (with ULFM; without it the launcher ends the job).
    Exception
        On rank 0, whatever the sink raises, after the workers have been told to stop.
    """
    options = options or SweepOptions()
    parallel = comm is not None and comm.Get_size() > 1
    if parallel and comm is not None and comm.Get_rank() != 0:
        from calcidem.sweep.worker import run_worker  # noqa: PLC0415 - a serial run must not need an MPI library

        return run_worker(comm, compute, options)

    if sink is None:
        raise ValueError("sink is None on rank 0: give the object that stores the outcomes")
    schedule = Schedule(tuple(batches))
    progress = progress or Progress()
    with nullcontext(stop_request) if stop_request is not None else StopRequest() as stop:
        context = SweepContext(schedule, sink, progress, stop, options)
        if parallel and comm is not None:
            from calcidem.sweep.master import run_master  # noqa: PLC0415 - as above

            progress.on_start(schedule.batches, workers=comm.Get_size() - 1)
            end = run_master(comm, context, fault_tolerance_enabled())
        else:
            progress.on_start(schedule.batches, workers=1)
            end = _run_serial(context, compute)
    progress.on_end(end)
    return end


def _run_serial(context: SweepContext[CellT], compute: Compute[CellT, ResultT]) -> SweepEnd:
    """Compute and store one batch after the other in this process, by the rules of the parallel sweep.

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
        context.progress.on_heartbeat(workers=1, running=1)
        try:
            deadline = Deadline(context.options.time_limit, stop_request.hurry)
            outcome = attempt(batch, compute, deadline, place)
        except SweepInterrupted:
            return end(SweepState.STOPPED, f"{stop_request.explanation}: the running batch was dropped")
        final = schedule.settle(outcome)
        context.store([final] if final is not None else [])
    if len(schedule) == 0:
        return end(SweepState.COMPLETE)
    return end(SweepState.STOPPED, f"{stop_request.explanation}: the running batch was finished")
