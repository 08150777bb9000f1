"""The one loop of calcidem: advance all lanes by some steps.

A step is a single sweep over the disks. Pairs are stored once, with their first disk, and a disk is
finished as soon as its own row of pairs is done: every pair with a lower first disk has been visited
before, and no later row touches it. So forces, damping and the leapfrog update share one pass, and the
state of a disk travels through the cache once a step.

Leapfrog (explicit central differences): ``v(n + 1/2) = v(n - 1/2) + dt a(x(n), v(n - 1/2))``,
``x(n + 1) = x(n) + dt v(n + 1/2)``. Shear forces and bonds grow by the displacement between the two
last positions, ``dt v(n - 1/2)``, so they belong to ``x(n)`` as the overlap does.
"""

from typing import Any

from numba import njit

import calcidem.dem.kernels.switches  # noqa: F401 - makes Features a type of the compiler
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.lanes import bits_of_mask, load, store
from calcidem.dem.kernels.laws import damped, inlined
from calcidem.dem.kernels.layout import Grains, Motion, Pairs, Recording, WallPairs, Walls, Watch
from calcidem.dem.kernels.pair import pair_forces
from calcidem.dem.kernels.wall import move_wall, wall_forces


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def sweep(
    features: Features,
    steps: int,
    time_step: Any,
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
    lanes = features.lanes
    dt = load(time_step, (0,), lanes)
    for step in range(steps):
        for wall in range(walls.normal.shape[0]):
            for component in range(3):
                store(walls.reaction, (wall, component), dt * 0.0)
        far = dt < 0.0
        for grain in range(grains.radius.shape[0]):
            force = (
                load(motion.force, (grain, 0), lanes),
                load(motion.force, (grain, 1), lanes),
                load(motion.force, (grain, 2), lanes),
            )
            for pair in range(pairs.start[grain], pairs.start[grain + 1]):
                force = pair_forces(features, grain, pair, dt, shear_ratio, grains, motion, pairs, watch, force)
            for pair in range(wall_pairs.start[grain], wall_pairs.start[grain + 1]):
                force = wall_forces(
                    features, grain, pair, dt, shear_ratio, grains, motion, wall_pairs, walls, watch, force
                )
            far = far | integrate(features, grain, dt, grains, motion, watch, force)
        for wall in range(walls.normal.shape[0]):
            move_wall(features, wall, step, dt, walls, recording, watch)
        if features.recording:
            if (step + 1) % recording.stride == 0:
                write_sample(features, step // recording.stride, motion, walls, recording)
        if features.search:
            if bits_of_mask(far) != 0:
                return step + 1
    return steps


@inlined  # type: ignore[untyped-decorator]
def integrate(
    features: Features, grain: int, dt: Any, grains: Grains, motion: Motion, watch: Watch, force: tuple[Any, Any, Any]
) -> Any:
    """Kick and drift one disk; return the lanes in which it left the reach of the pair list."""
    lanes = features.lanes
    square = dt * 0.0
    for component in range(3):
        store(motion.force, (grain, component), dt * 0.0 + grains.load[grain, component])
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


@inlined  # type: ignore[untyped-decorator]
def kick(
    features: Features,
    grain: int,
    component: int,
    inverse: float,
    dt: Any,
    grains: Grains,
    motion: Motion,
    watch: Watch,
    force: Any,
) -> Any:
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
        lost = load(watch.account, (2,), lanes) + (force - driving) * path
        store(watch.account, (2,), lost)
        gained = load(watch.account, (3,), lanes) + grains.load[grain, component] * path
        store(watch.account, (3,), gained)
    return moved


@inlined  # type: ignore[untyped-decorator]
def write_sample(
    features: Features, sample: int, motion: Motion, walls: Walls, recording: Recording
) -> None:
    """Record the shear force on the receiving wall and the mean velocity of the listening disks."""
    lanes = features.lanes
    store(recording.samples, (sample, 0), load(walls.reaction, (recording.receiver, 1), lanes))
    total = load(walls.reaction, (recording.receiver, 1), lanes) * 0.0
    for listener in recording.listeners:
        total = total + load(motion.velocity, (listener, 1), lanes)
    count = max(1, recording.listeners.shape[0])
    store(recording.samples, (sample, 1), total * (1.0 / count))
