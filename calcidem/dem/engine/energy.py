"""Energy stored in contacts."""

import numpy as np

from calcidem.dem.engine.assembly import Assembly, lanes_of_bits
from calcidem.dem.engine.scene import Scene
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.layout import MOMENT, NORMAL, REFERENCE_OVERLAP, SHEAR, Floats


def stored_energy(
    scene: Scene, assembly: Assembly, features: Features, overlap: Floats, wall_overlap: Floats
) -> Floats:
    """Energy (L,) of all contacts, J/m: Hertz 2/5 F_n d, shear F_s^2 / (2 k_s), springs of linear groups and bonds.

    Parameters
    ----------
    scene, features
        Scene and its features.
    assembly
        Assembly with the histories at the present position.
    overlap, wall_overlap
        (M, L) and (V, L) of its pairs, m.
    """
    pairs, wall_pairs, ratio = assembly.pairs, assembly.wall_pairs, scene.sand.shear_ratio
    normal, stiffness = _hertz_energy(pairs.hertz, overlap, ratio)
    if features.bonds:
        if features.linear_group:
            cemented = lanes_of_bits(pairs.cemented, features.lanes)
            linear = pairs.linear.astype(float)[:, :, None]
            pressed = np.maximum(overlap - linear[:, REFERENCE_OVERLAP], 0.0)
            normal = np.where(cemented, 0.5 * linear[:, NORMAL] * pressed * pressed, normal)
            stiffness = np.where(cemented, linear[:, SHEAR], stiffness)
        else:
            normal = np.where(lanes_of_bits(pairs.intact, features.lanes), 0.0, normal)
    total = normal.sum(axis=0) + _spring_energy(pairs.shear, stiffness)
    normal, stiffness = _hertz_energy(wall_pairs.hertz, wall_overlap, ratio)
    total = total + normal.sum(axis=0) + _spring_energy(wall_pairs.shear, stiffness)
    if features.bonds:
        for kind in (NORMAL, SHEAR, MOMENT):
            total = total + _spring_energy(pairs.bond_force[:, kind], pairs.bond[:, kind, None].astype(float))
    return np.asarray(total)


def _hertz_energy(coefficient: Floats, overlap: Floats, shear_ratio: float) -> tuple[Floats, Floats]:
    """Energy 2/5 F_n d of Hertz contacts and their shear stiffness."""
    hertz, pressed = coefficient.astype(float)[:, None], np.maximum(overlap, 0.0)
    root = np.sqrt(pressed)
    return 0.4 * hertz * pressed * pressed * root, 1.5 * hertz * shear_ratio * root


def _spring_energy(force: Floats, stiffness: Floats) -> Floats:
    """Sum of F^2 / (2 k) over springs (M, L); springs without stiffness carry nothing."""
    safe = np.where(stiffness > 0.0, stiffness, 1.0)
    return np.asarray(np.where(stiffness > 0.0, force.astype(float) ** 2 / (2.0 * safe), 0.0).sum(axis=0))
