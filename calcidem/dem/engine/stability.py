"""Largest stable time step of the explicit scheme."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from calcidem.dem.engine.assembly import Assembly, aligned_copy, lanes_of_bits
from calcidem.dem.engine.scene import Scene
from calcidem.dem.kernels.layout import (
    MOMENT,
    NORMAL,
    NORMAL_X,
    NORMAL_Y,
    OVERLAP,
    ROTATION,
    SHEAR,
    Features,
    Floats,
    Grains,
    Integers,
    X,
    Y,
)

_Entry = tuple[int, int]

_RING_INERTIA = 2.0  # moment of inertia of a ring over a disk's
_ROUNDED_UP = 1.0 + 1e-12  # covers the rounding of a bound


class _Springs(NamedTuple):
    """Contacts, each seen from one of its disks."""

    disk: Integers
    """(M,) disk of each contact."""
    n: Floats
    """(M, 2) unit vector towards it."""
    normal: Floats
    shear: Floats
    """(M, L) stiffnesses, N/m."""
    arm: Floats
    twist: Floats
    """(M, L) arm over the disk's radius, and rotational stiffness, as `critical_time_step_of_disks` scales it."""

    @property
    def trace(self) -> Floats:
        """(M, L) trace of each contact's term in its disk's matrix."""
        return np.asarray(self.normal + self.shear * (1.0 + 2.0 * (self.arm * self.arm)) + self.twist)

    @property
    def entries(self) -> dict[_Entry, Floats]:
        """Upper triangle, each entry (M, L), of each contact's term in its disk's matrix."""
        n_x, n_y = self.n[:, X, None], self.n[:, Y, None]
        normal, shear, turned = self.normal, self.shear, -np.sqrt(2.0) * self.arm
        return {
            (X, X): normal * (n_x * n_x) + shear * (n_y * n_y),
            (X, Y): normal * (n_x * n_y) + shear * (-n_y * n_x),
            (Y, Y): normal * (n_y * n_y) + shear * (n_x * n_x),
            (X, ROTATION): shear * (-n_y * turned),
            (Y, ROTATION): shear * (n_x * turned),
            (ROTATION, ROTATION): shear * (turned * turned) + self.twist,
        }


def critical_time_step(
    scene: Scene,
    assembly: Assembly,
    features: Features,
    overlap: Floats | None = None,
    wall_overlap: Floats | None = None,
) -> Floats:
    """Rigorous lower bound of the critical time step of a sample, (L,) s.

    The arguments are those of `critical_time_step_of_disks`, which is cheaper and about 15 to 30 % lower.

    Notes
    -----
    Central differences are stable iff ``dt < 2 / omega_max``. With the coordinates of `critical_time_step_of_disks`
    ``omega_max^2`` is the largest eigenvalue of the symmetric matrix A of 3 x 3 blocks ``A_ij = K_ij / sqrt(m_i m_j)``.
    By Gershgorin's theorem for blocks, for any positive weights x of the disks, it is at most
    ``max_i (lambda_max(A_ii) + sum_j |A_ij| x_j / x_i)`` (Feingold & Varga 1962, doi:10.2140/pjm.1962.12.1241). A few
    iterations of the power method on the matrix of these norms give good weights. A wall is fixed and has no A_ij.
    """
    first, second, at_walls = _springs_at_disks(scene, assembly, features, overlap, wall_overlap)
    inverse, disks, at_wall = _inverse_masses(assembly), np.arange(scene.count), np.unique(at_walls.disk)
    own = inverse * _largest_eigenvalue(_contact_matrices((first, second, at_walls), disks, features))
    squared = 2.0 * own.max(axis=0, initial=0.0)  # the bound of `critical_time_step_of_disks`
    whole_walls = at_walls._replace(normal=2.0 * at_walls.normal, shear=2.0 * at_walls.shear)
    own[at_wall] = inverse[at_wall] * _largest_eigenvalue(
        _contact_matrices((first, second, whole_walls), at_wall, features)
    )
    root = np.sqrt(inverse)
    between = root[first.disk] * root[second.disk] * _coupling(first, second, features)
    to_first, to_second = (_sums(side.disk, scene.count) for side in (first, second))
    weights = np.ones_like(own)
    for _ in range(12):  # power method
        at_first, at_second = (between * weights.take(side.disk, axis=0) for side in (first, second))
        grown = own * weights + to_first @ at_second + to_second @ at_first
        squared = np.minimum(squared, _ROUNDED_UP * (grown / weights).max(axis=0, initial=0.0))
        largest = grown.max(axis=0, initial=0.0)
        weights = grown / np.where(largest > 0.0, largest, 1.0) + 1e-6  # no weight may be 0
    return _step_of_squares(scene, squared)


def critical_time_step_of_disks(
    scene: Scene,
    assembly: Assembly,
    features: Features,
    overlap: Floats | None = None,
    wall_overlap: Floats | None = None,
    *,
    rings: bool = False,
) -> Floats:
    """Rigorous lower bound (L,) of the critical time step, s, from each disk alone: cheap enough for repeated checks.

    ``overlap`` (M, L) and ``wall_overlap`` (V, L) of the listed pairs set the stiffness of Hertz contacts; by default
    they are those of the reference geometry. With ``rings`` the disks have the moments of inertia of rings, see
    `scaled_densities`.

    Notes
    -----
    Central differences are stable iff ``dt < 2 / omega_max``, and ``omega_max^2`` is the largest ``u K u / u M u``.
    With the scaled rotation ``R theta / sqrt 2`` the three inertias of a disk are all ``m_i``. A contact then adds
    ``k_n (n (u_i - u_j))^2 + k_s (s_i u_i + s_j u_j)^2 + k_theta (theta_i - theta_j)^2`` to ``u K u``, with
    ``s = (t, sqrt 2 a / R)`` up to signs. The arm a from the centre to the contact is R, plus half of the gap where
    cement spans one. Since ``(a - b)^2 <= 2 a^2 + 2 b^2``, this is at most twice the sum for its two ends moving alone.
    Hence ``omega_max^2 <= max_i 2 lambda_max(B_i) / m_i`` with the 3 x 3 matrices
    ``B_i = sum over contacts of k_n n n^T + k_s s s^T + (2 k_theta / R_i^2) e3 e3^T``. A bond that may break reverts to
    the sand's contact, so the stiffer of the two counts. A wall is fixed, so its contacts count half. Local damping
    multiplies a force by up to ``1 + alpha``, like a mass smaller by that factor. It lowers the limit to
    ``2 / (omega sqrt(1 + alpha))``.

    O'Sullivan & Bray (2004), doi:10.1108/02644400410519794, show that the critical time step depends on the present
    contacts, and that rules of thumb overestimate it.
    """
    _, squares = stiffest_disks(scene, assembly, features, overlap, wall_overlap, rings=rings)
    return _step_of_squares(scene, squares.max(axis=0, initial=0.0))


def _step_of_squares(scene: Scene, squared: Floats) -> Floats:
    """Critical time step (L,), s, from bounds on the square of the highest frequency, rad^2/s^2.

    Disks without contacts have the limit of a contact with an overlap of a thousandth of a radius.
    """
    smallest = float(np.min(scene.radius))
    coefficient = float(scene.sand.hertz_coefficient(np.array(smallest), np.array(smallest)))
    stiffness = 1.5 * coefficient * np.sqrt(1e-3 * smallest)
    without = 2.0 / float(np.sqrt(12.0 * stiffness / np.min(scene.mass)))
    with np.errstate(divide="ignore"):
        return np.where(squared > 0.0, 2.0 / np.sqrt(squared), without)


def _coupling(first: _Springs, second: _Springs, features: Features) -> Floats:
    """Spectral norms (M, L), N/m, of the blocks of stiffness that couple the two disks of each contact.

    The normal part is k_n. For the block of shear and rotation, ``k_s s_i s_j^T - 2 k_theta / (R_i R_j) e3 e3^T``, the
    product of the singular values and the sum of their squares are known.
    """
    normal, shear = first.normal, first.shear
    if not features.rotation:
        return np.asarray(np.maximum(normal, shear))
    twist = np.sqrt(first.twist * second.twist)
    squared_arms = first.arm * first.arm + second.arm * second.arm
    turning = 2.0 * (shear * (first.arm * second.arm)) - twist
    total = (shear * shear) * (1.0 + 2.0 * squared_arms) + turning * turning
    product = shear * twist
    apart = np.sqrt(np.maximum((total - 2.0 * product) * (total + 2.0 * product), 0.0))
    return np.asarray(np.maximum(normal, np.sqrt(0.5 * (total + apart))))


def scaled_densities(
    scene: Scene, assembly: Assembly, features: Features, overlap: Floats, wall_overlap: Floats, highest: float
) -> tuple[Grains, Floats]:
    """Disks with scaled densities, which come to rest in fewer steps, and their step limit, (L,) s.

    If only the state of rest counts, the stiffest disks need not limit the step (density scaling, as PFC's 'timestep
    scale'). Disks are stiffest in rotation, so they receive the moment of inertia of rings. Each disk has its own bound
    in `critical_time_step_of_disks`. Bounds above ``highest`` times the largest are then lowered to it by added mass.
    All lanes share masses and step. The other arguments are those of that function.
    """
    disks, squares = stiffest_disks(scene, assembly, features, overlap, wall_overlap, rings=True, share=highest)
    allowed, grains = highest * float(squares.max(initial=0.0)), assembly.grains
    step = _step_of_squares(scene, np.full(features.lanes, allowed))
    if allowed == 0.0:
        return grains, step
    heavier = np.ones(scene.count)
    heavier[disks] = np.maximum(1.0, squares.max(axis=1) / allowed)
    inverse_mass = (grains.inverse_mass / heavier).astype(grains.inverse_mass.dtype)
    inverse_inertia = (grains.inverse_inertia / (_RING_INERTIA * heavier)).astype(grains.inverse_inertia.dtype)
    scaled = grains._replace(inverse_mass=aligned_copy(inverse_mass), inverse_inertia=aligned_copy(inverse_inertia))
    return scaled, step


def stiffest_disks(
    scene: Scene,
    assembly: Assembly,
    features: Features,
    overlap: Floats | None,
    wall_overlap: Floats | None,
    *,
    rings: bool = False,
    share: float = 1.0,
) -> tuple[Integers, Floats]:
    """Disks (K,) with at least those whose part in the bound of a lane reaches a share of the largest, and their parts.

    Parts are (K, L) squares of frequencies, rad^2/s^2; the other arguments are those of `critical_time_step_of_disks`.
    """
    springs = _springs_at_disks(scene, assembly, features, overlap, wall_overlap)
    if rings:
        root = np.sqrt(_RING_INERTIA)
        springs = tuple(side._replace(arm=side.arm / root, twist=side.twist / _RING_INERTIA) for side in springs)
    factor = 2.0 * _inverse_masses(assembly)
    # The trace bounds an eigenvalue, so few disks can exceed the disk with the largest trace.
    most = factor * sum(_sums(side.disk, len(factor)) @ side.trace for side in springs)
    tops = np.unique(most.argmax(axis=0))
    least = (factor[tops] * _largest_eigenvalue(_contact_matrices(springs, tops, features))).max(axis=0)
    near = np.flatnonzero((1.000001 * most >= share * least).any(axis=1))
    return near, np.asarray(factor[near] * _largest_eigenvalue(_contact_matrices(springs, near, features)))


def _inverse_masses(assembly: Assembly) -> Floats:
    """Inverse masses (N, 1), 1/kg; local damping counts as a smaller mass."""
    grains = assembly.grains
    return np.asarray((grains.inverse_mass.astype(float) * (1.0 + grains.damping.astype(float)))[:, None])


def _sums(disk: Integers, count: int) -> csr_array:
    """Matrix (count, M) that sums values over disks (M,), each sum in the order of its terms."""
    return csr_array((np.ones(len(disk)), (disk, np.arange(len(disk)))), shape=(count, len(disk)))


def _contact_matrices(springs: Sequence[_Springs], disks: Integers, features: Features) -> dict[_Entry, Floats]:
    """Upper triangle, each entry (K, L), of the matrices of `critical_time_step_of_disks` for increasing disks (K,)."""
    number = np.full(max(values.max(initial=-1) for values in (disks, *(side.disk for side in springs))) + 1, -1)
    number[disks] = np.arange(len(disks))
    chosen = [np.flatnonzero(number[side.disk] >= 0) for side in springs]
    parts = [
        side if len(rows) == len(side.disk) else _Springs._make(values[rows] for values in side)
        for side, rows in zip(springs, chosen, strict=True)
    ]
    over_disks = _sums(number[np.concatenate([part.disk for part in parts])], len(disks))
    terms = [part.entries for part in parts]
    matrices = {entry: over_disks @ np.concatenate([term[entry] for term in terms]) for entry in terms[0]}
    if not features.rotation:
        matrices |= {entry: np.zeros_like(matrices[X, X]) for entry in matrices if ROTATION in entry}
    return matrices


def _largest_eigenvalue(matrices: dict[_Entry, Floats]) -> Floats:
    """Upper bound (...) of the eigenvalues of positive semidefinite matrices, accurate to 1e-12.

    ``matrices`` holds the upper triangle, each entry (...). Jacobi rotations in a fixed order use only ``+ - * /`` and
    square roots, since LAPACK's last bits depend on the processor. Gershgorin's circles cover the tiny off-diagonal
    rest; the last factor covers rounding.
    """
    scale = matrices[X, X] + matrices[Y, Y] + matrices[ROTATION, ROTATION]
    size = np.where(scale > 0.0, scale, 1.0)
    entry: dict[_Entry, Floats] = {place: values / size for place, values in matrices.items()}
    for _ in range(6):  # sweeps converge quadratically
        for p, q, r in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
            _rotate(entry, (p, q), (min(p, r), max(p, r)), (min(q, r), max(q, r)))
        # The largest of three eigenvalues with the sum 1 is above 1/3, so less than this changes no bit of it.
        if all(np.abs(entry[place]).max(initial=0.0) < 1e-18 for place in ((0, 1), (0, 2), (1, 2))):
            break
    off = [np.abs(entry[place]) for place in ((0, 1), (0, 2), (1, 2))]
    rims = (
        entry[0, 0] + (off[0] + off[1]),
        entry[1, 1] + (off[0] + off[2]),
        entry[2, 2] + (off[1] + off[2]),
    )
    return np.asarray(np.maximum(np.maximum(rims[0], rims[1]), rims[2]) * scale * _ROUNDED_UP)


def _rotate(entry: dict[tuple[int, int], Floats], pq: _Entry, pr: _Entry, qr: _Entry) -> None:
    """Eliminate the entry (p, q) of symmetric matrices by a rotation of the axes p and q, in place."""
    p, q = pq
    off, gap = entry[pq], entry[q, q] - entry[p, p]
    # Tangent of the smaller angle: t^2 + t gap / off = 1, computed without dividing by ``off``, which may be zero.
    below = np.abs(gap) + np.sqrt(gap * gap + 4.0 * (off * off))
    twice = 2.0 * off / np.where(below > 0.0, below, 1.0)
    tangent = np.where(gap < 0.0, -twice, twice)
    cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    entry[p, p], entry[q, q] = entry[p, p] - tangent * off, entry[q, q] + tangent * off
    entry[pr], entry[qr] = cosine * entry[pr] - sine * entry[qr], sine * entry[pr] + cosine * entry[qr]
    entry[pq] = np.zeros_like(off)


def _springs_at_disks(
    scene: Scene, assembly: Assembly, features: Features, overlap: Floats | None, wall_overlap: Floats | None
) -> tuple[_Springs, ...]:
    """Contacts between disks from their first and from their second disk, and half of each wall contact."""
    normal, shear, twist = pair_stiffness(assembly, features, scene.sand.shear_ratio, overlap)
    pairs, wall_pairs, walls = assembly.pairs, assembly.wall_pairs, assembly.walls
    radius = assembly.grains.radius.astype(float)
    n = pairs.geometry[:, [NORMAL_X, NORMAL_Y]].astype(float)
    depth = pairs.geometry[:, OVERLAP, None].astype(float) if overlap is None else overlap

    def one_side(disk: Integers, side: float) -> _Springs:
        own = radius[disk, None]
        arm = np.broadcast_to(1.0 + np.maximum(-0.5 * depth, 0.0) / own, normal.shape)
        return _Springs(disk, side * n, normal, shear, arm, 2.0 * twist / own**2)

    pressed = wall_pairs.overlap[:, None] if wall_overlap is None else wall_overlap
    shape = (len(wall_pairs.disk), features.lanes)
    tangent = np.broadcast_to(hertz_tangent(wall_pairs.hertz, pressed), shape)
    rubbing = scene.sand.shear_ratio * tangent * (walls.friction[wall_pairs.wall] > 0.0)[:, None]
    towards = walls.normal[wall_pairs.wall].astype(float)
    at_walls = _Springs(wall_pairs.disk, towards, tangent / 2.0, rubbing / 2.0, np.ones(shape), np.zeros(shape))
    return one_side(pairs.first, -1.0), one_side(pairs.second, 1.0), at_walls


def hertz_tangent(coefficient: Floats, overlap: Floats) -> Floats:
    """Normal stiffness of Hertz contacts, 3/2 h_n sqrt(overlap), N/m; zero without overlap."""
    pressed: Floats = np.maximum(overlap, 0.0).astype(float)
    return 1.5 * coefficient.astype(float)[:, None] * np.sqrt(pressed)


def stiffest_contacts(assembly: Assembly, overlap: Floats, wall_overlap: Floats) -> Floats:
    """Largest sum (L,) of the stiffnesses of a disk's Hertz contacts over its mass, 1/s^2, at overlaps (M, L), (V, L).

    It grows when the limit of the step falls.
    """
    pairs, wall_pairs = assembly.pairs, assembly.wall_pairs
    total = sums_at_disks(assembly, hertz_tangent(pairs.hertz, overlap), hertz_tangent(wall_pairs.hertz, wall_overlap))
    return np.asarray((_inverse_masses(assembly) * total).max(axis=0, initial=0.0))


def sums_at_disks(assembly: Assembly, of_pairs: Floats, of_walls: Floats) -> Floats:
    """Sums (N, L) over the contacts of each disk of values of all contacts, (M, L) and (V, L)."""
    pairs, count = assembly.pairs, len(assembly.grains.radius)
    ends = ((pairs.first, of_pairs), (pairs.second, of_pairs), (assembly.wall_pairs.disk, of_walls))
    return np.asarray(sum(_sums(disk, count) @ values for disk, values in ends))


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
