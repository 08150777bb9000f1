"""Two more alternatives to the explicit step of the whole sample, on cemented samples in the linear regime.

Substepping: only the bonded contacts take the small step, the pressed ones push once in several of them (the impulse
method of multiple time steps). Rigid clusters: what bonds hold together moves as one body, and the step is that of the
pressed contacts. Both are compared with the plain explicit step written the same way, a product of a sparse matrix and
a vector a step, so that the ratio of run times says what the method itself saves. The error is that of the signal
against the same scheme at a tenth of the limit. No local damping, as in newmark.py.

    python benchmarks/stiff/split.py examples/paper-small-pulse.toml
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
from newmark import springs
from scipy import sparse
from scipy.interpolate import CubicSpline
from scipy.sparse.csgraph import connected_components

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import load_configuration
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.stability import critical_time_step
from calcidem.dem.engine.state import choose_features, start
from calcidem.dem.wave.domain import listening_disks
from calcidem.dem.wave.measurement import measure
from calcidem.dem.wave.pulse import Pulse
from calcidem.dem.wave.scene import lane_bonds, wave_scene

CONTENTS = (0.66, 2.55, 5.0, 9.0)
LANES = 8
Signal = tuple[np.ndarray, np.ndarray, float]


@dataclass
class Sample:
    """Matrices of one sample: all springs, those of the bonds, the transmitter's push, inertia, and what is heard."""

    stiffness: sparse.csr_array
    bonds: sparse.csr_array
    push: np.ndarray
    inertia: np.ndarray
    heard: np.ndarray
    labels: np.ndarray
    limit: float
    soft_limit: float
    pulse: Pulse
    duration: float


def explicit(sample: Sample, step: float) -> Signal:
    """Leapfrog of everything; times, signal, processor seconds."""
    return leapfrog(sample.stiffness, sample.inertia, sample.push, sample, step, lambda v: v[sample.heard].mean())


def leapfrog(
    stiffness: sparse.csr_array,
    inertia: np.ndarray,
    push: np.ndarray,
    sample: Sample,
    step: float,
    hear: Callable[[np.ndarray], float],
) -> Signal:
    """Explicit central differences with a diagonal inertia."""
    steps = int(sample.duration / step)
    drive = sample.pulse.displacement(step * np.arange(steps))
    place, speed, gain = np.zeros(len(inertia)), np.zeros(len(inertia)), step / inertia
    heard = np.empty(steps)
    began = process_time()
    for number in range(steps):
        speed += gain * (push * drive[number] - stiffness @ place)
        place += step * speed
        heard[number] = hear(speed)
    return step * (np.arange(steps) + 0.5), heard, process_time() - began


def substepped(sample: Sample, step: float, substeps: int) -> Signal:
    """Pressed contacts push once a step, bonds ``substeps`` times; only bonded disks take part in the small steps."""
    soft = (sample.stiffness - sample.bonds).tocsr()
    stiff = np.flatnonzero(sample.bonds.diagonal() > 0.0)
    inner = sample.bonds[stiff][:, stiff].tocsr()
    steps, small = int(sample.duration / step), step / substeps
    drive = sample.pulse.displacement(step * np.arange(steps))
    place, speed = np.zeros(len(sample.inertia)), np.zeros(len(sample.inertia))
    gain = small / sample.inertia[stiff]
    heard = np.empty(steps)
    began = process_time()
    for number in range(steps):
        speed += step / sample.inertia * (sample.push * drive[number] - soft @ place)
        before = place[stiff]
        near, fast = before.copy(), speed[stiff]
        for _ in range(substeps):
            fast -= gain * (inner @ near)
            near += small * fast
        place += step * speed
        place[stiff], speed[stiff] = near, fast
        heard[number] = speed[sample.heard].mean()
    return step * (np.arange(steps) + 0.5), heard, process_time() - began


def rigid(sample: Sample, fraction: float) -> Signal:
    """Clusters of bonded disks as rigid bodies, with the step that their own contacts allow."""
    place = cluster_modes(sample)
    body = (place.T @ sparse.diags_array(sample.inertia) @ place).tocsr()
    stiffness = (place.T @ (sample.stiffness - sample.bonds) @ place).tocsr()
    # Bodies turn about their centres of mass, so that their inertia is diagonal.
    inertia = body.diagonal()
    scale = 1.0 / np.sqrt(inertia)
    scaled = sparse.diags_array(scale) @ stiffness @ sparse.diags_array(scale)
    fastest = np.sqrt(sparse.linalg.eigsh(scaled, k=1, return_eigenvectors=False, tol=1e-3)[0])
    hear = np.asarray(place[sample.heard].mean(axis=0)).ravel()
    return leapfrog(
        stiffness, inertia, place.T @ sample.push, sample, fraction * 2.0 / fastest, lambda v: float(hear @ v)
    )


def cluster_modes(sample: Sample) -> sparse.csr_array:
    """Displacements of all disks for a unit translation or rotation of each cluster about its centre of mass."""
    x, y, label = sample.labels[:, 0], sample.labels[:, 1], sample.labels[:, 2].astype(int)
    mass = sample.inertia[::3]
    total = np.bincount(label, mass)
    dx, dy = (c - (np.bincount(label, mass * c) / total)[label] for c in (x, y))
    disk, one = np.arange(len(x)), np.ones(len(x))
    rows = np.concatenate([3 * disk, 3 * disk + 1, 3 * disk, 3 * disk + 1, 3 * disk + 2])
    columns = np.concatenate([3 * label, 3 * label + 1, 3 * label + 2, 3 * label + 2, 3 * label + 2])
    values = np.concatenate([one, one, -dy, dx, one])
    return sparse.csr_array((values, (rows, columns)), (3 * len(x), 3 * len(total)))


def only_bonds(state: State) -> sparse.csr_array:
    """Springs of the bonds alone."""
    pairs = state.assembly.pairs
    bare = replace(
        state,
        assembly=replace(
            state.assembly,
            pairs=pairs._replace(hertz=0.0 * pairs.hertz, mindlin=0.0 * pairs.mindlin),
            wall_pairs=state.assembly.wall_pairs._replace(hertz=0.0 * state.assembly.wall_pairs.hertz),
        ),
    )
    return springs(bare)[0]


def distance(found: Signal, exact: Signal) -> float:
    """Normalised L2 distance of two signals at the times of the first."""
    inside = (found[0] > exact[0][0]) & (found[0] < exact[0][-1])
    true = CubicSpline(exact[0], exact[1])(found[0][inside])
    return float(np.linalg.norm(found[1][inside] - true) / np.linalg.norm(true))


def main() -> None:
    """Print a table for each content."""
    configuration = load_configuration(Path(sys.argv[1]))
    experiment = configuration.experiment(provide_packing(configuration, None, print))
    packing, sand = experiment.stiffen()
    wave = replace(experiment.wave, damping=0.0, boundary_damping=0.0)
    print("| content % | method | step over its limit | run time over the plain one | signal error (L2) |")
    print("|---|---|---|---|---|")
    for content in CONTENTS:
        placed = [experiment.ordering(seed).at(content) for seed in range(1, LANES + 1)]
        bonds = lane_bonds(packing, experiment.cement, [placed[0].bonded], 1, "preserve")
        scene = wave_scene(packing, sand, wave, bonds)
        state = start(scene, features=choose_features(scene, "linear"), preload=packing.preload)
        sand_scene = wave_scene(packing, sand, wave, None)
        sand_state = start(sand_scene, features=choose_features(sand_scene, "linear"), preload=packing.preload)
        stiffness, push, inertia = springs(state)
        rank = np.argsort(state.assembly.order)
        pairs = rank[packing.pairs[placed[0].bonded]]
        graph = sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (scene.count, scene.count))
        label = connected_components(graph, directed=False)[1]
        vs = measure(experiment, content, [1])[0].vs or 500.0
        order = state.assembly.order
        sample = Sample(
            stiffness,
            only_bonds(state),
            push,
            inertia,
            3 * rank[listening_disks(packing, wave)] + 1,
            np.column_stack([packing.x[order], packing.y[order], label]),
            float(state.critical_time_step[0]),
            float(critical_time_step(sand_scene, sand_state.assembly, sand_state.features)[0]),
            Pulse(wave.amplitude, experiment.frequency(content)),
            1.0 / experiment.frequency(content) + 1.5 * packing.width / vs,
        )
        exact = explicit(sample, 0.1 * sample.limit)
        plain = explicit(sample, 0.8 * sample.limit)
        union = np.mean(np.any([cement.bonded for cement in placed], axis=0))
        print(
            f"| {content:g} | plain, bonded {100 * np.mean(placed[0].bonded):.0f} % of the contacts, in some of {LANES} "
            f"lanes {100 * union:.0f} % | 0.8 | 1 | {distance(plain, exact):.1e} |"
        )
        for substeps in (2, 4, 8):
            step = 0.8 * sample.limit * substeps
            if step < sample.soft_limit:
                found = substepped(sample, step, substeps)
                print(
                    f"| {content:g} | {substeps} substeps | 0.8 | {found[2] / plain[2]:.2f} "
                    f"| {distance(found, exact):.1e} |"
                )
        found = rigid(sample, 0.8)
        bodies = len(np.unique(label))
        print(
            f"| {content:g} | {bodies} rigid bodies | {0.8:g} of its own, {(found[0][1] - found[0][0]) / sample.limit:.1f} "
            f"of the plain one | {found[2] / plain[2]:.2f} | {distance(found, exact):.1e} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
