"""Largest stable time step of the explicit scheme."""

import numpy as np
from scipy.sparse import csr_array

from calcidem.dem.engine.assembly import Assembly, lanes_of_bits
from calcidem.dem.engine.scene import Scene
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.layout import (
    MOMENT,
    NORMAL,
    NORMAL_X,
    NORMAL_Y,
    OVERLAP,
    ROTATION,
    SHEAR,
    Floats,
    Integers,
    X,
    Y,
)

_Entry = tuple[int, int]
_Ends = tuple[Integers, Floats]

_UPPER = ((X, X), (X, Y), (Y, Y), (X, ROTATION), (Y, ROTATION), (ROTATION, ROTATION))  # entries of a matrix

_SWEEPS = 6  # of Jacobi's rotations; they converge quadratically


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

    Notes
    -----
    Central differences are stable iff ``dt < 2 / omega_max``, and ``omega_max^2`` is the largest ``u K u / u M u``.
    With the scaled rotation ``R theta / sqrt 2`` the three inertias of a disk are all ``m_i``, and a contact adds
    ``k_n (n (u_i - u_j))^2 + k_s (s_i u_i + s_j u_j)^2 + k_theta (theta_i - theta_j)^2`` to ``u K u``, with
    ``s = (t, sqrt 2 a / R)`` up to signs. The arm a from the centre to the contact is R, and longer by half of the gap
    where cement spans one. Since ``(a - b)^2 <= 2 a^2 + 2 b^2``, that is at most twice what its two ends would add if
    each moved alone, so ``omega_max^2 <= max_i 2 lambda_max(B_i) / m_i`` with the 3 x 3 matrices
    ``B_i = sum over contacts of k_n n n^T + k_s s s^T + (2 k_theta / R_i^2) e3 e3^T``. A bond that may break gives way
    to the sand's contact; whichever of the two is stiffer counts. A wall does not move, so its contacts count half.
    Local damping multiplies a force by up to ``1 + alpha``, as a mass smaller by that factor would: it lowers the limit
    to ``2 / (omega sqrt(1 + alpha))``.

    O'Sullivan & Bray (2004), doi:10.1108/02644400410519794, show that the critical time step depends on the present
    contacts, and that rules of thumb overestimate it.
    """
    matrices, factor = _contact_matrices(scene, assembly, features, overlap, wall_overlap)
    # An eigenvalue lies between the largest entry of the diagonal and the sum of all three: few can be the largest.
    diagonal = np.diagonal(matrices, axis1=-2, axis2=-1)
    possible = 1.000001 * factor * diagonal.sum(axis=-1) >= (factor * diagonal.max(axis=-1)).max(axis=0)
    squared = np.zeros(possible.shape)
    squared[possible] = largest_eigenvalue(matrices[possible])
    squared = (factor * squared).max(axis=0)
    with np.errstate(divide="ignore"):
        return np.where(squared > 0.0, 2.0 / np.sqrt(squared), _no_contact_step(scene))


def squared_frequencies(
    scene: Scene, assembly: Assembly, features: Features, overlap: Floats | None, wall_overlap: Floats | None
) -> Floats:
    """Each disk's part in the bound of `critical_time_step` on the highest frequency: (N, L) squares, rad^2/s^2."""
    matrices, factor = _contact_matrices(scene, assembly, features, overlap, wall_overlap)
    return np.asarray(factor * largest_eigenvalue(matrices))


def _contact_matrices(
    scene: Scene, assembly: Assembly, features: Features, overlap: Floats | None, wall_overlap: Floats | None
) -> tuple[Floats, Floats]:
    """Matrices (N, L, 3, 3) of `critical_time_step`, and what makes squared frequencies of their eigenvalues (N, 1)."""
    ends = (
        *_ends_of_pairs(scene, assembly, features, overlap),
        _ends_at_walls(scene, assembly, features, wall_overlap),
    )
    disk, blocks = (np.concatenate(parts) for parts in zip(*ends, strict=True))
    # One entry a contact: each disk's are added in their order, and multiplied by exactly one.
    of_disk = csr_array((np.ones(len(disk)), (disk, np.arange(len(disk)))), shape=(scene.count, len(disk)))
    width = features.lanes * len(_UPPER)
    entries = (of_disk @ blocks.reshape(len(disk), width)).reshape(scene.count, features.lanes, len(_UPPER))
    matrices = np.zeros((scene.count, features.lanes, 3, 3))
    for entry, (row, column) in enumerate(_UPPER):
        if features.rotation or ROTATION not in (row, column):
            matrices[..., row, column] = matrices[..., column, row] = entries[..., entry]
    inverse_mass = assembly.grains.inverse_mass.astype(float) * (1.0 + assembly.grains.damping.astype(float))
    return matrices, 2.0 * inverse_mass[:, None]


def largest_eigenvalue(matrices: Floats) -> Floats:
    """Upper bound (...) of the eigenvalues of symmetric matrices (..., 3, 3) without negative ones, good to 1e-12.

    Jacobi's rotations in a fixed order, made of ``+ - * /`` and square roots alone, since LAPACK's last bits depend on
    the processor. Off the diagonal next to nothing is left, and Gershgorin's circles cover it; the last factor covers
    the rounding.
    """
    scale = matrices[..., 0, 0] + matrices[..., 1, 1] + matrices[..., 2, 2]
    scaled = matrices / np.where(scale > 0.0, scale, 1.0)[..., None, None]
    entry: dict[_Entry, Floats] = {(i, j): scaled[..., i, j] for i in range(3) for j in range(i, 3)}
    for _ in range(_SWEEPS):
        for p, q, r in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
            _rotate(entry, (p, q), (min(p, r), max(p, r)), (min(q, r), max(q, r)))
    off = [np.abs(entry[place]) for place in ((0, 1), (0, 2), (1, 2))]
    rims = (
        entry[0, 0] + (off[0] + off[1]),
        entry[1, 1] + (off[0] + off[2]),
        entry[2, 2] + (off[1] + off[2]),
    )
    return np.asarray(np.maximum(np.maximum(rims[0], rims[1]), rims[2]) * scale * (1.0 + 1e-12))


def _rotate(entry: dict[tuple[int, int], Floats], pq: _Entry, pr: _Entry, qr: _Entry) -> None:
    """Turn the entry (p, q) of symmetric matrices into zero by a rotation of the axes p and q, in place."""
    p, q = pq
    off, gap = entry[pq], entry[q, q] - entry[p, p]
    # Tangent of the smaller angle: t^2 + t gap / off = 1, without a division by ``off``, which may be zero.
    below = np.abs(gap) + np.sqrt(gap * gap + 4.0 * (off * off))
    twice = 2.0 * off / np.where(below > 0.0, below, 1.0)
    tangent = np.where(gap < 0.0, -twice, twice)
    cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    entry[p, p], entry[q, q] = entry[p, p] - tangent * off, entry[q, q] + tangent * off
    entry[pr], entry[qr] = cosine * entry[pr] - sine * entry[qr], sine * entry[pr] + cosine * entry[qr]
    entry[pq] = np.zeros_like(off)


def _ends_of_pairs(scene: Scene, assembly: Assembly, features: Features, overlap: Floats | None) -> tuple[_Ends, _Ends]:
    """Both ends of the contacts between disks, see `_matrices_at`."""
    normal, shear, twist = pair_stiffness(assembly, features, scene.sand.shear_ratio, overlap)
    pairs, radius = assembly.pairs, assembly.grains.radius.astype(float)
    n = pairs.geometry[:, [NORMAL_X, NORMAL_Y]].astype(float)
    depth = pairs.geometry[:, OVERLAP, None].astype(float) if overlap is None else overlap

    def one_side(disk: Integers, side: float) -> _Ends:
        own = radius[disk, None]
        arm = np.broadcast_to(1.0 + np.maximum(-0.5 * depth, 0.0) / own, normal.shape)
        return _matrices_at(disk, side * n, normal, shear, (arm, 2.0 * twist / own**2))

    return one_side(pairs.first, -1.0), one_side(pairs.second, 1.0)


def _ends_at_walls(scene: Scene, assembly: Assembly, features: Features, overlap: Floats | None) -> _Ends:
    """The disks' ends of half of the contacts with walls, see `_matrices_at`."""
    wall_pairs, walls = assembly.wall_pairs, assembly.walls
    depth = wall_pairs.overlap[:, None] if overlap is None else overlap
    shape = (len(wall_pairs.disk), features.lanes)
    tangent = np.broadcast_to(hertz_tangent(wall_pairs.hertz, depth), shape)
    shear = scene.sand.shear_ratio * tangent * (walls.friction[wall_pairs.wall] > 0.0)[:, None]
    normal = walls.normal[wall_pairs.wall].astype(float)
    return _matrices_at(wall_pairs.disk, normal, tangent / 2.0, shear / 2.0, (np.ones(shape), np.zeros(shape)))


def _no_contact_step(scene: Scene) -> float:
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
    depth = pairs.geometry[:, OVERLAP, None] if overlap is None else overlap
    normal = np.broadcast_to(hertz_tangent(pairs.hertz, depth), shape)
    shear = shear_ratio * normal
    twist = np.zeros(shape)
    if features.bonds:
        intact = lanes_of_bits(pairs.intact, features.lanes)
        bond, linear = pairs.bond.astype(float), pairs.linear.astype(float)
        if features.linear_group:
            cemented = lanes_of_bits(pairs.cemented, features.lanes)
            normal, shear = (
                np.where(cemented, linear[:, k, None], sand) for k, sand in ((NORMAL, normal), (SHEAR, shear))
            )
            normal, shear = normal + intact * bond[:, NORMAL, None], shear + intact * bond[:, SHEAR, None]
        else:
            least = (normal, shear) if features.breakage else (0.0, 0.0)
            normal = np.where(intact, np.maximum(bond[:, NORMAL, None], least[0]), normal)
            shear = np.where(intact, np.maximum(bond[:, SHEAR, None], least[1]), shear)
        twist = np.where(intact, bond[:, MOMENT, None], twist)
    return normal, shear, twist


def _matrices_at(disk: Integers, n: Floats, normal: Floats, shear: Floats, turning: tuple[Floats, Floats]) -> _Ends:
    """Disks (M,) and what contacts add to their matrices: the entries `_UPPER`, (M, L, 6).

    ``n`` (M, 2) points to the disk; ``turning`` is the arm over its radius and the rotational stiffness, each (M, L).
    """
    arm, twist = turning
    n_x, n_y = n[:, X, None], n[:, Y, None]
    turned = -np.sqrt(2.0) * arm
    entries = np.empty((*arm.shape, len(_UPPER)))
    entries[..., 0] = normal * (n_x * n_x) + shear * (n_y * n_y)
    entries[..., 1] = normal * (n_x * n_y) + shear * (-n_y * n_x)
    entries[..., 2] = normal * (n_y * n_y) + shear * (n_x * n_x)
    entries[..., 3] = shear * (-n_y * turned)
    entries[..., 4] = shear * (n_x * turned)
    entries[..., 5] = shear * (turned * turned) + twist
    return disk, entries
