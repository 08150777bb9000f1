"""A sweep of hashes with faults on order: what the tests start under the real mpirun.

The sink is an SQLite file with one commit for each group of outcomes. Every program started twice with the same
file continues where the first one ended.
"""

import argparse
import ctypes
import hashlib
import os
import signal
import sqlite3
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

from calcidem.sweep.ranks import run_on_ranks
from calcidem.sweep.run import run_sweep
from calcidem.sweep.schedule import (
    LOSSES_BEFORE_QUARANTINE,
    Batch,
    BatchOutcome,
    Cell,
    StopRequest,
    SweepState,
    plan_batches,
)

CONTENTS = (0.0, 2.55, 9.0)

BAD_CELL = (5, 2.55)
"""The cell that misbehaves on order."""

SCHEMA = """
create table if not exists cell (
    seed integer, content real, status text, value text, message text, rank integer, primary key (seed, content));
create table if not exists running (seed integer, content real, run integer);
"""


class Sink:
    """Keeps outcomes in an SQLite file; can be told to kill the master around the n-th commit."""

    def __init__(self, path: Path, die: str, die_at: int) -> None:
        self._connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)  # one thread at a time
        self._connection.execute("pragma journal_mode = wal")
        self._connection.execute("pragma synchronous = full")
        self._connection.executescript(SCHEMA)
        self._die, self._die_at, self._count = die, die_at, 0

    def settled(self) -> set[Cell]:
        """Return the cells that have a row."""
        return {(seed, content) for seed, content in self._connection.execute("select seed, content from cell")}

    def losses(self) -> dict[Cell, int]:
        """Return the number of runs that died while each cell was computed."""
        query = "select seed, content, count(distinct run) from running group by seed, content"
        return {(seed, content): count for seed, content, count in self._connection.execute(query)}

    def store(self, outcomes: Sequence[BatchOutcome[Cell, str]]) -> None:
        """Keep outcomes in one transaction."""
        self._count += 1
        self._perhaps_die("before")
        self._connection.execute("begin immediate")
        for outcome in outcomes:
            failure = outcome.failure
            for position, (seed, content) in enumerate(outcome.batch.cells):
                value = outcome.results[position] if outcome.results is not None else None
                status = "done" if failure is None else str(failure.kind)
                message = "" if failure is None else failure.message
                self._connection.execute(
                    "insert or replace into cell values (?, ?, ?, ?, ?, ?)",
                    (seed, content, status, value, message, outcome.rank),
                )
                self._connection.execute("delete from running where seed = ? and content = ?", (seed, content))
        self._perhaps_die("while")
        self._connection.execute("commit")
        # What an acknowledged outcome is to an observer: it has been told of, so it must survive.
        sys.stdout.write("".join(f"stored {c}\n" for o in outcomes for c in o.batch.cells))
        sys.stdout.flush()
        self._perhaps_die("after")

    def keep_alive(self) -> None:
        """Do nothing."""

    def mark(self, batches: Sequence[Batch[Cell]]) -> None:
        """Keep that these batches are being computed."""
        rows = [(*cell, os.getpid()) for batch in batches for cell in batch.cells]
        self._connection.executemany("insert into running values (?, ?, ?)", rows)

    def forget(self) -> None:
        """Forget the marks of this run, which has not died."""
        self._connection.execute("delete from running where run = ?", (os.getpid(),))

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def _perhaps_die(self, moment: str) -> None:
        if self._count != self._die_at or not self._die.endswith(moment):
            return
        if self._die.startswith("raise"):
            raise OSError(28, "no space left on device (on order)")
        os.kill(os.getpid(), signal.SIGSEGV if self._die.startswith("segfault") else signal.SIGKILL)


def endless_loop() -> None:
    """Compute for ever in compiled code, as a stuck kernel does: no Python signal handler can run."""
    ctypes.PyDLL(None).sleep(100)  # unlike CDLL, PyDLL keeps the interpreter lock meanwhile


FAULTS: dict[str, Callable[[], Any]] = {
    "raise": lambda: 1 // 0,
    "exit": lambda: sys.exit(1),
    "hard-exit": lambda: os._exit(1),
    "kill": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "segfault": lambda: ctypes.string_at(0),
    "stop": lambda: os.kill(os.getpid(), signal.SIGSTOP),
    "loop": endless_loop,
    "unpicklable": lambda: None,
    "slow": lambda: None,
}


def arguments() -> argparse.Namespace:
    """Return what is asked for."""
    parser = argparse.ArgumentParser()
    parser.add_argument("database", type=Path)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--lanes", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=0.0, help="work for each batch")
    parser.add_argument("--fault", choices=FAULTS, help="what the cell (5, 2.55) does")
    parser.add_argument("--moment", choices=("start", "end"), default="start", help="when it does it")
    parser.add_argument("--once", type=Path, help="do it only if this file can be created")
    parser.add_argument("--time-limit", type=float)
    parser.add_argument("--silence-floor", type=float, default=300.0, help="patience with a worker without a limit")
    parser.add_argument("--die", default="", help="what the master does around a commit: kill-before, ...")
    parser.add_argument("--die-at", type=int, default=3, help="around which commit")
    parser.add_argument("--blob", type=int, default=0, help="bytes that each result carries in addition")
    return parser.parse_args()


class Work:
    """The computation of a batch: hashes, some waiting, and the fault on order."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._options = options

    def __call__(self, batch: Batch[Cell], raise_if_stopped: Callable[[], None]) -> list[Any]:
        """Return the hash of each cell, or do what was ordered."""
        options = self._options
        fault = options.fault if self._is_due(batch) else None
        if fault is not None and options.moment == "start":
            FAULTS[fault]()
        end = time.monotonic() + (1000.0 if fault == "slow" else options.seconds)
        while time.monotonic() < end:
            raise_if_stopped()
            time.sleep(0.01)
        if fault is not None and options.moment == "end":
            FAULTS[fault]()
        if fault == "unpicklable":
            return [lambda: None for _ in batch.cells]
        return [hashlib.sha256(repr(cell).encode()).hexdigest() + "x" * options.blob for cell in batch.cells]

    def _is_due(self, batch: Batch[Cell]) -> bool:
        if BAD_CELL not in batch.cells:
            return False
        if self._options.once is None:
            return True
        try:
            self._options.once.touch(exist_ok=False)
        except FileExistsError:
            return False
        return True


def lead(options: argparse.Namespace, executor: Executor | None, stop: StopRequest) -> int:
    """Run or continue the sweep, on rank 0."""
    sink = Sink(options.database, options.die, options.die_at)
    losses, settled = sink.losses(), sink.settled()
    cells = [(seed, content) for seed in range(options.seeds) for content in CONTENTS]
    deadly = [cell for cell in cells if losses.get(cell, 0) >= LOSSES_BEFORE_QUARANTINE and cell not in settled]
    pending = [cell for cell in cells if cell not in settled and cell not in deadly]
    end = run_sweep(
        executor,
        plan_batches(pending, options.lanes, lambda content: 1.0 + content, losses),
        Work(options),
        sink,
        time_limit=options.time_limit,
        silence_floor=options.silence_floor,
        stop_request=stop,
    )
    if end.state is not SweepState.CUT_OFF:
        sink.forget()
    sink.close()
    tally = end.tally
    sys.stderr.write(f"{end.state}: {end.detail}; {tally.total()} settled; deadly: {deadly}\n")
    return end.exit_code


if __name__ == "__main__":
    sys.exit(run_on_ranks(partial(lead, arguments()), grace=1.0))
