"""Force between a disk and a wall, and the motion of walls, on lane vectors.

The wall is the first body of a contact, the disk the second. A flat wall needs no square root: the
overlap changes by exactly the normal components of the two displacements.
"""

from calcidem.dem.kernels.compiling import inline
from calcidem.dem.kernels.lanes import (
    Vector,
    fill_lanes,
    larger,
    load,
    magnitude,
    scalar,
    select,
    smaller,
    store,
    zero_like,
)
from calcidem.dem.kernels.laws import SMALLEST_ROOT, coulomb_limit, hertz_normal, mindlin_shear, rescale_shear
from calcidem.dem.kernels.layout import (
    GAIN,
    NORMAL,
    NORMAL_PATH,
    NORMAL_SPEED,
    ROTATION,
    SHEAR,
    STIFFNESS,
    TANGENT_PATH,
    TANGENT_SPEED,
    TARGET,
    TOP_SPEED,
    WALL_WORK,
    Features,
    Front,
    System,
    Walls,
    Watch,
    X,
    Y,
)
from calcidem.dem.kernels.motion import add_energy, of_disk
from calcidem.dem.kernels.pair import add_shear_loss, middle_root


@inline
def wall_force(
    features: Features, contact: int, level: int, dt: Vector, system: System
) -> tuple[tuple[Vector, Vector, Vector], tuple[Vector, Vector, Vector]]:
    """Return x, y and moment of the force on the disk of a contact, and what it adds to `layout.Walls.reaction`."""
    lanes = features.lanes
    grains, motion, front = system.grains, system.motion, system.front
    walls, wall_pairs = system.walls, system.wall_pairs
    grain, wall = scalar(wall_pairs.disk, (contact,)), scalar(wall_pairs.wall, (contact,))
    overlap = scalar(wall_pairs.overlap, (contact,))
    normal_x, normal_y = scalar(walls.normal, (wall, X)), scalar(walls.normal, (wall, Y))
    field = motion.displacement
    away = normal_x * of_disk(features, field, grain, X) + normal_y * of_disk(features, field, grain, Y)
    closer = load(front.wall_motion, (level, wall, NORMAL_PATH), lanes) - away
    depth = overlap + closer
    if features.linear:
        arm = zero_like(away) + (scalar(grains.radius, (grain,)) - 0.5 * overlap)
        rim = load(front.wall_motion, (level, wall, TANGENT_PATH), lanes)
        slide = _wall_slide(features, grain, wall, arm, rim, motion.displacement, walls)
        normal = closer * scalar(wall_pairs.tangent, (contact, NORMAL))
        stiffness = fill_lanes(scalar(wall_pairs.tangent, (contact, NORMAL)), lanes)
        shear = slide * -scalar(wall_pairs.tangent, (contact, SHEAR))
    else:
        arm = scalar(grains.radius, (grain,)) - 0.5 * depth
        rim = load(front.wall_motion, (level, wall, TANGENT_SPEED), lanes)
        slide = _wall_slide(features, grain, wall, arm, rim, motion.velocity, walls) * dt
        friction = min(scalar(walls.friction, (wall,)), scalar(grains.friction, (grain,)))
        normal, stiffness, shear = _wall_law(features, contact, friction, depth, slide, system)
    on_disk = normal * normal_x - shear * normal_y, normal * normal_y + shear * normal_x, -(shear * arm)
    return on_disk, (normal, -shear, stiffness)


@inline
def _wall_slide(
    features: Features, grain: int, wall: int, arm: Vector, wall_path: Vector, field: Vector, walls: Walls
) -> Vector:
    """Tangential displacement (or velocity) of a disk's rim relative to a wall."""
    normal_x, normal_y = scalar(walls.normal, (wall, X)), scalar(walls.normal, (wall, Y))
    along = normal_x * of_disk(features, field, grain, Y) - normal_y * of_disk(features, field, grain, X)
    slide = along - wall_path
    if features.rotation:
        slide = slide - arm * of_disk(features, field, grain, ROTATION)
    return slide


@inline
def _wall_law(
    features: Features, pair: int, friction: float, depth: Vector, slide: Vector, system: System
) -> tuple[Vector, Vector, Vector]:
    """Hertz-Mindlin contact of a disk and a wall: normal force, normal stiffness, shear force on the disk."""
    lanes = features.lanes
    wall_pairs, shear_ratio = system.wall_pairs, system.grains.shear_ratio
    hertz = scalar(wall_pairs.hertz, (pair,))
    normal, root = hertz_normal(depth, hertz)
    stiffness = root * (1.5 * hertz)
    sliding = stiffness
    if features.midpoint:
        sliding = middle_root(features, root, load(wall_pairs.root, (pair,), lanes)) * (1.5 * hertz)
    old = load(wall_pairs.shear, (pair,), lanes)
    shear = old
    if features.rescaling:
        before = load(wall_pairs.root, (pair,), lanes)
        shear = rescale_shear(old, root, before, 1.0 / before)
    shear = select(depth > 0.0, mindlin_shear(shear, slide, sliding * shear_ratio), 0.0)
    if features.slip:
        shear = coulomb_limit(shear, normal * friction)
    elif friction <= 0.0:
        shear = zero_like(shear)
    if features.account:
        softer = (1.5 * hertz) * load(wall_pairs.root, (pair,), lanes)
        add_shear_loss(features, old, shear, softer * shear_ratio, stiffness * shear_ratio, slide, system.watch)
    if features.rescaling or features.account or features.midpoint:
        store(wall_pairs.root, (pair,), larger(root, SMALLEST_ROOT))
    store(wall_pairs.shear, (pair,), shear)
    return normal, stiffness, shear


@inline
def add_reaction(features: Features, wall: int, level: int, part: tuple[Vector, Vector, Vector], front: Front) -> None:
    """Add one contact to the sums of a wall."""
    lanes, sums = features.lanes, front.reaction
    store(sums, (level, wall, NORMAL), load(sums, (level, wall, NORMAL), lanes) + part[NORMAL])
    store(sums, (level, wall, SHEAR), load(sums, (level, wall, SHEAR), lanes) + part[SHEAR])
    store(sums, (level, wall, STIFFNESS), load(sums, (level, wall, STIFFNESS), lanes) + part[STIFFNESS])


@inline
def start_walls(features: Features, together: int, step: int, dt: Vector, system: System) -> None:
    """Write the positions of the walls in each of the next steps, from ``step`` on, and clear their sums.

    Walls that depend on the forces of a step (servo) or whose work is counted allow one step at a time only.
    """
    walls, front = system.walls, system.front
    for wall in range(walls.normal.shape[0]):
        for column in range(4):
            store(front.wall_motion, (0, wall, column), load(walls.motion, (wall, column), features.lanes))
        for level in range(together):
            for column in range(3):
                store(front.reaction, (level, wall, column), zero_like(dt))
        for level in range(together - 1):
            _move_wall(features, wall, level, step + level, dt, system)


@inline
def finish_walls(features: Features, together: int, step: int, dt: Vector, system: System) -> None:
    """Move the walls to the end of the last of the steps done together, ``step``; keep its forces."""
    lanes = features.lanes
    walls, front = system.walls, system.front
    for wall in range(walls.normal.shape[0]):
        _move_wall(features, wall, together - 1, step, dt, system)
        for column in range(4):
            store(walls.motion, (wall, column), load(front.wall_motion, (together, wall, column), lanes))
        for column in range(3):
            store(walls.reaction, (wall, column), load(front.reaction, (together - 1, wall, column), lanes))


@inline
def _move_wall(features: Features, wall: int, level: int, step: int, dt: Vector, system: System) -> None:
    """Set the velocity of a wall in this step and move it; drive and servo act here."""
    lanes = features.lanes
    front, recording = system.front, system.recording
    before_normal = load(front.wall_motion, (level, wall, NORMAL_SPEED), lanes)
    before_tangent = load(front.wall_motion, (level, wall, TANGENT_SPEED), lanes)
    along_normal, along_tangent = before_normal, before_tangent
    if features.recording:  # noqa: SIM102 - known to the compiler, unlike the condition within
        if wall == recording.driven:
            along_tangent = load(recording.drive, (step,), lanes)
    if features.servo:  # noqa: SIM102 - as above
        if scalar(system.walls.servo, (wall, GAIN)) > 0.0:
            along_normal = _servo_speed(features, wall, level, dt, system.walls, front)
    moved_normal = load(front.wall_motion, (level, wall, NORMAL_PATH), lanes) + dt * along_normal
    moved_tangent = load(front.wall_motion, (level, wall, TANGENT_PATH), lanes) + dt * along_tangent
    store(front.wall_motion, (level + 1, wall, NORMAL_PATH), moved_normal)
    store(front.wall_motion, (level + 1, wall, TANGENT_PATH), moved_tangent)
    store(front.wall_motion, (level + 1, wall, NORMAL_SPEED), along_normal)
    store(front.wall_motion, (level + 1, wall, TANGENT_SPEED), along_tangent)
    if features.account:
        pushed = load(front.reaction, (level, wall, NORMAL), lanes) * (before_normal + along_normal)
        dragged = load(front.reaction, (level, wall, SHEAR), lanes) * (before_tangent + along_tangent)
        add_energy(features, WALL_WORK, 0.5 * dt * (pushed - dragged), system.watch)


@inline
def wall_is_far(features: Features, wall: int, walls: Walls, watch: Watch) -> Vector:
    """Return the lanes in which a wall is beyond the reach of the pair list."""
    lanes = features.lanes
    moved = load(walls.motion, (wall, NORMAL_PATH), lanes) - load(watch.wall_origin, (wall,), lanes)
    return magnitude(moved) > watch.reach


@inline
def _servo_speed(features: Features, wall: int, level: int, dt: Vector, walls: Walls, front: Front) -> Vector:
    """Speed that would bring the wall's force to its target in 1 / gain steps, up to a largest speed.

    ``v = gain (F_target - F) / (K dt)`` with K the summed contact stiffness of the wall, as PFC's servo-mechanism of
    walls does it; a wall that touches nothing approaches at the largest speed.
    """
    lanes = features.lanes
    gain, fastest = scalar(walls.servo, (wall, GAIN)), scalar(walls.servo, (wall, TOP_SPEED))
    lacking = scalar(walls.servo, (wall, TARGET)) - load(front.reaction, (level, wall, NORMAL), lanes)
    stiffness = load(front.reaction, (level, wall, STIFFNESS), lanes)
    loaded = stiffness > 0.0
    speed = select(loaded, gain * lacking / (select(loaded, stiffness, 1.0) * dt), zero_like(lacking) + fastest)
    return smaller(larger(speed, zero_like(lacking) - fastest), zero_like(lacking) + fastest)
