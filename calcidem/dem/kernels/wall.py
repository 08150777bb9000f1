"""Force between a disk and a wall, and the motion of walls, on lane vectors.

The wall is the first body of a contact, the disk the second. A flat wall needs no square root: the
overlap changes by exactly the normal components of the two displacements.
"""

from calcidem.dem.kernels.compiling import inlined
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.lanes import (
    Vector,
    larger,
    load,
    magnitude,
    number,
    row,
    select,
    smaller,
    spread,
    store,
    zero_like,
)
from calcidem.dem.kernels.laws import coulomb_limit, hertz_normal, mindlin_shear, rescaled_shear
from calcidem.dem.kernels.layout import Front, Grains, Motion, Recording, WallPairs, Walls, Watch
from calcidem.dem.kernels.motion import add_force
from calcidem.dem.kernels.pair import add_shear_loss


@inlined
def wall_forces(
    features: Features,
    pair: int,
    level: int,
    dt: Vector,
    shear_ratio: float,
    grains: Grains,
    motion: Motion,
    wall_pairs: WallPairs,
    walls: Walls,
    front: Front,
    watch: Watch,
) -> None:
    """Add the force of a wall to that on a disk, and its opposite to the wall's reaction."""
    lanes = features.lanes
    grain, wall = number(wall_pairs.disk, (pair,)), number(wall_pairs.wall, (pair,))
    normal_x, normal_y = number(walls.normal, (wall, 0)), number(walls.normal, (wall, 1))
    field = motion.displacement
    away = normal_x * load(field, (row(grain, 0),), lanes) + normal_y * load(field, (row(grain, 1),), lanes)
    depth = number(wall_pairs.overlap, (pair,)) + (load(front.wall_motion, (level, wall, 0), lanes) - away)
    arm = zero_like(away) + (number(grains.radius, (grain,)) - 0.5 * number(wall_pairs.overlap, (pair,)))
    if features.finite:
        arm = number(grains.radius, (grain,)) - 0.5 * depth
    if features.linear:
        slide = wall_slide(features, grain, wall, arm, level, motion.displacement, walls, front, 1)
        closer = depth - number(wall_pairs.overlap, (pair,))
        normal = closer * number(wall_pairs.tangent, (pair, 0))
        stiffness = spread(number(wall_pairs.tangent, (pair, 0)), lanes)
        shear = slide * -number(wall_pairs.tangent, (pair, 1))
    else:
        slide = wall_slide(features, grain, wall, arm, level, motion.velocity, walls, front, 3) * dt
        friction = min(number(walls.friction, (wall,)), number(grains.friction, (grain,)))
        normal, stiffness, shear = wall_law(features, pair, shear_ratio, friction, depth, slide, wall_pairs, watch)
    add_reaction(features, wall, level, normal, -shear, stiffness, front)
    add_force(features, grain, 0, level, normal * normal_x - shear * normal_y, front)
    add_force(features, grain, 1, level, normal * normal_y + shear * normal_x, front)
    if features.rotation:
        add_force(features, grain, 2, level, -(shear * arm), front)


@inlined
def wall_slide(
    features: Features,
    grain: int,
    wall: int,
    arm: Vector,
    level: int,
    field: Vector,
    walls: Walls,
    front: Front,
    component: int,
) -> Vector:
    """Tangential displacement (or velocity) of a disk's rim relative to a wall."""
    lanes = features.lanes
    normal_x, normal_y = number(walls.normal, (wall, 0)), number(walls.normal, (wall, 1))
    along = normal_x * load(field, (row(grain, 1),), lanes) - normal_y * load(field, (row(grain, 0),), lanes)
    slide = along - load(front.wall_motion, (level, wall, component), lanes)
    if features.rotation:
        slide = slide - arm * load(field, (row(grain, 2),), lanes)
    return slide


@inlined
def wall_law(
    features: Features,
    pair: int,
    shear_ratio: float,
    friction: float,
    depth: Vector,
    slide: Vector,
    wall_pairs: WallPairs,
    watch: Watch,
) -> tuple[Vector, Vector, Vector]:
    """Hertz-Mindlin contact of a disk and a wall: normal force, normal stiffness, shear force on the disk."""
    lanes = features.lanes
    normal, root, inverse_root = hertz_normal(depth, number(wall_pairs.hertz, (pair,)))
    stiffness = root * (1.5 * number(wall_pairs.hertz, (pair,)))
    old = load(wall_pairs.shear, (pair,), lanes)
    shear = old
    if features.rescaling:
        shear = rescaled_shear(old, root, inverse_root, load(wall_pairs.inverse_root, (pair,), lanes))
    shear = select(depth > 0.0, mindlin_shear(shear, slide, stiffness * shear_ratio), 0.0)
    if features.slip:
        shear = coulomb_limit(shear, normal * friction)
    elif friction <= 0.0:
        shear = zero_like(shear)
    if features.account:
        before = (1.5 * number(wall_pairs.hertz, (pair,))) / load(wall_pairs.inverse_root, (pair,), lanes)
        add_shear_loss(features, old, shear, before * shear_ratio, stiffness * shear_ratio, slide, watch)
    if features.rescaling or features.account:
        store(wall_pairs.inverse_root, (pair,), inverse_root)
    store(wall_pairs.shear, (pair,), shear)
    return normal, stiffness, shear


@inlined
def add_reaction(
    features: Features, wall: int, level: int, normal: Vector, shear: Vector, stiffness: Vector, front: Front
) -> None:
    """Add one contact to the sums of a wall."""
    lanes = features.lanes
    store(front.reaction, (level, wall, 0), load(front.reaction, (level, wall, 0), lanes) + normal)
    store(front.reaction, (level, wall, 1), load(front.reaction, (level, wall, 1), lanes) + shear)
    store(front.reaction, (level, wall, 2), load(front.reaction, (level, wall, 2), lanes) + stiffness)


@inlined
def start_walls(
    features: Features,
    together: int,
    step: int,
    dt: Vector,
    walls: Walls,
    front: Front,
    recording: Recording,
    watch: Watch,
) -> None:
    """Lay out where the walls are in each of the next steps, which begin with ``step``, and clear their sums.

    Walls that depend on the forces of a step (servo) or whose work is counted allow one step at a time only.
    """
    for wall in range(walls.normal.shape[0]):
        for component in range(4):
            store(front.wall_motion, (0, wall, component), load(walls.motion, (wall, component), features.lanes))
        for level in range(together):
            for component in range(3):
                store(front.reaction, (level, wall, component), zero_like(dt))
        for level in range(together - 1):
            move_wall(features, wall, level, step + level, dt, walls, front, recording, watch)


@inlined
def finish_walls(
    features: Features,
    together: int,
    step: int,
    dt: Vector,
    walls: Walls,
    front: Front,
    recording: Recording,
    watch: Watch,
) -> None:
    """Move the walls to the end of the last of the steps done together, ``step``; keep the forces it met."""
    lanes = features.lanes
    for wall in range(walls.normal.shape[0]):
        move_wall(features, wall, together - 1, step, dt, walls, front, recording, watch)
        for component in range(4):
            store(walls.motion, (wall, component), load(front.wall_motion, (together, wall, component), lanes))
        for component in range(3):
            store(walls.reaction, (wall, component), load(front.reaction, (together - 1, wall, component), lanes))


@inlined
def move_wall(
    features: Features,
    wall: int,
    level: int,
    step: int,
    dt: Vector,
    walls: Walls,
    front: Front,
    recording: Recording,
    watch: Watch,
) -> None:
    """Give a wall its velocity of this step and move it; the drive and the servo act here."""
    lanes = features.lanes
    before_normal = load(front.wall_motion, (level, wall, 2), lanes)
    before_tangent = load(front.wall_motion, (level, wall, 3), lanes)
    along_normal, along_tangent = before_normal, before_tangent
    if features.recording:  # noqa: SIM102 - known to the compiler, unlike the condition within
        if wall == recording.driven:
            along_tangent = load(recording.drive, (step,), lanes)
    if features.servo:  # noqa: SIM102 - as above
        if number(walls.servo, (wall, 0)) > 0.0:
            along_normal = servo_speed(features, wall, level, dt, walls, front)
    moved_normal = load(front.wall_motion, (level, wall, 0), lanes) + dt * along_normal
    moved_tangent = load(front.wall_motion, (level, wall, 1), lanes) + dt * along_tangent
    store(front.wall_motion, (level + 1, wall, 0), moved_normal)
    store(front.wall_motion, (level + 1, wall, 1), moved_tangent)
    store(front.wall_motion, (level + 1, wall, 2), along_normal)
    store(front.wall_motion, (level + 1, wall, 3), along_tangent)
    if features.account:
        pushed = load(front.reaction, (level, wall, 0), lanes) * (before_normal + along_normal)
        dragged = load(front.reaction, (level, wall, 1), lanes) * (before_tangent + along_tangent)
        work = 0.5 * dt * (pushed - dragged)
        store(watch.account, (0,), load(watch.account, (0,), lanes) + work)


@inlined
def wall_is_far(features: Features, wall: int, walls: Walls, watch: Watch) -> Vector:
    """Return the lanes in which a wall left the reach of the pair list."""
    lanes = features.lanes
    moved = load(walls.motion, (wall, 0), lanes) - load(watch.wall_origin, (wall,), lanes)
    return magnitude(moved) > watch.reach


@inlined
def servo_speed(features: Features, wall: int, level: int, dt: Vector, walls: Walls, front: Front) -> Vector:
    """Speed that would bring the wall's force to its target in 1 / gain steps, up to a largest speed.

    ``v = gain (F_target - F) / (K dt)`` with K the summed contact stiffness of the wall (PFC's servo); a
    wall that touches nothing approaches at the largest speed.
    """
    lanes = features.lanes
    gain, target, fastest = (
        number(walls.servo, (wall, 0)),
        number(walls.servo, (wall, 1)),
        number(walls.servo, (wall, 2)),
    )
    lacking = target - load(front.reaction, (level, wall, 0), lanes)
    stiffness = load(front.reaction, (level, wall, 2), lanes)
    loaded = stiffness > 0.0
    speed = select(loaded, gain * lacking / (select(loaded, stiffness, 1.0) * dt), zero_like(lacking) + fastest)
    return smaller(larger(speed, zero_like(lacking) - fastest), zero_like(lacking) + fastest)
