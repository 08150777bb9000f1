"""Speed of long shear waves in a cemented sample from its static stiffness, for comparison with velocities."""

from typing import NamedTuple

import numpy as np

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.scene import Bonds
from calcidem.dem.engine.state import start
from calcidem.dem.engine.statics import sheared_motion, sheared_parts
from calcidem.dem.kernels.layout import Flags, Floats
from calcidem.dem.sample.packing import Packing
from calcidem.dem.sample.settling import settle
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.scene import wave_scene

LARGEST_STATIC_ERROR = 0.1
"""Relative uncertainty above which no static speed is stored."""

_MARGINS = (0.15, 0.2, 0.25)
"""Widths of the excluded rim over the smaller side of the box; held disks stiffen a rim of about 0.1."""


class StaticSpeed(NamedTuple):
    """Speed of long shear waves."""

    speed: float
    """m/s."""
    error: float
    """Relative uncertainty by the boundary conditions and by the size of the inner part."""


def static_speed(experiment: Experiment, bonded: Flags) -> StaticSpeed:
    """Speed sqrt(G / rho) of shear waves much longer than a disk, in the inner part of a sample.

    `ValueError` if the sample has no stiffness (`calcidem.dem.engine.statics.sheared_motion`), or no inner part;
    `SettlingError` if new bonds change the forces of the sample and it does not come to rest.

    Parameters
    ----------
    experiment
        Common settings; the packing touches all four walls.
    bonded
        (C,) True for cemented pairs of the packing.

    Notes
    -----
    G is mean stress over mean strain of the inner part. The sample is sheared twice. First all disks at the walls
    follow the shear, then only those at the side walls, with floor and lid free. The speed is the geometric mean of
    both. Displacements prescribed all around give an upper bound for the whole box (Huet 1990,
    doi:10.1016/0022-5096(90)90041-2), far too high where stiff patches reach its walls. They hardly affect the inner
    part.

    The error has two independent parts: half the difference of both shears, and half the range over three sizes of the
    inner part. rho is the density of the grains times their area fraction in the inner part. The wave itself is slower,
    since local damping reduces each force that moves a disk. docs/velocity.md compares the two.
    """
    packing, sand = experiment.stiffen()
    state = state_at_rest(experiment, bonded)
    from_sides, from_ends = distances_from_walls(packing)
    radius = np.asarray(packing.radius, dtype=float)
    sides, rim = from_sides < radius, np.minimum(from_sides, from_ends) < radius
    from_rim = np.minimum(from_sides, from_ends) / min(packing.width, packing.height)
    speeds = np.empty((2, len(_MARGINS)))
    for row, held in enumerate((rim, sides)):
        found = sheared_parts(state, sheared_motion(state, held), [from_rim > margin for margin in _MARGINS])
        speeds[row] = [np.sqrt(max(0.0, part.modulus) / (sand.density * part.solid)) for part in found]
    clamped, free = speeds[:, len(_MARGINS) // 2]
    speed = float(np.sqrt(clamped * free))
    if not speed > 0.0:
        raise ValueError("bonded: the inner part of the sample carries no shear: give more cement, or a denser packing")
    spread = np.hypot(0.5 * abs(clamped - free), 0.5 * np.ptp(speeds.mean(axis=0)))
    return StaticSpeed(speed, float(spread / speed))


def state_at_rest(experiment: Experiment, bonded: Flags) -> State:
    """State of a cemented sample before its wave; arguments and errors as for `static_speed`."""
    packing, sand = experiment.stiffen()
    rule, keeps_forces = experiment.wave, experiment.installation == "preserve"
    bonds = Bonds(packing.pairs[bonded], experiment.cement, installation=experiment.installation)
    scene = wave_scene(packing, sand, rule, bonds if np.any(bonded) else None)
    state = start(scene, regime="linear" if keeps_forces else rule.regime, preload=packing.preload)
    if np.any(bonded) and not keeps_forces:
        state = settle(state, rule.unbalanced_force_ratio, rule.most_settling_steps)
    return state


def distances_from_walls(packing: Packing) -> tuple[Floats, Floats]:
    """Distances (N,) of the centres from the nearer side wall, and from the nearer of floor and lid, m."""
    x, y = (np.asarray(values, dtype=float) for values in (packing.x, packing.y))
    return np.minimum(x, packing.width - x), np.minimum(y, packing.height - y)
