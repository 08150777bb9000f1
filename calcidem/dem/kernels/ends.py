"""How a pair reads its constants and its two disks, and adds forces to them, for many samples or for one.

For many samples a vector holds one pair of each sample. Constants are shared, and a disk is a row of lanes. For one
sample a vector holds `ABREAST` pairs, a *bundle* (see `layout.Pairs`). Then constants are vectors, and disks are
scattered records. Forces are added pair by pair in the order of the list, so sums have the same bits.
"""

from calcidem.dem.kernels.compiling import inline
from calcidem.dem.kernels.features import ABREAST, Features
from calcidem.dem.kernels.lanes import Vector, load, row, scalar
from calcidem.dem.kernels.layout import ROTATION, Front, Grains, Pairs, System, X, Y
from calcidem.dem.kernels.motion import add_force
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


@inline
def push_apart(
    features: Features,
    pair: int,
    level: int,
    force: tuple[Vector, Vector, Vector, Vector],
    system: System,
) -> None:
    """Add the force of a pair, as `pair.pair_force` returns it, to its two disks."""
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
