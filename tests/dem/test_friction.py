import numpy as np
import pytest
from scenes import HERTZ, RADIUS, SOFT

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.readout import wall_reactions
from calcidem.dem.engine.scene import Scene, Wall
from calcidem.dem.engine.state import advance, start

FRICTION = 0.4
WEIGHT = 1.0
STEPS = 4000


def disk_on_floor(pull: float, slope: float = 0.0) -> State:
    """Disk at rest on a rough plane, pressed on it by its weight and pulled along it."""
    coefficient = float(SOFT.hertz_coefficient(np.array(RADIUS)))
    depth = (WEIGHT / coefficient) ** (2.0 / 3.0)
    n = np.array([-np.sin(slope), np.cos(slope)])
    t = np.array([-n[1], n[0]])
    floor = Wall((0.0, 0.0), (float(n[0]), float(n[1])), friction=FRICTION)
    place = (RADIUS - depth) * n
    load = np.append(pull * t - WEIGHT * n, 0.0)
    scene = Scene(place[:1], place[1:], np.array([RADIUS]), SOFT, walls=(floor,), load=load[None])
    return start(scene, features=HERTZ, step_fraction=0.3, steps_per_contact=0.0)  # it rests on the floor


def along(state: State, slope: float = 0.0) -> float:
    """Velocity along the tangent of the floor, half a step before the present time."""
    return float(state.velocity()[0] @ [-np.cos(slope), -np.sin(slope)])


@pytest.mark.parametrize(
    "slope", [pytest.param(0.0, marks=pytest.mark.full), 0.7, pytest.param(2.5, marks=pytest.mark.full)]
)
def test_a_disk_pulled_hard_slides_with_the_friction_of_its_weight(slope: float) -> None:
    """Beyond a pull of 3 mu N it slips: a = (P - mu N) / m, while friction spins it at mu N R / I."""
    pull = 5.0 * FRICTION * WEIGHT
    state = disk_on_floor(pull, slope)
    mass, inertia = state.scene.mass[0], state.scene.inertia[0]
    state = advance(state, STEPS // 2)
    middle = along(state, slope), state.spin()[0]
    tangent = np.array([np.cos(slope), np.sin(slope)])
    state = advance(state, STEPS // 2)
    time = STEPS // 2 * state.time_step[0]
    acceleration = (pull - FRICTION * WEIGHT) / mass
    assert (along(state, slope) - middle[0]) / time == pytest.approx(acceleration, rel=1e-6)
    # The force acts in the middle of the overlap.
    arm = 0.5 * (RADIUS + np.hypot(*state.position()[0] - state.position()[0] @ tangent * tangent))
    assert (state.spin()[0] - middle[1]) / time == pytest.approx(FRICTION * WEIGHT * arm / inertia, rel=1e-6)


def test_a_disk_pulled_gently_rolls() -> None:
    """Below 3 mu N it rolls: a = 2 P / (3 m), a third of the pull is borne by friction."""
    pull = 1.5 * FRICTION * WEIGHT
    state = disk_on_floor(pull)
    mass = state.scene.mass[0]
    state = advance(state, STEPS)
    # The contact spring swings about rolling; its amplitude falls behind the growing velocity as 1 / steps.
    assert along(state) / state.time[0] == pytest.approx(2.0 * pull / (3.0 * mass), rel=5e-3)
    assert along(state) == pytest.approx(state.spin()[0] * RADIUS, rel=5e-3)


@pytest.mark.parametrize("pull", [0.5, *(pytest.param(pull, marks=pytest.mark.full) for pull in (1.1, 8.0)), 3.0])
def test_friction_never_exceeds_its_coefficient_times_the_normal_force(pull: float) -> None:
    """|F_s| <= mu F_n at every step, sticking or slipping, also while the disk bounces."""
    state = disk_on_floor(pull)
    state.motion.velocity[:, 1] = -0.02
    for _ in range(300):
        state = advance(state, 3)
        normal, shear = wall_reactions(state)[0]
        assert abs(shear) <= FRICTION * normal * (1.0 + 1e-15)


def test_the_floor_feels_what_the_disk_gives() -> None:
    """The reaction of a wall is opposite to the force on the disk: weight inwards, friction along the pull."""
    state = advance(disk_on_floor(5.0 * FRICTION * WEIGHT), 100)
    normal, shear = wall_reactions(state)[0]
    assert normal == pytest.approx(WEIGHT, rel=1e-9)
    assert shear == pytest.approx(FRICTION * WEIGHT, rel=1e-9)
