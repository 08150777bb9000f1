"""The check of a content: which law and step it takes, what it states as errors, and what they do to a velocity."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace

import numpy as np
import pytest
from waves import DISTANCE, FREQUENCY, guided, section, silence

from calcidem.app.campaign.cells import cell_result
from calcidem.dem.engine import leapfrog
from calcidem.dem.engine.scene import Law
from calcidem.dem.kernels.layout import Features, Flags
from calcidem.dem.sample.cement import CementRule
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave import check, measurement
from calcidem.dem.wave.check import Check, check_content, kernels_of, with_check
from calcidem.dem.wave.experiment import Experiment, WaveRule
from calcidem.dem.wave.measurement import Measurement, interpret, measure
from calcidem.dem.wave.propagation import prepare_recorder, send_waves
from calcidem.dem.wave.reading import PickRule, Verdict
from calcidem.dem.wave.section import Section, fit_wave
from calcidem.ends import CellStatus

CONTENT, HELD = 2.55, 2.07
QUIET = 1e-4
"""Amplitude (m/s) at which the contacts of 280 disks under 5 kPa keep their stiffness."""
LOUD = 0.3
"""And one at which they slip and open."""


@pytest.fixture(scope="module")
def quiet(small_packing: Packing) -> Experiment:
    """A small box with a quiet pulse, one wavelength of which is a third of the path."""
    wave = WaveRule(
        amplitude=QUIET,
        transmitter_half_width=0.01,
        receiver_half_width=0.012,
        boundary_thickness=0.012,
        listening_depth=0.006,
        most_broken_bonds=1.0,
    )
    return Experiment(
        small_packing,
        cement_rule=CementRule(p_share=0.77),
        wave=wave,
        pick=PickRule(largest_error=1.0),
        stiffness_factor=13.0,
        frequencies=((0.0, CONTENT), (12e3, 24e3)),
    )


# --- Law and step, from velocities that are written down

Speed = Callable[[WaveRule, float], float]
"""Travel time, periods, of a sample computed with a rule and a sense of the pulse, 2 from the other side."""


def checked(experiment: Experiment, monkeypatch: pytest.MonkeyPatch, travel: Speed) -> tuple[Check, list[WaveRule]]:
    """Check of a content whose samples have such travel times, and the rules of all batches."""
    rules: list[WaveRule] = []

    def sent(
        given: Experiment, bonded: Sequence[object], *_: object, signs: Sequence[float], **__: object
    ) -> list[Section]:
        rules.append(given.wave)
        assert len(bonded) == len(signs)
        is_mirrored = given.packing is not experiment.packing
        assert is_mirrored <= (given.packing.x[0] == experiment.packing.width - experiment.packing.x[0])
        return [section(guided(travel(given.wave, sign * (1 + is_mirrored)), HELD), duration=9.0) for sign in signs]

    monkeypatch.setattr(check, "send_waves", sent)
    monkeypatch.setattr(Experiment, "clamp", HELD / DISTANCE)
    return check_content(experiment, CONTENT, 8), rules


@pytest.mark.parametrize(
    ("law", "apart", "found"),
    [("auto", 0.009, "linear"), ("auto", 0.011, "finite"), ("linear", 0.1, "linear"), ("finite", 0.0, "finite")],
)
def test_the_linear_law_is_taken_where_it_agrees_to_a_percent(
    quiet: Experiment, monkeypatch: pytest.MonkeyPatch, law: Law, apart: float, found: Law
) -> None:
    """With `auto`; a law that the user forces stays, is compared in the same way, and its error is stated."""

    def travel(rule: WaveRule, _: float) -> float:
        return 2.0 * (1.0 + apart * (rule.law == "linear"))

    result, rules = checked(quiet.with_wave(law=law), monkeypatch, travel)
    assert result.law == found
    finer = replace(quiet.wave, law="finite", precision="float64", step_fraction=0.4, samples_per_period=80)
    assert rules[0] == finer
    assert rules[1] == replace(quiet.wave, law="linear" if law == "auto" else law)
    assert result.numerical_error is not None
    assert result.numerical_error == pytest.approx(2.2 * apart * (found == "linear"), rel=0.1, abs=5e-4)
    assert (result.step_fraction == 0.8) == (found == "finite" or apart < 0.01)


@pytest.mark.parametrize(("slope", "halvings"), [(0.02, 0), (0.03, 1), (0.09, 2), (0.3, 3)])
def test_the_step_is_halved_as_long_as_it_matters_by_more_than_a_percent(
    quiet: Experiment, monkeypatch: pytest.MonkeyPatch, slope: float, halvings: int
) -> None:
    """Three times at most; half a step is the difference, and what is left is stated with Student's 2.2."""

    def travel(rule: WaveRule, _: float) -> float:
        return 2.0 * (1.0 + slope * rule.step_fraction)

    result, rules = checked(quiet.with_wave(law="finite"), monkeypatch, travel)
    assert result.step_fraction == 0.8 / 2**halvings
    step = result.step_fraction
    assert [rule.step_fraction for rule in rules] == [
        *(part * 0.8 / 2**n for n in range(halvings + 1) for part in (0.5, 1.0)),
        step,  # from the other side
    ]
    expected = 2.2 * slope * 0.5 * step / (1.0 + 0.75 * slope * step)
    assert result.numerical_error == pytest.approx(expected, rel=0.05)


def test_the_difference_of_both_senses_is_the_effect_of_the_pulse(
    quiet: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each sense is off by half of it, as the standard deviation of two is the difference over sqrt 2."""
    result, _ = checked(quiet.with_wave(law="finite"), monkeypatch, lambda _, sign: 2.0 * (1.0 + 0.02 * sign))
    # The peak of a wave in a strip comes early, so its shift is a larger part of its time.
    assert result.pulse_effect == pytest.approx(2.2 / np.sqrt(2.0) * 0.04, rel=0.03)
    assert result.numerical_error == pytest.approx(0.0, abs=1e-4)  # of a parabola between 40 samples in a period


def test_the_side_that_transmits_is_compared_as_the_cells_are_computed(
    quiet: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With law and step of the check; each side is off by the difference over sqrt 2, and it is no numerical error.

    The rms of eight differences is uncertain, by which 95 % of errors need Student's 2.306 of it instead of 1.960.
    """
    result, rules = checked(quiet, monkeypatch, lambda _, sense: 2.0 * (1.0 + 0.05 * (sense == 2.0)))
    assert rules[-1] == replace(quiet.wave, law=result.law, step_fraction=result.step_fraction)
    assert result.side_error == pytest.approx(2.306 / 1.960 * 0.05 / 1.025 / np.sqrt(2.0), rel=1e-2)
    assert result.numerical_error == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("law", ["auto", "linear", "finite"])
@pytest.mark.parametrize("slow", [False, True])
def test_samples_without_a_wave_have_no_errors(
    quiet: Experiment, monkeypatch: pytest.MonkeyPatch, law: Law, slow: bool
) -> None:
    """What no check sample tells is unknown, not zero; the cheapest law is not confirmed then.

    So it is with a wave as slow as the slowest that is tried: its velocity is that end, and always the same.
    """
    wave = guided(8.5, HELD) if slow else silence
    given = section(wave, duration=40.0 if slow else 6.0)
    monkeypatch.setattr(Experiment, "clamp", HELD / DISTANCE)
    monkeypatch.setattr(check, "send_waves", lambda _given, bonded, *_, **__: [given] * len(bonded))
    found = check_content(quiet.with_wave(law=law), CONTENT, 8)
    assert found == Check("finite" if law == "auto" else law, 0.8, None, None, None)


@pytest.mark.parametrize("law", ["auto", "linear"])
def test_a_wave_that_arrives_under_one_law_only_confirms_nothing(
    quiet: Experiment, monkeypatch: pytest.MonkeyPatch, law: Law
) -> None:
    """Of two patterns one has no wave under the finite law: `auto` takes that law, a forced one has no known error."""
    heard, silent = section(guided(2.0, HELD), duration=9.0), section(silence, duration=6.0)

    def sent(given: Experiment, bonded: Sequence[object], *_: object, **__: object) -> list[Section]:
        return [silent if given.wave.law == "finite" and one % 2 else heard for one in range(len(bonded))]

    monkeypatch.setattr(check, "send_waves", sent)
    monkeypatch.setattr(Experiment, "clamp", HELD / DISTANCE)
    found = check_content(quiet.with_wave(law=law), CONTENT, 8)
    same = pytest.approx(0.0, abs=1e-4)  # of a parabola between samples
    expected = Check("finite", 0.8, same, same, 0.0) if law == "auto" else Check("linear", 0.1, None, same, 0.0)
    assert found == expected


# --- Real samples


def test_a_quiet_content_is_confirmed_linear(quiet: Experiment) -> None:
    """Law, step, precision and pulse matter less than 1 %, and the errors are stated with the velocities."""
    for content in (0.0, CONTENT):
        found = quiet.once(check_content, content, 8)
        assert (found.law, found.step_fraction) == ("linear", 0.8)
        assert found.numerical_error is not None
        assert 0.0 < found.numerical_error < 0.022
        assert found.pulse_effect is not None
        assert found.pulse_effect < 0.01


def test_a_check_depends_neither_on_lanes_nor_on_the_seeds_that_are_asked_for(quiet: Experiment) -> None:
    """Its samples are its own, and a sample has the same bits in any batch."""
    expected = quiet.once(check_content, CONTENT, 8)
    assert check_content(quiet, CONTENT, 1) == expected
    for seeds in ((5,), (7, 6)):
        for found in measure(replace(quiet), CONTENT, seeds):
            assert found.check == expected
            assert found.section.time_step == expected.step_fraction * found.section.stability_limit


def test_a_loud_content_takes_the_finite_law_and_says_what_its_pulse_does(quiet: Experiment) -> None:
    """Contacts slip and open: the sense of the pulse matters by percents; a forced linear law states its error."""
    loud = quiet.with_wave(amplitude=LOUD)
    found = check_content(loud, CONTENT, 8)
    assert found.law == "finite"
    assert found.pulse_effect is not None
    assert found.pulse_effect > 0.02
    forced = check_content(loud.with_wave(law="linear"), CONTENT, 8)
    assert forced.law == "linear"
    assert forced.numerical_error is not None
    assert forced.numerical_error > 0.01
    assert forced.pulse_effect == pytest.approx(found.pulse_effect, rel=0.5)


@pytest.mark.parametrize("amplitude", [QUIET, LOUD])
def test_every_kernel_of_a_content_is_named(
    quiet: Experiment, monkeypatch: pytest.MonkeyPatch, amplitude: float
) -> None:
    """Those of the samples and of their check, and where the check refuses the linear law one more."""
    experiment, kept = quiet.with_wave(amplitude=amplitude), leapfrog.run_kernel
    used: set[tuple[Features, str]] = set()

    def watched(state: leapfrog.State, *arguments: object) -> int:
        used.add((state.features, state.motion.velocity.dtype.name))
        return kept(state, *arguments)  # type: ignore[arg-type]

    named = set()
    for _, settings, lanes in kernels_of(experiment, 8):
        bonded = experiment.ordering(0).at(CONTENT).bonded
        state = prepare_recorder(settings, [bonded], 24e3, lanes, lambda: None).state
        named.add((state.features, state.motion.velocity.dtype.name))
    monkeypatch.setattr(leapfrog, "run_kernel", watched)
    for content in (0.0, CONTENT):
        measure(experiment, content, [1])
    assert len(named) == 2
    assert named <= used
    assert len(used) == (2 if amplitude == QUIET else 3)
    assert len(kernels_of(replace(experiment, is_checked=False), 8)) == 1


def test_a_reversed_pulse_is_the_exact_negative_under_the_linear_law(quiet: Experiment) -> None:
    """Sections are positive as the pulse, so they have the same bits; under the finite law a loud one has not."""
    bonded = [quiet.ordering(1).at(CONTENT).bonded] * 2

    def pair(law: Law, amplitude: float) -> list[Section]:
        return send_waves(
            quiet.with_wave(law=law, amplitude=amplitude),
            bonded,
            24e3,
            stop_when=lambda one: one.duration > 2e-4,
            signs=(1.0, -1.0),
        )

    forth, back = pair("linear", QUIET)
    assert np.abs(forth.across).max() > 1e3
    np.testing.assert_array_equal(forth.across, back.across)
    np.testing.assert_array_equal(forth.along, back.along)
    forth, back = pair("finite", LOUD)
    assert np.any(forth.across != back.across)


# --- What a measurement makes of it


def test_a_measurement_takes_law_and_step_of_its_check(quiet: Experiment) -> None:
    """And nothing else of the experiment changes."""
    given = with_check(quiet, Check("finite", 0.2, None, None, None))
    assert given.wave == replace(quiet.wave, law="finite", step_fraction=0.2)
    for field in fields(Experiment):
        assert field.name in {"wave", "_kept"} or getattr(given, field.name) is getattr(quiet, field.name)


def test_errors_of_the_check_are_part_of_the_effective_error_and_may_refuse_vs(
    quiet: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Root of the sum of squares; above 5 % of the effective velocity there is no Vs, and the reason has it.

    If the check could not measure them, there is no velocity at all; an experiment without a check says so by itself.
    """
    monkeypatch.setattr(Experiment, "clamp", HELD / DISTANCE)
    given = section(guided(2.5, HELD))
    cement = quiet.ordering(1).at(CONTENT)

    def with_error(*errors: float | None, experiment: Experiment = quiet) -> Measurement:
        found = Check("linear", 0.8, *errors)
        return interpret(experiment, Measurement(1, CONTENT, cement, given, found))

    plain = with_error(0.0, 0.0, 0.0)
    assert plain.status is CellStatus.DONE
    assert plain.reading is not None
    assert plain.effective_vs == plain.reading.wave.velocity == pytest.approx(DISTANCE * FREQUENCY / 2.5, rel=1e-3)
    assert plain.effective_error == plain.reading.wave.error
    part = plain.reading.wave.error
    assert with_error(2.0 * part, 2.0 * part, 0.9 * part).effective_error == pytest.approx(3.0 * part)
    assert with_error(2.0 * part, 0.0, 1.5 * part).effective_error == pytest.approx(2.5 * part)  # the larger of two
    assert with_error(0.049, 0.0, 0.0).vs == plain.vs
    refused = with_error(0.051, 0.0, 0.0)
    assert (refused.status, refused.vs) == (CellStatus.NO_ARRIVAL, None)
    assert refused.effective_vs == plain.effective_vs
    assert Verdict.of(refused.reason) is Verdict.INACCURATE
    assert "5.1%" in refused.reason
    alone = {
        with_error(None, 0.0, 0.0): "with other settings their",
        with_error(0.0, None, 0.0): "with the pulse reversed their",
        with_error(0.0, 0.0, None): "with the wave from the other side their",
    }
    for unknown, cause in alone.items():
        assert cause in unknown.reason
        assert (unknown.status, unknown.vs, unknown.effective_vs) == (CellStatus.NO_ARRIVAL, None, None)
        assert Verdict.of(unknown.reason) is Verdict.INACCURATE
    unchecked = with_error(None, None, None, experiment=replace(quiet, is_checked=False))
    assert (unchecked.vs, unchecked.effective_vs) == (plain.vs, plain.effective_vs)


def test_seeds_are_measured_in_batches_of_the_kernels_width(monkeypatch: pytest.MonkeyPatch, quiet: Experiment) -> None:
    """All of them, in order."""
    seeds, batches = [5, 3, 1, 2, 4], list[list[bytes]]()

    def sent(_experiment: Experiment, bonded: list[Flags], _frequency: float, **_options: object) -> list[bytes]:
        batches.append([flags.tobytes() for flags in bonded])
        return batches[-1]

    monkeypatch.setattr(measurement, "send_waves", sent)
    monkeypatch.setattr(measurement, "interpret", lambda _, one: one)
    found = measure(replace(quiet, is_checked=False), CONTENT, seeds, lanes=2)
    assert [one.seed for one in found] == seeds
    patterns = [quiet.ordering(seed).at(CONTENT).bonded.tobytes() for seed in seeds]
    assert [one.section for one in found] == patterns
    assert batches == [patterns[:2], patterns[2:4], patterns[4:]]


def test_both_sides_give_their_mean_with_the_error_of_a_mean(quiet: Experiment) -> None:
    """All else is that of one side; the other one is that of the mirrored packing with the same cement."""
    seeds = (1, 2)
    one, both = (measure(quiet.with_wave(both_sides=sides), CONTENT, seeds) for sides in (False, True))
    bonded = [quiet.ordering(seed).at(CONTENT).bonded for seed in seeds]
    settings = with_check(replace(quiet, packing=quiet.packing.mirrored()), one[0].check)
    sections = send_waves(settings, bonded, quiet.frequency(CONTENT), lanes=8, raise_if_stopped=lambda: None)
    for before, after, section_ in zip(one, both, sections, strict=True):
        assert before.other_wave is None
        assert (after.section.across == before.section.across).all()
        assert (after.vs, after.check) == (before.vs, before.check)
        assert after.reading is not None
        here, there = after.reading.wave, fit_wave(section_, quiet.clamp)
        assert there is not None
        assert after.other_wave == there
        assert there.velocity != here.velocity == before.effective_vs
        assert after.effective_vs == 0.5 * (here.velocity + there.velocity)
        known = replace(after, check=replace(after.check, numerical_error=0.0, pulse_effect=0.0, side_error=0.0))
        assert known.effective_error == pytest.approx(0.5 * np.hypot(here.error, there.error))
        side = replace(known, check=replace(known.check, side_error=0.5))
        assert side.effective_error == pytest.approx(0.5 / np.sqrt(2.0))
        lost = replace(known, other_wave=there._replace(error=1.0))
        assert (lost.effective_vs, lost.effective_error) == (here.velocity, pytest.approx(here.error))
        only = replace(known, reading=replace(known.reading, wave=here._replace(error=1.0)))
        assert (only.effective_vs, only.effective_error) == (there.velocity, pytest.approx(there.error))
        stored = cell_result(after, quiet, store_sections=True)
        assert (stored.effective_vs, stored.effective_vs_other_side) == (after.effective_vs, there.velocity)


def test_without_a_wave_from_its_own_side_a_sample_has_none_from_the_other(
    quiet: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A velocity from one side alone is always that of the usual side."""
    monkeypatch.setattr(measurement, "interpret", lambda _, one: one)
    (found,) = measure(replace(quiet.with_wave(both_sides=True), is_checked=False), CONTENT, [1])
    assert found.reading is found.other_wave is found.effective_vs is None


def test_a_sample_that_holds_no_cement_is_sent_beside_cemented_ones_as_alone(quiet: Experiment) -> None:
    """As at so small a content that some seeds cement no contact: those have longer steps and another sampling."""
    cemented, bare = quiet.ordering(1).at(CONTENT).bonded, np.zeros(len(quiet.packing.pairs), dtype=bool)
    samples, signs = [bare, cemented, bare], [1.0, 1.0, -1.0]
    for found, flags, sign in zip(send_waves(quiet, samples, 24e3, signs=signs), samples, signs, strict=True):
        (alone,) = send_waves(quiet, [flags], 24e3, signs=[sign])
        assert (alone.across == found.across).all()
        assert (alone.sampling_interval, alone.steps) == (found.sampling_interval, found.steps)
