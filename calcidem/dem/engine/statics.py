"""The stiffness of a sample against shear, from its contacts alone: nothing moves in time."""

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from calcidem.dem.engine.fields import require
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.readout import overlaps
from calcidem.dem.engine.stability import pair_stiffness
from calcidem.dem.kernels.layout import FIRST_ARM, NORMAL_X, NORMAL_Y, SECOND_ARM, Flags, Floats, Integers

_GROUND = 1e-9
"""Stiffness that holds each disk to the mean strain, over the median one of a contact: what hangs on nothing stays."""


def shear_modulus(state: State, edges: Sequence[Integers], lane: int = 0) -> float:
    """Shear modulus of the rectangle between four rows of disks, Pa: that of shear waves much longer than a disk.

    The rows follow a simple shear, ``u_y = gamma x``, but turn freely; the disks between them come to rest. With
    ``E = 1/2 u K u`` of all contacts the modulus is ``2 E / (gamma^2 A)``. Contacts between two disks of one row lie on
    the rim of the area A and have half of their stiffness. All stick, with the stiffness that they have in the state;
    contacts with walls, which move along with the rows, do not count.

    Parameters
    ----------
    state
        With all its bonds intact.
    edges
        Indices in the scene of the disks of the left, right, lower and upper row; no row is empty.
    lane
        Which sample.

    Raises
    ------
    ValueError
        If a bond is broken, no disk touches another, or a row is empty.

    Notes
    -----
    Displacements prescribed all around make a finite sample slightly too stiff, the less so the larger it is (Huet
    1990, doi:10.1016/0022-5096(90)90041-2). The factorization is SuperLU's, whose last bits depend on the processor.
    """
    pairs = state.assembly.pairs
    whole = bool(np.all((pairs.cemented ^ pairs.intact) >> np.uint32(lane) & 1 == 0))
    require(whole, "state", "with broken bonds", "their contacts have no one stiffness")
    strain_matrix, stiffness = contact_springs(state, lane)
    require(bool(np.any(stiffness > 0.0)), "state", "without contacts", "give disks that touch")
    affine, in_row, area = _mean_shear(state, edges)
    on_rim = np.any(in_row[:, pairs.first] & in_row[:, pairs.second], axis=0)
    stiffness = np.where(np.tile(on_rim, 3), 0.5, 1.0) * stiffness
    free = np.column_stack([~in_row.any(axis=0)] * 2 + [np.ones(state.scene.count, dtype=bool)]).ravel()
    matrix = strain_matrix.T @ sparse.diags_array(stiffness) @ strain_matrix
    ground = _GROUND * float(np.median(stiffness[stiffness > 0.0])) * sparse.eye_array(int(free.sum()))
    factors = splu(
        (matrix[free][:, free] + ground).tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    moved = affine.copy()
    moved[free] -= factors.solve((matrix @ affine)[free])
    return float(stiffness @ (strain_matrix @ moved) ** 2 / area)


def contact_springs(state: State, lane: int) -> tuple[sparse.csr_array, Floats]:
    """Approach, slide and roll of each pair from the motion of the disks, (3 M, 3 N), and stiffnesses (3 M,), N/m.

    A disk moves by x, y and radius times rotation, in memory order.
    """
    pairs, radius = state.assembly.pairs, state.assembly.grains.radius.astype(float)
    depth = None if state.features.linear else overlaps(state)
    normal, shear, twist = (
        stiffness[:, lane]
        for stiffness in pair_stiffness(state.assembly, state.features, state.scene.sand.shear_ratio, depth)
    )
    if state.scene.sand.friction == 0.0:
        shear = np.where(pairs.cemented >> np.uint32(lane) & 1, shear, 0.0)
    geometry = pairs.geometry.astype(float)
    n_x, n_y = geometry[:, NORMAL_X], geometry[:, NORMAL_Y]
    one, none = np.ones(len(n_x)), np.zeros(len(n_x))
    first, second = radius[pairs.first], radius[pairs.second]
    blocks = [  # what x, y and radius times rotation of the first and of the second disk contribute
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


def _mean_shear(state: State, edges: Sequence[Integers]) -> tuple[Floats, Flags, float]:
    """Motion (3 N,) of the disks in a shear of one, which of them are in each row (4, N), and the area between, m^2."""
    radius = state.assembly.grains.radius.astype(float)
    x, y = np.asarray(state.scene.x), np.asarray(state.scene.y)
    require(all(len(row) > 0 for row in edges), "edges", [len(row) for row in edges], "give disks to each row")
    left, right, lower, upper = edges
    area = float((x[right].mean() - x[left].mean()) * (y[upper].mean() - y[lower].mean()))
    order = state.assembly.order
    in_row = np.stack([np.isin(order, row) for row in edges])
    return np.column_stack([np.zeros(len(radius)), x[order], 0.5 * radius]).ravel(), in_row, area
