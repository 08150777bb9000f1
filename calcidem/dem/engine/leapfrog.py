"""State of a scene, and the leapfrog that advances it; bundles of one sample.

In bundles the arrays of one sample are laid out so that the kernel computes `ABREAST` pairs or disks at once. Pairs
fill bundles in list order, separately for each block of disks (see `layout.Front`). Spare places in a block's last
bundle repeat its last pair with zero stiffness. Its forces are zero and change no sum.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from calcidem.dem.engine.assembly import Assembly, aligned_copy, aligned_zeros, renew_assembly
from calcidem.dem.engine.scene import Scene
from calcidem.dem.kernels.layout import (
    ABREAST,
    CONTACT_LOSS,
    NORMAL_PATH,
    PATHS,
    ROTATION,
    SPEEDS,
    XY,
    Features,
    Floats,
    Front,
    Integers,
    Motion,
    Pairs,
    Recording,
    System,
    Watch,
    X,
)
from calcidem.dem.kernels.records import RECORD
from calcidem.dem.kernels.steps import advance_steps

Kernel: TypeAlias = Callable[[Features, int, Floats, System], int]
"""`advance_steps`, or what does the same elsewhere."""

_HISTORY_NUMBERS = {"shear": 1, "root": 1, "bond_force": 3}
"""Histories of a pair, and the count of values in each."""


@dataclass(frozen=True, slots=True)
class _Bundles:
    """Assignment of pairs to bundles."""

    start: Integers
    """(N + 1,) first bundle of a block, stored at the block's first disk; the last entry closes the list."""
    pair: Integers
    """(B, 8) pairs in each bundle."""
    place: Integers
    """(M,) place of each pair, counted through all bundles."""
    filling: tuple[Integers, ...]
    """Bundle and place of each spare place."""


def plan_bundles(pairs: Pairs, block: int, count: int) -> _Bundles:
    """Assign the pairs of ``count`` disks to bundles, block by block."""
    border = np.append(np.arange(0, count, block), count)
    first_pair = pairs.start[border]
    needed = -(-np.diff(first_pair) // ABREAST)
    first_bundle = np.concatenate([[0], np.cumsum(needed)])
    block_of_bundle = np.repeat(np.arange(len(needed)), needed)
    begin = first_pair[block_of_bundle] + ABREAST * (np.arange(first_bundle[-1]) - first_bundle[block_of_bundle])
    pair = begin[:, None] + np.arange(ABREAST)
    last = first_pair[block_of_bundle + 1][:, None] - 1
    start = np.zeros(count + 1, dtype=np.int64)
    start[border] = first_bundle
    real = pair <= last
    return _Bundles(start, np.minimum(pair, last), np.flatnonzero(real), np.nonzero(~real))


def bundle(system: System, bundles: _Bundles, features: Features) -> System:
    """Arrays of one sample as bundles and records; all other arrays are shared with the system."""
    grains, motion, watch = system.grains, system.motion, system.watch
    inverse = np.column_stack([grains.inverse_mass, grains.inverse_mass, grains.inverse_inertia])
    damping = np.broadcast_to(grains.damping[:, None], inverse.shape)
    return system._replace(
        grains=grains._replace(
            inverse_mass=_records(inverse),
            damping=_records(damping) if features.damping else grains.load,  # in its place, and not read
            load=_records(grains.load) if features.loads else grains.load,
        ),
        motion=Motion(*(_records(array.reshape(-1, 3)) for array in motion)),
        pairs=_bundle_pairs(system.pairs, bundles, grains.radius, features),
        watch=watch._replace(origin=_records(watch.origin[:, :, 0])),
    )


def unbundle(bundled: System, bundles: _Bundles, system: System, features: Features) -> None:
    """Copy the kernel's changes in bundles and records back to the system, in place."""
    moving = slice(X, ROTATION + 1) if features.rotation else XY
    for records, array in zip(bundled.motion, system.motion, strict=True):
        disks = array.reshape(-1, 3)
        disks[:, moving] = records.reshape(-1, RECORD)[: len(disks), moving]
    new, old = bundled.pairs, system.pairs
    for name in _histories(features):
        count, numbers = len(bundles.place), _HISTORY_NUMBERS[name]
        places = getattr(new, name).reshape(len(bundles.pair), numbers, ABREAST).swapaxes(1, 2)
        values = places.reshape(bundles.pair.size, numbers).take(bundles.place, axis=0)
        getattr(old, name).reshape(count, numbers)[...] = values
    if features.breakage:
        bits = new.intact[:, None] >> np.arange(ABREAST, dtype=np.uint32) & np.uint32(1)
        old.intact[...] = bits.reshape(-1)[bundles.place]


def _records(values: Floats) -> Floats:
    """(4 N', 1) records of values (N, 2 or 3), padded with zeros to a multiple of eight disks."""
    count, width = values.shape
    records = aligned_zeros((count + -count % ABREAST, RECORD), values.dtype)
    records[:count, :width] = values
    return records.reshape(-1, 1)


def _histories(features: Features) -> list[str]:
    """Histories of pairs that the kernel uses, except the state of bonds."""
    uses = {
        "shear": not features.linear,
        "root": not features.linear,
        "bond_force": features.bonds and not features.linear,
    }
    return [name for name, used in uses.items() if used]


def _bundle_pairs(pairs: Pairs, bundles: _Bundles, radius: Floats, features: Features) -> Pairs:
    """Pairs in bundles: (B, 8) for (M,) and (B, K, 8) for (M, K); disks become the first row of their records.

    Arrays that the kernel does not need stay unchanged, because bundling costs as much as several steps.
    """

    def dealt(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        taken = array.take(bundles.pair, axis=0)
        return aligned_copy(taken if taken.ndim == bundles.pair.ndim else taken.swapaxes(1, 2))

    def bits(array: Integers) -> Integers:
        packed: Integers = (array[bundles.pair] << np.arange(ABREAST, dtype=np.uint32)).sum(axis=1, dtype=np.uint32)
        return packed

    constants = ["geometry", *([] if features.linear else ["friction"]), *(["strength"] if features.breakage else [])]
    fields = {name: dealt(getattr(pairs, name)) for name in constants}
    stiffnesses = ["tangent"] if features.linear else ["hertz", "mindlin"]
    for name in [*stiffnesses, *(["bond"] if features.bonds else []), *(["linear"] if features.linear_group else [])]:
        fields[name] = dealt(getattr(pairs, name))
        np.moveaxis(fields[name], -1, 1)[bundles.filling] = 0.0
    for name in _histories(features):
        history = dealt(getattr(pairs, name).reshape(len(pairs.first), _HISTORY_NUMBERS[name]))
        if name != "root":
            history.swapaxes(1, 2)[bundles.filling] = 0.0
        fields[name] = history.reshape(-1, ABREAST)
    ends = np.column_stack([pairs.first, pairs.second])
    return pairs._replace(
        **fields,
        start=bundles.start,
        first=dealt(RECORD * pairs.first),
        second=dealt(RECORD * pairs.second),
        cemented=bits(pairs.cemented) if features.bonds else pairs.cemented,
        intact=bits(pairs.intact) if features.bonds else pairs.intact,
        radii=dealt(radius[ends]) if not features.linear else pairs.radii,
    )


_STEPS_TOGETHER = 4
_SMALLEST_BLOCK = 32


@dataclass(frozen=True, slots=True)
class StepControl:
    """Control of the time step by its limit."""

    fraction: float
    """Chosen step over its limit."""
    per_contact: float
    """Steps per impact if the fraction is `SAFETY`; 0: impacts are not resolved."""
    fixed: bool
    """True: the caller has set the step. It never changes, and a limit below it is an error."""
    next_look: int
    """Number of the step at which the limit is checked next."""
    stability: Floats
    """(L,) s, stability limit when it was last computed."""
    stiffness: Floats
    """(L,) 1/s^2, see `stability.stiffest_contacts`, at that time."""
    began: tuple[int, Floats]
    """Steps and time (L,) at which the present step was chosen."""
    energy: Floats
    """(2, L) J/m, energy at the start and largest so far; NaN before the first step."""


@dataclass(frozen=True, slots=True)
class State:
    """All variables that change while a scene is advanced.

    Attributes
    ----------
    scene
        The scene and its reference geometry.
    features
        Features of the kernel in use.
    time_step
        (L,) s.
    critical_time_step
        (L,) s, limit of the step at the last check: the lower bound of `stability.critical_time_step`. For freely
        moving disks it is at most a twentieth of the shortest possible contact.
    control
        Control of the step by this limit.
    steps
        Completed steps.
    skin
        Disks whose rims are up to this far apart are listed as pairs, m; zero if no new contacts can form.
    assembly
        Neighbours and histories of the contacts, in memory order.
    motion
        Displacements and velocities, in memory order.
    origin
        (N, 2, L) displacements when neighbours were listed.
    wall_origin
        (W, L) displacements of the walls along their normals at that time.
    account
        (4, L) J/m: work of walls and of moving held disks, contact losses (friction, changing shear stiffness, broken
        bonds), local damping, work of the loads.
    """

    scene: Scene
    features: Features
    time_step: Floats
    critical_time_step: Floats
    control: StepControl
    steps: int
    skin: float
    assembly: Assembly
    motion: Motion
    origin: Floats
    wall_origin: Floats
    account: Floats

    @property
    def time(self) -> Floats:
        """(L,) s."""
        steps, time = self.control.began
        return time + self.time_step * (self.steps - steps)

    def position(self, lane: int = 0) -> Floats:
        """(N, 2) centres of the disks, m, in the order of the scene."""
        reference = np.column_stack([self.scene.x, self.scene.y])
        return reference + self.to_scene_order(self.motion.displacement[:, XY, lane])

    def velocity(self, lane: int = 0) -> Floats:
        """(N, 2) velocities half a step before `time`, initially those at time zero, m/s, in the order of the scene."""
        return self.to_scene_order(self.motion.velocity[:, XY, lane])

    def spin(self, lane: int = 0) -> Floats:
        """(N,) angular velocities half a step before `time`, rad/s, in the order of the scene."""
        return self.to_scene_order(self.motion.velocity[:, ROTATION, lane])

    def rotation(self, lane: int = 0) -> Floats:
        """(N,) rotations since the start, rad, in the order of the scene."""
        return self.to_scene_order(self.motion.displacement[:, ROTATION, lane])

    def to_scene_order(self, values: Floats) -> Floats:
        """Reorder values of the disks from memory order to the order of the scene."""
        result = np.empty_like(values, dtype=float)
        result[self.assembly.order] = values
        return result


def _steps_together(features: Features) -> int:
    """Steps in flight; one with a servo, which needs the previous forces, or an account, which sums in step order."""
    return 1 if features.servo or features.account else _STEPS_TOGETHER


def _make_front(state: State) -> Front:
    """Empty work arrays for the steps in flight, see `layout.Front`."""
    assembly, together = state.assembly, _steps_together(state.features)
    block = max(_SMALLEST_BLOCK, int((assembly.pairs.second - assembly.pairs.first).max(initial=0)))
    if state.features.bundled:
        block += -block % ABREAST
    slot_bits = (2 * block - 1).bit_length()
    walls, lanes, dtype = len(state.scene.walls), state.features.lanes, state.motion.velocity.dtype
    return Front(
        levels=together,
        block=block,
        slot_bits=slot_bits,
        force=aligned_zeros(((RECORD if state.features.bundled else 3) * together << slot_bits, lanes), dtype),
        wall_motion=aligned_zeros((together + 1, walls, 4, lanes), dtype),
        reaction=aligned_zeros((together, walls, 3, lanes), dtype),
        parts=aligned_zeros((2 * RECORD * ABREAST, 1), dtype),
    )


def run_in_place(state: State, steps: int, recording: Recording, kernel: Kernel | None = None) -> State:
    """Advance a state in place by ``steps`` steps, relisting pairs when needed, by the kernel or another one."""
    done = 0
    if state.features.search and steps > 0:
        moved = state.motion.displacement[:, XY] - state.origin
        walls = state.assembly.walls.motion[:, NORMAL_PATH] - state.wall_origin
        reach = _reach(state)
        if (moved[:, 0] ** 2 + moved[:, 1] ** 2 > reach * reach).any() or (np.abs(walls) > reach).any():
            # It was left in the last step of an earlier call, which did not relist.
            state = _renew_neighbours(state)
    while done < steps:
        count = run_kernel(state, steps - done, recording._replace(offset=recording.offset + done), kernel)
        done += count
        state = replace(state, steps=state.steps + count)
        if done < steps:
            state = _renew_neighbours(state)
    return state


def _reach(state: State) -> float:
    """Distance that a disk may move before pairs are relisted, m; steps in flight may take it to half of the skin."""
    return (0.45 if _steps_together(state.features) == 1 else 0.35) * state.skin


def run_kernel(state: State, steps: int, recording: Recording, kernel: Kernel | None = None) -> int:
    """Run the kernel on a state in place; return the number of completed steps."""
    assembly, lanes = state.assembly, state.features.lanes
    system = System(
        grains=assembly.grains,
        # Views as rows of lanes, the shape that kernels index fastest.
        motion=Motion(*(array.reshape(-1, lanes) for array in state.motion)),
        pairs=assembly.pairs._replace(bond_force=assembly.pairs.bond_force.reshape(-1, lanes)),
        wall_pairs=assembly.wall_pairs,
        walls=assembly.walls,
        front=_make_front(state),
        recording=recording,
        watch=Watch(origin=state.origin, wall_origin=state.wall_origin, reach=_reach(state), account=state.account),
    )
    time_step = state.time_step.astype(state.motion.velocity.dtype).reshape(1, -1)
    if not state.features.bundled:
        return (kernel or advance_steps)(state.features, steps, time_step, system)
    bundles = plan_bundles(assembly.pairs, system.front.block, state.scene.count)
    bundled = bundle(system, bundles, state.features)
    done = (kernel or advance_steps)(state.features, steps, time_step, bundled)
    unbundle(bundled, bundles, system, state.features)
    return done


def no_recording(state: State) -> Recording:
    """Placeholder for calls without prescribed motion and recording."""
    dtype, lanes = state.motion.velocity.dtype, state.features.lanes
    return Recording(
        drive=np.zeros((0, lanes), dtype),
        driven=-1,
        driven_disks=np.zeros(0, dtype=np.int64),
        offset=0,
        stride=np.iinfo(np.int64).max,  # never write: the buffer holds no samples
        listeners=np.zeros(0, dtype=np.int64),
        groups=np.zeros(2, dtype=np.int64),
        axes=np.zeros(1, dtype=np.int64),
        samples=np.zeros((0, 1, lanes), dtype),
    )


def duplicate(state: State) -> State:
    """Copy of all arrays that the kernel changes in place."""
    pairs, walls = state.assembly.pairs, state.assembly.walls
    wall_pairs = state.assembly.wall_pairs
    assembly = replace(
        state.assembly,
        pairs=pairs._replace(
            intact=pairs.intact.copy(),
            shear=aligned_copy(pairs.shear),
            root=aligned_copy(pairs.root),
            bond_force=aligned_copy(pairs.bond_force),
        ),
        wall_pairs=wall_pairs._replace(shear=aligned_copy(wall_pairs.shear), root=aligned_copy(wall_pairs.root)),
        walls=walls._replace(motion=aligned_copy(walls.motion), reaction=aligned_copy(walls.reaction)),
    )
    motion = Motion(*(aligned_copy(array) for array in state.motion))
    return replace(state, assembly=assembly, motion=motion, account=aligned_copy(state.account))


def look_ahead(state: State) -> State:
    """Return the state one step later, with histories at the present position.

    At time zero the histories already belong to it, so nothing slides in that step.
    """
    ahead = duplicate(state)
    if state.steps == 0:
        halt(ahead)
    run_kernel(ahead, 1, no_recording(state))
    return ahead


def halt(state: State) -> None:
    """Bring disks and walls to rest, in place."""
    state.motion.velocity[...] = 0.0
    state.assembly.walls.motion[:, SPEEDS] = 0.0


def start_leapfrog(state: State) -> State:
    """First step from a state with velocities at time zero: half a kick, then a drift.

    The leapfrog starts with velocities at half a step. One kernel step on a copy at rest gives the acceleration at time
    zero. Damping depends on the velocity and is added here. Initial forces beyond friction or strength are cut off at
    time zero, before any motion, in scenes that resolve impacts. In others the first step cuts them off.
    """
    dt = state.time_step.astype(state.motion.velocity.dtype)
    probe = look_ahead(replace(state, steps=0))
    current = duplicate(state)
    if state.features.midpoint:
        # A relaxed packing continues from forces at the limit of friction; rounding alone can put them beyond it.
        contacts = replace(current.assembly, pairs=probe.assembly.pairs, wall_pairs=probe.assembly.wall_pairs)
        current = replace(current, assembly=contacts)
        current.account[CONTACT_LOSS] = probe.account[CONTACT_LOSS]
    kick = probe.motion.velocity / 2.0
    if state.features.damping:
        alpha = state.assembly.grains.damping[:, None, None]
        kick -= alpha * np.abs(kick) * np.sign(state.motion.velocity)
    current.motion.velocity[...] += kick
    current.motion.displacement[...] += dt * current.motion.velocity
    walls = current.assembly.walls
    walls.motion[:, PATHS] += dt * walls.motion[:, SPEEDS]
    walls.reaction[...] = probe.assembly.walls.reaction
    return replace(current, steps=state.steps + 1)


def change_step(state: State, ahead: State, step: Floats) -> State:
    """Return the state one step later, with new steps (L,).

    The leapfrog restarts from the present, with the mean of the velocities half a step before and after. A change
    therefore keeps the order of the scheme. ``ahead`` is the result of `look_ahead`, kept in lanes with equal steps.
    """
    if state.steps == 0:
        return replace(state, time_step=step)
    walls = ahead.assembly.walls
    motion = aligned_copy(walls.motion)
    motion[:, PATHS] = state.assembly.walls.motion[:, PATHS]
    middle = (0.5 * (state.motion.velocity + ahead.motion.velocity)).astype(ahead.motion.velocity.dtype)
    halted = replace(
        state,
        assembly=replace(ahead.assembly, walls=walls._replace(motion=motion)),
        motion=Motion(aligned_copy(state.motion.displacement), middle),
        time_step=step,
    )
    resumed = start_leapfrog(halted)
    changed = step != state.time_step
    for now, then in (
        (ahead.motion.displacement, resumed.motion.displacement),
        (ahead.motion.velocity, resumed.motion.velocity),
        (walls.motion, resumed.assembly.walls.motion),
    ):
        now[..., changed] = then[..., changed]
    # Half of the old and half of the new step lie between the two velocities.
    share = 0.5 * (1.0 + step / state.time_step)
    share = np.where(np.arange(len(state.account))[:, None] == CONTACT_LOSS, 1.0, share)
    account = (state.account + share * (ahead.account - state.account)).astype(ahead.account.dtype)
    control = replace(state.control, began=(state.steps, state.time))
    return _renew_neighbours(
        replace(
            ahead,
            time_step=step,
            control=control,
            critical_time_step=state.critical_time_step,
            steps=state.steps + 1,
            account=account,
        )
    )


def _renew_neighbours(state: State) -> State:
    """Return the state with a new pair list."""
    displacement = state.motion.displacement[:, XY]
    assembly = renew_assembly(state.scene, state.assembly, displacement, state.skin)
    return replace(
        state,
        assembly=assembly,
        origin=aligned_copy(displacement),
        wall_origin=aligned_copy(assembly.walls.motion[:, NORMAL_PATH]),
    )
