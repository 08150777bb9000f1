"""Motion of one disk: local damping and the leapfrog, on lane vectors."""

from calcidem.dem.kernels.compiling import inline
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.lanes import Vector, load, row, scalar, store, without_dust, zero_like
from calcidem.dem.kernels.laws import damp_force
from calcidem.dem.kernels.layout import DAMPING_LOSS, LOAD_WORK, ROTATION, WALL_WORK, Front, System, Watch, X, Y


@inline
def drive_disks(features: Features, grains: range, level: int, step: int, dt: Vector, system: System) -> None:
    """Give those of a range of disks that are driven their velocity of a step, just before it moves them.

    To the account that is work against the contacts; what speeds up the driven disks comes back as they stop.
    """
    velocity, recording = system.motion.velocity, system.recording
    for disk in recording.driven_disks:
        if grains.start <= disk < grains.stop:
            speed = load(recording.drive, (step,), features.lanes)
            if features.account:
                # Forces do work from half step to half step; `integrate` will see the later velocity only.
                force = load(system.front.force, (row(_slot(disk, level, system.front), Y),), features.lanes)
                gained = speed - load(velocity, (row(disk, Y),), features.lanes)
                add_energy(features, WALL_WORK, 0.5 * dt * force * gained, system.watch)
            store(velocity, (row(disk, Y),), speed)


@inline
def integrate(features: Features, grain: int, level: int, dt: Vector, system: System) -> Vector:
    """Kick and drift one disk; return the lanes in which it left the reach of the pair list."""
    lanes = features.lanes
    grains, watch = system.grains, system.watch
    square = zero_like(dt)
    inverse = scalar(grains.inverse_mass, (grain,))
    x = _kick(features, grain, X, level, inverse, dt, system)
    y = _kick(features, grain, Y, level, inverse, dt, system)
    if features.rotation:
        _kick(features, grain, ROTATION, level, scalar(grains.inverse_inertia, (grain,)), dt, system)
    if features.search:
        moved_x = x - load(watch.origin, (grain, X), lanes)
        moved_y = y - load(watch.origin, (grain, Y), lanes)
        square = moved_x * moved_x + moved_y * moved_y
    return square > watch.reach * watch.reach


@inline
def _kick(
    features: Features, grain: int, component: int, level: int, inverse: float, dt: Vector, system: System
) -> Vector:
    """Leapfrog update of one degree of freedom; return the new displacement."""
    lanes = features.lanes
    grains, motion, watch = system.grains, system.motion, system.watch
    force = _take_force(features, grain, component, level, system.front)
    if features.loads:
        force = force + scalar(grains.load, (grain, component))
    velocity = load(motion.velocity, (row(grain, component),), lanes)
    driving = force
    if features.damping:
        driving = damp_force(force, velocity, scalar(grains.damping, (grain,)))
    faster = without_dust(velocity + (dt * inverse) * driving)
    store(motion.velocity, (row(grain, component),), faster)
    moved = without_dust(load(motion.displacement, (row(grain, component),), lanes) + dt * faster)
    store(motion.displacement, (row(grain, component),), moved)
    if features.account:
        path = 0.5 * dt * (velocity + faster)
        if inverse > 0.0:
            add_energy(features, DAMPING_LOSS, (force - driving) * path, watch)
        else:
            # Whoever holds a disk that moves opposes every force on it.
            add_energy(features, WALL_WORK, -force * path, watch)
        add_energy(features, LOAD_WORK, scalar(grains.load, (grain, component)) * path, watch)
    return moved


@inline
def _slot(grain: int, level: int, front: Front) -> int:
    """Slot in which the forces on a disk are summed up for one of the steps in flight."""
    return (level << front.slot_bits) + (grain & ((1 << front.slot_bits) - 1))


@inline
def _take_force(features: Features, grain: int, component: int, level: int, front: Front) -> Vector:
    """Return the sum of the contact forces on a disk; clear its slot for a later disk."""
    slot = _slot(grain, level, front)
    force = load(front.force, (row(slot, component),), features.lanes)
    store(front.force, (row(slot, component),), zero_like(force))
    return force


@inline
def add_force(features: Features, grain: int, component: int, level: int, part: Vector, front: Front) -> None:
    """Add to the sum of the contact forces on a disk."""
    slot = _slot(grain, level, front)
    total = load(front.force, (row(slot, component),), features.lanes) + part
    store(front.force, (row(slot, component),), total)


@inline
def add_energy(features: Features, entry: int, part: Vector, watch: Watch) -> None:
    """Add to one sum of the energy account."""
    store(watch.account, (entry,), load(watch.account, (entry,), features.lanes) + part)
