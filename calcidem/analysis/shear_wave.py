"""Quantities derived from a shear-wave velocity: modulus, damping ratio, wavelengths and near-field criterion."""

import math
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calcidem.analysis.published import published_study

if TYPE_CHECKING:
    import xarray as xr  # its import would delay a rank by half a second

FEWEST_WAVELENGTHS = 2.0
"""Wavelengths from transmitter to receiver below which near field and shear wave arrive together (section 3.1.3)."""

Values = TypeVar("Values", float, NDArray[np.float64], "xr.DataArray")


def small_strain_modulus(vs: Values, density: float | None = None) -> Values:
    """Shear modulus G0 = rho Vs^2 (Eq. 1), Pa; the default density of the sample is that of Table 1, 1659 kg/m^3.

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
    """Median diameter d50 by mass of disks (N,), in the unit of the radii.

    This is the median of soil mechanics: 2.632 mm for the paper's disks, uniform from 2.12 to 3 mm. Their median by
    number is 2.562 mm.
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
