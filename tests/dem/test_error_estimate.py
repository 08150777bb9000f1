"""The parts of the stated numerical error, on a packing and records made by hand."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import LINEAR, SOFT, SOFT_CEMENT, bare_packing, hexagonal, pair_scene
from scenes import RADIUS as SCENE_RADIUS
from waves import section, wave

from calcidem.dem.engine.readout import net_forces
from calcidem.dem.engine.scene import Bonds, Preload, Scene, Wall
from calcidem.dem.engine.state import start
from calcidem.dem.wave import measurement
from calcidem.dem.wave.error_estimate import ErrorParts, chatters, cure_of, error_bound, estimate_error, shift_by_change
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.linearity import (
    _intact_bonds,
    _spring_work,
    _strained_contacts,
    nonlinearity,
    slipped_force,
)
from calcidem.dem.wave.measurement import _change_by_halving
from calcidem.dem.wave.pulse import Pulse
from calcidem.dem.wave.reading import Reading, read_section
from calcidem.dem.wave.rule import WaveRule
from calcidem.dem.wave.section import Nonlinearity, Section

WAY, RADIUS, OVERLAP = 0.094, 1.25e-3, 1e-6  # m; one disk is listened to, there
AMPLITUDE = 1e-4  # m/s
FREQUENCY, TRAVEL_TIME = 1e4, 2e-4  # Hz, s: two periods on the way
PACKING = bare_packing(
    np.array([0.01, WAY]), np.array([0.15, 0.15]), np.full(2, RADIUS), np.zeros((0, 2), int), (0.1, 0.3), OVERLAP
)
EXPERIMENT = Experiment(PACKING, wave=WaveRule(amplitude=AMPLITUDE))  # linear, with damping
EXACT = Experiment(PACKING, wave=WaveRule(regime="finite", damping=0.0))  # nothing but step and sampling
SAMPLING = 1e-6  # s
SECTION = Section(
    SAMPLING,
    0.0,
    FREQUENCY,
    AMPLITUDE,
    (WAY,),
    *np.zeros((2, 3, 1), dtype=np.int32),
    time_step=1e-7,
    stability_limit=1.25e-7,
    steps=30,
)


def waves(experiment: Experiment, **changes: object) -> Experiment:
    """The experiment with another wave."""
    return replace(experiment, wave=replace(experiment.wave, **changes))  # type: ignore[arg-type]


def pressed(experiment: Experiment, overlap: float) -> Experiment:
    """The experiment with another mean overlap."""
    return replace(experiment, packing=replace(PACKING, report=replace(PACKING.report, mean_overlap=overlap)))


def slipping(softening: float = 0.0, slipped: float = 0.0) -> Section:
    """The section with contacts that would slip."""
    return replace(SECTION, nonlinear=(Nonlinearity(0.0, softening),), slipped=slipped)


def received(stretch: float = 1.0, travel_time: float = TRAVEL_TIME, roughness: float = 0.0) -> Reading:
    """A pulse that arrives after a travel time, its width multiplied."""
    time = np.arange(0.0, 6.0 / FREQUENCY, SAMPLING)
    middle = 0.5 / FREQUENCY
    clean = Pulse(1.0, FREQUENCY).velocity(middle + (time - TRAVEL_TIME - middle) / stretch)
    index = round((TRAVEL_TIME + middle) / SAMPLING)
    return Reading(travel_time, 1.0, 0.0, 0.0, 0.0, roughness, None, index, clean[:, np.newaxis])


def parts(
    experiment: Experiment = EXPERIMENT,
    record: Section = SECTION,
    frequency: float = FREQUENCY,
    travel_time: float = TRAVEL_TIME,
    *,
    noisy: bool = False,
) -> ErrorParts:
    """Parts of the error, of the cell at hand but for what is given."""
    record = replace(record, frequency=frequency)
    return estimate_error(experiment, record, received(1.0, travel_time, 0.101 if noisy else 0.099))[2]


def test_a_plain_cell_has_the_error_of_its_step_and_sampling_alone() -> None:
    """Finite displacement in double precision, without damping, noise and unbalanced forces: two parts, by hand."""
    found = parts(EXACT)
    assert found.step == pytest.approx(0.5e-7 / 2e-4 + (3.0 * 2.0 * np.pi * 1e4 * 1e-7) ** 2 / 24.0)
    assert found.sampling == pytest.approx(0.2 * 1e-6 / 2e-4)
    assert found[2:] == (0.0,) * 7
    assert error_bound(found) == pytest.approx(float(np.hypot(found.step, found.sampling)))


@pytest.mark.parametrize(
    ("part", "experiment", "record", "noisy"),
    [
        ("step", EXPERIMENT, replace(SECTION, time_step=2e-7, stability_limit=2.5e-7), False),
        ("sampling", EXPERIMENT, replace(SECTION, sampling_interval=2.0 * SAMPLING), False),
        ("regime", waves(EXPERIMENT, amplitude=2.0 * AMPLITUDE), SECTION, False),
        ("regime", pressed(EXPERIMENT, 10.0 * OVERLAP), SECTION, False),
        ("regime", EXPERIMENT, replace(SECTION, closing_gaps=0.01), False),
        ("slip", EXPERIMENT, slipping(softening=0.01), False),
        ("slip", EXPERIMENT, slipping(slipped=0.01), False),
        ("precision", waves(EXPERIMENT, precision="float32"), SECTION, False),
        ("noise", EXPERIMENT, SECTION, True),
        ("chatter", EXPERIMENT, replace(SECTION, stability_limit=1.1e-7), False),
        ("unbalanced", EXPERIMENT, replace(SECTION, unbalanced_speed=1e-4), False),
        ("breaking", EXPERIMENT, replace(SECTION, broken_bonds=3, bonds=560), False),
    ],
)
def test_each_cause_raises_its_own_part_alone(part: str, experiment: Experiment, record: Section, noisy: bool) -> None:
    """More of a cause makes its part larger, leaves the others, and so raises the whole."""
    before, after = parts(), parts(experiment, record, noisy=noisy)
    assert getattr(after, part) > getattr(before, part)
    for other in set(ErrorParts._fields) - {part}:
        assert getattr(after, other) == pytest.approx(getattr(before, other), rel=1e-12)
    assert error_bound(after) > error_bound(before)


@given(st.floats(1e-9, 1e-6), st.floats(1e3, 5e4), st.floats(2e-5, 2e-3), st.floats(0.0, 0.7))
def test_the_error_is_at_least_that_of_each_part(
    time_step: float, frequency: float, travel_time: float, damping: float
) -> None:
    """No part is negative, and none takes another away."""
    record = replace(SECTION, time_step=time_step, stability_limit=1.25 * time_step)
    experiment = waves(EXPERIMENT, damping=damping, precision="float32")
    found = parts(experiment, record, frequency, travel_time, noisy=True)
    assert min(found) >= 0.0
    assert found.precision >= 1e-3
    whole = error_bound(found)
    assert max(found) <= whole * (1.0 + 1e-12)
    assert whole <= sum(found) * (1.0 + 1e-12)


def test_bonds_that_break_count_as_rare_events_do() -> None:
    """Two standard deviations of their number, over all bonds; none in a sample that has none."""
    four, sixteen = (parts(EXACT, replace(SECTION, broken_bonds=count, bonds=1000)).breaking for count in (4, 16))
    assert (four, sixteen) == pytest.approx((4e-3, 8e-3))
    assert parts(EXACT, replace(SECTION, broken_bonds=0, bonds=0)).breaking == 0.0


def test_the_step_has_the_dispersion_of_leapfrog() -> None:
    """Beyond the half step of damping it is the exact shift of a frequency three times that of the pulse."""
    angle = 3.0 * 2.0 * np.pi * FREQUENCY * SECTION.time_step
    shift = 2.0 / angle * np.arcsin(angle / 2.0) - 1.0
    assert parts(EXACT).step - 0.5 * SECTION.time_step / TRAVEL_TIME == pytest.approx(shift, rel=1e-3)


def test_a_damped_step_counts_more() -> None:
    """Half a step of the travel time, over the part of a force that local damping leaves."""
    first = [parts(waves(EXACT, damping=damping)).step - parts(EXACT).step for damping in (0.5, 0.6)]
    half = 0.5 * SECTION.time_step / TRAVEL_TIME
    assert first == pytest.approx([half, 1.5 * half])


def test_single_precision_rounds_the_forces_of_the_packing() -> None:
    """Five times 2^-24 of the mean overlap over the received stroke, times the shift by a change of the signal."""
    single, usual = waves(EXACT, precision="float32"), 1e-3
    quiet = waves(single, amplitude=1e-3 * single.wave.amplitude)
    added = [parts(each).precision - usual for each in (single, quiet)]
    stroke = single.wave.amplitude / FREQUENCY * 2.0  # the received peak is 2 v0
    # A pulse has amplitude over curvature 1 / (2 (pi f)^2), see `_shift_by_change`.
    shift = 1.0 / (np.pi * FREQUENCY * TRAVEL_TIME)
    assert added[0] == pytest.approx(shift * 5.0 * 2.0**-24 * PACKING.report.mean_overlap / stroke, rel=0.03)
    assert added[1] == pytest.approx(1e3 * added[0])


def test_noise_moves_a_peak_as_far_as_it_is_said() -> None:
    """The top of a pulse with a sine of the onset level added, found on a grid, is where the estimate has it."""
    time = np.linspace(-0.1, 0.1, 200_001) / FREQUENCY
    level = 0.1
    top = time[np.argmax(1.0 - (np.pi * FREQUENCY * time) ** 2 + level * np.sin(2.0 * np.pi * FREQUENCY * time))]
    # There the sine is less steep by 1 - cos 2 level.
    assert parts(noisy=True).noise * TRAVEL_TIME == pytest.approx(top, rel=0.021)


def test_regimes_count_what_they_leave_out() -> None:
    """Small displacement misses turning and closing contacts, linear also stiffening, finite nothing."""
    record, stroke = replace(SECTION, closing_gaps=0.01), AMPLITUDE / FREQUENCY
    small, linear = (parts(waves(EXPERIMENT, regime=name), record).regime for name in ("small", "linear"))
    assert parts(waves(EXPERIMENT, regime="finite")).regime == 0.0
    assert small == pytest.approx(3.0 * OVERLAP / RADIUS + 0.5 * 0.01)
    assert linear == pytest.approx(small + 3e-3 * stroke / OVERLAP)


def test_changes_of_shape_weigh_more_on_a_short_way() -> None:
    """On half a period of way precision counts twice; on more than one it is what it is."""
    single = waves(EXACT, precision="float32")
    assert parts(single, travel_time=0.5 / FREQUENCY).precision == pytest.approx(2e-3, rel=1e-3)
    assert parts(single, travel_time=3.0 / FREQUENCY).precision == pytest.approx(1e-3, rel=1e-3)


@given(st.floats(0.01, 0.7), st.floats(0.1, 1.0))
def test_chatter_grows_with_damping_and_step(damping: float, fraction: float) -> None:
    """It is the cube of a / (1 - a) times the fourth power of the step over its limit."""
    record = replace(SECTION, stability_limit=SECTION.time_step / fraction)
    expected = 1.8e-2 * (damping / (1.0 - damping)) ** 3 * fraction**4
    assert parts(waves(EXPERIMENT, damping=damping), record).chatter == pytest.approx(expected)


def test_what_chatters_is_measured() -> None:
    """Above 500 of (a / (1 - a))^3 times the contrast of stiffness; nothing does without damping or without cement."""
    assert [chatters(0.5, contrast) for contrast in (1.0, 499.0, 501.0)] == [False, False, True]
    assert [chatters(2.0 / 3.0, contrast) for contrast in (62.0, 63.0)] == [False, True]
    assert not chatters(0.0, 1e9)
    assert not chatters(0.7, 1.0)


def test_softening_counts_for_more_than_it_takes_where_slip_is_even() -> None:
    """V goes with the root of the stiffness; on half a wavelength of way the shape counts twice; more than 1 is 1."""
    assert parts(record=slipping(softening=0.02)).slip > 1.0 - np.sqrt(1.0 - 0.02)
    assert parts(record=slipping(softening=0.02)).slip == pytest.approx(0.02)
    assert parts(record=slipping(softening=0.02), travel_time=0.5 / FREQUENCY).slip == pytest.approx(0.04)
    assert parts(record=slipping(softening=np.inf)).slip == 1.0


def test_slip_counts_until_the_pulse_has_come() -> None:
    """Looks after 1, 3, 5 and 7 periods count until the whole pulse, a period long, has gone the way."""
    looks = tuple(Nonlinearity(0.0, softening) for softening in (1e-3, 2e-3, 4e-3, 8e-3))
    late = replace(SECTION, nonlinear=looks)
    for periods, largest in ((1.9, 1e-3), (2.1, 2e-3), (3.9, 2e-3), (4.1, 4e-3), (5.9, 4e-3)):
        found = parts(record=late, travel_time=periods / FREQUENCY).slip
        assert found == parts(record=slipping(softening=largest), travel_time=periods / FREQUENCY).slip


def test_a_force_that_is_missing_moves_a_top_as_far_as_is_said() -> None:
    """A pulse less the part e of it, a quarter of a period later, has its top ``e / (pi f)`` earlier at most."""
    missing, time = 0.02, np.linspace(-0.2, 0.2, 200_001) / FREQUENCY
    angle = 2.0 * np.pi * FREQUENCY * time
    pulse = 1.0 + np.cos(angle) - 2.0 * missing * np.sin(angle)
    shift = -time[np.argmax(pulse)] / TRAVEL_TIME
    # Smoothing makes the peak that is read a little wider.
    assert parts(record=slipping(slipped=missing)).slip == pytest.approx(shift, rel=0.1)


def test_the_cure_of_a_large_bound_works() -> None:
    """Contacts that overlap by 1.8 % of a radius are too much at any amplitude, others only for a loud pulse."""
    locked, loud = pressed(EXPERIMENT, 0.018 * RADIUS), waves(EXPERIMENT, amplitude=0.2)
    for experiment, quieter_helps in ((locked, False), (loud, True)):
        cure = cure_of(experiment, parts(experiment), 0.05)
        quieter, finite = waves(experiment, amplitude=1e-6), waves(experiment, regime="finite", damping=0.0)
        assert error_bound(parts(experiment)) > 0.05
        assert (error_bound(parts(quieter)) < 0.05) == quieter_helps
        assert error_bound(parts(finite)) < 0.05
        assert ("lower amplitude" in cure) == quieter_helps
        assert "regime = 'finite'" in cure
    slips = parts(record=slipping(softening=0.2))
    assert "contacts slip" in cure_of(EXPERIMENT, slips, 0.05)


def expected(share: float, stretch: float = 1.0, experiment: Experiment = EXACT) -> float:
    """Error to expect if that share of the work is nonlinear."""
    record = replace(SECTION, nonlinear=(Nonlinearity(share, 0.0),))
    return estimate_error(experiment, record, received(stretch))[0]


def test_a_changed_signal_moves_its_peak_as_far_as_is_expected() -> None:
    """A change by a sine of the pulse's frequency moves the top of the pulse by 2 pi f e w^2, found on a grid."""
    change = 1.7e-3  # as of a nonlinear share of a thousandth
    time = np.linspace(-0.02, 0.02, 200_001) / FREQUENCY
    angle = 2.0 * np.pi * FREQUENCY * time
    top = time[np.argmax(0.5 * (1.0 + np.cos(angle)) + change * np.sin(angle))]
    # The distance of the three values makes the peak look a little wider than it is.
    assert (expected(1e-3) - expected(0.0)) * TRAVEL_TIME == pytest.approx(top, rel=0.1)


def test_a_flat_peak_lets_expect_a_larger_error() -> None:
    """Twice as wide a peak moves four times as far, and a nonlinear share counts in proportion; so does roughness."""
    narrow, wide = (expected(1e-3, stretch) - expected(0.0, stretch) for stretch in (1.0, 2.0))
    assert wide == pytest.approx(4.0 * narrow, rel=0.1)
    assert expected(3e-3) - expected(0.0) == pytest.approx(3.0 * narrow)
    level = 5e-3
    chattering = estimate_error(EXACT, SECTION, received(roughness=level))[0]
    assert chattering - expected(0.0) == pytest.approx(narrow * 0.25 * level / 1.7e-3, rel=0.1)


def test_the_step_lets_expect_an_error_of_first_order() -> None:
    """Half the limit means twice the step over it, 1.6 for 0.8, and all is below the bound."""
    coarse = replace(SECTION, stability_limit=0.5 * SECTION.stability_limit)
    errors = [estimate_error(EXACT, record, received())[0] for record in (SECTION, coarse)]
    assert errors[1] - errors[0] == pytest.approx(7.5e-5 * 0.8)
    assert errors[0] < error_bound(parts(EXACT))


def test_what_the_transmitter_loses_is_expected_in_part() -> None:
    """A force of which 1 % is missing lets expect 0.45 of its bound more, and raises the bound by that alone."""
    lossy = slipping(slipped=0.01)
    loss = parts(EXACT, lossy).slip
    (usual, _, _), (larger, bound, found) = (estimate_error(EXACT, record, received()) for record in (SECTION, lossy))
    assert larger - usual == pytest.approx(0.45 * loss)
    assert bound == error_bound(found)


@pytest.mark.parametrize(
    ("experiment", "record"),
    [
        (waves(EXPERIMENT, precision="float32"), SECTION),
        (
            EXPERIMENT,
            replace(SECTION, time_step=0.5 * SECTION.time_step, stability_limit=0.5 * SECTION.stability_limit),
        ),
        (EXPERIMENT, replace(SECTION, unbalanced_speed=1e-4)),
        (EXPERIMENT, replace(SECTION, broken_bonds=3, bonds=560)),
        (waves(EXPERIMENT, damping=0.5), SECTION),
    ],
)
def test_a_tenth_of_the_other_parts_is_expected(experiment: Experiment, record: Section) -> None:
    """Precision, chatter, unbalanced forces and broken bonds count alike."""
    (usual, _, before), (changed, _, after) = (
        estimate_error(*given, received()) for given in ((EXPERIMENT, SECTION), (experiment, record))
    )
    others = ("precision", "chatter", "unbalanced", "breaking")
    more = sum(getattr(after, name) - getattr(before, name) for name in others)
    assert changed - usual == pytest.approx(0.1 * more, rel=1e-9, abs=1e-15)


def test_chatter_that_was_measured_is_expected_as_of_one_of_two_runs() -> None:
    """Two runs with equal errors differ by sqrt(2) of one."""
    without, measured = (estimate_error(EXPERIMENT, SECTION, received(), chatter)[0] for chatter in (0.0, 0.01))
    assert measured - without == pytest.approx(0.01 / np.sqrt(2.0), rel=0.01)


def test_the_change_by_halving_is_that_of_the_signal_where_the_travel_time_stays() -> None:
    """A signal sampled at other times is the same; one that is 1 % larger moves its peak as such a change does."""
    fine, coarse, louder = (
        section(wave(8.0, height), samples=samples) for height, samples in ((1.0, 40), (1.0, 37), (1.01, 40))
    )
    arrival = read_section(fine)
    assert isinstance(arrival, Reading)
    assert _change_by_halving(EXPERIMENT, fine, arrival, coarse) < 3e-4
    change = _change_by_halving(EXPERIMENT, fine, arrival, louder)
    assert change == pytest.approx(0.01 * shift_by_change(fine, arrival), rel=1e-3)
    assert _change_by_halving(EXPERIMENT, fine, arrival, replace(coarse, problem="unstable")) == 1.0


def test_where_there_is_no_peak_a_change_moves_the_time_as_the_period_is_wide() -> None:
    """By 2 pi f T^2 over the travel time, and no more for a peak that is wider."""
    arrival = received()
    for curvature in (0.0, 1e-6):
        places = np.arange(len(arrival.clean)) - arrival.index
        wide = replace(arrival, clean=np.repeat(1.0 - curvature * places[:, None] ** 2, arrival.clean.shape[1], axis=1))
        assert shift_by_change(SECTION, wide) == pytest.approx(2.0 * np.pi / (FREQUENCY * TRAVEL_TIME))


def test_seeds_are_measured_in_batches_of_the_kernels_width(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of them, in order."""
    batches: list[list[int]] = []

    def measured(_experiment: Experiment, _content: float, seeds: list[int], **_options: object) -> list[int]:
        batches.append(seeds)
        return seeds

    monkeypatch.setattr(measurement, "measure", measured)
    found: list[object] = list(measurement.measure_all(EXPERIMENT, 0.0, [5, 3, 1, 2, 4], lanes=2))
    assert found == [5, 3, 1, 2, 4]
    assert batches == [[5, 3], [1, 2], [4]]


FAR = (Wall((0.0, -1.0), (0.0, 1.0)),)  # touches nothing


@pytest.mark.parametrize("lanes", [1, 8])
def test_the_nonlinear_share_of_one_contact_is_that_of_hertz(lanes: int) -> None:
    """Pressing by x changes the force by k x at constant stiffness; Hertz says h ((d + x)^1.5 - d^1.5)."""
    scene = pair_scene(gap=-1e-6, sand=SOFT, walls=FAR)
    state = start(scene, features=replace(LINEAR, bonds=False, linear_group=False, lanes=lanes))
    assert not np.any(nonlinearity(state).share)  # nothing moves yet
    pressed = 3e-7
    state.motion.displacement[1, 0] = -pressed
    stiffness = 1.5e-3  # of h = 1: 1.5 sqrt(d)
    missed = (1e-6 + pressed) ** 1.5 - 1e-6**1.5 - stiffness * pressed
    assert nonlinearity(state).share == pytest.approx(missed / (stiffness * pressed), rel=1e-6)
    state.motion.displacement[1, 0] = 2e-6  # apart: no force is left, which constant stiffness takes for tension
    missed = -(1e-6**1.5) + stiffness * 2e-6
    assert nonlinearity(state).share == pytest.approx(missed / (stiffness * 2e-6), rel=1e-6)


def test_cement_is_linear() -> None:
    """A bonded contact has no share, however far its disks move."""
    scene = pair_scene(gap=-1e-6, sand=SOFT, bonds=Bonds(np.array([[0, 1]]), SOFT_CEMENT), walls=FAR)
    state = start(scene, features=LINEAR)
    state.motion.displacement[1] = [[1e-5], [1e-5], [1e-3]]
    assert not np.any(nonlinearity(state).share)


def test_the_work_of_the_springs_is_that_of_the_net_forces() -> None:
    """With constant stiffness, bonds and bare contacts take up the negative sum of force times displacement."""
    x, y = hexagonal(3, 2, 2.0 * SCENE_RADIUS - 1e-6)
    scene = Scene(x, y, np.full(6, SCENE_RADIUS), SOFT, FAR, Bonds(np.array([[0, 1], [1, 2], [1, 4]]), SOFT_CEMENT))
    state = start(scene, features=LINEAR)
    state.motion.displacement[:, :, 0] = np.random.default_rng(1).normal(size=(6, 3)) * [1e-9, 1e-9, 1e-6]
    moved = state.to_scene_order(state.motion.displacement[:, :, 0])
    work = _spring_work(state, _strained_contacts(state, slice(None)), _intact_bonds(state, slice(None)))
    assert work == pytest.approx(-np.sum(net_forces(state) * moved), rel=1e-6, abs=0.0)


@pytest.mark.parametrize("slide", [1e-12, 1e-9])
def test_a_contact_beyond_its_limit_slips_however_weak_the_pulse(slide: float) -> None:
    """With twice the shear that friction bears it has no stiffness against more of it, and its own against less."""
    scene = pair_scene(gap=-1e-6, sand=SOFT, walls=FAR)
    limit = SOFT.friction * float(SOFT.hertz_coefficient(scene.radius[:1], scene.radius[:1])[0]) * 1e-6**1.5
    held = Preload(np.array([[0, 1]]), np.array([2.0 * limit]))
    state = start(scene, features=replace(LINEAR, bonds=False, linear_group=False), preload=held)
    state.motion.displacement[1, 1] = -slide  # of the second disk: the shear force on it grows
    assert nonlinearity(state).share == pytest.approx(1.0)
    assert nonlinearity(state).softening == pytest.approx(1.0)  # one contact fixes nothing: all of it is spare
    state.motion.displacement[1, 1] = slide
    assert not np.any(nonlinearity(state).softening)


@pytest.mark.parametrize("amplitude", [1e-3, 1e-6])
def test_a_loaded_contact_loses_shear_where_it_is_unloaded(amplitude: float) -> None:
    """The part 1 - sqrt(1 - a / d) of the shear it bears, however weak the wave; nothing where it is pressed."""
    overlap, apart, slide = 1e-6, 1e-6 * amplitude, 2e-6 * amplitude
    scene = pair_scene(gap=-overlap, sand=SOFT, walls=FAR)
    coefficient = float(SOFT.hertz_coefficient(scene.radius[:1], scene.radius[:1])[0])
    borne = 0.5 * SOFT.friction * coefficient * overlap**1.5
    state = start(
        scene,
        features=replace(LINEAR, bonds=False, linear_group=False),
        preload=Preload(np.array([[0, 1]]), np.array([borne])),
    )
    state.motion.displacement[1, :2, 0] = apart, slide
    stiffness = 1.5 * coefficient * overlap**0.5
    work = stiffness * (apart * apart + SOFT.shear_ratio * slide * slide)
    lost = borne * (1.0 - np.sqrt(1.0 - apart / overlap)) * slide
    assert nonlinearity(state).rescaling == pytest.approx(lost / work, rel=1e-6)
    state.motion.displacement[1, 0, 0] = -apart
    assert not np.any(nonlinearity(state).rescaling)


def test_the_bound_counts_half_of_what_shear_rescaling_takes() -> None:
    """A velocity goes with the root of the stiffness; what is expected stays, since work of both signs cancels."""
    rescaled = replace(SECTION, nonlinear=(Nonlinearity(0.0, 0.0, 0.01),))
    assert parts(EXACT, rescaled).regime - parts(EXACT).regime == pytest.approx(0.005)
    usual, same = (estimate_error(EXACT, record, received())[0] for record in (SECTION, rescaled))
    assert same == usual


@pytest.mark.parametrize("bonds", [0, 1])
def test_softening_is_slip_over_what_is_spare(bonds: int) -> None:
    """Of C contacts of N disks one that slips leaves 2 C - 1 components for 3 N ways to move; a bond adds one."""
    x, y = hexagonal(5, 4, 2.0 * SCENE_RADIUS - 1e-6)
    contacts = int(np.sum(np.triu(np.hypot(x - x[:, None], y - y[:, None]) < 2.0 * SCENE_RADIUS, 1)))
    cement = Bonds(np.array([[len(x) - 2, len(x) - 1]])[:bonds], SOFT_CEMENT)
    scene = Scene(x=x, y=y, radius=np.full(len(x), SCENE_RADIUS), sand=SOFT, walls=FAR, bonds=cement)
    state = start(scene, features=LINEAR)
    # The first and the second disk in memory touch; turning against each other they slip, others do not.
    state.assembly.pairs.friction[1:] = 1e9
    state.motion.displacement[0, 2] = 1e-2
    found = nonlinearity(state)
    spare = 1.0 - 3.0 * len(x) / (2.0 * contacts - 1.0 + bonds)
    assert found.softening == pytest.approx(found.share / spare)
    assert found.share > 0.0
    triangle = hexagonal(2, 2, 2.0 * SCENE_RADIUS - 1e-6)
    three = Scene(x=triangle[0][:3], y=triangle[1][:3], radius=np.full(3, SCENE_RADIUS), sand=SOFT, walls=FAR)
    state = start(three, features=replace(LINEAR, bonds=False, linear_group=False))
    state.motion.displacement[0, 2] = 1e-2
    assert nonlinearity(state).softening == np.inf  # six components for nine ways to move


def test_the_transmitter_loses_what_its_friction_does_not_bear() -> None:
    """A wall that slides by p pulls with k_s p as long as that is below mu F_n, by Hertz and Mindlin."""
    overlap, path = 1e-6, 3e-6
    wall = Wall((0.0, overlap - SCENE_RADIUS), (0.0, 1.0), friction=0.4)
    scene = Scene(x=np.zeros(1), y=np.zeros(1), radius=np.full(1, SCENE_RADIUS), sand=SOFT, walls=(wall,))
    state = start(scene, features=replace(LINEAR, bonds=False, linear_group=False))
    state.assembly.walls.motion[0, 1, 0] = path
    borne = 0.4 * overlap / (1.5 * SOFT.shear_ratio * path)
    assert slipped_force(state, 0) == pytest.approx(1.0 - borne)
    state.assembly.walls.motion[0, 1, 0] = borne * path
    assert slipped_force(state, 0) == pytest.approx(0.0, abs=1e-12)
