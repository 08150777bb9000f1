"""The one loop of calcidem: advance all lanes by some steps.

Pairs are stored once, sorted by their first disk. A step visits the disks block by block: the pairs of a block, its
contacts with walls, then the update of its disks. Every pair with a lower first disk has been visited before, and no
later one touches a disk of this block, so forces, damping and leapfrog share one pass.

That order leaves room behind a step. Once it has left a block, and the next block in which the pairs of that one may
end, the following step can start there. So several steps run through the disks one behind the other, and what a block
needs stays in the cache from the first of them to the last, instead of coming from memory for each:

    block         0    1    2    3
    step n        1    2    4    6        (numbers: order of the visits)
    step n + 1         3    5    7 ...    (step n + 1 is a block behind: it visits block 0 third)

Every force is summed up in the same order as if the steps were done one after the other: not a bit depends on it.

Leapfrog (explicit central differences): ``v(n + 1/2) = v(n - 1/2) + dt a(x(n), v(n - 1/2))``,
``x(n + 1) = x(n) + dt v(n + 1/2)``. Shear forces and bonds grow by the displacement between the two
last positions, ``dt v(n - 1/2)``, so they belong to ``x(n)`` as the overlap does.
"""

import calcidem.dem.kernels.switches  # noqa: F401 - makes Features a type of the compiler
from calcidem.dem.kernels.compiling import compiled, inlined
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.lanes import (
    Vector,
    bits_of_mask,
    flush_tiny_numbers,
    load,
    number,
    restore_control_word,
    row,
    store,
)
from calcidem.dem.kernels.layout import Floats, Front, Grains, Motion, Pairs, Recording, WallPairs, Walls, Watch
from calcidem.dem.kernels.motion import integrate
from calcidem.dem.kernels.pair import pair_forces
from calcidem.dem.kernels.wall import finish_walls, start_walls, wall_forces, wall_is_far


@compiled(cache=True, error_model="numpy")
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
    front: Front,
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
    grains, motion, pairs, wall_pairs, walls, front, recording, watch
        See `layout`.

    Returns
    -------
    Steps done: fewer than ``steps`` when a disk has moved so far that the pair list must be renewed.
    """
    word = flush_tiny_numbers()
    done = sweep_steps(
        features, steps, time_step, shear_ratio, grains, motion, pairs, wall_pairs, walls, front, recording, watch
    )
    restore_control_word(word)
    return done


@inlined
def sweep_steps(
    features: Features,
    steps: int,
    time_step: Floats,
    shear_ratio: float,
    grains: Grains,
    motion: Motion,
    pairs: Pairs,
    wall_pairs: WallPairs,
    walls: Walls,
    front: Front,
    recording: Recording,
    watch: Watch,
) -> int:
    """Do the steps of `sweep`, some at a time."""
    dt = load(time_step, (0,), features.lanes)
    step = 0
    while step < steps:
        together = steps_in_flight(features, steps, step, front, recording)
        start_walls(features, together, recording.offset + step, dt, walls, front, recording, watch)
        far = sweep_together(
            features, together, dt, shear_ratio, grains, motion, pairs, wall_pairs, walls, front, watch
        )
        step += together
        finish_walls(features, together, recording.offset + step - 1, dt, walls, front, recording, watch)
        if features.recording:  # noqa: SIM102 - known to the compiler, unlike the condition within
            if (recording.offset + step) % recording.stride == 0:
                write_sample(features, (recording.offset + step) // recording.stride - 1, motion, walls, recording)
        if features.search:
            for wall in range(walls.normal.shape[0]):
                far = far | wall_is_far(features, wall, walls, watch)
            if bits_of_mask(far) != 0:
                return step
    return steps


@inlined
def steps_in_flight(features: Features, steps: int, step: int, front: Front, recording: Recording) -> int:
    """Steps that may run together: not more than fit, and not beyond the next sample."""
    together = min(front.levels, steps - step)
    if features.recording:
        together = min(together, recording.stride - (recording.offset + step) % recording.stride)
    return together


@inlined
def sweep_together(
    features: Features,
    together: int,
    dt: Vector,
    shear_ratio: float,
    grains: Grains,
    motion: Motion,
    pairs: Pairs,
    wall_pairs: WallPairs,
    walls: Walls,
    front: Front,
    watch: Watch,
) -> Vector:
    """Lead ``together`` steps through all blocks; return the lanes in which a disk left the reach of the pair list."""
    far = dt < 0.0
    count = grains.radius.shape[0]
    blocks = (count + front.block - 1) // front.block
    for leading in range(blocks + together - 1):
        for level in range(max(0, leading - blocks + 1), min(together, leading + 1)):
            begin = (leading - level) * front.block
            end = min(count, begin + front.block)
            for pair in range(number(pairs.start, (begin,)), number(pairs.start, (end,))):
                pair_forces(features, pair, level, dt, grains, motion, pairs, front, watch)
            for pair in range(number(wall_pairs.start, (begin,)), number(wall_pairs.start, (end,))):
                wall_forces(features, pair, level, dt, shear_ratio, grains, motion, wall_pairs, walls, front, watch)
            for grain in range(begin, end):
                far = far | integrate(features, grain, level, dt, grains, motion, front, watch)
    return far


@inlined
def write_sample(features: Features, sample: int, motion: Motion, walls: Walls, recording: Recording) -> None:
    """Record the shear force on the receiving wall and the mean velocity of the listening disks."""
    lanes = features.lanes
    store(recording.samples, (sample, 0), load(walls.reaction, (recording.receiver, 1), lanes))
    total = load(walls.reaction, (recording.receiver, 1), lanes) * 0.0
    for listener in recording.listeners:
        total = total + load(motion.velocity, (row(listener, 1),), lanes)
    count = max(1, recording.listeners.shape[0])
    store(recording.samples, (sample, 1), total * (1.0 / count))
