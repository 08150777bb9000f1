"""Measures what a sweep costs: wall time and CPU time of the master, of all and of each turn, printed as JSON."""

import argparse
import itertools
import json
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from calcidem.sweep.backoff import Backoff, wait_until
from calcidem.sweep.batch import Batch
from calcidem.sweep.outcome import BatchOutcome
from calcidem.sweep.run import run_sweep
from calcidem.sweep.session import Session


class Counter:
    """A sink that only counts."""

    cells = 0

    def store(self, outcomes: Sequence[BatchOutcome[int, int]]) -> None:
        """Count."""
        self.cells += sum(len(outcome.batch.cells) for outcome in outcomes)

    def keep_alive(self) -> None:
        """Do nothing."""

    def store_loss(self, batch: Batch[int], reason: str) -> None:
        """Count nothing."""


def note_sleeps() -> list[float]:
    """Return a list that gets the CPU time of the thread before each sleep from now on, s."""
    noted: list[float] = []
    sleep = Backoff.sleep

    def note_and_sleep(backoff: Backoff) -> None:
        noted.append(time.thread_time())
        sleep(backoff)

    Backoff.sleep = note_and_sleep  # type: ignore[assignment,method-assign]
    return noted


def main() -> None:
    """Run the sweep and print what it cost."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--batches", type=int, required=True)
    parser.add_argument("--seconds", type=float, default=0.0, help="sleep of each batch")
    options = parser.parse_args()

    def compute(batch: Batch[int], deadline_check: Callable[[], None]) -> tuple[Any, ...]:
        if options.seconds:
            time.sleep(options.seconds)
        deadline_check()
        return batch.cells

    with Session() as session:
        session.broadcast(0)  # so that the clock starts when all ranks are there
        sink = Counter()
        batches = [Batch(number, (number,)) for number in range(options.batches)]
        sleeps, wall, cpu = note_sleeps(), time.perf_counter(), time.process_time()
        end = run_sweep(session.comm, batches, compute, sink)
        measured = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu, "cells": sink.cells}
        swept = len(sleeps)
        if session.rank == 0:
            if session.comm is not None and options.seconds:  # what sleeping and looking for messages alone costs here
                wait_until(session.comm.Iprobe, options.seconds)
            turns = [after - before for before, after in itertools.pairwise(sleeps)]
            sys.stdout.write(json.dumps(measured | {"turns": turns[: swept - 1], "bare": turns[swept:]}))
        session.end(end.exit_code, end)


if __name__ == "__main__":
    main()
