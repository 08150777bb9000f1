"""What Vs means: picked velocities beside the static speed of the same samples, and what makes the difference.

    python benchmarks/statics/run.py [--seeds 8]

Prints the table of docs/velocity.md: for each content the static speed, that of the inner part of the box, Vs over the
static speed with the preset and with some of its keys changed, and what a static speed costs beside a wave (CPU
seconds, without compilation).
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import load_configuration
from calcidem.dem import Bonds, start
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.statics import contact_springs
from calcidem.dem.kernels.layout import NORMAL, NORMAL_X, NORMAL_Y, Flags, Floats
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
MARGIN = 0.2  # of the width, left out on all sides


def inner_speed(experiment: Experiment, bonded: Flags) -> float:
    """Static speed of the middle of the box, m/s, from stress over strain; the rim moves as in `static_speed`."""
    packing, sand = experiment.stiffen()
    bonds = Bonds(packing.pairs[bonded], experiment.cement) if bonded.any() else None
    state = start(wave_scene(packing, sand, experiment.wave, bonds), regime="linear", preload=packing.preload)
    x, y, radius = (np.asarray(values)[state.assembly.order] for values in (packing.x, packing.y, packing.radius))
    rim = (x < radius) | (packing.width - x < radius) | (y < radius) | (packing.height - y < radius)
    matrix, stiffness = contact_springs(state, 0)
    motion = _relaxed(matrix, stiffness, x, rim)
    margin = MARGIN * packing.width
    inside = (np.abs(x - packing.width / 2) < packing.width / 2 - margin) & (
        np.abs(y - packing.height / 2) < packing.height / 2 - margin
    )
    terms = np.column_stack([np.ones(inside.sum()), x[inside], y[inside]])
    along, up = (np.linalg.lstsq(terms, motion[inside, axis], rcond=None)[0] for axis in (0, 1))
    forces = (stiffness * (matrix @ motion.ravel())).reshape(3, -1)
    stress = _mean_stress(state, forces, np.column_stack([x, y]), inside)
    area = (packing.width - 2 * margin) * (packing.height - 2 * margin)
    density = sand.density * (1.0 - packing.report.porosity)
    return float(np.sqrt(stress / area / (along[2] + up[1]) / density))


def _relaxed(matrix: sparse.csr_array, stiffness: Floats, x: Floats, rim: Flags) -> Floats:
    """(N, 3) motion of the disks at rest when those of the rim follow u_y = x."""
    motion = np.column_stack([0.0 * x, x, 0.0 * x])
    free = np.column_stack([~rim, ~rim, np.ones_like(rim)]).ravel()
    whole = (matrix.T @ sparse.diags_array(stiffness) @ matrix).tocsr()
    ground = 1e-9 * np.median(stiffness[stiffness > 0.0]) * sparse.eye_array(int(free.sum()))
    flat = motion.ravel()
    flat[free] -= spsolve((whole[free][:, free] + ground).tocsc(), (whole @ flat)[free])
    return flat.reshape(-1, 3)


def _mean_stress(state: State, forces: Floats, place: Floats, inside: Flags) -> float:
    """Shear stress times area of the contacts between two disks inside, half of those that cross the rim, N."""
    pairs = state.assembly.pairs
    normal = pairs.geometry[:, [NORMAL_X, NORMAL_Y]].astype(float)
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    force = forces[0][:, None] * normal + forces[1][:, None] * tangent
    branch = place[pairs.second] - place[pairs.first]
    share = (inside[pairs.first].astype(float) + inside[pairs.second]) / 2.0
    return float(share @ (branch[:, 0] * force[:, 1] + branch[:, 1] * force[:, 0])) / 2.0


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
    titles = ("content %", "static, m/s", "inner part, m/s", *VARIANTS, "delay at the wall", "seconds: static", "wave")
    print(f"| {' | '.join(titles)} |\n|{'---|' * len(titles)}")
    for content in CONTENTS:
        chosen = seeds if content else seeds[:1]
        bonded = [experiment.ordering(seed).at(content).bonded for seed in chosen]
        began = time.process_time()
        static = np.array([static_speed(experiment, flags) for flags in bonded])
        seconds = [(time.process_time() - began) / len(chosen)]
        inner = np.mean([inner_speed(experiment, flags) for flags in bonded])
        began = time.process_time()
        measure(experiment, content, chosen)
        seconds.append((time.process_time() - began) / len(chosen))
        ratios = [ratio_text(picked(experiment, content, chosen, changes), static) for changes in VARIANTS.values()]
        last = [wall_delay(experiment, float(static.mean()), experiment.frequency(content)), *seconds]
        cells = (f"{content:g}", f"{static.mean():.0f}", f"{inner:.0f}", *ratios, *(f"{value:.2f}" for value in last))
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
