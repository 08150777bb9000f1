from dataclasses import replace

import numpy as np
import pytest
from scenes import LINEAR, RADIUS, SOFT, SPACING, contact_stiffness, hexagonal

from calcidem.dem.engine.leapfrog import State, no_recording, run_kernel
from calcidem.dem.engine.scene import Scene
from calcidem.dem.engine.state import advance, start
from calcidem.dem.kernels.layout import Floats

EIGHT = replace(LINEAR, lanes=8, linear_group=False, loads=False, recording=True)  # as cells; four lanes are used
WAVELENGTH = 20.0 * SPACING
LANES = ((0, 0), (0, 1), (1, 1), (1, 0))  # direction of travel and of motion: P and S along x, P and S along y


def standing_waves(x: Floats, y: Floats, wavelength: float) -> Floats:
    """Speeds of a P and an S wave along x and a P and an S wave along y in the middle of a patch of disks.

    A standing wave cos(q x) is let go and watched in the middle. Up to its first zero, a quarter of a period, nothing
    from the edges arrives there.
    """
    scene = Scene(x, y, np.full(len(x), RADIUS), SOFT)
    state = start(scene, features=EIGHT, step_fraction=0.2)
    at = state.assembly.order
    middle = int(np.argmin(np.hypot(x - x.mean(), y - y.mean())))
    for lane, (travel, motion) in enumerate(LANES):
        along = (x, y)[travel]
        state.motion.displacement[:, motion, lane] = (
            1e-6 * np.cos(2.0 * np.pi / wavelength * (along - along[middle]))[at]
        )
    watched = int(np.flatnonzero(at == middle)[0])
    history = signals(state, watched, quarter_period(wavelength))
    crossing = np.argmax(history < 0.0, axis=0)
    rows, lanes = crossing - 1, np.arange(len(LANES))
    before, after = history[rows, lanes], history[crossing, lanes]
    quarter = (rows + before / (before - after)) * state.time_step[0]
    return wavelength / (4.0 * quarter)


def quarter_period(wavelength: float) -> float:
    """A little more than a quarter of the period of the slowest wave looked at here, s."""
    slowest = SPACING * np.sqrt(contact_stiffness()[1] / (2.0 * SOFT.density * np.pi * RADIUS**2))
    return 1.2 * wavelength / (4.0 * slowest)


def signals(state: State, disk: int, duration: float) -> Floats:
    """Displacement of a disk in its lane's direction of motion, at the steps."""
    motions = [motion for _, motion in LANES]
    lanes = np.arange(len(LANES))
    history = [state.motion.displacement[disk, motions, lanes]]
    state = advance(state, 1)
    for _ in range(int(duration / state.time_step[0])):
        history.append(state.motion.displacement[disk, motions, lanes])
        run_kernel(state, 1, no_recording(state))
    return np.array(history)


@pytest.mark.full
def test_waves_in_a_hexagonal_lattice_travel_at_the_speeds_of_theory() -> None:
    """c_s^2 = 3/8 (k_n + k_s) a^2 / m and c_p^2 = 3/8 (3 k_n + k_s) a^2 / m, along x as along y."""
    normal, shear = contact_stiffness()
    scale = 0.375 * SPACING**2 / (SOFT.density * np.pi * RADIUS**2)
    p, s = np.sqrt(scale * (3.0 * normal + shear)), np.sqrt(scale * (normal + shear))
    speeds = standing_waves(*hexagonal(43, 49, SPACING), WAVELENGTH)
    # A lattice is slower than the continuum by about (q a)^2 / 24 to (q a)^2 / 16: at most 0.6 % at this wavelength.
    np.testing.assert_allclose(speeds, [p, s, p, s], rtol=8e-3)
    assert np.all(speeds < np.array([p, s, p, s]))


def test_waves_along_the_axes_of_a_square_lattice_travel_at_the_speeds_of_theory() -> None:
    """c_p^2 = k_n a^2 / m and, because the disks turn, c_s^2 = k_s a^2 / (2 m)."""
    normal, shear = contact_stiffness()
    scale = SPACING**2 / (SOFT.density * np.pi * RADIUS**2)
    p, s = np.sqrt(scale * normal), np.sqrt(scale * shear / 2.0)
    column, row = np.meshgrid(np.arange(51.0), np.arange(51.0))
    speeds = standing_waves(column.ravel() * SPACING, row.ravel() * SPACING, WAVELENGTH)
    # As above; the freely turning disks add (q a)^2 / 16 or so to the S wave.
    np.testing.assert_allclose(speeds, [p, s, p, s], rtol=1.5e-2)


@pytest.mark.parametrize("mode", [1, 7, 15, 19])
def test_a_chain_has_the_dispersion_of_the_leapfrog_grid(mode: int) -> None:
    """A standing wave of a chain between held ends turns at sin(omega dt / 2) = dt sqrt(k / m) |sin(q a / 2)|."""
    bays, steps = 20, 500
    held = np.zeros(bays + 1, dtype=bool)
    held[[0, -1]] = True
    scene = Scene(SPACING * np.arange(bays + 1.0), np.zeros(bays + 1), np.full(bays + 1, RADIUS), SOFT, held=held)
    q = np.pi * mode / (bays * SPACING)
    shape = np.sin(q * np.asarray(scene.x))
    shape[[0, -1]] = 0.0
    state = start(scene, features=LINEAR, velocity=np.column_stack([shape, 0.0 * shape]))
    dt = state.time_step[0]
    state.motion.displacement[:, 0, 0] = dt * state.motion.velocity[:, 0, 0]  # no force acts at time zero
    place = np.empty((steps, bays + 1))
    for step in range(steps):
        place[step] = state.motion.displacement[:, 0, 0]
        run_kernel(state, 1, no_recording(state))
    frequency = np.sqrt(contact_stiffness()[0] / scene.mass[0])
    angle = 2.0 * np.arcsin(dt * frequency * np.sin(0.5 * q * SPACING))
    expected = dt / np.sin(angle) * np.sin(angle * np.arange(1, steps + 1))[:, None] * shape
    # 500 steps of roundings, a hundredfold amplified by the other modes they excite.
    np.testing.assert_allclose(place, expected, atol=1e-11 * np.abs(expected).max())
