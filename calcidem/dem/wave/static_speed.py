"""Speed of long shear waves in a cemented sample from its static stiffness, for comparison with velocities."""

from typing import NamedTuple

import numpy as np

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.scene import Bonds
from calcidem.dem.engine.state import start
from calcidem.dem.engine.statics import sheared_motion, sheared_triangles, triangulate
from calcidem.dem.kernels.layout import Flags, Integers
from calcidem.dem.sample.settling import settle
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.scene import wave_scene

LARGEST_STATIC_ERROR = 0.1
"""Relative uncertainty above which no static speed is stored."""

_MARGINS = (2.0, 3.0, 4.0)
"""Distances from the side walls, over the mean diameter, that are excluded: the disks held there stiffen their
neighbours.
"""


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
    G is mean stress over mean strain where the wave is: along the whole path, and between the damped layers at floor
    and lid, which it cannot enter, weighted across the path by ``cos^2(pi y / h)``, the energy of a wave in a strip of
    height h (`strip_wave`).
    The sample is sheared twice. First all disks at the walls follow the shear, then only those at the side walls, with
    floor and lid free. The speed is the geometric mean of both. Displacements prescribed all around give an upper bound
    for the whole box (Huet 1990, doi:10.1016/0022-5096(90)90041-2), far too high where stiff patches reach its walls.
    They hardly affect the inner part.

    The error has two independent parts: half the difference of both shears, and half the range over three distances
    from the side walls. rho is the density of the grains times their area fraction with the same weights. The wave
    itself is slower, since local damping reduces each force that moves a disk. docs/velocity.md compares the two.
    """
    packing, sand = experiment.stiffen()
    state, corners = _state_at_rest(experiment, bonded), experiment.once(_corners)
    x, y, radius = (np.asarray(values, dtype=float) for values in (packing.x, packing.y, packing.radius))
    from_sides, from_ends = np.minimum(x, packing.width - x), np.minimum(y, packing.height - y)
    strip = packing.height - 2.0 * experiment.wave.boundary_thickness
    speeds = np.empty((2, len(_MARGINS)))
    for row, held in enumerate((np.minimum(from_sides, from_ends) < radius, from_sides < radius)):
        triangles = sheared_triangles(state, sheared_motion(state, held), corners)
        from_sides_here = np.minimum(triangles.middle[:, 0], packing.width - triangles.middle[:, 0])
        across = (triangles.middle[:, 1] - 0.5 * packing.height) / strip
        energy = np.where(np.abs(across) < 0.5, np.cos(np.pi * across) ** 2, 0.0)
        for column, margin in enumerate(_MARGINS):
            inner = from_sides_here > margin * 2.0 * radius.mean()
            part = triangles.weighted(np.where(inner, energy, 0.0))
            speeds[row, column] = np.sqrt(max(0.0, part.modulus) / (sand.density * part.solid))
    clamped, free = speeds[:, len(_MARGINS) // 2]
    speed = float(np.sqrt(clamped * free))
    if not speed > 0.0:
        raise ValueError("bonded: the inner part of the sample carries no shear: give more cement, or a denser packing")
    spread = np.hypot(0.5 * abs(clamped - free), 0.5 * np.ptp(speeds.mean(axis=0)))
    return StaticSpeed(speed, float(spread / speed))


def _corners(experiment: Experiment) -> Integers:
    return triangulate(experiment.packing.x, experiment.packing.y)


def _state_at_rest(experiment: Experiment, bonded: Flags) -> State:
    """State of a cemented sample before its wave; arguments and errors as for `static_speed`."""
    packing, sand = experiment.stiffen()
    rule, keeps_forces = experiment.wave, experiment.installation == "preserve"
    bonds = Bonds(packing.pairs[bonded], experiment.cement, installation=experiment.installation)
    scene = wave_scene(packing, sand, rule, bonds if np.any(bonded) else None)
    state = start(scene, regime="linear" if keeps_forces else rule.regime, preload=packing.preload)
    if np.any(bonded) and not keeps_forces:
        state = settle(state, rule.unbalanced_force_ratio, rule.most_settling_steps)
    return state
