"""Force between a disk and a wall, and the motion of walls, on lane vectors.

The wall is the first body of a contact, the disk the second. A flat wall needs no square root: the
overlap changes by exactly the normal components of the two displacements.
"""

from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.lanes import Vector, larger, load, select, smaller, store
from calcidem.dem.kernels.laws import coulomb_limit, hertz_normal, inlined, mindlin_shear, rescaled_shear
from calcidem.dem.kernels.layout import Grains, Motion, Recording, WallPairs, Walls, Watch
from calcidem.dem.kernels.pair import add_shear_loss


@inlined
def wall_forces(
    features: Features,
    grain: int,
    pair: int,
    dt: Vector,
    shear_ratio: float,
    grains: Grains,
    motion: Motion,
    wall_pairs: WallPairs,
    walls: Walls,
    watch: Watch,
    force: tuple[Vector, Vector, Vector],
) -> tuple[Vector, Vector, Vector]:
    """Add the force of a wall to that on a disk, and its opposite to the wall's reaction."""
    lanes = features.lanes
    wall = wall_pairs.wall[pair]
    normal_x, normal_y = walls.normal[wall, 0], walls.normal[wall, 1]
    field = motion.displacement
    away = normal_x * load(field, (grain, 0), lanes) + normal_y * load(field, (grain, 1), lanes)
    depth = wall_pairs.overlap[pair] + (load(walls.motion, (wall, 0), lanes) - away)
    arm = away * 0.0 + (grains.radius[grain] - 0.5 * wall_pairs.overlap[pair])
    if features.finite:
        arm = grains.radius[grain] - 0.5 * depth
    if features.linear:
        slide = wall_slide(features, grain, wall, arm, motion.displacement, walls, 1)
        closer = depth - wall_pairs.overlap[pair]
        normal, stiffness = closer * wall_pairs.tangent[pair, 0], away * 0.0 + wall_pairs.tangent[pair, 0]
        shear = slide * -wall_pairs.tangent[pair, 1]
    else:
        slide = wall_slide(features, grain, wall, arm, motion.velocity, walls, 3) * dt
        friction = min(walls.friction[wall], grains.friction[grain])
        normal, stiffness, shear = wall_law(features, pair, shear_ratio, friction, depth, slide, wall_pairs, watch)
    add_reaction(features, wall, normal, -shear, stiffness, walls)
    turning = force[2]
    if features.rotation:
        turning = turning - shear * arm
    return (
        force[0] + normal * normal_x - shear * normal_y,
        force[1] + normal * normal_y + shear * normal_x,
        turning,
    )


@inlined
def wall_slide(
    features: Features, grain: int, wall: int, arm: Vector, field: Vector, walls: Walls, component: int
) -> Vector:
    """Tangential displacement (or velocity) of a disk's rim relative to a wall."""
    lanes = features.lanes
    normal_x, normal_y = walls.normal[wall, 0], walls.normal[wall, 1]
    along = normal_x * load(field, (grain, 1), lanes) - normal_y * load(field, (grain, 0), lanes)
    slide = along - load(walls.motion, (wall, component), lanes)
    if features.rotation:
        slide = slide - arm * load(field, (grain, 2), lanes)
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
    normal, root = hertz_normal(depth, wall_pairs.hertz[pair])
    stiffness = root * (1.5 * wall_pairs.hertz[pair])
    old = load(wall_pairs.shear, (pair,), lanes)
    shear = old
    if features.rescaling:
        shear = rescaled_shear(old, root, load(wall_pairs.root, (pair,), lanes))
    shear = select(depth > 0.0, mindlin_shear(shear, slide, stiffness * shear_ratio), 0.0)
    if features.slip:
        shear = coulomb_limit(shear, normal * friction)
    elif friction <= 0.0:
        shear = shear * 0.0
    if features.account:
        before = load(wall_pairs.root, (pair,), lanes) * (1.5 * wall_pairs.hertz[pair])
        add_shear_loss(features, old, shear, before * shear_ratio, stiffness * shear_ratio, slide, watch)
    if features.rescaling or features.account:
        store(wall_pairs.root, (pair,), root)
    store(wall_pairs.shear, (pair,), shear)
    return normal, stiffness, shear


@inlined
def add_reaction(features: Features, wall: int, normal: Vector, shear: Vector, stiffness: Vector, walls: Walls) -> None:
    """Add one contact to the sums of a wall."""
    lanes = features.lanes
    store(walls.reaction, (wall, 0), load(walls.reaction, (wall, 0), lanes) + normal)
    store(walls.reaction, (wall, 1), load(walls.reaction, (wall, 1), lanes) + shear)
    store(walls.reaction, (wall, 2), load(walls.reaction, (wall, 2), lanes) + stiffness)


@inlined
def move_wall(
    features: Features, wall: int, step: int, dt: Vector, walls: Walls, recording: Recording, watch: Watch
) -> None:
    """Give a wall its velocity of this step and move it; the drive and the servo act here."""
    lanes = features.lanes
    before_normal, before_tangent = load(walls.motion, (wall, 2), lanes), load(walls.motion, (wall, 3), lanes)
    along_normal, along_tangent = before_normal, before_tangent
    if features.recording:  # noqa: SIM102 - known to the compiler, unlike the condition within
        if wall == recording.driven:
            along_tangent = load(recording.drive, (step,), lanes)
    if features.servo:  # noqa: SIM102 - as above
        if walls.servo[wall, 0] > 0.0:
            along_normal = servo_speed(features, wall, dt, walls)
    store(walls.motion, (wall, 2), along_normal)
    store(walls.motion, (wall, 3), along_tangent)
    store(walls.motion, (wall, 0), load(walls.motion, (wall, 0), lanes) + dt * along_normal)
    store(walls.motion, (wall, 1), load(walls.motion, (wall, 1), lanes) + dt * along_tangent)
    if features.account:
        pushed = load(walls.reaction, (wall, 0), lanes) * (before_normal + along_normal)
        dragged = load(walls.reaction, (wall, 1), lanes) * (before_tangent + along_tangent)
        work = 0.5 * dt * (pushed - dragged)
        store(watch.account, (0,), load(watch.account, (0,), lanes) + work)


@inlined
def servo_speed(features: Features, wall: int, dt: Vector, walls: Walls) -> Vector:
    """Speed that would bring the wall's force to its target in 1 / gain steps, up to a largest speed.

    ``v = gain (F_target - F) / (K dt)`` with K the summed contact stiffness of the wall (PFC's servo); a
    wall that touches nothing approaches at the largest speed.
    """
    lanes = features.lanes
    gain, target, fastest = walls.servo[wall, 0], walls.servo[wall, 1], walls.servo[wall, 2]
    lacking = target - load(walls.reaction, (wall, 0), lanes)
    stiffness = load(walls.reaction, (wall, 2), lanes)
    loaded = stiffness > 0.0
    speed = select(loaded, gain * lacking / (select(loaded, stiffness, 1.0) * dt), lacking * 0.0 + fastest)
    return smaller(larger(speed, lacking * 0.0 - fastest), lacking * 0.0 + fastest)
