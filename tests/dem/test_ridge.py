"""Following the S wave from station to station."""

from itertools import product

import numpy as np
import pytest

from calcidem.dem.wave.arrival import is_settled, read_travel_times
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
    on_line, alone = follow_ridge(section, PLACES, np.array([120, 80]), SENT, PERIOD)
    assert on_line == pytest.approx((4.0 + 1.0 / 3.0) / 5.0, abs=0.03)
    assert alone < 0.5


def test_units_of_a_station_do_not_matter() -> None:
    """Each station is measured by its own largest value."""
    section, ends = bumps(100.0) - 0.7 * bumps(60.0), np.array([90, 120, 150])
    scaled = section * np.array([3.0, 0.25, 7.0, 1.0, 64.0])
    np.testing.assert_allclose(
        follow_ridge(section, PLACES, ends, SENT, PERIOD), follow_ridge(scaled, PLACES, ends, SENT, PERIOD), rtol=1e-12
    )


def test_a_bent_line_is_followed_at_a_cost() -> None:
    """A wave that slows down on its way is the same wave."""
    bent, straight = (
        follow_ridge(bumps(100.0, shape=shape), PLACES, np.array([120]), SENT, PERIOD)[0] for shape in (1.2, 1.0)
    )
    assert 0.8 < bent < straight


def test_it_finds_the_best_of_all_paths() -> None:
    """The naive twin tries them all."""
    generator = np.random.default_rng(3)
    section, places, period, count = generator.uniform(-0.5, 1.0, (40, 3)), np.array([0.3, 0.6, 1.0]), 24.0, 40
    travels = [2.4]
    while travels[-1] < count:
        travels.append(travels[-1] * SLOWER)
    late = np.rint(np.outer(places, travels)).astype(int)
    signals = section / section.max(axis=0)
    best = np.full(count, -np.inf)
    for first in range(len(travels)):
        for bends in product(range(-BEND, BEND + 1), repeat=2):
            sample, path = late[0, first], first
            if sample >= count:
                continue
            score = signals[sample, 0]
            for station, bend in enumerate(bends, start=1):
                path += bend
                if not 0 <= path < len(travels):
                    break
                sample += late[station, path] - late[station - 1, path]
                if sample >= count:
                    break
                score += signals[sample, station] - BEND_COST * (bend * np.log(SLOWER)) ** 2
            else:
                best[sample] = max(best[sample], score / 3.0)
    ends = np.arange(10, 38)
    expected = [best[end - 1 : end + 2].max() for end in ends]
    np.testing.assert_allclose(follow_ridge(section, places, ends, 0.0, period), expected, rtol=1e-12)


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
