"""How far a wave of the linear regime leaves what constant stiffnesses stand for."""

import numpy as np

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.portable import length, three_halves
from calcidem.dem.kernels.layout import (
    FIRST_ARM,
    MOMENT,
    NORMAL,
    NORMAL_X,
    NORMAL_Y,
    OVERLAP,
    ROTATION,
    SECOND_ARM,
    SHEAR,
    Floats,
    X,
    Y,
)


def nonlinear_share(state: State) -> Floats:
    """(L,) share of the work of all contacts of disks that Hertz's and Coulomb's laws would change.

    It is the sum of ``|dF| |du|`` over that of ``F du``: du is the displacement between two disks since the start, F
    the force that constant stiffnesses answer with, dF what separates it from that of the contact laws, where contacts
    stiffen, open and slip. Cement is linear in either case. Zero in other regimes.
    """
    lanes = state.features.lanes
    if not state.features.linear:
        return np.zeros(lanes)
    pairs = state.assembly.pairs
    approach, slide, twist = _relative_displacements(state)
    overlap = pairs.geometry[:, OVERLAP, None].astype(float)
    hertz, rubbing = (values[:, None].astype(float) for values in (pairs.hertz, pairs.friction))
    stiff, shear_stiff = (pairs.tangent[:, column, None].astype(float) for column in (NORMAL, SHEAR))
    before, held = hertz * three_halves(np.maximum(overlap, 0.0)), pairs.shear.astype(float)
    pressed, sheared = before + stiff * approach, held - shear_stiff * slide
    normal = hertz * three_halves(np.maximum(overlap + approach, 0.0))
    shear = np.clip(sheared, -rubbing * normal, rubbing * normal)
    changed = length(normal - pressed, shear - sheared) * length(approach, slide)
    work = stiff * approach * approach + shear_stiff * slide * slide
    springs = pairs.bond.astype(float)
    if state.features.linear_group:
        springs[:, :MOMENT] += pairs.linear[:, :MOMENT]
    bound = springs[:, NORMAL, None] * approach * approach + springs[:, SHEAR, None] * slide * slide
    bound = bound + springs[:, MOMENT, None] * twist * twist
    intact = (pairs.intact[:, None] >> np.arange(lanes, dtype=np.uint32) & 1).astype(bool)
    total, otherwise = _lane_sums(np.where(intact, bound, work)), _lane_sums(np.where(intact, 0.0, changed))
    return np.asarray(otherwise / np.where(total > 0.0, total, 1.0))


def _lane_sums(values: Floats) -> Floats:
    """Sums (L,) over all pairs, in an order that does not hang on the number of lanes."""
    return np.asarray(np.ascontiguousarray(values.T).sum(axis=1))


def _relative_displacements(state: State) -> tuple[Floats, Floats, Floats]:
    """Approach, slide (m) and twist (rad) of the listed pairs since the start, second disk less first, each (M, L)."""
    pairs, moved = state.assembly.pairs, state.motion.displacement.astype(float)
    first, second = moved[pairs.first], moved[pairs.second]
    n_x, n_y, first_arm, second_arm = (
        pairs.geometry[:, column, None].astype(float) for column in (NORMAL_X, NORMAL_Y, FIRST_ARM, SECOND_ARM)
    )
    apart = second - first
    slide = n_x * apart[:, Y] - n_y * apart[:, X] - first_arm * first[:, ROTATION] - second_arm * second[:, ROTATION]
    return -(n_x * apart[:, X] + n_y * apart[:, Y]), slide, apart[:, ROTATION]
