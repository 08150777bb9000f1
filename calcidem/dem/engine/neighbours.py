"""Lists of neighbours: renewing them while disks move, without losing what the contacts remember."""

from dataclasses import replace

import numpy as np

from calcidem.dem.engine.assembly import Assembly, assemble, pair_keys
from calcidem.dem.engine.scene import Scene
from calcidem.dem.kernels.layout import Floats, Integers


def listed_pairs(assembly: Assembly) -> Integers:
    """(M, 2) pairs of the list, in memory order."""
    pairs = assembly.pairs
    first = np.repeat(np.arange(len(pairs.start) - 1), np.diff(pairs.start))
    return np.column_stack([first, pairs.second])


def renewed(scene: Scene, old: Assembly, displacement: Floats, skin: float) -> Assembly:
    """Assembly with the neighbours of the present places; histories of pairs that stay are kept.

    Parameters
    ----------
    scene
        What is moving.
    old
        Its assembly so far.
    displacement
        (N, 2, L) m, in memory order.
    skin
        Pairs whose rims are closer than this are listed, m.
    """
    lanes = displacement.shape[2]
    centres = np.empty((scene.count, 2, lanes))
    centres[old.order] = displacement
    centres += np.column_stack([scene.x, scene.y])[:, :, None]
    fresh = assemble(scene, centres, skin, lanes, displacement.dtype, old.walls.motion[:, 0].astype(float))
    new_keys, old_keys = (pair_keys(listed_pairs(assembly), scene.count) for assembly in (fresh, old))
    _, new_place, old_place = np.intersect1d(new_keys, old_keys, assume_unique=True, return_indices=True)
    for name in ("intact", "linear", "shear", "inverse_root", "bond_force"):
        getattr(fresh.pairs, name)[new_place] = getattr(old.pairs, name)[old_place]
    new_walls, old_walls = (wall_keys(assembly) for assembly in (fresh, old))
    _, new_place, old_place = np.intersect1d(new_walls, old_walls, assume_unique=True, return_indices=True)
    for name in ("shear", "inverse_root"):
        getattr(fresh.wall_pairs, name)[new_place] = getattr(old.wall_pairs, name)[old_place]
    return replace(fresh, walls=old.walls)


def wall_keys(assembly: Assembly) -> Integers:
    """(V,) one number for each pair of disk and wall, increasing in the order of the list."""
    disk = np.repeat(np.arange(len(assembly.wall_pairs.start) - 1), np.diff(assembly.wall_pairs.start))
    return disk * max(1, len(assembly.walls.normal)) + assembly.wall_pairs.wall
