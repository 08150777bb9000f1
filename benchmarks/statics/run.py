"""What Vs means: picked velocities beside the static speed of the same samples, and what makes the difference.

    python benchmarks/statics/run.py [--seeds 8]

Prints the table of docs/velocity.md: for each content the static speed and its mean error, Vs over the static speed with
the preset and with some of its keys changed, and what a static speed costs beside a wave (CPU seconds, without
compilation).
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import load_configuration
from calcidem.dem import start
from calcidem.dem.kernels.layout import NORMAL, Floats
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure
from calcidem.dem.wave.scene import TRANSMITTER, wave_scene
from calcidem.dem.wave.static_speed import static_speed

CONTENTS = (0.0, 0.66, 2.55, 5.0, 9.0)
_WIDE = {"transmitter_half_width": 0.09, "receiver_half_width": 0.06}
VARIANTS: dict[str, dict[str, Any]] = {
    "Vs / static as configured": {},
    "damping 0": {"damping": 0.0},
    "driven disks": {"transmitter": "driven"},
    "wide bands": _WIDE,
    "both": _WIDE | {"transmitter": "driven"},
    "both, damping 0": _WIDE | {"transmitter": "driven", "damping": 0.0},
}


def wall_delay(experiment: Experiment, speed: float, frequency: float) -> float:
    """Periods by which a wall passes a wave on late: a spring k before a medium of impedance Z = rho V, atan(w Z / k)."""
    packing, sand = experiment.stiffen()
    state = start(wave_scene(packing, sand, experiment.wave, None), regime="linear", preload=packing.preload)
    wall_pairs, left = state.assembly.wall_pairs, (TRANSMITTER - 1, TRANSMITTER, TRANSMITTER + 1)
    spring = sand.shear_ratio * float(wall_pairs.tangent[np.isin(wall_pairs.wall, left), NORMAL].sum()) / packing.height
    impedance = sand.density * (1.0 - packing.report.porosity) * speed
    return float(np.arctan(2.0 * np.pi * frequency * impedance / spring) / (2.0 * np.pi))


def picked(experiment: Experiment, content: float, seeds: Sequence[int], changes: dict[str, Any]) -> Floats:
    """Vs of each seed with some keys of the wave changed, NaN where there is none."""
    found = measure(replace(experiment, wave=replace(experiment.wave, **changes)), content, seeds)
    return np.array([np.nan if cell.vs is None else cell.vs for cell in found])


def ratio_text(vs: Floats, static: Floats) -> str:
    """Mean of picked over static speed, and how many samples gave one if not all did."""
    read = int(np.isfinite(vs).sum())
    mean = f"{np.nanmean(vs / static):.2f}" if read else "-"
    return mean + (f" ({read} of {len(vs)})" if read < len(vs) else "")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=8, choices=range(1, 9))
    seeds = list(range(1, parser.parse_args().seeds + 1))
    configuration = load_configuration("examples/paper-small-pulse.toml", {})
    experiment = configuration.experiment(provide_packing(configuration, None, lambda _: None, lambda: None))
    for content in (0.0, 5.0):
        measure(experiment, content, seeds)  # compiles
    titles = ("content %", "static, m/s", "its error %", *VARIANTS, "delay at the wall", "seconds: static", "wave")
    print(f"| {' | '.join(titles)} |\n|{'---|' * len(titles)}")
    for content in CONTENTS:
        chosen = seeds if content else seeds[:1]
        bonded = [experiment.ordering(seed).at(content).bonded for seed in chosen]
        began = time.process_time()
        static, errors = np.array([static_speed(experiment, flags) for flags in bonded]).T
        seconds = [(time.process_time() - began) / len(chosen)]
        began = time.process_time()
        measure(experiment, content, chosen)
        seconds.append((time.process_time() - began) / len(chosen))
        ratios = [ratio_text(picked(experiment, content, chosen, changes), static) for changes in VARIANTS.values()]
        last = [wall_delay(experiment, float(static.mean()), experiment.frequency(content)), *seconds]
        cells = (
            f"{content:g}",
            f"{static.mean():.0f}",
            f"{100.0 * errors.mean():.1f}",
            *ratios,
            *(f"{value:.2f}" for value in last),
        )
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
