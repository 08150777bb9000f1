"""One rank of a sweep whose workers sleep and return real outcomes, which a real master stores in a real database.

Started by run.py under mpirun; rank 0 prints what the sweep has cost as JSON.
"""

import argparse
import json
import random
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from typing import Any

from calcidem.app.campaign.run import StoreSink
from calcidem.storage.records import CellKey, CellResult
from calcidem.storage.sql.store import Store
from calcidem.sweep.ranks import run_on_ranks
from calcidem.sweep.run import run_sweep
from calcidem.sweep.schedule import Batch, BatchOutcome, Cell, StopRequest

CELLS = 8
"""Cells in a batch, as in a campaign on processors with AVX-512."""

CONTENT = 5.0

SPREAD = 0.5
"""Batches take their mean time up to so much less or more, all values alike: cheap and expensive contents."""


@dataclass(frozen=True)
class Group:
    """What one call of the sink has cost: batches, CPU time of its thread, its waiting for a core, and all of it, s."""

    batches: int
    cpu: float
    queue: float
    wall: float


class TimedSink:
    """A sink that notes what the one behind it costs; without one it keeps nothing."""

    def __init__(self, sink: StoreSink | None) -> None:
        self._sink = sink
        self.groups: list[Group] = []

    def mark(self, batches: Sequence[Batch[Any]], /) -> None:
        """Mark batches as being computed, and note the cost as that of a group of none."""
        if self._sink is not None:
            with self._noted(0):
                self._sink.mark(batches)

    def store(self, outcomes: Sequence[BatchOutcome[Any, Any]], /) -> None:
        """Store, and note the cost."""
        if self._sink is not None:
            with self._noted(len(outcomes)):
                self._sink.store(outcomes)

    def keep_alive(self) -> None:
        """Do nothing."""

    @contextmanager
    def _noted(self, batches: int) -> Iterator[None]:
        before, begin = thread_times(), time.perf_counter()
        yield
        wall = time.perf_counter() - begin
        cpu, queue = (later - earlier for later, earlier in zip(thread_times(), before, strict=True))
        self.groups.append(Group(batches, cpu, queue, wall))


@dataclass(frozen=True)
class Sleep:
    """A computation that takes as long as it is told."""

    times: Sequence[float]
    payload: tuple[CellResult, ...]

    def __call__(self, batch: Batch[Cell], raise_if_stopped: Callable[[], None]) -> Sequence[Any]:
        """Give outcomes after the batch's time, without a payload the cells themselves."""
        time.sleep(self.times[(batch.cells[0][0] - 100) // CELLS])  # see `numbered`
        raise_if_stopped()
        return moved(self.payload, batch) if self.payload else batch.cells


def thread_times() -> tuple[float, float]:
    """CPU time of this thread, and for how long it was ready and had no core, s (Linux)."""
    cpu, queue, _ = Path("/proc/thread-self/schedstat").read_text(encoding="ascii").split()
    return int(cpu) * 1e-9, int(queue) * 1e-9


def durations(batches: int, mean: float) -> list[float]:
    """Times of the batches, s: evenly spread around the mean in a random order that is always the same."""
    order = list(range(batches))
    random.Random(17).shuffle(order)
    return [mean * (1.0 + SPREAD * (2.0 * (position + 0.5) / batches - 1.0)) for position in order]


def real_outcomes(database: str) -> tuple[CellResult, ...]:
    """As many outcomes as a batch has, with cement and sections; the sections are kept of one seed, so others share them."""
    with Store(database, read_only=True) as store:
        store.use_campaign()
        stored = [result for result in store.results(with_arrays=True) if result.key.content > 0.0]
    sections = {result.key.content: result.section for result in stored if result.section is not None}
    complete = (replace(result, section=sections[result.key.content]) for result in stored)
    return tuple(islice(cycle(result.pack() for result in complete), CELLS))


def moved(payload: Sequence[CellResult], batch: Batch[Cell]) -> tuple[CellResult, ...]:
    """Outcomes as if they were those of a batch, but for the checksums of their arrays."""
    return tuple(replace(result, key=CellKey(*cell)) for result, cell in zip(payload, batch.cells, strict=True))


def open_sink(database: str, batches: Sequence[Batch[Cell]]) -> tuple[Store, StoreSink]:
    """Plan the cells of the batches, and become the one that writes them."""
    store = Store(database)
    store.use_campaign()
    store.acquire_lease()
    keys = [CellKey(*cell) for batch in batches for cell in batch.cells]
    store.extend([key.seed for key in keys], [CONTENT])
    return store, StoreSink(store, keys)


def numbered(count: int) -> list[Batch[Cell]]:
    """Batches of cells that the database does not have."""
    return [Batch(tuple((100 + CELLS * number + lane, CONTENT) for lane in range(CELLS))) for number in range(count)]


def lead(batches: int, seconds: float, database: str | None, executor: Executor | None, stop: StopRequest) -> int:
    """Sweep on the other ranks, and print what it has cost."""
    planned, payload = numbered(batches), real_outcomes(database) if database else ()
    store, stored = open_sink(database, planned) if database else (None, None)
    sink = TimedSink(stored)
    if executor is None:
        raise RuntimeError("there are no other ranks")
    begin, own = time.perf_counter(), time.process_time()
    end = run_sweep(executor, planned, Sleep(durations(batches, seconds), payload), sink, stop_request=stop)
    wall, cpu = time.perf_counter() - begin, time.process_time() - own
    sys.stdout.write(json.dumps({"wall": wall, "messages": cpu - sum(group.cpu for group in sink.groups)}) + "\n")
    if store is not None:
        lost = len(store.pending(contents=[CONTENT]))
        store.close()
        if lost:
            raise RuntimeError(f"{lost} cells were acknowledged and are not stored")
    return end.exit_code


def main() -> None:
    """Sweep."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--batches", type=int, required=True)
    parser.add_argument("--seconds", type=float, required=True, help="mean time of a batch")
    parser.add_argument("--database", help="where to store; without one, outcomes are empty and nothing is stored")
    options = parser.parse_args()
    sys.exit(run_on_ranks(partial(lead, options.batches, options.seconds, options.database)))


if __name__ == "__main__":
    main()
