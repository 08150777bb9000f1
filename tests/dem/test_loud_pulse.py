"""Pulses of 5 m/s, which press contacts far harder than the packing did: what carries them, and what ends them."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scenes import HERTZ, RADIUS, SOFT, pair_scene

from calcidem.dem.engine.readout import unbalanced_ratio
from calcidem.dem.engine.scene import Cement, Sand
from calcidem.dem.engine.state import start
from calcidem.dem.kernels.layout import ROTATION, Floats, X, Y
from calcidem.dem.sample.compaction import make_packing
from calcidem.dem.sample.packing import PackingRule
from calcidem.dem.wave.experiment import Experiment, WaveRule
from calcidem.dem.wave.measurement import Measurement, measure
from calcidem.dem.wave.propagation import Recorder, cheap_limit, prepare_recorder, problems_of, unbalanced_speed
from calcidem.dem.wave.section import Section

LOUD, CONTENT, FREQUENCY = 5.0, 1.0, 2.4e4
STRESS = 3.0e5  # that carries it, Pa
SEEDS = (1, 2, 4)  # what reaches the receiver of other samples is too weak, or on no line


@lru_cache
def experiment(stress: float = STRESS, **rule: object) -> Experiment:
    """Some 280 disks under a stress (Pa), of which those at the left wall are driven at 5 m/s."""
    sizes = PackingRule(width=0.03, height=0.06, stress=stress, unbalanced_force_ratio=1e-5)
    wave = WaveRule(
        amplitude=LOUD,
        transmitter="driven",
        transmitter_half_width=0.01,
        receiver_half_width=0.012,
        boundary_thickness=0.012,
        listening_depth=0.006,
        law="finite",
    )
    return Experiment(
        make_packing(sizes, Sand(), np.random.default_rng(1)),
        cement=Cement(bond_stiffness_ratio=1.6),
        stiffness_factor=2.8,
        wave=replace(wave, **rule),  # type: ignore[arg-type]
        frequencies=((0.0, CONTENT), (0.3 * FREQUENCY, FREQUENCY)),
        is_checked=False,
    )


def measured(given: Experiment) -> list[Measurement]:
    """Measure every seed by itself: each combination of lanes is compiled anew."""
    return [measure(given, CONTENT, [seed], lanes=1)[0] for seed in SEEDS]


@pytest.mark.full
def test_loads_that_hold_a_packing_are_those_of_the_packing() -> None:
    """Samples of a batch share them, so neither cement nor time step of one may round them."""
    given = experiment()
    loads = [
        prepare_recorder(given, [given.ordering(seed).at(CONTENT).bonded], FREQUENCY, 1, lambda: None).state.scene.load
        for seed in SEEDS
    ]
    assert loads[0] is not None
    assert np.any(loads[0])
    assert all(np.array_equal(load, loads[0]) for load in loads[1:])


@pytest.mark.full
def test_a_sample_settles_before_its_disks_are_driven() -> None:
    """Cement that sets without force leaves contacts out of balance: the disks come to rest, driven ones with them."""
    given = replace(experiment(), installation="zero")
    placed = given.ordering(1).at(CONTENT).bonded
    state = prepare_recorder(given, [placed], FREQUENCY, 1, lambda: None).state
    assert state.features.driven
    assert unbalanced_ratio(state, 0) < given.wave.unbalanced_force_ratio
    assert np.abs(state.motion.displacement[:, Y]).max() > 0.0


@pytest.mark.full
def test_a_loud_sample_gives_the_same_bits_alone_and_among_others() -> None:
    """In a batch of eight lanes, wherever in it."""
    given = experiment()
    batch = measure(given, CONTENT, SEEDS[::-1], lanes=8)
    for one, another in zip(measured(given), batch[::-1], strict=True):
        assert one.vs == another.vs
        np.testing.assert_array_equal(one.section.across, another.section.across)


def prepared(given: Experiment) -> Recorder:
    """Recorder of one sample, before its pulse."""
    return prepare_recorder(given, [given.ordering(1).at(CONTENT).bonded], FREQUENCY, 1, lambda: None)


def recorded(given: Experiment, step_of_limit: float, limit: Floats | None = None) -> Section:
    """Send the pulse with a step over its limit at the start, for as long as it takes to cross the sample."""
    recorder = prepared(given)
    limit = recorder.state.critical_time_step if limit is None else limit
    recorder.stride = max(1, int(2e-7 / (step_of_limit * limit[0])))
    recorder.state = replace(recorder.state, time_step=step_of_limit * limit)
    return recorder.run(lambda section: section.duration > 1.5e-4, lambda: None)[0]


@pytest.mark.parametrize("part", [0.5, 0.8])
@pytest.mark.parametrize("above", [False, True])
def test_the_step_is_held_against_the_contacts_as_they_are_pressed_now(part: float, above: bool) -> None:
    """A Hertz contact's limit falls with the fourth root of its overlap: a step is too long from part^-4 of it on."""
    overlap = 1e-4 * RADIUS
    state = start(pair_scene(-overlap, sand=SOFT), features=HERTZ, step_fraction=part, steps_per_contact=0.0)
    state.motion.displacement[1, X, 0] = -overlap * (part**-4 * (1.02 if above else 0.98) - 1.0)
    (problem,) = problems_of(state, amplitude=1.0, overlap=overlap)
    assert ("above the stability limit of the pressed contacts" in problem) == above


@pytest.mark.parametrize("speed", [31.0, np.nan])
def test_the_fastest_disk_is_named_by_its_place_not_by_its_spin(speed: float) -> None:
    """Above 30 times the amplitude in either direction, or not a number, while the other disk spins."""
    state = start(pair_scene(-1e-4 * RADIUS, sand=SOFT), features=HERTZ)
    state.motion.velocity[0, ROTATION, 0] = 1e4
    assert problems_of(state, amplitude=1.0, overlap=RADIUS) == [""]
    state.motion.velocity[1, Y, 0] = -speed
    (problem,) = problems_of(state, amplitude=1.0, overlap=RADIUS)
    x, y = state.scene.x[1], state.scene.y[1]
    assert problem == f"the disk at ({x:.5g}, {y:.5g}) m moves at {speed:.3g} m/s after 0 steps"


def test_the_cheap_limit_of_two_equal_disks_is_exact() -> None:
    """Their contact counts twice, as it is now and as at the start: the limit is that of twice the stiffness."""
    state = start(pair_scene(-1e-4 * RADIUS, sand=SOFT), features=HERTZ, steps_per_contact=0.0)
    assert cheap_limit(state)[0] == pytest.approx(state.critical_time_step[0] / np.sqrt(2.0), rel=1e-6)


def test_unbalanced_forces_move_disks_at_force_over_mass_and_frequency() -> None:
    """Two pressed disks that nothing holds; a pulse of a thousand times their speed is not yet too weak."""
    overlap = 1e-4 * RADIUS
    state = start(pair_scene(-overlap, sand=SOFT), features=HERTZ, steps_per_contact=0.0)
    radius = np.full(1, RADIUS)
    force = float(SOFT.hertz_coefficient(radius, radius)[0]) * overlap**1.5
    speed = float(force / state.scene.mass[0] * state.critical_time_step[0] / 2.0)
    assert unbalanced_speed(state, 1010.0 * speed) == pytest.approx(1.0 / 1010.0, rel=1e-6)
    with pytest.raises(ValueError, match=r"amplitude = .* unbalanced forces of the packing alone"):
        unbalanced_speed(state, 990.0 * speed)


@pytest.mark.full
def test_what_a_loud_pulse_makes_heard_does_not_depend_on_disks_out_of_reach() -> None:
    """At 5 m/s, too, damping layers let nothing through: with the same step, the signal is that of all disks."""
    scenes = [experiment(boundary_thickness=0.022, whole_domain=whole) for whole in (False, True)]
    # That of the part is 1.4e-6 longer, which moves signals by 3e-5.
    limit = prepared(scenes[1]).state.critical_time_step
    part, whole = (recorded(given, 0.4, limit) for given in scenes)
    assert np.abs(whole.received).max() > 1e-3 * LOUD
    np.testing.assert_allclose(part.across, whole.across, rtol=0.0, atol=2.0)  # steps of 1e-6


@pytest.mark.full
def test_a_shock_is_told_from_an_unstable_run() -> None:
    """Under 300 kPa 5 m/s goes through, and half the step gives the same Vs; a step above the limit is found out."""
    given = experiment()
    coarse, fine = measured(given), measured(replace(given, wave=replace(given.wave, step_fraction=0.4)))
    assert all(not cell.section.problem and not cell.section.retry for cell in (*coarse, *fine))
    assert [cell.vs for cell in coarse] == pytest.approx([cell.vs for cell in fine], rel=0.02)
    stable, unstable = (recorded(given, part) for part in (0.8, 2.5))
    assert not stable.problem
    assert "moves at" in unstable.problem or "above the stability limit" in unstable.problem
    assert unstable.duration < stable.duration


@pytest.mark.full
def test_a_sample_that_a_loud_pulse_presses_too_hard_is_sent_again_with_half_the_step() -> None:
    """Sand under 5 kPa stiffens so much that the step is too long: it is sent again with half of it, and says so."""
    (cell,) = measure(experiment(stress=5e3), 0.0, [1], lanes=1)
    assert "stability limit of the pressed contacts" in cell.section.retry
    assert cell.section.time_step == pytest.approx(0.4 * cell.section.stability_limit)
