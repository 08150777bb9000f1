"""Seconds and steps of packings, their statistics over the seeds, and the velocities of waves through them.

    python benchmarks/packing/run.py [--seeds 20] [--config FILE] [--set packing.stress=3e5] [--contents 0 2.55]

Seconds are those of the processor with the kernels in the cache. Each quantity is printed with its mean over the seeds
and the standard error of that. Velocities are means over the cement seeds of a batch.
"""

import argparse
import json
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from calcidem.app.config.reader import change_configuration
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.cement import RandomPurpose, random_generator
from calcidem.dem.sample.compaction import make_packing
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.measurement import measure

ROOT = Path(__file__).resolve().parents[2]
PRESET = ROOT / "calcidem" / "app" / "config" / "presets" / "paper.toml"
_LANES = 8
_SLIDING = 0.999  # of the friction limit
_WEAK, _STRONG = 0.1, 2.0  # normal forces over the mean


def make(configuration: Configuration, seed: int) -> tuple[Packing, float]:
    """Packing of a seed, and the processor's seconds that it took."""
    generator = random_generator(configuration.campaign.root_seed, seed, RandomPurpose.DISKS)
    began = time.process_time()
    packing = make_packing(configuration.packing, configuration.sand, generator)
    return packing, time.process_time() - began


def describe(packing: Packing, configuration: Configuration) -> dict[str, float]:
    """Statistics of the contacts."""
    first, second = packing.pairs.T
    apart = np.column_stack([packing.x[second] - packing.x[first], packing.y[second] - packing.y[first]])
    overlap = packing.radius[first] + packing.radius[second] - np.hypot(*apart.T)
    normal = configuration.sand.hertz_coefficient(packing.radius[first], packing.radius[second]) * overlap**1.5
    force, double_angle = normal / normal.mean(), 2.0 * np.arctan2(apart[:, 1], apart[:, 0])
    mobilised = np.abs(packing.preload.shear) / (configuration.packing.friction_preparation * normal)
    report = packing.report
    return {
        "steps": float(report.steps),
        "porosity": report.porosity,
        "coordination number": report.coordination_number,
        "the same without rattlers": report.coordination_number_without_rattlers,
        "rattlers": report.rattlers / len(packing.x),
        "side stress / lid stress": (report.wall_stress[0] + report.wall_stress[1]) / (2.0 * report.wall_stress[3]),
        "fabric along y (-mean cos 2a)": float(-np.cos(double_angle).mean()),
        "force fabric (-mean f cos 2a)": float(-(force * np.cos(double_angle)).mean()),
        "sliding contacts": float((mobilised > _SLIDING).mean()),
        "mean mobilised friction": float(mobilised.mean()),
        "standard deviation of f": float(force.std()),
        f"share of f < {_WEAK:g}": float((force < _WEAK).mean()),
        f"share of f > {_STRONG:g}": float((force > _STRONG).mean()),
        "mean overlap, um": 1e6 * report.mean_overlap,
        "unbalanced-force ratio, 1e-6": 1e6 * report.unbalanced_ratio,
        "error of the lid's stress, %": 100.0 * abs(report.wall_stress[3] / configuration.packing.stress - 1.0),
    }


def velocities(packing: Packing, configuration: Configuration, contents: list[float]) -> Iterator[tuple[str, float]]:
    """Mean velocity over the cement seeds of a batch, m/s, and the part of them without a velocity."""
    for content in contents:
        cells = measure(configuration.experiment(packing), content, range(1, _LANES + 1), lanes=_LANES)
        found = [cell.vs for cell in cells if cell.vs is not None]
        yield f"Vs at {content:g} %, m/s", float(np.mean(found)) if found else float("nan")
        yield f"without Vs at {content:g} %", 1.0 - len(found) / _LANES


def main() -> None:
    """Make packings, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--config", type=Path, default=PRESET)
    parser.add_argument("--set", nargs="*", default=[])
    parser.add_argument("--contents", nargs="*", type=float, default=[0.0, 2.55])
    options = parser.parse_args()
    values = {key: json.loads(value) for key, _, value in (item.partition("=") for item in options.set)}
    configuration = change_configuration(options.config, values)
    small = replace(configuration, packing=replace(configuration.packing, width=0.02, height=0.03))
    make(small, 1)  # compiles
    found: dict[str, list[float]] = defaultdict(list)
    for seed in range(1, options.seeds + 1):
        packing, seconds = make(configuration, seed)
        measured = {"seconds": seconds, **describe(packing, configuration)}
        for name, value in (measured | dict(velocities(packing, configuration, options.contents))).items():
            found[name].append(value)
        print(seed, f"{seconds:.2f} s", file=sys.stderr, flush=True)
    print("| quantity | mean |\n|---|---|")
    for name, values_found in found.items():
        known = np.array(values_found)[np.isfinite(values_found)]
        error = known.std(ddof=1) / np.sqrt(len(known)) if len(known) > 1 else np.nan
        print(f"| {name} | {known.mean() if len(known) else np.nan:.5g} ± {error:.2g} |")


if __name__ == "__main__":
    main()
