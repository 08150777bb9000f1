"""`run_sweep`: compute all batches and store their outcomes."""

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

from calcidem.launch.channel import tell_command
from calcidem.sweep.attempt import Compute
from calcidem.sweep.backoff import Backoff
from calcidem.sweep.batch import Batch, CellT
from calcidem.sweep.environment import fault_tolerance_enabled
from calcidem.sweep.executor_workers import ExecutorWorkers
from calcidem.sweep.group_commit import GroupCommit, Sink
from calcidem.sweep.options import SweepOptions
from calcidem.sweep.outcome import BatchOutcome, ResultT
from calcidem.sweep.progress import Progress
from calcidem.sweep.schedule import Schedule
from calcidem.sweep.signals import StopLevel, StopRequest
from calcidem.sweep.sweep_end import SweepEnd, SweepState
from calcidem.sweep.workers import Loss, SerialWorkers, Workers

if TYPE_CHECKING:
    from mpi4py import MPI  # importing it starts MPI, which a serial run must not need

_HEARTBEAT_INTERVAL = 0.5
"""Seconds between two heartbeats, for the command that started the ranks and for the progress display."""

More: TypeAlias = Callable[[Sequence[BatchOutcome[CellT, Any]]], Iterable[Batch[CellT]]]


def _no_more(_outcomes: Sequence[BatchOutcome[Any, Any]]) -> tuple[()]:
    return ()


def run_sweep(  # noqa: PLR0913 - each is another side of a sweep
    where: "MPI.Comm | Executor | None",
    batches: Iterable[Batch[CellT]],
    compute: Compute[CellT, ResultT],
    sink: Sink | None,
    *,
    options: SweepOptions | None = None,
    progress: Progress | None = None,
    stop_request: StopRequest | None = None,
    more: More[CellT] = _no_more,
) -> SweepEnd:
    """Compute all batches and store their outcomes.

    All ranks of a communicator call this. Rank 0 hands out the batches and stores the outcomes; it sleeps most of the
    time, so start one rank more than there are cores. All other ranks compute. With an executor its workers compute;
    with one rank or None this process computes. `ValueError` on rank 0 if there is no sink or two batches have the same
    identifier. `MasterLostError` on a worker if rank 0 has died (with ULFM; without it the launcher ends the job).
    `SweepError` if the workers of an executor cannot load the computation. Exceptions of the sink are raised on rank 0
    after the workers were stopped.

    Parameters
    ----------
    where
        Communicator whose ranks take part, executor, or None. No other messages may use a communicator during the
        sweep. An executor is left open.
    batches
        Batches in the order of computation; used on rank 0 only.
    compute
        Computes a batch; used on the workers. `Compute` states its conditions. For an executor it is pickled once, and
        unpickled once in each process.
    sink
        Stores the outcomes; used on rank 0 only, may be None elsewhere.
    options
        Limits, the same on all ranks.
    progress
        Display, used on rank 0 only; silent by default.
    stop_request
        Signals received since the start of the program (`Session` has one); by default signals count only during the
        sweep. Used on rank 0 only.
    more
        Returns further batches for new final outcomes; their identifiers are replaced. Used on rank 0 only, on the main
        thread, before these outcomes are stored.

    Returns
    -------
    SweepEnd
        How the sweep ended, on all ranks, with the `exit_code` of the program.
    """
    options = options or SweepOptions()
    comm = None if where is None or isinstance(where, Executor) or where.Get_size() == 1 else where
    if comm is not None and comm.Get_rank() != 0:
        from calcidem.sweep.mpi_workers import run_worker  # noqa: PLC0415 - a serial run must not need an MPI library

        return run_worker(comm, compute, options)
    if sink is None:
        raise ValueError("sink is None on rank 0: give the object that stores the outcomes")
    schedule = Schedule(tuple(batches))
    progress = progress or Progress()
    with nullcontext(stop_request) if stop_request is not None else StopRequest() as stop:
        master = _Master(schedule, sink, progress, stop, options, more)
        workers: Workers[CellT]
        if isinstance(where, Executor):
            workers = ExecutorWorkers(where, compute, options)
        elif comm is not None:
            from calcidem.sweep.mpi_workers import MPIWorkers  # noqa: PLC0415 - as above

            workers = MPIWorkers(comm, options, fault_tolerance_enabled())
        else:
            workers = SerialWorkers(compute, options.time_limit, master.go_on_here)
        progress.on_start(schedule.batches, workers=workers.count)
        end = master.run(workers)
    progress.on_end(end)
    return end


class _Master:
    """Hands out batches and stores their outcomes, for any kind of workers.

    Attributes
    ----------
    schedule
        Batches still to be handed out.
    sink, progress
        Receivers of the outcomes for storage and display.
    stop_request
        Signals received so far.
    options
        Limits.
    more
        Returns further batches for final outcomes.
    """

    def __init__(
        self,
        schedule: Schedule[Any],
        sink: Sink,
        progress: Progress,
        stop_request: StopRequest,
        options: SweepOptions,
        more: More[Any],
    ) -> None:
        self._schedule, self._sink, self._progress = schedule, sink, progress
        self._stop_request, self._options, self._more = stop_request, options, more
        self._next_heartbeat = 0.0

    def go_on_here(self) -> bool:
        """Send a heartbeat while this process computes; return whether it has to end at once."""
        self._beat(workers=1, running=1)
        return self._stop_request.hurry()

    def run(self, workers: Workers[CellT]) -> SweepEnd:
        """Have the batches computed and store their outcomes.

        Raises
        ------
        Exception
            Exceptions of the sink, after the workers were stopped.
        """
        start = time.monotonic()
        options = self._options
        tell_command("sweeping")
        try:
            commits: GroupCommit[CellT] = GroupCommit(self._sink, self._progress)
            with commits:
                state, detail = self._hand_out_all(workers, commits)
                tell_command("pause")  # stores waiting outcomes
        except BaseException as error:
            workers.stop(SweepEnd(SweepState.ERROR, detail=str(error)), options.hurry_grace)
            raise
        end = SweepEnd(state, detail, self._schedule.tally, time.monotonic() - start)
        grace = options.hurry_grace if self._stop_request.hurry() else options.stop_grace
        return replace(end, unresponsive_ranks=workers.stop(end, grace))

    def _hand_out_all(self, workers: Workers[CellT], commits: GroupCommit[CellT]) -> tuple[SweepState, str]:
        """Hand out batches and receive outcomes until there is a reason to end; return it."""
        backoff = Backoff()
        while True:
            level = self._stop_request.level  # taken first, so that the last round includes everything
            outcomes, losses = workers.poll()
            settled = [self._schedule.settle(outcome) for outcome in outcomes]
            self._take_in([outcome for outcome in settled if outcome is not None], commits)
            if isinstance(workers, SerialWorkers):
                commits.flush()  # the storing thread would compete with this computing one for the interpreter
            handed_out = not commits.is_full and self._hand_out(workers)
            commits.advance()
            self._account_for(losses, commits)

            if (end := self._reason_to_end(workers, level)) is not None:
                return end
            self._beat(workers.count, min(workers.running, workers.count))  # others wait in the executor's queue
            if outcomes or handed_out or losses:
                backoff.reset()
            backoff.sleep()

    def _take_in(self, outcomes: Sequence[BatchOutcome[CellT, Any]], commits: GroupCommit[CellT]) -> None:
        """Queue final outcomes for storage, and the further batches that they need."""
        if further := self._schedule.extend(self._more(outcomes)):
            self._progress.on_further(further)
        commits.add(*outcomes)

    def _beat(self, workers: int, running: int) -> None:
        if time.monotonic() > self._next_heartbeat:
            self._next_heartbeat = time.monotonic() + _HEARTBEAT_INTERVAL
            tell_command("beat")
            self._sink.keep_alive()
            self._progress.on_heartbeat(workers=workers, running=running)

    def _hand_out(self, workers: Workers[CellT]) -> bool:
        """Submit batches as long as workers accept them; return whether any was submitted."""
        handed_out = False
        while self._stop_request.level is StopLevel.NONE and workers.wants_batch:
            batch = self._schedule.take()
            if batch is None:
                break
            workers.submit(batch)
            handed_out = True
        return handed_out

    def _account_for(self, losses: list[Loss[CellT]], commits: GroupCommit[CellT]) -> None:
        """Store the losses of workers and of their batches."""
        for loss in losses:
            self._progress.on_loss(loss.place, loss.reason)
            batch = loss.batch
            # At an urgent end workers may die of the same signal, so their cells do not count a loss.
            if batch is None or self._stop_request.hurry():
                continue
            for _ in range(loss.workers):
                batch = batch.with_another_loss()
                commits.add_loss(batch, loss.reason)
            self._schedule.tally.lost_workers += loss.workers
            outcome: BatchOutcome[CellT, Any] | None = self._schedule.lose(batch, loss.reason, loss.place, loss.seconds)
            if outcome is not None:
                self._take_in([outcome], commits)

    def _reason_to_end(self, workers: Workers[CellT], level: StopLevel) -> tuple[SweepState, str] | None:
        """Return why the sweep is over, or None if it isn't."""
        asked_by = self._stop_request.explanation
        if workers.running == 0 and len(self._schedule) == 0:
            return SweepState.COMPLETE, ""
        if level is StopLevel.HURRY:
            return SweepState.STOPPED, f"{asked_by}: running batches were dropped"
        if level is StopLevel.DRAIN and workers.running == 0:
            return SweepState.STOPPED, f"{asked_by}: running batches were finished"
        if workers.exhausted:
            return SweepState.OUT_OF_WORKERS, f"{workers.exhausted}; run the same command again to continue"
        return None
