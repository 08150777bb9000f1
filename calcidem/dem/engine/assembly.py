"""Builds the kernel's arrays from a scene: order, neighbours, stiffnesses, contact histories; and renews them."""

from dataclasses import dataclass
from math import prod
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from calcidem.dem.engine.fields import require
from calcidem.dem.engine.portable import length, three_halves
from calcidem.dem.engine.scene import Preload, Scene
from calcidem.dem.kernels.laws import SMALLEST_ROOT
from calcidem.dem.kernels.layout import (
    NORMAL,
    NORMAL_PATH,
    OVERLAP,
    REFERENCE_OVERLAP,
    SHEAR,
    SPEEDS,
    Features,
    Flags,
    Floats,
    Grains,
    Integers,
    Pairs,
    WallPairs,
    Walls,
)


@dataclass(frozen=True, slots=True)
class Assembly:
    """Arrays shared by all lanes, and the histories of the contacts."""

    order: Integers
    """(N,) the scene's disks in memory order: sorted along the longer side, which keeps neighbours close in memory."""
    grains: Grains
    pairs: Pairs
    wall_pairs: WallPairs
    walls: Walls
    """See `layout`. Here, outside the kernel, the bond forces are (M, 3, L)."""


def aligned_zeros(shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Array of zeros that starts on a cache line, so that no lane vector straddles two."""
    size = prod(shape) * np.dtype(dtype).itemsize
    line = 64  # bytes of a cache line, and of an AVX-512 vector
    raw = np.zeros(size + line, dtype=np.uint8)
    start = -raw.ctypes.data % line
    return raw[start : start + size].view(dtype).reshape(shape)


def aligned_copy(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Copy that starts on a cache line."""
    copy = aligned_zeros(array.shape, array.dtype)
    copy[...] = array
    return copy


def near_pairs(centres: Floats, radius: Floats, skin: float) -> Integers:
    """Pairs of disks whose rims are less than ``skin`` apart: (M, 2), sorted, first < second.

    ``centres`` are (N, 2), or (N, 2, K) for pairs that are near in any of K samples.
    """
    samples = centres.reshape(len(centres), 2, -1)
    middle = samples.mean(axis=2)
    aside = samples - middle[:, :, None]
    largest, apart = float(radius.max()), float(length(aside[:, 0], aside[:, 1]).max())
    if apart > largest:  # a single tree would find too many pairs
        return np.unique(np.concatenate([near_pairs(one, radius, skin) for one in np.moveaxis(samples, 2, 0)]), axis=0)
    # The tree searches slightly too far; the exact test follows.
    reach = (2.0 * (largest + apart) + skin) * (1.0 + 1e-9)
    found = cKDTree(middle).query_pairs(reach, output_type="ndarray")
    between = samples[found[:, 0]] - samples[found[:, 1]]
    gap = length(between[:, 0], between[:, 1]) - (radius[found[:, 0]] + radius[found[:, 1]])[:, None]
    keys = np.sort(pair_keys(found[(gap < skin).any(axis=1)], len(centres)))
    return np.column_stack(np.divmod(keys, len(centres)))


def pair_keys(pairs: Integers, count: int) -> npt.NDArray[np.int64]:
    """(M,) keys of pairs (M, 2) of ``count`` items. The order of the two ends does not matter; keys sort like pairs."""
    ends = pairs[:, 0].astype(np.int64), pairs[:, 1].astype(np.int64)
    keys: npt.NDArray[np.int64] = np.minimum(*ends) * count + np.maximum(*ends)
    return keys


def lanes_of_bits(bits: Integers, lanes: int) -> Flags:
    """(M, L) flags from words (M,) whose bit l is lane l."""
    return ((bits[:, None] >> np.arange(lanes, dtype=np.uint32)) & 1).astype(bool)


def assemble(
    scene: Scene, centres: Floats, skin: float, lanes: int, dtype: npt.DTypeLike, old: Assembly | None = None
) -> Assembly:
    """Arrays of the kernel for a scene; `ValueError` if two disks have the same centre.

    Parameters
    ----------
    scene
        Scene to assemble.
    centres
        (N, 2, K) present centres of the disks in one or more samples, m, for the neighbour search.
    skin
        Pairs whose rims are closer than this in any sample are listed, m.
    lanes, dtype
        Number of lanes and precision.
    old
        Previous assembly. Its disks and moved walls are kept; without it the walls start at their scene positions.

    Returns
    -------
    Arrays with zero histories.
    """
    x, y = np.asarray(scene.x), np.asarray(scene.y)
    longer = (x, y) if np.ptp(y) >= np.ptp(x) else (y, x)  # the last one sorts first
    order: Integers = np.lexsort(longer) if old is None else old.order
    radius = np.asarray(scene.radius, dtype=float)[order]
    reference = np.column_stack([scene.x, scene.y])[order]
    cemented = np.zeros(0, dtype=np.int64)
    if scene.bonds is not None and len(scene.bonds.pairs):
        cemented = pair_keys(np.argsort(order)[np.asarray(scene.bonds.pairs)], scene.count)
    # A sample that has blown up must not disturb the others, so its neighbours are not listed. 1e100 m are far beyond
    # any scene, yet their square does not overflow.
    samples = np.flatnonzero((np.abs(centres) < 1e100).all(axis=(0, 1)))
    present = centres[order][:, :, samples]
    near = near_pairs(present, radius, skin) if len(samples) else np.zeros((0, 2), dtype=np.int64)
    listed = pair_keys(near, scene.count)
    across = cemented[~np.isin(cemented, listed)]  # cement that spans a gap
    if len(across):
        listed = np.unique(np.concatenate([listed, across]))
    walls = _assemble_walls(scene, lanes, dtype) if old is None else old.walls
    moved = walls.motion[:, NORMAL_PATH].astype(float)[:, samples]
    facing = _near_walls(scene, reference, present, radius + skin, moved)
    return Assembly(
        order=order,
        grains=_assemble_grains(scene, order, dtype) if old is None else old.grains,
        pairs=_assemble_pairs(scene, reference, radius, listed, cemented, lanes, dtype),
        wall_pairs=_assemble_wall_pairs(scene, reference, radius, facing, lanes, dtype),
        walls=walls,
    )


def _assemble_grains(scene: Scene, order: Integers, dtype: npt.DTypeLike) -> Grains:
    """Properties of the disks in memory order."""
    free = np.ones(scene.count) if scene.held is None else 1.0 - np.asarray(scene.held, dtype=float)

    def sorted_copy(values: npt.ArrayLike) -> npt.NDArray[Any]:
        return aligned_copy(np.asarray(values)[order].astype(dtype))

    return Grains(
        radius=sorted_copy(scene.radius),
        inverse_mass=sorted_copy(free / scene.mass),
        inverse_inertia=sorted_copy(free / scene.inertia),
        damping=sorted_copy(scene.per_disk(scene.damping)),
        friction=sorted_copy(scene.per_disk(scene.sand.friction)),
        load=sorted_copy(scene.total_load),
        shear_ratio=scene.sand.shear_ratio,
    )


def _assemble_pairs(
    scene: Scene,
    reference: Floats,
    radius: Floats,
    listed: Integers,
    cemented: Integers,
    lanes: int,
    dtype: npt.DTypeLike,
) -> Pairs:
    """Pairs of disks with the constants of their contact laws.

    All arrays are in memory order. ``listed`` (M,) holds the sorted keys of the pairs. ``cemented`` (B,) holds the keys
    of the scene's bonds.
    """
    count = len(listed)
    first, second = np.divmod(listed, scene.count)
    apart = reference[second] - reference[first]
    distance = length(apart[:, 0], apart[:, 1])
    require(bool(np.all(distance > 0.0)), "x, y", "two disks with one centre", "give every disk its own position")
    overlap = radius[first] + radius[second] - distance
    arms = radius[np.column_stack([first, second])] - 0.5 * overlap[:, None]
    hertz = scene.sand.hertz_coefficient(radius[first], radius[second])
    tangent = 1.5 * hertz * np.sqrt(np.maximum(overlap, 0.0))
    shear = scene.sand.shear_ratio * tangent if scene.sand.friction > 0.0 else 0.0 * tangent
    bare = Pairs(
        start=np.searchsorted(first, np.arange(scene.count + 1)).astype(np.int64),
        first=aligned_copy(first.astype(np.int32)),
        second=aligned_copy(second.astype(np.int32)),
        geometry=aligned_copy(
            np.column_stack([apart / distance[:, None], distance, overlap, apart, arms]).astype(dtype)
        ),
        hertz=aligned_copy(hertz.astype(dtype)),
        mindlin=aligned_copy((1.5 * scene.sand.shear_ratio * hertz).astype(dtype)),
        tangent=aligned_copy(np.column_stack([tangent, shear]).astype(dtype)),
        friction=aligned_copy(np.full(count, scene.sand.friction, dtype=dtype)),
        bond=aligned_zeros((count, 3), dtype),
        linear=aligned_zeros((count, 3), dtype),
        strength=aligned_zeros((count, 4), dtype),
        cemented=np.zeros(count, dtype=np.uint32),
        intact=np.zeros(count, dtype=np.uint32),
        shear=aligned_zeros((count, lanes), dtype),
        root=overlap_roots(np.zeros(count), lanes, dtype),
        bond_force=aligned_zeros((count, 3, lanes), dtype),
        radii=np.zeros((0, 2, 0), dtype),
    )
    return _cement_pairs(bare, scene, radius, np.searchsorted(listed, cemented), lanes)


def _cement_pairs(bare: Pairs, scene: Scene, radius: Floats, places: Integers, lanes: int) -> Pairs:
    """Pairs with the scene's bonds, each at its place (B,) in the list; ``radius`` (N,) is in memory order."""
    if scene.bonds is None:
        return bare
    dtype, ends = bare.hertz.dtype, (radius[bare.first], radius[bare.second])
    bits = np.zeros(len(bare.first), dtype=np.uint32)
    # A pair listed twice is cemented in the lanes of both entries.
    np.bitwise_or.at(bits, places, scene.bonds.bits)
    bits &= np.uint32(2**lanes - 1)
    linear = np.zeros((len(bits), 3))
    linear[:, :REFERENCE_OVERLAP] = scene.bonds.cement.linear_stiffness(*ends)
    bond_radius, tensile_strength, cohesion, slope = scene.bonds.cement.strength(*ends).T
    area = 2.0 * bond_radius
    strength = np.column_stack([tensile_strength * area, cohesion * area, slope, 3.0 / bond_radius])
    return bare._replace(
        bond=aligned_copy(scene.bonds.cement.bond_stiffness(*ends).astype(dtype)),
        linear=aligned_copy(linear.astype(dtype)),
        strength=aligned_copy(strength.astype(dtype)),
        cemented=bits,
        intact=bits.copy(),
    )


def share_assembly(single: Assembly, scene: Scene, lanes: int) -> Assembly | None:
    """Assembly of samples of one scene, from its one-lane assembly without bonds and loads.

    All lanes inherit its shear forces. None if cement spans a gap that is not listed.
    """
    pairs, wall_pairs, dtype = single.pairs, single.wall_pairs, single.pairs.hertz.dtype
    places = np.zeros(0, dtype=np.int64)
    if scene.bonds is not None:
        cemented = pair_keys(np.argsort(single.order)[np.asarray(scene.bonds.pairs)], scene.count)
        listed = pair_keys(listed_pairs(single), scene.count)
        places = np.searchsorted(listed, cemented)
        if not np.array_equal(np.append(listed, -1)[places], cemented):
            return None
    spread = pairs._replace(
        shear=aligned_copy(np.repeat(pairs.shear, lanes, axis=1)),
        root=aligned_copy(np.repeat(pairs.root, lanes, axis=1)),
        bond_force=aligned_zeros((len(pairs.first), 3, lanes), dtype),
    )
    radius = np.asarray(scene.radius, dtype=float)[single.order]
    return Assembly(
        order=single.order,
        grains=single.grains._replace(load=aligned_copy(scene.total_load[single.order].astype(dtype))),
        pairs=_cement_pairs(spread, scene, radius, places, lanes),
        wall_pairs=wall_pairs._replace(
            shear=aligned_zeros((len(wall_pairs.disk), lanes), dtype),
            root=aligned_copy(np.repeat(wall_pairs.root, lanes, axis=1)),
        ),
        walls=_assemble_walls(scene, lanes, dtype),
    )


def overlap_roots(overlap: Floats, lanes: int, dtype: npt.DTypeLike) -> Floats:
    """(M, L) square roots of overlaps (M,), the same in all lanes."""
    values = np.maximum(np.sqrt(np.maximum(overlap, 0.0)), SMALLEST_ROOT)
    return aligned_copy(np.repeat(values[:, None], lanes, axis=1).astype(dtype))


def _near_walls(scene: Scene, reference: Floats, centres: Floats, reach: Floats, moved: Floats) -> Integers:
    """Disks nearer to a wall than their ``reach`` (N,), in any sample of ``centres`` (N, 2, K): (V, 2) disk and wall.

    Where several walls form one side, a disk's reference position decides which of them it faces.
    """
    found = [np.zeros((0, 2), dtype=np.int64)]
    for index, wall in enumerate(scene.walls):
        along = wall.along(reference[:, 0], reference[:, 1])
        facing = np.flatnonzero((along >= wall.span[0]) & (along < wall.span[1]))
        gap = wall.distance(centres[facing, 0], centres[facing, 1]) - moved[index]
        disks = facing[(gap < reach[facing, None]).any(axis=1)]
        found.append(np.column_stack([disks, np.full(len(disks), index)]))
    both = np.concatenate(found)
    return both[np.lexsort((both[:, 1], both[:, 0]))]


def _assemble_wall_pairs(
    scene: Scene, reference: Floats, radius: Floats, facing: Integers, lanes: int, dtype: npt.DTypeLike
) -> WallPairs:
    """Contacts of disks with walls; ``facing`` lists disk and wall."""
    disk, wall_index = facing[:, 0], facing[:, 1]
    distance = np.zeros(len(disk))
    for index, wall in enumerate(scene.walls):
        chosen = wall_index == index
        distance[chosen] = wall.distance(*reference[disk[chosen]].T)
    overlap = radius[disk] - distance
    hertz = scene.sand.hertz_coefficient(radius[disk])
    tangent = 1.5 * hertz * np.sqrt(np.maximum(overlap, 0.0))
    friction = np.array([wall.friction for wall in scene.walls])[wall_index]
    shear = np.where(np.minimum(friction, scene.sand.friction) > 0.0, scene.sand.shear_ratio * tangent, 0.0)
    return WallPairs(
        start=np.searchsorted(disk, np.arange(scene.count + 1)).astype(np.int64),
        disk=aligned_copy(disk.astype(np.int32)),
        wall=aligned_copy(wall_index.astype(np.int32)),
        overlap=aligned_copy(overlap.astype(dtype)),
        hertz=aligned_copy(hertz.astype(dtype)),
        tangent=aligned_copy(np.column_stack([tangent, shear]).astype(dtype)),
        shear=aligned_zeros((len(disk), lanes), dtype),
        root=overlap_roots(np.zeros(len(disk)), lanes, dtype),
    )


def _assemble_walls(scene: Scene, lanes: int, dtype: npt.DTypeLike) -> Walls:
    """Walls at their reference positions."""
    count = len(scene.walls)
    motion = aligned_zeros((count, 4, lanes), dtype)
    servo = np.zeros((count, 3))
    for index, wall in enumerate(scene.walls):
        motion[index, SPEEDS] = np.reshape(wall.velocity, (2, 1))
        if wall.servo_force is not None:
            servo[index] = wall.servo_gain, wall.servo_force, wall.servo_speed
    return Walls(
        normal=aligned_copy(np.array([wall.normal for wall in scene.walls], dtype=dtype).reshape(count, 2)),
        friction=aligned_copy(np.array([wall.friction for wall in scene.walls], dtype=dtype)),
        motion=motion,
        reaction=aligned_zeros((count, 3, lanes), dtype),
        servo=aligned_copy(servo.astype(dtype)),
    )


def listed_pairs(assembly: Assembly) -> Integers:
    """(M, 2) pairs of the list, in memory order."""
    return np.column_stack([assembly.pairs.first, assembly.pairs.second])


def install_forces(scene: Scene, assembly: Assembly, features: Features, preload: Preload | None) -> None:
    """Set the initial contact forces of a new assembly: preloaded shear, and the cement's share of the forces.

    With the linear law forces are increments to the reference state. The preload moves nothing; it sets only how far
    each contact is from slipping.
    """
    pairs, wall_pairs = assembly.pairs, assembly.wall_pairs
    if preload is not None:
        pairs.shear[...] = _preload_of_pairs(scene, assembly, preload)[:, None]
    if features.linear:
        return
    pairs.root[...] = overlap_roots(pairs.geometry[:, OVERLAP], features.lanes, pairs.shear.dtype)
    wall_pairs.root[...] = overlap_roots(wall_pairs.overlap, features.lanes, wall_pairs.shear.dtype)
    if scene.bonds is None:
        return
    overlap = pairs.geometry[:, OVERLAP]
    cemented = lanes_of_bits(pairs.cemented, features.lanes)
    carried = pairs.hertz * three_halves(np.maximum(overlap, 0.0))
    if scene.bonds.installation != "preserve":
        pairs.shear[cemented] = 0.0
        pairs.linear[:, REFERENCE_OVERLAP] = overlap if scene.bonds.installation == "zero" else 0.0
    elif features.linear_group:
        # The linear group takes the normal force through its reference overlap and keeps the shear force.
        pairs.linear[:, REFERENCE_OVERLAP] = overlap - carried / pairs.linear[:, NORMAL]
    else:
        pairs.bond_force[:, NORMAL] = np.where(cemented, carried[:, None], 0.0)
        pairs.bond_force[:, SHEAR] = np.where(cemented, pairs.shear, 0.0)
        pairs.shear[cemented] = 0.0


def _preload_of_pairs(scene: Scene, assembly: Assembly, preload: Preload) -> Floats:
    """(M,) preloaded shear force of every listed pair; zero without preload."""
    given, forces = np.asarray(preload.pairs), np.asarray(preload.shear)
    wanted = f"give shape ({len(forces)}, 2), as many as forces"
    require(given.shape == (len(forces), 2), "preload.pairs", given.shape, wanted)
    require(bool(np.all(np.isfinite(forces))), "preload.shear", "NaN or infinite", "give finite forces")
    first, last = (int(given.min()), int(given.max())) if given.size else (0, 0)
    inside = first >= 0 and last < scene.count
    require(inside, "preload.pairs", f"{first} to {last}", f"use indices 0 to {scene.count - 1}")
    # Swapping the ends reverses both n and the relative motion, so the value stays the same.
    keys = pair_keys(np.argsort(assembly.order)[given.astype(np.int64)], scene.count)
    listed = pair_keys(listed_pairs(assembly), scene.count)
    known = np.isin(keys, listed)
    shear = np.zeros(len(listed))
    shear[np.searchsorted(listed, keys[known])] = forces[known]
    return shear


def renew_assembly(scene: Scene, old: Assembly, displacement: Floats, skin: float) -> Assembly:
    """Assembly with the neighbours at the present positions; pairs that stay keep their histories.

    Parameters
    ----------
    scene
        Moving scene.
    old
        Its previous assembly.
    displacement
        (N, 2, L) m, in memory order.
    skin
        Pairs whose rims are closer than this are listed, m.
    """
    lanes = displacement.shape[2]
    centres = np.empty((scene.count, 2, lanes))
    centres[old.order] = displacement
    centres += np.column_stack([scene.x, scene.y])[:, :, None]
    fresh = assemble(scene, centres, skin, lanes, displacement.dtype, old)
    keys = [pair_keys(listed_pairs(assembly), scene.count) for assembly in (fresh, old)]
    of_cement = () if scene.bonds is None else ("intact", "linear", "bond_force")
    _hand_down(fresh.pairs, old.pairs, keys, ("shear", "root", *of_cement))
    keys = [
        pair_keys(np.column_stack([pairs.disk, pairs.wall + scene.count]), scene.count + len(scene.walls))
        for pairs in (fresh.wall_pairs, old.wall_pairs)
    ]
    _hand_down(fresh.wall_pairs, old.wall_pairs, keys, ("shear", "root"))
    return fresh


def _hand_down(fresh: NamedTuple, old: NamedTuple, keys: list[npt.NDArray[np.int64]], names: tuple[str, ...]) -> None:
    """Copy the values of pairs in the old list to the new one, in place; both have increasing keys."""
    place = np.searchsorted(keys[1], keys[0])
    known = np.flatnonzero(np.append(keys[1], -1)[place] == keys[0])
    place = place[known]
    for name in names:
        getattr(fresh, name)[known] = getattr(old, name)[place]
