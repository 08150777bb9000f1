"""Modulus, damping ratio, median diameter by mass and wavelengths against closed forms."""

import numpy as np
import pytest

from calcidem.analysis.measured import published_study
from calcidem.analysis.velocity import (
    SOIL_DENSITY,
    damping_ratio,
    median_diameter_by_mass,
    notes_on,
    small_strain_modulus,
    wavelengths,
)
from calcidem.ends import CellStatus


def test_modulus_and_damping_ratio_are_those_of_the_paper() -> None:
    """Eq. 1 with the soil density of Table 1, for numbers and arrays, and D = 0.095 at alpha = 0.3 (section 3.1.2)."""
    assert small_strain_modulus(100.0) == 1659.0 * 1e4
    assert published_study().parameters["soil_density"] == SOIL_DENSITY
    np.testing.assert_array_equal(small_strain_modulus(np.array([1.0, 2.0]), density=2000.0), [2000.0, 8000.0])
    assert damping_ratio(published_study().parameters["local_damping"]) == pytest.approx(0.095, abs=1e-3)


def test_half_of_the_mass_is_below_the_median_diameter() -> None:
    """Of diameters uniform from a to b half of the mass lies below ((a^3 + b^3) / 2)^(1/3), whatever their order."""
    a, b = 2.12, 3.0
    diameter = np.random.default_rng(1).permutation(np.linspace(a, b, 4001))
    found = median_diameter_by_mass(diameter / 2.0)
    assert found == pytest.approx(((a**3 + b**3) / 2.0) ** (1.0 / 3.0), abs=(b - a) / 4000)
    # One large disk that outweighs the others together is the median; by count it would be a small one.
    assert median_diameter_by_mass([1.0, 1.0, 1.0, 5.0]) == 10.0


def test_wavelengths() -> None:
    """200 m/s at 4 kHz are 50 mm: two wavelengths in 0.1 m, and 20 grains of 2.5 mm; without a velocity none."""
    assert wavelengths(200.0, 4e3, 0.1, 2.5e-3) == pytest.approx((2.0, 20.0), rel=1e-14)
    assert wavelengths(None, 4e3, 0.1, 2.5e-3) == (None, None)


def test_advice_names_the_contents_that_it_is_about() -> None:
    """Two failures of eight may bias a mean, one of sixteen may not; five grains in a wave are few, nine are not."""
    content = np.repeat([1.0, 2.0], [8, 16])
    status = np.full(24, CellStatus.DONE, dtype=object)
    status[[0, 1, 8]] = CellStatus.NO_ARRIVAL
    vs = np.where(status == CellStatus.DONE, 500.0, np.nan)
    columns = {
        "content": content,
        "status": status,
        "vs": vs,
        "pulse_effect": np.where(content == 1.0, 0.001, 0.03),
        "wavelengths_on_path": np.where(content == 1.0, 1.5, 2.5),
        "wavelength_over_d50": np.where(content == 1.0, 9.0, 5.0),
        "broken_bonds": np.where(content == 1.0, 0, 1),
    }
    notes = notes_on(columns)
    beginnings = [
        *("At 1 % fewer than two wavelengths", "At 2 % a wavelength has fewer than 6 grains"),
        *("At 2 % Vs depends on the pulse", "Cells in which the pulse broke bonds: 16;"),
        *("Possible selection bias at 1 %:", "Cells without velocity: 3."),
    ]
    assert len(notes) == len(beginnings)
    for note, beginning in zip(notes, beginnings, strict=True):
        assert note.startswith(beginning)
    columns["content"] = np.where(content == 1.0, 0.0, content)  # without cement all cells are one sample
    assert not any("selection bias" in note for note in notes_on(columns))
    assert any(note.startswith("Cells without velocity: 1.") for note in notes_on(columns))
