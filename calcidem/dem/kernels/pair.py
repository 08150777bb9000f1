"""Force between two disks, on lane vectors."""

from typing import TypeAlias

from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.lanes import Vector, bits_of_mask, load, mask_of_bits, select, square_root, store
from calcidem.dem.kernels.laws import (
    bond_fails,
    coulomb_limit,
    hertz_normal,
    inlined,
    mindlin_shear,
    rescaled_shear,
)
from calcidem.dem.kernels.layout import Grains, Motion, Pairs, Watch

Geometry: TypeAlias = tuple[Vector, Vector, Vector, Vector, Vector, Vector]


@inlined
def pair_forces(
    features: Features,
    first: int,
    pair: int,
    dt: Vector,
    shear_ratio: float,
    grains: Grains,
    motion: Motion,
    pairs: Pairs,
    watch: Watch,
    force: tuple[Vector, Vector, Vector],
) -> tuple[Vector, Vector, Vector]:
    """Add the force of one pair to its second disk (in memory) and to the first (returned)."""
    lanes = features.lanes
    second = pairs.second[pair]
    geometry = pair_geometry(features, first, second, pair, grains, motion, pairs)
    if features.linear:
        normal, shear, moment = linear_law(features, first, second, pair, geometry, motion, pairs)
    else:
        normal, shear, moment = general_law(
            features, first, second, pair, dt, shear_ratio, geometry, motion, pairs, watch
        )
    normal_x, normal_y, _, arm_first, arm_second, _ = geometry
    along_x = normal * normal_x - shear * normal_y
    along_y = normal * normal_y + shear * normal_x
    slot = second & (motion.force.shape[0] - 1)
    store(motion.force, (slot, 0), load(motion.force, (slot, 0), lanes) + along_x)
    store(motion.force, (slot, 1), load(motion.force, (slot, 1), lanes) + along_y)
    turning = force[2]
    if features.rotation:
        store(motion.force, (slot, 2), load(motion.force, (slot, 2), lanes) + (moment - shear * arm_second))
        turning = turning - (moment + shear * arm_first)
    return force[0] - along_x, force[1] - along_y, turning


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
    reference_x, reference_y = pairs.geometry[pair, 0], pairs.geometry[pair, 1]
    reference_distance, overlap = pairs.geometry[pair, 2], pairs.geometry[pair, 3]
    apart_x, apart_y = relative(features, first, second, motion.displacement)
    nothing = apart_x * 0.0
    normal_x, normal_y = nothing + reference_x, nothing + reference_y
    along = normal_x * apart_x + normal_y * apart_y
    if features.finite:
        x = reference_x * reference_distance + apart_x
        y = reference_y * reference_distance + apart_y
        distance = square_root(x * x + y * y)
        inverse = 1.0 / distance
        grown = 2.0 * reference_distance * along + (apart_x * apart_x + apart_y * apart_y)
        depth = overlap - grown / (distance + reference_distance)
        arm_first = grains.radius[first] - 0.5 * depth
        arm_second = grains.radius[second] - 0.5 * depth
        return x * inverse, y * inverse, depth, arm_first, arm_second, inverse
    arm_first = nothing + (grains.radius[first] - 0.5 * overlap)
    arm_second = nothing + (grains.radius[second] - 0.5 * overlap)
    return normal_x, normal_y, overlap - along, arm_first, arm_second, nothing


@inlined
def relative(features: Features, first: int, second: int, field: Vector) -> tuple[Vector, Vector]:
    """Components of the second disk's translation less the first's."""
    lanes = features.lanes
    return (
        load(field, (second, 0), lanes) - load(field, (first, 0), lanes),
        load(field, (second, 1), lanes) - load(field, (first, 1), lanes),
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
        turn_first = load(field, (first, 2), lanes)
        turn_second = load(field, (second, 2), lanes)
        return slide - arm_first * turn_first - arm_second * turn_second, turn_second - turn_first
    return slide, slide * 0.0


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
    closer = geometry[2] - pairs.geometry[pair, 3]
    nothing = twist * 0.0
    if features.bonds:
        intact = mask_of_bits(pairs.intact[pair], features.lanes)
        normal_stiffness, shear_stiffness = pairs.bond[pair, 0], pairs.bond[pair, 1]
        if features.linear_group:
            normal_stiffness = normal_stiffness + pairs.linear[pair, 0]
            shear_stiffness = shear_stiffness + pairs.linear[pair, 1]
        normal = select(intact, nothing + normal_stiffness, pairs.tangent[pair, 0])
        shear = select(intact, nothing + shear_stiffness, pairs.tangent[pair, 1])
        bending = select(intact, nothing + pairs.bond[pair, 2], 0.0)
        return normal * closer, -(shear * slide), -(bending * twist)
    return closer * pairs.tangent[pair, 0], slide * -pairs.tangent[pair, 1], nothing


@inlined
def general_law(
    features: Features,
    first: int,
    second: int,
    pair: int,
    dt: Vector,
    shear_ratio: float,
    geometry: Geometry,
    motion: Motion,
    pairs: Pairs,
    watch: Watch,
) -> tuple[Vector, Vector, Vector]:
    """Return normal force, shear force and moment from overlap, histories and the increments of the last step."""
    speed, spin = slide_and_twist(features, first, second, geometry, motion.velocity)
    slide = speed * dt
    if not features.bonds:
        normal, shear = frictional_law(features, pair, shear_ratio, geometry[2], slide, pairs, watch)
        return normal, shear, slide * 0.0
    approach = relative_approach(features, first, second, geometry, dt, motion)
    bond = bond_forces(features, pair, slide, spin * dt, approach, geometry[2], pairs, watch)
    normal, shear = frictional_law(features, pair, shear_ratio, geometry[2], slide, pairs, watch)
    return normal + bond[0], shear + bond[1], bond[2]


@inlined
def frictional_law(
    features: Features,
    pair: int,
    shear_ratio: float,
    overlap: Vector,
    slide: Vector,
    pairs: Pairs,
    watch: Watch,
) -> tuple[Vector, Vector]:
    """Return normal and shear force of the part with friction: the sand's contact, or the cement's linear group.

    Without a linear group an intact bond takes the place of the sand's contact; a broken one gives it back.
    """
    lanes = features.lanes
    normal, root = hertz_normal(overlap, pairs.hertz[pair])
    stiffness = root * (1.5 * pairs.hertz[pair] * shear_ratio)
    touching = overlap > 0.0
    old = load(pairs.shear, (pair,), lanes)
    carried = old
    if features.rescaling:
        carried = rescaled_shear(old, root, load(pairs.root, (pair,), lanes))
    if features.linear_group:
        cemented = mask_of_bits(pairs.cemented[pair], lanes)
        depth = overlap - pairs.linear[pair, 2]
        pressed = select(depth > 0.0, depth, 0.0)
        normal = select(cemented, pressed * pairs.linear[pair, 0], normal)
        stiffness = select(cemented, stiffness * 0.0 + pairs.linear[pair, 1], stiffness)
        carried = select(cemented, old, carried)
        touching = normal > 0.0
    shear = select(touching, mindlin_shear(carried, slide, stiffness), 0.0)
    if features.slip:
        shear = coulomb_limit(shear, normal * pairs.friction[pair])
    elif pairs.friction[pair] <= 0.0:
        shear = shear * 0.0
    if features.bonds and not features.linear_group:
        intact = mask_of_bits(pairs.intact[pair], lanes)
        normal = select(intact, normal * 0.0, normal)
        shear = select(intact, shear * 0.0, shear)
    store(pairs.shear, (pair,), shear)
    if features.account:
        before = load(pairs.root, (pair,), lanes) * (1.5 * pairs.hertz[pair] * shear_ratio)
        if features.linear_group:
            before = select(mask_of_bits(pairs.cemented[pair], lanes), stiffness, before)
        add_shear_loss(features, old, shear, before, stiffness, slide, watch)
    if features.rescaling or features.account:
        store(pairs.root, (pair,), root)
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
    intact = mask_of_bits(pairs.intact[pair], lanes)
    normal = load(pairs.bond_force, (pair, 0), lanes) + approach * pairs.bond[pair, 0]
    shear = load(pairs.bond_force, (pair, 1), lanes) - slide * pairs.bond[pair, 1]
    moment = load(pairs.bond_force, (pair, 2), lanes) - twist * pairs.bond[pair, 2]
    if features.breakage:
        broken = bond_fails(
            normal, shear, moment,
            pairs.strength[pair, 0], pairs.strength[pair, 1], pairs.strength[pair, 2], pairs.strength[pair, 3],
        )  # fmt: skip
        if features.account:
            add_breakage_loss(features, pair, intact & broken, (normal, shear, moment), overlap, pairs, watch)
        intact = intact & ~broken
        pairs.intact[pair] = bits_of_mask(intact)
    normal = select(intact, normal, 0.0)
    shear = select(intact, shear, 0.0)
    moment = select(intact, moment, 0.0)
    store(pairs.bond_force, (pair, 0), normal)
    store(pairs.bond_force, (pair, 1), shear)
    store(pairs.bond_force, (pair, 2), moment)
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
    lost = bond[0] * bond[0] / pairs.bond[pair, 0]
    lost = lost + bond[1] * bond[1] / pairs.bond[pair, 1]
    lost = 0.5 * (lost + bond[2] * bond[2] / pairs.bond[pair, 2])
    if not features.linear_group:
        normal, _ = hertz_normal(overlap, pairs.hertz[pair])
        lost = lost - 0.4 * normal * overlap
    store(watch.account, (1,), load(watch.account, (1,), features.lanes) + select(broken, lost, 0.0))
