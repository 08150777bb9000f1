"""Local damping and the speed of a front."""

import numpy as np
import pytest
from scenes import LINEAR, RADIUS, SOFT, SPACING

from calcidem.dem.engine.leapfrog import no_recording, run_kernel
from calcidem.dem.engine.scene import Scene
from calcidem.dem.engine.state import start

WIDTH = 12.0 * SPACING  # of the front: a chain is slower than the continuum by (a / width)^2 / 24 or so
COUNT = 400
WATCHED = (180, 240)  # passed before what the free end behind the front sends, at c sqrt(1 + alpha), catches up


@pytest.mark.parametrize("damping", [0.0, 0.3, 0.7])
def test_a_rising_front_runs_slower_by_local_damping(damping: float) -> None:
    """Force and velocity have one sign, so 1 - alpha of the force is left: the front runs at c sqrt(1 - alpha)."""
    radius = np.array([RADIUS])
    stiffness = 1.5 * float(SOFT.hertz_coefficient(radius, radius)[0]) * np.sqrt(2.0 * RADIUS - SPACING)
    x = SPACING * np.arange(float(COUNT))
    scene = Scene(x, np.zeros(COUNT), np.full(COUNT, RADIUS), SOFT, damping=damping)
    speed = SPACING * np.sqrt(stiffness * (1.0 - damping) / scene.mass[0])
    height = 1e-3
    # A step in velocity, smooth as tanh, on its way to the right: u_x = -v / c.
    profile = 0.5 * height * (1.0 - np.tanh((x - 150.0 * SPACING) / WIDTH))
    displacement = 0.5 * height / speed * WIDTH * np.log1p(np.exp(-2.0 * (x - 150.0 * SPACING) / WIDTH))
    state = start(scene, features=LINEAR, velocity=np.column_stack([profile, 0.0 * x]))
    order = state.assembly.order
    state.motion.displacement[:, 0, 0] = displacement[order]
    watched = [int(np.flatnonzero(order == disk)[0]) for disk in WATCHED]
    steps = int(110.0 * SPACING / speed / state.time_step[0])
    history = np.empty((steps, 2))
    for step in range(steps):
        run_kernel(state, 1, no_recording(state))
        history[step] = state.motion.velocity[watched, 0, 0]
    after = np.argmax(history > 0.5 * height, axis=0)
    before, beyond = history[after - 1, [0, 1]], history[after, [0, 1]]
    arrival = (after - 1 + (0.5 * height - before) / (beyond - before)) * state.time_step[0]
    assert (WATCHED[1] - WATCHED[0]) * SPACING / (arrival[1] - arrival[0]) == pytest.approx(speed, rel=2e-3)
