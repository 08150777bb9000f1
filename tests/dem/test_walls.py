from dataclasses import replace

import numpy as np
import pytest
from scenes import HERTZ, LINEAR, RADIUS, SERVO, SOFT, jumble

from calcidem.dem.engine.leapfrog import State, no_recording, run_in_place, run_kernel
from calcidem.dem.engine.readout import net_forces, wall_reactions
from calcidem.dem.engine.scene import Scene, Wall
from calcidem.dem.engine.state import advance, start
from calcidem.dem.kernels.layout import NORMAL_PATH, Features, Recording

RECORDING = replace(HERTZ, recording=True)


def disk_between(friction: float, **options: object) -> Scene:
    """A disk squeezed between a floor and a lid; the floor slides."""
    walls = (
        Wall((0.0, 1e-6), (0.0, 1.0), friction=friction, velocity=(0.0, -1e-3)),
        Wall((0.0, 2.0 * RADIUS - 1e-6), (0.0, -1.0)),
    )
    return Scene(np.zeros(1), np.array([RADIUS]), np.array([RADIUS]), SOFT, walls=walls, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "features",
    [HERTZ, pytest.param(replace(HERTZ, slip=False), marks=pytest.mark.full), LINEAR],
    ids=["slip", "no slip", "linear"],
)
def test_a_smooth_wall_never_pulls(features: Features) -> None:
    """A wall without friction has no shear force, whether slip is checked or left out."""
    state = advance(start(disk_between(0.0), features=features), 50)
    assert state.velocity()[0, 0] == 0.0
    assert state.spin()[0] == 0.0


def test_a_rough_wall_drags_the_disk_along() -> None:
    """The tangent of a floor with normal up points to -x: a floor with negative tangential speed moves to +x."""
    state = advance(start(disk_between(0.5), features=HERTZ), 50)
    assert state.velocity()[0, 0] > 0.0
    assert state.spin()[0] > 0.0


def test_sand_without_friction_slides_in_the_linear_regime_too() -> None:
    """Contacts of frictionless sand have no shear stiffness in any law."""
    scene = replace(jumble(4, 9, walls=False), sand=replace(SOFT, friction=0.0))
    state = start(scene, features=LINEAR, spin=np.linspace(-1.0, 1.0, 9))
    np.testing.assert_allclose(advance(state, 20).spin(), np.linspace(-1.0, 1.0, 9), rtol=1e-15)


def test_a_servo_brings_its_wall_to_the_force_it_is_to_hold() -> None:
    """A lid that begins above a loose heap comes down and holds its force to 1e-6 when all is at rest."""
    heap = jumble(8, 16, walls=False)
    top, width = float(np.max(heap.y)) + 1.5 * RADIUS, float(np.max(heap.x)) + RADIUS
    walls = (
        Wall((-RADIUS, 0.0), (1.0, 0.0)),
        Wall((width, 0.0), (-1.0, 0.0)),
        Wall((0.0, -RADIUS), (0.0, 1.0)),
        Wall((0.0, top), (0.0, -1.0), servo_force=0.2, servo_speed=0.05),
    )
    state = start(replace(heap, walls=walls, damping=0.7), features=SERVO, step_fraction=0.3)
    state = advance(state, 40_000)
    assert state.assembly.walls.motion[3, NORMAL_PATH, 0] > 0.2 * RADIUS
    assert wall_reactions(state)[3, 0] == pytest.approx(0.2, rel=1e-6)
    # Smooth walls and a heap at rest: what presses on the floor is what presses on the lid.
    assert wall_reactions(state)[2, 0] == pytest.approx(0.2, rel=1e-4)
    assert np.abs(net_forces(state)[:, :2]).max() < 1e-4 * 0.2


def test_each_disk_belongs_to_the_wall_whose_span_holds_it() -> None:
    """Of several walls that make up one side only the one beside the disk touches it."""
    below = Wall((0.0, 0.0), (1.0, 0.0), span=(-np.inf, 0.0))
    above = Wall((0.0, 0.0), (1.0, 0.0), span=(0.0, np.inf))
    for y, wall in ((-2.0 * RADIUS, 0), (0.0, 1), (2.0 * RADIUS, 1)):
        scene = Scene(np.array([0.999 * RADIUS]), np.array([y]), np.array([RADIUS]), SOFT, walls=(below, above))
        assert np.flatnonzero(wall_reactions(start(scene, features=HERTZ))[:, 0]).tolist() == [wall]


def recorded(state: State, calls: list[int], stride: int, drive: np.ndarray) -> tuple[State, np.ndarray]:  # type: ignore[type-arg]
    """Samples of a run in several calls, with a driven floor."""
    samples = np.zeros((sum(calls) // stride, 1, 1))
    done = 0
    for steps in calls:
        nobody, listeners = np.zeros(0, dtype=np.int64), np.array([0])
        groups = np.array([0, 1])
        recording = Recording(drive, 0, nobody, done, stride, listeners, groups, np.array([0]), samples)
        state = run_in_place(state, steps, recording)
        done += steps
    return state, samples


@pytest.mark.full
def test_a_record_does_not_depend_on_how_a_run_is_cut_into_calls() -> None:
    """Drive and samples go on where the call before ended, also in the middle of a stride and after a new pair list."""
    floor = Wall((0.0, 0.0), (0.0, 1.0), friction=0.5)
    lid = Wall((0.0, 2.0 * RADIUS - 2e-6), (0.0, -1.0), friction=0.5)
    scene = Scene(np.zeros(1), np.array([RADIUS - 1e-6]), np.array([RADIUS]), SOFT, walls=(floor, lid))
    drive = -3.0 * np.sin(np.linspace(0.0, 3.0, 600))[:, None] ** 2

    def fresh() -> State:
        return start(scene, features=RECORDING, time_step=4e-7, velocity=np.array([[1.0, 0.0]]))

    whole, one = recorded(fresh(), [600], 7, drive)
    parts, several = recorded(fresh(), [100, 3, 250, 247], 7, drive)
    assert whole.origin.any()  # a new list was made on the way
    np.testing.assert_array_equal(one, several)
    np.testing.assert_array_equal(whole.position(), parts.position())
    assert one[:, 0].any()
    assert one[-1, 0] != 0.0


@pytest.mark.full
def test_a_run_without_a_recording_writes_none() -> None:
    """A state that could record advances without one and touches no memory beyond its own."""
    state = start(disk_between(0.5), features=RECORDING)
    plain = advance(start(disk_between(0.5), features=HERTZ), 100)
    np.testing.assert_array_equal(advance(state, 100).position(), plain.position())
    assert run_kernel(state, 5, no_recording(state)) == 5
