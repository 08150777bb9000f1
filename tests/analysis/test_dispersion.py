"""Phase velocities of waves whose dispersion is known."""

import numpy as np
import pytest
from numpy.typing import NDArray

from calcidem.analysis.velocity import _jackknife, dispersion

FREQUENCY = 8000.0
PLACES = np.linspace(0.012, 0.093, 10)


def section(speed: float, spacing: float, seed: int, noise: float = 0.0) -> tuple[NDArray[np.float64], ...]:
    """A pulse that has travelled through a chain of masses: ``sin(k d / 2) = pi f d / speed``."""
    times = np.arange(0.0, 12.0 / FREQUENCY, 1.0 / (40.0 * FREQUENCY))
    pulse = np.where(times < 1.0 / FREQUENCY, 1.0 - np.cos(2.0 * np.pi * FREQUENCY * times), 0.0)
    frequency = np.fft.rfftfreq(8 * len(times), times[1])
    spectrum = np.fft.rfft(pulse, 8 * len(times))
    number = 2.0 / spacing * np.arcsin(np.minimum(np.pi * frequency * spacing / speed, 1.0))
    waves = [np.fft.irfft(spectrum * np.exp(-1j * number * place))[: len(times)] for place in PLACES]
    across = np.column_stack(waves)
    generator = np.random.default_rng(seed)
    return times, PLACES, across + noise * generator.standard_normal(across.shape)


def test_phase_velocities_of_a_chain_are_those_of_its_dispersion_relation() -> None:
    """A tenth of the grid's step of 0.6 % is left."""
    speed, spacing = 700.0, 5.0e-3
    found = dispersion([section(speed, spacing, seed) for seed in range(3)], FREQUENCY, (200.0, 2000.0))
    argument = np.pi * found.frequency * spacing / speed
    expected = speed * argument / np.arcsin(argument)
    np.testing.assert_allclose(found.phase_velocity, expected, rtol=1e-3)


def test_the_error_of_a_phase_velocity_covers_what_noise_does() -> None:
    """Of ten noisy sets of eight samples that at the pulse's frequency is within two standard errors in seven or more.

    A tenth of the grid's step, as above, is no noise.
    """
    inside, argument = 0, np.pi * FREQUENCY * 5.0e-3 / 700.0
    expected = 700.0 * argument / np.arcsin(argument)
    for trial in range(10):
        sections = [section(700.0, 5.0e-3, 100 * trial + seed, noise=0.3) for seed in range(8)]
        found = dispersion(sections, FREQUENCY, (200.0, 2000.0))
        at_pulse = int(np.abs(found.frequency - FREQUENCY).argmin())
        off = abs(found.phase_velocity[at_pulse] - expected)
        inside += off < 2.0 * found.standard_error[at_pulse] + 1e-3 * expected
    assert inside >= 7


def test_power_is_one_where_all_places_move_in_phase() -> None:
    """A wave without dispersion stacks to 1 at its velocity."""
    found = dispersion([section(900.0, 1.0e-6, seed) for seed in range(3)], FREQUENCY, (200.0, 2000.0))
    assert found.power.max() == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(found.phase_velocity, 900.0, rtol=3e-3)


@pytest.mark.parametrize(
    ("count", "velocities", "word"), [(0, (200.0, 900.0), "none given"), (3, (900.0, 200.0), "slowest")]
)
def test_what_has_no_dispersion_is_refused(count: int, velocities: tuple[float, float], word: str) -> None:
    """No sample and a range without width are refused with what to give."""
    with pytest.raises(ValueError, match=word):
        dispersion([section(700.0, 5.0e-3, seed) for seed in range(count)], FREQUENCY, velocities)


def test_one_sample_has_a_dispersion_without_errors() -> None:
    """All seeds without cement are one sample; a jackknife of one says nothing."""
    found = dispersion([section(900.0, 1.0e-6, 1)], FREQUENCY, (200.0, 2000.0))
    np.testing.assert_allclose(found.phase_velocity, 900.0, rtol=3e-3)
    assert np.isnan(found.standard_error).all()


def test_the_jackknife_of_means_is_the_standard_error_of_the_mean() -> None:
    """Each estimate leaves out one value: s / sqrt(n) in closed form."""
    values = np.random.default_rng(0).normal(size=(12, 3))
    left_out = (values.sum(axis=0) - values) / 11
    assert _jackknife(left_out) == pytest.approx(values.std(axis=0, ddof=1) / np.sqrt(12), rel=1e-12)
