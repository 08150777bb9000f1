"""Implicit steps against the explicit lane kernel on the stiffest scenes.

The linear regime has a constant stiffness matrix, which is the best case for an implicit method: one sparse
factorisation (Newmark, beta = 1/4, unconditionally stable) and two triangular solves a step, with steps that the pulse
alone decides. Local damping is no part of it (its force is not linear in the velocity), so both run without.

    python benchmarks/stiff/newmark.py examples/paper-small-pulse.toml
"""

import sys
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
from scipy import sparse
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import splu

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import load_configuration
from calcidem.app.studies.accuracy.settings import with_wave
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.stability import hertz_tangent, pair_stiffness
from calcidem.dem.engine.state import choose_features, start
from calcidem.dem.kernels.layout import NORMAL_X, NORMAL_Y, OVERLAP
from calcidem.dem.wave.domain import listening_disks
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure
from calcidem.dem.wave.pulse import Pulse
from calcidem.dem.wave.reading import record_duration
from calcidem.dem.wave.recorder import WaveRecord
from calcidem.dem.wave.scene import TRANSMITTER, lane_bonds, wave_scene

SEEDS = range(1, 9)
SAMPLES = 400  # in a period of the pulse
SETTLED = 0.01  # part of the record that is left out at its start, where a spline has nothing to lean on


def springs(state: State, lane: int = 0) -> tuple[sparse.csr_array, np.ndarray, np.ndarray]:
    """Stiffness matrix, force on the disks for a unit rise of the transmitter, and inertia, in memory order."""
    pairs, wall_pairs, walls, scene = (
        state.assembly.pairs,
        state.assembly.wall_pairs,
        state.assembly.walls,
        state.scene,
    )
    radius, size = state.assembly.grains.radius, 3 * scene.count
    normal, shear, twist = (
        k[:, lane] for k in pair_stiffness(state.assembly, state.features, scene.sand.shear_ratio, None)
    )
    i, j, n = pairs.first, pairs.second, pairs.geometry[:, [NORMAL_X, NORMAL_Y]]
    half = 0.5 * pairs.geometry[:, OVERLAP]
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
    began = process_time()
    stiffness, push, inertia = springs(state)
    solver = splu((sparse.diags_array(inertia) + 0.25 * step**2 * stiffness).tocsc())
    ready = process_time()
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
    return np.array(received), ready - began, process_time() - ready


def explicit(experiment: Experiment, content: float, fraction: float) -> tuple[WaveRecord, float]:
    """First sample's record with the lane kernel, and processor seconds of a cell in a full batch."""
    setting = with_wave(experiment, step_fraction=fraction, samples_per_period=SAMPLES)
    measure(setting, content, SEEDS[:1])
    began = process_time()
    record = measure(setting, content, SEEDS)[0].record
    return record, (process_time() - began) / len(SEEDS)


def main() -> None:
    """Print error and run time of both on contents 5 and 9 %."""
    configuration = load_configuration(Path(sys.argv[1]))
    experiment = configuration.experiment(provide_packing(configuration, None, print))
    wave = replace(experiment.wave, damping=0.0, boundary_damping=0.0, slowest=500.0)
    bare = replace(experiment, wave=wave, early_stop=False)
    print("| content % | method | step over the limit | s a cell | signal error (L2) |")
    print("|---|---|---|---|---|")
    for content in (5.0, 9.0):
        exact = measure(with_wave(bare, step_fraction=0.025, samples_per_period=SAMPLES), content, SEEDS[:1])[0]
        true = CubicSpline(exact.record.section.times, exact.record.section.received)
        end = exact.record.section.times[-1]

        def distance(
            at: np.ndarray, signal: np.ndarray, true: CubicSpline = true, end: float = end, first: float = SETTLED
        ) -> float:
            inside = (at > first * end) & (at < end)
            return float(np.linalg.norm(signal[inside] - true(at[inside])) / np.linalg.norm(true(at[inside])))

        for fraction in (0.8, 0.4, 0.2):
            record, seconds = explicit(bare, content, fraction)
            error = distance(record.section.times, record.section.received)
            print(f"| {content:g} | explicit, 8 lanes | {fraction:g} | {seconds:.2f} | {error:.1e} |", flush=True)
        stiffened, sand = bare.stiffen()
        bonds = lane_bonds(stiffened, bare.cement, [exact.cement.bonded], 1, "preserve")
        scene = wave_scene(stiffened, sand, wave, bonds)
        state = start(scene, features=choose_features(scene, "linear"), preload=stiffened.preload)
        pulse = Pulse(wave.amplitude, exact.frequency)
        duration = record_duration(experiment.distance, wave.slowest, pulse.frequency)
        for steps in (50, 100, 200):
            step = 1.0 / (pulse.frequency * steps)
            signal, setup, run = newmark(state, pulse, listening_disks(stiffened, wave), duration, step)
            error = distance((np.arange(len(signal)) + 1) * step, signal)
            print(
                f"| {content:g} | Newmark | {step / state.critical_time_step[0]:.0f} | {setup + run:.2f} | {error:.1e} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
