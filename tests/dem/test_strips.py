"""The generator of elastic strips: its waves against closed forms, and the reading against its known delay."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks" / "reading"))

from judge import read_effective
from section import peak_time
from strips import WALLS, compute_strip

UNIFORM = np.zeros(3)


def test_a_plane_wave_has_its_speed_and_its_height_at_each_wall() -> None:
    """In a strip so high that nothing arrives from its edges; a free wall doubles the wave, a held one has none."""
    free, held = (compute_strip(wall, 2.0, 1.4, UNIFORM, height=0.5, spacing=2e-3) for wall in WALLS[1:])
    halfway = int(np.argmin(np.abs(free.places - 0.5)))
    for strip in (free, held):
        before = strip.times < strip.delay + strip.transmitted_peak  # nothing has returned
        peak = peak_time(strip.times, strip.across[halfway], before) - strip.transmitted_peak
        # Cells of a twenty-fifth of a wavelength slow the wave by (1 / 25)^2 pi^2 / 6 = 0.3 %.
        assert peak == pytest.approx(strip.places[halfway] * strip.delay, rel=0.005)
        # A station is the mean over a slice of the path, here of a sixth of a wavelength.
        thickness = 2.0 * (0.9 - 0.125) / 9.0
        assert strip.across[halfway][before].max() == pytest.approx(1.0 + np.sinc(thickness), rel=0.01)
    # The receiver records up to a fifth of a wavelength before the wall.
    assert 3.0 < free.across[-1].max() < 4.0
    assert held.across[-1].max() < 1.5


def test_the_fit_finds_the_velocity_of_an_elastic_strip() -> None:
    """Within 3 %: of the waves across a strip, whose second has a third of the height, the fit knows the first."""
    strip = compute_strip(WALLS[0], 2.0, 1.4, UNIFORM, spacing=2.5e-3)
    velocity, _ = read_effective(strip)
    assert velocity == pytest.approx(strip.velocity, rel=0.03)
