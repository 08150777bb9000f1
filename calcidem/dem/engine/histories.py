"""Contact histories: initial values, and transfer to a new neighbour list."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calcidem.dem.engine.assembly import Assembly, assemble, is_among, lanes_of_bits, overlap_roots, pair_keys
from calcidem.dem.engine.fields import require
from calcidem.dem.engine.portable import three_halves
from calcidem.dem.engine.scene import Preload, Scene
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.layout import NORMAL, OVERLAP, REFERENCE_OVERLAP, SHEAR, Floats, Integers


def listed_pairs(assembly: Assembly) -> Integers:
    """(M, 2) pairs of the list, in memory order."""
    return np.column_stack([assembly.pairs.first, assembly.pairs.second])


def install_forces(scene: Scene, assembly: Assembly, features: Features, preload: Preload | None) -> None:
    """Set the initial contact forces of a new assembly: preloaded shear, and the cement's share of the forces.

    In the linear regime forces are increments to the reference state. The preload moves nothing; it sets only how far
    each contact is from slipping.
    """
    pairs, wall_pairs = assembly.pairs, assembly.wall_pairs
    if preload is not None:
        pairs.shear[...] = _preload_of_pairs(scene, assembly, preload)[:, None]
    if features.linear:
        return
    if not features.finite:
        # Without contact search a gap stays a gap; it is listed only because cement fills it in some lane.
        gaps = pairs.geometry[:, OVERLAP] <= 0.0
        pairs.hertz[gaps] = pairs.mindlin[gaps] = 0.0
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
    first, last = (int(given.min()), int(given.max())) if given.size else (0, 0)
    inside = first >= 0 and last < scene.count
    require(inside, "preload.pairs", f"{first} to {last}", f"use indices 0 to {scene.count - 1}")
    # Swapping the ends reverses both n and the relative motion, so the value stays the same.
    keys = pair_keys(np.argsort(assembly.order)[given.astype(np.int64)], scene.count)
    listed = pair_keys(listed_pairs(assembly), scene.count)
    known = is_among(keys, listed)
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
    keys = [_wall_keys(assembly) for assembly in (fresh, old)]
    _hand_down(fresh.wall_pairs, old.wall_pairs, keys, ("shear", "root"))
    return fresh


def _hand_down(fresh: NamedTuple, old: NamedTuple, keys: list[npt.NDArray[np.int64]], names: tuple[str, ...]) -> None:
    """Copy the values of pairs in the old list to the new one, in place; both have increasing keys."""
    place = np.searchsorted(keys[1], keys[0])
    known = np.flatnonzero(np.append(keys[1], -1)[place] == keys[0])
    place = place[known]
    for name in names:
        getattr(fresh, name)[known] = getattr(old, name)[place]


def _wall_keys(assembly: Assembly) -> npt.NDArray[np.int64]:
    """(V,) key of each contact of disk and wall, increasing in list order."""
    disks, wall_pairs = len(assembly.order), assembly.wall_pairs
    pairs = np.column_stack([wall_pairs.disk, wall_pairs.wall + disks])
    return pair_keys(pairs, disks + len(assembly.walls.normal))
