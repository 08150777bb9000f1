"""Amount of cement at a contact: the toroid between two touching disks."""

import numpy as np
import numpy.typing as npt

from calcidem.dem.engine.portable import arc_sine
from calcidem.dem.kernels.layout import Floats


def toroid_area(
    first_diameter: npt.ArrayLike, second_diameter: npt.ArrayLike, cement_diameter: npt.ArrayLike
) -> Floats:
    """Cement at a contact of two disks, m^2 (m^3 per metre of thickness).

    `ValueError` if a diameter is not positive, or the cement is wider than a disk.

    Parameters
    ----------
    first_diameter, second_diameter
        Diameters of the two disks, m; any shapes that broadcast together.
    cement_diameter
        Width d_c of the cement across the contact, m.

    Returns
    -------
    Floats
        Area of each contact, in the common shape of the arguments.

    Notes
    -----
    Eq. 2 of the paper, ``v = d_c (h_1 + h_2) - (S_1 + S_2)``: a rectangle as wide as the cement, which
    extends into each disk by ``h_i = d_i / 2 (1 - cos(arcsin(d_c / d_i)))``, less the circular segments
    ``S_i = d_i^2 / 4 arcsin(d_c / d_i) - d_c / 2 (d_i / 2 - h_i)`` of the disks in it.
    For disks that just touch, this is the exact area on both sides of the contact. An overlap removes
    about ``d_c`` times the overlap, which Eq. 2 neglects: about 1 % of the area in a packing at 5 kPa.
    For narrow cement the area tends to ``d_c^3 (1 / d_1 + 1 / d_2) / 12``.
    """
    first, second, cement = np.broadcast_arrays(
        *(np.asarray(values, dtype=float) for values in (first_diameter, second_diameter, cement_diameter))
    )
    for name, values in (("disk diameter", first), ("disk diameter", second), ("cement diameter", cement)):
        if not np.all(values > 0.0):
            raise ValueError(f"{name} = {np.min(values):g} m: give positive diameters in m")
    too_wide = cement > np.minimum(first, second)
    if np.any(too_wide):
        worst = int(np.argmax(np.where(too_wide, cement / np.minimum(first, second), 0.0)))
        raise ValueError(
            f"cement diameter = {cement.flat[worst]:g} m is larger than a disk of "
            f"{min(first.flat[worst], second.flat[worst]):g} m that it cements: "
            "make the cement narrower than the smallest disk"
        )
    return _half_area(first, cement) + _half_area(second, cement)


def _half_area(diameter: Floats, cement_diameter: Floats) -> Floats:
    """Cement between one disk and the tangent line at the contact, m^2; shapes as given."""
    sine = cement_diameter / diameter
    height = diameter / 2.0 * (1.0 - np.sqrt((1.0 - sine) * (1.0 + sine)))
    segment = diameter**2 / 4.0 * arc_sine(sine) - cement_diameter / 2.0 * (diameter / 2.0 - height)
    return np.asarray(cement_diameter * height - segment)
