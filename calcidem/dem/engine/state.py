"""State of a scene, and how it is started and advanced. States are values: advancing makes a new one."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from calcidem.dem.engine.assembly import Assembly, aligned_copy, aligned_zeros, assemble
from calcidem.dem.engine.histories import install_forces, renew_assembly
from calcidem.dem.engine.material import require
from calcidem.dem.engine.scene import Preload, Regime, Scene
from calcidem.dem.engine.stability import critical_time_step
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.layout import (
    NORMAL_PATH,
    PATHS,
    ROTATION,
    SPEEDS,
    XY,
    Floats,
    Front,
    Integers,
    Motion,
    Recording,
    System,
    Watch,
)
from calcidem.dem.kernels.steps import advance_steps

Precision = Literal["float64", "float32"]
SAFETY = 0.8  # default step as a part of the critical time step
SKIN = 0.2  # pairs are listed up to this part of the mean radius apart
_REACH = 0.45  # part of the skin a disk may move before a new list; below 1/2: the step that crosses it is finished
_REACH_TOGETHER = 0.35  # the same where several steps are under way then
STEPS_TOGETHER = 4
SMALLEST_BLOCK = 32


@dataclass(frozen=True, slots=True)
class State:
    """Everything that changes while a scene is advanced.

    Attributes
    ----------
    scene
        The scene and its reference geometry.
    features
        What the kernel was told to do.
    time_step
        (L,) s.
    critical_time_step
        (L,) s, its lower bound at the start.
    steps
        Steps done.
    skin
        Rims of disks up to this far apart are listed as pairs, m; zero where nothing new can touch.
    assembly
        Neighbours and histories of the contacts, in memory order.
    motion
        Displacements and velocities, in memory order.
    origin
        (N, 2, L) displacements when the neighbours were listed.
    wall_origin
        (W, L) displacements of the walls along their normals, at that time.
    account
        (4, L) J/m: work of the walls and of held disks that move, losses of contacts (friction, changing shear
        stiffness, broken bonds), local damping, work of the loads.
    """

    scene: Scene
    features: Features
    time_step: Floats
    critical_time_step: Floats
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
        return self.time_step * self.steps

    def position(self, lane: int = 0) -> Floats:
        """(N, 2) centres of the disks, m, in the order of the scene."""
        reference = np.column_stack([self.scene.x, self.scene.y])
        return reference + self.to_scene_order(self.motion.displacement[:, XY, lane])

    def velocity(self, lane: int = 0) -> Floats:
        """(N, 2) velocities half a step before `time` (at time zero: then), m/s, in the order of the scene."""
        return self.to_scene_order(self.motion.velocity[:, XY, lane])

    def spin(self, lane: int = 0) -> Floats:
        """(N,) angular velocities half a step before `time`, rad/s, in the order of the scene."""
        return self.to_scene_order(self.motion.velocity[:, ROTATION, lane])

    def rotation(self, lane: int = 0) -> Floats:
        """(N,) rotations since the start, rad, in the order of the scene."""
        return self.to_scene_order(self.motion.displacement[:, ROTATION, lane])

    def to_scene_order(self, values: Floats) -> Floats:
        """Values of the disks brought from memory order back to the order of the scene."""
        result = np.empty_like(values, dtype=float)
        result[self.assembly.order] = values
        return result


def choose_features(
    scene: Scene, regime: Regime, lanes: int = 1, *, slip: bool = True, breakage: bool = True, account: bool = False
) -> Features:
    """Features a scene needs in a regime: ``finite``, ``small`` (fixed geometry) or ``linear`` (fixed stiffness)."""
    linear = regime == "linear"
    bonds = scene.bonds is not None and len(scene.bonds.pairs) > 0
    group = bonds and scene.bonds is not None and bool(scene.bonds.cement.linear_modulus > 0.0)
    return Features(
        lanes=lanes,
        finite=regime == "finite",
        linear=linear,
        rotation=scene.rotation,
        bonds=bonds,
        linear_group=group,
        breakage=bonds and breakage and not linear,
        slip=slip and not linear,
        rescaling=scene.rescaling and not linear,
        damping=bool(np.any(np.asarray(scene.damping) > 0.0)),
        servo=any(wall.servo_force is not None for wall in scene.walls) and not linear,
        search=regime == "finite",
        loads=scene.load is not None,
        account=account and not linear,
    )


def start(  # noqa: PLR0913 - the way into the engine: how a scene differs from the default, by keyword
    scene: Scene,
    *,
    regime: Regime = "finite",
    features: Features | None = None,
    precision: Precision = "float64",
    time_step: Floats | float | None = None,
    step_fraction: float = SAFETY,
    velocity: Floats | None = None,
    spin: Floats | None = None,
    preload: Preload | None = None,
    skin_fraction: float | None = None,
) -> State:
    """State of a scene at time zero.

    Parameters
    ----------
    scene
        Disks at their reference positions.
    regime
        ``finite``: displacements of any size. ``small``: normals stay as they are. ``linear``: stiffnesses too.
    features
        Overrides what `choose_features` finds.
    precision
        Of all arrays of the kernel.
    time_step
        s, one number or (L,); a part of the critical time step by default.
    step_fraction
        That part.
    velocity, spin
        (N, 2) m/s and (N,) rad/s at time zero.
    preload
        Shear forces of the reference state.
    skin_fraction
        Pairs are listed up to this part of the mean radius apart. Small where disks move little, since listed pairs
        cost time; large where they move far, since a new list costs more. By default 0.2, or 0 without contact search.

    Raises
    ------
    ValueError
        If the time step is above the critical time step, or an array has the wrong shape.
    """
    chosen = features or choose_features(scene, regime)
    dtype = np.dtype(precision)
    if skin_fraction is None:
        skin_fraction = SKIN if chosen.search else 0.0
    skin = skin_fraction * float(np.mean(scene.radius)) if chosen.finite else 0.0
    centres = np.column_stack([scene.x, scene.y])[:, :, None]
    assembly = assemble(scene, centres, skin, chosen.lanes, dtype)
    install_forces(scene, assembly, chosen, preload)
    limit = critical_time_step(scene, assembly, chosen)
    step = step_fraction * limit if time_step is None else np.broadcast_to(np.asarray(time_step, float), chosen.lanes)
    require(bool(np.all(step > 0.0)), "time_step", step.tolist(), "give a positive number of seconds")
    cure = f"above the critical time step of {limit.tolist()} s: choose a smaller one"
    require(bool(np.all(step <= limit)), "time_step", step.tolist(), cure)
    return State(
        scene=scene,
        features=chosen,
        time_step=np.array(step, dtype=float),
        critical_time_step=limit,
        steps=0,
        skin=skin,
        assembly=assembly,
        motion=_first_motion(scene, assembly.order, chosen.lanes, dtype, velocity, spin),
        origin=aligned_zeros((scene.count, 2, chosen.lanes), dtype),
        wall_origin=aligned_zeros((len(scene.walls), chosen.lanes), dtype),
        account=aligned_zeros((4, chosen.lanes), dtype),
    )


def _first_motion(
    scene: Scene,
    order: Integers,
    lanes: int,
    dtype: npt.DTypeLike,
    velocity: Floats | None,
    spin: Floats | None,
) -> Motion:
    """Disks at their reference positions, with the velocities they are given."""
    shape = (scene.count, 3, lanes)
    motion = Motion(displacement=aligned_zeros(shape, dtype), velocity=aligned_zeros(shape, dtype))
    for name, values, components in (("velocity", velocity, XY), ("spin", spin, ROTATION)):
        if values is not None:
            wanted = (scene.count, 2) if name == "velocity" else (scene.count,)
            require(np.shape(values) == wanted, name, np.shape(values), f"give an array of shape {wanted}")
            require(bool(np.all(np.isfinite(values))), name, "NaN or infinite", "give finite numbers")
            motion.velocity[:, components] = np.asarray(values)[order][..., None]
    return motion


def make_front(state: State) -> Front:
    """Empty scratch for the steps in flight, see `layout.Front`."""
    features, assembly = state.features, state.assembly
    # A servo answers to the forces of the step before, and an account is summed up in the order of the steps.
    together = 1 if features.servo or features.account else STEPS_TOGETHER
    block = max(SMALLEST_BLOCK, int((assembly.pairs.second - assembly.pairs.first).max(initial=0)))
    slot_bits = (2 * block - 1).bit_length()
    walls, lanes, dtype = len(state.scene.walls), features.lanes, state.motion.velocity.dtype
    return Front(
        levels=together,
        block=block,
        slot_bits=slot_bits,
        force=aligned_zeros((3 * together << slot_bits, lanes), dtype),
        wall_motion=aligned_zeros((together + 1, walls, 4, lanes), dtype),
        reaction=aligned_zeros((together, walls, 3, lanes), dtype),
    )


def advance(state: State, steps: int) -> State:
    """State after ``steps`` more steps; the given one is left as it is."""
    first = start_leapfrog(state) if state.steps == 0 and steps > 0 else duplicate(state)
    return run_in_place(first, state.steps + steps - first.steps, no_recording(state))


def run_in_place(state: State, steps: int, recording: Recording) -> State:
    """Let the kernel change a state in place for ``steps`` steps, with new lists of pairs where they are needed."""
    done = 0
    while done < steps:
        count = run_kernel(state, steps - done, recording._replace(offset=recording.offset + done))
        done += count
        state = replace(state, steps=state.steps + count)
        if done < steps:
            state = renew_neighbours(state)
    return state


def run_kernel(state: State, steps: int, recording: Recording) -> int:
    """Let the kernel change a state in place; return the steps it did."""
    assembly, front = state.assembly, make_front(state)
    reach = (_REACH if front.levels == 1 else _REACH_TOGETHER) * state.skin
    system = System(
        grains=assembly.grains,
        motion=Motion(*(_rows(array) for array in state.motion)),
        pairs=assembly.pairs._replace(bond_force=_rows(assembly.pairs.bond_force)),
        wall_pairs=assembly.wall_pairs,
        walls=assembly.walls,
        front=front,
        recording=recording,
        watch=Watch(origin=state.origin, wall_origin=state.wall_origin, reach=reach, account=state.account),
    )
    time_step = state.time_step.astype(state.motion.velocity.dtype).reshape(1, -1)
    return advance_steps(state.features, steps, time_step, system)


def _rows(array: Floats) -> Floats:
    """View of an array as rows of lanes, the shape in which kernels find their way fastest."""
    return array.reshape(-1, array.shape[-1])


def no_recording(state: State) -> Recording:
    """Stand-in for a call in which nothing is driven or recorded."""
    dtype, lanes = state.motion.velocity.dtype, state.features.lanes
    return Recording(
        drive=np.zeros((0, lanes), dtype),
        driven=-1,
        driven_disks=np.zeros(0, dtype=np.int64),
        offset=0,
        stride=np.iinfo(np.int64).max,  # never write: there is no room for samples
        receiver=0,
        listeners=np.zeros(0, dtype=np.int64),
        samples=np.zeros((0, 2, lanes), dtype),
    )


def duplicate(state: State) -> State:
    """Copy of everything the kernel changes in place."""
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


def start_leapfrog(state: State) -> State:
    """First step from a state whose velocities are those of time zero: half a kick, then a drift.

    The leapfrog starts with velocities at half a step. The acceleration at time zero comes from the kernel
    itself, which does one step on a copy at rest; damping, which needs the velocity, is added here.
    """
    current = duplicate(state)
    dt = state.time_step.astype(state.motion.velocity.dtype)
    probe = duplicate(state)
    probe.motion.velocity[...] = 0.0
    probe.assembly.walls.motion[:, SPEEDS] = 0.0
    run_kernel(probe, 1, no_recording(state))
    kick = probe.motion.velocity / 2.0
    if state.features.damping:
        alpha = state.assembly.grains.damping[:, None, None]
        kick -= alpha * np.abs(kick) * np.sign(state.motion.velocity)
    current.motion.velocity[...] += kick
    current.motion.displacement[...] += dt * current.motion.velocity
    walls = current.assembly.walls
    walls.motion[:, PATHS] += dt * walls.motion[:, SPEEDS]
    walls.reaction[...] = probe.assembly.walls.reaction
    return replace(current, steps=1)


def renew_neighbours(state: State) -> State:
    """Return the same state with its pair list made anew."""
    displacement = state.motion.displacement[:, XY]
    assembly = renew_assembly(state.scene, state.assembly, displacement, state.skin)
    return replace(
        state,
        assembly=assembly,
        origin=aligned_copy(displacement),
        wall_origin=aligned_copy(assembly.walls.motion[:, NORMAL_PATH]),
    )
