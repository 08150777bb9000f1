"""Reading of sections that are written down: closed forms, and what no change of a record may do."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from waves import DISTANCE, FREQUENCY, PARTS, Wave, at_receiver, at_stations, periods, section, silence, total, wave

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.reading import (
    PickRule,
    Reading,
    Verdict,
    find_candidates,
    is_settled,
    prepare,
    read_section,
    reading_error,
    record_duration,
    smooth,
    velocity_spectrum,
)
from calcidem.dem.wave.section import RESOLUTION, Section

ANY_ERROR = PickRule(largest_error=1.0)
LEAST, P_LEFT, NEAR_FIELD, TIE, CREST = 0.019, 0.75, 0.04, 0.05, 1.8
"""Factors of the standard error as they were fitted: written here a second time, so that none moves unnoticed."""
TRAVELS = st.floats(1.0, 12.0)


def arrival_of(given: Section, rule: PickRule = ANY_ERROR) -> Reading:
    """The S wave of a section; fails if none was found."""
    found = read_section(given, rule)
    assert isinstance(found, Reading), found
    return found


def travel_of(given: Section) -> float:
    """Travel time that was read, periods."""
    return arrival_of(given).travel_time * FREQUENCY


def same(one: Reading | Verdict, other: Reading | Verdict) -> bool:
    """Whether two readings have the same bits."""
    if isinstance(one, Verdict) or isinstance(other, Verdict):
        return one is other
    return all(np.array_equal(getattr(one, field.name), getattr(other, field.name)) for field in fields(Reading))


def cut(given: Section, samples: int) -> Reading | Verdict:
    """Reading of the first samples."""
    return read_section(given.until(samples), ANY_ERROR)


# --- A wave on a straight line


@given(TRAVELS, st.integers(20, 200), st.floats(0.011, 2.0), st.integers(0, 9))
@example(1.0, 20, 0.011, 0)
def test_a_delayed_pulse_is_read_between_samples(travel: float, samples: int, height: float, stations: int) -> None:
    """At any sampling, amplitude above silence, and number of stations."""
    found = read_section(
        section(wave(travel, height), duration=2.2 * travel + 3.0, samples=samples, parts=PARTS[9 - stations :]),
        ANY_ERROR,
    )
    # Smoothing leaves a cosine a cosine. Its parabola has its vertex at tan(h d) / (2 tan(h / 2)) for a peak at d and
    # samples h apart, off by 0.016 h^2 at most. Rounding moves three smoothed samples by 0.75 steps each.
    h = 2.0 * np.pi / samples
    tolerance = (0.017 * h * h + 2.5 * RESOLUTION / (0.98 * height * (1.0 - np.cos(h)))) / samples
    assert periods(found.peak) == pytest.approx(travel, abs=tolerance)
    # The pulse that is compared ends up to a sample early, and is not symmetric then.
    assert periods(found.cross_correlation) == pytest.approx(travel, abs=3.0 * tolerance)
    assert found.shifted == 0.0
    # Stations see it between two samples.
    assert 1.0 - 0.3 * h * h < found.coherence <= 1.0
    assert (found.path is None) == (stations < 4)
    if found.path is not None:
        assert periods(found.path) == pytest.approx(travel, abs=2.0 * tolerance / 0.09)  # of two neighbours
        assert found.path_error == pytest.approx(found.error, rel=0.01)


def test_the_first_arrival_is_where_the_pulse_begins() -> None:
    """Smoothing bends its foot by less than a hundredth of a period."""
    for travel in (1.0, 1.7, 6.3):
        found = read_section(section(wave(travel)), ANY_ERROR)
        assert periods(found.first_arrival) == pytest.approx(travel, abs=0.012)


@pytest.mark.parametrize(("level", "hidden"), [(0.085, False), (0.115, True)])
def test_a_foot_hides_the_first_arrival_if_it_is_higher_than_a_tenth(level: float, hidden: bool) -> None:
    """The last rise through a tenth of the peak is the onset; further than a quarter of a period it is none."""

    def foot(part: float, time: Floats) -> Floats:
        rise = level * wave(6.0)(part, np.minimum(time, 6.5 * part + 0.5 * (1.0 - part)))
        return np.where(time < 8.6, rise, 0.0)

    before = at_receiver(lambda part, time: np.maximum(wave(8.0)(part, time), foot(part, time)))
    found = read_section(section(total(at_stations(wave(8.0)), before)), ANY_ERROR)
    assert periods(found.peak) == pytest.approx(8.0, abs=0.01)
    assert (found.first_arrival is None) == hidden


def test_nothing_below_a_thousandth_is_read() -> None:
    """Silence is a thousandth of v0, and says so."""
    top = smooth(wave(8.0)(1.0, np.arange(800) / 40.0), 12.0).max()
    assert read_section(section(silence)) is Verdict.SILENT
    assert read_section(section(wave(8.0, 0.00085 / top))) is Verdict.SILENT
    assert arrival_of(section(wave(8.0, 0.00115 / top)), PickRule()).verdict is None


# --- The P wave


def slanted(share: float, height: float, travel: float = 8.0, ratio: float = 2.0) -> Section:
    """S wave, and a P wave that moves grains across in proportion to along."""
    p_wave = wave(travel / ratio, height)
    return section(total(wave(travel), wave(travel / ratio, share * height)), p_wave, duration=2.2 * travel + 3.0)


@given(st.floats(-0.5, 0.5), st.floats(0.2, 3.0), st.floats(6.0, 12.0), st.floats(1.6, 2.1))
def test_a_p_wave_at_a_slant_is_taken_off(share: float, height: float, travel: float, ratio: float) -> None:
    """The S wave is read as if there were none, whatever its share, amplitude and speed."""
    found = arrival_of(slanted(share, height, travel, ratio))
    assert found.travel_time * FREQUENCY == pytest.approx(travel, abs=1e-4)  # as without it
    assert np.abs(found.clean[: int(40.0 * (travel - 0.3)), -1]).max() < 0.03  # what smoothing puts before the S wave
    top = round(40.0 * (0.2 + travel / ratio))
    assert np.abs(found.clean[top : top + 25, -1]).max() < 0.004 * height + 1e-3


def test_without_motion_along_the_p_wave_would_be_read() -> None:
    """What is taken off decides."""
    given = slanted(0.5, 2.4)
    assert travel_of(given) == pytest.approx(8.0, abs=1e-4)
    assert travel_of(replace(given, along=0 * given.along)) == pytest.approx(4.0, abs=0.01)


@pytest.mark.parametrize("share", [0.8, 0.55, 0.4, -0.4, -0.55, -0.8])
def test_half_of_the_motion_along_is_taken_off_at_most(share: float) -> None:
    """What is steeper stays: 27 degrees are the steepest path."""
    clean = arrival_of(slanted(share, 0.5)).clean[:, -1]
    left = clean[round(40.0 * 4.5)] / (0.5 * smooth(wave(4.0)(1.0, np.arange(400) / 40.0), 12.0).max())
    assert left == pytest.approx(np.sign(share) * max(0.0, abs(share) - 0.5), abs=0.003)


def test_a_shear_wave_without_motion_along_keeps_its_bits() -> None:
    """Nothing is taken off where nothing moves along, or less than silence."""
    alone = read_section(section(wave(8.0)))
    assert alone.peak is not None
    assert same(read_section(section(wave(8.0), wave(4.0, 0.00085))), alone)
    assert not same(read_section(section(total(wave(8.0), wave(4.0, 0.0004)), wave(4.0, 0.00115))), alone)


def test_a_late_motion_along_takes_nothing_off() -> None:
    """A P wave does not come behind the S wave's line."""
    found = arrival_of(section(wave(6.0), wave(9.0, 2.0)))
    np.testing.assert_array_equal(found.clean, arrival_of(section(wave(6.0))).clean)


@pytest.mark.parametrize(
    ("ratio", "apart", "first"),
    [(2.6, 0.8, True), (3.5, 0.8, False), (-2.6, 0.8, True), (-3.5, 0.8, False), (6.0, 1.2, True)],
)
def test_a_swing_that_one_three_times_as_large_follows_is_a_precursor(ratio: float, apart: float, first: bool) -> None:
    """Within a period, and of any sign; its share is that of the swing that is taken."""
    small, large = wave(4.0, 0.2, 2.0), wave(4.0 + apart, 0.2 * ratio, 2.0)
    along = at_receiver(total(small, large))
    across = at_receiver(total(wave(4.0, 0.08, 2.0), wave(4.0 + apart, -0.02 * ratio, 2.0)))
    found = prepare(section(total(wave(12.0), across), along, duration=30.0), 0.3)
    time = (found.p_peak[-1] + 0.3) / 40.0
    assert time == pytest.approx(4.5 if first else 4.5 + apart, abs=0.06)
    if first:
        assert found.p_share[-1] == pytest.approx(0.4, abs=0.02)
    else:
        assert found.p_share[-1] < 0.1
    assert (found.p_peak[:-1] == -1).all()
    assert found.p_end[-1] > found.p_peak[-1]


def test_a_share_does_not_jump_with_the_sampling() -> None:
    """Also where P and S wave run into each other before the swing is over."""
    given = [
        section(total(wave(2.8), wave(2.4, 0.1)), wave(2.4), samples=samples, duration=12.0)
        for samples in range(40, 60)
    ]
    shares = [prepare(one, 0.3).p_share[-1] for one in given]
    assert min(shares) > 0.11  # the S wave's beginning is in it
    assert max(shares) - min(shares) < 0.01


def test_the_shift_is_what_the_p_wave_does_to_the_peak() -> None:
    """A long P wave whose slope moves the receiver's peak: the shift is that of a fine grid, over the travel time."""
    p_wave = at_receiver(wave(10.0, 0.4, 0.25))
    found = arrival_of(section(total(wave(11.0), at_receiver(wave(10.0, 0.2, 0.25))), p_wave, duration=28.0))
    time = np.linspace(11.0, 12.0, 100_001)
    with_p = time[np.argmax(wave(11.0)(1.0, time) + wave(10.0, 0.2, 0.25)(1.0, time))]
    assert found.travel_time * FREQUENCY == pytest.approx(11.0, abs=0.004)  # what the regression takes of the S wave
    assert found.shifted * 11.0 == pytest.approx(11.5 - with_p, rel=0.15)
    assert found.shifted > 0.0


# --- Which peak is the S wave


def test_motion_of_the_receiver_alone_is_not_read() -> None:
    """However large and early it is; without stations it would be."""
    given = section(total(wave(8.0), at_receiver(wave(4.0, 1.5))))
    assert travel_of(given) == pytest.approx(8.0, abs=1e-4)
    alone = replace(given, places=given.places[-1:], across=given.across[:, -1:], along=given.along[:, -1:])
    assert travel_of(alone) == pytest.approx(4.0, abs=1e-4)


@pytest.mark.parametrize(("stations", "read"), [(3, False), (5, True)])
def test_half_of_all_places_have_to_see_a_wave(stations: int, read: bool) -> None:
    """The stack of one that three of nine stations see is 0.4, and that of five 0.6; the receiver is a place."""
    found = read_section(section(total(at_receiver(wave(8.0)), at_stations(wave(8.0), stations))))
    if not read:
        assert found is Verdict.NO_LINE
        return
    assert found.coherence == pytest.approx(0.6, abs=0.001)


def test_a_stack_is_over_the_largest_value_of_each_place() -> None:
    """A wave that is half as high as another one at each station has half of its stack, in any unit of a station."""
    both = total(at_receiver(wave(8.0)), at_stations(total(wave(8.0, 0.5), wave(14.0))))
    found = arrival_of(section(both, duration=24.0))
    assert found.coherence == pytest.approx((1.0 + 9 * 0.5) / 10.0, abs=0.005)
    gains = np.geomspace(0.3, 1.0, 10)

    def scaled(part: float, time: Floats) -> Floats:
        return both(part, time) * float(gains[PARTS.index(part)])

    assert arrival_of(section(scaled, duration=24.0)).coherence == pytest.approx(found.coherence, abs=1e-4)


@pytest.mark.parametrize(("before", "read"), [(2.1, True), (2.4, False)])
def test_a_small_wave_after_a_large_motion_is_reverberation(before: float, read: bool) -> None:
    """Stations that moved 9 / 4 times as far before, the other way, and the receiver make a stack of 1/2."""
    earlier = at_stations(wave(1.0, -before))
    found = read_section(section(total(earlier, wave(4.0)), duration=20.0), ANY_ERROR)
    assert isinstance(found, Reading) == read


@pytest.mark.parametrize(("ratio", "read"), [(1.5, 1.5), (1.95, 1.95), (2.25, 1.0), (2.8, 1.0)])
def test_a_slower_wave_is_waited_for(ratio: float, read: float) -> None:
    """Up to 2.1 travel times of a faster one of the same kind, which is then taken for the P wave."""
    given = section(total(wave(8.0, 0.8), wave(8.0 * ratio)), duration=50.0)
    assert travel_of(given) == pytest.approx(8.0 * read, abs=0.01)


@pytest.mark.parametrize(("slower", "read"), [(1.5, 1.5), (1.9, 0.65)])
def test_a_wave_a_period_behind_is_waited_for(slower: float, read: float) -> None:
    """On a short path, where 2.1 travel times are less than the pulse is long."""
    both = total(wave(0.65, 0.7, 2.0), wave(slower, 1.0, 2.0))
    assert travel_of(section(both, duration=12.0)) == pytest.approx(read, abs=0.05)


@pytest.mark.parametrize(("late", "read"), [(0.039, True), (-0.039, True), (0.055, False), (-0.055, False)])
def test_the_last_grains_may_delay_or_advance_the_receiver(late: float, read: bool) -> None:
    """By 4 % of the travel time: on a path of 100 periods the line is met or missed by much."""
    given = section(
        total(at_receiver(wave(100.0 * (1.0 + late))), at_stations(wave(100.0))), duration=225.0, samples=20
    )
    found = read_section(given)
    if not read:
        assert found is Verdict.NO_LINE
        return
    assert isinstance(found, Reading)
    assert periods(found.peak) == pytest.approx(100.0 * (1.0 + late), abs=1e-3)


# --- The path's velocity


def shifted_stations(shifts: Floats) -> Section:
    """S wave of 8 periods that each station sees so much later."""

    def moved(part: float, time: Floats) -> Floats:
        return wave(8.0)(part, time - float(shifts[PARTS.index(part)]))

    return section(moved)


def naive_slope(shifts: Floats) -> tuple[float, float]:
    """Median of the slopes of all pairs of stations, and relative standard error by the median deviation."""
    x, t = np.array(PARTS[:-1]), 8.0 * np.array(PARTS[:-1]) + shifts[:-1]
    slope = np.median([(t[j] - t[i]) / (x[j] - x[i]) for i in range(9) for j in range(i + 1, 9)])
    rest = t - slope * x
    spread = 1.4826 * np.median(np.abs(rest - np.median(rest))) * np.sqrt(9.0 / 7.0)
    return float(slope), float(spread / np.sqrt(np.sum((x - x.mean()) ** 2)) / slope)


def test_the_path_has_a_free_origin() -> None:
    """A delay of all stations moves the velocity between them by nothing, and the receiver's is its own."""
    found = read_section(shifted_stations(np.append(np.full(9, 0.15), 0.0)))
    assert periods(found.peak) == pytest.approx(8.0, abs=1e-3)
    assert periods(found.path) == pytest.approx(8.0, abs=2e-3)
    found = read_section(shifted_stations(np.append(np.zeros(9), 0.2)))
    assert periods(found.peak) == pytest.approx(8.2, abs=1e-3)
    assert periods(found.path) == pytest.approx(8.0, abs=2e-3)


def test_the_path_has_the_slope_of_its_stations() -> None:
    """Median slope of all pairs, with the error of the naive twin; a path that is too uncertain has none."""
    shifts = np.append(np.random.default_rng(4).uniform(-0.08, 0.08, 9), 0.0)
    found = read_section(shifted_stations(shifts))
    slope, scatter = naive_slope(shifts)
    assert abs(slope - 8.0) > 0.01
    assert periods(found.path) == pytest.approx(slope, abs=3e-3)
    assert found.error is not None
    assert found.path_scatter == pytest.approx(scatter, rel=0.02)
    assert found.path_error == pytest.approx(np.hypot(found.error, CREST * scatter), rel=0.01)
    bound = 1e-6 + found.error
    assert found.path_error > bound
    unsure = read_section(shifted_stations(shifts), PickRule(largest_error=bound))
    assert unsure.peak == found.peak
    assert (unsure.path, unsure.path_error) == (None, None)


def test_one_stray_station_moves_the_path_little() -> None:
    """Less than a third of what it does to a line of least squares."""
    shifts = np.zeros(10)
    shifts[0] = 0.2
    moved = abs(periods(read_section(shifted_stations(shifts)).path) - 8.0)
    least_squares = abs(np.polyfit(PARTS[:-1], 8.0 * np.array(PARTS[:-1]) + shifts[:-1], 1)[0] - 8.0)
    assert moved < least_squares / 3.0


@pytest.mark.parametrize(("stations", "seen"), [(3, False), (4, True), (9, True)])
def test_four_stations_make_a_path(stations: int, seen: bool) -> None:
    """Fewer have no velocity of their own."""
    found = read_section(section(wave(8.0), parts=PARTS[9 - stations :]))
    assert (found.path is not None) == seen
    assert (found.path_error is not None) == seen


# --- What a picture of a section shows


def test_candidates_are_the_peaks_that_are_judged() -> None:
    """The S wave is one of them, with its coherence; the one before it is less coherent than its rival."""
    given = section(total(wave(8.0), at_receiver(wave(4.0, 0.5)), wave(5.5, 0.3)))
    early, faster, chosen = find_candidates(given, 0.3)[:3]
    found = arrival_of(given)
    assert (chosen.index, chosen.travel_time, chosen.coherence) == (found.index, found.travel_time, found.coherence)
    np.testing.assert_array_equal(chosen.clean[: len(found.clean)], found.clean)
    assert chosen.decided == pytest.approx((len(found.clean) + 12) / (40.0 * FREQUENCY), rel=1e-12)
    assert early.coherence < 0.5
    assert faster.coherence == pytest.approx(0.3, abs=0.02)  # the others' flanks
    assert faster.rival == pytest.approx(chosen.coherence, abs=0.01)
    assert chosen.rival < 0.5
    assert [one.rival for one in find_candidates(section(wave(8.0)), 0.3)] == [0.0]  # nothing else moves


def test_a_peak_at_that_of_the_p_wave_is_a_candidate() -> None:
    """A narrow S wave that arrives with the crest of a wide P wave is left when the P wave is taken off."""
    given = section(wave(8.0, faster=2.0), at_receiver(wave(8.0)))
    assert int(prepare(given, 0.3).p_peak[-1]) in [one.index for one in find_candidates(given, 0.3)]


def test_the_spectrum_lacks_a_p_wave_before_the_line_alone() -> None:
    """A wave of P that also moves across is seen along a faster line, and taken off before a slower one."""
    given = section(total(wave(4.0, 0.3), wave(8.0, 0.2)), wave(4.0))
    faster, slower = velocity_spectrum(given, 0.3, DISTANCE * FREQUENCY / np.array([3.8, 4.3]))
    assert faster > 0.9
    assert slower < 0.1


def test_the_spectrum_is_largest_at_the_velocity() -> None:
    """Within the stretch of a line; a wave behind the end of the record has none."""
    velocities = DISTANCE * FREQUENCY / np.linspace(3.0, 25.0, 221)
    stack = velocity_spectrum(section(wave(8.0)), 0.3, velocities)
    travels = np.linspace(3.0, 25.0, 221)
    assert abs(travels[np.nanargmax(stack)] / 8.0 - 1.0) < 0.05
    assert np.nanmax(stack) > 0.999
    assert (stack[abs(travels - 8.0) > 2.0] < 0.5)[travels[abs(travels - 8.0) > 2.0] < 18.0].all()
    assert np.isnan(stack[travels > 19.3]).all()
    assert np.isfinite(stack[travels < 19.1]).all()


# --- The standard error


def error_of(*, length: float = 1e6, **parts: float) -> float:
    """Error of an arrival after so many periods."""
    found = replace(arrival_of(section(wave(4.0))), travel_time=length / FREQUENCY, early=0.0)
    return reading_error(replace(found, **parts), FREQUENCY)


def test_each_part_of_the_error_has_its_closed_form() -> None:
    """They add as squares, to that of the clearest reading."""
    assert error_of() == pytest.approx(LEAST, rel=1e-6)
    assert error_of(shifted=0.4) == pytest.approx(np.hypot(LEAST, P_LEFT * 0.4), rel=1e-6)
    assert error_of(early=0.1) == pytest.approx(np.hypot(LEAST, 0.1), rel=1e-6)
    assert error_of(tie=0.1) == pytest.approx(np.hypot(LEAST, 0.1), rel=1e-6)
    assert error_of(length=1.0) == pytest.approx(np.hypot(LEAST, NEAR_FIELD), rel=1e-9)
    assert error_of(length=4.0) == pytest.approx(np.hypot(LEAST, NEAR_FIELD / 32.0), rel=1e-9)
    assert error_of(length=0.1) == 1.0
    parts = [LEAST, P_LEFT * 0.02, 0.1, 0.03, NEAR_FIELD / 2.0**2.5]
    assert error_of(length=2.0, shifted=0.02, early=0.1, tie=0.03) == pytest.approx(np.linalg.norm(parts), rel=1e-9)


@pytest.mark.parametrize("ahead", [-0.25, 0.25])
def test_a_crest_that_left_before_the_pulse_is_an_error(ahead: float) -> None:
    """It is slower than the receiver says. One that is faster, as behind slow last grains, is none."""
    found = arrival_of(section(total(at_receiver(wave(8.0 - ahead)), at_stations(wave(8.0)))))
    assert found.early == pytest.approx(max(0.0, ahead / 8.0), abs=1e-4)


@pytest.mark.parametrize(("height", "tied"), [(1.0, True), (0.985, True), (0.93, False)])
def test_two_peaks_of_one_coherence_are_a_tie(height: float, tied: bool) -> None:
    """The odds fall with the difference of their coherences; the distance of the other peak counts by their root."""
    given = section(total(wave(8.0), wave(10.0, height)), duration=30.0)
    found = arrival_of(given)
    chosen = next(one for one in find_candidates(given, 0.3) if one.index == found.index)
    apart = 2.0 / (found.travel_time * FREQUENCY)
    behind = min(1.0, (found.coherence - chosen.rival) / TIE)
    assert found.tie == pytest.approx(apart * np.sqrt(0.5 * (1.0 - behind)), abs=1e-4)
    assert (found.tie > 0.5 * apart) == tied


def test_the_error_of_a_reading_is_that_of_its_arrival() -> None:
    """Roughness is what smoothing takes away: a jitter that changes its sign at each sample."""

    def jitter(part: float, time: Floats) -> Floats:
        return 0.1 * (-1.0) ** np.arange(len(time)) * (part == 1.0)

    given = section(total(wave(2.0), jitter))
    found = read_section(given)
    assert found.error == reading_error(found, FREQUENCY)
    assert found.roughness == pytest.approx(0.1, rel=0.05)
    assert arrival_of(section(wave(2.0))).roughness < 0.01


@pytest.mark.parametrize(("early", "refused"), [(0.23, False), (0.26, True)])
def test_what_is_uncertain_by_more_than_a_quarter_is_refused(early: float, refused: bool) -> None:
    """By default; here by a crest that turns about the middle of the path."""
    slower = early / (1.0 - early)
    given = total(at_receiver(wave(1.0)), at_stations(lambda part, time: wave(1.0)(part, time - slower * (part - 0.5))))
    found = read_section(section(given))
    assert found.error == pytest.approx(np.linalg.norm([LEAST, NEAR_FIELD, early]), abs=0.005)
    assert (found.verdict is Verdict.UNCERTAIN) == refused


def test_the_largest_error_is_the_users() -> None:
    """A refused reading keeps its arrival and its error, and has no velocity."""
    given = section(wave(2.0))
    whole = read_section(given)
    assert whole.error is not None
    assert same(read_section(given, PickRule(largest_error=1.001 * whole.error)), whole)
    refused = read_section(given, PickRule(largest_error=0.999 * whole.error))
    assert refused.verdict is Verdict.UNCERTAIN
    assert refused.error == whole.error
    assert {refused.peak, refused.first_arrival, refused.cross_correlation, refused.path} == {None}


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
    """The naive twin fits each cubic by itself; before the record all is at rest."""
    noise, reach = np.random.default_rng(3).normal(size=60), int(half_width)
    before = np.concatenate([np.zeros(reach), noise])
    j = np.arange(-reach, reach + 1)
    weight = (1.0 - (j / half_width) ** 2) ** 2
    expected = [
        np.polyfit(j, before[i : i + 2 * reach + 1], 3, w=np.sqrt(weight))[-1] for i in range(len(noise) - reach)
    ]
    np.testing.assert_allclose(smooth(noise, half_width), expected, rtol=0.0, atol=1e-12)
    columns = np.column_stack([noise, 2.0 * noise])
    np.testing.assert_array_equal(smooth(columns, half_width)[:, 0], smooth(noise, half_width))


def test_smoothing_sees_no_further_than_its_window() -> None:
    """What comes later than that changes no bit; a window below a sample does nothing."""
    noise = np.random.default_rng(3).normal(size=60)
    whole, later = smooth(noise, 7.5), np.where(np.arange(60) < 40, noise, 99.0)
    assert len(whole) == 60 - 7
    np.testing.assert_array_equal(smooth(later, 7.5)[:33], whole[:33])
    np.testing.assert_array_equal(smooth(noise[:40], 7.5), whole[:33])
    np.testing.assert_array_equal(smooth(noise, 0.9), noise)


# --- A record that is cut


@pytest.mark.parametrize(("travel", "behind"), [(0.8, 1.0), (8.0, 1.1 * 8.0)])
def test_a_record_is_long_enough_at_its_horizon(travel: float, behind: float) -> None:
    """2.1 travel times or a period behind the peak, and 0.3 periods for smoothing; not a sample earlier."""
    given = section(wave(travel), duration=30.0)
    peak = given.transmitted_peak + 40.0 * travel
    needed = int(peak + 40.0 * behind) + 1 + 12  # the peak is read to less than a hundredth of a sample
    assert isinstance(cut(given, needed), Reading)
    assert same(cut(given, needed), read_section(given, ANY_ERROR))
    assert cut(given, needed - 1) is Verdict.TOO_SHORT
    lasts = record_duration(DISTANCE, DISTANCE * FREQUENCY / travel, FREQUENCY) * FREQUENCY
    assert needed / 40.0 <= lasts < needed / 40.0 + 0.5
    assert record_duration(travel, 1.0, 1.0) == pytest.approx(max(2.1 * travel, travel + 1.0) + 0.5 + 2.0 * 0.3)


def drawn(seed: int) -> Section:
    """S wave with a P wave at a slant, scattered arrivals of both, uneven stations and noise."""
    generator = np.random.default_rng([17, seed])
    draw = generator.uniform
    travel, ratio = float(np.exp(draw(np.log(0.8), np.log(10.0)))), draw(1.4, 2.1)
    gains = np.exp(0.3 * generator.normal(size=10))
    waves: list[tuple[list[Wave], list[Wave]]] = []
    for height, speed, share in ((draw(0.0, 3.0), ratio, draw(-0.7, 0.7)), (draw(0.3, 1.0), 1.0, draw(-0.2, 0.2))):
        later = [(0.0, 1.0), *zip(draw(0.2, 4.0, 5), draw(-0.7, 0.7, 5), strict=True)]
        parts = [
            lambda part, time, a=height * size, late=late, speed=speed: wave(travel / speed, a)(part, time - late)
            for late, size in later
        ]
        along = parts if speed > 1.0 else []
        turned = [lambda part, time, one=one, share=share: share * one(part, time) for one in parts]
        waves.append((turned if speed > 1.0 else parts, along or turned))
    noise = draw(0.0, 0.05)

    def heard(parts: list[Wave]) -> Wave:
        def motion(part: float, time: Floats) -> Floats:
            rough = noise * generator.normal(size=len(time))
            return gains[PARTS.index(part)] * total(*parts)(part, time) + rough * np.minimum(time, 1.0)

        return motion

    across, along = (heard(waves[0][k] + waves[1][k]) for k in (0, 1))
    return section(across, along, samples=int(draw(20, 60)), duration=2.4 * travel + 8.0)


@pytest.mark.parametrize(("seeds", "cuts"), [(range(12), 15), pytest.param(range(12, 600), 60, marks=pytest.mark.full)])
def test_a_record_that_is_cut_has_the_same_bits_or_none(seeds: range, cuts: int) -> None:
    """At each place from its own horizon on the whole reading, before it none; and no end of a record is premature."""
    read = ended = 0
    for seed in seeds:
        given = drawn(seed)
        whole, count = read_section(given, ANY_ERROR), len(given.across)
        speed = np.sqrt(given.across.astype(float) ** 2 + given.along.astype(float) ** 2).max(axis=1)
        remaining = np.append(np.maximum.accumulate(speed[::-1])[::-1], 0.0) * given.amplitude * RESOLUTION
        first = None
        for samples in range(int(given.period) + 1, count + 1, max(1, count // cuts)):
            found = cut(given, samples)
            if isinstance(found, Reading):
                first = samples if first is None else first
                assert same(found, whole), (seed, samples)
            else:
                assert first is None, (seed, samples)
                assert found in {Verdict.SILENT, Verdict.TOO_SHORT, Verdict.NO_LINE}
            settled = is_settled(given.until(samples), ANY_ERROR, float(remaining[samples]))
            assert settled or isinstance(found, Verdict), (seed, samples)
            assert not settled or found is not Verdict.TOO_SHORT, (seed, samples)
            if settled:
                ended += isinstance(found, Verdict)
                assert isinstance(found, Verdict) == isinstance(whole, Verdict), (seed, samples)
        if isinstance(whole, Reading):
            read += 1
            needed = len(whole.clean) + int(0.3 * given.period)
            assert same(cut(given, needed), whole), seed
            assert cut(given, needed - 1) is Verdict.TOO_SHORT, seed
    assert read > 0.8 * len(seeds)
    assert ended or len(seeds) < 100
