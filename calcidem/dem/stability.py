"""Largest stable time step of the explicit scheme."""

import numpy as np

from calcidem.dem.assembly import Assembly
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.scene import Scene


def critical_time_step(scene: Scene, assembly: Assembly, features: Features) -> Floats:
    """Rigorous lower bound of the critical time step in the reference geometry, (L,) s.

    Central differences are stable iff ``dt < 2 / omega_max``, and
    ``omega_max^2 <= max_i (2 (1 + alpha_i) / m_i) lambda_max(B_i)`` with the 3 x 3 matrices
    ``B_i = sum over contacts of k_n n n^T + k_s s s^T + (2 k_theta / R_i^2) e3 e3^T``,
    ``s = (t, sqrt 2)`` in the scaled rotation ``R theta / sqrt 2``. It follows from
    ``(a - b)^2 <= 2 a^2 + 2 b^2`` for each pair; a wall does not move, so its contacts count half. Local
    damping multiplies a force by up to ``1 + alpha``, as a mass smaller by that factor would.
    """
    normal, shear, twist = pair_stiffness(assembly, features)
    pairs, radius = assembly.pairs, assembly.grains.radius.astype(float)
    first = np.repeat(np.arange(scene.count), np.diff(pairs.start))
    matrices = np.zeros((scene.count, features.lanes, 3, 3))
    n = pairs.geometry[:, :2].astype(float)
    for disk, side in ((first, -1.0), (pairs.second, 1.0)):
        add_contacts(matrices, disk, n, side, normal, shear, 2.0 * twist / radius[disk, None] ** 2)
    wall_pairs, walls = assembly.wall_pairs, assembly.walls
    disk = np.repeat(np.arange(scene.count), np.diff(wall_pairs.start))
    tangent = np.repeat(wall_pairs.tangent.astype(float)[:, :, None], features.lanes, axis=2)
    still = np.zeros((len(disk), features.lanes))
    add_contacts(matrices, disk, walls.normal[wall_pairs.wall].astype(float), 1.0, tangent[:, 0] / 2, tangent[:, 1] / 2, still)
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


def pair_stiffness(assembly: Assembly, features: Features) -> tuple[Floats, Floats, Floats]:
    """Normal, shear and rotational stiffness of every pair in every lane at the reference overlap, each (M, L)."""
    pairs = assembly.pairs
    shape = (len(pairs.second), features.lanes)
    normal = np.broadcast_to(pairs.tangent[:, :1].astype(float), shape).copy()
    shear = np.broadcast_to(pairs.tangent[:, 1:].astype(float), shape).copy()
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
    matrices: Floats, disk: Floats, n: Floats, side: float, normal: Floats, shear: Floats, twist: Floats
) -> None:
    """Add the contacts' matrices to those of their disks, in place."""
    s = np.column_stack([-side * n[:, 1], side * n[:, 0], np.full(len(n), -np.sqrt(2.0))])
    flat = np.column_stack([n, np.zeros(len(n))])
    blocks = normal[:, :, None, None] * (flat[:, None, :, None] * flat[:, None, None, :])
    blocks = blocks + shear[:, :, None, None] * (s[:, None, :, None] * s[:, None, None, :])
    blocks[..., 2, 2] += twist
    np.add.at(matrices, disk, blocks)
