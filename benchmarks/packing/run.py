"""Seconds and steps of a packing, and whether packings of two checkouts are alike.

    python benchmarks/packing/run.py [--against CHECKOUT] [--seeds 20] [--config FILE] [--set packing.stress=3e5]
                                     [--contents 0 2.55] [--mirrored] [--keep FOLDER] [--json FILE]

Every seed is packed by both in turns, each on one core with its kernels in the cache; without ``--against`` by this one
alone. Two packings of one seed begin with the same disks, so what is given is the mean of their differences in units of
its standard error: of many, one in twenty lies beyond 2, more of few seeds. Of normal
forces over their mean, f, the whole distributions are compared too: the largest distance between the two (Kolmogorov and
Smirnov) over that of seeds dealt out to two heaps at random, since forces of one packing are not independent.
``--keep`` keeps packings and takes those that are there; their seconds are then those of the clock. With ``--mirrored``
waves go through the packings seen from behind.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import ks_2samp

Floats = npt.NDArray[np.float64]

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
DEALS = 200


class Worker:
    """A process that makes packings of one checkout."""

    def __init__(self, checkout: Path, options: argparse.Namespace) -> None:
        command = [sys.executable, str(HERE / "worker.py"), str(options.config), "--set", *options.set]
        command += ["--contents", *map(str, options.contents)]
        command += ["--mirrored"] if options.mirrored else []
        if options.keep:
            folder = options.keep / checkout.resolve().name
            folder.mkdir(parents=True, exist_ok=True)
            command += ["--keep", str(folder)]
        threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            command,
            env={**os.environ, **threads, "PYTHONPATH": str(checkout)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def pack(self, seed: int) -> dict[str, Any]:
        """What the packing of a seed took and is."""
        print(seed, file=self.process.stdin, flush=True)
        found: dict[str, Any] = json.loads((self.process.stdout or sys.stdin).readline())
        return found


def mean_and_error(values: Floats) -> tuple[float, float]:
    """Mean and its standard error, of the numbers among them."""
    known = values[np.isfinite(values)]
    return float(known.mean()), float(known.std(ddof=1) / np.sqrt(len(known))) if len(known) > 1 else float("nan")


def distance_of_forces(heaps: list[list[list[float]]]) -> tuple[float, float]:
    """Largest distance of two distributions, and the share of random deals of the seeds that give a larger one."""
    generator, seeds = np.random.default_rng(1), [*heaps[0], *heaps[1]]

    def distance(order: Any) -> float:  # noqa: ANN401 - numbers of seeds
        halves = np.array_split(order, [len(heaps[0])])
        return float(ks_2samp(*(np.concatenate([seeds[k] for k in half]) for half in halves), method="asymp").statistic)

    found = distance(np.arange(len(seeds)))
    return found, float(np.mean([distance(generator.permutation(len(seeds))) > found for _ in range(DEALS)]))


def show(found: list[list[dict[str, Any]]]) -> None:
    """Print means, and differences in units of their standard errors."""
    both = len(found) > 1
    print("| quantity | this checkout |", "the other | difference / its standard error |" if both else "")
    print("|---|---|", "---|---|" if both else "")
    for part in ("cost", "statistics"):
        for name in found[0][0][part]:
            values = np.array([[packing[part][name] for packing in packings] for packings in found])
            cells = ["{:.5g} ± {:.2g}".format(*mean_and_error(row)) for row in values]
            if both:
                mean, error = mean_and_error(values[0] - values[1])
                cells.append(f"{mean / error:+.1f}" if error > 0.0 else "0")
            print("|", name, "|", " | ".join(cells), "|")
    if both:
        distance, larger = distance_of_forces([[packing["force"] for packing in packings] for packings in found])
        print(f"\nDistributions of f are {distance:.4f} apart; {larger:.0%} of {DEALS} random deals are further apart.")


def main() -> None:
    """Make, compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument(
        "--config", type=Path, default=ROOT / "calcidem" / "app" / "config" / "presets" / "paper-small-pulse.toml"
    )
    parser.add_argument("--set", nargs="*", default=[])
    parser.add_argument("--contents", nargs="*", type=float, default=[0.0, 2.55])
    parser.add_argument("--mirrored", action="store_true")
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    workers = [Worker(checkout, options) for checkout in (ROOT, options.against) if checkout]
    found: list[list[dict[str, Any]]] = [[] for _ in workers]
    for seed in range(1, options.seeds + 1):
        for worker, packings in zip(workers, found, strict=True):
            packings.append(worker.pack(seed))
            print(seed, packings[-1]["cost"], file=sys.stderr, flush=True)
    show(found)
    if options.json:
        options.json.write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    main()
