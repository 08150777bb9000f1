"""The parts of the stated numerical error, on a packing and records made by hand."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import LINEAR, SOFT, SOFT_CEMENT, bare_packing, pair_scene

from calcidem.dem.engine.material import Sand
from calcidem.dem.engine.scene import Bonds
from calcidem.dem.engine.state import start
from calcidem.dem.wave.error_estimate import ErrorParts, cure_of, error_bound, error_parts, expected_error, slip_ratio
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.linearity import nonlinear_share
from calcidem.dem.wave.pick import Signals
from calcidem.dem.wave.pulse import Pulse
from calcidem.dem.wave.recorder import WaveRecord
from calcidem.dem.wave.rule import WaveRule

WAY, RADIUS, OVERLAP = 0.094, 1.25e-3, 1e-6  # m; one disk is listened to, there
AMPLITUDE = 1e-4  # m/s
FREQUENCY, TRAVEL_TIME = 1e4, 2e-4  # Hz, s: two periods on the way
PACKING = bare_packing(
    np.array([0.01, WAY]), np.array([0.15, 0.15]), np.full(2, RADIUS), np.zeros((0, 2), int), (0.1, 0.3), OVERLAP
)
EXPERIMENT = Experiment(PACKING, wave=WaveRule(amplitude=AMPLITUDE))  # linear, with damping
EXACT = Experiment(PACKING, wave=WaveRule(regime="finite", damping=0.0))  # nothing but step and sampling
RECORD = WaveRecord(
    time_step=1e-7, stride=10, sent=np.zeros(3), force=np.zeros(3), velocity=np.zeros(3),
    stability_limit=1.25e-7, steps=30,
)  # fmt: skip


def waves(experiment: Experiment, **changes: object) -> Experiment:
    """The experiment with another wave."""
    return replace(experiment, wave=replace(experiment.wave, **changes))  # type: ignore[arg-type]


def pressed(experiment: Experiment, overlap: float) -> Experiment:
    """The experiment with another mean overlap."""
    return replace(experiment, packing=replace(PACKING, report=replace(PACKING.report, mean_overlap=overlap)))


def parts(
    experiment: Experiment = EXPERIMENT,
    record: WaveRecord = RECORD,
    frequency: float = FREQUENCY,
    travel_time: float = TRAVEL_TIME,
    *,
    noisy: bool = False,
) -> ErrorParts:
    """Parts of the error, of the cell at hand but for what is given."""
    return error_parts(experiment, record, frequency, travel_time, noisy=noisy)


def test_a_plain_cell_has_the_error_of_its_step_and_sampling_alone() -> None:
    """Finite displacement in double precision, without damping, noise and unbalanced forces: two parts, by hand."""
    found = parts(EXACT)
    assert found.step == pytest.approx(0.5e-7 / 2e-4 + (3.0 * 2.0 * np.pi * 1e4 * 1e-7) ** 2 / 24.0)
    assert found.sampling == pytest.approx(0.2 * 1e-6 / 2e-4)
    assert found[2:] == (0.0, 0.0, 0.0, 0.0, 0.0)
    both = float(np.hypot(found.step, found.sampling))
    assert error_bound(EXACT, RECORD, FREQUENCY, TRAVEL_TIME) == pytest.approx(both)


@pytest.mark.parametrize(
    ("part", "experiment", "record", "noisy"),
    [
        ("step", EXPERIMENT, replace(RECORD, time_step=2e-7, stride=5, stability_limit=2.5e-7), False),
        ("sampling", EXPERIMENT, replace(RECORD, stride=20), False),
        ("regime", waves(EXPERIMENT, amplitude=2.0 * AMPLITUDE), RECORD, False),
        ("regime", pressed(EXPERIMENT, 10.0 * OVERLAP), RECORD, False),
        ("regime", EXPERIMENT, replace(RECORD, closing_gaps=0.01), False),
        ("regime", replace(EXPERIMENT, sand=Sand(friction=0.1)), RECORD, False),
        ("precision", waves(EXPERIMENT, precision="float32"), RECORD, False),
        ("noise", EXPERIMENT, RECORD, True),
        ("chatter", waves(EXPERIMENT, damping=0.5), RECORD, False),
        ("chatter", EXPERIMENT, replace(RECORD, stability_limit=1.1e-7), False),
        ("unbalanced", EXPERIMENT, replace(RECORD, unbalanced_speed=1e-4), False),
    ],
)
def test_each_cause_raises_its_own_part_alone(
    part: str, experiment: Experiment, record: WaveRecord, noisy: bool
) -> None:
    """More of a cause makes its part larger, leaves the others, and so raises the whole."""
    before, after = parts(), parts(experiment, record, noisy=noisy)
    assert getattr(after, part) > getattr(before, part)
    for other in set(ErrorParts._fields) - {part}:
        assert getattr(after, other) == pytest.approx(getattr(before, other), rel=1e-12)
    errors = [
        error_bound(EXPERIMENT, RECORD, FREQUENCY, TRAVEL_TIME),
        error_bound(experiment, record, FREQUENCY, TRAVEL_TIME, noisy=noisy),
    ]
    assert errors[1] > errors[0]


@given(st.floats(1e-9, 1e-6), st.integers(1, 50), st.floats(1e3, 5e4), st.floats(2e-5, 2e-3), st.floats(0.0, 0.7))
def test_the_error_is_at_least_that_of_each_part(
    time_step: float, stride: int, frequency: float, travel_time: float, damping: float
) -> None:
    """No part is negative, and none takes another away."""
    record = replace(RECORD, time_step=time_step, stride=stride, stability_limit=1.25 * time_step)
    experiment = waves(EXPERIMENT, damping=damping, precision="float32")
    found = parts(experiment, record, frequency, travel_time, noisy=True)
    assert min(found) >= 0.0
    assert found.precision >= 1e-3
    whole = error_bound(experiment, record, frequency, travel_time, noisy=True)
    assert max(found) <= whole * (1.0 + 1e-12)
    assert whole <= sum(found) * (1.0 + 1e-12)


def test_the_step_has_the_dispersion_of_leapfrog() -> None:
    """Beyond the half step of damping it is the exact shift of a frequency three times that of the pulse."""
    angle = 3.0 * 2.0 * np.pi * FREQUENCY * RECORD.time_step
    shift = 2.0 / angle * np.arcsin(angle / 2.0) - 1.0
    assert parts().step - 0.5 * RECORD.time_step / TRAVEL_TIME == pytest.approx(shift, rel=1e-3)


def test_noise_moves_a_peak_as_far_as_it_is_said() -> None:
    """The top of a pulse with a sine of the onset level added, found on a grid, is where the estimate has it."""
    time = np.linspace(-0.1, 0.1, 200_001) / FREQUENCY
    level = 0.02
    top = time[np.argmax(1.0 - (np.pi * FREQUENCY * time) ** 2 + level * np.sin(2.0 * np.pi * FREQUENCY * time))]
    noisy = replace(EXPERIMENT, pick=replace(EXPERIMENT.pick, onset=level))
    assert parts(noisy, noisy=True).noise * TRAVEL_TIME == pytest.approx(top, rel=2e-3)


def test_regimes_count_what_they_leave_out() -> None:
    """Small displacement misses turning and closing contacts, linear also stiffening and slip, finite nothing."""
    record, stroke = replace(RECORD, closing_gaps=0.01), AMPLITUDE / FREQUENCY
    small, linear = (parts(waves(EXPERIMENT, regime=name), record).regime for name in ("small", "linear"))
    assert parts(waves(EXPERIMENT, regime="finite")).regime == 0.0
    assert small == pytest.approx(3.0 * OVERLAP / RADIUS + 0.5 * 0.01)
    slip = 0.8 * slip_ratio(EXPERIMENT, FREQUENCY, TRAVEL_TIME) ** 3
    assert linear == pytest.approx(small + 3e-3 * stroke / OVERLAP + slip)


def test_changes_of_shape_weigh_more_on_a_short_way() -> None:
    """On half a period of way precision counts twice; on more than one it is what it is."""
    single = waves(EXACT, precision="float32")
    assert parts(single, travel_time=0.5 / FREQUENCY).precision == pytest.approx(2e-3)
    assert parts(single, travel_time=3.0 / FREQUENCY).precision == pytest.approx(1e-3)


@given(st.floats(0.01, 0.7), st.floats(0.1, 1.0))
def test_chatter_grows_with_damping_and_step(damping: float, fraction: float) -> None:
    """It is the cube of a / (1 - a) times the fourth power of the step over its limit."""
    record = replace(RECORD, stability_limit=RECORD.time_step / fraction)
    expected = 7.5e-3 * (damping / (1.0 - damping)) ** 3 * fraction**4
    assert parts(waves(EXPERIMENT, damping=damping), record).chatter == pytest.approx(expected)


def test_a_soft_contact_takes_the_whole_stroke_and_slips_at_its_friction() -> None:
    """Of a fast pulse a contact at the transmitter takes all, and slips at mu F_n / k_s by Hertz and Mindlin."""
    sand = EXPERIMENT.sand
    hertz = 2.0 / 3.0 * sand.shear_modulus / (1.0 - sand.poisson_ratio) * np.sqrt(4.0 * RADIUS)  # at a flat wall
    shear = 1.5 * hertz * np.sqrt(OVERLAP) * 2.0 * (1.0 - sand.poisson_ratio) / (2.0 - sand.poisson_ratio)
    slides = 0.5 * hertz * OVERLAP**1.5 / shear
    fast = 1e9
    assert slip_ratio(EXPERIMENT, fast, TRAVEL_TIME) == pytest.approx(AMPLITUDE / fast / slides, rel=1e-3)
    # Of a slow pulse it takes omega rho V d / k_s, whatever its frequency.
    slow = AMPLITUDE * 2.0 * np.pi * sand.density * WAY / TRAVEL_TIME * 2.0 * RADIUS / shear
    assert slip_ratio(EXPERIMENT, 10.0, TRAVEL_TIME) == pytest.approx(slow / slides, rel=1e-3)


def test_grains_without_friction_have_no_velocity_in_the_linear_regime() -> None:
    """They slip at once, which the linear regime cannot do: the error has no bound."""
    smooth = replace(EXPERIMENT, sand=Sand(friction=0.0))
    assert error_bound(smooth, RECORD, FREQUENCY, TRAVEL_TIME) == np.inf
    assert error_bound(waves(smooth, regime="small"), RECORD, FREQUENCY, TRAVEL_TIME) < 0.05


def test_the_cure_of_a_large_bound_works() -> None:
    """Contacts that overlap by 1.8 % of a radius are too much at any amplitude, others only for a loud pulse."""
    locked, loud = pressed(EXPERIMENT, 0.018 * RADIUS), waves(EXPERIMENT, amplitude=2e-3)
    for experiment, quieter_helps in ((locked, False), (loud, True)):
        cure = cure_of(experiment, parts(experiment), 0.05)
        quieter, finite = waves(experiment, amplitude=1e-6), waves(experiment, regime="finite", damping=0.0)
        assert error_bound(experiment, RECORD, FREQUENCY, TRAVEL_TIME) > 0.05
        assert (error_bound(quieter, RECORD, FREQUENCY, TRAVEL_TIME) < 0.05) == quieter_helps
        assert error_bound(finite, RECORD, FREQUENCY, TRAVEL_TIME) < 0.05
        assert ("lower amplitude" in cure) == quieter_helps
        assert "regime = 'finite'" in cure


def received(stretch: float = 1.0) -> Signals:
    """A pulse that arrives after the travel time, its width multiplied."""
    time = np.arange(0.0, 6.0 / FREQUENCY, 1e-6)
    pulse = Pulse(AMPLITUDE, FREQUENCY)
    arrived = pulse.velocity(0.5 / FREQUENCY + (time - TRAVEL_TIME - 0.5 / FREQUENCY) / stretch)
    return Signals(1e-6, pulse.velocity(time), arrived, PACKING.width, 0.0)


def expected(share: float, stretch: float = 1.0, experiment: Experiment = EXACT) -> float:
    """Error to expect if that share of the work is nonlinear."""
    record = replace(RECORD, nonlinear_share=share)
    return expected_error(experiment, record, received(stretch), FREQUENCY, TRAVEL_TIME)


def test_a_changed_signal_moves_its_peak_as_far_as_is_expected() -> None:
    """A change by a sine of the pulse's frequency moves the top of the pulse by 2 pi f e w^2, found on a grid."""
    change = 1.7e-3  # as of a nonlinear share of a thousandth
    time = np.linspace(-0.02, 0.02, 200_001) / FREQUENCY
    angle = 2.0 * np.pi * FREQUENCY * time
    top = time[np.argmax(0.5 * (1.0 + np.cos(angle)) + change * np.sin(angle))]
    # Smoothing and the distance of the three values make the peak look a little wider than it is.
    assert (expected(1e-3) - expected(0.0)) * TRAVEL_TIME == pytest.approx(top, rel=0.1)


def test_a_flat_peak_lets_expect_a_larger_error() -> None:
    """Twice as wide a peak moves four times as far, and a nonlinear share counts in proportion; so does roughness."""
    narrow, wide = (expected(1e-3, stretch) - expected(0.0, stretch) for stretch in (1.0, 2.0))
    assert wide == pytest.approx(4.0 * narrow, rel=0.1)
    assert expected(3e-3) - expected(0.0) == pytest.approx(3.0 * narrow)
    rough = received()
    rough.received[:] += 1e-2 * AMPLITUDE * (-1.0) ** np.arange(len(rough.received))
    level = 1e-2 / 2.0  # of a peak of twice the amplitude
    chattering = expected_error(EXACT, RECORD, rough, FREQUENCY, TRAVEL_TIME)
    assert chattering - expected(0.0) == pytest.approx(narrow * 0.25 * level / 1.7e-3, rel=0.1)


def test_the_step_lets_expect_an_error_of_first_order() -> None:
    """Half the limit means twice the step over it, 1.6 for 0.8, and all is below the bound."""
    coarse = replace(RECORD, stability_limit=0.5 * RECORD.stability_limit)
    errors = [expected_error(EXACT, record, received(), FREQUENCY, TRAVEL_TIME) for record in (RECORD, coarse)]
    assert errors[1] - errors[0] == pytest.approx(6e-5 * 0.8)
    assert errors[0] < error_bound(EXACT, RECORD, FREQUENCY, TRAVEL_TIME)


@pytest.mark.parametrize("lanes", [1, 8])
def test_the_nonlinear_share_of_one_contact_is_that_of_hertz(lanes: int) -> None:
    """Pressing by x changes the force by k x at constant stiffness; Hertz says h ((d + x)^1.5 - d^1.5)."""
    scene = pair_scene(gap=-1e-6, sand=SOFT)
    state = start(scene, features=replace(LINEAR, bonds=False, linear_group=False, lanes=lanes))
    assert not nonlinear_share(state).any()  # nothing moves yet
    pressed = 3e-7
    state.motion.displacement[1, 0] = -pressed
    stiffness = 1.5e-3  # of h = 1: 1.5 sqrt(d)
    missed = (1e-6 + pressed) ** 1.5 - 1e-6**1.5 - stiffness * pressed
    assert nonlinear_share(state) == pytest.approx(missed / (stiffness * pressed), rel=1e-6)
    state.motion.displacement[1, 0] = 2e-6  # apart: no force is left, which constant stiffness takes for tension
    missed = -(1e-6**1.5) + stiffness * 2e-6
    assert nonlinear_share(state) == pytest.approx(missed / (stiffness * 2e-6), rel=1e-6)


def test_cement_is_linear() -> None:
    """A bonded contact has no share, however far its disks move."""
    scene = pair_scene(gap=-1e-6, sand=SOFT, bonds=Bonds(np.array([[0, 1]]), SOFT_CEMENT))
    state = start(scene, features=LINEAR)
    state.motion.displacement[1] = [[1e-5], [1e-5], [1e-3]]
    assert not nonlinear_share(state).any()
