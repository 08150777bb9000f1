"""Motion of one disk: local damping and the leapfrog, on lane vectors."""

from calcidem.dem.kernels.compiling import inlined
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.lanes import (
    Vector,
    load,
    number,
    row,
    store,
    zero_like,
)
from calcidem.dem.kernels.laws import damped
from calcidem.dem.kernels.layout import Front, Grains, Motion, Watch


@inlined
def integrate(
    features: Features,
    grain: int,
    level: int,
    dt: Vector,
    grains: Grains,
    motion: Motion,
    front: Front,
    watch: Watch,
) -> Vector:
    """Kick and drift one disk; return the lanes in which it left the reach of the pair list."""
    lanes = features.lanes
    square = zero_like(dt)
    inverse = number(grains.inverse_mass, (grain,))
    x = kick(features, grain, 0, level, inverse, dt, grains, motion, front, watch)
    y = kick(features, grain, 1, level, inverse, dt, grains, motion, front, watch)
    if features.rotation:
        kick(features, grain, 2, level, number(grains.inverse_inertia, (grain,)), dt, grains, motion, front, watch)
    if features.search:
        moved_x = x - load(watch.origin, (grain, 0), lanes)
        moved_y = y - load(watch.origin, (grain, 1), lanes)
        square = moved_x * moved_x + moved_y * moved_y
    return square > watch.reach * watch.reach


@inlined
def kick(
    features: Features,
    grain: int,
    component: int,
    level: int,
    inverse: float,
    dt: Vector,
    grains: Grains,
    motion: Motion,
    front: Front,
    watch: Watch,
) -> Vector:
    """Leapfrog update of one degree of freedom; return the new displacement."""
    lanes = features.lanes
    force = taken_force(features, grain, component, level, front)
    if features.loads:
        force = force + number(grains.load, (grain, component))
    velocity = load(motion.velocity, (row(grain, component),), lanes)
    driving = force
    if features.damping:
        driving = damped(force, velocity, number(grains.damping, (grain,)))
    faster = velocity + (dt * inverse) * driving
    store(motion.velocity, (row(grain, component),), faster)
    moved = load(motion.displacement, (row(grain, component),), lanes) + dt * faster
    store(motion.displacement, (row(grain, component),), moved)
    if features.account:
        path = 0.5 * dt * (velocity + faster)
        if inverse > 0.0:
            store(watch.account, (2,), load(watch.account, (2,), lanes) + (force - driving) * path)
        else:
            # Whoever holds a disk that moves opposes every force on it.
            store(watch.account, (0,), load(watch.account, (0,), lanes) - force * path)
        gained = load(watch.account, (3,), lanes) + number(grains.load, (grain, component)) * path
        store(watch.account, (3,), gained)
    return moved


@inlined
def taken_force(features: Features, grain: int, component: int, level: int, front: Front) -> Vector:
    """Return the sum of the contact forces on a disk; clear its slot for a later disk."""
    slot = (level << front.slot_bits) + (grain & ((1 << front.slot_bits) - 1))
    force = load(front.force, (row(slot, component),), features.lanes)
    store(front.force, (row(slot, component),), zero_like(force))
    return force


@inlined
def add_force(features: Features, grain: int, component: int, level: int, part: Vector, front: Front) -> None:
    """Add to the sum of the contact forces on a disk."""
    slot = (level << front.slot_bits) + (grain & ((1 << front.slot_bits) - 1))
    total = load(front.force, (row(slot, component),), features.lanes) + part
    store(front.force, (row(slot, component),), total)
