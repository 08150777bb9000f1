"""How many workers one master keeps busy: measured costs, the bound that follows, and what real ranks reach.

    python benchmarks/dispatch/run.py [--json FILE] [--figure docs/scaling.png]

Takes some five minutes; docs/performance.md says what follows. The threads of the master share the interpreter lock, so
that a batch costs it the message and its share of the storing, and N workers with batches of T seconds compute at most
T / (N cost) of their time. Workers that sleep stand in for those that compute, so that
more of them than there are cores can be had; what they return is real, and the real master stores it in a real database.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("agg")
import matplotlib.pyplot as plt
import numpy as np
from rank import CELLS, Group, TimedSink, durations, moved, numbered, open_sink, real_outcomes

from calcidem.app.campaign.launch import find_mpirun, launcher_options
from calcidem.sweep.schedule import BatchOutcome

HERE = Path(__file__).resolve().parent
REAL = HERE.parents[1] / "docs" / "tutorial" / "quick.db"
"""Database with real outcomes."""

GROUPS = (1, 2, 4, 8, 16, 32)
ROUNDS = 8
SECONDS = 0.5
"""Mean time of a batch; one of the paper's scene takes 0.3 to 0.9 s."""

BATCHES_OF_ONE = 20
"""Batches for each worker, where real ranks are compared."""

WORKERS = (16, 32, 64, 128, 256, 512, 1000)


@dataclass(frozen=True)
class Costs:
    """What a batch costs the master, s.

    Attributes
    ----------
    message
        CPU time of the threads that exchange messages, for a batch: receive the outcome, hand out the next batch.
    group_cpu, batch_cpu
        CPU time of the storing thread for a group, marks and outcomes, and for each batch in it.
    group_disk, batch_disk
        Its waiting for the disk, likewise; messages are exchanged meanwhile.
    """

    message: float
    group_cpu: float
    batch_cpu: float
    group_disk: float
    batch_disk: float

    def bound(self, workers: int, seconds: float) -> float:
        """Largest share of their time that so many workers compute with batches of so many seconds."""
        return min(1.0, seconds / (workers * (self.message + self.batch_cpu)))


@dataclass(frozen=True)
class Check:
    """Share of their time that real workers compute, for so many workers and so long batches."""

    workers: int
    seconds: float
    real: float


def sweep(ranks: int, batches: int, seconds: float, *, stored: bool) -> dict[str, Any]:
    """What rank 0 of a real sweep has measured."""
    mpirun = find_mpirun()
    with tempfile.TemporaryDirectory(prefix="calcidem-dispatch-") as folder:
        given = ["--batches", str(batches), "--seconds", str(seconds)]
        given += ["--database", shutil.copy(REAL, folder)] if stored else []
        command = [mpirun, *launcher_options(mpirun, ranks), sys.executable, str(HERE / "rank.py"), *given]
        variables = {"OMPI_MCA_btl": "^ofi", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        done = subprocess.run(command, check=False, capture_output=True, text=True, env=os.environ | variables)
    if done.returncode != 0:
        raise RuntimeError(f"the sweep of {ranks} ranks ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    measured: dict[str, Any] = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))
    return measured


def measure_storing() -> list[Group]:
    """Cost of transactions of several sizes, in this process alone."""
    with tempfile.TemporaryDirectory(prefix="calcidem-dispatch-") as folder:
        database = shutil.copy(REAL, folder)
        payload = real_outcomes(database)
        batches = numbered(ROUNDS * sum(GROUPS))
        store, stored = open_sink(database, batches)
        sink, remaining = TimedSink(stored), iter(batches)
        with store:
            for size in GROUPS * ROUNDS:
                group = [next(remaining) for _ in range(size)]
                sink.mark(group)
                sink.store(
                    [
                        BatchOutcome(batch, SECONDS, results=moved(payload, batch), rank=1, host="node")
                        for batch in group
                    ]
                )
    pairs = zip(sink.groups[::2], sink.groups[1::2], strict=True)
    return [
        Group(late.batches, mark.cpu + late.cpu, mark.queue + late.queue, mark.wall + late.wall) for mark, late in pairs
    ]


def fit(groups: Sequence[Group], cost: Sequence[float]) -> tuple[float, float]:
    """Cost of a transaction, and of each batch in it, s: a line through the medians of each size, none below zero."""
    sizes = np.array([group.batches for group in groups])
    medians = np.array([np.median(np.asarray(cost)[sizes == size]) for size in GROUPS])
    weights = 1.0 / np.array(GROUPS)
    slope, start = np.polyfit(GROUPS, medians, 1, w=weights)
    return max(float(start), 0.0), max(float(slope), 0.0)


def measure_costs() -> tuple[Costs, list[Group]]:
    """All costs."""
    groups = measure_storing()
    group_cpu, batch_cpu = fit(groups, [group.cpu for group in groups])
    group_disk, batch_disk = fit(groups, [max(group.wall - group.cpu - group.queue, 0.0) for group in groups])
    count, seconds = 400, 0.02
    busy = sweep(9, count, seconds, stored=True)
    return Costs(busy["messages"] / count, group_cpu, batch_cpu, group_disk, batch_disk), groups


def check(ranks: int, seconds: float) -> Check:
    """What real ranks reach."""
    workers = ranks - 1
    times = durations(workers * BATCHES_OF_ONE, seconds)
    real = sweep(ranks, len(times), seconds, stored=True)
    return Check(workers, seconds, sum(times) / workers / real["wall"])


def draw(costs: Costs, checks: Sequence[Check], file: Path) -> None:
    """Draw the bound over the number of workers, and the real ranks."""
    figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    workers = np.unique(np.geomspace(8, 1000, 25).round().astype(int))
    for seconds in (2.0, SECONDS, 0.25):
        share = [100.0 * costs.bound(int(count), seconds) for count in workers]
        axes.plot(workers, share, label=f"bound, batches of {seconds:g} s")
    own = [found for found in checks if found.seconds == SECONDS]
    axes.plot([c.workers for c in own], [100.0 * c.real for c in own], "ko", label=f"real ranks, {SECONDS:g} s")
    axes.set(xscale="log", xlabel="workers of one master", ylabel="time that the workers compute, %", ylim=(0, 102))
    axes.xaxis.set_major_formatter(mpl.ticker.ScalarFormatter())
    axes.set_xticks([8, 16, 32, 64, 128, 256, 512, 1000])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(file, dpi=120)


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="file for all numbers")
    parser.add_argument("--figure", type=Path, help="picture to draw")
    options = parser.parse_args()
    print(f"{len(os.sched_getaffinity(0))} cores, {os.getloadavg()[0]:.1f} processes ready to run in the last minute")
    costs, groups = measure_costs()
    print("ms:", ", ".join(f"{field.name} {1e3 * getattr(costs, field.name):.2f}" for field in fields(costs)))
    print("batches in a transaction   CPU of storing a cell, ms")
    for size in GROUPS:
        own = [group.cpu for group in groups if group.batches == size]
        print(f"{size:24d}   {1e3 * float(np.median(own)) / size / CELLS:.3f}")
    print("workers   s a batch   real   bound")
    checks = []
    for ranks, seconds in ((8, SECONDS), (16, SECONDS), (32, SECONDS), (32, SECONDS / 4)):
        checks.append(found := check(ranks, seconds))
        bound = costs.bound(found.workers, seconds)
        print(f"{found.workers:7d}   {seconds:9g}   {found.real:4.0%}   {bound:5.0%}", flush=True)
    print(f"workers   bound, {SECONDS:g} s a batch")
    for workers in WORKERS:
        print(f"{workers:7d}   {costs.bound(workers, SECONDS):.0%}")
    idle = sweep(3, 4, 5.0, stored=False)
    print(f"idle: {idle['messages'] / idle['wall']:.2%} of a core while its workers compute")
    if options.json:
        numbers = {"costs": asdict(costs), "checks": [asdict(found) for found in checks]}
        options.json.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
    if options.figure:
        draw(costs, checks, options.figure)


if __name__ == "__main__":
    main()
