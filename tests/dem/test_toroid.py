import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from calcidem.dem.sample.cement import toroid_area

# Size ratios to 20, cement not below 1/20 of the smaller disk: Eq. 2 loses about 6 (d / d_c)^2 roundings by
# cancellation, here 1e6 of 1e-16.
DIAMETERS = st.floats(1e-3, 2e-2)
SHARES = st.floats(0.05, 1.0)


def area_between_circles(first: float, second: float, cement: float) -> float:
    """Integral of the gap between two touching circles over the width of the cement."""

    def gap(across: float) -> float:
        return sum(float(d / 2 - np.sqrt(max(0.0, d**2 / 4 - across**2))) for d in (first, second))

    area, _ = quad(gap, -cement / 2, cement / 2, epsabs=0.0, epsrel=1e-10, limit=200)
    return float(area)


@given(DIAMETERS, DIAMETERS, SHARES)
def test_area_is_that_of_the_gap_between_touching_circles(first: float, second: float, share: float) -> None:
    """Eq. 2 is the region between two touching disks within the width of the cement."""
    cement = share * min(first, second)
    # Up to the square-root end point of the widest cement, which quad meets only to about 1e-8.
    assert toroid_area(first, second, cement) == pytest.approx(
        area_between_circles(first, second, cement), rel=1e-7, abs=0.0
    )


@pytest.mark.parametrize(("cement", "area"), [(1.06e-3, 0.080e-6), (1.33e-3, 0.16e-6)])
def test_mean_grains_hold_the_known_areas(cement: float, area: float) -> None:
    """Cement of 1.06 mm on grains of 2.12 to 3 mm is 0.080 mm^2 on average, of 1.33 mm 0.16 mm^2."""
    first, second = np.random.default_rng(1).uniform(2.12e-3, 3.0e-3, (2, 20_000))
    assert toroid_area(first, second, cement).mean() == pytest.approx(area, rel=0.02)  # two digits are known


@given(DIAMETERS, DIAMETERS, SHARES, st.floats(0.01, 100.0))
def test_area_is_symmetric_and_scales_with_length_squared(
    first: float, second: float, share: float, scale: float
) -> None:
    """Swapping the disks changes nothing; a picture enlarged s times has s^2 times the area."""
    cement = share * min(first, second)
    area = toroid_area(first, second, cement)
    assert toroid_area(second, first, cement) == area
    assert toroid_area(scale * first, scale * second, scale * cement) == pytest.approx(
        scale**2 * area, rel=2e-9, abs=0.0
    )


def test_narrow_cement_follows_the_parabola() -> None:
    """Narrow cement has the area between two parabolas, d_c^3 (1/d_1 + 1/d_2) / 12."""
    first, second, cement = 2e-3, 3e-3, 2e-5
    expected = cement**3 * (1 / first + 1 / second) / 12
    assert toroid_area(first, second, cement) == pytest.approx(expected, rel=1e-4, abs=0.0)  # (d_c / d)^2 = 1e-4


def test_arguments_broadcast() -> None:
    """One cement diameter serves an array of contacts, with the same numbers as one by one."""
    first, second = np.array([2e-3, 3e-3, 2.5e-3]), np.array([2.2e-3, 2.2e-3, 2.9e-3])
    together = toroid_area(first, second, 1e-3)
    assert together.tolist() == [float(toroid_area(a, b, 1e-3)) for a, b in zip(first, second, strict=True)]
    assert toroid_area([], [], 1e-3).shape == (0,)


def test_cement_wider_than_a_disk_is_refused() -> None:
    """Cement wider than one of its disks is refused, with both sizes in the message."""
    with pytest.raises(ValueError, match=r"0\.0025 m is larger than a disk of 0\.0024 m"):
        toroid_area([3e-3, 2.4e-3], 3e-3, 2.5e-3)
