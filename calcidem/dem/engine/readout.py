"""Reading a state: contact forces, unbalanced force, energies.

Contact histories belong to the position before the last drift. One kernel step on a copy brings them to the present
position. Energies stored in contacts are the integrals of the laws.
"""

from dataclasses import dataclass, replace

import numpy as np

from calcidem.dem.engine.assembly import Assembly, lanes_of_bits, listed_pairs
from calcidem.dem.engine.leapfrog import State, look_ahead
from calcidem.dem.engine.portable import length, three_halves
from calcidem.dem.engine.scene import Scene
from calcidem.dem.kernels.layout import (
    CONTACT_LOSS,
    DAMPING_LOSS,
    DISTANCE,
    LOAD_WORK,
    MOMENT,
    NORMAL,
    NORMAL_PATH,
    NORMAL_X,
    NORMAL_Y,
    OVERLAP,
    REFERENCE_OVERLAP,
    SHEAR,
    STIFFNESS,
    WALL_WORK,
    XY,
    Features,
    Flags,
    Floats,
    Integers,
    X,
    Y,
)


def stored_energy(
    scene: Scene, assembly: Assembly, features: Features, overlap: Floats, wall_overlap: Floats
) -> Floats:
    """Energy (L,) of all contacts, J/m: Hertz 2/5 F_n d, shear F_s^2 / (2 k_s), springs of linear groups and bonds.

    Parameters
    ----------
    scene, features
        Scene and its features.
    assembly
        Assembly with the histories at the present position.
    overlap, wall_overlap
        (M, L) and (V, L) of its pairs, m.
    """
    pairs, wall_pairs, ratio = assembly.pairs, assembly.wall_pairs, scene.sand.shear_ratio
    normal, stiffness = hertz_energy(pairs.hertz, overlap, ratio)
    if features.bonds:
        if features.linear_group:
            cemented = lanes_of_bits(pairs.cemented, features.lanes)
            linear = pairs.linear.astype(float)[:, :, None]
            pressed = np.maximum(overlap - linear[:, REFERENCE_OVERLAP], 0.0)
            normal = np.where(cemented, 0.5 * linear[:, NORMAL] * pressed * pressed, normal)
            stiffness = np.where(cemented, linear[:, SHEAR], stiffness)
        else:
            normal = np.where(lanes_of_bits(pairs.intact, features.lanes), 0.0, normal)
    total = normal.sum(axis=0) + _spring_energy(pairs.shear, stiffness)
    normal, stiffness = hertz_energy(wall_pairs.hertz, wall_overlap, ratio)
    total = total + normal.sum(axis=0) + _spring_energy(wall_pairs.shear, stiffness)
    if features.bonds:
        for kind in (NORMAL, SHEAR, MOMENT):
            total = total + _spring_energy(pairs.bond_force[:, kind], pairs.bond[:, kind, None].astype(float))
    return np.asarray(total)


def hertz_energy(coefficient: Floats, overlap: Floats, shear_ratio: float = 0.0) -> tuple[Floats, Floats]:
    """Energy 2/5 F_n d of Hertz contacts and their shear stiffness."""
    hertz, pressed = coefficient.astype(float)[:, None], np.maximum(overlap, 0.0)
    root = np.sqrt(pressed)
    return 0.4 * hertz * pressed * pressed * root, 1.5 * hertz * shear_ratio * root


def _spring_energy(force: Floats, stiffness: Floats) -> Floats:
    """Sum of F^2 / (2 k) over springs (M, L); springs without stiffness carry nothing."""
    safe = np.where(stiffness > 0.0, stiffness, 1.0)
    return np.asarray(np.where(stiffness > 0.0, force.astype(float) ** 2 / (2.0 * safe), 0.0).sum(axis=0))


@dataclass(frozen=True, slots=True)
class ContactForces:
    """Contacts of one lane that carry force or cement.

    Attributes
    ----------
    pairs
        (C, 2) indices of the first and second disk in the scene. The first comes first in memory, along the longer side
        of the scene. Forces are those of the first disk on the second.
    overlap
        (C,) m.
    normal, shear
        (C,) N/m on the second disk, along n from the first to the second (compression positive) and along
        ``t = (-n_y, n_x)``. From the other end n, t and the force are reversed, so both values stay the same.
    moment
        (C,) N, of the bond on the second disk, positive counterclockwise; its opposite acts on the first. The shear
        force adds ``-shear`` times the arm to both. An arm is the radius less half of the overlap.
    bonded
        (C,) True for intact bonds.
    """

    pairs: Integers
    overlap: Floats
    normal: Floats
    shear: Floats
    moment: Floats
    bonded: Flags


@dataclass(frozen=True, slots=True)
class WallForces:
    """Contacts of one lane between disks and walls.

    Attributes
    ----------
    disks, walls
        (V,) indices in the scene.
    overlap
        (V,) m.
    normal, shear
        (V,) N/m on the disk, along the wall's normal (compression positive) and along its tangent ``t = (-n_y, n_x)``.
    """

    disks: Integers
    walls: Integers
    overlap: Floats
    normal: Floats
    shear: Floats


@dataclass(frozen=True, slots=True)
class Energies:
    """Energies of one lane, J per metre of thickness; the balance is ``supplied = stored + lost``.

    The last four are summed from half a step after the start, and only if the state was started with the ``account``
    feature.

    Attributes
    ----------
    kinetic
        ``m v(n - 1/2) v(n + 1/2) / 2``, with the velocities half a step before and after. With their product, linear
        springs conserve energy to rounding at any stable step. It is slightly negative where all velocities reverse.
    elastic
        Stored in contacts and bonds.
    wall_work
        Work of moving walls and of moving held disks.
    contact_loss
        Loss by friction, by changing shear stiffness, by broken bonds, and by cutting initial forces off at the limits
        of friction or strength.
    damping_loss
        Dissipated by local damping.
    load_work
        Work of the constant external forces and moments.
    """

    kinetic: float
    elastic: float
    wall_work: float
    contact_loss: float
    damping_loss: float
    load_work: float

    @property
    def imbalance(self) -> float:
        """Kinetic and elastic energy and losses, less the work supplied; constant in an exact solution."""
        return self.kinetic + self.elastic + self.contact_loss + self.damping_loss - self.wall_work - self.load_work


def overlaps(state: State) -> Floats:
    """(M, L) overlaps of the listed pairs, m; negative for a gap."""
    pairs = state.assembly.pairs
    moved = state.motion.displacement[:, XY].astype(float)
    apart = moved[pairs.second] - moved[pairs.first]
    n_x, n_y, distance, overlap = (
        pairs.geometry[:, column, None].astype(float) for column in (NORMAL_X, NORMAL_Y, DISTANCE, OVERLAP)
    )
    further: Floats = n_x * apart[:, X] + n_y * apart[:, Y]
    if not state.features.linear:
        now = length(n_x * distance + apart[:, X], n_y * distance + apart[:, Y])
        further = (2.0 * distance * further + (apart[:, X] ** 2 + apart[:, Y] ** 2)) / (now + distance)
    return overlap - further


def wall_overlaps(state: State) -> Floats:
    """(V, L) overlaps of the listed wall pairs, m."""
    wall_pairs, walls = state.assembly.wall_pairs, state.assembly.walls
    normal = walls.normal[wall_pairs.wall].astype(float)
    moved = state.motion.displacement[wall_pairs.disk, XY].astype(float)
    away = normal[:, X, None] * moved[:, X] + normal[:, Y, None] * moved[:, Y]
    closer: Floats = walls.motion[wall_pairs.wall, NORMAL_PATH] - away
    return wall_pairs.overlap.astype(float)[:, None] + closer


def contact_forces(state: State, lane: int = 0, ahead: State | None = None) -> ContactForces:
    """Forces between the disks at the present position; `ValueError` with the law ``linear``, which has none.

    ``ahead`` is the result of `look_ahead`, if it is known.
    """
    _refuse_linear(state)
    pairs = (ahead or look_ahead(state)).assembly.pairs
    ends = listed_pairs(state.assembly)
    depth = overlaps(state)[:, lane]
    intact, cemented = (lanes_of_bits(bits, state.features.lanes)[:, lane] for bits in (pairs.intact, pairs.cemented))
    normal = pairs.hertz * three_halves(np.maximum(depth, 0.0))
    if state.features.linear_group:
        pressed = np.maximum(depth - pairs.linear[:, REFERENCE_OVERLAP], 0.0) * pairs.linear[:, NORMAL]
        normal = np.where(cemented, pressed, normal)
    else:
        normal = np.where(intact, 0.0, normal)
    bond = pairs.bond_force[:, :, lane]
    normal, shear = normal + bond[:, NORMAL], pairs.shear[:, lane] + bond[:, SHEAR]
    present = (normal != 0.0) | intact
    order = state.assembly.order
    return ContactForces(
        pairs=order[ends[present]],
        overlap=depth[present],
        normal=normal[present].astype(float),
        shear=shear[present].astype(float),
        moment=bond[present, MOMENT].astype(float),
        bonded=intact[present],
    )


def wall_contacts(state: State, lane: int = 0) -> WallForces:
    """Forces of walls on disks at the present position; `ValueError` with the law ``linear``."""
    _refuse_linear(state)
    wall_pairs = look_ahead(state).assembly.wall_pairs
    depth = wall_overlaps(state)[:, lane]
    touching = depth > 0.0
    return WallForces(
        disks=state.assembly.order[wall_pairs.disk[touching]],
        walls=wall_pairs.wall[touching],
        overlap=depth[touching],
        normal=(wall_pairs.hertz * three_halves(np.maximum(depth, 0.0)))[touching].astype(float),
        shear=wall_pairs.shear[touching, lane].astype(float),
    )


def wall_reactions(state: State, lane: int = 0) -> Floats:
    """(W, 2) normal and shear force of the disks on each wall at the present position, N/m; see `wall_contacts`."""
    return look_ahead(state).assembly.walls.reaction[:, :STIFFNESS, lane].astype(float)


def look_undamped(state: State) -> State:
    """Result of `look_ahead` without damping."""
    undamped = state.assembly.grains._replace(damping=np.zeros_like(state.assembly.grains.damping))
    return look_ahead(replace(state, assembly=replace(state.assembly, grains=undamped)))


def net_forces(state: State, lane: int = 0, ahead: State | None = None) -> Floats:
    """(N, 3) net force (N/m) and moment (N) on the disks without damping, in the order of the scene.

    They follow from the change of velocities in one kernel step on a copy; zero for held disks. ``ahead`` is the result
    of `look_undamped`, the same for all lanes, if it is known.
    """
    ahead = ahead or look_undamped(state)
    before = state.motion.velocity[:, :, lane] if state.steps else 0.0
    # Convert to double precision: NumPy 1 would divide single-precision arrays by a double in single precision.
    change = (ahead.motion.velocity[:, :, lane] - before).astype(float) / state.time_step[lane]
    inertia = np.column_stack([state.scene.mass, state.scene.mass, state.scene.inertia])
    return state.to_scene_order(change) * inertia


def unbalanced_ratio(state: State, lane: int = 0) -> float:
    """Sum of the net forces on the disks over that of their contact forces (PFC 'mech-ratio-average'); 0 without."""
    _refuse_linear(state)
    ahead = look_undamped(state)
    net, contacts = net_forces(state, lane, ahead), contact_forces(state, lane, ahead)
    magnitude = 2.0 * float(length(contacts.normal, contacts.shear).sum())
    magnitude += float(np.abs(ahead.assembly.walls.reaction[:, :STIFFNESS, lane].astype(float)).sum())
    unbalanced = float(length(net[:, X], net[:, Y]).sum())
    return unbalanced / magnitude if magnitude > 0.0 else 0.0


def energies(state: State, lane: int = 0) -> Energies:
    """Energies of one lane at the present position; `ValueError` with the law ``linear``."""
    _refuse_linear(state)
    ahead = look_ahead(state)
    velocity = state.motion.velocity[:, :, lane].astype(float)
    following = ahead.motion.velocity[:, :, lane] if state.steps else velocity
    account = state.account[:, lane].astype(float)
    if state.steps:
        # Work is summed from half step to half step; contact losses belong to the present position.
        account = 0.5 * (account + ahead.account[:, lane])
    account[CONTACT_LOSS] = ahead.account[CONTACT_LOSS, lane]
    order = state.assembly.order
    inertia = np.column_stack([state.scene.mass, state.scene.mass, state.scene.inertia])[order]
    return Energies(
        kinetic=0.5 * float((inertia * velocity * following).sum()),
        elastic=float(
            stored_energy(state.scene, ahead.assembly, state.features, overlaps(state), wall_overlaps(state))[lane]
        ),
        wall_work=float(account[WALL_WORK]),
        contact_loss=float(account[CONTACT_LOSS]),
        damping_loss=float(account[DAMPING_LOSS]),
        load_work=float(account[LOAD_WORK]),
    )


def _refuse_linear(state: State) -> None:
    """Raise a `ValueError` for a state of the law ``linear``."""
    if state.features.linear:
        raise ValueError('law = "linear": only force increments to the reference state are known; use "finite"')
