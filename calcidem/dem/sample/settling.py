"""Settling of cemented samples after the installation of bonds has changed their forces."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calcidem.dem.engine.leapfrog import State, duplicate, no_recording, run_in_place
from calcidem.dem.engine.readout import unbalanced_ratio
from calcidem.dem.kernels.layout import SPEEDS


class SettlingError(RuntimeError):
    """A cemented sample did not come to rest."""


def settle(
    state: State, unbalanced_force_ratio: float, most_steps: int, check: Callable[[], None] = lambda: None
) -> State:
    """Return the state with every lane at rest under the lid's servo; steps restart from zero.

    A balanced lane is frozen by a step of zero while the others continue, so its result does not depend on them.
    `SettlingError` if a lane does not come to rest.

    Parameters
    ----------
    state
        Newly started state.
    unbalanced_force_ratio
        Ratio to reach.
    most_steps
        Largest number of steps.
    check
        Called every fraction of a second; may raise to end the run.
    """
    lanes = state.features.lanes
    open_lanes = np.ones(lanes, dtype=bool)
    grains = state.assembly.grains
    damped = grains._replace(damping=np.full_like(grains.damping, 0.7))  # local damping factor
    features = replace(state.features, servo=True, damping=True, recording=False, driven=False)
    current = duplicate(replace(state, assembly=replace(state.assembly, grains=damped), features=features))
    while open_lanes.any():
        check()
        if current.steps >= most_steps:
            raise SettlingError(
                f"a cemented sample is not at rest after {most_steps} steps: "
                "raise most_settling_steps or unbalanced_force_ratio"
            )
        current = replace(current, time_step=np.where(open_lanes, state.time_step, 0.0))
        current = run_in_place(current, 500, no_recording(current))  # steps between two checks
        current = replace(current, time_step=state.time_step)
        for lane in np.flatnonzero(open_lanes):
            open_lanes[lane] = not unbalanced_ratio(current, int(lane)) < unbalanced_force_ratio
    current.motion.velocity[...] = 0.0
    current.assembly.walls.motion[:, SPEEDS] = 0.0
    assembly = replace(current.assembly, grains=grains)
    return replace(current, assembly=assembly, features=state.features, steps=0)
