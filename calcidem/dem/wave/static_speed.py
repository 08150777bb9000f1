"""Static shear stiffness of a cemented sample from its contacts, without time integration.

It gives the speed of long shear waves, for comparison with velocities.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import Delaunay

from calcidem.dem.engine.assembly import listed_pairs, pair_keys
from calcidem.dem.engine.fields import require
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.readout import overlaps
from calcidem.dem.engine.scene import Bonds
from calcidem.dem.engine.stability import pair_stiffness
from calcidem.dem.engine.state import start
from calcidem.dem.kernels.layout import FIRST_ARM, NORMAL_X, NORMAL_Y, SECOND_ARM, Flags, Floats, Integers
from calcidem.dem.sample.compaction import settle
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import Experiment, wave_scene


def sheared_motion(state: State, held: Flags) -> Floats:
    """Static motion of all disks of a sample in a simple shear ``u_y = x``: (N, 3) m and rad, in the scene's order.

    All contacts stick, with their stiffness in the state. Wall contacts do not count. `ValueError` if a bond is broken,
    no disk touches another, or no disk is held.

    Parameters
    ----------
    state
        State of one lane with all bonds intact.
    held
        (N,) disks that follow the shear, but rotate freely. All others reach equilibrium.

    Notes
    -----
    SuperLU factorizes the matrix; its last bits depend on the processor.
    """
    pairs, order = state.assembly.pairs, state.assembly.order
    whole = bool(np.all(pairs.cemented == pairs.intact))
    require(whole, "state", "with broken bonds", "their contacts have no single stiffness")
    require(bool(np.any(held)), "held", "no disk", "give disks that follow the shear")
    strain_matrix, stiffness = _contact_springs(state)
    require(bool(np.any(stiffness > 0.0)), "state", "without contacts", "give disks that touch")
    x, radius = np.asarray(state.scene.x)[order], state.assembly.grains.radius.astype(float)
    motion = np.column_stack([np.zeros(len(x)), x, 0.5 * radius]).ravel()
    free = np.column_stack([~held[order], ~held[order], np.ones(len(x), dtype=bool)]).ravel()
    matrix = (strain_matrix.T @ sparse.diags_array(stiffness) @ strain_matrix).tocsr()
    # Soft springs, 1e-9 of the median stiffness, tie disks to the mean strain and so hold loose ones.
    ground = 1e-9 * float(np.median(stiffness[stiffness > 0.0])) * sparse.eye_array(int(free.sum()))
    factors = splu(
        (matrix[free][:, free] + ground).tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    motion[free] -= factors.solve((matrix @ motion)[free])
    moved = motion.reshape(-1, 3)
    return state.to_scene_order(np.column_stack([moved[:, :2], moved[:, 2] / radius]))


class ShearedTriangles(NamedTuple):
    """Delaunay triangles between centres of a sheared sample; weighted sums give the values of a part."""

    middle: Floats
    """(K, 2) centroids, m."""
    area: Floats
    solid: Floats
    """(K,) m^2; ``solid`` is the area of the disks."""
    strain: Floats
    stress: Floats
    """(K,) shear strain and shear stress, times area."""

    def weighted(self, weight: Floats) -> tuple[float, float]:
        """Shear modulus, Pa, and area fraction of disks of a part of the sample: mean shear stress over mean strain.

        Each triangle (K,) counts with a weight; `ValueError` if none does.
        """
        require(bool(weight.any()), "weight", 0, "give at least one triangle a weight")
        area, solid, strain, stress = (
            float((values * weight).sum()) for values in (self.area, self.solid, self.strain, self.stress)
        )
        return stress / strain, solid / area


def sheared_triangles(state: State, motion: Floats, corners: Integers) -> ShearedTriangles:
    """Strain and stress of each triangle of a sheared sample.

    The stress of a part is ``sum(branch f) / area`` over its contacts (Love 1927). Each of the two triangles that share
    a contact as a side takes half of it, so a contact on the rim of a part counts half.

    Parameters
    ----------
    state, motion
        See `sheared_motion`.
    corners
        (K, 3) disks at the corners of triangles between the centres, the same for all samples of a packing.
    """
    order = state.assembly.order
    centres = np.column_stack([state.scene.x, state.scene.y])
    radius = np.asarray(state.scene.radius)
    strain_matrix, stiffness = _contact_springs(state)
    scaled = np.column_stack([motion[:, :2], motion[:, 2] * radius])[order]
    change = (stiffness * (strain_matrix @ scaled.ravel())).reshape(3, -1)
    normal = state.assembly.pairs.geometry[:, [NORMAL_X, NORMAL_Y]].astype(float)
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    # (M, 2) change of the force of each pair's first disk on its second; tension positive.
    force = change[0][:, None] * normal + change[1][:, None] * tangent
    ends = order[listed_pairs(state.assembly)]
    branch = centres[ends[:, 1]] - centres[ends[:, 0]]
    moments = 0.5 * (branch[:, 0] * force[:, 1] + branch[:, 1] * force[:, 0])
    sides = centres[np.roll(corners, 1, axis=1)] - centres[np.roll(corners, -1, axis=1)]  # opposite to each corner
    length = np.hypot(sides[:, :, 0], sides[:, :, 1])
    one, other = np.roll(length, 1, axis=1), np.roll(length, -1, axis=1)
    angles = np.arccos(np.clip((one**2 + other**2 - length**2) / (2.0 * one * other), -1.0, 1.0))
    double = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]  # area, negative if clockwise
    # A linear function has the gradient sum(value times normal of the opposite side) over twice the area.
    shear = motion[corners, 0] * sides[:, :, 0] - motion[corners, 1] * sides[:, :, 1]
    return ShearedTriangles(
        centres[corners].mean(axis=1),
        0.5 * np.abs(double),
        0.5 * (radius[corners] ** 2 * angles).sum(axis=1),
        0.5 * np.sign(double) * shear.sum(axis=1),
        0.5 * _carried(corners, ends, moments, len(centres)).sum(axis=1),
    )


def _carried(corners: Integers, pairs: Integers, moments: Floats, count: int) -> Floats:
    """(K, 3) moments (M,) of the pairs (M, 2) on the sides of each triangle; 0 for sides without a pair."""
    keys, sides = pair_keys(pairs, count), np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    rising, wanted = np.argsort(keys), pair_keys(sides, count)
    place = np.minimum(np.searchsorted(keys[rising], wanted), len(keys) - 1)
    return np.where(np.isin(wanted, keys), moments[rising][place], 0.0).reshape(corners.shape)


def _contact_springs(state: State) -> tuple[sparse.csr_array, Floats]:
    """Matrix (3 M, 3 N) from motions to approach, sliding and rolling of each pair, and stiffnesses (3 M,), N/m.

    The motion of a disk is x, y and radius times rotation, in memory order.
    """
    pairs, radius = state.assembly.pairs, state.assembly.grains.radius.astype(float)
    depth = None if state.features.linear else overlaps(state)
    normal, shear, twist = (
        stiffness[:, 0]
        for stiffness in pair_stiffness(state.assembly, state.features, state.scene.sand.shear_ratio, depth)
    )
    if state.scene.sand.friction == 0.0:
        shear = np.where(pairs.cemented, shear, 0.0)
    geometry = pairs.geometry.astype(float)
    n_x, n_y = geometry[:, NORMAL_X], geometry[:, NORMAL_Y]
    one, none = np.ones(len(n_x)), np.zeros(len(n_x))
    first, second = radius[pairs.first], radius[pairs.second]
    blocks = [  # contributions of x, y and radius times rotation, of the first and of the second disk
        (-n_x, -n_y, none, n_x, n_y, none),
        (n_y, -n_x, -geometry[:, FIRST_ARM] / first, -n_y, n_x, -geometry[:, SECOND_ARM] / second),
        (none, none, -one / first, none, none, one / second),
    ]
    columns = [3 * disk[:, None] + np.arange(3) for disk in (pairs.first, pairs.second)]
    count = len(pairs.first)
    rows = np.repeat(np.arange(3 * count), 6)
    values = np.concatenate([np.column_stack(block) for block in blocks]).ravel()
    places = np.tile(np.hstack(columns), (3, 1)).ravel()
    shape = (3 * count, 3 * len(radius))
    return sparse.csr_array((values, (rows, places)), shape=shape), np.concatenate([normal, shear, twist])


LARGEST_STATIC_ERROR = 0.1
"""Relative uncertainty above which no static speed is stored."""

_MARGINS = (2.0, 3.0, 4.0)
"""Distances from the side walls, over the mean diameter, that are excluded: the disks held there stiffen their
neighbours.
"""


class StaticSpeed(NamedTuple):
    """Speed of long shear waves."""

    speed: float
    """m/s."""
    error: float
    """Relative uncertainty by the boundary conditions and by the size of the inner part."""


def static_speed(experiment: Experiment, bonded: Flags) -> StaticSpeed:
    """Speed sqrt(G / rho) of shear waves much longer than a disk, in the inner part of a sample.

    `ValueError` if the sample has no stiffness (`calcidem.dem.wave.static_speed.sheared_motion`), or no inner part;
    `SettlingError` if new bonds change the forces of the sample and it does not come to rest.

    Parameters
    ----------
    experiment
        Common settings; the packing touches all four walls.
    bonded
        (C,) True for cemented pairs of the packing.

    Notes
    -----
    G is mean stress over mean strain where the wave is: along the whole path, and between the damped layers at floor
    and lid, which it cannot enter, weighted across the path by ``cos^2(pi y / h)``, the energy of a wave in a strip of
    height h (`StripWave`), or evenly without such layers.
    The sample is sheared twice. First all disks at the walls follow the shear, then only those at the side walls, with
    floor and lid free. The speed is the geometric mean of both. Displacements prescribed all around give an upper bound
    for the whole box (Huet 1990, doi:10.1016/0022-5096(90)90041-2), far too high where stiff patches reach its walls.
    They hardly affect the inner part.

    The error has two independent parts: half the difference of both shears, and half the range over three distances
    from the side walls. rho is the density of the grains times their area fraction with the same weights. The wave
    itself is slower, since local damping reduces each force that moves a disk. docs/velocity.md compares the two.
    """
    packing, sand = experiment.stiffen()
    refuse_narrow(packing)
    state, corners = _state_at_rest(experiment, bonded), experiment.once(_corners)
    x, y, radius = (np.asarray(values, dtype=float) for values in (packing.x, packing.y, packing.radius))
    from_sides, from_ends = np.minimum(x, packing.width - x), np.minimum(y, packing.height - y)
    strip = packing.height - 2.0 * experiment.wave.boundary_thickness
    speeds = np.empty((2, len(_MARGINS)))
    for row, held in enumerate((np.minimum(from_sides, from_ends) < radius, from_sides < radius)):
        triangles = sheared_triangles(state, sheared_motion(state, held), corners)
        from_sides_here = np.minimum(triangles.middle[:, 0], packing.width - triangles.middle[:, 0])
        across = (triangles.middle[:, 1] - 0.5 * packing.height) / strip
        profile = np.cos(np.pi * across) ** 2 if experiment.clamp else 1.0
        energy = np.where(np.abs(across) < 0.5, profile, 0.0)
        for column, margin in enumerate(_MARGINS):
            inner = from_sides_here > margin * 2.0 * radius.mean()
            modulus, solid = triangles.weighted(np.where(inner, energy, 0.0))
            speeds[row, column] = np.sqrt(max(0.0, modulus) / (sand.density * solid))
    clamped, free = speeds[:, len(_MARGINS) // 2]
    speed = float(np.sqrt(clamped * free))
    if not speed > 0.0:
        raise ValueError("bonded: the inner part of the sample carries no shear: give more cement, or a denser packing")
    spread = np.hypot(0.5 * abs(clamped - free), 0.5 * np.ptp(speeds.mean(axis=0)))
    return StaticSpeed(speed, float(spread / speed))


def refuse_narrow(packing: Packing) -> None:
    """Raise a `ValueError` for a box without an inner part of some disks."""
    least = 2.0 * (2.0 * _MARGINS[-1] + 2.0) * float(packing.radius.mean())
    cure = f"too narrow for a static speed: the disks at the side walls are held; give at least {least:.3g} m"
    require(packing.width >= least, "packing.width", packing.width, cure)


def _corners(experiment: Experiment) -> Integers:
    """(K, 3) corners of the Delaunay triangles between the disks of a packing."""
    corners: Integers = Delaunay(np.column_stack([experiment.packing.x, experiment.packing.y])).simplices
    return corners


def _state_at_rest(experiment: Experiment, bonded: Flags) -> State:
    """State of a cemented sample before its wave; arguments and errors as for `static_speed`."""
    packing, sand = experiment.stiffen()
    rule, keeps_forces = experiment.wave, experiment.installation == "preserve"
    bonds = Bonds(packing.pairs[bonded], experiment.cement, installation=experiment.installation)
    scene = wave_scene(packing, sand, rule, bonds if np.any(bonded) else None)
    state = start(scene, law="linear" if keeps_forces else rule.contact_law, preload=packing.preload)
    if np.any(bonded) and not keeps_forces:
        state = settle(state, rule.unbalanced_force_ratio, rule.most_settling_steps)
    return state
