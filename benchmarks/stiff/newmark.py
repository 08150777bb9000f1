"""Implicit steps against the explicit lane kernel on the stiffest scenes.

The linear regime has a constant stiffness matrix, which is the best case for an implicit method: one sparse
factorisation (Newmark, beta = 1/4, unconditionally stable) and two triangular solves a step, with steps that the pulse
alone decides. Local damping is no part of it (its force is not linear in the velocity), so both run without.

    python benchmarks/stiff/newmark.py PACKING.pickle
"""

import pickle
import sys
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from calcidem.dem.arrival import record_duration
from calcidem.dem.cement import CementRule
from calcidem.dem.measurement import Experiment, measure
from calcidem.dem.pulse import Pulse
from calcidem.dem.stability import hertz_tangent, pair_stiffness
from calcidem.dem.state import State, choose_features, start
from calcidem.dem.wave import TRANSMITTER, lane_bonds, listening_disks, wave_scene


def springs(state: State) -> tuple[sparse.csr_array, np.ndarray, np.ndarray]:
    """Stiffness matrix, force on the disks for a unit rise of the transmitter, and inertia, in memory order."""
    pairs, wall_pairs, walls, scene = (
        state.assembly.pairs,
        state.assembly.wall_pairs,
        state.assembly.walls,
        state.scene,
    )
    radius, size = state.assembly.grains.radius, 3 * scene.count
    normal, shear, twist = (
        k[:, 0] for k in pair_stiffness(state.assembly, state.features, scene.sand.shear_ratio, None)
    )
    i, j, n = np.repeat(np.arange(scene.count), np.diff(pairs.start)), pairs.second, pairs.geometry[:, :2]
    half = 0.5 * pairs.geometry[:, 3]
    one, none = np.ones(len(j)), np.zeros(len(j))
    places = np.column_stack([3 * i, 3 * i + 1, 3 * i + 2, 3 * j, 3 * j + 1, 3 * j + 2])
    total = sparse.csr_array((size, size))
    for k, row in (
        (normal, [-n[:, 0], -n[:, 1], none, n[:, 0], n[:, 1], none]),
        (shear, [n[:, 1], -n[:, 0], half - radius[i], -n[:, 1], n[:, 0], half - radius[j]]),
        (twist, [none, none, -one, none, none, one]),
    ):
        rows = sparse.csr_array(
            (np.column_stack(row).ravel(), (np.repeat(np.arange(len(j)), 6), places.ravel())), (len(j), size)
        )
        total = total + rows.T @ sparse.diags_array(k) @ rows
    disk, wall = np.repeat(np.arange(scene.count), np.diff(wall_pairs.start)), wall_pairs.wall
    tangent = hertz_tangent(wall_pairs.hertz, wall_pairs.overlap[:, None])[:, 0]
    sliding = scene.sand.shear_ratio * tangent * (walls.friction[wall] > 0.0)
    w, arm = walls.normal[wall], radius[disk] - 0.5 * wall_pairs.overlap
    push = np.zeros(size)
    for k, row in (
        (tangent, [w[:, 0], w[:, 1], 0.0 * arm]),
        (sliding, [-w[:, 1], w[:, 0], -arm]),
    ):
        columns = (3 * disk[:, None] + np.arange(3)).ravel()
        rows = sparse.csr_array(
            (np.column_stack(row).ravel(), (np.repeat(np.arange(len(disk)), 3), columns)), (len(disk), size)
        )
        total = total + rows.T @ sparse.diags_array(k) @ rows
        if k is sliding:
            push = rows.T @ (k * (wall == TRANSMITTER))
    inertia = np.column_stack([scene.mass, scene.mass, scene.inertia])[state.assembly.order].ravel()
    return total.tocsr(), push, inertia


def newmark(
    state: State, pulse: Pulse, listeners: np.ndarray, duration: float, step: float
) -> tuple[np.ndarray, float, float]:
    """Mean velocity of the listeners at every step; seconds to factorise, seconds to step."""
    began = perf_counter()
    stiffness, push, inertia = springs(state)
    solver = splu((sparse.diags_array(inertia) + 0.25 * step**2 * stiffness).tocsc())
    ready = perf_counter()
    place, speed, gain = np.zeros_like(inertia), np.zeros_like(inertia), np.zeros_like(inertia)
    rank = np.argsort(state.assembly.order)
    heard, received = 3 * rank[listeners] + 1, []
    for number in range(1, int(duration / step) + 1):
        guess = place + step * speed + 0.25 * step**2 * gain
        new = solver.solve(push * pulse.displacement(number * step) - stiffness @ guess)
        place = guess + 0.25 * step**2 * new
        speed = speed + 0.5 * step * (gain + new)
        gain = new
        received.append(speed[heard].mean())
    return np.array(received), ready - began, perf_counter() - ready


def main() -> None:
    """Print error and run time of both on contents 5 and 9 %."""
    packing = pickle.loads(Path(sys.argv[1]).read_bytes())  # noqa: S301 - a file of one's own
    experiment = Experiment(packing, stiffness_factor=13.0, cement_rule=CementRule(p_share=0.77, cluster_area=3.6e-6))
    wave = replace(experiment.wave, damping=0.0, boundary_damping=0.0, slowest=500.0)
    bare = replace(experiment, wave=wave, early_stop=False)
    for content in (5.0, 9.0):
        exact = measure(replace(bare, wave=replace(wave, step_fraction=0.1, samples_per_period=400)), content, [1])[0]
        measure(bare, content, [1])
        began = perf_counter()
        explicit = measure(bare, content, range(1, 9))
        cell = (perf_counter() - began) / 8
        time = (np.arange(len(exact.record.velocity)) + 1) * exact.record.interval - 0.5 * exact.record.time_step

        def distance(
            at: np.ndarray, signal: np.ndarray, time: np.ndarray = time, exact: np.ndarray = exact.record.velocity
        ) -> float:
            true = np.interp(at, time, exact)
            return float(np.linalg.norm(signal - true) / np.linalg.norm(true))

        own = explicit[0].record
        at = (np.arange(len(own.velocity)) + 1) * own.interval - 0.5 * own.time_step
        print(f"{content} % explicit, 8 lanes: {cell:.2f} s a cell, signal error {distance(at, own.velocity):.1e}")
        stiffened, sand = bare.stiffened()
        bonds = lane_bonds(stiffened, bare.cement, [exact.cement.bonded], 1, "preserve")
        scene = wave_scene(stiffened, sand, wave, bonds)
        state = start(scene, features=choose_features(scene, "linear"), preload=stiffened.preload)
        pulse = Pulse(wave.amplitude, exact.frequency)
        duration = record_duration(stiffened.width, wave.slowest, pulse.frequency)
        for steps in (50, 100, 200):
            step = 1.0 / (pulse.frequency * steps)
            signal, setup, run = newmark(state, pulse, listening_disks(stiffened, wave), duration, step)
            error = distance((np.arange(len(signal)) + 1) * step, signal)
            print(
                f"{content} % Newmark, step {step / state.limit[0]:.0f} limits: "
                f"{setup:.2f} s + {run:.2f} s a cell, signal error {error:.1e}"
            )


if __name__ == "__main__":
    main()
