from dataclasses import replace

import numpy as np
import pytest
from scenes import LINEAR, RADIUS, SOFT_CEMENT, jumble, pair_scene

from calcidem.dem.engine.leapfrog import State, no_recording, run_kernel
from calcidem.dem.engine.scene import Bonds, Cement, Sand, Scene
from calcidem.dem.engine.stability import critical_time_step_of_disks, stiffest_disks
from calcidem.dem.engine.state import advance, choose_features, start
from calcidem.dem.kernels.layout import Floats

PAIR = Bonds(np.array([[0, 1]]), SOFT_CEMENT)
HELD = np.array([True, False])
SPEED = 1e-3


def oscillator(fraction: float, damping: float = 0.0, speed: float = SPEED) -> tuple[State, float]:
    """Disk on a bond to a held disk, kicked along the bond; the step as a part of 2 / omega, and omega."""
    scene = pair_scene(bonds=PAIR, held=HELD, damping=damping)
    stiffness = SOFT_CEMENT.bond_modulus + SOFT_CEMENT.linear_modulus  # 2 E R_min / (R1 + R2) of equal disks
    omega = np.sqrt(stiffness / scene.mass[1])
    velocity = np.array([[0.0, 0.0], [speed, 0.0]])
    state = start(scene, features=LINEAR, velocity=velocity)
    # Set here because `start` refuses a step above the limit.
    state = replace(state, time_step=np.array([fraction * 2.0 / omega]))
    return advance(state, 1), float(omega)


def track(state: State, steps: int) -> tuple[Floats, Floats]:
    """Displacement of the free disk at the steps, and velocity half a step before each."""
    place, speed = [], []
    for _ in range(steps):
        place.append(state.motion.displacement[1, 0, 0])
        speed.append(state.motion.velocity[1, 0, 0])
        run_kernel(state, 1, no_recording(state))
    return np.array(place), np.array(speed)


@pytest.mark.parametrize("fraction", [0.3, 0.9])
def test_the_leapfrog_energy_of_a_linear_oscillator_is_constant(fraction: float) -> None:
    """1/2 m v(k - 1/2) v(k + 1/2) + 1/2 k x(k)^2 does not change, whatever the step."""
    state, omega = oscillator(fraction)
    place, speed = track(state, 4000)
    energy = 0.5 * speed[:-1] * speed[1:] + 0.5 * omega**2 * place[:-1] ** 2
    # A random walk of 4000 roundings of 1e-16, of terms up to twice the energy at the largest step.
    np.testing.assert_allclose(energy, energy[0], rtol=1e-12 / (1.0 - fraction**2))


@pytest.mark.parametrize(
    "alpha", [pytest.param(0.1, marks=pytest.mark.full), 0.3, pytest.param(0.7, marks=pytest.mark.full)]
)
def test_local_damping_shrinks_each_half_cycle_by_a_known_factor(alpha: float) -> None:
    """Successive extremes of an oscillator have the ratio sqrt((1 - alpha) / (1 + alpha)).

    On the way in the spring pulls with (1 - alpha) of its force, on the way out with (1 + alpha): the speed v at the
    middle obeys v^2 = omega^2 (1 - alpha) A^2 = omega^2 (1 + alpha) A'^2.
    """
    state, omega = oscillator(0.001, damping=alpha)
    half_period = 0.5 * np.pi / omega * (1.0 / np.sqrt(1.0 - alpha) + 1.0 / np.sqrt(1.0 + alpha))
    place, _ = track(state, int(3.5 * half_period / state.time_step[0]))
    turns = np.flatnonzero((place[1:-1] - place[:-2]) * (place[2:] - place[1:-1]) < 0.0) + 1
    extremes = np.abs(place[turns])
    assert len(extremes) >= 3
    # The sign of the velocity is one half step late at each turn: a relative error of about omega dt = 2e-3, squared.
    np.testing.assert_allclose(extremes[1:] / extremes[:-1], np.sqrt((1.0 - alpha) / (1.0 + alpha)), rtol=1e-4)
    np.testing.assert_allclose(np.diff(turns) * state.time_step[0], half_period, rtol=5e-3)


@pytest.mark.parametrize("alpha", [0.0, 0.3, 1.0])
def test_local_damping_lowers_the_critical_step_by_the_root_of_one_plus_alpha(alpha: float) -> None:
    """An oscillator stays bounded just below 2 / (omega sqrt(1 + alpha)) and grows without bound just above."""
    below, above = (
        np.abs(track(oscillator(fraction / np.sqrt(1.0 + alpha), alpha)[0], 600)[0]) for fraction in (0.99, 1.02)
    )
    assert below.max() < 20.0 * RADIUS * 1e-3
    assert not above.max() < 1e3 * below.max()


def test_the_limit_that_start_reports_is_below_the_exact_one() -> None:
    """`State.critical_time_step` of a damped oscillator is within 50 to 100 % of 2 / (omega sqrt(1 + alpha))."""
    for alpha in (0.0, 0.3, 1.0):
        state, omega = oscillator(0.1, alpha)
        exact = 2.0 / (omega * np.sqrt(1.0 + alpha))
        assert 0.5 * exact < state.critical_time_step[0] <= exact


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_limit_is_that_of_the_disk_with_the_highest_frequency_of_all(share: float) -> None:
    """`critical_time_step_of_disks`, which looks at few, is 2 / omega of the largest of all, to the last bit."""
    for seed in range(20):
        scene = jumble(seed, count=40, share_bonded=share, damping=np.linspace(0.0, 1.0, 40))
        state = start(scene, features=choose_features(scene, "finite", 4), steps_per_contact=0.0)
        disks, of_all = stiffest_disks(scene, state.assembly, state.features, None, None, share=0.0)
        assert len(disks) == scene.count
        found = critical_time_step_of_disks(scene, state.assembly, state.features)
        assert np.array_equal(found, 2.0 / np.sqrt(of_all.max(axis=0)))
        assert np.all(found <= state.critical_time_step)


def test_cement_across_a_gap_has_arms_to_its_middle() -> None:
    """The bound of two disks and a bond is the largest eigenvalue of a 3 x 3 matrix with the arm R + gap / 2."""
    radius, gap = 1e-3, 4e-4
    bonds = Bonds(np.array([[0, 1]]), Cement())
    scene = Scene(np.array([0.0, 2.0 * radius + gap]), np.zeros(2), np.full(2, radius), Sand(), bonds=bonds)
    state = start(scene, law="linear")
    normal, shear, moment = state.assembly.pairs.bond[0].astype(float)
    along, turned = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, np.sqrt(2.0) * (1.0 + 0.5 * gap / radius)])
    matrix = normal * np.outer(along, along) + shear * np.outer(turned, turned)
    matrix[2, 2] += 2.0 * moment / radius**2
    limit = 2.0 / np.sqrt(2.0 * np.linalg.eigvalsh(matrix)[-1] / scene.mass[0])
    assert critical_time_step_of_disks(scene, state.assembly, state.features)[0] == pytest.approx(limit, rel=1e-9)
