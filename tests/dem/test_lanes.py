from dataclasses import replace

import numpy as np
import pytest
from scenes import GROUPED, jumble, throw

from calcidem.dem.engine import leapfrog
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.scene import Bonds, Precision, Scene
from calcidem.dem.engine.state import UnstableRunError, advance, start
from calcidem.dem.kernels.layout import Features, Floats, Integers

WIDTH = 8
EIGHT = replace(GROUPED, lanes=WIDTH)
STEPS = 150
STEP = 2e-7


def scene_of(bits: Integers | None = None) -> Scene:
    """Bonded heap; ``bits`` say in which lanes each bond is."""
    scene = jumble(11, 20, share_bonded=0.99, damping=0.2)
    assert scene.bonds is not None
    lanes = np.random.default_rng(3).integers(0, 2, len(scene.bonds.pairs)).astype(np.uint32) if bits is None else bits
    return replace(scene, bonds=Bonds(scene.bonds.pairs, scene.bonds.cement, lanes))


def begun(
    scene: Scene, velocities: dict[int, Floats], features: Features = EIGHT, precision: Precision = "float64"
) -> State:
    """The scene at time zero; lanes without a velocity begin at rest."""
    state = start(scene, features=features, time_step=STEP, precision=precision)
    for lane, velocity in velocities.items():
        state.motion.velocity[:, :, lane] = velocity[state.assembly.order]
    return state


def run(
    scene: Scene, velocities: dict[int, Floats], features: Features = EIGHT, precision: Precision = "float64"
) -> State:
    """The scene some steps later."""
    return advance(begun(scene, velocities, features, precision), STEPS)


def thrown(scene: Scene, seed: int) -> Floats:
    """Velocities and spins (N, 3)."""
    velocity, spin = throw(scene, seed)
    return np.column_stack([velocity, spin])


def lane_bytes(state: State, lane: int) -> list[bytes]:
    """Everything the kernel changes in one lane, bit by bit."""
    pairs = state.assembly.pairs
    arrays = [
        state.motion.displacement,
        state.motion.velocity,
        pairs.bond_force,
        pairs.shear,
        pairs.root,
        state.assembly.walls.reaction,
    ]
    intact = pairs.intact >> np.uint32(lane) & 1
    return [np.ascontiguousarray(array[..., lane]).tobytes() for array in arrays] + [intact.tobytes()]


@pytest.mark.parametrize(
    ("lane", "features"),
    [(0, EIGHT), (3, EIGHT), (7, EIGHT), pytest.param(3, replace(EIGHT, linear_group=False), marks=pytest.mark.full)],
)
def test_the_bits_of_a_lane_depend_neither_on_its_place_nor_on_the_other_lanes(lane: int, features: Features) -> None:
    """A sample gives the same bits alone in a batch, in any lane, and beside samples that are all different."""
    alone = scene_of()
    assert alone.bonds is not None
    bonded = alone.bonds.bits
    mine = thrown(alone, 1)
    filled = scene_of(bonded * np.uint32(2**WIDTH - 1))  # lanes that are not used repeat the first
    reference = lane_bytes(run(filled, {0: mine}, features), 0)
    others = np.random.default_rng(lane).integers(0, 256, len(bonded)).astype(np.uint32) & ~np.uint32(1 << lane)
    crowd = {other: thrown(alone, 50 + other) for other in range(WIDTH)}
    crowded = run(scene_of(others | bonded << np.uint32(lane)), {**crowd, lane: mine}, features)
    assert lane_bytes(crowded, lane) == reference


def test_a_lane_that_blows_up_leaves_the_others_alone() -> None:
    """NaN and infinity in one lane do not reach its neighbours, though a run with them is refused."""
    scene = scene_of()
    mine = thrown(scene, 1)
    wild = np.full((scene.count, 3), np.inf)
    wild[::3] = np.nan
    blown_up = {0: mine, 1: wild, 5: 1e200 * mine}
    with pytest.raises(UnstableRunError, match="blown up"):
        run(scene, blown_up)
    # The kernel itself, which nobody watches: it goes on.
    states = [leapfrog.start_leapfrog(begun(scene, velocities)) for velocities in ({0: mine}, blown_up)]
    alone, state = (leapfrog.run_in_place(state, STEPS, leapfrog.no_recording(state)) for state in states)
    assert lane_bytes(state, 0)[:2] == lane_bytes(alone, 0)[:2]
    assert not np.isfinite(state.velocity(1)).any()


def test_one_lane_gives_what_eight_give() -> None:
    """A kernel of width 1 and one of width 8 agree to the last bit."""
    scene = scene_of()
    mine = thrown(scene, 1)
    wide = run(scene, {0: mine})
    narrow = run(scene, {0: mine}, GROUPED)
    np.testing.assert_array_equal(narrow.velocity(), wide.velocity())


@pytest.mark.full
def test_single_precision_follows_double_precision() -> None:
    """In float32 the same heap moves the same to 1e-3 of its speed."""
    scene = scene_of()
    mine = thrown(scene, 1)
    double = run(scene, {0: mine})
    single = run(scene, {0: mine}, precision="float32")
    assert single.motion.velocity.dtype == np.float32
    # Overlaps of 1e-6 m change by displacements stored to 6e-8 of 1e-6 m; forces of 1e-7 accuracy over 150 steps, and a
    # few contacts that open or slip a step earlier or later.
    np.testing.assert_allclose(single.velocity(), double.velocity(), atol=1e-3 * np.abs(mine[:, :2]).max())


def test_speeds_too_small_for_normal_numbers_do_no_harm() -> None:
    """Motion of 1e-310 m/s, far below the smallest normal number, stays where it is and makes no NaN."""
    scene = replace(scene_of(), damping=0.0)
    state = run(scene, {1: np.full((scene.count, 3), 1e-310), 2: np.full((scene.count, 3), -1e-310)})
    for lane in (1, 2):
        np.testing.assert_array_equal(state.velocity(lane), state.velocity(3))


@pytest.mark.parametrize("together", [2, 4, 7])
def test_steps_in_flight_together_change_no_bit(together: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps that run through the disks one behind the other give the bits of one step after the other."""
    scene = scene_of()
    velocities = {lane: thrown(scene, lane) for lane in range(WIDTH)}
    monkeypatch.setattr(leapfrog, "_SMALLEST_BLOCK", 3)  # several blocks even in a small heap
    monkeypatch.setattr(leapfrog, "_STEPS_TOGETHER", 1)
    one_by_one = run(scene, velocities)
    monkeypatch.setattr(leapfrog, "_STEPS_TOGETHER", together)
    in_flight = run(scene, velocities)
    assert leapfrog._make_front(in_flight).levels == together
    assert 3 * leapfrog._make_front(in_flight).block <= scene.count
    for lane in range(WIDTH):
        assert lane_bytes(in_flight, lane) == lane_bytes(one_by_one, lane)
