"""Deviation of a wave in the linear regime from the nonlinear contact laws."""

from typing import NamedTuple

import numpy as np

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.portable import length, three_halves
from calcidem.dem.kernels.layout import (
    FIRST_ARM,
    MOMENT,
    NORMAL,
    NORMAL_PATH,
    NORMAL_X,
    NORMAL_Y,
    OVERLAP,
    ROTATION,
    SECOND_ARM,
    SHEAR,
    TANGENT_PATH,
    Flags,
    Floats,
    Integers,
    X,
    Y,
)
from calcidem.dem.wave.section import Nonlinearity


def nonlinearity(state: State, lanes: Integers | slice = slice(None)) -> Nonlinearity:
    """Changes by the contact laws at the present displacements, in all lanes or in some.

    A contact with more shear than friction permits slips before the wave arrives. It starts at its limit here.

    If slip removes the part s of a wave's work, the stiffness falls by s as long as the motion of the disks is the same
    (Rayleigh's quotient). But disks yield where a contact slips. Let the others take the part p of the share that a
    component of a contact has in its own deformation. Without it the energy falls by 1 / (1 - p) times as much. The
    mean of p over all components is degrees of freedom over components (trace of a projection; Calladine 1978,
    doi:10.1016/0020-7683(78)90052-5). Softening is therefore s over the redundant part of the components. At
    isostaticity there is no bound, and softening is infinite.
    """
    if not state.features.linear:
        return Nonlinearity(*np.zeros((len(Nonlinearity._fields), state.features.lanes))[:, lanes])
    contacts, intact = _strained_contacts(state, lanes), _intact_bonds(state, lanes)
    sheared = contacts.held - contacts.shear_stiffness * contacts.slide
    lacking = np.clip(sheared, -contacts.limit, contacts.limit) - sheared
    total = _spring_work(state, contacts, intact)
    slip = _lane_sums(np.where(intact, 0.0, np.abs(lacking * contacts.slide))) / total
    spare = _spare_share(state, intact, (lacking != 0.0) | (contacts.held != contacts.installed))
    softening = np.divide(slip, spare, out=np.where(slip > 0.0, np.inf, 0.0), where=spare > 0.0)
    changed = length(contacts.normal - contacts.before - contacts.stiffness * contacts.approach, lacking)
    share = _lane_sums(np.where(intact, 0.0, changed * length(contacts.approach, contacts.slide))) / total
    # Shear rescaling removes a part of the shear force from a contact that a wave unloads.
    overlap, approach = contacts.overlap, contacts.approach
    relative = np.divide(approach, overlap, out=np.zeros_like(approach), where=overlap > 0.0)
    rescaled = 1.0 - np.sqrt(np.clip(1.0 + relative, 0.0, 1.0))
    lost = _lane_sums(np.where(intact, 0.0, np.abs(contacts.held * rescaled * contacts.slide)))
    return Nonlinearity(share, softening, lost / total)


class _StrainedContacts(NamedTuple):
    """Contacts of listed pairs of disks in some lanes, with forces by Hertz's and Coulomb's laws; SI.

    As everywhere in this module, lanes are the first axis, so values common to all lanes broadcast along contacts.
    """

    approach: Floats
    slide: Floats
    twist: Floats
    """(L, M) m, m and rad, see `_relative_displacements`."""
    overlap: Floats
    """(M,) before the wave, m."""
    stiffness: Floats
    shear_stiffness: Floats
    """(M,) N/m, constant."""
    before: Floats
    normal: Floats
    """(M,) and (L, M) normal force before the wave and now, N."""
    installed: Floats
    held: Floats
    """(L, M) shear force before the wave, N: that of the packing, and the same limited by friction."""
    limit: Floats
    """(L, M) present friction limit, N."""


def _strained_contacts(state: State, lanes: Integers | slice) -> _StrainedContacts:
    """Contacts at the present displacements."""
    pairs = state.assembly.pairs
    approach, slide, twist = _relative_displacements(state, lanes)
    overlap = pairs.geometry[:, OVERLAP].astype(float)
    hertz, rubbing = (values.astype(float) for values in (pairs.hertz, pairs.friction))
    stiffness, shear_stiffness = (pairs.tangent[:, column].astype(float) for column in (NORMAL, SHEAR))
    before = hertz * three_halves(np.maximum(overlap, 0.0))
    normal = hertz * three_halves(np.maximum(overlap + approach, 0.0))
    installed = np.ascontiguousarray(pairs.shear[:, lanes].T.astype(float))
    held = np.clip(installed, -rubbing * before, rubbing * before)
    limit = rubbing * normal
    return _StrainedContacts(
        approach, slide, twist, overlap, stiffness, shear_stiffness, before, normal, installed, held, limit
    )


def _intact_bonds(state: State, lanes: Integers | slice) -> Flags:
    """(L, M) True for cemented pairs."""
    lane = np.arange(state.features.lanes, dtype=np.uint32)[lanes]
    return np.asarray((state.assembly.pairs.intact >> lane[:, None]) & 1, dtype=bool)


def _spring_work(state: State, contacts: _StrainedContacts, intact: Flags) -> Floats:
    """(L,) positive sum of ``F du`` with constant stiffnesses over all contacts; 1 without motion."""
    pairs = state.assembly.pairs
    springs = pairs.bond.T.astype(float)
    if state.features.linear_group:
        springs[:MOMENT] += pairs.linear.T[:MOMENT]
    approach, slide, twist = contacts.approach, contacts.slide, contacts.twist
    bound = springs[NORMAL] * approach * approach + springs[SHEAR] * slide * slide
    bound = bound + springs[MOMENT] * twist * twist
    bare = contacts.stiffness * approach * approach + contacts.shear_stiffness * slide * slide
    total = _lane_sums(np.where(intact, bound, bare))
    return np.where(total > 0.0, total, 1.0)


def _spare_share(state: State, intact: Flags, slipping: Flags) -> Floats:
    """(L,) 1 - degrees of freedom / components of contact forces; ``intact`` and ``slipping`` are (L, M).

    A contact has a normal and a shear force, a slipping contact only a normal force, and a bond also a moment. Disks
    with at most one contact carry nothing.
    """
    pairs, wall_pairs, grains = state.assembly.pairs, state.assembly.wall_pairs, state.assembly.grains
    touching, leaning = pairs.geometry[:, OVERLAP] > 0.0, wall_pairs.overlap > 0.0
    sticking = (pairs.tangent[:, SHEAR] > 0.0) & ~slipping
    components = np.where(intact, 3, np.where(touching, 1 + sticking, 0)).sum(axis=1)
    components = components + (1 + (wall_pairs.tangent[leaning, SHEAR] > 0.0)).sum()
    across = np.flatnonzero((intact & ~touching).any(axis=0))  # few bonds span a gap; the rest is common to all lanes
    disks = [pairs.first[touching], pairs.second[touching], wall_pairs.disk[leaning]]
    alike = np.bincount(np.concatenate(disks), minlength=len(grains.radius))
    neighbours = np.repeat(alike[None], len(intact), axis=0)
    for disk in (pairs.first[across], pairs.second[across]):
        np.add.at(neighbours.T, disk, intact[:, across].T)
    moving = np.count_nonzero((grains.inverse_mass > 0.0) & (neighbours > 1), axis=1)
    return np.asarray(1.0 - 3.0 * moving / np.maximum(components, 1))


def slipped_force(state: State, transmitter: int) -> Floats:
    """(L,) part of a wall's force that its contacts cannot transmit, since they would slip; linear regime only."""
    if not state.features.linear:
        return np.zeros(state.features.lanes)
    assembly, moved = state.assembly, state.motion.displacement
    pairs = assembly.wall_pairs
    here = np.flatnonzero((pairs.wall == transmitter) & (pairs.overlap > 0.0))
    disk, overlap = pairs.disk[here], pairs.overlap[here].astype(float)
    hertz, shear_stiff = pairs.hertz[here].astype(float), pairs.tangent[here, SHEAR].astype(float)
    normal_x, normal_y = assembly.walls.normal[transmitter].astype(float)
    path = assembly.walls.motion[transmitter, :, :, None].astype(float)
    x, y, turned = moved[disk].transpose(1, 2, 0).astype(float)
    away, along = normal_x * x + normal_y * y, normal_x * y - normal_y * x
    arm = assembly.grains.radius[disk].astype(float) - 0.5 * overlap
    shear = np.abs(shear_stiff * (along - path[TANGENT_PATH] - arm * turned))
    rubbing = np.minimum(assembly.walls.friction[transmitter], assembly.grains.friction[disk]).astype(float)
    limit = rubbing * hertz * three_halves(np.maximum(overlap + path[NORMAL_PATH] - away, 0.0))
    total = _lane_sums(shear)
    return np.asarray(_lane_sums(np.maximum(shear - limit, 0.0)) / np.where(total > 0.0, total, 1.0))


def _lane_sums(values: Floats) -> Floats:
    """Sums (L,) over all pairs (L, M), in an order independent of the number of lanes."""
    return np.asarray(np.ascontiguousarray(values).sum(axis=1))


def _relative_displacements(state: State, lanes: Integers | slice) -> tuple[Floats, Floats, Floats]:
    """Approach, slide (m) and twist (rad) of the listed pairs since the start, second minus first disk, each (L, M)."""
    pairs, moved = state.assembly.pairs, state.motion.displacement[..., lanes].astype(float)
    moved = np.ascontiguousarray(moved.transpose(1, 2, 0))
    first, second = np.take(moved, pairs.first, axis=2), np.take(moved, pairs.second, axis=2)
    n_x, n_y, first_arm, second_arm = (
        pairs.geometry[:, column].astype(float) for column in (NORMAL_X, NORMAL_Y, FIRST_ARM, SECOND_ARM)
    )
    apart = second - first
    slide = n_x * apart[Y] - n_y * apart[X] - first_arm * first[ROTATION] - second_arm * second[ROTATION]
    return -(n_x * apart[X] + n_y * apart[Y]), slide, apart[ROTATION]
