"""Following the S wave from station to station."""

from itertools import product

import numpy as np
import pytest

from calcidem.dem.wave.arrival import is_settled, read_travel_times
from calcidem.dem.wave.on_the_way import denied_doubts
from calcidem.dem.wave.pick import PickFailure, PickRule, Signals
from calcidem.dem.wave.pulse import Pulse
from calcidem.dem.wave.ridge import BEND, BEND_COST, SLOWER, follow_ridge

PLACES = np.array([0.2, 0.4, 0.6, 0.8, 1.0])
PERIOD, SENT, COUNT = 24.0, 20.0, 240
WAY, FREQUENCY, INTERVAL = 0.094, 5e3, 2e-6


def bumps(travel: float, height: float = 1.0, shape: float = 1.0) -> np.ndarray:  # type: ignore[type-arg]
    """Section of a pulse that takes so many samples to the receiver."""
    cycle = (np.arange(COUNT)[:, None] - SENT - travel * PLACES**shape) / PERIOD
    return height * np.where(np.abs(cycle) < 0.5, 0.5 + 0.5 * np.cos(2.0 * np.pi * cycle), 0.0)


def test_a_straight_line_of_the_largest_values_scores_one() -> None:
    """And a higher top that is at the receiver alone does not."""
    section = bumps(100.0)
    section[:, -1] += 3.0 * bumps(60.0)[:, -1]
    on_line, alone = follow_ridge(section, PLACES, np.array([120, 80]), SENT, PERIOD).scores
    assert on_line == pytest.approx((4.0 + 1.0 / 3.0) / 5.0, abs=0.03)
    assert alone < 0.5


def test_units_of_a_station_do_not_matter() -> None:
    """Each station is measured by its own largest value."""
    section, ends = bumps(100.0) - 0.7 * bumps(60.0), np.array([90, 120, 150])
    scaled = section * np.array([3.0, 0.25, 7.0, 1.0, 64.0])
    one, other = (follow_ridge(signals, PLACES, ends, SENT, PERIOD).scores for signals in (section, scaled))
    np.testing.assert_allclose(one, other, rtol=1e-12)


def test_a_bent_line_is_followed_at_a_cost() -> None:
    """A wave that slows down on its way is the same wave."""
    bent, straight = (
        follow_ridge(bumps(100.0, shape=shape), PLACES, np.array([120]), SENT, PERIOD) for shape in (1.2, 1.0)
    )
    assert 0.8 < bent.scores[0] < straight.scores[0]
    # A slowness more or less is 4 % of a travel time, a sample of the ends one more.
    np.testing.assert_allclose(bent.path_to(0), SENT + 100.0 * PLACES**1.2, atol=5.0)
    np.testing.assert_allclose(straight.path_to(0), SENT + 100.0 * PLACES, atol=5.0)


def test_it_finds_the_best_of_all_paths() -> None:
    """The naive twin tries them all."""
    generator = np.random.default_rng(3)
    section, places, period, count = generator.uniform(-0.5, 1.0, (40, 3)), np.array([0.3, 0.6, 1.0]), 24.0, 40
    travels = [2.4]
    while travels[-1] < count:
        travels.append(travels[-1] * SLOWER)
    late = np.rint(np.outer(places, travels)).astype(int)
    signals = section / section.max(axis=0)
    best, path_to = np.full(count, -np.inf), {}
    for first in range(len(travels)):
        for bends in product(range(-BEND, BEND + 1), repeat=2):
            sample, path = late[0, first], first
            if sample >= count:
                continue
            score, samples = signals[sample, 0], [sample]
            for station, bend in enumerate(bends, start=1):
                path += bend
                if not 0 <= path < len(travels):
                    break
                sample += late[station, path] - late[station - 1, path]
                if sample >= count:
                    break
                score += signals[sample, station] - BEND_COST * (bend * np.log(SLOWER)) ** 2
                samples.append(sample)
            else:
                if score / 3.0 > best[sample]:
                    best[sample], path_to[sample] = score / 3.0, samples
    ends = np.arange(10, 38)
    expected = [best[end - 1 : end + 2].max() for end in ends]
    ridge = follow_ridge(section, places, ends, 0.0, period)
    np.testing.assert_allclose(ridge.scores, expected, rtol=1e-12)
    for number, end in enumerate(ends):
        assert ridge.path_to(number).tolist() == path_to[end - 1 + int(np.argmax(best[end - 1 : end + 2]))]


def loud_record(duration: float = 2.2e-3) -> Signals:
    """S wave at 230 m/s behind a P wave of opposite sign, four times as high; a swing of the receiver between."""
    time, pulse = np.arange(0.0, duration, INTERVAL), Pulse(0.5, FREQUENCY)
    places = np.linspace(0.15, 0.9, 9)

    def section(place: float) -> np.ndarray:  # type: ignore[type-arg]
        travel = place * WAY / 230.0
        return pulse.velocity(time - travel) - 4.0 * place * pulse.velocity(time - travel / 1.8)

    swing = 0.95 * pulse.velocity(time - WAY / 310.0)
    received = section(1.0) + swing
    stations = np.column_stack([section(place) for place in places])
    return Signals(INTERVAL, pulse.velocity(time), received, WAY, 1e-3, stations, tuple(places))


def test_stations_tell_which_of_two_tops_is_the_s_wave() -> None:
    """The receiver alone cannot: it is refused, or wrong."""
    signals = loud_record()
    alone = Signals(signals.sampling_interval, signals.sent, signals.received, WAY, 1e-3)
    velocity = read_travel_times(alone).peak.velocity
    assert velocity is None or abs(velocity / 230.0 - 1.0) > 0.1
    read = read_travel_times(signals).peak
    assert read.velocity == pytest.approx(230.0, rel=0.03)


def test_a_longer_record_changes_no_bit() -> None:
    """Each top is judged by what is seen up to its own horizon."""
    signals = loud_record()
    whole = read_travel_times(signals).peak
    settled = []
    for count in range(300, len(signals.received), 50):
        sent, received, stations = signals.sent[:count], signals.received[:count], signals.stations[:count]  # type: ignore[index]
        cut = Signals(INTERVAL, sent, received, WAY, 1e-3, stations, signals.places)
        if is_settled(cut):
            settled.append(read_travel_times(cut).peak)
    assert len(settled) > 2
    assert all(one == whole for one in settled)


def test_what_cannot_be_followed_is_refused() -> None:
    """Stations that heard only something else lead to no top of the receiver."""
    signals = loud_record()
    flat = np.full_like(signals.stations, -1.0)
    lost = Signals(INTERVAL, signals.sent, signals.received, WAY, 1e-3, flat, signals.places)
    assert read_travel_times(lost, PickRule()).peak.failure is PickFailure.LOST


def on_short_way(
    *, p_height: float = 0.0, p_speed: float = 1.6, at_receiver: float = 0.0, late: float = 1.0
) -> Signals:
    """S wave of 230 m/s on 1.2 periods of way, a P wave that grows on its way, and what is at the receiver alone."""
    frequency, places = 230.0 * 1.2 / WAY, np.linspace(0.15, 0.9, 9)
    time, pulse = np.arange(0.0, 2.2e-3, INTERVAL), Pulse(0.5, frequency)

    def section(place: float) -> np.ndarray:  # type: ignore[type-arg]
        travel = place * WAY / 230.0
        return pulse.velocity(time - travel) + p_height * place * pulse.velocity(time - travel / p_speed)

    received = section(1.0) + at_receiver * pulse.velocity(time - late * WAY / 230.0)
    stations = np.column_stack([section(place) for place in places])
    return Signals(INTERVAL, pulse.velocity(time), received, WAY, 1e-3, stations, tuple(places))


def test_a_swing_at_the_receiver_alone_is_no_p_wave() -> None:
    """The same swing before the main peak is a doubt only where it has crossed the sample."""
    crossed = read_travel_times(on_short_way(p_height=-0.9)).peak
    assert crossed.failure is PickFailure.PRECURSOR
    local = read_travel_times(on_short_way(at_receiver=-0.45, late=0.55)).peak
    assert local.velocity == pytest.approx(230.0, rel=0.1)  # it moves the top that it runs into


def test_a_hump_at_the_receiver_alone_is_no_faster_wave() -> None:
    """A peak as broad as that of two waves is refused where both were on the way."""
    crossed = read_travel_times(on_short_way(p_height=0.9, p_speed=1.5)).peak
    assert crossed.failure is PickFailure.BROAD
    local = read_travel_times(on_short_way(at_receiver=0.6, late=0.7)).peak
    assert local.failure is None


def test_stations_that_heard_nothing_deny_nothing() -> None:
    """Nor do those that are all near the transmitter."""
    section, path = bumps(100.0), np.array([40, 60, 80, 100, 120])
    both = {PickFailure.PRECURSOR, PickFailure.BROAD}
    assert denied_doubts(section, PLACES, path, SENT, PERIOD) == both
    assert denied_doubts(-section, PLACES, path, SENT, PERIOD) == set()
    near = np.array([0.05, 0.1, 0.2, 0.3, 1.0])
    assert denied_doubts(section, near, path, SENT, PERIOD) == set()


@pytest.mark.parametrize(("height", "read"), [(0.5, True), (0.9, False), (1.3, False)])
def test_a_wave_that_a_high_one_follows_is_not_read(height: float, read: bool) -> None:
    """Two waves on the way, the slower one as high at the receiver: the first may be P. What follows S is lower."""
    time, pulse, places = np.arange(0.0, 2.2e-3, INTERVAL), Pulse(0.5, FREQUENCY), np.linspace(0.15, 0.9, 9)

    def section(place: float, second: float) -> np.ndarray:  # type: ignore[type-arg]
        fast, slow = (pulse.velocity(time - place * WAY / speed) for speed in (340.0, 210.0))
        return fast + second * slow

    stations = np.column_stack([section(place, 0.85) for place in places])
    signals = Signals(INTERVAL, pulse.velocity(time), section(1.0, height), WAY, 1e-3, stations, tuple(places))
    found = read_travel_times(signals).peak
    assert found.velocity == pytest.approx(340.0, rel=0.03) if read else found.failure is PickFailure.LOST


def splitting(place: float, until: float, second: float) -> np.ndarray:  # type: ignore[type-arg]
    """A wave of 340 m/s at a place, and a slower part of it that stays behind from another place on."""
    time, pulse = np.arange(0.0, 2.2e-3, INTERVAL), Pulse(0.5, FREQUENCY)
    fast = pulse.velocity(time - place * WAY / 340.0)
    stays = until * WAY / 340.0 + (place - until) * WAY / 170.0
    return fast + (second * pulse.velocity(time - stays) if place > until else 0.0)


@pytest.mark.parametrize(("until", "second", "read"), [(0.6, 1.2, True), (0.2, 0.95, False)])
def test_what_stays_behind_late_on_the_way_is_of_the_same_wave(until: float, second: float, read: bool) -> None:
    """Two tops of like height: a wave that was one for most of its way is read, two that went apart early are not."""
    time, places = np.arange(0.0, 2.2e-3, INTERVAL), np.linspace(0.15, 0.9, 9)
    stations = np.column_stack([splitting(place, until, second) for place in places])
    sent, received = Pulse(0.5, FREQUENCY).velocity(time), splitting(1.0, until, second)
    signals = Signals(INTERVAL, sent, received, WAY, 1e-3, stations, tuple(places))
    found = read_travel_times(signals).peak
    assert found.velocity == pytest.approx(340.0, rel=0.03) if read else found.failure is PickFailure.LOST


def test_a_tie_ends_the_record() -> None:
    """Nothing that comes later unties two tops, so that the sample need not be computed to its end."""
    time, pulse, places = np.arange(0.0, 4.4e-3, INTERVAL), Pulse(0.5, FREQUENCY), np.linspace(0.15, 0.9, 9)

    def section(place: float) -> np.ndarray:  # type: ignore[type-arg]
        return pulse.velocity(time - place * WAY / 340.0) + pulse.velocity(time - place * WAY / 210.0)

    stations = np.column_stack([section(place) for place in places])

    def cut(count: int) -> Signals:
        signals = pulse.velocity(time)[:count], section(1.0)[:count]
        return Signals(INTERVAL, *signals, WAY, 1e-3, stations[:count], tuple(places))

    ended = next(count for count in range(120, len(time), 20) if is_settled(cut(count)))
    assert ended * INTERVAL < 1.3e-3  # the second wave has just passed
    for count in (ended, 2 * ended, len(time)):
        assert read_travel_times(cut(count)).peak.failure is PickFailure.LOST


def test_what_is_left_of_a_wave_is_no_s_wave() -> None:
    """Behind a wave that leads to no top, tops of less than a tenth of it are passed over, and not waited for."""
    signals = loud_record()
    flat = np.full_like(signals.stations, -1.0)
    lost = Signals(INTERVAL, signals.sent, signals.received, WAY, 1e-3, flat, signals.places)
    height = float(signals.received.max())
    assert is_settled(lost, loudest=0.09 * height)
    assert not is_settled(lost, loudest=0.11 * height)


def test_a_peak_that_was_as_sent_on_the_way_is_no_sum_of_two_waves() -> None:
    """A wave that becomes broad behind a station is read; one that was broad at all of them is not."""
    time, places = np.arange(0.0, 2.2e-3, INTERVAL), np.linspace(0.15, 0.9, 9)
    frequency = 230.0 * 1.2 / WAY

    def section(place: float, begins: float) -> np.ndarray:  # type: ignore[type-arg]
        broad = 1.0 + 0.75 * max(0.0, place - begins) / (1.0 - begins)
        middle = 0.5 / frequency + place * WAY / 230.0
        cycle = (time - middle) * frequency / broad
        return 0.5 * np.where(np.abs(cycle) < 0.5, 1.0 + np.cos(2.0 * np.pi * cycle), 0.0)

    def read(begins: float) -> PickFailure | None:
        stations = np.column_stack([section(place, begins) for place in places])
        sent = Pulse(0.5, frequency).velocity(time)
        return read_travel_times(
            Signals(INTERVAL, sent, section(1.0, begins), WAY, 1e-3, stations, tuple(places))
        ).peak.failure

    assert read(0.4) is None
    assert read(-1.5) is PickFailure.BROAD
