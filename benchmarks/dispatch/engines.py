"""How many cells per second each engine finishes, and for how much of the time its workers compute.

    python benchmarks/dispatch/engines.py [--workers 2 8 32] [--seconds 0.5]
    python benchmarks/dispatch/engines.py --campaign examples/paper.toml [--seeds 32] [--workers 2]

Workers sleep for the time of a batch and return real outcomes, which this process stores in a real database: so there
can be more workers than cores. MPI is measured by rank.py, the others here. With a campaign, whole commands compute
real cells, with kernels and packing from the cache; then there are also the engines that start a process for each part.
"""

import argparse
import os
import re
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import closing, contextmanager
from multiprocessing import get_context
from pathlib import Path

from rank import CELLS, Sleep, durations, numbered, open_sink, real_outcomes
from run import REAL, sweep

from calcidem.sweep.run import run_sweep

BATCHES_OF_ONE = 20
"""Batches for each worker."""


@contextmanager
def _pool(workers: int) -> Iterator[Executor]:
    with ProcessPoolExecutor(workers, get_context("forkserver")) as pool:
        list(pool.map(time.sleep, [1.0] * workers))  # all have started
        yield pool


@contextmanager
def _dask(workers: int) -> Iterator[Executor]:
    from distributed import Client, LocalCluster  # noqa: PLC0415 - an extra

    with (
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        client.wait_for_workers(workers)
        yield client.get_executor()


ENGINES = {"ProcessPoolExecutor": _pool, "Dask": _dask}


def wall_time(engine: str, workers: int, seconds: float) -> float:
    """Seconds of a sweep, from when all workers are there."""
    batches = workers * BATCHES_OF_ONE
    if engine == "MPI":
        return float(sweep(workers + 1, batches, seconds, stored=True)["wall"])
    with tempfile.TemporaryDirectory(prefix="calcidem-dispatch-") as folder, ENGINES[engine](workers) as executor:
        database, planned = str(shutil.copy(REAL, folder)), numbered(batches)
        store, sink = open_sink(database, planned)
        with store:
            compute = Sleep(durations(batches, seconds), real_outcomes(database))
            begin = time.perf_counter()
            end = run_sweep(executor, planned, compute, sink)
            if end.exit_code != 0:
                raise RuntimeError(f"{engine}: the sweep ended with {end}")
            return time.perf_counter() - begin


EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
COMMANDS = {
    "MPI": "calcidem run c.toml --db out.db --ranks {ranks}",
    "one process": "calcidem run c.toml --db out.db --ranks 0",
    "GNU parallel": "bash {examples}/gnu-parallel.sh c.toml out.db {workers}",
    "Snakemake": "snakemake -s {examples}/Snakefile --cores {workers} --config campaign=c.toml parts={workers} out=out.db",
    "HyperQueue": "{python} {examples}/hyperqueue_parts.py c.toml out.db {workers}",
}


def of_command(engine: str, campaign: Path, seeds: int, workers: int) -> tuple[float, int, float]:
    """Wall time (s) of a whole command, cells, and seconds that workers computed."""
    with tempfile.TemporaryDirectory(prefix="calcidem-engine-") as folder:
        text = re.sub(r"(?m)^seeds = .*", f"seeds = {seeds}", campaign.read_text(encoding="utf-8"))
        Path(folder, "c.toml").write_text(text, encoding="utf-8")
        places = {"examples": EXAMPLES, "python": sys.executable, "workers": workers, "ranks": workers + 1}
        command = COMMANDS[engine].format(**places).split()
        environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
        begin = time.perf_counter()
        subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)
        wall = time.perf_counter() - begin
        with closing(sqlite3.connect(Path(folder, "out.db"))) as database:
            return wall, *database.execute("select count(*), sum(seconds) from attempt").fetchone()


def main() -> None:
    """Print a line of the table for each engine and number of workers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workers", type=int, nargs="+", default=[2, 8, 32])
    parser.add_argument("--seconds", type=float, default=0.5, help="mean time of a batch")
    parser.add_argument("--engines", nargs="+", default=["MPI", *ENGINES], choices=["MPI", *ENGINES])
    parser.add_argument("--campaign", type=Path, help="real cells of this file, by whole commands")
    parser.add_argument("--seeds", type=int, default=32)
    given = parser.parse_args()
    if given.campaign:
        for engine in COMMANDS:
            wall, cells, computed = of_command(engine, given.campaign, given.seeds, given.workers[0])
            share = 100 * computed / wall / given.workers[0]
            sys.stdout.write(f"| {engine} | {wall:.1f} s | {cells / wall:.1f} cells/s | {share:.0f} % |\n")
            sys.stdout.flush()
        return
    sys.stdout.write("| engine | workers | cells/s | workers compute |\n|---|---|---|---|\n")
    for engine in given.engines:
        for workers in given.workers:
            wall = wall_time(engine, workers, given.seconds)
            cells = workers * BATCHES_OF_ONE * CELLS
            share = BATCHES_OF_ONE * given.seconds / wall
            sys.stdout.write(f"| {engine} | {workers} | {cells / wall:.1f} | {100 * share:.0f} % |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
