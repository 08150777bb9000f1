"""Reading a state: contact forces, unbalanced force, energies.

Histories of contacts belong to the position before the last drift. To read them at the present position
the kernel itself does one step on a copy, so that no law is written a second time.
"""

from dataclasses import dataclass, replace

import numpy as np

from calcidem.dem.engine.histories import listed_pairs
from calcidem.dem.engine.portable import length, three_halves
from calcidem.dem.engine.state import State, duplicate, no_recording, run_kernel
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
    SPEEDS,
    STIFFNESS,
    WALL_WORK,
    XY,
    Flags,
    Floats,
    Integers,
    X,
    Y,
)


@dataclass(frozen=True, slots=True)
class ContactForces:
    """Contacts of one lane that carry force or cement.

    Attributes
    ----------
    pairs
        (C, 2) indices of the disks in the scene.
    overlap
        (C,) m.
    normal, shear
        (C,) N/m on the second disk; compression positive, shear along ``t = (-n_y, n_x)``.
    moment
        (C,) N, of the bond on the second disk.
    bonded
        (C,) True where an intact bond is.
    """

    pairs: Integers
    overlap: Floats
    normal: Floats
    shear: Floats
    moment: Floats
    bonded: Flags


@dataclass(frozen=True, slots=True)
class Energies:
    """Energies of one lane, J per metre of thickness; the balance is ``supplied = stored + lost``.

    The last four are sums since half a step after the start and are kept only if the state was started with the
    ``account`` feature.

    Attributes
    ----------
    kinetic
        Of the mean of the two half-step velocities.
    elastic
        Stored in contacts and bonds.
    wall_work
        Work of moving walls and of held disks that move.
    contact_loss
        Friction, shear energy that vanishes with changing stiffness, and what broken bonds take with them.
    damping_loss
        Taken by local damping.
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


def _look_ahead(state: State) -> State:
    """Return the state one step later, with histories that belong to the present position.

    At time zero the histories do so already, hence nothing slides in that step.
    """
    ahead = duplicate(state)
    if state.steps == 0:
        ahead.motion.velocity[...] = 0.0
        ahead.assembly.walls.motion[:, SPEEDS] = 0.0
    run_kernel(ahead, 1, no_recording(state))
    return ahead


def overlaps(state: State) -> Floats:
    """(M, L) overlaps of the listed pairs, m."""
    pairs = state.assembly.pairs
    displacement = state.motion.displacement[:, XY].astype(float)
    apart = displacement[pairs.second] - displacement[pairs.first]
    n_x, n_y, distance, overlap = (
        pairs.geometry[:, column, None].astype(float) for column in (NORMAL_X, NORMAL_Y, DISTANCE, OVERLAP)
    )
    further: Floats = n_x * apart[:, X] + n_y * apart[:, Y]
    if state.features.finite:
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


def contact_forces(state: State, lane: int = 0) -> ContactForces:
    """Forces between the disks at the present position, except in the ``linear`` regime, which has none of its own."""
    _refuse_linear(state)
    ahead = _look_ahead(state)
    pairs = ahead.assembly.pairs
    ends = listed_pairs(state.assembly)
    depth = overlaps(state)[:, lane]
    intact = _lane_of(pairs.intact, lane)
    normal = pairs.hertz * three_halves(np.maximum(depth, 0.0))
    if state.features.linear_group:
        pressed = np.maximum(depth - pairs.linear[:, REFERENCE_OVERLAP], 0.0) * pairs.linear[:, NORMAL]
        normal = np.where(_lane_of(pairs.cemented, lane), pressed, normal)
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


def _lane_of(bits: Integers, lane: int) -> Flags:
    """Truth values of one lane."""
    return ((bits >> np.uint32(lane)) & 1).astype(bool)


def wall_reactions(state: State, lane: int = 0) -> Floats:
    """(W, 2) normal and shear force of the disks on each wall at the present position, N/m."""
    return _look_ahead(state).assembly.walls.reaction[:, :STIFFNESS, lane].astype(float)


def net_forces(state: State, lane: int = 0) -> Floats:
    """(N, 3) net force (N/m) and moment (N) on the disks without damping, in the order of the scene.

    Taken from what one step of the kernel does to the velocities of a copy; zero for disks that are held.
    """
    undamped = state.assembly.grains._replace(damping=np.zeros_like(state.assembly.grains.damping))
    ahead = _look_ahead(replace(state, assembly=replace(state.assembly, grains=undamped)))
    before = state.motion.velocity[:, :, lane] if state.steps else 0.0
    change = (ahead.motion.velocity[:, :, lane] - before) / state.time_step[lane]
    inertia = np.column_stack([state.scene.mass, state.scene.mass, state.scene.inertia])
    return state.to_scene_order(change) * inertia


def unbalanced_ratio(state: State, lane: int = 0) -> float:
    """Sum of the net forces on the disks over the sum of their contact forces (PFC 'mech-ratio-average')."""
    net = net_forces(state, lane)
    contacts = contact_forces(state, lane)
    magnitude = 2.0 * float(length(contacts.normal, contacts.shear).sum())
    magnitude += float(np.abs(wall_reactions(state, lane)).sum())
    unbalanced = float(length(net[:, X], net[:, Y]).sum())
    return unbalanced / magnitude if magnitude > 0.0 else 0.0


def energies(state: State, lane: int = 0) -> Energies:
    """Energies of one lane at the present position, except in the ``linear`` regime (see `contact_forces`)."""
    _refuse_linear(state)
    ahead = _look_ahead(state)
    velocity = state.motion.velocity[:, :, lane].astype(float)
    account = state.account[:, lane].astype(float)
    if state.steps:
        velocity = 0.5 * (velocity + ahead.motion.velocity[:, :, lane])
        # Forces do work from half step to half step; the losses of contacts belong to the present position.
        account = 0.5 * (account + ahead.account[:, lane])
        account[CONTACT_LOSS] = ahead.account[CONTACT_LOSS, lane]
    order = state.assembly.order
    inertia = np.column_stack([state.scene.mass, state.scene.mass, state.scene.inertia])[order]
    return Energies(
        kinetic=0.5 * float((inertia * velocity**2).sum()),
        elastic=_elastic_energy(state, ahead, lane),
        wall_work=float(account[WALL_WORK]),
        contact_loss=float(account[CONTACT_LOSS]),
        damping_loss=float(account[DAMPING_LOSS]),
        load_work=float(account[LOAD_WORK]),
    )


def _refuse_linear(state: State) -> None:
    """Raise a `ValueError` for a state of the ``linear`` regime."""
    if state.features.linear:
        raise ValueError("regime = linear: it knows only forces added to the reference state; use small or finite")


def _elastic_energy(state: State, ahead: State, lane: int) -> float:
    """Energy stored in contacts: Hertz 2/5 F_n d, shear F_s^2 / (2 k_s), and the springs of linear groups and bonds."""
    pairs, wall_pairs = ahead.assembly.pairs, ahead.assembly.wall_pairs
    depth, wall_depth = overlaps(state)[:, lane], wall_overlaps(state)[:, lane]
    ratio = state.scene.sand.shear_ratio
    hertz, shear_stiffness = _hertz_energy(pairs.hertz, depth, ratio)
    intact, cemented = _lane_of(pairs.intact, lane), _lane_of(pairs.cemented, lane)
    if state.features.linear_group:
        linear = 0.5 * pairs.linear[:, NORMAL] * np.maximum(depth - pairs.linear[:, REFERENCE_OVERLAP], 0.0) ** 2
        hertz = np.where(cemented, linear, hertz)
        shear_stiffness = np.where(cemented, pairs.linear[:, SHEAR], shear_stiffness)
    else:
        hertz = np.where(intact, 0.0, hertz)
    stored = float(hertz.sum()) + _spring_energy(pairs.shear[:, lane], shear_stiffness)
    wall_hertz, wall_stiffness = _hertz_energy(wall_pairs.hertz, wall_depth, ratio)
    stored += float(wall_hertz.sum()) + _spring_energy(wall_pairs.shear[:, lane], wall_stiffness)
    if state.features.bonds:
        for component in (NORMAL, SHEAR, MOMENT):
            stored += _spring_energy(pairs.bond_force[:, component, lane], pairs.bond[:, component])
    return stored


def _hertz_energy(coefficient: Floats, depth: Floats, shear_ratio: float) -> tuple[Floats, Floats]:
    """Energy 2/5 F_n d of Hertz contacts and their shear stiffness."""
    pressed = np.maximum(depth, 0.0)
    return 0.4 * coefficient * pressed**2.5, 1.5 * coefficient * shear_ratio * np.sqrt(pressed)


def _spring_energy(force: Floats, stiffness: Floats) -> float:
    """Summed F^2 / (2 k) of springs; those without stiffness carry nothing."""
    safe = np.where(stiffness > 0.0, stiffness, 1.0)
    return float(np.sum(np.where(stiffness > 0.0, force**2 / (2.0 * safe), 0.0)))
