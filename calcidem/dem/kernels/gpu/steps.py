"""`steps.advance_steps` on a GPU: one block of threads for each sample, the physics of `pair`, `wall` and `motion`.

A step has two phases. The threads of a block first share the pairs and store their forces. Then they share the disks:
each sums the forces of its disk in the order of the pair list, as on the CPU, and moves the disk. So the bits are the
same. A block stops after the step in which one of its disks left the reach of the pair list, each at its own step.

Reactions of walls are not summed: waves do not use them.
"""

from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import config, cuda

from calcidem.dem.kernels.compiling import SOURCES, inline
from calcidem.dem.kernels.lanes import Vector, bits_of_mask, load, row, scalar, store
from calcidem.dem.kernels.layout import (
    Features,
    Floats,
    Front,
    Integers,
    Motion,
    Pairs,
    Recording,
    System,
    WallPairs,
    Walls,
    Watch,
    Y,
)
from calcidem.dem.kernels.motion import add_force, integrate, of_disk
from calcidem.dem.kernels.pair import pair_force, pair_geometry
from calcidem.dem.kernels.wall import finish_walls, start_walls, wall_force, wall_is_far

_IS_SIMULATED = bool(config.ENABLE_CUDASIM)  # type: ignore[attr-defined]  # made from the environment

if not _IS_SIMULATED:  # the simulator runs the Python bodies of `lanes`
    import calcidem.dem.kernels.gpu.lanes  # noqa: F401 - makes lane vectors types of numba-cuda


class Plan(NamedTuple):
    """Which forces act on each disk, and work space."""

    start: Integers
    """(N + 1,) the pairs of disk i, as first or second disk, are code[start[i] : start[i + 1]]."""
    code: Integers
    """(2 M,) twice the number of a pair, plus 1 for its second disk; increasing for each disk."""
    driven: Integers
    """(N,) 1 for driven disks."""
    force: Floats
    """(S, M, 4, 1) force x and y on the second disk, moments on the first and the second disk, of each sample."""


@lru_cache
def gpu_kernel(features: Features, walls: int, dtype: np.dtype[Any], is_shared: bool) -> Any:  # noqa: ANN401 - of numba-cuda
    """Compiled kernel: features with one lane, number of walls, number type, and where the motion of the disks lies.

    It takes the steps to do, the steps (S,) that each sample has done and will have done, time steps (S, 1), a `System`
    and a `Plan`. Arrays with lanes have the samples first instead, and one lane last. Where the motion lies in the
    shared memory of a block, `motion_bytes` of it are given at the launch.
    """
    real = dtype.type
    room, nothing = max(1, walls), real(0.0)

    def advance_samples(steps: int, done: Integers, time_step: Floats, system: System, plan: Plan) -> None:
        # A thread has a slot of its own for the force on its disk, the one slot of a front of one step.
        force = cuda.local.array((3, 1), real)
        reaction = cuda.local.array((1, room, 3, 1), real)
        for component in range(3):
            force[component, 0] = nothing
            for wall in range(room):
                reaction[0, wall, component, 0] = nothing
        sample = cuda.blockIdx.x
        motion = Motion(system.motion.displacement[sample], system.motion.velocity[sample])
        kept = motion
        if is_shared:
            rows = 3 * system.grains.radius.shape[0]
            place = cuda.shared.array(0, dtype)  # of the size that the launch gives
            kept = Motion(place[:rows, None], place[rows : 2 * rows, None])
            _copy_motion(motion, kept)
        own = _sample_of(system, sample, kept, force, reaction)
        dt = load(time_step, (sample,), 1)
        step, far = done[sample], 0
        cuda.syncthreads()
        while step < steps and far == 0:
            _share_pairs(features, dt, own, plan.force[sample])
            if cuda.threadIdx.x == 0:
                start_walls(features, 1, own.recording.offset + step, dt, own)
            cuda.syncthreads()
            left = _share_disks(features, own.recording.offset + step, dt, own, plan, plan.force[sample])
            step += 1
            far = cuda.syncthreads_or(left)
            _finish_step(features, own.recording.offset + step, dt, own)
        if is_shared:
            _copy_motion(kept, motion)
        if cuda.threadIdx.x == 0:
            done[sample] = step

    advance_samples.__qualname__ += f"_{_SOURCES[:16]}"
    if _IS_SIMULATED:
        return cuda.jit(advance_samples)
    # With optimisation at link time multiply-adds come back. 64 registers are those of 1,024 threads.
    return cuda.jit(advance_samples, cache=True, lto=False, max_registers=64)


_SOURCES = sha256(
    b"".join([SOURCES.encode(), *(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))])
).hexdigest()
"""Identity of the source code, as `compiling.SOURCES` with this folder."""


def motion_bytes(disks: int, dtype: np.dtype[Any]) -> int:
    """Bytes of the motion of a sample's disks."""
    return 2 * 3 * disks * dtype.itemsize


@inline
def _copy_motion(source: Motion, target: Motion) -> None:
    """Copy the motion of all disks, with the threads of a block."""
    for place in range(cuda.threadIdx.x, source.velocity.shape[0], cuda.blockDim.x):
        target.displacement[place, 0] = source.displacement[place, 0]
        target.velocity[place, 0] = source.velocity[place, 0]


@inline
def _sample_of(system: System, sample: int, motion: Motion, force: Floats, reaction: Floats) -> System:
    """System of one sample, as `advance_steps` gets it with one lane."""
    pairs, wall_pairs, walls, recording = system.pairs, system.wall_pairs, system.walls, system.recording
    return System(
        system.grains,
        motion,
        Pairs(
            pairs.start,
            pairs.first,
            pairs.second,
            pairs.geometry,
            pairs.hertz,
            pairs.mindlin,
            pairs.tangent,
            pairs.friction,
            pairs.bond,
            pairs.linear,
            pairs.strength,
            pairs.cemented[sample],
            pairs.intact[sample],
            pairs.shear[sample],
            pairs.root[sample],
            pairs.bond_force[sample],
            pairs.radii,
        ),
        WallPairs(
            wall_pairs.start,
            wall_pairs.disk,
            wall_pairs.wall,
            wall_pairs.overlap,
            wall_pairs.hertz,
            wall_pairs.tangent,
            wall_pairs.shear[sample],
            wall_pairs.root[sample],
        ),
        Walls(walls.normal, walls.friction, walls.motion[sample], walls.reaction[sample], walls.servo),
        Front(1, 1, 0, force, system.front.wall_motion[sample], reaction, pairs.radii),
        Recording(
            recording.drive[sample],
            recording.driven,
            recording.driven_disks,
            recording.offset,
            recording.stride,
            recording.listeners,
            recording.groups,
            recording.axes,
            recording.samples[sample],
        ),
        Watch(system.watch.origin[sample], system.watch.wall_origin[sample], system.watch.reach, system.watch.account),
    )


@inline
def _share_pairs(features: Features, dt: Vector, system: System, forces: Floats) -> None:
    """Store the forces of the pairs of this thread."""
    for pair in range(cuda.threadIdx.x, system.pairs.first.shape[0], cuda.blockDim.x):
        geometry = pair_geometry(features, pair, system)
        x, y, first_moment, second_moment = pair_force(features, pair, geometry, dt, system)
        store(forces, (pair, 0), x)
        store(forces, (pair, 1), y)
        store(forces, (pair, 2), first_moment)
        store(forces, (pair, 3), second_moment)


@inline
def _share_disks(features: Features, step: int, dt: Vector, system: System, plan: Plan, force: Floats) -> int:
    """Move the disks of this thread; return 1 if one of them, or before this step a wall, went far."""
    walls, wall_pairs = system.walls, system.wall_pairs
    far = dt < 0.0
    for disk in range(cuda.threadIdx.x, system.grains.radius.shape[0], cuda.blockDim.x):
        for place in range(plan.start[disk], plan.start[disk + 1]):
            _add_pair(features, disk, plan.code[place], force, system.front)
        for contact in range(scalar(wall_pairs.start, (disk,)), scalar(wall_pairs.start, (disk + 1,))):
            on_disk, _ = wall_force(features, contact, 0, dt, system)
            add_force(features, disk, 0, on_disk, system.front)
        if features.driven:  # noqa: SIM102 - known to the compiler, unlike the condition within
            if plan.driven[disk]:
                store(system.motion.velocity, (row(disk, Y),), load(system.recording.drive, (step,), features.lanes))
        far = far | integrate(features, disk, 0, dt, system)
    if features.search and cuda.threadIdx.x == 0:
        for wall in range(walls.normal.shape[0]):
            far = far | wall_is_far(features, wall, walls, system.watch)
    return 1 if bits_of_mask(far) != 0 else 0


@inline
def _add_pair(features: Features, disk: int, code: int, force: Floats, front: Front) -> None:
    """Add the force of a pair to one of its disks, as `pair.push_apart` does."""
    pair, is_second = code >> 1, code & 1
    x, y = load(force, (pair, 0), features.lanes), load(force, (pair, 1), features.lanes)
    moment = load(force, (pair, 2 + is_second), features.lanes)
    add_force(features, disk, 0, (x if is_second else -x, y if is_second else -y, moment), front)


@inline
def _finish_step(features: Features, done: int, dt: Vector, system: System) -> None:
    """Move the walls and record what listeners do, after ``done`` steps of the recording."""
    if cuda.threadIdx.x == 0:
        finish_walls(features, 1, done - 1, dt, system)
    recording = system.recording
    if features.recording:  # noqa: SIM102 - known to the compiler, unlike the condition within
        if done % recording.stride == 0:
            for group in range(cuda.threadIdx.x, recording.groups.shape[0] - 1, cuda.blockDim.x):
                begin, end = scalar(recording.groups, (group,)), scalar(recording.groups, (group + 1,))
                total = dt * 0.0
                for place in range(begin, end):
                    disk, axis = scalar(recording.listeners, (place,)), scalar(recording.axes, (group,))
                    total = total + of_disk(features, system.motion.velocity, disk, axis)
                mean = total * (1.0 / float(max(1, end - begin)))
                store(recording.samples, (done // recording.stride - 1, group), mean)
