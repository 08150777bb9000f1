"""Force between two disks, on lane vectors."""

from typing import NamedTuple

from calcidem.dem.kernels.compiling import inline
from calcidem.dem.kernels.features import Features
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
    Motion,
    Pairs,
    System,
    Watch,
    X,
    Y,
)
from calcidem.dem.kernels.motion import add_energy, add_force


class _Geometry(NamedTuple):
    """A contact at the present positions.

    Attributes
    ----------
    normal_x, normal_y
        Unit vector from the first to the second disk.
    overlap
        m; in the linear regime by how much the disks have moved apart.
    first_arm, second_arm
        From the centres to the contact, m.
    curvature
        Inverse of the distance of the centres, 1/m; zero where normals do not turn.
    inverse_root
        Inverse of `layout.Pairs.root`, m^-0.5, where that is in use.
    """

    normal_x: Vector
    normal_y: Vector
    overlap: Vector
    first_arm: Vector
    second_arm: Vector
    curvature: Vector
    inverse_root: Vector


class _Increment(NamedTuple):
    """Motion of the second disk relative to the first during the last step.

    Attributes
    ----------
    approach
        By how much the distance shrank, m.
    slide
        Along the tangent at the contact, m.
    twist
        Rotation, rad.
    """

    approach: Vector
    slide: Vector
    twist: Vector


@inline
def add_pair_forces(features: Features, begin: int, end: int, level: int, dt: Vector, system: System) -> None:
    """Add the forces of the pairs ``begin`` to ``end - 1`` to their disks."""
    if features.linear:
        for pair in range(begin, end):
            _add_linear_forces(features, pair, level, system)
    elif begin < end:
        # Roots and quotients make a pair wait for long; the next one's are begun before this one's forces are taken.
        geometry = _pair_geometry(features, begin, system)
        for pair in range(begin, end):
            following = _pair_geometry(features, min(pair + 1, end - 1), system)
            _add_general_forces(features, pair, geometry, level, dt, system)
            geometry = following


@inline
def _add_linear_forces(features: Features, pair: int, level: int, system: System) -> None:
    """Add the force of one pair of constant stiffness to its two disks."""
    pairs, front = system.pairs, system.front
    first, second = scalar(pairs.first, (pair,)), scalar(pairs.second, (pair,))
    geometry = _pair_geometry(features, pair, system)
    pull, drag, moment = _linear_law(features, first, second, pair, geometry, system.motion, pairs)
    along_x = pull * geometry.normal_x - drag * geometry.normal_y
    along_y = pull * geometry.normal_y + drag * geometry.normal_x
    add_force(features, first, X, level, along_x, front)
    add_force(features, first, Y, level, along_y, front)
    add_force(features, second, X, level, -along_x, front)
    add_force(features, second, Y, level, -along_y, front)
    if features.rotation and features.bonds:
        add_force(features, first, ROTATION, level, moment + drag * geometry.first_arm, front)
        add_force(features, second, ROTATION, level, drag * geometry.second_arm - moment, front)
    elif features.rotation:
        add_force(features, first, ROTATION, level, drag * geometry.first_arm, front)
        add_force(features, second, ROTATION, level, drag * geometry.second_arm, front)


@inline
def _add_general_forces(
    features: Features, pair: int, geometry: _Geometry, level: int, dt: Vector, system: System
) -> None:
    """Add the force of one pair to its two disks."""
    pairs, front = system.pairs, system.front
    first, second = scalar(pairs.first, (pair,)), scalar(pairs.second, (pair,))
    normal, shear, moment = _general_law(features, first, second, pair, dt, geometry, system)
    along_x = normal * geometry.normal_x - shear * geometry.normal_y
    along_y = normal * geometry.normal_y + shear * geometry.normal_x
    add_force(features, first, X, level, -along_x, front)
    add_force(features, first, Y, level, -along_y, front)
    add_force(features, second, X, level, along_x, front)
    add_force(features, second, Y, level, along_y, front)
    if features.rotation and features.bonds:
        add_force(features, first, ROTATION, level, -(moment + shear * geometry.first_arm), front)
        add_force(features, second, ROTATION, level, moment - shear * geometry.second_arm, front)
    elif features.rotation:
        add_force(features, first, ROTATION, level, -(shear * geometry.first_arm), front)
        add_force(features, second, ROTATION, level, -(shear * geometry.second_arm), front)


@inline
def _pair_geometry(features: Features, pair: int, system: System) -> _Geometry:
    """Return the contact of two disks at their present positions.

    The overlap is the reference overlap less the *change* of the distance, which keeps single precision
    accurate: overlaps are a ten-thousandth of a radius, and their changes far less. The contact lies in
    the middle of the overlap, so the arms add up to the distance and angular momentum is conserved.
    """
    table, radius = system.pairs.geometry, system.grains.radius
    first, second = scalar(system.pairs.first, (pair,)), scalar(system.pairs.second, (pair,))
    overlap = scalar(table, (pair, OVERLAP))
    apart_x, apart_y = _relative_translation(features, first, second, system.motion.displacement)
    if features.finite:
        distance_before = scalar(table, (pair, DISTANCE))
        before_x, before_y = scalar(table, (pair, APART_X)), scalar(table, (pair, APART_Y))
        x, y = apart_x + before_x, apart_y + before_y
        # By how much the distance grew, free of cancellation: ``longer (distance + before) = x^2 - before^2``.
        grown = (x + before_x) * apart_x + (y + before_y) * apart_y
        distance = square_root(x * x + y * y)
        both = distance + distance_before
        # One division, the slowest operation, makes three inverses.
        root = load(system.pairs.root, (pair,), features.lanes)
        distance_root = distance * root
        share = 1.0 / (both * distance_root)
        inverse = share * (both * root)
        depth = overlap - grown * (share * distance_root)
        first_arm = scalar(radius, (first,)) - 0.5 * depth
        second_arm = scalar(radius, (second,)) - 0.5 * depth
        return _Geometry(x * inverse, y * inverse, depth, first_arm, second_arm, inverse, share * (both * distance))
    normal_x = fill_lanes(scalar(table, (pair, NORMAL_X)), features.lanes)
    normal_y = fill_lanes(scalar(table, (pair, NORMAL_Y)), features.lanes)
    along = normal_x * apart_x + normal_y * apart_y
    first_arm = fill_lanes(scalar(table, (pair, FIRST_ARM)), features.lanes)
    second_arm = fill_lanes(scalar(table, (pair, SECOND_ARM)), features.lanes)
    flat = zero_like(along)
    if features.linear:
        return _Geometry(normal_x, normal_y, along, first_arm, second_arm, flat, flat)
    inverse_root = 1.0 / load(system.pairs.root, (pair,), features.lanes) if features.rescaling else flat
    return _Geometry(normal_x, normal_y, overlap - along, first_arm, second_arm, flat, inverse_root)


@inline
def _relative_translation(features: Features, first: int, second: int, field: Vector) -> tuple[Vector, Vector]:
    """Components of the second disk's translation less the first's."""
    lanes = features.lanes
    return (
        load(field, (row(second, X),), lanes) - load(field, (row(first, X),), lanes),
        load(field, (row(second, Y),), lanes) - load(field, (row(first, Y),), lanes),
    )


@inline
def _slide_and_twist(
    features: Features, first: int, second: int, geometry: _Geometry, field: Vector
) -> tuple[Vector, Vector]:
    """Tangential displacement (or velocity) at the contact and relative rotation, second less first."""
    lanes = features.lanes
    apart_x, apart_y = _relative_translation(features, first, second, field)
    slide = geometry.normal_x * apart_y - geometry.normal_y * apart_x
    if features.rotation:
        first_turn = load(field, (row(first, ROTATION),), lanes)
        second_turn = load(field, (row(second, ROTATION),), lanes)
        slide = slide - geometry.first_arm * first_turn - geometry.second_arm * second_turn
        return slide, second_turn - first_turn
    return slide, zero_like(slide)


@inline
def _linear_law(
    features: Features, first: int, second: int, pair: int, geometry: _Geometry, motion: Motion, pairs: Pairs
) -> tuple[Vector, Vector, Vector]:
    """Return tension, shear force and moment that constant stiffnesses add to the reference state.

    Unlike those of the other laws they are the ones on the first disk, which saves three changes of sign.
    """
    lanes = features.lanes
    slide, twist = _slide_and_twist(features, first, second, geometry, motion.displacement)
    apart = geometry.overlap
    sand_normal, sand_shear = scalar(pairs.tangent, (pair, NORMAL)), scalar(pairs.tangent, (pair, SHEAR))
    if features.bonds:
        intact = mask_of_bits(scalar(pairs.intact, (pair,)), lanes)
        cement_normal, cement_shear = scalar(pairs.bond, (pair, NORMAL)), scalar(pairs.bond, (pair, SHEAR))
        if features.linear_group:
            cement_normal = cement_normal + scalar(pairs.linear, (pair, NORMAL))
            cement_shear = cement_shear + scalar(pairs.linear, (pair, SHEAR))
        normal = select(intact, fill_lanes(cement_normal, lanes), sand_normal)
        shear = select(intact, fill_lanes(cement_shear, lanes), sand_shear)
        bending = select(intact, fill_lanes(scalar(pairs.bond, (pair, MOMENT)), lanes), 0.0)
        return normal * apart, shear * slide, bending * twist
    return apart * sand_normal, slide * sand_shear, zero_like(slide)


@inline
def _general_law(
    features: Features, first: int, second: int, pair: int, dt: Vector, geometry: _Geometry, system: System
) -> tuple[Vector, Vector, Vector]:
    """Return normal force, shear force and moment from overlap, histories and the increments of the last step."""
    pairs, motion, watch = system.pairs, system.motion, system.watch
    speed, spin = _slide_and_twist(features, first, second, geometry, motion.velocity)
    slide = speed * dt
    if not features.bonds:
        normal, shear = _frictional_law(features, pair, geometry, slide, pairs, watch)
        return normal, shear, zero_like(slide)
    approach = _relative_approach(features, first, second, geometry, dt, motion)
    moved = _Increment(approach, slide, spin * dt)
    normal, shear, moment = _bond_forces(features, pair, moved, geometry.overlap, pairs, watch)
    if features.linear_group or scalar(pairs.intact, (pair,)) != (1 << features.lanes) - 1:
        # Where all lanes are cemented, and the cement has no part with friction, there is nothing to add.
        friction = _frictional_law(features, pair, geometry, slide, pairs, watch)
        normal, shear = normal + friction[0], shear + friction[1]
    return normal, shear, moment


@inline
def _frictional_law(
    features: Features, pair: int, geometry: _Geometry, slide: Vector, pairs: Pairs, watch: Watch
) -> tuple[Vector, Vector]:
    """Return normal and shear force of the part with friction: the sand's contact, or the cement's linear group.

    Without a linear group an intact bond takes the place of the sand's contact; a broken one gives it back.
    """
    lanes, overlap = features.lanes, geometry.overlap
    normal, root = hertz_normal(overlap, scalar(pairs.hertz, (pair,)))
    stiffness = root * scalar(pairs.mindlin, (pair,))
    touching = overlap > 0.0
    old = load(pairs.shear, (pair,), lanes)
    carried = old
    if features.rescaling:
        carried = rescale_shear(old, root, load(pairs.root, (pair,), lanes), geometry.inverse_root)
    if features.linear_group:
        cemented = mask_of_bits(scalar(pairs.cemented, (pair,)), lanes)
        depth = overlap - scalar(pairs.linear, (pair, REFERENCE_OVERLAP))
        pressed = select(depth > 0.0, depth, 0.0)
        normal = select(cemented, pressed * scalar(pairs.linear, (pair, NORMAL)), normal)
        stiffness = select(cemented, fill_lanes(scalar(pairs.linear, (pair, SHEAR)), lanes), stiffness)
        carried = select(cemented, old, carried)
        touching = normal > 0.0
    shear = select(touching, mindlin_shear(carried, slide, stiffness), 0.0)
    if features.slip:
        shear = coulomb_limit(shear, normal * scalar(pairs.friction, (pair,)))
    elif scalar(pairs.friction, (pair,)) <= 0.0:
        shear = zero_like(shear)
    if features.bonds and not features.linear_group:
        intact = mask_of_bits(scalar(pairs.intact, (pair,)), lanes)
        normal = select(intact, 0.0, normal)
        shear = select(intact, 0.0, shear)
    store(pairs.shear, (pair,), shear)
    if features.account:
        before = scalar(pairs.mindlin, (pair,)) * load(pairs.root, (pair,), lanes)
        if features.linear_group:
            before = select(mask_of_bits(scalar(pairs.cemented, (pair,)), lanes), stiffness, before)
        add_shear_loss(features, old, shear, before, stiffness, slide, watch)
    if features.rescaling or features.account:
        store(pairs.root, (pair,), larger(root, SMALLEST_ROOT))
    return normal, shear


@inline
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
    add_energy(features, CONTACT_LOSS, held - stored - 0.5 * (old + new) * slide, watch)


@inline
def _relative_approach(
    features: Features, first: int, second: int, geometry: _Geometry, dt: Vector, motion: Motion
) -> Vector:
    """Return by how much the distance of two disks shrank during the last step, m.

    The normal belongs to the end of the step. ``across^2 / (2 distance)`` corrects for its turning: without it a bonded
    pair that only rotates would stretch its bond a little in every step.
    """
    apart_x, apart_y = _relative_translation(features, first, second, motion.velocity)
    along = (geometry.normal_x * apart_x + geometry.normal_y * apart_y) * dt
    if features.finite:
        across = (geometry.normal_x * apart_y - geometry.normal_y * apart_x) * dt
        return 0.5 * across * across * geometry.curvature - along
    return -along


@inline
def _bond_forces(
    features: Features, pair: int, moved: _Increment, overlap: Vector, pairs: Pairs, watch: Watch
) -> tuple[Vector, Vector, Vector]:
    """Return the forces of the parallel bond after one more increment; break it where it is too weak.

    Forces and moment grow with the relative motion of the two disks, see `material.Cement.bond_stiffness`.
    """
    lanes = features.lanes
    intact = mask_of_bits(scalar(pairs.intact, (pair,)), lanes)
    force = pairs.bond_force
    normal = load(force, (row(pair, NORMAL),), lanes) + moved.approach * scalar(pairs.bond, (pair, NORMAL))
    shear = load(force, (row(pair, SHEAR),), lanes) - moved.slide * scalar(pairs.bond, (pair, SHEAR))
    moment = load(force, (row(pair, MOMENT),), lanes) - moved.twist * scalar(pairs.bond, (pair, MOMENT))
    if features.breakage:
        broken = bond_fails(
            normal,
            shear,
            moment,
            tension_limit=scalar(pairs.strength, (pair, TENSION_LIMIT)),
            shear_limit=scalar(pairs.strength, (pair, SHEAR_LIMIT)),
            friction_slope=scalar(pairs.strength, (pair, FRICTION_SLOPE)),
            bending=scalar(pairs.strength, (pair, BENDING)),
        )
        if features.account:
            _add_breakage_loss(features, pair, intact & broken, (normal, shear, moment), overlap, pairs, watch)
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
    overlap: Vector,
    pairs: Pairs,
    watch: Watch,
) -> None:
    """Add the energy of a breaking bond to the account, less that of the sand's contact which takes over."""
    lost = bond[0] * bond[0] / scalar(pairs.bond, (pair, NORMAL))
    lost = lost + bond[1] * bond[1] / scalar(pairs.bond, (pair, SHEAR))
    lost = 0.5 * (lost + bond[2] * bond[2] / scalar(pairs.bond, (pair, MOMENT)))
    if not features.linear_group:
        normal, _ = hertz_normal(overlap, scalar(pairs.hertz, (pair,)))
        lost = lost - 0.4 * normal * overlap
    add_energy(features, CONTACT_LOSS, select(broken, lost, 0.0), watch)
