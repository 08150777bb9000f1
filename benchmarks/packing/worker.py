"""Makes packings with the calcidem that is imported and prints what they are: a line of JSON for every seed it reads."""

import argparse
import contextlib
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from calcidem.app.campaign.stored_packing import packing_from_bytes, packing_to_bytes
from calcidem.app.config.changed import change_configuration
from calcidem.app.config.schema import Configuration
from calcidem.dem.engine.scene import Preload
from calcidem.dem.sample.compaction import make_packing
from calcidem.dem.sample.packing import Packing
from calcidem.dem.sample.random_streams import RandomPurpose, random_generator
from calcidem.dem.wave.measurement import measure

_LANES = 8
_SLIDING = 0.999  # of the friction limit
_WEAK, _STRONG = 0.1, 2.0  # normal forces over the mean


def make(configuration: Configuration, seed: int) -> tuple[Packing, dict[str, float]]:
    """Packing of a seed, and the processor's seconds and the steps that it took."""
    generator = random_generator(configuration.campaign.root_seed, seed, RandomPurpose.DISKS)
    began = time.process_time()
    packing = make_packing(configuration.packing, configuration.sand, generator)
    return packing, {"seconds": time.process_time() - began, "steps": float(packing.report.steps)}


def describe(packing: Packing, configuration: Configuration) -> tuple[dict[str, float], list[float]]:
    """Statistics of the contacts, and their normal forces over the mean."""
    first, second = packing.pairs.T
    apart = np.column_stack([packing.x[second] - packing.x[first], packing.y[second] - packing.y[first]])
    overlap = packing.radius[first] + packing.radius[second] - np.hypot(*apart.T)
    normal = configuration.sand.hertz_coefficient(packing.radius[first], packing.radius[second]) * overlap**1.5
    force, double_angle = normal / normal.mean(), 2.0 * np.arctan2(apart[:, 1], apart[:, 0])
    mobilised = np.abs(packing.preload.shear) / (configuration.packing.friction_preparation * normal)
    report = packing.report
    found = {
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
    return found, np.sort(force).tolist()


def mirror(packing: Packing) -> Packing:
    """The same packing, seen from behind: another transmitter and another way for the wave."""
    return replace(packing, x=packing.width - packing.x, preload=Preload(packing.pairs, -packing.preload.shear))


def velocities(packing: Packing, configuration: Configuration, contents: list[float]) -> Iterator[tuple[str, float]]:
    """Mean velocity over the cement seeds of a batch, m/s, and the part of them without a velocity."""
    for content in contents:
        cells = measure(configuration.experiment(packing), content, range(1, _LANES + 1), lanes=_LANES)
        found = [cell.vs for cell in cells if cell.vs is not None]
        yield f"Vs at {content:g} %, m/s", float(np.mean(found)) if found else float("nan")
        yield f"without Vs at {content:g} %", 1.0 - len(found) / _LANES


def main() -> None:
    """Answer seeds until there are no more."""
    parser = argparse.ArgumentParser()
    parser.add_argument("configuration", type=Path)
    parser.add_argument("--set", nargs="*", default=[])
    parser.add_argument("--contents", nargs="*", type=float, default=[0.0, 2.55])
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--mirrored", action="store_true")
    options = parser.parse_args()
    with contextlib.suppress(ImportError):  # as the ranks of a campaign do; older checkouts cannot
        from calcidem.sweep.processes import keep_freed_memory  # noqa: PLC0415 - as said

        keep_freed_memory()
    values = {key: json.loads(value) for key, _, value in (item.partition("=") for item in options.set)}
    configuration = change_configuration(options.configuration, values)
    small = replace(configuration, packing=replace(configuration.packing, width=0.02, height=0.03))
    make(small, 1)  # compiles
    for line in sys.stdin:
        kept = options.keep and options.keep / f"{int(line)}.npz"
        if kept and kept.exists():
            packing = packing_from_bytes(kept.read_bytes())
            cost = {"seconds": packing.report.seconds, "steps": float(packing.report.steps)}
        else:
            packing, cost = make(configuration, int(line))
            if kept:
                kept.write_bytes(packing_to_bytes(packing))
        found, force = describe(packing, configuration)
        found |= velocities(mirror(packing) if options.mirrored else packing, configuration, options.contents)
        print(json.dumps({"cost": cost, "statistics": found, "force": force}), flush=True)


if __name__ == "__main__":
    main()
