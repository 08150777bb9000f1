"""Motion of one disk: local damping and the leapfrog, on lane vectors."""

from calcidem.dem.kernels.compiling import inline
from calcidem.dem.kernels.lanes import Vector, load, row, scalar, store, without_dust, zero_like
from calcidem.dem.kernels.laws import damp_force
from calcidem.dem.kernels.layout import (
    ABREAST,
    DAMPING_LOSS,
    LOAD_WORK,
    ROTATION,
    WALL_WORK,
    Features,
    Front,
    System,
    Watch,
    X,
    Y,
)
from calcidem.dem.kernels.records import RECORD, load_run, records_to_columns, store_run


@inline
def of_disk(features: Features, field: Vector, disk: int, component: int) -> Vector:
    """One component of a disk in a field."""
    return load(field, (_disk_row(features, disk, component),), features.lanes)


@inline
def _disk_row(features: Features, disk: int, component: int) -> Vector:
    """Row of a component in the arrays of what moves, and of the slots of forces."""
    if features.bundled:
        return RECORD * disk + component
    return row(disk, component)


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
                # Forces do work from half step to half step, but `integrate` gets only the later velocity.
                force = of_disk(features, system.front.force, _slot(disk, level, system.front), Y)
                gained = speed - of_disk(features, velocity, disk, Y)
                add_energy(features, WALL_WORK, 0.5 * dt * force * gained, system.watch)
            store(velocity, (_disk_row(features, disk, Y),), speed)


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
    grains, motion, watch = system.grains, system.motion, system.watch
    force = _take_force(features, grain, component, level, system.front)
    if features.loads:
        force = force + scalar(grains.load, (grain, component))
    velocity = of_disk(features, motion.velocity, grain, component)
    driving, faster = _accelerate(features, force, velocity, scalar(grains.damping, (grain,)), inverse, dt)
    store(motion.velocity, (_disk_row(features, grain, component),), faster)
    moved = without_dust(of_disk(features, motion.displacement, grain, component) + dt * faster)
    store(motion.displacement, (_disk_row(features, grain, component),), moved)
    if features.account:
        path = 0.5 * dt * (velocity + faster)
        if inverse > 0.0:
            add_energy(features, DAMPING_LOSS, (force - driving) * path, watch)
        else:
            # The support of a held, moving disk balances every force on it.
            add_energy(features, WALL_WORK, -force * path, watch)
        add_energy(features, LOAD_WORK, scalar(grains.load, (grain, component)) * path, watch)
    return moved


@inline
def _accelerate(
    features: Features, force: Vector, velocity: Vector, damping: Vector, inverse: Vector, dt: Vector
) -> tuple[Vector, Vector]:
    """Return the force after damping, and the velocity a step later."""
    driving = force
    if features.damping:
        driving = damp_force(force, velocity, damping)
    return driving, without_dust(velocity + (dt * inverse) * driving)


@inline
def integrate_records(features: Features, grain: int, level: int, dt: Vector, system: System) -> Vector:
    """Kick and drift the `ABREAST` disks of one sample from ``grain`` on; return which left the reach of the list.

    `integrate` does the same for one disk of many samples.
    """
    watch, begin = system.watch, RECORD * grain
    slot = RECORD * _slot(grain, level, system.front)
    a = _kick_records(features, begin, slot, dt, system)
    b = _kick_records(features, begin + ABREAST, slot + ABREAST, dt, system)
    c = _kick_records(features, begin + 2 * ABREAST, slot + 2 * ABREAST, dt, system)
    d = _kick_records(features, begin + 3 * ABREAST, slot + 3 * ABREAST, dt, system)
    square = zero_like(dt)
    if features.search:
        moved = records_to_columns(a, b, c, d)
        square = moved[X] * moved[X] + moved[Y] * moved[Y]
    return square > watch.reach * watch.reach


@inline
def _kick_records(features: Features, begin: int, slot: int, dt: Vector, system: System) -> Vector:
    """Leapfrog update of the two records from row ``begin`` on; return how far they are from where lists were made."""
    grains, motion, front, watch = system.grains, system.motion, system.front, system.watch
    force = load_run(front.force, slot, ABREAST)
    store_run(front.force, slot, zero_like(force))
    if features.loads:
        force = force + load_run(grains.load, begin, ABREAST)
    velocity, inverse = load_run(motion.velocity, begin, ABREAST), load_run(grains.inverse_mass, begin, ABREAST)
    damping = load_run(grains.damping, begin, ABREAST)
    _, faster = _accelerate(features, force, velocity, damping, inverse, dt)
    store_run(motion.velocity, begin, faster)
    moved = without_dust(load_run(motion.displacement, begin, ABREAST) + dt * faster)
    store_run(motion.displacement, begin, moved)
    if features.search:
        moved = moved - load_run(watch.origin, begin, ABREAST)
    return moved


@inline
def _slot(grain: int, level: int, front: Front) -> int:
    """Slot in which the forces on a disk are summed up for one of the steps in flight."""
    return (level << front.slot_bits) + (grain & ((1 << front.slot_bits) - 1))


@inline
def _take_force(features: Features, grain: int, component: int, level: int, front: Front) -> Vector:
    """Return the sum of the contact forces on a disk; clear its slot for a later disk."""
    slot = _slot(grain, level, front)
    force = of_disk(features, front.force, slot, component)
    store(front.force, (_disk_row(features, slot, component),), zero_like(force))
    return force


@inline
def add_force(features: Features, grain: int, level: int, force: tuple[Vector, Vector, Vector], front: Front) -> None:
    """Add x, y and moment to the sums of the forces on a disk."""
    slot = _slot(grain, level, front)
    _add_component(features, slot, X, force[X], front)
    _add_component(features, slot, Y, force[Y], front)
    if features.rotation:
        _add_component(features, slot, ROTATION, force[ROTATION], front)


@inline
def _add_component(features: Features, slot: int, component: int, part: Vector, front: Front) -> None:
    """Add to one component of the sum in a slot."""
    total = of_disk(features, front.force, slot, component) + part
    store(front.force, (_disk_row(features, slot, component),), total)


@inline
def add_energy(features: Features, entry: int, part: Vector, watch: Watch) -> None:
    """Add to one sum of the energy account."""
    store(watch.account, (entry,), load(watch.account, (entry,), features.lanes) + part)
