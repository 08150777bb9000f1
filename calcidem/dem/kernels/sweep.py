"""The one loop of calcidem: advance all lanes by some steps.

A step is a single sweep over the disks. Pairs are stored once, with their first disk, and a disk is
finished as soon as its own row of pairs is done: every pair with a lower first disk has been visited
before, and no later row touches it. So forces, damping and the leapfrog update share one pass, and the
state of a disk travels through the cache once a step.

Leapfrog (explicit central differences): ``v(n + 1/2) = v(n - 1/2) + dt a(x(n), v(n - 1/2))``,
``x(n + 1) = x(n) + dt v(n + 1/2)``. Shear forces and bonds grow by the displacement between the two
last positions, ``dt v(n - 1/2)``, so they belong to ``x(n)`` as the overlap does.
"""

from numba import njit

import calcidem.dem.kernels.switches  # noqa: F401 - makes Features a type of the compiler
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.lanes import (
    Vector,
    bits_of_mask,
    flush_tiny_numbers,
    load,
    magnitude,
    restore_control_word,
    store,
)
from calcidem.dem.kernels.laws import damped, inlined
from calcidem.dem.kernels.layout import Floats, Grains, Motion, Pairs, Recording, WallPairs, Walls, Watch
from calcidem.dem.kernels.pair import pair_forces
from calcidem.dem.kernels.wall import move_wall, wall_forces


@njit(cache=True, error_model="numpy")
def sweep(
    features: Features,
    steps: int,
    time_step: Floats,
    shear_ratio: float,
    grains: Grains,
    motion: Motion,
    pairs: Pairs,
    wall_pairs: WallPairs,
    walls: Walls,
    recording: Recording,
    watch: Watch,
) -> int:
    """Advance ``motion`` by up to ``steps`` steps, in place, with all histories and records.

    Parameters
    ----------
    features
        Compile-time switches.
    steps
        Steps to do.
    time_step
        (1, L) s, each lane has its own.
    shear_ratio
        Hertz-Mindlin k_s / k_n = 2 (1 - nu) / (2 - nu).
    grains, motion, pairs, wall_pairs, walls, recording, watch
        See `layout`.

    Returns
    -------
    Steps done: fewer than ``steps`` when a disk has moved so far that the pair list must be renewed.
    """
    word = flush_tiny_numbers()
    done = sweep_steps(
        features, steps, time_step, shear_ratio, grains, motion, pairs, wall_pairs, walls, recording, watch
    )
    restore_control_word(word)
    return done


@inlined
def sweep_steps(  # noqa: C901 - the branches are compile-time switches
    features: Features,
    steps: int,
    time_step: Floats,
    shear_ratio: float,
    grains: Grains,
    motion: Motion,
    pairs: Pairs,
    wall_pairs: WallPairs,
    walls: Walls,
    recording: Recording,
    watch: Watch,
) -> int:
    """Do the steps of `sweep`."""
    lanes = features.lanes
    dt = load(time_step, (0,), lanes)
    for step in range(steps):
        for wall in range(walls.normal.shape[0]):
            for component in range(3):
                store(walls.reaction, (wall, component), dt * 0.0)
        far = dt < 0.0
        for grain in range(grains.radius.shape[0]):
            force = taken_force(features, grain, grains, motion)
            for pair in range(pairs.start[grain], pairs.start[grain + 1]):
                force = pair_forces(features, grain, pair, dt, shear_ratio, grains, motion, pairs, watch, force)
            for pair in range(wall_pairs.start[grain], wall_pairs.start[grain + 1]):
                force = wall_forces(
                    features, grain, pair, dt, shear_ratio, grains, motion, wall_pairs, walls, watch, force
                )
            far = far | integrate(features, grain, dt, grains, motion, watch, force)
        for wall in range(walls.normal.shape[0]):
            move_wall(features, wall, recording.offset + step, dt, walls, recording, watch)
            if features.search:
                far = far | wall_is_far(features, wall, walls, watch)
        if features.recording:
            done = recording.offset + step + 1
            if done % recording.stride == 0:
                write_sample(features, done // recording.stride - 1, motion, walls, recording)
        if features.search:  # noqa: SIM102 - known to the compiler, unlike the condition within
            if bits_of_mask(far) != 0:
                return step + 1
    return steps


@inlined
def taken_force(features: Features, grain: int, grains: Grains, motion: Motion) -> tuple[Vector, Vector, Vector]:
    """Return the force of earlier rows of pairs and of the load on a disk; clear its slot for a later disk."""
    lanes = features.lanes
    slot = grain & (motion.force.shape[0] - 1)
    x = load(motion.force, (slot, 0), lanes)
    y = load(motion.force, (slot, 1), lanes)
    turning = load(motion.force, (slot, 2), lanes)
    for component in range(3):
        store(motion.force, (slot, component), x * 0.0)
    return x + grains.load[grain, 0], y + grains.load[grain, 1], turning + grains.load[grain, 2]


@inlined
def integrate(
    features: Features,
    grain: int,
    dt: Vector,
    grains: Grains,
    motion: Motion,
    watch: Watch,
    force: tuple[Vector, Vector, Vector],
) -> Vector:
    """Kick and drift one disk; return the lanes in which it left the reach of the pair list."""
    lanes = features.lanes
    square = dt * 0.0
    inverse = grains.inverse_mass[grain]
    x = kick(features, grain, 0, inverse, dt, grains, motion, watch, force[0])
    y = kick(features, grain, 1, inverse, dt, grains, motion, watch, force[1])
    if features.rotation:
        kick(features, grain, 2, grains.inverse_inertia[grain], dt, grains, motion, watch, force[2])
    if features.search:
        moved_x = x - load(watch.origin, (grain, 0), lanes)
        moved_y = y - load(watch.origin, (grain, 1), lanes)
        square = moved_x * moved_x + moved_y * moved_y
    return square > watch.reach * watch.reach


@inlined
def wall_is_far(features: Features, wall: int, walls: Walls, watch: Watch) -> Vector:
    """Return the lanes in which a wall left the reach of the pair list."""
    lanes = features.lanes
    moved = load(walls.motion, (wall, 0), lanes) - load(watch.wall_origin, (wall,), lanes)
    return magnitude(moved) > watch.reach


@inlined
def kick(
    features: Features,
    grain: int,
    component: int,
    inverse: float,
    dt: Vector,
    grains: Grains,
    motion: Motion,
    watch: Watch,
    force: Vector,
) -> Vector:
    """Leapfrog update of one degree of freedom; return the new displacement."""
    lanes = features.lanes
    velocity = load(motion.velocity, (grain, component), lanes)
    driving = force
    if features.damping:
        driving = damped(force, velocity, grains.damping[grain])
    faster = velocity + (dt * inverse) * driving
    store(motion.velocity, (grain, component), faster)
    moved = load(motion.displacement, (grain, component), lanes) + dt * faster
    store(motion.displacement, (grain, component), moved)
    if features.account:
        path = 0.5 * dt * (velocity + faster)
        if inverse > 0.0:
            store(watch.account, (2,), load(watch.account, (2,), lanes) + (force - driving) * path)
        else:
            # Whoever holds a disk that moves opposes every force on it.
            store(watch.account, (0,), load(watch.account, (0,), lanes) - force * path)
        gained = load(watch.account, (3,), lanes) + grains.load[grain, component] * path
        store(watch.account, (3,), gained)
    return moved


@inlined
def write_sample(features: Features, sample: int, motion: Motion, walls: Walls, recording: Recording) -> None:
    """Record the shear force on the receiving wall and the mean velocity of the listening disks."""
    lanes = features.lanes
    store(recording.samples, (sample, 0), load(walls.reaction, (recording.receiver, 1), lanes))
    total = load(walls.reaction, (recording.receiver, 1), lanes) * 0.0
    for listener in recording.listeners:
        total = total + load(motion.velocity, (listener, 1), lanes)
    count = max(1, recording.listeners.shape[0])
    store(recording.samples, (sample, 1), total * (1.0 / count))
