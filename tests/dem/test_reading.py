"""Reading of sections that are written down: waves in a strip by an inverse transform of their own."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import find_peaks
from waves import DISTANCE, FREQUENCY, PARTS, Wave, at_receiver, guided, periods, section, silence, total, wave

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.propagation import SAMPLES_PER_CHUNK
from calcidem.dem.wave.reading import (
    PickRule,
    Reading,
    Verdict,
    _peaks_of_wave,
    arrival_shift,
    describe_refusal,
    is_settled,
    read_section,
    record_duration,
    smooth,
)
from calcidem.dem.wave.section import (
    Section,
    StripWave,
    _least,
    clamp_of_strip,
    far_stations,
    fit_wave,
    fitness,
    waveform,
)

ANY_ERROR = PickRule(largest_error=1.0)
HELD = 2.07
"""K of the preset `paper`, times the path."""
CLAMP = HELD / DISTANCE
PATHS = (0.5, 0.7, 1.0, 1.5, 2.5, 5.0)
"""Wavelengths on the path, which are periods of travel."""


def read(given: Section, held: float = HELD, rule: PickRule = ANY_ERROR) -> Reading:
    """Reading of a section; fails if there is no wave."""
    found = read_section(given, held / DISTANCE, rule)
    assert isinstance(found, Reading), found
    return found


def off(found: Reading, travel: float) -> float:
    """Relative error of the effective velocity."""
    return travel / periods(found.wave.velocity) - 1.0


def first_settled(given: Section, stride: int = 1) -> int:
    """Samples after which a record ends that is looked at so often."""
    return next(n for n in range(stride, len(given.across) + 1, stride) if is_settled(given.until(n), CLAMP, np.inf))


# --- The fitted wave


@pytest.mark.parametrize("held", [0.0, HELD])
@pytest.mark.parametrize("travel", PATHS)
def test_a_wave_in_a_strip_has_its_velocity(travel: float, held: float) -> None:
    """From half a wavelength to five, as a plane wave or clamped, with any gains of the stations."""
    given = section(guided(travel, held))
    found = read(given, held)
    # A parabola through three values 1.67 % apart, whose misfit is no parabola.
    assert off(found, travel) == pytest.approx(0.0, abs=3e-4)
    assert 0.99 < found.wave.coherence <= 1.0
    gains = 2 ** np.arange(10) % 7 + 1
    scaled = fit_wave(replace(given, across=given.across * gains.astype(np.int32)), held / DISTANCE)
    assert scaled is not None
    assert scaled.velocity == pytest.approx(found.wave.velocity, rel=1e-6)  # squares of small counts are rounded


@pytest.mark.parametrize("travel", PATHS)
def test_another_clamp_costs_as_much_as_is_stated(travel: float) -> None:
    """K is known to 15 %, which is the error of a perfect section; without any K long waves are far too fast."""
    given = section(guided(travel, 1.15 * HELD))
    found = read(given)
    assert off(found, travel) == pytest.approx(found.wave.error, rel=0.2, abs=3e-4)
    # omega^2 = c^2 (k^2 + K^2), where the section is felt at about the pulse's frequency, less damped ones more.
    plane = off(read(section(guided(travel, HELD)), 0.0), travel)
    assert plane > 0.7 * (np.sqrt(1.0 + (HELD / (2.0 * np.pi * travel)) ** 2) - 1.0)


def test_the_clamp_of_a_strip() -> None:
    """K = pi cp / (cs h), with cp / cs = 1.4."""
    assert clamp_of_strip(0.2) == pytest.approx(22.0, rel=1e-3)


@pytest.mark.parametrize("travel", PATHS)
def test_a_waveform_is_the_inverse_transform(travel: float) -> None:
    """Without frequencies above three times that of the pulse, which has 2 % of its height there."""
    time = np.linspace(0.0, travel + 1.5, 300)
    strip = StripWave(DISTANCE * FREQUENCY / travel, 0.0, 1.0, CLAMP)
    (found,) = waveform(strip, FREQUENCY, (DISTANCE,), time[None] / FREQUENCY)
    np.testing.assert_allclose(0.5 * found, guided(travel, HELD)(1.0, time), rtol=0.0, atol=0.02)


def test_the_fit_sees_the_far_stations_alone() -> None:
    """Those beyond half of the path; a motion of the others changes no bit, and a station at rest leaves no wave."""
    assert far_stations((0.1, 0.4, 0.5, 0.7, 1.0)) == (0.5, 0.7, 1.0)
    given = section(guided(1.5, HELD))
    near = np.array(PARTS) < 0.5
    assert near.sum() == 4
    assert fit_wave(replace(given, across=given.across * np.where(near, 3, 1).astype(np.int32)), CLAMP) == fit_wave(
        given, CLAMP
    )
    dead = given.across.copy()
    dead[:, 6] = 0
    assert fit_wave(replace(given, across=dead), CLAMP) is None
    assert read_section(replace(given, across=dead), CLAMP) is Verdict.SILENT


def test_fitness_is_the_coherence_of_each_velocity() -> None:
    """Highest at the velocity that fits, where it is that of the fit."""
    given = section(guided(2.5, HELD))
    best = read(given).wave
    values = fitness(given, CLAMP, best.velocity * np.array([0.8, 1.0, 1.25]))
    assert values[1] > max(values[0], values[2]) + 0.3
    assert values[1] == pytest.approx(best.coherence, abs=0.01)  # which is that of the best velocity tried


def test_few_stations_and_the_ends_of_the_search_have_no_error() -> None:
    """Two stations have no jackknife, and a wave below 0.3 wavelengths on the path is none of those tried."""
    given = section(guided(1.5, HELD), parts=(0.2, 0.8, 1.0))
    assert off(read(given), 1.5) == pytest.approx(0.0, abs=3e-4)
    assert read(given).wave.error == read(given).error == 1.0
    three = read(section(guided(1.5, HELD), parts=(0.2, 0.6, 0.8, 1.0))).wave
    assert three.error < 0.05  # of the clamp, as a perfect section has it
    fast = fit_wave(section(wave(0.2)), 0.0)
    assert fast is not None
    assert fast.velocity == pytest.approx(DISTANCE * FREQUENCY / 0.3)
    assert fast.error == 1.0


@pytest.mark.parametrize(("share", "within"), [(0.2, 0.06), (0.5, 0.13)])
@pytest.mark.parametrize("ratio", [1.4, 2.0])
@pytest.mark.parametrize("travel", [0.7, 1.0, 1.5])
def test_a_p_wave_across_moves_the_fit_by_less_than_its_share(
    travel: float, ratio: float, share: float, within: float
) -> None:
    """Of either sign, where it is not yet apart from the S wave."""
    for height in (share, -share):

        def early(part: float, time: Floats, height: float = height) -> Floats:
            return height * guided(travel / ratio, HELD)(part, time)

        assert abs(off(read(section(total(guided(travel, HELD), early))), travel)) < within


@pytest.mark.parametrize("height", [0.2, 0.5])
def test_a_p_wave_that_is_apart_is_not_taken_for_the_wave_up_to_a_half(height: float) -> None:
    """On four wavelengths the transform weighs what comes two periods earlier e times as much."""

    def early(part: float, time: Floats) -> Floats:
        return height * guided(2.0, HELD)(part, time)

    velocity = read(section(total(guided(4.0, HELD), early))).wave.velocity
    assert periods(velocity) == pytest.approx(4.0, rel=0.01)


# --- The peak at the receiver


@pytest.mark.parametrize("held", [0.0, HELD, 2.0 * HELD])  # in thinner strips crests are two thirds of a period apart
def test_the_peak_of_a_fitted_wave_moves_smoothly_with_its_velocity(held: float) -> None:
    """From half a wavelength on the path: the edge of the samples looked at is no crest, nor is a later crest taken.

    A fit that changes by a part in a hundred must not move the peak by more than a few of them of the travel time.
    """
    given = section(guided(1.0, HELD))
    travel = np.geomspace(0.5, 3.0, 180)  # wavelengths on the path
    waves = [StripWave(DISTANCE * FREQUENCY / one, 0.0, 1.0, held / DISTANCE) for one in travel]
    peaks = [_peaks_of_wave(given, wave, (DISTANCE,))[0] - given.transmitted_peak for wave in waves]
    assert np.all(np.array(peaks) > 0.0)
    assert np.abs(np.diff(np.log(peaks))).max() < 0.03


@pytest.mark.parametrize("travel", PATHS)
def test_the_peak_of_a_strip_wave_is_early_by_the_stated_bias(travel: float) -> None:
    """That of the wave on a fine grid; without its high frequencies the fitted one peaks 4e-3 periods earlier."""
    time = np.linspace(0.0, travel + 2.0, 20_001)
    top = time[np.argmax(guided(travel, HELD)(1.0, time))] - 0.5
    found = read(section(guided(travel, HELD)))
    assert periods(found.peak) == pytest.approx(top, rel=2e-3)
    assert travel / (1.0 + found.bias) == pytest.approx(top, abs=0.01)
    plane = read(section(guided(travel, 0.0)), 0.0)
    assert plane.bias == pytest.approx(0.0, abs=5e-4)
    assert periods(plane.peak) == pytest.approx(travel, rel=1e-4)
    assert periods(plane.cross_correlation) == pytest.approx(travel, rel=1e-4)
    assert periods(plane.first_arrival) == pytest.approx(travel, rel=1e-4)  # both feet are smoothed likewise


def test_a_wave_that_a_strip_does_not_pass_has_no_peak() -> None:
    """Far below the cut-off frequency of a thin strip nothing arrives; an edge of the samples is no peak."""
    slow = StripWave(DISTANCE * FREQUENCY / 0.6, 0.0, 1.0, 6.0 * CLAMP)
    assert np.isnan(_peaks_of_wave(section(guided(1.0, HELD)), slow, (DISTANCE,))[0])


@pytest.mark.parametrize("late", [-0.3, -0.013, 0.0, 1e-4, 0.2])
@pytest.mark.parametrize("travel", [0.7, 2.0])
@pytest.mark.parametrize("samples", [40, 67])
def test_the_shift_of_an_arrival_is_its_delay(late: float, travel: float, samples: int) -> None:
    """Also between records of other sampling and length, which cubics through 40 samples allow to 1e-3 of a period."""
    first = section(wave(travel), duration=travel + 1.5)
    second = section(wave(travel + late, height=0.9), samples=samples, duration=travel + 1.6)
    shift = arrival_shift(first, second, travel / FREQUENCY) * FREQUENCY
    assert shift == pytest.approx(late, abs=1e-3)


def test_peaks_that_change_places_are_no_shift() -> None:
    """The last grains make two equal crests; the least change decides which one is read."""

    def motion(second: float) -> Wave:
        crests = total(wave(2.0, 1.0, 3.0), wave(2.4, second, 3.0))
        return lambda part, time: crests(1.0, time) if part == 1.0 else wave(2.0)(part, time)

    one, other = (section(motion(height)) for height in (1.0, 1.01))
    found = read(one, 0.0)
    assert abs(arrival_shift(one, other, found.travel_time)) * FREQUENCY < 5e-3
    assert np.isnan(arrival_shift(one, other.until(int(2.1 * 40)), found.travel_time))


def test_a_late_receiver_is_late_and_says_so() -> None:
    """The last grains delay the peak, not the wave; the error is the rms distance of the far stations' peaks."""
    late = np.where(np.array(PARTS) == 1.0, 0.1, 0.0)

    def motion(part: float, time: Floats) -> Floats:
        return guided(2.0, 0.0)(part, time - float(late[PARTS.index(part)]))

    found = read(section(motion), 0.0)
    assert periods(found.peak) == pytest.approx(2.1, rel=1e-3)
    expected = periods(found.wave.velocity)
    assert 2.0 < expected < 2.05
    places = np.array(far_stations(PARTS))
    apart = places * (2.0 - expected) + late[-len(places) :]
    assert found.error * 2.1 == pytest.approx(np.sqrt(np.sum(apart**2) / (len(places) - 1)), rel=0.01)


def between_two_peaks(early: float) -> Section:
    """Wave of 3 periods whose receiver has a short peak before and another after it, 0.84 periods apart."""

    def stations(part: float, time: Floats) -> Floats:
        return wave(3.0)(part, time) * (part < 1.0)

    return section(total(stations, *(at_receiver(wave(3.0 - early + late, faster=2.0)) for late in (0.0, 0.84))))


def test_of_two_peaks_as_near_either_may_be_the_wave() -> None:
    """A small shift exchanges them: the velocities differ by their distance, which is within 1.96 stated errors."""
    first, second = (read(between_two_peaks(early), 0.0) for early in (0.425, 0.45))
    early, late = periods(first.peak), periods(second.peak)
    assert late - early == pytest.approx(0.84, abs=0.03)
    assert abs(late - early) < 1.96 * min(first.error * early, second.error * late)
    assert read(between_two_peaks(0.6), 0.0).error < 0.25 * min(first.error, second.error)  # there one is much nearer


@pytest.mark.parametrize("jitter", [0.0, 0.1, 0.2])
def test_other_peaks_count_by_their_likelihood(jitter: float) -> None:
    """The errors of a wave train are those of a twin that knows nothing of the reading but its wave."""
    late = jitter * np.random.default_rng(0).normal(size=len(PARTS))

    def train(part: float, time: Floats) -> Floats:
        since = time - float(late[PARTS.index(part)])
        return total(wave(3.0), at_receiver(wave(2.4, 0.5, 2.0)), at_receiver(wave(3.7, 0.7, 2.0)))(part, since)

    given = section(train)
    found = read(given, 0.0)
    expected = periods(found.wave.velocity * (1.0 + found.bias))
    times = given.times * FREQUENCY - 0.5  # after the pulse's peak
    places = np.array(far_stations(PARTS))
    motion = smooth(given.across[:, -len(places) :] / 2**20, 0.3 * given.period)
    peaks = [times[find_peaks(one, height=0.001)[0]] for one in motion.T]
    near = [one[np.abs(one - place * expected).argmin()] for one, place in zip(peaks, places, strict=True)]
    scatter = np.sum((np.array(near) - places * expected) ** 2) / (len(places) - 1)
    spread = scatter + (found.wave.error * near[-1]) ** 2
    likelihood = np.exp(-((peaks[-1] - expected) ** 2) / (2 * spread + 1e-9))
    error = np.sqrt(scatter + np.average((peaks[-1] - near[-1]) ** 2, weights=likelihood))
    assert found.error * near[-1] == pytest.approx(error, abs=0.02)
    assert (error > 0.2) == (jitter == 0.2)


@pytest.mark.parametrize(("level", "hidden"), [(0.085, False), (0.115, True)])
def test_a_foot_hides_the_first_arrival_if_it_is_higher_than_a_tenth(level: float, hidden: bool) -> None:
    """The last rise through a tenth of the peak is the onset; further than a quarter of a period it is none."""

    def foot(_: float, time: Floats) -> Floats:
        return np.where((time > 2.0) & (time < 4.6), level * np.minimum(1.0, 2.0 * np.abs(time - 2.0)), 0.0)

    given = section(lambda part, time: np.maximum(wave(4.0)(part, time), at_receiver(foot)(part, time)))
    found = read(given, 0.0)
    assert periods(found.peak) == pytest.approx(4.0, abs=0.01)
    assert (found.first_arrival is None) == hidden


# --- Errors


def drawn(seed: int) -> tuple[float, Section]:
    """Travel time, periods, and a section with P wave, scattered arrivals, uneven stations and noise."""
    generator = np.random.default_rng([17, seed])
    draw = generator.uniform
    travel, ratio, share = float(np.exp(draw(np.log(0.6), np.log(5.0)))), draw(1.4, 2.0), draw(-0.2, 0.2)
    late, gains = 0.02 * travel * generator.normal(size=10), np.exp(0.3 * generator.normal(size=10))
    noise = draw(0.0, 0.03)

    def motion(part: float, time: Floats) -> Floats:
        place, rough = PARTS.index(part), noise * generator.normal(size=len(time)) * np.minimum(time, 1.0)
        since = time - late[place]
        waves = guided(travel, HELD)(part, since) + share * guided(travel / ratio, HELD)(part, since)
        return np.asarray(gains[place] * (waves + rough))

    return travel, section(motion, duration=2.24 * travel + 4.0)


@pytest.mark.parametrize("seeds", [range(40), pytest.param(range(40, 400), marks=pytest.mark.full)])
def test_errors_cover_and_a_record_that_ends_when_settled_has_the_same_velocities(seeds: range) -> None:
    """At least 90 % lie within 1.96 stated errors; the end changes the fit by less than a tenth of its error.

    That is .4 to .7 %, since a record below a wavelength ends soon after the pulse; above it is .1 %.
    """
    effective, peaks = [], []
    for seed in seeds:
        travel, given = drawn(seed)
        whole, ended = read(given), read(given.until(first_settled(given, SAMPLES_PER_CHUNK)))
        tolerance = 0.1 * whole.wave.error if travel < 1.0 else 1e-3
        assert ended.wave.velocity == pytest.approx(whole.wave.velocity, rel=tolerance), seed
        effective.append(off(whole, travel) / whole.wave.error)
        if whole.peak is not None:
            assert ended.peak == pytest.approx(whole.peak, rel=1e-6), seed
            peaks.append((travel / periods(whole.peak) / (1.0 + whole.bias) - 1.0) / whole.error)
    assert len(peaks) > 0.9 * len(seeds)
    for deviations in (effective, peaks):
        assert np.mean(np.abs(deviations) < 1.96) > 0.9
        assert np.sqrt(np.mean(np.square(deviations))) > 0.2  # and they are not stated far too large


def test_noise_and_late_stations_raise_the_errors() -> None:
    """In proportion; those of a perfect section are that of K alone, and nearly none."""
    generator = np.random.default_rng(5)
    shifts = 0.03 * generator.normal(size=10)

    def late(times: float) -> Reading:
        return read(section(lambda part, time: wave(3.0)(part, time - times * float(shifts[PARTS.index(part)]))), 0.0)

    none, once, twice = (late(times) for times in (0.0, 1.0, 2.0))
    assert none.wave.error < 1e-3
    assert none.error < 1e-3
    assert twice.error == pytest.approx(2.0 * once.error, rel=0.1)
    assert twice.wave.error == pytest.approx(2.0 * once.wave.error, rel=0.2)


@pytest.mark.parametrize("place", range(1, 9))
def test_the_minimum_of_a_misfit_is_the_vertex_of_its_parabola(place: int) -> None:
    """Between any two velocities but the outermost, where there is no parabola, to either side of a value."""
    velocities = np.linspace(900.0, 100.0, 10)
    for beside in (-0.4, 0.0, 0.4):
        vertex = 900.0 - (place + beside) * 800.0 / 9.0
        assert _least(velocities, (velocities - vertex) ** 2) == pytest.approx(vertex)
    for end in (0, 9):
        assert _least(velocities, (velocities - velocities[end]) ** 2) == velocities[end]


# --- Verdicts


def test_nothing_below_a_thousandth_is_read() -> None:
    """Silence is a thousandth of v0; the record ends when nothing louder can come."""
    for quiet in (section(silence), section(wave(4.0, 0.00095))):
        assert read_section(quiet, 0.0) is Verdict.SILENT
        assert not is_settled(quiet, 0.0, 1.01e-3 * quiet.amplitude)
        assert is_settled(quiet, 0.0, 0.99e-3 * quiet.amplitude)
        assert is_settled(quiet.until(41), 0.0, 0.0)
        assert not is_settled(quiet.until(39), 0.0, 0.0)  # the pulse is being sent
    assert "reaches 0.09" in describe_refusal(Verdict.SILENT, section(wave(4.0, 0.00095)), PickRule())
    assert periods(read(section(wave(4.0, 0.00125)), 0.0).peak) == pytest.approx(4.0, rel=1e-2)


@pytest.mark.parametrize("travel", PATHS)
def test_a_record_is_long_enough_at_its_horizon(travel: float) -> None:
    """1.4 travel times of the fitted wave and 1.35 periods; not a sample earlier."""
    given = section(guided(travel, HELD))
    needed = first_settled(given)
    assert read_section(given.until(needed - 1), CLAMP) is Verdict.TOO_SHORT
    found = read(given.until(needed))
    lasts = record_duration(DISTANCE, found.wave.velocity, FREQUENCY)
    assert lasts * FREQUENCY == pytest.approx(1.4 * periods(found.wave.velocity) + 1.35)
    assert given.times[needed - 1] >= lasts > given.times[needed - 2] * 0.99
    assert found.wave.velocity == pytest.approx(read(given).wave.velocity, rel=1e-2 if travel < 1.0 else 1e-3)
    assert found.peak == pytest.approx(read(given).peak, rel=1e-9)


def test_forerunners_do_not_end_a_record() -> None:
    """Before the S wave comes, noise of a thousandth and a P wave fit some fast wave, badly."""
    generator = np.random.default_rng(0)

    def motion(part: float, time: Floats) -> Floats:
        return (
            guided(5.0, HELD)(part, time)
            - 0.3 * guided(2.5, HELD)(part, time)
            + 1e-3 * generator.normal(size=len(time)) * np.minimum(time, 1.0)
        )

    given = section(motion)
    assert periods(read(given.until(first_settled(given, SAMPLES_PER_CHUNK))).wave.velocity) == pytest.approx(
        5.0, rel=0.01
    )


def test_a_wave_that_fits_badly_ends_its_record_when_nothing_as_large_can_come() -> None:
    """Stations that are early and late by turns fit no wave well: the record goes on, but not until its longest end."""

    def motion(part: float, time: Floats) -> Floats:
        return guided(2.5, HELD)(part, time + 0.4 * (-1.0) ** PARTS.index(part))

    given = section(motion)
    found = read(given)
    assert found.wave.error > 0.15
    largest = np.abs(given.received).max()
    assert not is_settled(given, CLAMP, 1.01 * largest)
    assert is_settled(given, CLAMP, 0.99 * largest)
    needed = int(record_duration(DISTANCE, found.wave.velocity, FREQUENCY) / given.sampling_interval)
    assert not is_settled(given.until(needed - 10), CLAMP, 0.0)  # a slower wave than the present one may be fitted yet


@pytest.mark.parametrize("travel", [0.5, 1.5])
def test_the_fit_needs_no_pick(travel: float) -> None:
    """A receiver that moves the other way has no peak, and the stations have their wave."""
    turned: Wave = at_receiver(lambda part, time: -2.0 * guided(travel, HELD)(part, time))
    given = section(total(guided(travel, HELD), turned))
    found = read(given)
    assert found.verdict is Verdict.NO_PEAK
    assert found.peak is found.first_arrival is found.cross_correlation is None
    assert off(found, travel) == pytest.approx(0.0, abs=5e-4)
    assert "coherence of 0.8" in describe_refusal(found, given, PickRule())


def test_the_largest_error_is_the_users() -> None:
    """A refused reading keeps its wave and its error, and has no velocity to the receiver."""
    _, given = drawn(1)
    whole = read(given)
    assert read(given, rule=PickRule(largest_error=1.001 * whole.error)).peak == whole.peak is not None
    refused = read(given, rule=PickRule(largest_error=0.999 * whole.error))
    assert refused.verdict is Verdict.UNCERTAIN
    assert (refused.error, refused.wave) == (whole.error, whole.wave)
    assert {refused.peak, refused.first_arrival, refused.cross_correlation} == {None}
    assert f"{whole.error:.1%}" in describe_refusal(refused, given, PickRule())


@pytest.mark.parametrize(("error", "is_read"), [(0.48, True), (0.52, False)])
def test_by_default_half_of_the_travel_time_is_too_large_an_error(error: float, is_read: bool) -> None:
    """Peaks of the far stations are alternately early and late by as much as makes such an error."""

    def motion(part: float, time: Floats, late: float) -> Floats:
        return wave(0.38)(part, time + late * (-1.0) ** PARTS.index(part))

    def alternating(late: float) -> Section:
        return section(lambda part, time: motion(part, time, late))

    given = min(map(alternating, np.linspace(0.1, 0.265, 34)), key=lambda one: abs(read(one, 0.0).error - error))
    assert read(given, 0.0).error == pytest.approx(error, abs=0.01)
    assert (read(given, 0.0, PickRule()).peak is not None) == is_read


def test_a_section_of_the_wrong_sense_has_no_wave() -> None:
    """Sections are positive as the pulse: a mirrored one correlates with nothing."""
    for travel in (0.7, 1.5, 4.0):
        given = section(guided(travel, HELD))
        mirrored = fit_wave(replace(given, across=-given.across), CLAMP)
        assert mirrored is not None
        assert mirrored.coherence < 0.3


@pytest.mark.parametrize("name", ["smoothing", "largest_error"])
@pytest.mark.parametrize("value", [0.0, -0.1, 1.1, float("nan")])
def test_impossible_rules_are_refused(name: str, value: float) -> None:
    """With the name of the field."""
    with pytest.raises(ValueError, match=name):
        PickRule(**{name: value})


# --- Smoothing


@given(st.floats(2.0, 15.0), st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4))
def test_smoothing_leaves_cubics_unchanged(half_width: float, terms: list[float]) -> None:
    """Where the whole window is inside of the record."""
    time = np.linspace(-1.0, 1.0, 80)
    cubic = np.polynomial.Polynomial(terms)(time)
    smoothed = smooth(cubic, half_width)
    inside = slice(int(half_width), len(smoothed))
    np.testing.assert_allclose(smoothed[inside], cubic[inside], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("half_width", [2.6, 6.0, 12.3])
def test_smoothing_is_local_regression(half_width: float) -> None:
    """The naive twin fits each cubic by itself; before the record all is at rest, and what comes later is not seen."""
    noise, reach = np.random.default_rng(3).normal(size=60), int(half_width)
    before = np.concatenate([np.zeros(reach), noise])
    j = np.arange(-reach, reach + 1)
    weight = (1.0 - (j / half_width) ** 2) ** 2
    expected = [
        np.polyfit(j, before[i : i + 2 * reach + 1], 3, w=np.sqrt(weight))[-1] for i in range(len(noise) - reach)
    ]
    found = smooth(noise, half_width)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(smooth(np.column_stack([noise, 2.0 * noise]), half_width)[:, 0], found)
    np.testing.assert_array_equal(smooth(noise[:40], half_width), found[: 40 - reach])
    np.testing.assert_array_equal(smooth(noise, 0.9), noise)
