"""Force between two disks, on lane vectors: how a pair reads its constants and disks, and adds forces to them.

For many samples a vector holds one pair of each sample. Constants are shared, and a disk is a row of lanes. For one
sample a vector holds `ABREAST` pairs, a *bundle* (see `layout.Pairs`). Then constants are vectors, and disks are
scattered records. Forces are added pair by pair in the order of the list, so sums have the same bits.
"""

from typing import NamedTuple

from calcidem.dem.kernels.compiling import inline
from calcidem.dem.kernels.lanes import (
    Vector,
    bits_of_mask,
    fill_lanes,
    larger,
    load,
    mask_of_bits,
    row,
    scalar,
    select,
    smaller,
    square_root,
    store,
    zero_like,
)
from calcidem.dem.kernels.laws import (
    SMALLEST_ROOT,
    bond_fails,
    coulomb_limit,
    hertz_normal,
    mindlin_shear,
    rescale_shear,
)
from calcidem.dem.kernels.layout import (
    ABREAST,
    APART_X,
    APART_Y,
    BENDING,
    CONTACT_LOSS,
    DISTANCE,
    FIRST_ARM,
    FRICTION_SLOPE,
    MOMENT,
    NORMAL,
    NORMAL_X,
    NORMAL_Y,
    OVERLAP,
    REFERENCE_OVERLAP,
    ROTATION,
    SECOND_ARM,
    SHEAR,
    SHEAR_LIMIT,
    TENSION_LIMIT,
    Features,
    Front,
    Grains,
    Motion,
    Pairs,
    System,
    Watch,
    X,
    Y,
)
from calcidem.dem.kernels.motion import add_energy, add_force
from calcidem.dem.kernels.records import RECORD, columns_to_records, gather_records, load_run, store_run


@inline
def constant(features: Features, array: Vector, index: tuple[Vector, ...]) -> Vector:
    """Constant of a pair: one number for all samples, or a vector of the pairs of a bundle."""
    if features.bundled:
        return load(array, index, features.width)
    return scalar(array, index)


@inline
def radii(features: Features, pair: int, grains: Grains, pairs: Pairs) -> tuple[Vector, Vector]:
    """Radii of the two disks."""
    if features.bundled:
        return load(pairs.radii, (pair, 0), features.width), load(pairs.radii, (pair, 1), features.width)
    first, second = scalar(pairs.first, (pair,)), scalar(pairs.second, (pair,))
    return scalar(grains.radius, (first,)), scalar(grains.radius, (second,))


@inline
def components(features: Features, pair: int, table: Vector, field: Vector) -> tuple[Vector, Vector, Vector]:
    """X, y and rotation of the first or second disk of a pair, listed in ``table``, in a field."""
    if features.bundled:
        return gather_records(field, table, (pair,))
    disk, lanes = scalar(table, (pair,)), features.lanes
    return (
        load(field, (row(disk, X),), lanes),
        load(field, (row(disk, Y),), lanes),
        load(field, (row(disk, ROTATION),), lanes),
    )


class Geometry(NamedTuple):
    """A contact at the present positions."""

    normal_x: Vector
    normal_y: Vector
    """Unit vector from the first to the second disk."""
    overlap: Vector
    """m; with the linear law the distance by which the disks have moved apart."""
    first_arm: Vector
    second_arm: Vector
    """From the centres to the contact, m."""
    curvature: Vector
    """Inverse of the distance of the centres, 1/m; zero where normals do not turn."""
    inverse_root: Vector
    """Inverse of `layout.Pairs.root`, m^-0.5, if that is used."""


class _Increment(NamedTuple):
    """Motion of the second disk relative to the first during the last step."""

    approach: Vector
    """Decrease of the distance, m."""
    slide: Vector
    """Along the tangent at the contact, m."""
    twist: Vector
    """Rotation, rad."""


@inline
def pair_force(
    features: Features, pair: int, geometry: Geometry, dt: Vector, system: System
) -> tuple[Vector, Vector, Vector, Vector]:
    """Return x and y of the force on the second disk, opposite to that on the first, and the moments on both."""
    if features.linear:
        normal, shear, moment = _linear_law(features, pair, geometry, system.motion, system.pairs)
    else:
        normal, shear, moment = _general_law(features, pair, dt, geometry, system)
    x = normal * geometry.normal_x - shear * geometry.normal_y
    y = normal * geometry.normal_y + shear * geometry.normal_x
    first_moment, second_moment = shear * geometry.first_arm, shear * geometry.second_arm
    if features.bonds:
        first_moment, second_moment = moment + first_moment, second_moment - moment
    if features.linear:  # where they act on the first disk
        return -x, -y, first_moment, second_moment
    return x, y, -first_moment, -second_moment


@inline
def pair_geometry(features: Features, pair: int, system: System) -> Geometry:
    """Return the contact of two disks at their present positions.

    The overlap is the reference overlap minus the *change* of the distance. This keeps single precision accurate:
    overlaps are a ten-thousandth of a radius, and their changes far less. The contact lies in the middle of the
    overlap, so the arms add up to the distance, and angular momentum is conserved.
    """
    table = system.pairs.geometry
    overlap = constant(features, table, (pair, OVERLAP))
    apart_x, apart_y = _relative_translation(features, pair, system.pairs, system.motion.displacement)
    if not features.linear:
        distance_before = constant(features, table, (pair, DISTANCE))
        before_x, before_y = constant(features, table, (pair, APART_X)), constant(features, table, (pair, APART_Y))
        x, y = apart_x + before_x, apart_y + before_y
        # Increase of the distance without cancellation: ``longer (distance + before) = x^2 - before^2``.
        grown = (x + before_x) * apart_x + (y + before_y) * apart_y
        distance = square_root(x * x + y * y)
        both = distance + distance_before
        # One division, the slowest operation, gives three inverses.
        root = load(system.pairs.root, (pair,), features.width)
        distance_root = distance * root
        share = 1.0 / (both * distance_root)
        inverse = share * (both * root)
        depth = overlap - grown * (share * distance_root)
        first_radius, second_radius = radii(features, pair, system.grains, system.pairs)
        first_arm, second_arm = first_radius - 0.5 * depth, second_radius - 0.5 * depth
        return Geometry(x * inverse, y * inverse, depth, first_arm, second_arm, inverse, share * (both * distance))
    normal_x = fill_lanes(constant(features, table, (pair, NORMAL_X)), features.width)
    normal_y = fill_lanes(constant(features, table, (pair, NORMAL_Y)), features.width)
    along = normal_x * apart_x + normal_y * apart_y
    first_arm = fill_lanes(constant(features, table, (pair, FIRST_ARM)), features.width)
    second_arm = fill_lanes(constant(features, table, (pair, SECOND_ARM)), features.width)
    flat = zero_like(along)
    return Geometry(normal_x, normal_y, along, first_arm, second_arm, flat, flat)


@inline
def _relative_translation(features: Features, pair: int, pairs: Pairs, field: Vector) -> tuple[Vector, Vector]:
    """Components of the translation of the second disk minus that of the first."""
    first = components(features, pair, pairs.first, field)
    second = components(features, pair, pairs.second, field)
    return second[X] - first[X], second[Y] - first[Y]


@inline
def _slide_and_twist(
    features: Features, pair: int, pairs: Pairs, geometry: Geometry, field: Vector
) -> tuple[Vector, Vector]:
    """Tangential displacement (or velocity) at the contact and relative rotation, second minus first."""
    first = components(features, pair, pairs.first, field)
    second = components(features, pair, pairs.second, field)
    slide = geometry.normal_x * (second[Y] - first[Y]) - geometry.normal_y * (second[X] - first[X])
    if features.rotation:
        slide = slide - geometry.first_arm * first[ROTATION] - geometry.second_arm * second[ROTATION]
        return slide, second[ROTATION] - first[ROTATION]
    return slide, zero_like(slide)


@inline
def _linear_law(
    features: Features, pair: int, geometry: Geometry, motion: Motion, pairs: Pairs
) -> tuple[Vector, Vector, Vector]:
    """Return tension, shear force and moment that constant stiffnesses add to the reference state.

    Unlike those of the finite law they act on the first disk, which saves three changes of sign.
    """
    lanes = features.width
    slide, twist = _slide_and_twist(features, pair, pairs, geometry, motion.displacement)
    apart = geometry.overlap
    sand_normal = constant(features, pairs.tangent, (pair, NORMAL))
    sand_shear = constant(features, pairs.tangent, (pair, SHEAR))
    if features.bonds:
        intact = mask_of_bits(scalar(pairs.intact, (pair,)), lanes)
        cement_normal = constant(features, pairs.bond, (pair, NORMAL))
        cement_shear = constant(features, pairs.bond, (pair, SHEAR))
        if features.linear_group:
            cement_normal = cement_normal + constant(features, pairs.linear, (pair, NORMAL))
            cement_shear = cement_shear + constant(features, pairs.linear, (pair, SHEAR))
        normal = select(intact, fill_lanes(cement_normal, lanes), sand_normal)
        shear = select(intact, fill_lanes(cement_shear, lanes), sand_shear)
        bending = select(intact, fill_lanes(constant(features, pairs.bond, (pair, MOMENT)), lanes), 0.0)
        return normal * apart, shear * slide, bending * twist
    return apart * sand_normal, slide * sand_shear, zero_like(slide)


@inline
def _general_law(
    features: Features, pair: int, dt: Vector, geometry: Geometry, system: System
) -> tuple[Vector, Vector, Vector]:
    """Return normal force, shear force and moment from the overlap, the histories and the increments of a step."""
    pairs, motion, watch = system.pairs, system.motion, system.watch
    speed, spin = _slide_and_twist(features, pair, pairs, geometry, motion.velocity)
    slide = speed * dt
    if not features.bonds:
        normal, shear = _frictional_law(features, pair, geometry, slide, pairs, watch)
        return normal, shear, zero_like(slide)
    approach = _relative_approach(features, pair, geometry, dt, system)
    moved = _Increment(approach, slide, spin * dt)
    normal, shear, moment = _bond_forces(features, pair, moved, geometry.overlap, pairs, watch)
    if features.linear_group or scalar(pairs.intact, (pair,)) != (1 << features.width) - 1:
        # Nothing to add where all lanes are cemented and the cement has no frictional part.
        friction = _frictional_law(features, pair, geometry, slide, pairs, watch)
        normal, shear = normal + friction[0], shear + friction[1]
    return normal, shear, moment


@inline
def _frictional_law(
    features: Features, pair: int, geometry: Geometry, slide: Vector, pairs: Pairs, watch: Watch
) -> tuple[Vector, Vector]:
    """Return normal and shear force of the part with friction: the sand's contact, or the cement's linear group.

    Without a linear group an intact bond replaces the sand's contact; after it breaks the contact is there again.
    """
    lanes, overlap = features.width, geometry.overlap
    normal, root = hertz_normal(overlap, constant(features, pairs.hertz, (pair,)))
    sliding = stiffness = root * constant(features, pairs.mindlin, (pair,))
    if features.midpoint:
        middle = middle_root(features, root, load(pairs.root, (pair,), lanes))
        sliding = middle * constant(features, pairs.mindlin, (pair,))
    touching = overlap > 0.0
    old = load(pairs.shear, (pair,), lanes)
    carried = old
    if features.rescaling:
        carried = rescale_shear(old, root, load(pairs.root, (pair,), lanes), geometry.inverse_root)
    if features.linear_group:
        cemented = mask_of_bits(scalar(pairs.cemented, (pair,)), lanes)
        depth = overlap - constant(features, pairs.linear, (pair, REFERENCE_OVERLAP))
        pressed = select(depth > 0.0, depth, 0.0)
        normal = select(cemented, pressed * constant(features, pairs.linear, (pair, NORMAL)), normal)
        stiffness = select(cemented, fill_lanes(constant(features, pairs.linear, (pair, SHEAR)), lanes), stiffness)
        sliding = select(cemented, stiffness, sliding)
        carried = select(cemented, old, carried)
        touching = normal > 0.0
    shear = select(touching, mindlin_shear(carried, slide, sliding), 0.0)
    if features.slip:
        shear = coulomb_limit(shear, normal * constant(features, pairs.friction, (pair,)))
    else:
        shear = select(fill_lanes(constant(features, pairs.friction, (pair,)), lanes) > 0.0, shear, 0.0)
    kept_root = larger(root, SMALLEST_ROOT)
    if features.bonds and not features.linear_group:
        intact = mask_of_bits(scalar(pairs.intact, (pair,)), lanes)
        normal = select(intact, 0.0, normal)
        shear = select(intact, 0.0, shear)
        # A cemented pair keeps its root, as where all lanes are cemented and this is not computed.
        kept_root = select(intact, load(pairs.root, (pair,), lanes), kept_root)
    store(pairs.shear, (pair,), shear)
    if features.account:
        before = constant(features, pairs.mindlin, (pair,)) * load(pairs.root, (pair,), lanes)
        if features.linear_group:
            before = select(mask_of_bits(scalar(pairs.cemented, (pair,)), lanes), stiffness, before)
        add_shear_loss(features, old, shear, before, stiffness, slide, watch)
    if features.rescaling or features.account or features.midpoint:
        store(pairs.root, (pair,), kept_root)
    return normal, shear


@inline
def middle_root(features: Features, root: Vector, previous: Vector) -> Vector:
    """Root of the overlap that gives a step its shear stiffness, to second order in the step.

    The shear stiffness is proportional to the root, so the mean of both ends is used for the step. While a contact
    unloads, shear rescaling mode 1 scales the increments of earlier steps, so the root at the end is exact.
    """
    if features.rescaling:
        previous = smaller(root, previous)
    return 0.5 * (root + previous)


@inline
def add_shear_loss(
    features: Features, old: Vector, new: Vector, before: Vector, after: Vector, slide: Vector, watch: Watch
) -> None:
    """Add the loss of a contact's shear spring in one step to the account.

    It is the work done on the spring, ``-(F_old + F_new) / 2 du_s``, minus the change of ``F_s^2 / (2 k_s)``. It
    contains sliding friction, and the energy lost because ``k_s`` changes with the normal force. It is negative where
    energy is created, as in shear rescaling mode 0.
    """
    stored = new * new / select(after > 0.0, 2.0 * after, 1.0)
    held = old * old / select(before > 0.0, 2.0 * before, 1.0)
    add_energy(features, CONTACT_LOSS, held - stored - 0.5 * (old + new) * slide, watch)


@inline
def _relative_approach(features: Features, pair: int, geometry: Geometry, dt: Vector, system: System) -> Vector:
    """Return the decrease of the distance of two disks during the last step, m.

    The normal is that at the end of the step. ``across^2 / (2 distance)`` corrects for its rotation. Otherwise a bonded
    pair that only rotates would stretch its bond a little in every step.
    """
    apart_x, apart_y = _relative_translation(features, pair, system.pairs, system.motion.velocity)
    along = (geometry.normal_x * apart_x + geometry.normal_y * apart_y) * dt
    across = (geometry.normal_x * apart_y - geometry.normal_y * apart_x) * dt
    return 0.5 * across * across * geometry.curvature - along


@inline
def _bond_forces(
    features: Features, pair: int, moved: _Increment, overlap: Vector, pairs: Pairs, watch: Watch
) -> tuple[Vector, Vector, Vector]:
    """Return the forces of the parallel bond after one more increment; break it where its strength is exceeded.

    Forces and moment grow with the relative motion of the two disks, see `engine.scene.Cement`.
    """
    lanes = features.width
    intact = mask_of_bits(scalar(pairs.intact, (pair,)), lanes)
    force = pairs.bond_force
    old_normal = load(force, (row(pair, NORMAL),), lanes)
    old_shear, old_moment = load(force, (row(pair, SHEAR),), lanes), load(force, (row(pair, MOMENT),), lanes)
    normal = old_normal + moved.approach * constant(features, pairs.bond, (pair, NORMAL))
    shear = old_shear - moved.slide * constant(features, pairs.bond, (pair, SHEAR))
    moment = old_moment - moved.twist * constant(features, pairs.bond, (pair, MOMENT))
    if features.breakage:
        broken = bond_fails(
            normal,
            shear,
            moment,
            tension_limit=constant(features, pairs.strength, (pair, TENSION_LIMIT)),
            shear_limit=constant(features, pairs.strength, (pair, SHEAR_LIMIT)),
            friction_slope=constant(features, pairs.strength, (pair, FRICTION_SLOPE)),
            bending=constant(features, pairs.strength, (pair, BENDING)),
        )
        if features.account:
            bond = (old_normal * normal, old_shear * shear, old_moment * moment)
            _add_breakage_loss(features, pair, intact & broken, bond, (overlap, moved.approach), pairs, watch)
        intact = intact & ~broken
        pairs.intact[pair] = bits_of_mask(intact)
    normal = select(intact, normal, 0.0)
    shear = select(intact, shear, 0.0)
    moment = select(intact, moment, 0.0)
    store(force, (row(pair, NORMAL),), normal)
    store(force, (row(pair, SHEAR),), shear)
    store(force, (row(pair, MOMENT),), moment)
    return normal, shear, moment


@inline
def _add_breakage_loss(
    features: Features,
    pair: int,
    broken: Vector,
    bond: tuple[Vector, Vector, Vector],
    contact: tuple[Vector, Vector],
    pairs: Pairs,
    watch: Watch,
) -> None:
    """Add the energy of a breaking bond to the account, minus that of the sand's contact that replaces it.

    ``bond`` has the products of the forces before and after the increment, ``contact`` overlap and approach. The bond
    had ``F_old^2 / 2 k``. In the step in which it breaks its force falls from ``F_old`` to zero instead of rising to
    ``F_new``, so the disks do the work ``F_old (F_new - F_old) / 2 k``; the sum is ``F_old F_new / 2 k``. Likewise the
    force of the contact that replaces it rises from zero.
    """
    lost = bond[0] / constant(features, pairs.bond, (pair, NORMAL))
    lost = lost + bond[1] / constant(features, pairs.bond, (pair, SHEAR))
    lost = 0.5 * (lost + bond[2] / constant(features, pairs.bond, (pair, MOMENT)))
    if not features.linear_group:
        overlap, approach = contact
        normal, _ = hertz_normal(overlap, constant(features, pairs.hertz, (pair,)))
        lost = lost - (0.4 * overlap - 0.5 * approach) * normal
    add_energy(features, CONTACT_LOSS, select(broken, lost, 0.0), watch)


@inline
def push_apart(
    features: Features,
    pair: int,
    level: int,
    force: tuple[Vector, Vector, Vector, Vector],
    system: System,
) -> None:
    """Add the force of a pair, as `pair_force` returns it, to its two disks."""
    x, y, first_moment, second_moment = force
    pairs, front = system.pairs, system.front
    if features.bundled:
        _store_records(front, 0, (-x, -y, first_moment))
        _store_records(front, ABREAST, (x, y, second_moment))
        for lane in range(ABREAST):
            _add_record(front, level, scalar(pairs.first, (pair, lane)), lane)
            _add_record(front, level, scalar(pairs.second, (pair, lane)), ABREAST + lane)
    else:
        add_force(features, scalar(pairs.first, (pair,)), level, (-x, -y, first_moment), front)
        add_force(features, scalar(pairs.second, (pair,)), level, (x, y, second_moment), front)


@inline
def _store_records(front: Front, begin: int, columns: tuple[Vector, Vector, Vector]) -> None:
    """Write the forces of a bundle's pairs on their first or second disks as records."""
    a, b, c, d = columns_to_records(columns[0], columns[1], columns[2])
    place = RECORD * begin
    store_run(front.parts, place, a)
    store_run(front.parts, place + 2 * RECORD, b)
    store_run(front.parts, place + 4 * RECORD, c)
    store_run(front.parts, place + 6 * RECORD, d)


@inline
def _add_record(front: Front, level: int, begin: int, place: int) -> None:
    """Add one of those records to the sum of the forces on the disk whose records begin at ``begin``."""
    slot = ((level << front.slot_bits) * RECORD) + (begin & ((RECORD << front.slot_bits) - 1))
    store_run(front.force, slot, load_run(front.force, slot, RECORD) + load_run(front.parts, RECORD * place, RECORD))
