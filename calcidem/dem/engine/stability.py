"""Largest stable time step of the explicit scheme."""

import numpy as np

from calcidem.dem.engine.assembly import Assembly
from calcidem.dem.engine.scene import Scene
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.layout import Floats, Integers


def critical_time_step(
    scene: Scene,
    assembly: Assembly,
    features: Features,
    overlap: Floats | None = None,
    wall_overlap: Floats | None = None,
) -> Floats:
    """Rigorous lower bound of the critical time step, (L,) s.

    ``overlap`` (M, L) and ``wall_overlap`` (V, L) are the present ones of the listed pairs, which set the
    stiffness of Hertz contacts; those of the reference geometry by default.

    Central differences are stable iff ``dt < 2 / omega_max``, and
    ``omega_max^2 <= max_i (2 (1 + alpha_i) / m_i) lambda_max(B_i)`` with the 3 x 3 matrices
    ``B_i = sum over contacts of k_n n n^T + k_s s s^T + (2 k_theta / R_i^2) e3 e3^T``,
    ``s = (t, sqrt 2)`` in the scaled rotation ``R theta / sqrt 2``. It follows from
    ``(a - b)^2 <= 2 a^2 + 2 b^2`` for each pair; a wall does not move, so its contacts count half. Local
    damping multiplies a force by up to ``1 + alpha``, as a mass smaller by that factor would.
    """
    normal, shear, twist = pair_stiffness(assembly, features, scene.sand.shear_ratio, overlap)
    pairs, radius = assembly.pairs, assembly.grains.radius.astype(float)
    first = np.repeat(np.arange(scene.count), np.diff(pairs.start))
    matrices = np.zeros((scene.count, features.lanes, 3, 3))
    n = pairs.geometry[:, :2].astype(float)
    for disk, side in ((first, -1.0), (pairs.second, 1.0)):
        add_contacts(matrices, disk, n, side, normal, shear, 2.0 * twist / radius[disk, None] ** 2)
    wall_pairs, walls = assembly.wall_pairs, assembly.walls
    disk = np.repeat(np.arange(scene.count), np.diff(wall_pairs.start))
    depth = wall_pairs.overlap[:, None] if wall_overlap is None else wall_overlap
    shape = (len(disk), features.lanes)
    tangent = np.broadcast_to(hertz_tangent(wall_pairs.hertz, depth), shape)
    wall_shear = scene.sand.shear_ratio * tangent * (walls.friction[wall_pairs.wall] > 0.0)[:, None]
    wall_normal = walls.normal[wall_pairs.wall].astype(float)
    add_contacts(matrices, disk, wall_normal, 1.0, tangent / 2.0, wall_shear / 2.0, np.zeros(shape))
    if not features.rotation:
        matrices[..., 2, :] = matrices[..., :, 2] = 0.0
    largest = np.linalg.eigvalsh(matrices)[..., -1]
    inverse_mass = assembly.grains.inverse_mass.astype(float) * (1.0 + assembly.grains.damping.astype(float))
    squared = (2.0 * inverse_mass[:, None] * largest).max(axis=0)
    with np.errstate(divide="ignore"):
        return np.where(squared > 0.0, 2.0 / np.sqrt(squared), no_contact_step(scene))


def no_contact_step(scene: Scene) -> float:
    """Step for disks that touch nothing yet: limit of a contact pressed in by a thousandth of a radius."""
    smallest = float(np.min(scene.radius))
    coefficient = float(scene.sand.hertz_coefficient(np.array(smallest), np.array(smallest)))
    stiffness = 1.5 * coefficient * np.sqrt(1e-3 * smallest)
    return 2.0 / float(np.sqrt(12.0 * stiffness / np.min(scene.mass)))


def hertz_tangent(coefficient: Floats, overlap: Floats) -> Floats:
    """Normal stiffness of Hertz contacts, 3/2 h_n sqrt(overlap), N/m; zero where nothing overlaps."""
    pressed: Floats = np.maximum(overlap, 0.0).astype(float)
    return 1.5 * coefficient.astype(float)[:, None] * np.sqrt(pressed)


def pair_stiffness(
    assembly: Assembly, features: Features, shear_ratio: float, overlap: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
    """Normal, shear and rotational stiffness of every pair in every lane, each (M, L)."""
    pairs = assembly.pairs
    shape = (len(pairs.second), features.lanes)
    depth = pairs.geometry[:, 3:4] if overlap is None else overlap
    normal = np.broadcast_to(hertz_tangent(pairs.hertz, depth), shape)
    shear = shear_ratio * normal
    twist = np.zeros(shape)
    if features.bonds:
        bits = (pairs.cemented[:, None] >> np.arange(features.lanes, dtype=np.uint32)) & 1
        cemented = bits.astype(bool)
        bond, linear = pairs.bond.astype(float), pairs.linear.astype(float)
        normal = np.where(cemented, (bond[:, 0] + linear[:, 0])[:, None], normal)
        shear = np.where(cemented, (bond[:, 1] + linear[:, 1])[:, None], shear)
        twist = np.where(cemented, bond[:, 2:], twist)
    return normal, shear, twist


def add_contacts(
    matrices: Floats, disk: Integers, n: Floats, side: float, normal: Floats, shear: Floats, twist: Floats
) -> None:
    """Add the contacts' matrices to those of their disks, in place."""
    s = np.column_stack([-side * n[:, 1], side * n[:, 0], np.full(len(n), -np.sqrt(2.0))])
    flat = np.column_stack([n, np.zeros(len(n))])
    blocks = normal[:, :, None, None] * (flat[:, None, :, None] * flat[:, None, None, :])
    blocks = blocks + shear[:, :, None, None] * (s[:, None, :, None] * s[:, None, None, :])
    blocks[..., 2, 2] += twist
    np.add.at(matrices, disk, blocks)
