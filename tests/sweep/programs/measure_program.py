"""Measures what a sweep costs: CPU time of the master and wall time, printed by rank 0 as JSON."""

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from calcidem.sweep import Batch, BatchOutcome, Session, run_sweep


class Counter:
    """A sink that only counts."""

    cells = 0

    def store(self, outcomes: Sequence[BatchOutcome[int, int]]) -> None:
        """Count."""
        self.cells += sum(len(outcome.batch.cells) for outcome in outcomes)

    def store_loss(self, batch: Batch[int], reason: str) -> None:
        """Count nothing."""


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
        wall, cpu = time.perf_counter(), time.process_time()
        end = run_sweep(session.comm, batches, compute, sink)
        measured = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu, "cells": sink.cells}
        if session.rank == 0:
            sys.stdout.write(json.dumps(measured))
        session.end(end.exit_code, end)


if __name__ == "__main__":
    main()
