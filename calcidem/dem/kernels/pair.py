"""Force between two disks, on lane vectors."""

from typing import Any

from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.lanes import bits_of_mask, load, mask_of_bits, select, square_root, store
from calcidem.dem.kernels.laws import (
    bond_fails,
    coulomb_limit,
    hertz_normal,
    inlined,
    mindlin_shear,
    rescaled_shear,
)
from calcidem.dem.kernels.layout import Grains, Motion, Pairs, Watch


@inlined  # type: ignore[untyped-decorator]
def pair_forces(
    features: Features,
    first: int,
    pair: int,
    dt: Any,
    shear_ratio: float,
    grains: Grains,
    motion: Motion,
    pairs: Pairs,
    watch: Watch,
    force: tuple[Any, Any, Any],
) -> tuple[Any, Any, Any]:
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
    normal_x, normal_y, _, arm_first, arm_second = geometry
    along_x = normal * normal_x - shear * normal_y
    along_y = normal * normal_y + shear * normal_x
    store(motion.force, (second, 0), load(motion.force, (second, 0), lanes) + along_x)
    store(motion.force, (second, 1), load(motion.force, (second, 1), lanes) + along_y)
    turning = force[2]
    if features.rotation:
        store(motion.force, (second, 2), load(motion.force, (second, 2), lanes) + (moment - shear * arm_second))
        turning = turning - (moment + shear * arm_first)
    return force[0] - along_x, force[1] - along_y, turning


@inlined  # type: ignore[untyped-decorator]
def pair_geometry(
    features: Features, first: int, second: int, pair: int, grains: Grains, motion: Motion, pairs: Pairs
) -> tuple[Any, Any, Any, Any, Any]:
    """Unit normal from the first to the second disk, overlap, and the arms from the centres to the contact.

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
        return x * inverse, y * inverse, depth, grains.radius[first] - 0.5 * depth, grains.radius[second] - 0.5 * depth
    arm_first = nothing + (grains.radius[first] - 0.5 * overlap)
    arm_second = nothing + (grains.radius[second] - 0.5 * overlap)
    return normal_x, normal_y, overlap - along, arm_first, arm_second


@inlined  # type: ignore[untyped-decorator]
def relative(features: Features, first: int, second: int, field: Any) -> tuple[Any, Any]:
    """Components of the second disk's translation less the first's."""
    lanes = features.lanes
    return (
        load(field, (second, 0), lanes) - load(field, (first, 0), lanes),
        load(field, (second, 1), lanes) - load(field, (first, 1), lanes),
    )


@inlined  # type: ignore[untyped-decorator]
def slide_and_twist(
    features: Features, first: int, second: int, geometry: tuple[Any, Any, Any, Any, Any], field: Any
) -> tuple[Any, Any]:
    """Tangential displacement (or velocity) at the contact and relative rotation, second less first."""
    lanes = features.lanes
    normal_x, normal_y, _, arm_first, arm_second = geometry
    apart_x, apart_y = relative(features, first, second, field)
    slide = normal_x * apart_y - normal_y * apart_x
    if features.rotation:
        turn_first = load(field, (first, 2), lanes)
        turn_second = load(field, (second, 2), lanes)
        return slide - arm_first * turn_first - arm_second * turn_second, turn_second - turn_first
    return slide, slide * 0.0


@inlined  # type: ignore[untyped-decorator]
def linear_law(
    features: Features,
    first: int,
    second: int,
    pair: int,
    geometry: tuple[Any, Any, Any, Any, Any],
    motion: Motion,
    pairs: Pairs,
) -> tuple[Any, Any, Any]:
    """Normal force, shear force and moment that constant stiffnesses add to the reference state."""
    slide, twist = slide_and_twist(features, first, second, geometry, motion.displacement)
    closer = geometry[2] - pairs.geometry[pair, 3]
    nothing = twist * 0.0
    if features.bonds:
        intact = mask_of_bits(pairs.intact[pair], features.lanes)
        normal = select(intact, nothing + pairs.bond[pair, 0], pairs.tangent[pair, 0])
        shear = select(intact, nothing + pairs.bond[pair, 1], pairs.tangent[pair, 1])
        bending = select(intact, nothing + pairs.bond[pair, 2], 0.0)
        return normal * closer, -(shear * slide), -(bending * twist)
    return closer * pairs.tangent[pair, 0], slide * -pairs.tangent[pair, 1], nothing


@inlined  # type: ignore[untyped-decorator]
def general_law(
    features: Features,
    first: int,
    second: int,
    pair: int,
    dt: Any,
    shear_ratio: float,
    geometry: tuple[Any, Any, Any, Any, Any],
    motion: Motion,
    pairs: Pairs,
    watch: Watch,
) -> tuple[Any, Any, Any]:
    """Normal force, shear force and moment from overlap, histories and the increments of the last step."""
    lanes = features.lanes
    overlap = geometry[2]
    speed, spin = slide_and_twist(features, first, second, geometry, motion.velocity)
    slide = speed * dt
    normal, root = hertz_normal(overlap, pairs.hertz[pair])
    stiffness = root * (1.5 * pairs.hertz[pair] * shear_ratio)
    touching = overlap > 0.0
    if features.linear_group:
        cemented = mask_of_bits(pairs.cemented[pair], lanes)
        depth = overlap - pairs.linear[pair, 2]
        pressed = select(depth > 0.0, depth, 0.0)
        normal = select(cemented, pressed * pairs.linear[pair, 0], normal)
        stiffness = select(cemented, stiffness * 0.0 + pairs.linear[pair, 1], stiffness)
        touching = normal > 0.0
    shear = load(pairs.shear, (pair,), lanes)
    if features.rescaling:
        carried = rescaled_shear(shear, root, load(pairs.root, (pair,), lanes))
        if features.linear_group:
            carried = select(mask_of_bits(pairs.cemented[pair], lanes), shear, carried)
        shear = carried
        store(pairs.root, (pair,), root)
    shear = select(touching, mindlin_shear(shear, slide, stiffness), 0.0)
    if features.slip:
        trial = shear
        shear = coulomb_limit(trial, normal * pairs.friction[pair])
        if features.account:
            add_slip(features, shear, trial, stiffness, watch)
    moment = slide * 0.0
    if features.bonds:
        intact = mask_of_bits(pairs.intact[pair], lanes)
        if not features.linear_group:
            # The bond takes the place of the sand contact; a broken one gives it back.
            normal = select(intact, normal * 0.0, normal)
            shear = select(intact, shear * 0.0, shear)
        store(pairs.shear, (pair,), shear)
        approach = relative_approach(features, first, second, geometry, dt, motion)
        bond = bond_forces(features, pair, slide, spin * dt, approach, pairs)
        return normal + bond[0], shear + bond[1], bond[2]
    store(pairs.shear, (pair,), shear)
    return normal, shear, moment


@inlined  # type: ignore[untyped-decorator]
def add_slip(features: Features, shear: Any, trial: Any, stiffness: Any, watch: Watch) -> None:
    """Add the work of sliding friction, F_s times the slid distance (F_s,trial - F_s) / k_s, to the account."""
    slid = (trial - shear) / select(stiffness > 0.0, stiffness, 1.0)
    store(watch.account, (1,), load(watch.account, (1,), features.lanes) + shear * slid)


@inlined  # type: ignore[untyped-decorator]
def relative_approach(
    features: Features, first: int, second: int, geometry: tuple[Any, Any, Any, Any, Any], dt: Any, motion: Motion
) -> Any:
    """Approach of two disks along the normal during the last step, m."""
    apart_x, apart_y = relative(features, first, second, motion.velocity)
    return -(geometry[0] * apart_x + geometry[1] * apart_y) * dt


@inlined  # type: ignore[untyped-decorator]
def bond_forces(
    features: Features, pair: int, slide: Any, twist: Any, approach: Any, pairs: Pairs
) -> tuple[Any, Any, Any]:
    """Forces of the parallel bond after one more increment; breaks it where it is too weak."""
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
        intact = intact & ~broken
        pairs.intact[pair] = bits_of_mask(intact)
    normal = select(intact, normal, 0.0)
    shear = select(intact, shear, 0.0)
    moment = select(intact, moment, 0.0)
    store(pairs.bond_force, (pair, 0), normal)
    store(pairs.bond_force, (pair, 1), shear)
    store(pairs.bond_force, (pair, 2), moment)
    return normal, shear, moment
