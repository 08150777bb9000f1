"""One sample whose pairs are computed eight at once: not a bit differs from one pair after the other."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes import ACCOUNT, BONDED, GROUPED, HERTZ, LINEAR, SOFT_CEMENT, jumble, throw

from calcidem.dem.engine import leapfrog
from calcidem.dem.engine.leapfrog import State, plan_bundles
from calcidem.dem.engine.scene import Bonds, Law, Precision, Scene
from calcidem.dem.engine.state import advance, choose_features, start
from calcidem.dem.kernels.layout import ABREAST, Features

STEPS = 150
DISKS = 45  # no multiple of eight
WEAK = replace(SOFT_CEMENT, tensile_strength=1e5, cohesion=1e5)


def heap(features: Features) -> Scene:
    """Heap between walls, one of which moves, under gravity; some pairs are cemented, too weakly for what comes."""
    cemented: dict[str, Any] = {"share_bonded": 0.6, "cement": WEAK} if features.bonds else {}
    scene = jumble(3, DISKS, damping=0.2, gravity=(3.0, -9.81), rescaling=features.rescaling, **cemented)
    return replace(scene, rotation=features.rotation)


def flown(features: Features, precision: Precision = "float64") -> State:
    """The heap some steps after it was thrown about."""
    scene = heap(features)
    velocity, spin = throw(scene, 3)
    begun = start(scene, features=features, velocity=velocity, spin=spin, precision=precision, time_step=2e-7)
    return advance(begun, STEPS)


def kernel_bytes(state: State) -> list[bytes]:
    """Everything the kernel changes, bit by bit."""
    pairs, wall_pairs, walls = state.assembly.pairs, state.assembly.wall_pairs, state.assembly.walls
    arrays = [*state.motion, pairs.shear, pairs.root, pairs.bond_force, pairs.intact]
    arrays += [wall_pairs.shear, wall_pairs.root, walls.motion, walls.reaction]
    return [array.tobytes() for array in arrays]


@pytest.mark.parametrize(
    ("features", "precision"),
    [
        pytest.param(HERTZ, "float64", marks=pytest.mark.full),
        pytest.param(BONDED, "float64", marks=pytest.mark.full),
        pytest.param(GROUPED, "float64", marks=pytest.mark.full),
        pytest.param(BONDED, "float32", marks=pytest.mark.full),
        pytest.param(replace(HERTZ, slip=False, rescaling=False), "float64", marks=pytest.mark.full),
        pytest.param(replace(HERTZ, rotation=False), "float64", marks=pytest.mark.full),
        pytest.param(LINEAR, "float64", marks=pytest.mark.full),
        pytest.param(LINEAR, "float32", marks=pytest.mark.full),
    ],
)
def test_eight_pairs_at_once_give_the_bits_of_one_after_the_other(
    features: Features, precision: Precision, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A heap that slides, rolls, opens, breaks its bonds and meets its walls moves the same to the last bit."""
    monkeypatch.setattr(leapfrog, "_SMALLEST_BLOCK", 3)  # several blocks even in a small heap
    bundled = replace(features, bundles=True)
    assert bundled.bundled
    together, in_turn = flown(bundled, precision), flown(features, precision)
    assert np.isfinite(together.motion.velocity).all()
    assert kernel_bytes(together) == kernel_bytes(in_turn)
    pairs = in_turn.assembly.pairs
    if features.slip:
        sliding = np.abs(pairs.shear[:, 0]) >= 0.999 * pairs.friction * pairs.hertz * pairs.root[:, 0] ** 3
        assert (sliding & (pairs.root[:, 0] > 1e-10)).sum() >= 5
    if features.breakage:
        assert 0 < pairs.intact.sum() < pairs.cemented.sum()


@pytest.mark.full
def test_an_account_is_summed_up_pair_by_pair() -> None:
    """Where energies are counted, bundles are not made, and nothing that moves differs."""
    counted = flown(replace(ACCOUNT, bundles=True, midpoint=True))
    assert counted.account.any()
    assert kernel_bytes(counted) == kernel_bytes(flown(BONDED))


@pytest.mark.parametrize("block", [8, 16, 200])
def test_every_pair_has_one_place_in_the_bundles_of_its_block(block: int) -> None:
    """Read through without what is filled up, the bundles are the list; none has pairs of two blocks."""
    pairs = start(heap(HERTZ), features=HERTZ).assembly.pairs
    bundles = plan_bundles(pairs, block, DISKS)
    count = len(pairs.first)
    assert bundles.pair.shape[1] == ABREAST
    np.testing.assert_array_equal(bundles.pair.ravel()[bundles.place], np.arange(count))
    assert len(bundles.place) + len(bundles.filling[0]) == bundles.pair.size
    blocks = pairs.first[bundles.pair] // block
    assert (blocks == blocks[:, :1]).all()
    assert bundles.start[-1] == len(bundles.pair)
    for begin in range(0, DISKS, block):
        assert (blocks[bundles.start[begin] :] >= begin // block).all()


def test_a_list_without_bonds_costs_nothing() -> None:
    """The features are those of a scene without cement."""
    scene = jumble(1, 9)
    empty = replace(scene, bonds=Bonds(np.empty((0, 2), dtype=np.int64), SOFT_CEMENT))
    laws: tuple[Law, ...] = ("linear", "finite")
    for law in laws:
        assert choose_features(empty, law) == choose_features(scene, law)


def test_scenes_of_some_hundred_disks_are_bundled() -> None:
    """The choice follows the number of disks, and leaves several samples and small scenes alone."""
    small, large = jumble(1, 9), jumble(1, 300)
    assert not choose_features(small, "finite").bundled
    assert choose_features(large, "finite").bundled
    assert choose_features(large, "linear").bundled
    assert choose_features(large, "finite", 8) == choose_features(small, "finite", 8)
