"""Impacts: the part of the step limit that no present stiffness shows.

Disks that hardly touch have hardly any stiffness, and a scheme that goes by it leaps over their collision. What counts
is the overlap that a collision will reach, at present speeds or under forces that nothing balances yet: loads, gravity,
a lid. Hertz's law makes of both how long such a contact lasts (Landau & Lifshitz, Theory of Elasticity, section 9).
"""

from typing import NamedTuple

import numpy as np

from calcidem.dem.engine.assembly import Assembly, lanes_of_bits
from calcidem.dem.engine.portable import length, root
from calcidem.dem.engine.scene import Scene
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.layout import (
    GAIN,
    NORMAL,
    NORMAL_SPEED,
    STIFFNESS,
    TARGET,
    TOP_SPEED,
    Floats,
    X,
    Y,
)

_DURATION = 3.2180
"""Of a Hertz contact over ``(m*^2 / (h^2 v))^(1/5)``: 2.943275 (5/4)^(2/5)."""
_QUIET = 1e-2  # free energy over the stored one up to which no impact matters


class Instant(NamedTuple):
    """What a state does now, in double precision and memory order.

    Attributes
    ----------
    velocity, force
        (N, 3, L) velocities (m/s, rad/s), and net forces (N/m) and moments (N).
    overlap, wall_overlap
        (M, L) and (V, L) of the listed pairs, m.
    reaction
        (W, 3, L) as in `layout.Walls`.
    kinetic, stored
        (L,) energies, J/m, see `readout.Energies`.
    """

    velocity: Floats
    force: Floats
    overlap: Floats
    wall_overlap: Floats
    reaction: Floats
    kinetic: Floats
    stored: Floats


def contact_durations(
    scene: Scene, assembly: Assembly, features: Features, now: Instant, time_step: Floats
) -> tuple[Floats, Floats]:
    """How long the shortest contacts will last that disks may make, (N, L) s, and the fastest speed, (L,) m/s.

    Infinite for disks that are held, and for all where next to nothing moves freely, or nothing is listed that it could
    hit.

    Notes
    -----
    Two disks of reduced mass m* that meet at a speed v touch for ``3.218 (m*^2 / (h^2 v))^(1/5)``. A disk is taken to
    hit its like, at its own speed and that of the fastest thing together; a heavier partner or a wall makes the contact
    longer. An unbalanced force F adds the speed that a contact gives back which it has pressed, ``v^2 = 1.6 F d / m``
    with ``F = h d^1.5``: so v stays as it is while two disks collide, and a disk at rest has one before it falls.
    """
    radius = assembly.grains.radius.astype(float)
    inverse = assembly.grains.inverse_mass.astype(float)[:, None]
    coefficient = scene.sand.hertz_coefficient(radius, radius)[:, None]
    mass = scene.sand.density * np.pi * (radius * radius)[:, None]
    speed, push = (length(field[:, X], field[:, Y]) for field in (now.velocity, now.force))
    walls = _wall_speeds(assembly, now.reaction, time_step)
    fastest = np.maximum(speed.max(axis=0), walls.max(axis=0, initial=0.0))
    depth = root(push / coefficient, 3)
    released = 0.8 * push * depth * depth * (inverse > 0.0)
    own, disk = assembly.wall_pairs, assembly.wall_pairs.disk
    free = (0.5 * mass * speed * speed + released).sum(axis=0) + (0.5 * mass[disk] * walls[own.wall] ** 2).sum(axis=0)
    approach = np.sqrt((speed + fastest) ** 2 + 2.0 * released / mass)
    ratio = 0.5 * mass / coefficient
    with np.errstate(divide="ignore"):
        duration = _DURATION / root(approach / (ratio * ratio), 5)
    matters = (free > _QUIET * now.stored) & _may_touch(assembly, features)
    return np.where((inverse > 0.0) & matters, duration, np.inf), fastest


def _wall_speeds(assembly: Assembly, reaction: Floats, time_step: Floats) -> Floats:
    """Speeds (W, L) of walls along their normals, as they are or as a servo will make them, m/s."""
    walls = assembly.walls
    gain, target, fastest = (walls.servo[:, column, None].astype(float) for column in (GAIN, TARGET, TOP_SPEED))
    held = reaction[:, STIFFNESS] > 0.0
    speed = gain * np.abs(target - reaction[:, NORMAL]) / (np.where(held, reaction[:, STIFFNESS], 1.0) * time_step)
    served = np.where(held, np.minimum(speed, fastest), fastest)
    return np.where(gain > 0.0, served, np.abs(walls.motion[:, NORMAL_SPEED].astype(float)))


def _may_touch(assembly: Assembly, features: Features) -> Floats:
    """Lanes (L,) in which a wall or a disk is listed that some disk may hit and is not cemented to."""
    loose = ~lanes_of_bits(assembly.pairs.intact, features.lanes)
    return np.asarray(loose.any(axis=0) | (len(assembly.wall_pairs.disk) > 0))
