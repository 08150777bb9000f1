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
Flags: TypeAlias = npt.NDArray[np.bool_]


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
    """(3 N, L) m, m, rad, measured from the reference positions"""
    velocity: Floats
    """(3 N, L) m/s, m/s, rad/s at the half step before the displacement"""


class Pairs(NamedTuple):
    """Pairs of disks that touch or may touch, sorted by (first, second) with first < second."""

    start: Integers
    """(N + 1,) the pairs of first disk i are start[i] to start[i + 1] - 1"""
    first: Integers
    """(M,)"""
    second: Integers
    """(M,)"""
    geometry: Floats
    """(M, 8) at the start: normal x and y from the first to the second disk, distance of the centres, overlap, x and y
    from the first centre to the second, arms from the first and the second centre to the contact"""
    hertz: Floats
    """(M,) coefficient h_n of F_n = h_n overlap^1.5, N/m^2.5"""
    mindlin: Floats
    """(M,) coefficient of k_s = 1.5 h_n (k_s / k_n) overlap^0.5, N/m^1.5"""
    tangent: Floats
    """(M, 2) normal and shear stiffness at the reference overlap, for the linear regime, N/m"""
    friction: Floats
    """(M,)"""
    bond: Floats
    """(M, 3) stiffness of the parallel bond: normal and shear (N/m), rotation (N m)"""
    linear: Floats
    """(M, 3) linear group: normal stiffness, shear stiffness (N/m), reference overlap (m)"""
    strength: Floats
    """(M, 4) tensile strength and cohesion times the area of the bond (N/m), tangent of the friction angle,
    tension at the rim times that area over bending moment (1/m)"""
    cemented: Integers
    """(M,) bit l: the pair of lane l follows the cement's laws"""
    intact: Integers
    """(M,) bit l: its bond is not broken"""
    shear: Floats
    """(M, L) shear force of the frictional part on the second disk, N/m"""
    inverse_root: Floats
    """(M, L) inverse square root of the previous overlap (1e15 where there was none), for shear rescaling only"""
    bond_force: Floats
    """(3 M, L) normal force (compression positive), shear force (N/m) and moment (N) of the bond"""


class WallPairs(NamedTuple):
    """Disks that touch or may touch a wall, sorted by disk."""

    start: Integers
    """(N + 1,) the wall pairs of disk i are start[i] to start[i + 1] - 1"""
    disk: Integers
    """(V,)"""
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
    inverse_root: Floats
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


class Front(NamedTuple):
    """Scratch of the steps in flight: ``T`` consecutive steps run through the disks one behind the other."""

    levels: int
    """T"""
    block: int
    """disks that one step is ahead of the next; at least the largest distance in memory between two disks of a pair"""
    slot_bits: int
    """K = 2^slot_bits slots for forces in each step"""
    force: Floats
    """(3 T K, L) N/m, N/m, N: sums over the pairs already visited by each step; zero between calls. Disk i has slot i
    modulo K. They hold a block and all disks its pairs reach, no more, so that the sums stay in the fastest cache."""
    wall_motion: Floats
    """(T + 1, W, 4, L) as in Walls, at the start of each step and after the last"""
    reaction: Floats
    """(T, W, 3, L) as in Walls, of each step"""


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
