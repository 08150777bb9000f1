from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import GROUPED, HERTZ, RADIUS, SOFT, SOFT_CEMENT, jumble, throw

from calcidem.dem.engine import state as state_module
from calcidem.dem.engine.assembly import assemble, listed_pairs, near_pairs
from calcidem.dem.engine.leapfrog import State, _renew_neighbours
from calcidem.dem.engine.readout import contact_forces
from calcidem.dem.engine.scene import Bonds, Law, Scene, Wall
from calcidem.dem.engine.state import advance, choose_features, start
from calcidem.dem.kernels.layout import DISTANCE, NORMAL_X, NORMAL_Y


@given(st.integers(0, 2**20), st.integers(2, 40), st.floats(0.0, 2.0))
def test_near_pairs_are_those_that_looking_at_all_pairs_finds(seed: int, count: int, skin: float) -> None:
    """The tree search lists each pair whose rims are nearer than the skin once, sorted, and no other."""
    generator = np.random.default_rng(seed)
    centres = generator.uniform(0.0, 10.0, (count, 2))
    radius = generator.uniform(0.1, 1.5, count)
    expected = [
        [i, j]
        for i in range(count)
        for j in range(i + 1, count)
        if np.hypot(*(centres[j] - centres[i])) - radius[i] - radius[j] < skin
    ]
    np.testing.assert_array_equal(near_pairs(centres, radius, skin), np.array(expected).reshape(-1, 2))


@given(st.integers(0, 2**20), st.integers(2, 40), st.sampled_from([0.0, 1e-3, 0.3, 5.0]))
def test_pairs_near_in_several_samples_are_those_of_each_alone(seed: int, count: int, apart: float) -> None:
    """One search for all samples finds what a search in each finds together, however far apart the samples are."""
    generator = np.random.default_rng(seed)
    radius = generator.uniform(0.5, 0.7, count)
    centres = generator.uniform(0.0, 10.0, (count, 2, 1)) + apart * generator.uniform(-1.0, 1.0, (count, 2, 3))
    each = [near_pairs(centres[:, :, sample], radius, 0.2) for sample in range(3)]
    np.testing.assert_array_equal(near_pairs(centres, radius, 0.2), np.unique(np.concatenate(each), axis=0))


@pytest.mark.parametrize("axis", [0, 1])
def test_a_pair_that_is_near_in_one_sample_is_found_along_either_axis(axis: int) -> None:
    """Two disks that touch in one sample and are two radii apart in the other."""
    centres = np.zeros((2, 2, 2))
    centres[1, axis] = 1.2, 2.5
    np.testing.assert_array_equal(near_pairs(centres, np.full(2, 0.6), 0.1), [[0, 1]])


def test_the_pair_list_names_every_pair_once_and_knows_its_rows() -> None:
    """Row i of the list holds the pairs whose first disk is i; contacts keep the geometry of the scene."""
    scene = jumble(1, 25)
    assembly = assemble(scene, np.column_stack([scene.x, scene.y])[:, :, None], 0.1 * RADIUS, 1, "float64")
    pairs = listed_pairs(assembly)
    assert np.all(pairs[:, 0] < pairs[:, 1])
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    ends = assembly.order[pairs]
    apart = np.column_stack([scene.x, scene.y])[ends[:, 1]] - np.column_stack([scene.x, scene.y])[ends[:, 0]]
    geometry = assembly.pairs.geometry
    np.testing.assert_allclose(geometry[:, [NORMAL_X, NORMAL_Y]] * geometry[:, DISTANCE, None], apart, rtol=1e-12)


@pytest.mark.parametrize("law", ["linear", "finite"])
@pytest.mark.parametrize("across", [False, True])
def test_what_samples_share_is_what_each_would_find(law: Law, across: bool) -> None:
    """Samples begun from their packing without cement have the arrays and the step that they have alone, to the bit.

    Also where cement spans a gap, of which the packing's list knows nothing.
    """
    bare = replace(jumble(1, 25), load=None)
    unwatched = {"skin_fraction": 0.01, "steps_per_contact": 0.0}  # which needs no kernel
    single = start(bare, law=law, **unwatched)
    pairs = single.assembly.order[listed_pairs(single.assembly)][::2]
    first, second = ([0, 24] if across else pairs[0]), pairs[-1]
    bonds = Bonds(np.vstack([pairs, first, second]), SOFT_CEMENT, lanes=np.arange(len(pairs) + 2) % 7 + 1)
    scene = replace(bare, bonds=bonds, load=np.full((25, 3), 1e-3))
    features = choose_features(scene, law, 2)
    alone = start(scene, features=features, **unwatched)
    shared = start(scene, features=features, single=single, **unwatched)
    np.testing.assert_array_equal(shared.time_step, alone.time_step)
    for name in ("grains", "pairs", "wall_pairs", "walls"):
        for ours, theirs in zip(getattr(shared.assembly, name), getattr(alone.assembly, name), strict=True):
            np.testing.assert_array_equal(ours, theirs)


def colliding(monkeypatch: pytest.MonkeyPatch, skin: float, lanes: int = 1) -> State:
    """Two heaps that fly into each other and scatter, with pairs listed up to a skin."""
    monkeypatch.setattr(state_module, "SKIN", skin)
    left, right = jumble(1, 12, walls=False), jumble(2, 12, walls=False)
    x = np.concatenate([left.x, np.asarray(right.x) + 9.0 * RADIUS])
    y, radius = np.concatenate([left.y, right.y]), np.concatenate([left.radius, right.radius])
    walls = (Wall((0.0, -1.1 * RADIUS), (0.0, 1.0), friction=0.4), Wall((0.0, 8.0 * RADIUS), (0.0, -1.0)))
    scene = Scene(x, y, radius, SOFT, damping=0.1, walls=walls)
    velocity, spin = throw(scene, 1, 0.3)
    velocity[:12, 0] += 1.0
    velocity[12:, 0] -= 1.0
    state = start(scene, features=replace(HERTZ, lanes=lanes), velocity=velocity, spin=spin, time_step=4e-7)
    state.motion.velocity[:, :2, lanes - 1] *= 1.0 if lanes == 1 else 0.8
    return advance(state, 12_000)


def test_renewing_the_pair_list_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disks that meet, rub and part again move as with a list of all pairs that is never renewed."""
    renewed, complete = colliding(monkeypatch, 0.2), colliding(monkeypatch, 60.0)
    assert len(complete.assembly.pairs.second) == 24 * 23 // 2
    assert len(renewed.assembly.pairs.second) < 100
    assert renewed.origin.any()  # the list was renewed on the way
    assert not complete.origin.any()
    assert np.hypot(*(renewed.position() - np.column_stack([renewed.scene.x, renewed.scene.y])).T).max() > RADIUS
    # A pair that does not touch adds zero forces, which change nothing.
    np.testing.assert_array_equal(renewed.position(), complete.position())
    np.testing.assert_array_equal(renewed.spin(), complete.spin())


@pytest.mark.full
def test_lanes_that_go_different_ways_share_a_list_that_serves_both(monkeypatch: pytest.MonkeyPatch) -> None:
    """With two samples that drift apart each still moves as with a list of all pairs."""
    renewed, complete = colliding(monkeypatch, 0.2, lanes=2), colliding(monkeypatch, 60.0, lanes=2)
    assert np.abs(renewed.position(0) - renewed.position(1)).max() > 0.2 * RADIUS
    np.testing.assert_array_equal(renewed.motion.displacement, complete.motion.displacement)


def test_histories_survive_a_renewal() -> None:
    """Bonds, shear forces and roots of pairs and walls are the same before and after a new list."""
    scene = jumble(6, 20, share_bonded=0.5, damping=0.2)
    velocity, spin = throw(scene, 6, 0.01)
    state = advance(start(scene, features=GROUPED, velocity=velocity, spin=spin), 200)
    before, after = contact_forces(state), contact_forces(_renew_neighbours(state))
    for name in ("pairs", "overlap", "normal", "shear", "moment", "bonded"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    fresh = _renew_neighbours(state).assembly.wall_pairs
    old = state.assembly.wall_pairs
    assert old.shear.any()
    assert sorted(fresh.shear[fresh.shear != 0.0]) == sorted(old.shear[old.shear != 0.0])


def test_a_wall_finds_disks_that_it_reaches_later() -> None:
    """A wall that comes from afar pushes disks that lie still."""
    wall = Wall((0.0, 0.0), (0.0, 1.0), velocity=(1.0, 0.0))
    scene = Scene(np.zeros(1), np.array([5.0 * RADIUS]), np.array([RADIUS]), SOFT, walls=(wall,))
    state = advance(start(scene, features=HERTZ, time_step=1e-6), 6000)
    # An elastic impact on a heavy wall throws the disk ahead at twice the speed of the wall, the second time too.
    assert state.velocity()[0, 1] == pytest.approx(2.0, rel=1e-3)


def test_far_disks_do_not_make_the_list_long_when_a_wall_travels() -> None:
    """A wall that has moved far does not widen the list of pairs of disks."""
    scene = jumble(2, 16, walls=False)
    far = replace(scene, walls=(Wall((0.0, -1.0), (0.0, 1.0), velocity=(1.0, 0.0)),), damping=0.9)
    state = advance(start(far, features=HERTZ), 800)
    assert state.wall_origin.any()
    assert len(state.assembly.pairs.second) < 60
