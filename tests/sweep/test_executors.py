"""Any executor computes a sweep: the same results, failures, quarantine and resumption as in one process."""

import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import (
    CancelledError,
    Executor,
    Future,
    InvalidStateError,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import pytest

from calcidem.ends import CellStatus
from calcidem.sweep.run import _Master, run_sweep
from calcidem.sweep.schedule import (
    LOSSES_BEFORE_QUARANTINE,
    Batch,
    BatchOutcome,
    Progress,
    StopRequest,
    SweepError,
    SweepInterrupted,
    SweepState,
    plan_batches,
)
from calcidem.sweep.workers import Workers

if TYPE_CHECKING:
    from conftest import MemorySink

CELLS = [(seed, content) for seed in range(8) for content in (0.0, 5.0)]
BAD_CELL = (3, 5.0)


@dataclass(frozen=True)
class Fault:
    """Squares cells, but misbehaves at one; notes in a folder each process that unpickles it."""

    kind: str
    folder: Path

    def __call__(self, batch: Batch[tuple[int, float]], raise_if_stopped: Callable[[], None]) -> list[Any]:
        """Compute a batch."""
        time.sleep(0.01)
        if BAD_CELL in batch.cells:
            if self.kind == "raise":
                raise ArithmeticError("on order")
            if self.kind == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            if self.kind == "unpicklable":
                return [threading.Lock() for _ in batch.cells]
            while self.kind == "slow":
                raise_if_stopped()
                time.sleep(0.01)
            while self.kind == "stuck":
                time.sleep(1.0)
        return [seed * content for seed, content in batch.cells]

    def __reduce__(self) -> tuple[object, ...]:
        """Be made anew by the process that computes."""
        return (_unpickle, (self.kind, self.folder))


def _unpickle(kind: str, folder: Path) -> Fault:
    with (folder / f"unpickled-{os.getpid()}").open("a") as file:
        file.write("once\n")
    if kind == "missing":
        raise ModuleNotFoundError("No module named 'calcidem'")
    return Fault(kind, folder)


def planned(done: "MemorySink | None" = None) -> tuple[Batch[tuple[int, float]], ...]:
    """Batches of what is left to do, as a campaign plans them after a restart."""
    settled: set[Any] = {cell for outcome in done.outcomes for cell in outcome.batch.cells} if done else set()
    losses = Counter(cell for batch in done.marked for cell in batch.cells) if done else Counter()
    pending = {cell for cell in set(CELLS) - settled if losses[cell] < LOSSES_BEFORE_QUARANTINE}
    return plan_batches(pending, 2, lambda content: 1.0 + content, losses)


def processes() -> ProcessPoolExecutor:
    """Make a pool of two processes that share nothing with this one."""
    return ProcessPoolExecutor(2, mp_context=get_context("forkserver"))


EXPECTED = {(seed, content): seed * content for seed, content in CELLS}


def test_processes_unpickle_the_computation_once(sink: "MemorySink", tmp_path: Path) -> None:
    """All results come, from processes that are told apart, and each has loaded the computation a single time."""
    with processes() as pool:
        end = run_sweep(pool, planned(), Fault("", tmp_path), sink)
    assert end.state is SweepState.COMPLETE
    assert sink.results() == EXPECTED
    notes = list(tmp_path.glob("unpickled-*"))
    assert all(note.read_text() == "once\n" for note in notes)
    assert {outcome.rank for outcome in sink.outcomes} == set(range(1, len(notes) + 1))


def test_a_worker_of_many_sweeps_watches_its_master_once(sink: "MemorySink", tmp_path: Path) -> None:
    """Studies give one pool a computation after another: none of them leaves a thread and an open file."""
    with ProcessPoolExecutor(1, mp_context=get_context("forkserver")) as pool:
        for name in ("first", "second", "third"):
            assert run_sweep(pool, planned(), Fault(name, tmp_path), sink).state is SweepState.COMPLETE
        assert pool.submit(_watchers).result() <= 1  # none without pidfd_open
    (notes,) = tmp_path.glob("unpickled-*")
    assert notes.read_text() == 3 * "once\n"


def _watchers() -> int:
    return sum(thread.name == "watch-master" for thread in threading.enumerate())


@pytest.mark.parametrize("kind", ["raise", "unpicklable", "slow"])
def test_a_failure_on_an_executor_is_that_of_a_serial_run(sink: "MemorySink", tmp_path: Path, kind: str) -> None:
    """An exception or a result that cannot be pickled costs its cell, a time limit its batch."""
    with ThreadPoolExecutor(2) as pool:
        end = run_sweep(pool, planned(), Fault(kind, tmp_path), sink, time_limit=0.2)
    assert end.exit_code == 0
    failed = [outcome for outcome in sink.outcomes if outcome.failure is not None]
    cells = {cell for outcome in failed for cell in outcome.batch.cells}
    assert cells == ({(2, 5.0), BAD_CELL} if kind == "slow" else {BAD_CELL})
    assert failed[0].failure is not None
    assert failed[0].failure.kind is (CellStatus.TIMED_OUT if kind == "slow" else CellStatus.FAILED)
    assert sink.results() == {cell: value for cell, value in EXPECTED.items() if cell not in cells}


@pytest.mark.full
def test_a_cell_that_kills_processes_is_left_out_by_the_fourth_call(sink: "MemorySink", tmp_path: Path) -> None:
    """Each lost process ends its pool and the sweep as resumable; the fourth call at the latest has all the rest."""
    for _ in range(4):
        with processes() as pool:
            end = run_sweep(pool, planned(sink), Fault("kill", tmp_path), sink)
        if end.state is SweepState.COMPLETE:
            break
        assert (end.state, end.exit_code) == (SweepState.CUT_OFF, 75)
        assert "a worker was lost" in end.detail
    assert end.state is SweepState.COMPLETE
    assert sink.results() == {cell: value for cell, value in EXPECTED.items() if cell != BAD_CELL}


def test_workers_that_cannot_load_the_computation_end_the_sweep(sink: "MemorySink", tmp_path: Path) -> None:
    """No cell is to blame for a library that is missing; the error says what to install."""
    with ThreadPoolExecutor(1) as pool, pytest.raises(SweepError, match="install the same calcidem"):
        run_sweep(pool, planned(), Fault("missing", tmp_path), sink)
    assert not sink.outcomes


@dataclass
class KilledWorker(Exception):  # noqa: N818 - as Dask calls it
    """What Dask says of a task that has lost several workers."""

    allowed_failures: int = 3


@dataclass
class Scripted(Executor):
    """Computes at once, but answers as told wherever the bad cell is."""

    answer: Callable[[], Exception | None]
    sizes: list[int] = field(default_factory=list)
    with_computation: int = 0

    def submit(self, fn: Callable[..., Any], /, *arguments: Any, **_options: Any) -> "Future[Any]":  # noqa: ANN401 - as it is
        """Compute, or not."""
        future: Future[Any] = Future()
        self.with_computation += arguments[1] is not None
        batch = arguments[2]
        if BAD_CELL in batch.cells:
            self.sizes.append(len(batch.cells))
            if (error := self.answer()) is not None:
                future.set_exception(error)
                return future
            if self.answer is hang:
                future.set_running_or_notify_cancel()
                return future
        future.set_result(fn(*arguments))
        return future

    def __enter__(self) -> Self:
        """Begin."""
        return self


def hang() -> None:
    """Stand for an answer that does not come."""


def test_a_cell_that_kills_the_workers_of_dask_is_quarantined_alone(sink: "MemorySink", tmp_path: Path) -> None:
    """Dask goes on without the workers that a batch took down; its company is computed."""
    end = run_sweep(Scripted(KilledWorker), planned(), Fault("", tmp_path), sink)
    assert end.state is SweepState.COMPLETE
    assert end.tally[CellStatus.QUARANTINED] == 1
    assert sink.results() == {cell: value for cell, value in EXPECTED.items() if cell != BAD_CELL}


@pytest.mark.parametrize("error", [ConnectionError, CancelledError, lambda: BrokenProcessPool("gone")])
def test_an_executor_that_is_gone_ends_the_sweep(
    error: Callable[[], Exception], sink: "MemorySink", tmp_path: Path
) -> None:
    """When its processes or its scheduler are gone the sweep ends as resumable, not as complete."""
    end = run_sweep(Scripted(error), planned(), Fault("", tmp_path), sink)
    assert (end.state, end.exit_code) == (SweepState.CUT_OFF, 75)
    assert BAD_CELL not in sink.results()


def test_a_batch_that_a_worker_dropped_is_not_complete(sink: "MemorySink", tmp_path: Path) -> None:
    """A signal that reaches a worker alone ends the sweep as stopped; it is no death, and blames no cell."""
    end = run_sweep(Scripted(SweepInterrupted), planned(), Fault("", tmp_path), sink)
    assert (end.state, end.exit_code) == (SweepState.STOPPED, 75)
    assert sink.results() == {cell: value for cell, value in EXPECTED.items() if cell not in {BAD_CELL, (2, 5.0)}}


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (CancelledError, "CancelledError"),
        (lambda: OSError("gone"), "OSError: gone"),
        (lambda: BrokenProcessPool("dead"), "BrokenProcessPool: dead"),
    ],
)
def test_the_loss_of_a_worker_is_named(
    sink: "MemorySink", tmp_path: Path, error: Callable[[], Exception], said: str
) -> None:
    """By the kind of the error, where it has no words, as those of Dask; a dead process blames its batch at once."""
    end = run_sweep(Scripted(error), planned(), Fault("", tmp_path), sink)
    assert end.state is SweepState.CUT_OFF
    assert end.detail.startswith(f"a worker was lost ({said});")
    # It died before the batch was seen to run; a scheduler that is gone tells nothing of what ran.
    blamed = {cell for batch in sink.marked for cell in batch.cells} - set(sink.results())
    assert blamed == ({BAD_CELL, (2, 5.0)} if said.startswith("Broken") else set())


def test_a_process_that_dies_during_a_submission_counts_too(sink: "MemorySink", tmp_path: Path) -> None:
    """The executor refuses the next batch, and the sweep ends: what ran is marked all the same."""

    class Dying(Executor):
        num_workers = 2
        futures: ClassVar[list[Future[Any]]] = []

        def submit(self, *_: Any, **__: Any) -> "Future[Any]":  # noqa: ANN401 - as it is
            if self.futures:
                self.futures[0].set_exception(BrokenProcessPool("dead"))
                raise BrokenProcessPool("dead")
            self.futures.append(Future())
            self.futures[0].set_running_or_notify_cancel()
            return self.futures[0]

    end = run_sweep(Dying(), planned(), Fault("", tmp_path), sink)
    assert end.state is SweepState.CUT_OFF
    assert sink.marked == [planned()[0]]


def test_all_is_stored_before_what_may_be_deadly_begins(
    sink: "MemorySink", tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However slow the disk is: a death must not be blamed on a cell that had ended."""
    stored: list[int] = []
    store = sink.store

    def store_slowly(outcomes: Sequence[BatchOutcome[Any, Any]]) -> None:
        time.sleep(0.3)
        store(outcomes)

    class Watched(ThreadPoolExecutor):
        def submit(self, function: Any, /, *arguments: Any, **keywords: Any) -> "Future[Any]":  # noqa: ANN401 - as it is
            if arguments[2].is_alone:
                stored.append(len(sink.outcomes))
            return super().submit(function, *arguments, **keywords)

    monkeypatch.setattr(sink, "store", store_slowly)
    batches = plan_batches(CELLS, 4, lambda _: 1.0, {(3, 5.0): 2, (4, 5.0): 2})
    with Watched(2) as pool:
        run_sweep(pool, batches, Fault("", tmp_path), sink)
    assert stored == [len(batches) - 2, len(batches) - 1]


@pytest.mark.full
def test_batches_that_wait_in_a_pool_do_not_hang(sink: "MemorySink") -> None:
    """A pool of one process calls three batches running; the last one waits for two that take nearly the limit."""
    with ProcessPoolExecutor(1, mp_context=get_context("forkserver")) as pool:
        end = run_sweep(pool, [Batch((number,)) for number in range(6)], _take_long, sink, time_limit=6.0)
    assert end.state is SweepState.COMPLETE
    assert len(sink.results()) == 6


def _take_long(batch: Batch[int], raise_if_stopped: Callable[[], None]) -> list[int]:
    for _ in range(59):
        raise_if_stopped()
        time.sleep(0.1)
    return list(batch.cells)


def test_a_worker_that_does_not_answer_ends_the_sweep(sink: "MemorySink", tmp_path: Path) -> None:
    """The sweep does not wait for ever, and names the cells."""
    end = run_sweep(Scripted(hang), planned(), Fault("", tmp_path), sink, silence_floor=0.1)
    assert (end.state, end.exit_code) == (SweepState.CUT_OFF, 75)
    assert str(BAD_CELL) in end.detail
    assert sink.results() == {cell: value for cell, value in EXPECTED.items() if cell not in {BAD_CELL, (2, 5.0)}}


def test_an_executor_without_workers_ends_the_sweep(sink: "MemorySink", tmp_path: Path) -> None:
    """Batches that nobody begins are not waited for for ever."""

    class Nobody(Executor):
        def submit(self, *_arguments: Any, **_keywords: Any) -> "Future[Any]":  # noqa: ANN401 - as it is
            return Future()

    end = run_sweep(Nobody(), planned(), Fault("", tmp_path), sink, silence_floor=0.05)
    assert end.state is SweepState.CUT_OFF
    assert "no worker has answered" in end.detail
    assert sink.marked == []


def test_workers_are_counted_by_their_answers(tmp_path: Path) -> None:
    """An executor that does not tell their number has those that answered in the last minute."""
    workers: Workers[tuple[int, float]] = Workers(Scripted(hang), Fault("", tmp_path), None, 300.0)
    now = time.monotonic()
    workers._last_answer = {("here", 1, 1, None): now, ("here", 2, 1, None): now, ("here", 3, 1, None): now - 61.0}
    assert workers.count == 2
    with ProcessPoolExecutor(5) as pool:
        assert Workers(pool, Fault("", tmp_path), None, 300.0).count == 5


def test_what_may_be_deadly_is_computed_alone(sink: "MemorySink", tmp_path: Path) -> None:
    """While a cell with two losses is computed, nothing else is in flight that could be blamed for a third."""
    together: list[int] = []

    class Watched(ThreadPoolExecutor):
        def submit(self, function: Any, /, *arguments: Any, **keywords: Any) -> "Future[Any]":  # noqa: ANN401 - as it is
            if arguments[2].losses > 1:
                together.append(sum(not future.done() for future in futures))
            futures.append(super().submit(function, *arguments, **keywords))
            return futures[-1]

    futures: list[Future[Any]] = []
    losses = {(3, 5.0): 2, (4, 5.0): 2, (5, 0.0): 1}
    with Watched(2) as pool:
        end = run_sweep(pool, plan_batches(CELLS, 2, lambda _: 1.0, losses), Fault("", tmp_path), sink)
    assert end.state is SweepState.COMPLETE
    assert together == [0, 0]
    assert sink.results() == EXPECTED


def test_the_heart_beats_twice_a_second() -> None:
    """However often the scheduler looks, whoever watches the run hears of it at this interval."""
    beats: list[float] = []
    sink: Any = SimpleNamespace(keep_alive=lambda: beats.append(time.monotonic()))
    nothing: Any = None  # is asked
    master = _Master(nothing, sink, Progress(), nothing, nothing)
    begun = time.monotonic()
    while len(beats) < 3:
        master._beat()
    assert beats[-1] - begun >= 1.0


def test_the_computation_travels_with_the_first_batches_only(sink: "MemorySink", tmp_path: Path) -> None:
    """Once a worker has answered, a batch is sent without the packing."""
    executor = Scripted(hang)
    batches = [batch for batch in planned() if BAD_CELL not in batch.cells]
    more = [Batch(((number, 1.0),)) for number in range(50)]
    run_sweep(executor, [*batches, *more], Fault("", tmp_path), sink)
    assert executor.with_computation < 20


class Reticent(Executor):
    """Two threads whose futures do not tell that they run, and are cancelled all the same, as those of Dask."""

    num_workers = 2

    def __init__(self, begun: Callable[[], object]) -> None:
        self._threads, self._begun = ThreadPoolExecutor(2), begun

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **_: Any) -> "Future[Any]":  # noqa: ANN401
        """Compute in a thread."""
        future: Future[Any] = Future()

        def compute() -> None:
            if not future.cancelled():
                self._begun()
                time.sleep(0.5)
                found = function(*arguments)
                with suppress(InvalidStateError):
                    future.set_result(found)

        self._threads.submit(compute)
        return future


def test_running_batches_are_finished_though_their_executor_does_not_tell(sink: "MemorySink", tmp_path: Path) -> None:
    """SIGUSR1 while two of eight batches run: both are stored, no other is begun."""
    begun: list[None] = []

    def note() -> None:
        begun.append(None)
        if len(begun) == 2:
            os.kill(os.getpid(), signal.SIGUSR1)

    with StopRequest() as stop:
        end = run_sweep(Reticent(note), planned(), Fault("", tmp_path), sink, stop_request=stop)
    assert end.state is SweepState.STOPPED
    assert (len(begun), len(sink.outcomes)) == (2, 2)


def test_a_finished_batch_does_not_tell_that_others_run(tmp_path: Path) -> None:
    """An answer that was not yet received says nothing of the batches that an executor keeps silent about."""
    futures: list[Future[Any]] = []

    class Silent(Executor):
        num_workers = 1

        def submit(self, *_: Any, **__: Any) -> "Future[Any]":  # noqa: ANN401
            futures.append(Future())
            return futures[-1]

    workers = Workers(Silent(), Fault("", tmp_path), None, 300.0)
    batches = planned()[:4]
    for batch in batches:
        workers.submit(batch)
    futures[0].set_result(b"")
    assert workers.begun() == [batches[0]]
    assert workers.cancel(finishes=True) == [*batches[2:]]
    assert workers.cancel(finishes=True) == []
    assert workers.cancel() == [batches[1]]


@pytest.mark.full
def test_a_cell_that_kills_workers_of_a_real_cluster_is_quarantined(sink: "MemorySink", tmp_path: Path) -> None:
    """Nannies replace three killed workers; the deadly cell is given up and all others are computed, in one sweep."""
    distributed, dask = pytest.importorskip("distributed"), pytest.importorskip("dask")
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),  # a new worker takes seconds to start
        distributed.LocalCluster(**options) as cluster,
        distributed.Client(cluster) as client,
    ):
        end = run_sweep(client.get_executor(), planned(), Fault("kill", tmp_path), sink)
    assert end.state is SweepState.COMPLETE
    failures = {cell: o.failure.kind for o in sink.outcomes if o.failure is not None for cell in o.batch.cells}
    assert failures == {BAD_CELL: CellStatus.QUARANTINED}
    assert sink.results() == {cell: value for cell, value in EXPECTED.items() if cell != BAD_CELL}
