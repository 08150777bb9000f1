"""How far a wave of the linear regime leaves what constant stiffnesses stand for."""

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

_ALL = slice(None)


class Nonlinearity(NamedTuple):
    """What Hertz's and Coulomb's laws would change in a wave of the linear regime; zero in other regimes.

    Each is (L,), or the number of one sample.

    Attributes
    ----------
    share
        Sum of ``|dF| |du|`` over that of ``F du`` of all contacts of disks: du is the displacement between two disks
        since the start, F the force that constant stiffnesses add, dF what separates it from that of the contact laws,
        where contacts stiffen, open and slip. Cement is linear in either case.
    softening
        Part of its stiffness that the sample may lose by slip, see `nonlinearity`.
    rescaling
        Work of the shear forces that contacts already bear and would lose where the wave unloads them (shear rescaling
        mode 1, `laws.rescale_shear`), each taken as positive, over that of ``F du``. It goes with the loads of the
        packing, not with the amplitude.
    """

    share: Floats | float = 0.0
    softening: Floats | float = 0.0
    rescaling: Floats | float = 0.0


def nonlinearity(state: State, lanes: Integers | slice = _ALL) -> Nonlinearity:
    """What the contact laws would change at the present displacements, in all lanes or in some.

    A contact with more shear than its friction bears slips before the wave comes: it begins at its limit here.

    A wave whose contacts lack the part s of its work by slip has s less stiffness as long as it moves the disks the
    same way (Rayleigh's quotient). But they give way where a contact slips: without one component of a contact whose
    share of its own deformation is taken by the others to the part p, the energy falls by 1 / (1 - p) times as much.
    The mean of p over all components is that of degrees of freedom over components (trace of a projection; Calladine
    1978, doi:10.1016/0020-7683(78)90052-5), so softening is s over the part of the components that is spare. At
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
    lost = _lane_sums(np.where(intact, 0.0, np.abs(contacts.held * _rescaled_part(contacts) * contacts.slide)))
    return Nonlinearity(share, softening, lost / total)


class _StrainedContacts(NamedTuple):
    """Contacts of listed pairs of disks in some lanes, with what Hertz's and Coulomb's laws say of them; SI.

    Lanes come first, as everywhere in this module: what all lanes share meets a row of contacts, not a row of lanes.

    Attributes
    ----------
    approach, slide, twist
        (L, M) m, m and rad, as `_relative_displacements`.
    overlap
        (M,) before the wave, m.
    stiffness, shear_stiffness
        (M,) N/m, constant.
    before, normal
        (M,) and (L, M) normal force before the wave and now, N.
    installed, held
        (L, M) shear force before the wave, N: as the packing left it, and no more than friction bears.
    limit
        (L, M) what friction bears now, N.
    """

    approach: Floats
    slide: Floats
    twist: Floats
    overlap: Floats
    stiffness: Floats
    shear_stiffness: Floats
    before: Floats
    normal: Floats
    installed: Floats
    held: Floats
    limit: Floats


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
    """(L, M) which listed pairs are cemented."""
    lane = np.arange(state.features.lanes, dtype=np.uint32)[lanes]
    return np.asarray((state.assembly.pairs.intact >> lane[:, None]) & 1, dtype=bool)


def _spring_work(state: State, contacts: _StrainedContacts, intact: Flags) -> Floats:
    """(L,) ``F du`` of constant stiffnesses over all contacts, positive: 1 where nothing moved."""
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


def _rescaled_part(contacts: _StrainedContacts) -> Floats:
    """(L, M) part of the shear force that shear rescaling takes from a contact that a wave unloads."""
    overlap, approach = contacts.overlap, contacts.approach
    change = np.divide(approach, overlap, out=np.zeros_like(approach), where=overlap > 0.0)
    return np.asarray(1.0 - np.sqrt(np.clip(1.0 + change, 0.0, 1.0)))


def _spare_share(state: State, intact: Flags, slipping: Flags) -> Floats:
    """(L,) 1 - degrees of freedom / components of contact forces; ``intact`` and ``slipping`` are (L, M).

    A contact has a normal and a shear force, one that slips a normal force alone, a bond a moment, too. Disks that
    lean on one thing at most bear nothing.
    """
    pairs, wall_pairs, grains = state.assembly.pairs, state.assembly.wall_pairs, state.assembly.grains
    touching, leaning = pairs.geometry[:, OVERLAP] > 0.0, wall_pairs.overlap > 0.0
    sticking = (pairs.tangent[:, SHEAR] > 0.0) & ~slipping
    components = np.where(intact, 3, np.where(touching, 1 + sticking, 0)).sum(axis=1)
    components = components + (1 + (wall_pairs.tangent[leaning, SHEAR] > 0.0)).sum()
    across = np.flatnonzero((intact & ~touching).any(axis=0))  # few bonds span a gap: the rest is the same in all lanes
    disks = [pairs.first[touching], pairs.second[touching], wall_pairs.disk[leaning]]
    alike = np.bincount(np.concatenate(disks), minlength=len(grains.radius))
    neighbours = np.repeat(alike[None], len(intact), axis=0)
    for disk in (pairs.first[across], pairs.second[across]):
        np.add.at(neighbours.T, disk, intact[:, across].T)
    moving = np.count_nonzero((grains.inverse_mass > 0.0) & (neighbours > 1), axis=1)
    return np.asarray(1.0 - 3.0 * moving / np.maximum(components, 1))


def slipped_force(state: State, transmitter: int) -> Floats:
    """(L,) part of the force of a wall that its contacts cannot pass on, since they would slip; linear regime alone."""
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
    """Sums (L,) over all pairs (L, M), in an order that does not hang on the number of lanes."""
    return np.asarray(np.ascontiguousarray(values).sum(axis=1))


def _relative_displacements(state: State, lanes: Integers | slice) -> tuple[Floats, Floats, Floats]:
    """Approach, slide (m) and twist (rad) of the listed pairs since the start, second disk less first, each (L, M)."""
    pairs, moved = state.assembly.pairs, state.motion.displacement[..., lanes].astype(float)
    moved = np.ascontiguousarray(moved.transpose(1, 2, 0))
    first, second = np.take(moved, pairs.first, axis=2), np.take(moved, pairs.second, axis=2)
    n_x, n_y, first_arm, second_arm = (
        pairs.geometry[:, column].astype(float) for column in (NORMAL_X, NORMAL_Y, FIRST_ARM, SECOND_ARM)
    )
    apart = second - first
    slide = n_x * apart[Y] - n_y * apart[X] - first_arm * first[ROTATION] - second_arm * second[ROTATION]
    return -(n_x * apart[X] + n_y * apart[Y]), slide, apart[ROTATION]
