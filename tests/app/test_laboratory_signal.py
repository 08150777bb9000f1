"""Velocities from laboratory signals with known delays: clean, noisy, coarse, reversed and wrong."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

import calcidem
from calcidem.app.cli.exit_codes import _exit_code_of
from calcidem.dem.engine.fields import FieldError

TIME = np.arange(-1e-4, 2e-3, 2e-6)
DELAY, DISTANCE = 5.033e-4, 0.1
"""s and m: a delay that is no multiple of the sampling interval."""
METHODS = {"peak", "first_arrival", "cross_correlation"}


def raised_cosine(turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """One period that does not change its sign."""
    return 0.5 - 0.5 * np.cos(2.0 * np.pi * turns)


def sine(turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """One period, as most function generators give."""
    return np.sin(2.0 * np.pi * turns)


Shape = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def pulse(shape: Shape, delay: float = 0.0) -> NDArray[np.float64]:
    """Pulse of 10 kHz that begins after a delay, s."""
    turns = 1e4 * (TIME - delay)
    return np.where((turns > 0.0) & (turns < 1.0), shape(turns), 0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("shape", [raised_cosine, sine])
def test_a_delayed_pulse_has_the_velocity_of_its_delay(shape: Shape, sign: float) -> None:
    """By each method, whatever the units and offsets of the signals and the polarity of the receiver."""
    received = 3.0 + 0.02 * sign * pulse(shape, DELAY)
    found = calcidem.read_signal(TIME, pulse(shape) - 1.0, received, DISTANCE)
    assert found.velocities.keys() == found.errors.keys() == METHODS
    assert list(found.velocities.values()) == pytest.approx([DISTANCE / DELAY] * 3, rel=3e-4)  # a tenth of a sample
    assert found.is_reversed is (sign < 0.0)
    assert ("reversed" in str(found)) is found.is_reversed
    turned = calcidem.read_signal(TIME, sign * pulse(shape), sign * received, DISTANCE)
    assert turned.velocities["peak"] == pytest.approx(DISTANCE / DELAY, rel=1e-4)
    assert turned.is_reversed is (sign < 0.0)
    assert not calcidem.read_signal(TIME, -pulse(shape), -sign * received, DISTANCE).is_reversed


@pytest.mark.parametrize("shape", [raised_cosine, sine])
def test_noise_scatters_the_velocity_as_the_error_says(shape: Shape) -> None:
    """Of 150 records with 4 % noise, each method's velocities scatter about the true one by its standard error."""
    random, found = np.random.default_rng(7), []
    for _ in range(150):
        noise = random.normal(scale=0.04, size=(2, TIME.size))
        received = 5.0 * (pulse(shape, DELAY) + noise[1])
        found.append(calcidem.read_signal(TIME, pulse(shape) + 0.25 * noise[0], received, DISTANCE))
    for method in METHODS:
        velocities = np.array([one.velocities[method] for one in found])
        errors = np.array([one.errors[method] for one in found])
        assert errors.mean() == pytest.approx(velocities.std(), rel=0.2)
        assert abs(velocities.mean() - DISTANCE / DELAY) < 0.5 * velocities.std()


def test_the_delay_of_the_electronics_is_subtracted() -> None:
    """Then all methods have the velocity of the rest, and the arrivals are drawn where the signal is shown."""
    found = calcidem.read_signal(TIME, pulse(sine), pulse(sine, DELAY + 1e-5), DISTANCE, delay=1e-5)
    assert list(found.velocities.values()) == pytest.approx([DISTANCE / DELAY] * 3, rel=3e-4)
    assert TIME[found.arrival.received.argmax()] == pytest.approx(found.arrival.arrival_time("peak"), abs=2e-6)
    with pytest.raises(FieldError, match="less than the travel time"):
        calcidem.read_signal(TIME, pulse(sine), pulse(sine, DELAY), DISTANCE, delay=6e-4)


def test_the_spread_is_the_difference_of_the_methods() -> None:
    """It is small for a delayed pulse, and stated beside the error by noise for one that has changed its shape."""
    assert calcidem.read_signal(TIME, pulse(sine), pulse(sine, DELAY), DISTANCE).spread < 1e-3
    found = calcidem.read_signal(TIME, pulse(sine), pulse(raised_cosine, DELAY), DISTANCE)
    speeds = [*found.velocities.values()]
    assert found.spread == pytest.approx((max(speeds) - min(speeds)) / np.mean(speeds))
    assert f"The methods differ by {100.0 * found.spread:.2g} %" in str(found)


def test_twice_the_noise_is_twice_the_error() -> None:
    """The error is proportional to the noise, and to the square root of the sampling interval."""
    noise = np.random.default_rng(3).normal(scale=0.01, size=TIME.size)
    clean = pulse(sine, DELAY)
    one, two = (calcidem.read_signal(TIME, pulse(sine), clean + f * noise, DISTANCE).errors for f in (1.0, 2.0))
    ratios = [two[method] / one[method] for method in ("peak", "cross_correlation")]
    assert ratios == pytest.approx([2.0, 2.0], rel=0.05)
    sparse = calcidem.read_signal(TIME[::4], pulse(sine)[::4], (clean + noise)[::4], DISTANCE).errors
    assert sparse["cross_correlation"] == pytest.approx(2.0 * one["cross_correlation"], rel=0.25)


def test_a_recorder_of_few_digits_has_an_error() -> None:
    """Digits hide the noise at rest; half of a digit is an error all the same."""
    found = calcidem.read_signal(TIME, pulse(sine), np.round(40.0 * pulse(sine, DELAY)), DISTANCE)
    assert all(error > 1e-5 * DISTANCE / DELAY for error in found.errors.values())
    assert found.velocities["peak"] == pytest.approx(DISTANCE / DELAY, rel=2e-3)


def test_the_picture_marks_each_arrival_once() -> None:
    """Both signals and the three readings, with their velocities beside."""
    figure = calcidem.read_signal(TIME, pulse(sine), pulse(sine, DELAY), DISTANCE).plot()
    (axes,) = figure.axes
    assert len(axes.get_legend_handles_labels()[1]) == 5
    assert sum("m/s" in text.get_text() for text in axes.texts) == 3


SENT, GOT = pulse(sine), pulse(sine, DELAY)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((TIME, SENT, GOT[:-1], DISTANCE), "received = 1049 values: give one for each time"),
        ((TIME[:20], SENT[:20], GOT[:20], DISTANCE), "time = 20 values: give one for each time, at least 32"),
        ((TIME, SENT, GOT * np.nan, DISTANCE), "received = not finite: leave such samples out"),
        ((TIME, SENT * 0.0, GOT, DISTANCE), "transmitted = 0 always: give a signal that changes"),
        ((TIME[::-1], SENT, GOT, DISTANCE), "time = 0.001998 to -0.0001: give increasing times in equal steps, s"),
        ((TIME**3, SENT, GOT, DISTANCE), "equal steps"),
        ((TIME, SENT, GOT, 0.0), "distance = 0.0: give the path between the elements, m"),
        ((TIME, SENT, GOT, 100.0), "distance = 100.0: give the path"),
        ((1e3 * TIME, SENT, GOT, DISTANCE), "distance = 0.1 gives 0.199 m/s: give distance in m and time in s"),
        ((TIME, GOT, SENT, DISTANCE), "received = no arrival above the noise: record longer"),
        ((TIME, SENT, np.random.default_rng(1).normal(size=TIME.size), DISTANCE), "no arrival above the noise"),
        (
            (TIME[70:], SENT[70:], GOT[70:], DISTANCE),
            "time = 4e-05 is within the pulse: give a record that begins before it",
        ),
        ((TIME[::20], SENT[::20], GOT[::20], DISTANCE), "give a pulse of 5 samples or more, and a longer record"),
    ],
)
def test_what_is_wrong_with_a_signal_is_named(
    arguments: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float], words: str
) -> None:
    """Field, value and cure."""
    with pytest.raises(FieldError) as caught:
        calcidem.read_signal(*arguments)
    assert words in str(caught.value)
    assert _exit_code_of(caught.value) == 2
