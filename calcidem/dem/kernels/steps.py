"""The one loop of calcidem: advance all lanes by some steps.

Pairs are stored once, sorted by their first disk. A step visits the disks block by block: the pairs of a block, its
contacts with walls, then the motion of its disks. Every pair with a lower first disk has been visited before, and no
later one touches a disk of this block, so forces, damping and leapfrog share one pass.

So the following step can start at a block once this step has left it and the next block, where its pairs may end.
Several steps pass through the disks one behind the other. The data of a block stay in the cache for all of them,
instead of being loaded from memory for each:

    block         0    1    2    3
    step n        1    2    4    6        (numbers: order of the visits)
    step n + 1         3    5    7 ...    (step n + 1 is a block behind: it visits block 0 third)

Every force is summed in the same order as if the steps were done one after the other, so the bits are the same.

Leapfrog (explicit central differences, as in Cundall & Strack 1979, doi:10.1680/geot.1979.29.1.47):
``v(n + 1/2) = v(n - 1/2) + dt a(x(n), v(n - 1/2))``, ``x(n + 1) = x(n) + dt v(n + 1/2)``. Shear forces and bonds grow
by the displacement between the two last positions, ``dt v(n - 1/2)``, so they belong to ``x(n)`` as the overlap does.
"""

import calcidem.dem.kernels.compiling  # noqa: F401 - makes Features a type of the compiler
from calcidem.dem.kernels.compiling import compile_function, inline
from calcidem.dem.kernels.lanes import (
    Vector,
    bits_of_mask,
    fill_lanes,
    load,
    scalar,
    store,
    zero_like,
)
from calcidem.dem.kernels.layout import ABREAST, Features, Floats, Front, Recording, System
from calcidem.dem.kernels.motion import add_force, drive_disks, integrate, integrate_records, of_disk
from calcidem.dem.kernels.pair import pair_force, pair_geometry, push_apart
from calcidem.dem.kernels.wall import add_reaction, finish_walls, start_walls, wall_force, wall_is_far


@compile_function(cache=True, error_model="numpy")
def advance_steps(features: Features, steps: int, time_step: Floats, system: System) -> int:
    """Advance a system by up to ``steps`` steps, in place, with all histories and records.

    Parameters
    ----------
    features
        Compile-time switches.
    steps
        Steps to do.
    time_step
        (1, L) s, each lane has its own.
    system
        See `layout`.

    Returns
    -------
    Steps done: fewer than ``steps`` when a disk has moved so far that the pair list must be renewed.
    """
    dt = load(time_step, (0,), features.lanes)
    if features.bundled:  # noqa: SIM108 - known to the compiler; both sides have a type of their own
        pair_dt = fill_lanes(scalar(time_step, (0, 0)), features.width)
    else:
        pair_dt = dt
    walls, recording = system.walls, system.recording
    step = 0
    while step < steps:
        together = _steps_in_flight(features, steps, step, system.front, recording)
        start_walls(features, together, recording.offset + step, dt, system)
        far = _step_together(features, together, recording.offset + step, (dt, pair_dt), system)
        step += together
        finish_walls(features, together, recording.offset + step - 1, dt, system)
        if features.recording:  # noqa: SIM102 - known to the compiler, unlike the condition within
            if (recording.offset + step) % recording.stride == 0:
                _record_sample(features, (recording.offset + step) // recording.stride - 1, system)
        if features.search:
            for wall in range(walls.normal.shape[0]):
                far = far | bits_of_mask(wall_is_far(features, wall, walls, system.watch))
            if far != 0:
                return step
    return steps


@inline
def _steps_in_flight(features: Features, steps: int, step: int, front: Front, recording: Recording) -> int:
    """Number of steps that may run together: at most ``levels``, and not beyond the next sample."""
    together = min(front.levels, steps - step)
    if features.recording:
        together = min(together, recording.stride - (recording.offset + step) % recording.stride)
    return together


@inline
def _step_together(
    features: Features, together: int, step: int, time_steps: tuple[Vector, Vector], system: System
) -> Vector:
    """Advance ``together`` steps, from ``step`` on, through all blocks; return zero if no disk went far.

    Far is beyond the reach of the pair list. ``time_steps`` have the widths of samples and of pairs.
    """
    dt, pair_dt = time_steps
    pair_start, wall_start = system.pairs.start, system.wall_pairs.start
    far = pair_dt < 0.0
    count, block = system.grains.radius.shape[0], system.front.block
    blocks = (count + block - 1) // block
    for leading in range(blocks + together - 1):
        for level in range(max(0, leading - blocks + 1), min(together, leading + 1)):
            begin = (leading - level) * block
            end = min(count, begin + block)
            first, last = scalar(pair_start, (begin,)), scalar(pair_start, (end,))
            _add_pair_forces(features, first, last, level, pair_dt, system)
            for contact in range(scalar(wall_start, (begin,)), scalar(wall_start, (end,))):
                on_disk, on_wall = wall_force(features, contact, level, dt, system)
                add_force(features, scalar(system.wall_pairs.disk, (contact,)), level, on_disk, system.front)
                add_reaction(features, scalar(system.wall_pairs.wall, (contact,)), level, on_wall, system.front)
            if features.driven:
                drive_disks(features, range(begin, end), level, step + level, dt, system)
            if features.bundled:
                for grain in range(begin, end, ABREAST):
                    far = far | integrate_records(features, grain, level, pair_dt, system)
            else:
                for grain in range(begin, end):
                    far = far | integrate(features, grain, level, dt, system)
    return bits_of_mask(far)


@inline
def _add_pair_forces(features: Features, begin: int, end: int, level: int, dt: Vector, system: System) -> None:
    """Add the forces of the pairs ``begin`` to ``end - 1`` to their disks."""
    if features.linear:
        for pair in range(begin, end):
            geometry = pair_geometry(features, pair, system)
            push_apart(features, pair, level, pair_force(features, pair, geometry, dt, system), system)
    elif begin < end:
        # Roots and quotients have a long latency. Those of the next pair begin before the forces of this one.
        geometry = pair_geometry(features, begin, system)
        for pair in range(begin, end):
            following = pair_geometry(features, min(pair + 1, end - 1), system)
            push_apart(features, pair, level, pair_force(features, pair, geometry, dt, system), system)
            geometry = following


@inline
def _record_sample(features: Features, sample: int, system: System) -> None:
    """Record the mean velocities of the groups of listening disks."""
    recording = system.recording
    for group in range(recording.groups.shape[0] - 1):
        begin, end = scalar(recording.groups, (group,)), scalar(recording.groups, (group + 1,))
        axis = scalar(recording.axes, (group,))
        total = zero_like(load(recording.samples, (sample, group), features.lanes))
        for place in range(begin, end):
            total = total + of_disk(features, system.motion.velocity, scalar(recording.listeners, (place,)), axis)
        store(recording.samples, (sample, group), total * (1.0 / float(max(1, end - begin))))
