import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import EXCITATION, Experiment, cutoff_frequency
from calcidem.dem.wave.section import Pulse

AMPLITUDES = st.floats(1e-9, 10.0)
FREQUENCIES = st.floats(100.0, 1e6)


@given(AMPLITUDES, FREQUENCIES)
def test_velocity_starts_and_ends_at_rest_with_its_peak_between(amplitude: float, frequency: float) -> None:
    """The pulse is at rest before 0 and after one period, and twice v0 fast in its middle."""
    pulse = Pulse(amplitude, frequency)
    outside = np.array([-1.0, -1e-9, 0.0, 1.001 / frequency, 1.0])
    assert np.abs(pulse.velocity(outside)).max() <= 1e-15 * amplitude  # rounding of cos(2 pi)
    assert pulse.velocity(0.5 / frequency) == pytest.approx(2.0 * amplitude, rel=1e-14, abs=0.0)
    assert pulse.velocity(np.linspace(0.0, 1.0 / frequency, 101)).argmax() == 50


@given(AMPLITUDES, FREQUENCIES, st.floats(0.0, 1.5))
def test_velocity_moves_the_transmitter_by_the_stroke(amplitude: float, frequency: float, cycle: float) -> None:
    """The integral of the velocity is that of v0 (1 - cos) at any time, and the stroke from the end on."""
    pulse = Pulse(amplitude, frequency)
    nodes, weights = np.polynomial.legendre.leggauss(30)
    end = min(cycle, 1.0) / frequency
    integral = end / 2.0 * np.sum(weights * pulse.velocity(end / 2.0 * (nodes + 1.0)))
    turns = min(cycle, 1.0)
    moved = pulse.stroke * (turns - np.sin(2.0 * np.pi * turns) / (2.0 * np.pi))
    # 30 Gauss points are exact for this cosine to rounding, which is relative to the whole stroke.
    assert moved == pytest.approx(integral, rel=0.0, abs=1e-13 * pulse.stroke)


def test_the_paper_moves_its_transmitter_by_half_a_grain() -> None:
    """At 5 m/s and 4 kHz the transmitter ends 1.25 mm away."""
    assert Pulse(5.0, 4e3).stroke == pytest.approx(1.25e-3)


def test_frequencies_of_the_paper(small_packing: Packing) -> None:
    """Table 2 is met exactly at its 17 contents."""
    frequency = Experiment(small_packing).frequency
    assert len(EXCITATION) == 17
    assert [frequency(content) for content, _ in EXCITATION] == [hertz for _, hertz in EXCITATION]
    assert [frequency(content) for content in (0.66, 3.17, 6.0, 8.0)] == [8e3, 8e3, 20e3, 25e3]


@given(content=st.floats(0.0, 9.0))
def test_frequencies_between_are_between(small_packing: Packing, content: float) -> None:
    """Between two contents of Table 2 the frequency lies between theirs, and never falls with content."""
    below = max(hertz for c, hertz in EXCITATION if c <= content)
    above = min(hertz for c, hertz in EXCITATION if c >= content)
    frequency = Experiment(small_packing).frequency
    assert below <= frequency(content) <= above
    assert frequency(4.5) == pytest.approx(12.5e3)


def test_cutoff_is_that_of_a_chain() -> None:
    """The cut-off is the highest eigenfrequency of a long chain of the same contacts and grains."""
    stiffness, mass, count = 3e7, 13.6, 400
    matrix = 2.0 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1)
    highest = np.sqrt(np.linalg.eigvalsh(matrix)[-1] * stiffness / mass) / (2.0 * np.pi)
    assert cutoff_frequency(stiffness, mass) == pytest.approx(highest, rel=(np.pi / count) ** 2)  # finite length


@pytest.mark.parametrize(
    ("amplitude", "frequency"),
    [(0.0, 1e3), (float("nan"), 1e3), (1.0, 0.0), (1.0, -1.0), (1.0, float("inf"))],
)
def test_impossible_pulses_are_refused(amplitude: float, frequency: float) -> None:
    """A pulse without motion, without frequency or with infinite numbers is refused."""
    with pytest.raises(ValueError, match=r"(amplitude|frequency) = "):
        Pulse(amplitude, frequency)
