"""Force between two disks, on lane vectors."""

from typing import TypeAlias

from calcidem.dem.kernels.compiling import inlined
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.lanes import (
    Vector,
    bits_of_mask,
    inverse_root_of,
    load,
    mask_of_bits,
    number,
    row,
    select,
    spread,
    store,
    zero_like,
)
from calcidem.dem.kernels.laws import bond_fails, coulomb_limit, hertz_normal, mindlin_shear, rescaled_shear
from calcidem.dem.kernels.layout import Front, Grains, Motion, Pairs, Watch
from calcidem.dem.kernels.motion import add_force

Geometry: TypeAlias = tuple[Vector, Vector, Vector, Vector, Vector, Vector]


@inlined
def pair_forces(
    features: Features,
    pair: int,
    level: int,
    dt: Vector,
    grains: Grains,
    motion: Motion,
    pairs: Pairs,
    front: Front,
    watch: Watch,
) -> None:
    """Add the force of one pair to its two disks."""
    first, second = number(pairs.first, (pair,)), number(pairs.second, (pair,))
    geometry = pair_geometry(features, first, second, pair, grains, motion, pairs)
    if features.linear:
        normal, shear, moment = linear_law(features, first, second, pair, geometry, motion, pairs)
    else:
        normal, shear, moment = general_law(features, first, second, pair, dt, geometry, motion, pairs, watch)
    normal_x, normal_y, _, arm_first, arm_second, _ = geometry
    along_x = normal * normal_x - shear * normal_y
    along_y = normal * normal_y + shear * normal_x
    add_force(features, first, 0, level, -along_x, front)
    add_force(features, first, 1, level, -along_y, front)
    add_force(features, second, 0, level, along_x, front)
    add_force(features, second, 1, level, along_y, front)
    if features.rotation and features.bonds:
        add_force(features, first, 2, level, -(moment + shear * arm_first), front)
        add_force(features, second, 2, level, moment - shear * arm_second, front)
    elif features.rotation:
        add_force(features, first, 2, level, -(shear * arm_first), front)
        add_force(features, second, 2, level, -(shear * arm_second), front)


@inlined
def pair_geometry(
    features: Features, first: int, second: int, pair: int, grains: Grains, motion: Motion, pairs: Pairs
) -> Geometry:
    """Return unit normal from first to second disk, overlap, arms from the centres to the contact, curvature.

    The curvature is the inverse of the distance, and zero where normals do not turn.

    The overlap is the reference overlap less the *change* of the distance, which keeps single precision
    accurate: overlaps are a ten-thousandth of a radius, and their changes far less. The contact lies in
    the middle of the overlap, so the arms add up to the distance and angular momentum is conserved.
    """
    reference_x, reference_y = number(pairs.geometry, (pair, 0)), number(pairs.geometry, (pair, 1))
    reference_distance, overlap = number(pairs.geometry, (pair, 2)), number(pairs.geometry, (pair, 3))
    apart_x, apart_y = relative(features, first, second, motion.displacement)
    if features.finite:
        before_x, before_y = number(pairs.geometry, (pair, 4)), number(pairs.geometry, (pair, 5))
        x, y = apart_x + before_x, apart_y + before_y
        square = x * x + y * y
        inverse = inverse_root_of(square)
        # By how much the distance grew: the root of a large number first, then one of Newton's steps on
        # ``longer (2 reference + longer) = x^2 - reference^2``, whose right side is free of cancellation.
        grown = (x + before_x) * apart_x + (y + before_y) * apart_y
        distance = square * inverse
        longer = distance - reference_distance
        longer = longer + 0.5 * inverse * (grown - longer * (distance + reference_distance))
        depth = overlap - longer
        arm_first = number(grains.radius, (first,)) - 0.5 * depth
        arm_second = number(grains.radius, (second,)) - 0.5 * depth
        return x * inverse, y * inverse, depth, arm_first, arm_second, inverse
    normal_x, normal_y = spread(reference_x, features.lanes), spread(reference_y, features.lanes)
    along = normal_x * apart_x + normal_y * apart_y
    arm_first = spread(number(pairs.geometry, (pair, 6)), features.lanes)
    arm_second = spread(number(pairs.geometry, (pair, 7)), features.lanes)
    return normal_x, normal_y, overlap - along, arm_first, arm_second, zero_like(along)


@inlined
def relative(features: Features, first: int, second: int, field: Vector) -> tuple[Vector, Vector]:
    """Components of the second disk's translation less the first's."""
    lanes = features.lanes
    return (
        load(field, (row(second, 0),), lanes) - load(field, (row(first, 0),), lanes),
        load(field, (row(second, 1),), lanes) - load(field, (row(first, 1),), lanes),
    )


@inlined
def slide_and_twist(
    features: Features, first: int, second: int, geometry: Geometry, field: Vector
) -> tuple[Vector, Vector]:
    """Tangential displacement (or velocity) at the contact and relative rotation, second less first."""
    lanes = features.lanes
    normal_x, normal_y, _, arm_first, arm_second, _ = geometry
    apart_x, apart_y = relative(features, first, second, field)
    slide = normal_x * apart_y - normal_y * apart_x
    if features.rotation:
        turn_first = load(field, (row(first, 2),), lanes)
        turn_second = load(field, (row(second, 2),), lanes)
        return slide - arm_first * turn_first - arm_second * turn_second, turn_second - turn_first
    return slide, zero_like(slide)


@inlined
def linear_law(
    features: Features,
    first: int,
    second: int,
    pair: int,
    geometry: Geometry,
    motion: Motion,
    pairs: Pairs,
) -> tuple[Vector, Vector, Vector]:
    """Return normal force, shear force and moment that constant stiffnesses add to the reference state."""
    slide, twist = slide_and_twist(features, first, second, geometry, motion.displacement)
    closer = geometry[2] - number(pairs.geometry, (pair, 3))
    if features.bonds:
        intact = mask_of_bits(number(pairs.intact, (pair,)), features.lanes)
        normal_stiffness, shear_stiffness = number(pairs.bond, (pair, 0)), number(pairs.bond, (pair, 1))
        if features.linear_group:
            normal_stiffness = normal_stiffness + number(pairs.linear, (pair, 0))
            shear_stiffness = shear_stiffness + number(pairs.linear, (pair, 1))
        normal = select(intact, spread(normal_stiffness, features.lanes), number(pairs.tangent, (pair, 0)))
        shear = select(intact, spread(shear_stiffness, features.lanes), number(pairs.tangent, (pair, 1)))
        bending = select(intact, spread(number(pairs.bond, (pair, 2)), features.lanes), 0.0)
        return normal * closer, -(shear * slide), -(bending * twist)
    return closer * number(pairs.tangent, (pair, 0)), -(slide * number(pairs.tangent, (pair, 1))), zero_like(slide)


@inlined
def general_law(
    features: Features,
    first: int,
    second: int,
    pair: int,
    dt: Vector,
    geometry: Geometry,
    motion: Motion,
    pairs: Pairs,
    watch: Watch,
) -> tuple[Vector, Vector, Vector]:
    """Return normal force, shear force and moment from overlap, histories and the increments of the last step."""
    speed, spin = slide_and_twist(features, first, second, geometry, motion.velocity)
    slide = speed * dt
    if not features.bonds:
        normal, shear = frictional_law(features, pair, geometry[2], slide, pairs, watch)
        return normal, shear, zero_like(slide)
    approach = relative_approach(features, first, second, geometry, dt, motion)
    normal, shear, moment = bond_forces(features, pair, slide, spin * dt, approach, geometry[2], pairs, watch)
    if features.linear_group or number(pairs.intact, (pair,)) != (1 << features.lanes) - 1:
        # Where all lanes are cemented, and the cement has no part with friction, there is nothing to add.
        friction = frictional_law(features, pair, geometry[2], slide, pairs, watch)
        normal, shear = normal + friction[0], shear + friction[1]
    return normal, shear, moment


@inlined
def frictional_law(
    features: Features,
    pair: int,
    overlap: Vector,
    slide: Vector,
    pairs: Pairs,
    watch: Watch,
) -> tuple[Vector, Vector]:
    """Return normal and shear force of the part with friction: the sand's contact, or the cement's linear group.

    Without a linear group an intact bond takes the place of the sand's contact; a broken one gives it back.
    """
    lanes = features.lanes
    normal, root, inverse_root = hertz_normal(overlap, number(pairs.hertz, (pair,)))
    stiffness = root * number(pairs.mindlin, (pair,))
    touching = overlap > 0.0
    old = load(pairs.shear, (pair,), lanes)
    carried = old
    if features.rescaling:
        carried = rescaled_shear(old, root, inverse_root, load(pairs.inverse_root, (pair,), lanes))
    if features.linear_group:
        cemented = mask_of_bits(number(pairs.cemented, (pair,)), lanes)
        depth = overlap - number(pairs.linear, (pair, 2))
        pressed = select(depth > 0.0, depth, 0.0)
        normal = select(cemented, pressed * number(pairs.linear, (pair, 0)), normal)
        stiffness = select(cemented, spread(number(pairs.linear, (pair, 1)), lanes), stiffness)
        carried = select(cemented, old, carried)
        touching = normal > 0.0
    shear = select(touching, mindlin_shear(carried, slide, stiffness), 0.0)
    if features.slip:
        shear = coulomb_limit(shear, normal * number(pairs.friction, (pair,)))
    elif number(pairs.friction, (pair,)) <= 0.0:
        shear = zero_like(shear)
    if features.bonds and not features.linear_group:
        intact = mask_of_bits(number(pairs.intact, (pair,)), lanes)
        normal = select(intact, 0.0, normal)
        shear = select(intact, 0.0, shear)
    store(pairs.shear, (pair,), shear)
    if features.account:
        before = number(pairs.mindlin, (pair,)) / load(pairs.inverse_root, (pair,), lanes)
        if features.linear_group:
            before = select(mask_of_bits(number(pairs.cemented, (pair,)), lanes), stiffness, before)
        add_shear_loss(features, old, shear, before, stiffness, slide, watch)
    if features.rescaling or features.account:
        store(pairs.inverse_root, (pair,), inverse_root)
    return normal, shear


@inlined
def add_shear_loss(
    features: Features, old: Vector, new: Vector, before: Vector, after: Vector, slide: Vector, watch: Watch
) -> None:
    """Add to the account what the shear spring of a contact loses in one step.

    It is the work done on the spring, ``-(F_old + F_new) / 2 du_s``, less the change of ``F_s^2 / (2 k_s)``: sliding
    friction, and what vanishes because ``k_s`` changes with the normal force. Negative where energy is created, as in
    shear rescaling mode 0.
    """
    stored = new * new / select(after > 0.0, 2.0 * after, 1.0)
    held = old * old / select(before > 0.0, 2.0 * before, 1.0)
    lost = held - stored - 0.5 * (old + new) * slide
    store(watch.account, (1,), load(watch.account, (1,), features.lanes) + lost)


@inlined
def relative_approach(
    features: Features, first: int, second: int, geometry: Geometry, dt: Vector, motion: Motion
) -> Vector:
    """Return by how much the distance of two disks shrank during the last step, m.

    The normal belongs to the end of the step. ``across^2 / (2 distance)`` corrects for its turning: without it a bonded
    pair that only rotates would stretch its bond a little in every step.
    """
    apart_x, apart_y = relative(features, first, second, motion.velocity)
    along = (geometry[0] * apart_x + geometry[1] * apart_y) * dt
    if features.finite:
        across = (geometry[0] * apart_y - geometry[1] * apart_x) * dt
        return 0.5 * across * across * geometry[5] - along
    return -along


@inlined
def bond_forces(
    features: Features,
    pair: int,
    slide: Vector,
    twist: Vector,
    approach: Vector,
    overlap: Vector,
    pairs: Pairs,
    watch: Watch,
) -> tuple[Vector, Vector, Vector]:
    """Return the forces of the parallel bond after one more increment; break it where it is too weak."""
    lanes = features.lanes
    intact = mask_of_bits(number(pairs.intact, (pair,)), lanes)
    normal = load(pairs.bond_force, (row(pair, 0),), lanes) + approach * number(pairs.bond, (pair, 0))
    shear = load(pairs.bond_force, (row(pair, 1),), lanes) - slide * number(pairs.bond, (pair, 1))
    moment = load(pairs.bond_force, (row(pair, 2),), lanes) - twist * number(pairs.bond, (pair, 2))
    if features.breakage:
        broken = bond_fails(
            normal,
            shear,
            moment,
            tension_limit=number(pairs.strength, (pair, 0)),
            shear_limit=number(pairs.strength, (pair, 1)),
            friction_slope=number(pairs.strength, (pair, 2)),
            bending=number(pairs.strength, (pair, 3)),
        )
        if features.account:
            add_breakage_loss(features, pair, intact & broken, (normal, shear, moment), overlap, pairs, watch)
        intact = intact & ~broken
        pairs.intact[pair] = bits_of_mask(intact)
    normal = select(intact, normal, 0.0)
    shear = select(intact, shear, 0.0)
    moment = select(intact, moment, 0.0)
    store(pairs.bond_force, (row(pair, 0),), normal)
    store(pairs.bond_force, (row(pair, 1),), shear)
    store(pairs.bond_force, (row(pair, 2),), moment)
    return normal, shear, moment


@inlined
def add_breakage_loss(
    features: Features,
    pair: int,
    broken: Vector,
    bond: tuple[Vector, Vector, Vector],
    overlap: Vector,
    pairs: Pairs,
    watch: Watch,
) -> None:
    """Add the energy of a breaking bond to the account, less that of the sand's contact which takes over."""
    lost = bond[0] * bond[0] / number(pairs.bond, (pair, 0))
    lost = lost + bond[1] * bond[1] / number(pairs.bond, (pair, 1))
    lost = 0.5 * (lost + bond[2] * bond[2] / number(pairs.bond, (pair, 2)))
    if not features.linear_group:
        normal, _, _ = hertz_normal(overlap, number(pairs.hertz, (pair,)))
        lost = lost - 0.4 * normal * overlap
    store(watch.account, (1,), load(watch.account, (1,), features.lanes) + select(broken, lost, 0.0))
