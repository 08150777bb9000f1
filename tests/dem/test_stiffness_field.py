"""Local stiffness against closed forms: a lattice of one kind, and one of two layers."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import RADIUS, SOFT, SOFT_CEMENT
from test_distance import OVERLAP, SPACING, lattice_experiment

from calcidem.dem.kernels.layout import Flags
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.stiffness_field import stiffness_field

WINDOW = 4.0 * SPACING


def experiment() -> Experiment:
    """A square lattice of 35 x 21 disks, with a soft cement."""
    return replace(lattice_experiment(3), cement=SOFT_CEMENT)


def test_a_lattice_is_as_stiff_everywhere_as_its_shear_wave_says() -> None:
    """It is k_s / 2 in every window, to rounding, and cement everywhere makes every window equally stiffer."""
    lattice = experiment()
    none = np.zeros(len(lattice.packing.pairs), dtype=bool)
    radius = np.array([RADIUS])
    normal = 1.5 * float(SOFT.hertz_coefficient(radius, radius)[0]) * np.sqrt(OVERLAP)
    found = stiffness_field(lattice, none, WINDOW)
    assert found.modulus.shape == (len(found.y), len(found.x))
    assert min(found.modulus.shape) > 10
    box = lattice.packing.width, lattice.packing.height
    for centres, side in zip((found.x, found.y), box, strict=True):
        assert 0.5 * (centres[0] + centres[-1]) == pytest.approx(0.5 * side)
        assert centres[0] - 0.5 * WINDOW > 0.0999 * min(box)
    np.testing.assert_allclose(found.modulus, 0.5 * SOFT.shear_ratio * normal, rtol=1e-6)
    cemented = stiffness_field(lattice, ~none, WINDOW).modulus
    np.testing.assert_allclose(cemented, cemented[0, 0], rtol=1e-6)
    assert cemented[0, 0] > 1.5 * found.modulus[0, 0]


@pytest.mark.parametrize("axis", [0, 1])
def test_each_of_two_layers_has_its_own_stiffness(axis: int) -> None:
    """Layers beside and above one another have the stiffness that each has alone, three disks from their border on."""
    lattice = experiment()
    packing = lattice.packing
    place = np.column_stack([packing.x, packing.y])[:, axis]
    half = 0.5 * (packing.width, packing.height)[axis]
    upper: Flags = (place > half)[packing.pairs].all(axis=1)
    alone = [stiffness_field(lattice, np.full(len(upper), flag), WINDOW).modulus[0, 0] for flag in (False, True)]
    found = stiffness_field(lattice, upper, WINDOW)
    centre, modulus = ((found.x, found.modulus.T), (found.y, found.modulus))[axis]
    away = 0.5 * WINDOW + 3.0 * SPACING
    for stiffness, there in zip(alone, (centre < half - away, centre > half + away), strict=True):
        assert there.any()
        np.testing.assert_allclose(modulus[there], stiffness, rtol=0.02)


def test_a_window_that_does_not_fit_is_refused() -> None:
    """The sentence names the largest one."""
    lattice = experiment()
    with pytest.raises(ValueError, match=r"window = 1\.0: give at most 0\.0"):
        stiffness_field(lattice, np.zeros(len(lattice.packing.pairs), dtype=bool), 1.0)
