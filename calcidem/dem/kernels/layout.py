"""Arrays a kernel works on, grouped by what they describe.

Everything is per metre of thickness and in SI units. ``N`` grains, ``M`` pairs, ``W`` walls, ``V``
wall pairs and ``L`` lanes. The lane is always the last axis. Arrays without a lane axis are what all
samples of a batch share: geometry, material, neighbours.
"""

from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

Floats: TypeAlias = npt.NDArray[np.floating[Any]]
Integers: TypeAlias = npt.NDArray[np.integer[Any]]


class Grains(NamedTuple):
    """Disks, shared by all lanes."""

    radius: Floats
    """(N,) m"""
    inverse_mass: Floats
    """(N,) 1/kg; zero for a disk that is held and keeps its velocity"""
    inverse_inertia: Floats
    """(N,) 1/(kg m^2); zero for a disk that may not turn"""
    damping: Floats
    """(N,) local damping factor alpha"""
    friction: Floats
    """(N,) friction coefficient; a contact takes the smaller of its two ends"""
    load: Floats
    """(N, 3) constant external force (N/m) and moment (N)"""


class Motion(NamedTuple):
    """What moves, lane by lane. Components are x, y and rotation."""

    displacement: Floats
    """(N, 3, L) m, m, rad, measured from the reference positions"""
    velocity: Floats
    """(N, 3, L) m/s, m/s, rad/s at the half step before the displacement"""
    force: Floats
    """(K, 3, L) N/m, N/m, N: sum over the pairs already visited in the running step; zero between steps. Disk i has
    slot i modulo K, a power of two above the largest distance in memory between two disks of a pair, so that the
    sums stay in the fastest cache."""


class Pairs(NamedTuple):
    """Pairs of disks that touch or may touch, sorted by (first, second) with first < second."""

    start: Integers
    """(N + 1,) the pairs of first disk i are start[i] to start[i + 1] - 1"""
    second: Integers
    """(M,)"""
    geometry: Floats
    """(M, 4) reference normal x and y from the first to the second disk, centre distance, overlap"""
    hertz: Floats
    """(M,) coefficient h_n of F_n = h_n overlap^1.5, N/m^2.5"""
    tangent: Floats
    """(M, 2) normal and shear stiffness at the reference overlap, for the linear regime, N/m"""
    friction: Floats
    """(M,)"""
    bond: Floats
    """(M, 3) stiffness of the parallel bond: normal and shear (N/m), rotation (N m)"""
    linear: Floats
    """(M, 3) linear group: normal stiffness, shear stiffness (N/m), reference overlap (m)"""
    strength: Floats
    """(M, 4) bond radius (m), tensile strength, cohesion (Pa), tangent of the friction angle"""
    cemented: Integers
    """(M,) bit l: the pair of lane l follows the cement's laws"""
    intact: Integers
    """(M,) bit l: its bond is not broken"""
    shear: Floats
    """(M, L) shear force of the frictional part on the second disk, N/m"""
    root: Floats
    """(M, L) square root of the previous overlap, for shear rescaling only"""
    bond_force: Floats
    """(M, 3, L) normal force (compression positive), shear force (N/m) and moment (N) of the bond"""


class WallPairs(NamedTuple):
    """Disks that touch or may touch a wall, sorted by disk."""

    start: Integers
    """(N + 1,) the wall pairs of disk i are start[i] to start[i + 1] - 1"""
    wall: Integers
    """(V,)"""
    overlap: Floats
    """(V,) overlap in the reference geometry, m"""
    hertz: Floats
    """(V,) as in Pairs"""
    tangent: Floats
    """(V, 2) as in Pairs"""
    shear: Floats
    """(V, L) as in Pairs"""
    root: Floats
    """(V, L) as in Pairs"""


class Walls(NamedTuple):
    """Straight rigid walls. Their normal points to the side of the disks."""

    normal: Floats
    """(W, 2)"""
    friction: Floats
    """(W,)"""
    motion: Floats
    """(W, 4, L) displacement along the normal and the tangent (m), velocity along both (m/s)"""
    reaction: Floats
    """(W, 3, L) normal and shear force of the disks on the wall (N/m), normal stiffness (N/m)"""
    servo: Floats
    """(W, 3) gain (zero: no servo), target normal force (N/m), largest speed (m/s)"""


class Recording(NamedTuple):
    """What is driven and what is written down during a call."""

    drive: Floats
    """(S, L) velocity of the driven wall along its tangent during each step, m/s"""
    driven: int
    """index of the driven wall"""
    offset: int
    """steps of the drive and the samples that earlier calls have done"""
    stride: int
    """steps between two samples"""
    receiver: int
    """index of the wall whose shear force is recorded"""
    listeners: Integers
    """disks whose mean velocity along y is recorded"""
    samples: Floats
    """(S // stride, 2, L) shear force on the receiving wall (N/m), mean velocity (m/s)"""


class Watch(NamedTuple):
    """What may end a call early, and the energy account."""

    origin: Floats
    """(N, 2, L) displacement when the pair list was made"""
    wall_origin: Floats
    """(W, L) displacement of the walls along their normal when the pair list was made"""
    reach: float
    """m: a disk or wall that moved further than this since asks for a new list"""
    account: Floats
    """(4, L) J/m: work of moving walls and held disks, loss of the shear springs, local damping, external loads"""
