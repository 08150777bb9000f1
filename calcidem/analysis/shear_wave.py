"""What follows from a shear-wave velocity: modulus, damping ratio, wavelengths, and whether near field spoils it."""

import math
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calcidem.analysis.published import published_study

if TYPE_CHECKING:
    import xarray as xr  # half a second that a rank would wait for

FEWEST_WAVELENGTHS = 2.0
"""Wavelengths from transmitter to receiver below which near field and shear wave arrive together (section 3.1.3)."""

LONGEST_WAVELENGTH = 10.0
"""Median diameters below which a wavelength has to be, as section 3.1.3 prints it."""

Values = TypeVar("Values", float, NDArray[np.float64], "xr.DataArray")


def small_strain_modulus(vs: Values, density: float | None = None) -> Values:
    """Shear modulus G0 = rho Vs^2 (Eq. 1), Pa; the density of the sample, kg/m^3, is that of Table 1, 1659, by default.

    Examples
    --------
    >>> small_strain_modulus(200.0)
    66360000.0
    """
    soil_density = published_study().parameters["soil_density"]
    return vs * vs * (soil_density if density is None else density)


def damping_ratio(local_damping: float) -> float:
    """Damping ratio D = alpha / pi of local damping (section 3.1.2).

    Examples
    --------
    >>> round(damping_ratio(0.3), 4)
    0.0955
    """
    return local_damping / math.pi


def median_diameter_by_mass(radius: ArrayLike) -> float:
    """Diameter d50 that half of the mass of disks (N,) lies below, in the unit of the radii.

    The median of soil mechanics; the paper's disks, uniform from 2.12 to 3 mm, have 2.632 mm. Half of their number lies
    below 2.562 mm.
    """
    ascending = np.sort(np.asarray(radius, dtype=np.float64))
    passing = np.cumsum(ascending * ascending)
    return 2.0 * float(ascending[np.searchsorted(passing, 0.5 * passing[-1])])


def wavelengths(
    vs: float | None, frequency: float, distance: float, median_diameter: float
) -> tuple[float, float] | tuple[None, None]:
    """Wavelengths on a path (m), and wavelength over median diameter by mass (m); None and None without a velocity."""
    if vs is None:
        return None, None
    wavelength = vs / frequency
    return distance / wavelength, wavelength / median_diameter
