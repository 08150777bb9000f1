"""Reading a state: contact forces, unbalanced force, energies.

Histories of contacts belong to the position before the last drift. To read them at the present position
the kernel itself does one step on a copy, so that no law is written a second time.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from calcidem.dem.engine.neighbours import listed_pairs
from calcidem.dem.engine.state import State, duplicate, no_recording, run_kernel
from calcidem.dem.kernels.layout import Floats, Integers


@dataclass(frozen=True, slots=True)
class ContactForces:
    """Contacts of one lane that carry force or cement.

    Attributes
    ----------
    pairs
        (C, 2) indices of the disks in the scene; (C,) disk and wall for wall contacts are in `WallForces`.
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
    bonded: npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Energies:
    """Energies of one lane, J per metre of thickness; the balance is ``supplied = stored + lost``.

    ``kinetic`` uses the mean of the two half-step velocities. The last four are sums since half a step after the start
    and are kept only if the state was started with the ``account`` feature. ``wall_work`` is that of moving walls and
    of held disks that move; ``contact_loss`` is friction, shear energy that vanishes with changing stiffness, and what
    broken bonds take with them.
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


def looked_ahead(state: State) -> State:
    """Return the state one step later, with histories that belong to the present position.

    At time zero the histories do so already, hence nothing slides in that step.
    """
    ahead = duplicate(state)
    if state.steps == 0:
        ahead.motion.velocity[...] = 0.0
        ahead.assembly.walls.motion[:, 2:] = 0.0
    run_kernel(ahead, 1, no_recording(state))
    return ahead


def overlaps(state: State) -> Floats:
    """(M, L) overlaps of the listed pairs, m."""
    pairs = state.assembly.pairs
    ends = listed_pairs(state.assembly)
    displacement = state.motion.displacement[:, :2].astype(float)
    apart = displacement[ends[:, 1]] - displacement[ends[:, 0]]
    n, distance = pairs.geometry[:, :2].astype(float), pairs.geometry[:, 2].astype(float)[:, None]
    along = n[:, :1] * apart[:, 0] + n[:, 1:] * apart[:, 1]
    further: Floats = along
    if state.features.finite:
        now = np.hypot(n[:, :1] * distance + apart[:, 0], n[:, 1:] * distance + apart[:, 1])
        further = (2.0 * distance * along + np.sum(apart**2, axis=1)) / (now + distance)
    reference: Floats = pairs.geometry[:, 3:4].astype(float)
    return reference - further


def wall_overlaps(state: State) -> Floats:
    """(V, L) overlaps of the listed wall pairs, m."""
    wall_pairs, walls = state.assembly.wall_pairs, state.assembly.walls
    disk = np.repeat(np.arange(state.scene.count), np.diff(wall_pairs.start))
    normal = walls.normal[wall_pairs.wall].astype(float)
    moved = state.motion.displacement[disk, :2].astype(float)
    away = normal[:, :1] * moved[:, 0] + normal[:, 1:] * moved[:, 1]
    closer: Floats = walls.motion[wall_pairs.wall, 0] - away
    return wall_pairs.overlap.astype(float)[:, None] + closer


def contact_forces(state: State, lane: int = 0) -> ContactForces:
    """Forces between the disks at the present position, except in the ``linear`` regime, which has none of its own."""
    refuse_linear(state)
    ahead = looked_ahead(state)
    pairs = ahead.assembly.pairs
    ends = listed_pairs(state.assembly)
    depth = overlaps(state)[:, lane]
    intact = lane_of(pairs.intact, lane)
    normal = pairs.hertz * np.maximum(depth, 0.0) ** 1.5
    if state.features.linear_group:
        pressed = np.maximum(depth - pairs.linear[:, 2], 0.0) * pairs.linear[:, 0]
        normal = np.where(lane_of(pairs.cemented, lane), pressed, normal)
    else:
        normal = np.where(intact, 0.0, normal)
    bond = pairs.bond_force[:, :, lane]
    normal, shear = normal + bond[:, 0], pairs.shear[:, lane] + bond[:, 1]
    present = (normal != 0.0) | intact
    order = state.assembly.order
    return ContactForces(
        pairs=order[ends[present]],
        overlap=depth[present],
        normal=normal[present].astype(float),
        shear=shear[present].astype(float),
        moment=bond[present, 2].astype(float),
        bonded=intact[present],
    )


def lane_of(bits: Integers, lane: int) -> npt.NDArray[np.bool_]:
    """Truth values of one lane."""
    return ((bits >> np.uint32(lane)) & 1).astype(bool)


def wall_reactions(state: State, lane: int = 0) -> Floats:
    """(W, 2) normal and shear force of the disks on each wall at the present position, N/m."""
    return looked_ahead(state).assembly.walls.reaction[:, :2, lane].astype(float)


def net_forces(state: State, lane: int = 0) -> Floats:
    """(N, 3) net force (N/m) and moment (N) on the disks without damping, in the order of the scene.

    Taken from what one step of the kernel does to the velocities of a copy; zero for disks that are held.
    """
    undamped = state.assembly.grains._replace(damping=np.zeros_like(state.assembly.grains.damping))
    ahead = looked_ahead(replace(state, assembly=replace(state.assembly, grains=undamped)))
    before = state.motion.velocity[:, :, lane] if state.steps else 0.0
    change = (ahead.motion.velocity[:, :, lane] - before) / state.time_step[lane]
    inertia = np.column_stack([state.scene.mass, state.scene.mass, state.scene.inertia])
    return state.unsorted(change) * inertia


def unbalanced_ratio(state: State, lane: int = 0) -> float:
    """Sum of the net forces on the disks over the sum of their contact forces (PFC 'mech-ratio-average')."""
    net = net_forces(state, lane)
    contacts = contact_forces(state, lane)
    magnitude = 2.0 * float(np.hypot(contacts.normal, contacts.shear).sum())
    magnitude += float(np.abs(wall_reactions(state, lane)).sum())
    unbalanced = float(np.hypot(net[:, 0], net[:, 1]).sum())
    return unbalanced / magnitude if magnitude > 0.0 else 0.0


def energies(state: State, lane: int = 0) -> Energies:
    """Energies of one lane at the present position, except in the ``linear`` regime (see `contact_forces`)."""
    refuse_linear(state)
    ahead = looked_ahead(state)
    velocity = state.motion.velocity[:, :, lane].astype(float)
    account = state.account[:, lane].astype(float)
    if state.steps:
        velocity = 0.5 * (velocity + ahead.motion.velocity[:, :, lane])
        # Forces do work from half step to half step; the losses of contacts belong to the present position.
        account = 0.5 * (account + ahead.account[:, lane])
        account[1] = ahead.account[1, lane]
    order = state.assembly.order
    inertia = np.column_stack([state.scene.mass, state.scene.mass, state.scene.inertia])[order]
    return Energies(
        kinetic=0.5 * float((inertia * velocity**2).sum()),
        elastic=elastic_energy(state, ahead, lane),
        wall_work=float(account[0]),
        contact_loss=float(account[1]),
        damping_loss=float(account[2]),
        load_work=float(account[3]),
    )


def refuse_linear(state: State) -> None:
    """Raise a `ValueError` for a state of the ``linear`` regime."""
    if state.features.linear:
        raise ValueError("regime = linear: it knows only forces added to the reference state; use small or finite")


def elastic_energy(state: State, ahead: State, lane: int) -> float:
    """Energy stored in contacts: Hertz 2/5 F_n d, shear F_s^2 / (2 k_s), and the springs of linear groups and bonds."""
    pairs, wall_pairs = ahead.assembly.pairs, ahead.assembly.wall_pairs
    depth, wall_depth = overlaps(state)[:, lane], wall_overlaps(state)[:, lane]
    ratio = state.scene.sand.shear_ratio
    hertz, shear_stiffness = hertz_energy(pairs.hertz, depth, ratio)
    intact, cemented = lane_of(pairs.intact, lane), lane_of(pairs.cemented, lane)
    if state.features.linear_group:
        linear = 0.5 * pairs.linear[:, 0] * np.maximum(depth - pairs.linear[:, 2], 0.0) ** 2
        hertz = np.where(cemented, linear, hertz)
        shear_stiffness = np.where(cemented, pairs.linear[:, 1], shear_stiffness)
    else:
        hertz = np.where(intact, 0.0, hertz)
    stored = float(hertz.sum()) + spring_energy(pairs.shear[:, lane], shear_stiffness)
    wall_hertz, wall_stiffness = hertz_energy(wall_pairs.hertz, wall_depth, ratio)
    stored += float(wall_hertz.sum()) + spring_energy(wall_pairs.shear[:, lane], wall_stiffness)
    if state.features.bonds:
        for component in range(3):
            stored += spring_energy(pairs.bond_force[:, component, lane], pairs.bond[:, component])
    return stored


def hertz_energy(coefficient: Floats, depth: Floats, shear_ratio: float) -> tuple[Floats, Floats]:
    """Energy 2/5 F_n d of Hertz contacts and their shear stiffness."""
    pressed = np.maximum(depth, 0.0)
    return 0.4 * coefficient * pressed**2.5, 1.5 * coefficient * shear_ratio * np.sqrt(pressed)


def spring_energy(force: Floats, stiffness: Floats) -> float:
    """Summed F^2 / (2 k) of springs; those without stiffness carry nothing."""
    safe = np.where(stiffness > 0.0, stiffness, 1.0)
    return float(np.sum(np.where(stiffness > 0.0, force**2 / (2.0 * safe), 0.0)))
