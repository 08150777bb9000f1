"""Materials of the grains and of the cement.

The equations are those of PFC 7.0 (Itasca), https://docs.itascacg.com/pfc700/common/contactmodel/: models 'hertz'
(hertz/doc/manual/cmhertz.html) and 'linearpbond' (linearpbond/doc/manual/cmlinearpbond.html).
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval, Unit
from pydantic import AllowInfNan

from calcidem.dem.engine.fields import NotNegative, Positive, checked
from calcidem.dem.engine.portable import tangent_of_degrees
from calcidem.dem.kernels.layout import Floats


@checked
@dataclass(frozen=True, slots=True)
class Sand:
    """Grain material of the Hertz-Mindlin contact (PFC 'hertz' model).

    Attributes
    ----------
    shear_modulus
        Shear modulus G of the grains, Pa.
    poisson_ratio
        Poisson's ratio nu of the grains.
    density
        Density of the grains, kg/m^3; disks are 1 m thick.
    friction
        Coulomb coefficient between grains.
    """

    shear_modulus: Annotated[Positive, Unit("Pa")] = 6.5e11
    poisson_ratio: Annotated[float, Interval(gt=-1.0, lt=0.5)] = 0.25  # limits of elastic stability
    density: Annotated[Positive, Unit("kg/m^3")] = 2650.0
    friction: NotNegative = 0.5

    @property
    def shear_ratio(self) -> float:
        """Mindlin's k_s / k_n = 2 (1 - nu) / (2 - nu), without slip: Mindlin & Deresiewicz (1953), see `laws`."""
        return 2.0 * (1.0 - self.poisson_ratio) / (2.0 - self.poisson_ratio)

    def hertz_coefficient(self, radius_first: Floats, radius_second: Floats | None = None) -> Floats:
        """Coefficient h_n of ``F_n = h_n overlap^1.5``, N/m^2.5.

        ``h_n = (2/3) G / (1 - nu) sqrt(2 R~)`` with ``R~ = 2 / (1/R1 + 1/R2)``, and ``R~ = 2 R`` at a flat wall (no
        second radius): Hertz's ``(4/3) E* sqrt(R*) overlap^1.5`` (Johnson 1985, chapter 4, see `laws`) with
        ``E* = G / (1 - nu)`` of two equal materials and ``R* = R~ / 2``.
        """
        if radius_second is None:
            effective = 2.0 * np.asarray(radius_first)
        else:
            effective = 2.0 / (1.0 / np.asarray(radius_first) + 1.0 / np.asarray(radius_second))
        coefficient: Floats = np.sqrt(2.0 * effective) * (2.0 / 3.0 * self.shear_modulus / (1.0 - self.poisson_ratio))
        return coefficient


@checked
@dataclass(frozen=True, slots=True)
class Cement:
    """Cement of a bonded contact (PFC 'linearpbond': linear group and parallel bond).

    Attributes
    ----------
    bond_modulus
        Effective modulus of the parallel bond, Pa.
    bond_stiffness_ratio
        k_n / k_s of the bond.
    linear_modulus
        Effective modulus of the linear group, Pa. Without it (0) a broken bond returns the contact to the sand's law.
    linear_stiffness_ratio
        k_n / k_s of the linear group.
    tensile_strength, cohesion
        Strength of the bond, Pa.
    friction_angle
        Friction angle of the bond's shear strength, degrees.
    """

    bond_modulus: Annotated[Positive, Unit("Pa")] = 8.0e10
    bond_stiffness_ratio: Positive = 1.0
    linear_modulus: Annotated[NotNegative, Unit("Pa")] = 0.0
    linear_stiffness_ratio: Positive = 1.0
    tensile_strength: Annotated[float, Interval(gt=0.0), AllowInfNan(), Unit("Pa")] = 5.0e9  # infinite: never breaks
    cohesion: Annotated[float, Interval(gt=0.0), AllowInfNan(), Unit("Pa")] = 2.0e10
    friction_angle: Annotated[float, Interval(ge=0.0, lt=90.0), Unit("degrees")] = 0.0

    def bond_stiffness(self, radius_first: Floats, radius_second: Floats) -> Floats:
        """Stiffness of a parallel bond: (M, 3) normal, shear (N/m) and rotational (N m).

        ``k_n A = E / (R1 + R2) 2 R_b``, the shear stiffness is this over the ratio, and
        ``k_n I = E / (R1 + R2) 2 R_b^3 / 3``, with ``R_b = min(R1, R2)`` and unit thickness: the parallel bond of
        Potyondy & Cundall (2004), A bonded-particle model for rock, doi:10.1016/j.ijrmms.2004.09.011.
        """
        bond_radius = np.minimum(radius_first, radius_second)
        per_area = self.bond_modulus / (np.asarray(radius_first) + np.asarray(radius_second))
        normal = per_area * 2.0 * bond_radius
        return np.stack(
            [
                normal,
                normal / self.bond_stiffness_ratio,
                per_area * 2.0 * (bond_radius * bond_radius * bond_radius) / 3.0,
            ],
            axis=-1,
        )

    def linear_stiffness(self, radius_first: Floats, radius_second: Floats) -> Floats:
        """Stiffness of the linear group: (M, 2) normal and shear, N/m; ``k_n = 2 E R_min / (R1 + R2)``."""
        smallest = np.minimum(radius_first, radius_second)
        normal = 2.0 * self.linear_modulus * smallest / (np.asarray(radius_first) + np.asarray(radius_second))
        return np.stack([normal, normal / self.linear_stiffness_ratio], axis=-1)

    def strength(self, radius_first: Floats, radius_second: Floats) -> Floats:
        """Bond radius, tensile strength, cohesion and tangent of the friction angle: (M, 4)."""
        bond_radius = np.minimum(radius_first, radius_second)
        slope = tangent_of_degrees(self.friction_angle)
        rest = np.broadcast_to([self.tensile_strength, self.cohesion, slope], (len(bond_radius), 3))
        return np.column_stack([bond_radius, rest])
