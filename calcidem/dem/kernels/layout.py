"""Arguments of the kernel: arrays, grouped by meaning, the names of their columns, and compile-time switches.

All is per metre of thickness and in SI units. ``N`` grains, ``M`` pairs, ``W`` walls, ``V`` wall pairs and ``L``
lanes. The lane is always the last axis. Arrays without a lane axis are common to all samples of a batch: geometry,
material, neighbours.
"""

from dataclasses import dataclass, fields
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

Floats: TypeAlias = npt.NDArray[np.floating[Any]]
Integers: TypeAlias = npt.NDArray[np.integer[Any]]
Flags: TypeAlias = npt.NDArray[np.bool_]

# To the compiler these names are constants.
X, Y, ROTATION = range(3)
"""Columns of what moves, and of the forces on it. Walls do not turn."""
XY = slice(X, Y + 1)
NORMAL_X, NORMAL_Y, DISTANCE, OVERLAP, APART_X, APART_Y, FIRST_ARM, SECOND_ARM = range(8)
"""Columns of `Pairs.geometry`."""
NORMAL, SHEAR, MOMENT = range(3)
"""Columns of the stiffnesses and forces of contacts; the moment turns with the stiffness of rotation."""
REFERENCE_OVERLAP = 2
"""Third column of `Pairs.linear`."""
STIFFNESS = 2
"""Third column of `Walls.reaction`."""
TENSION_LIMIT, SHEAR_LIMIT, FRICTION_SLOPE, BENDING = range(4)
"""Columns of `Pairs.strength`."""
NORMAL_PATH, TANGENT_PATH, NORMAL_SPEED, TANGENT_SPEED = range(4)
"""Columns of `Walls.motion`."""
PATHS, SPEEDS = slice(NORMAL_PATH, NORMAL_SPEED), slice(NORMAL_SPEED, None)
GAIN, TARGET, TOP_SPEED = range(3)
"""Columns of `Walls.servo`."""
WALL_WORK, CONTACT_LOSS, DAMPING_LOSS, LOAD_WORK = range(4)
"""Rows of `Watch.account`."""


class Grains(NamedTuple):
    """Disks, shared by all lanes."""

    radius: Floats
    """(N,) m."""
    inverse_mass: Floats
    """(N,) 1/kg; zero for a disk that is held and keeps its velocity."""
    inverse_inertia: Floats
    """(N,) 1/(kg m^2); zero for a disk that may not turn."""
    damping: Floats
    """(N,) local damping factor alpha."""
    friction: Floats
    """(N,) friction coefficient; a contact takes the smaller of its two ends."""
    load: Floats
    """(N, 3) constant external force x, y (N/m) and moment (N)."""
    shear_ratio: float
    """Hertz-Mindlin k_s / k_n = 2 (1 - nu) / (2 - nu) of their material."""


class Motion(NamedTuple):
    """Motion of the disks, lane by lane. Components are x, y and rotation."""

    displacement: Floats
    """(3 N, L) m, m, rad, measured from the reference positions."""
    velocity: Floats
    """(3 N, L) m/s, m/s, rad/s at the half step before the displacement."""


class Pairs(NamedTuple):
    """Pairs of disks that touch or may touch, sorted by (first, second) with first < second.

    For one sample the kernel may use *bundles* of eight pairs (`engine.leapfrog`). Shapes are then (B, 8) instead of
    (M,) and (B, K, 8) instead of (M, K). Bit l belongs to the pair in place l. ``start`` has the first bundle of each
    block of disks, and a disk is given by the row where its record begins. A record has four numbers (`records`).
    Displacements, velocities, origins and sums of forces are records, (4 N, 1), as are three constants of `Grains`:
    inverse mass with inverse inertia, damping and load.
    """

    start: Integers
    """(N + 1,) the pairs of first disk i are start[i] to start[i + 1] - 1."""
    first: Integers
    second: Integers
    """(M,) the two disks."""
    geometry: Floats
    """(M, 8) at the start: normal x and y from the first to the second disk, distance of the centres, overlap, x and y
    from the first centre to the second, arms from the first and the second centre to the contact.
    """
    hertz: Floats
    """(M,) coefficient h_n of F_n = h_n overlap^1.5, N/m^2.5."""
    mindlin: Floats
    """(M,) coefficient of k_s = 1.5 h_n (k_s / k_n) overlap^0.5, N/m^1.5."""
    tangent: Floats
    """(M, 2) normal and shear stiffness at the reference overlap, for the linear law, N/m."""
    friction: Floats
    """(M,) friction coefficient."""
    bond: Floats
    """(M, 3) stiffness of the parallel bond: normal and shear (N/m), rotation (N m)."""
    linear: Floats
    """(M, 3) linear group: normal stiffness, shear stiffness (N/m), reference overlap (m)."""
    strength: Floats
    """(M, 4) tensile strength and cohesion times the area of the bond (N/m), tangent of the friction angle, tension at
    the rim times that area over bending moment (1/m).
    """
    cemented: Integers
    """(M,) bit l: the pair of lane l is cemented."""
    intact: Integers
    """(M,) bit l: its bond is not broken."""
    shear: Floats
    """(M, L) shear force of the frictional part on the second disk, N/m."""
    root: Floats
    """(M, L) square root of the previous overlap (1e-15 where there was none), for shear rescaling and stiffnesses in
    the middle of a step.
    """
    bond_force: Floats
    """(3 M, L) normal force (compression positive), shear force (N/m) and moment (N) of the bond."""
    radii: Floats
    """Bundles only: (B, 2, 8) of the two disks, m."""


class WallPairs(NamedTuple):
    """Disks that touch or may touch a wall, sorted by disk."""

    start: Integers
    """(N + 1,) the wall pairs of disk i are start[i] to start[i + 1] - 1."""
    disk: Integers
    wall: Integers
    """(V,) the two bodies."""
    overlap: Floats
    """(V,) overlap in the reference geometry, m."""
    hertz: Floats
    tangent: Floats
    shear: Floats
    root: Floats
    """(V,), (V, 2), (V, L) and (V, L), as in `Pairs`."""


class Walls(NamedTuple):
    """Straight rigid walls. Their normal points to the side of the disks."""

    normal: Floats
    """(W, 2) unit vector."""
    friction: Floats
    """(W,) friction coefficient."""
    motion: Floats
    """(W, 4, L) displacement along the normal and the tangent (m), velocity along both (m/s)."""
    reaction: Floats
    """(W, 3, L) normal and shear force of the disks on the wall (N/m), normal stiffness (N/m)."""
    servo: Floats
    """(W, 3) gain (zero: no servo), target normal force (N/m), largest speed (m/s)."""


class Front(NamedTuple):
    """Work arrays of ``T`` consecutive steps that pass through the disks one behind the other."""

    levels: int
    """T."""
    block: int
    """Disks that one step is ahead of the next; at least the largest distance in memory between two disks of a pair."""
    slot_bits: int
    """K = 2^slot_bits slots for forces in each step."""
    force: Floats
    """(3 T K, L) N/m, N/m, N: sums over the pairs already visited by each step; zero between calls. Disk i has slot i
    modulo K. They hold a block and all disks its pairs reach, no more, so that the sums stay in the fastest cache.
    """
    wall_motion: Floats
    """(T + 1, W, 4, L) as in `Walls`, at the start of each step and after the last."""
    reaction: Floats
    """(T, W, 3, L) as in `Walls`, of each step."""
    parts: Floats
    """(64, 1) bundles only: records of the forces on the first disks of the pairs of a bundle, then on the second."""


class Recording(NamedTuple):
    """What is driven and what is written down during a call."""

    drive: Floats
    """(S, L) velocity during each step of the driven wall along its tangent, of driven disks along y, m/s."""
    driven: int
    """Index of the driven wall; -1 for none."""
    driven_disks: Integers
    """(D,) disks that are driven. They have to be held: the drive gives them one component of their velocity, and
    nothing changes the others.
    """
    offset: int
    """Steps of the drive and the samples that earlier calls have done."""
    stride: int
    """Steps between two samples."""
    listeners: Integers
    """Disks whose mean velocities are recorded, group by group."""
    groups: Integers
    """(G + 1,) the disks of group g are ``listeners[groups[g] : groups[g + 1]]``."""
    axes: Integers
    """(G,) component of the velocity of each group, `X` or `Y`."""
    samples: Floats
    """(S // stride, G, L) mean velocity of each group, m/s."""


class Watch(NamedTuple):
    """What may end a call early, and the energy account."""

    origin: Floats
    """(N, 2, L) displacement when the pair list was made, m."""
    wall_origin: Floats
    """(W, L) displacement of the walls along their normal when the pair list was made, m."""
    reach: float
    """A disk or wall that moved further than this since asks for a new list, m."""
    account: Floats
    """(4, L) J/m: work of moving walls and held disks, loss of the shear springs, local damping, external loads."""


class System(NamedTuple):
    """All that a kernel reads and changes; functions that need one part of it take that part."""

    grains: Grains
    motion: Motion
    pairs: Pairs
    wall_pairs: WallPairs
    walls: Walls
    front: Front
    recording: Recording
    watch: Watch
    """As their classes say."""


LANE_COUNTS = (1, 2, 4, 8, 16, 32)
"""Samples that can be advanced side by side, in whole registers: other numbers would be written beyond their ends."""

ABREAST = 8
"""Pairs of one sample that are computed side by side."""


@dataclass(frozen=True, slots=True)
class Features:
    """Switches that are constants during compilation, so a scene pays only for what it needs."""

    lanes: int = 1
    """Samples advanced side by side, one of `LANE_COUNTS`."""
    linear: bool = False
    """Contact law `linear`: normals and stiffnesses are those of the reference geometry, and Hertz contacts are
    replaced by their tangent there. Contacts neither slip nor open, and bonds do not break. Forces are changes from the
    reference state. No contact has a history. Otherwise law `finite`: normals and overlaps follow the displacements.
    """
    rotation: bool = True
    """Disks turn."""
    bonds: bool = False
    """Some pairs are cemented."""
    linear_group: bool = False
    """Cemented pairs carry the linear group of 'linearpbond' beside the bond."""
    breakage: bool = False
    """Bonds are checked against their strengths."""
    slip: bool = True
    """Shear forces are checked against Coulomb friction."""
    rescaling: bool = True
    """Shear rescaling mode 1 (see `laws.rescale_shear`)."""
    damping: bool = True
    """Local damping."""
    servo: bool = False
    """Some walls are moved to hold a force."""
    search: bool = False
    """The pair list is checked and renewed."""
    recording: bool = False
    """A wall is driven, and signals are recorded."""
    driven: bool = False
    """Some disks move with the drive of the recording."""
    loads: bool = True
    """Constant external forces act on some disks."""
    account: bool = False
    """Work and losses are summed for an energy balance."""
    bundles: bool = False
    """Eight pairs of one sample are computed at once, unless the order of an account forbids it; bits are the same.
    This pays from some hundred disks on.
    """
    midpoint: bool = False
    """The shear stiffness of a step is that of its middle instead of its end. Then contacts that stick during loading
    are of second order in the step. Impacts need it; loaded contacts that a wave meets do not.
    """

    def __post_init__(self) -> None:
        """Refuse combinations that contradict each other."""
        if self.lanes not in LANE_COUNTS:
            raise ValueError(f"lanes = {self.lanes}: choose 1, 2, 4, 8, 16 or 32")
        if self.linear:
            needless = [
                name for name in ("breakage", "slip", "servo", "search", "account", "midpoint") if getattr(self, name)
            ]
            if needless:
                raise ValueError(
                    f"linear = True excludes {', '.join(needless)}: its contacts keep their stiffness; switch them off"
                )
        if self.driven and not self.recording:
            raise ValueError("driven = True needs recording = True: it is a recording that has the drive")
        if not self.bonds and (self.linear_group or self.breakage):
            raise ValueError("linear_group and breakage belong to cemented pairs: set bonds = True or switch them off")

    def items(self) -> tuple[tuple[str, int | bool], ...]:
        """Names and values, in the order of declaration, and of what follows from them."""
        names = [field.name for field in fields(self)]
        return tuple((name, getattr(self, name)) for name in (*names, "bundled", "width"))

    @property
    def bundled(self) -> bool:
        """Whether pairs of one sample are computed side by side."""
        return self.bundles and self.lanes == 1 and not self.account

    @property
    def width(self) -> int:
        """Numbers in a vector of a pair."""
        return ABREAST if self.bundled else self.lanes
