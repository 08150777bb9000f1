"""What the scheduler costs: dispatch rate on 2, 4 and 8 ranks, CPU time of the master, and wall time against the ideal.

    python benchmarks/dispatch/run.py      # about a minute; docs/scaling.md says what follows from the numbers

Empty batches measure the messages alone. Stored batches carry eight real outcomes each, with signals and cement, which
the master writes into a database as in a campaign. A batch that sleeps stands in for one that computes, so that other
users of the machine do not matter.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path
from typing import Any

from calcidem.app.campaign.launch import find_mpirun, launcher_options
from calcidem.app.campaign.store_sink import StoreSink
from calcidem.storage.records import CellKey
from calcidem.storage.sql.store import open_store
from calcidem.sweep import Batch, BatchOutcome, Session, run_sweep

CELLS = 8
"""Cells in a batch, as in a campaign with AVX-512."""

REAL = Path(__file__).parents[2] / "docs" / "tutorial" / "quick.db"
"""Database with 40 real outcomes."""

BATCHES_OF_ONE_WORKER = 20
SLEEP = 0.5
"""Seconds; a batch of the real scene takes 0.4 to 2."""


class Discard:
    """A sink that keeps nothing."""

    def store(self, outcomes: Sequence[BatchOutcome[Any, Any]], /) -> None:
        """Keep nothing."""

    def store_loss(self, batch: Batch[Any], reason: str, /) -> None:
        """Keep nothing."""


def rank_program(options: argparse.Namespace) -> None:
    """What every rank does: one sweep; rank 0 prints what it cost as JSON."""
    payload = []
    if options.database:
        with open_store(options.database, read_only=True) as store:
            store.use_campaign()
            stored = [result for result in store.results(with_arrays=True) if result.key.content > 0.0]
            payload = list(islice(cycle(stored), CELLS))

    def compute(batch: Batch[Any], deadline_check: Callable[[], None]) -> Sequence[Any]:
        time.sleep(options.sleep)
        deadline_check()
        return [replace(result, key=CellKey(*cell)) for result, cell in zip(payload, batch.cells, strict=False)]

    batches = [
        Batch(number, tuple((10 + CELLS * number + lane, 5.0) for lane in range(CELLS)))
        for number in range(options.batches)
    ]
    with Session() as session:
        sink: Any = Discard()
        store = None
        if session.rank == 0 and options.database:
            store = open_store(options.database)
            store.use_campaign()
            keys = [CellKey(*cell) for batch in batches for cell in batch.cells]
            store.extend([key.seed for key in keys], [5.0])
            sink = StoreSink(store, keys)
        session.broadcast(0)  # the clock starts when all ranks are there
        wall, cpu = time.perf_counter(), time.process_time()
        end = run_sweep(session.comm, batches, compute, sink)
        measured = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
        if session.rank == 0:
            sys.stdout.write(json.dumps(measured) + "\n")
        if store is not None:
            store.close()
        session.end(end.exit_code, end)


def measure(ranks: int, batches: int, sleep: float = 0.0, *, stored: bool = False) -> dict[str, float]:
    """Wall seconds of a sweep and CPU seconds of its master."""
    mpirun = find_mpirun()
    with tempfile.TemporaryDirectory(prefix="calcidem-dispatch-") as folder:
        arguments = ["--batches", str(batches), "--sleep", str(sleep)]
        if stored:
            database = Path(shutil.copy(REAL, folder))
            open_store(database).close()  # in the present schema
            arguments += ["--database", str(database)]
        command = [mpirun, *launcher_options(mpirun, ranks), sys.executable, __file__, "--rank", *arguments]
        variables = {"OMPI_MCA_btl": "^ofi", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        done = subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ | variables)
    measured: dict[str, float] = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))
    return measured


def main() -> None:
    """Measure and print."""
    print(f"{len(os.sched_getaffinity(0))} cores, {os.getloadavg()[0]:.1f} processes ready to run in the last minute")
    print("ranks  batches of 8 cells  batches/s  master's CPU, us per batch")
    for ranks in (2, 4, 8):
        for stored, batches in ((False, 2000), (True, 200)):
            found = measure(ranks, batches, stored=stored)
            kind = "stored" if stored else "empty"
            rate, cost = batches / found["wall"], 1e6 * found["cpu"] / batches
            print(f"{ranks:5d}  {kind:>18}  {rate:9.0f}  {cost:12.0f}", flush=True)
    idle = measure(3, 4, 5.0)
    print(f"idle master: {idle['cpu'] / idle['wall']:.2%} of a core while its workers compute ({idle['wall']:.1f} s)")
    found = measure(2, BATCHES_OF_ONE_WORKER, SLEEP, stored=True)
    ideal = BATCHES_OF_ONE_WORKER * SLEEP
    print(
        f"2 ranks, {BATCHES_OF_ONE_WORKER} stored batches of {SLEEP} s on one worker: {found['wall']:.2f} s, "
        f"ideal {ideal:.2f} s, overhead {found['wall'] / ideal - 1:.1%}; master's CPU {found['cpu']:.2f} s"
    )


def arguments() -> argparse.Namespace:
    """What is asked for; the options are for the ranks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rank", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--batches", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--sleep", type=float, default=0.0, help=argparse.SUPPRESS)
    parser.add_argument("--database", help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":
    asked = arguments()
    if asked.rank:
        rank_program(asked)
    else:
        main()
