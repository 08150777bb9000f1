"""`run_sweep`: compute all batches; a separate thread stores outcomes in groups, so no worker waits for the disk."""

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import nullcontext, suppress
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeAlias

from calcidem.sweep.schedule import (
    IS_INTERRUPTED,
    Batch,
    BatchOutcome,
    CellT,
    Compute,
    Progress,
    ResultT,
    Schedule,
    StopLevel,
    StopRequest,
    SweepEnd,
    SweepState,
)
from calcidem.sweep.workers import ThisProcess, Workers


class Sink(Protocol):
    """Receiver of the outcomes of a sweep, given by its caller; its storing methods run on a separate thread.

    An outcome counts as stored once `store` has returned, so it must be on disk by then. After a kill a stored batch
    may be computed again, so storing twice must have the same effect as storing once. An exception of the sink ends the
    sweep and is raised again.
    """

    def store(self, outcomes: Sequence[BatchOutcome[Any, Any]], /) -> None:
        """Store one or several final outcomes."""

    def mark(self, batches: Sequence[Batch[Any]], /) -> None:
        """Store that these batches are being computed.

        A mark without an outcome tells the next run that this one died meanwhile; it counts for `Batch.losses`.
        """

    def keep_alive(self) -> None:
        """Called on the main thread twice a second during the sweep; must not wait for a stored outcome."""


class GroupCommit(Generic[CellT]):
    """Stores marks and final outcomes on a separate thread, in the order given, and shows outcomes once stored.

    Outcomes that arrive while a group is stored form the next group. As a context manager it stores the remaining
    outcomes on exit, unless the sink has failed. The display receives only stored outcomes.
    """

    def __init__(self, sink: Sink, progress: Progress) -> None:
        self._sink, self._progress = sink, progress
        self._thread = ThreadPoolExecutor(1, "store")
        self._marks: list[Batch[CellT]] = []
        self._waiting: list[BatchOutcome[CellT, Any]] = []
        self._groups: deque[tuple[Future[None], list[BatchOutcome[CellT, Any]]]] = deque()
        self._next_begin = 0.0

    @property
    def is_full(self) -> bool:
        """Whether so many outcomes wait, some 200 kB each, that no more batches should be handed out."""
        return len(self._waiting) > 512

    def add(self, *outcomes: BatchOutcome[CellT, Any]) -> None:
        """Queue outcomes for the next group."""
        self._waiting.extend(outcomes)

    def mark(self, *batches: Batch[CellT]) -> None:
        """Queue marks of batches that are being computed for the next group."""
        self._marks.extend(batches)

    def advance(self) -> None:
        """Show stored outcomes, and begin the next group if it is due; does not wait.

        Raises
        ------
        Exception
            Any exception of the sink; the waiting outcomes are dropped.
        """
        while self._groups and self._groups[0][0].done():
            self._acknowledge()
        if not self._groups and time.monotonic() >= self._next_begin:
            self._begin()

    def flush(self) -> None:
        """Return once all is stored and shown; raises the exceptions of `advance`."""
        self._begin()
        while self._groups:
            self._acknowledge()

    def _begin(self) -> None:
        """Let the thread store marks and waiting outcomes after the previous group."""
        if self._waiting or self._marks:
            # 0.1 s: a transaction costs as much as the rows of two or three batches.
            self._next_begin = time.monotonic() + 0.1
            group, self._waiting = self._waiting, []
            marks, self._marks = self._marks, []
            self._groups.append((self._thread.submit(self._store, marks, group), group))

    def _store(self, marks: Sequence[Batch[CellT]], outcomes: Sequence[BatchOutcome[CellT, Any]]) -> None:
        """Store marks before outcomes, which complete them."""
        if marks:
            self._sink.mark(marks)
        if outcomes:
            self._sink.store(outcomes)

    def _acknowledge(self) -> None:
        """Wait for the oldest group; show its outcomes."""
        stored, group = self._groups.popleft()
        try:
            stored.result()
        except BaseException:
            self._waiting.clear()
            self._groups.clear()
            self._thread.shutdown(wait=False, cancel_futures=True)
            raise
        for outcome in group:
            self._progress.on_outcome(outcome)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Store the waiting outcomes; a pending error is raised first."""
        with self._thread, suppress(*(() if error is None else (Exception,))):
            self.flush()


More: TypeAlias = Callable[[Sequence[BatchOutcome[CellT, Any]]], Iterable[Batch[CellT]]]


def run_sweep(  # noqa: PLR0913 - each is another side of a sweep
    executor: Executor | None,
    batches: Iterable[Batch[CellT]],
    compute: Compute[CellT, ResultT],
    sink: Sink,
    *,
    time_limit: float | None = None,
    silence_floor: float = 300.0,
    progress: Progress | None = None,
    stop_request: StopRequest | None = None,
    more: More[CellT] = lambda _: (),
) -> SweepEnd:
    """Compute all batches and store their outcomes.

    `SweepError` if the workers of an executor cannot load the computation. Exceptions of the sink are raised after the
    waiting batches were cancelled.

    Parameters
    ----------
    executor
        Executor whose workers compute; None for this process. It is left open.
    batches
        Batches in the order of computation.
    compute
        Computes a batch. `Compute` states its conditions. For an executor it is pickled once, and each process
        unpickles it once.
    sink
        Stores the outcomes.
    time_limit, silence_floor
        Limits of a batch in s, above 0, see `Workers`.
    progress
        Display; silent by default.
    stop_request
        Signals received since the start of the program; by default signals count only during the sweep.
    more
        Returns further batches for new final outcomes. Used on the main thread, before these outcomes are stored.

    Returns
    -------
    SweepEnd
        How the sweep ended, with the `exit_code` of the program.
    """
    schedule = Schedule(tuple(batches))
    progress = progress or Progress()
    with nullcontext(stop_request) if stop_request is not None else StopRequest() as stop:
        master = _Master(schedule, sink, progress, stop, more)
        here = IS_INTERRUPTED.set(master.has_to_end) if executor is None else None
        try:
            workers: Workers[CellT] = Workers(executor or ThisProcess(), compute, time_limit, silence_floor)
            progress.on_start(schedule.batches, workers=workers.count)
            end = master.run(workers)
        finally:
            if here is not None:
                IS_INTERRUPTED.reset(here)
    progress.on_end(end)
    return end


class _Master:
    """Hands out batches of a schedule, and stores and shows their outcomes, until all are final or it has to end.

    ``more`` returns further batches for final outcomes.
    """

    def __init__(
        self, schedule: Schedule[Any], sink: Sink, progress: Progress, stop_request: StopRequest, more: More[Any]
    ) -> None:
        self._schedule, self._sink, self._progress = schedule, sink, progress
        self._stop_request, self._more = stop_request, more
        self._next_heartbeat = 0.0
        self._error: BaseException | None = None

    def has_to_end(self) -> bool:
        """Send a heartbeat while this process computes; return whether it has to end at once.

        An error of the heartbeat is none of the batch: it drops the batch, and ends the sweep after it.
        """
        try:
            self._beat()
        except (Exception, SystemExit) as error:  # noqa: BLE001 - raised again
            self._error = error
        return self._error is not None or self._stop_request.hurry()

    def run(self, workers: Workers[CellT]) -> SweepEnd:
        """Have the batches computed and store their outcomes.

        Raises
        ------
        Exception
            Exceptions of the sink, after the waiting batches were cancelled.
        """
        start = time.monotonic()
        try:
            commits: GroupCommit[CellT] = GroupCommit(self._sink, self._progress)
            with commits:
                state, detail = self._hand_out_all(workers, commits)
        finally:
            workers.cancel()
        return SweepEnd(state, detail, self._schedule.tally, time.monotonic() - start)

    def _hand_out_all(self, workers: Workers[CellT], commits: GroupCommit[CellT]) -> tuple[SweepState, str]:
        """Hand out batches and receive outcomes until there is a reason to end; return it."""
        while True:
            level = self._stop_request.level  # taken first, so that the last round includes everything
            outcomes = workers.poll(wait=0.02 if workers.running else 0.0)  # s, in which a signal is noticed
            if self._error is not None:
                raise self._error
            settled = [self._schedule.settle(outcome) for outcome in outcomes]
            final = [outcome for outcome in settled if outcome is not None]
            self._schedule.extend(self._more(final))
            commits.add(*final)
            if not commits.is_full:
                self._hand_out(workers, commits)
            # Marks of batches that are computed again, too: their cells are in flight until then.
            commits.mark(*workers.begun())
            commits.advance()
            if level is not StopLevel.NONE:
                self._schedule.extend(workers.cancel(finishes=level is StopLevel.DRAIN))
            if (end := self._reason_to_end(workers, level)) is not None:
                return end
            self._beat()

    def _beat(self) -> None:
        if time.monotonic() > self._next_heartbeat:
            self._next_heartbeat = time.monotonic() + 0.5
            self._sink.keep_alive()
            self._progress.on_heartbeat()

    def _hand_out(self, workers: Workers[CellT], commits: GroupCommit[CellT]) -> None:
        """Submit batches as long as workers accept them."""
        while self._stop_request.level is StopLevel.NONE and workers.wants_batch:
            batch = self._schedule.take(beside=workers.running)
            if batch is None:
                break
            # All is stored before what this process computes, since nothing else happens meanwhile, and before what may
            # take it down.
            is_marked = workers.are_here or batch.is_alone
            if is_marked:
                commits.mark(batch)
                commits.flush()
            workers.submit(batch, is_marked=is_marked)

    def _reason_to_end(self, workers: Workers[CellT], level: StopLevel) -> tuple[SweepState, str] | None:
        """Return why the sweep is over, or None if it isn't."""
        asked_by = self._stop_request.explanation
        is_over = workers.running == 0 and len(self._schedule) == 0 and not workers.exhausted
        since_drop = 0.0 if workers.last_dropped is None else time.monotonic() - workers.last_dropped
        end: tuple[SweepState, str] | None = None
        if is_over and workers.last_dropped is None:
            end = SweepState.COMPLETE, ""
        elif level is StopLevel.LOST:
            end = SweepState.CUT_OFF, asked_by
        elif level is StopLevel.HURRY:
            end = SweepState.STOPPED, f"{asked_by}: running batches were dropped"
        elif level is StopLevel.DRAIN and workers.running == 0 and not workers.exhausted:
            end = SweepState.STOPPED, f"{asked_by}: running batches were finished"
        elif is_over and since_drop > 1.0:  # s, in which the same signal usually reaches this process, too
            end = SweepState.STOPPED, "a worker was asked to end, and dropped its batches"
        elif workers.exhausted:
            end = SweepState.CUT_OFF, f"{workers.exhausted}; the same command or call continues"
        return end
