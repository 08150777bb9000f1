import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest

from calcidem.ends import CellStatus
from calcidem.sweep.run import run_sweep
from calcidem.sweep.schedule import EXIT_RESUMABLE, Batch, Progress, StopRequest, SweepState, plan_batches

if TYPE_CHECKING:
    from conftest import MemorySink

Compute = Callable[[Batch[int], Callable[[], None]], Sequence[int]]


def square(batch: Batch[int], raise_if_stopped: Callable[[], None]) -> list[int]:
    """Compute something cheap."""
    raise_if_stopped()
    return [cell * cell for cell in batch.cells]


def refuse_seven(batch: Batch[int], raise_if_stopped: Callable[[], None]) -> list[int]:
    """Fail for one cell."""
    if 7 in batch.cells:
        raise ArithmeticError("seven is not supported")
    return square(batch, raise_if_stopped)


def wait_signalled_at(cell: int, number: signal.Signals) -> Compute:
    """Give `wait` during which this process gets a signal when this cell is computed."""

    def compute(batch: Batch[int], raise_if_stopped: Callable[[], None]) -> Sequence[int]:
        if cell in batch.cells:
            os.kill(os.getpid(), number)
        return wait(batch, raise_if_stopped)

    return compute


def wait(batch: Batch[int], raise_if_stopped: Callable[[], None]) -> Sequence[int]:
    """Take half a second for each batch, in chunks."""
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        raise_if_stopped()
        time.sleep(0.01)
    return batch.cells


BATCHES = (Batch((1, 2, 3)), Batch((6, 7, 8)), Batch((10,)))


class Cancelled(Progress):
    """Raises at the fifth heartbeat, two seconds after the first."""

    def __init__(self, error: BaseException) -> None:
        self.error, self.beats = error, 0

    def on_heartbeat(self) -> None:
        """Raise once."""
        self.beats += 1
        if self.beats == 5:
            raise self.error


@pytest.mark.parametrize("error", [RuntimeError("cancelled"), SystemExit(3), KeyboardInterrupt()])
def test_an_error_of_the_display_ends_the_sweep_and_fails_no_cell(sink: "MemorySink", error: BaseException) -> None:
    """Also within a batch of one cell: the batch is dropped, and the same call would compute it."""

    def wait_longer(batch: Batch[int], raise_if_stopped: Callable[[], None]) -> Sequence[int]:
        for _ in range(3):
            wait(batch, raise_if_stopped)
        return batch.cells

    with pytest.raises(type(error)):
        run_sweep(None, [Batch((cell,)) for cell in range(3)], wait_longer, sink, progress=Cancelled(error))
    assert [outcome.batch.cells for outcome in sink.outcomes] == [(0,)]
    assert sink.results() == {0: 0}


def test_all_cells_are_computed_and_stored(sink: "MemorySink") -> None:
    """Without a communicator the sweep computes in this process, in the order given."""
    end = run_sweep(None, BATCHES, square, sink)
    assert end.state is SweepState.COMPLETE
    assert end.exit_code == 0
    assert sink.results() == {1: 1, 2: 4, 3: 9, 6: 36, 7: 49, 8: 64, 10: 100}
    assert [outcome.batch for outcome in sink.outcomes] == [*BATCHES]


def test_an_exception_costs_only_its_cell(sink: "MemorySink") -> None:
    """The company of a bad cell is computed again without it; the bad cell keeps its traceback."""
    end = run_sweep(None, BATCHES, refuse_seven, sink)
    assert end.exit_code == 0
    assert sink.results() == {1: 1, 2: 4, 3: 9, 6: 36, 8: 64, 10: 100}
    (failure,) = [outcome for outcome in sink.outcomes if outcome.failure is not None]
    assert failure.batch.cells == (7,)
    assert failure.failure is not None
    assert failure.failure.kind is CellStatus.FAILED
    assert failure.failure.message == "ArithmeticError: seven is not supported"
    assert "refuse_seven" in failure.failure.traceback
    assert end.tally[CellStatus.FAILED] == 1


def test_exit_is_a_failure_of_the_cell(sink: "MemorySink") -> None:
    """A computation that calls sys.exit does not end the program."""
    end = run_sweep(None, [Batch((1,))], lambda _batch, _check: sys.exit(1), sink)
    assert end.tally[CellStatus.FAILED] == 1


def test_a_wrong_number_of_results_is_a_failure(sink: "MemorySink") -> None:
    """Two results for one cell are refused and counted."""
    run_sweep(None, [Batch((1,))], lambda _batch, _check: [1, 1], sink)
    failure = sink.outcomes[0].failure
    assert failure is not None
    assert "2 results for 1 cells" in failure.message


def test_the_time_limit_is_a_failure_of_the_batch(sink: "MemorySink") -> None:
    """A batch that asks after its time is up becomes timed out."""
    end = run_sweep(None, [Batch((1, 2))], wait, sink, time_limit=0.05)
    assert end.tally[CellStatus.TIMED_OUT] == 2
    failure = sink.outcomes[0].failure
    assert failure is not None
    assert failure.kind is CellStatus.TIMED_OUT
    assert "0.05 s" in failure.message


def test_sigusr1_finishes_the_running_batch(sink: "MemorySink") -> None:
    """SIGUSR1 stores the running batch and ends with 75."""
    end = run_sweep(None, BATCHES, wait_signalled_at(1, signal.SIGUSR1), sink)
    assert (end.state, end.exit_code) == (SweepState.STOPPED, 75)
    assert [outcome.batch for outcome in sink.outcomes] == [BATCHES[0]]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGUSR2])
def test_urgent_signals_drop_the_running_batch(sink: "MemorySink", number: signal.Signals) -> None:
    """SIGTERM, SIGINT and SIGUSR2 end within one chunk of work and keep what was stored before."""
    end = run_sweep(None, BATCHES, wait_signalled_at(6, number), sink)
    assert (end.state, end.exit_code) == (SweepState.STOPPED, 75)
    assert [outcome.batch for outcome in sink.outcomes] == [BATCHES[0]]


def test_a_signal_in_the_last_batch_leaves_a_complete_sweep(sink: "MemorySink") -> None:
    """Nothing is left to resume, so the exit code is 0."""
    assert run_sweep(None, [Batch((1,))], wait_signalled_at(1, signal.SIGUSR1), sink).exit_code == 0


def test_handlers_are_put_back(sink: "MemorySink") -> None:
    """After a sweep the signals do what they did before."""
    before = [signal.getsignal(number) for number in (signal.SIGUSR1, signal.SIGTERM, signal.SIGINT)]
    run_sweep(None, BATCHES, square, sink)
    after = [signal.getsignal(number) for number in (signal.SIGUSR1, signal.SIGTERM, signal.SIGINT)]
    assert before == after


def test_an_error_of_the_sink_is_passed_on() -> None:
    """A full disk ends the sweep with the sink's own exception."""

    class FullDisk:
        def store(self, _outcomes: object) -> None:
            raise OSError(28, "No space left on device")

        def keep_alive(self) -> None:
            """Do nothing."""

        def mark(self, _batches: object) -> None: ...

    with pytest.raises(OSError, match="No space left"):
        run_sweep(None, BATCHES, square, FullDisk())


def test_a_batch_is_marked_before_it_is_computed(sink: "MemorySink") -> None:
    """If the process dies meanwhile, the next run knows which cells it was computing."""
    marked: list[list[Batch[int]]] = []

    def compute(batch: Batch[int], _check: Callable[[], None]) -> tuple[int, ...]:
        marked.append(list(sink.marked))
        return batch.cells

    run_sweep(None, BATCHES, compute, sink)
    assert marked == [[*BATCHES[:1]], [*BATCHES[:2]], [*BATCHES]]


def test_a_serial_sweep_loads_no_mpi_library() -> None:
    """The package and a sweep in one process work where no MPI library is installed."""
    program = """
import sys
from calcidem.sweep.schedule import Batch
from calcidem.sweep.ranks import run_on_ranks
from calcidem.sweep.run import run_sweep

class Sink:
    def store(self, outcomes): pass
    def mark(self, batches): pass
    def keep_alive(self): pass

def lead(executor, stop):
    assert executor is None
    return run_sweep(None, [Batch((1,))], lambda batch, check: batch.cells, Sink(), stop_request=stop).exit_code

code = run_on_ranks(lead)
assert "mpi4py" not in sys.modules
sys.exit(code)
"""
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_a_second_urgent_signal_ends_the_process_at_once() -> None:
    """SIGTERM during a chunk that never asks, then SIGTERM again: the process ends with 75."""
    program = """
import os, signal, time
from calcidem.sweep.schedule import Batch
from calcidem.sweep.run import run_sweep

class Sink:
    def store(self, outcomes): pass
    def mark(self, batches): pass
    def keep_alive(self): pass

def never_ask(batch, check):
    for seconds in (1.3, 30.0):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(seconds)

run_sweep(None, [Batch((1,))], never_ask, Sink())
"""
    start = time.monotonic()
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 75
    assert time.monotonic() - start < 10.0


def test_sweeps_in_several_threads_do_not_meet(sink: "MemorySink") -> None:
    """Each computes its own cells, though all compute in this process at the same time."""
    both = threading.Barrier(2, timeout=30.0)

    def sweep(name: str) -> tuple[list[str], SweepState]:
        def compute(batch: Batch[int], _check: Callable[[], None]) -> list[str]:
            both.wait()
            return [name] * len(batch.cells)

        own = type(sink)()
        end = run_sweep(None, [Batch((cell,)) for cell in range(5)], compute, own, stop_request=StopRequest())
        return list(own.results().values()), end.state

    with ThreadPoolExecutor(2) as threads:
        found = list(threads.map(sweep, ("one", "other")))
    assert found == [([name] * 5, SweepState.COMPLETE) for name in ("one", "other")]


def test_a_sweep_within_a_sweep_leaves_it_its_computation(sink: "MemorySink") -> None:
    """A program may run another one, such as from the function that it is told the progress with."""
    inner = type(sink)()

    class Curious(Progress):
        def on_outcome(self, _outcome: object) -> None:
            if not inner.outcomes:
                run_sweep(None, [Batch((1,))], lambda _batch, _check: ["inner"], inner, stop_request=StopRequest())

    run_sweep(None, BATCHES, square, sink, progress=Curious())
    assert inner.results() == {1: "inner"}
    assert sink.results() == {cell: cell * cell for batch in BATCHES for cell in batch.cells}


def test_a_plan_can_be_swept(sink: "MemorySink") -> None:
    """Cells of a campaign go through a plan and a sweep and come out complete."""
    cells = [(seed, content) for seed in range(5) for content in (0.0, 9.0)]
    plan = plan_batches(cells, 4, lambda content: 1.0 + content)
    run_sweep(None, plan, lambda batch, _: [seed + content for seed, content in batch.cells], sink)
    assert sink.results() == {(seed, content): seed + content for seed, content in cells}


def ask_to_end(batch: Batch[int], _raise_if_stopped: Callable[[], None]) -> Sequence[int]:
    """Compute while Slurm says that the time is nearly up."""
    os.kill(os.getpid(), signal.SIGUSR1)
    time.sleep(0.2)
    return batch.cells


@pytest.mark.parametrize("count", [3, 9])
def test_batches_that_a_signal_took_back_are_not_complete(count: int, sink: "MemorySink") -> None:
    """Also when all are handed out already: the sweep has stopped, so that the same command continues."""
    with ThreadPoolExecutor(1) as executor:
        end = run_sweep(executor, [Batch((number,)) for number in range(count)], ask_to_end, sink)
    assert (end.state, end.exit_code) == (SweepState.STOPPED, EXIT_RESUMABLE)
    assert len(sink.results()) < count
