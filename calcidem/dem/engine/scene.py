"""Scene of disks, walls and bonds with damping and loads, and the materials of grains and cement.

A scene is built from plain arrays and checked once.
"""

from dataclasses import dataclass, field
from typing import Annotated, Literal, get_args

import numpy as np
import numpy.typing as npt
from annotated_types import Interval, Unit
from pydantic import AllowInfNan

from calcidem.dem.engine.fields import NotNegative, Positive, PositivePart, checked, quote, require
from calcidem.dem.engine.portable import tangent_of_degrees
from calcidem.dem.kernels.layout import Floats, Integers


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


Law = Literal["finite", "linear"]
Precision = Literal["float64", "float32"]
Installation = Literal["preserve", "zero", "pfc_absolute"]


@checked
@dataclass(frozen=True, slots=True)
class Wall:
    """Straight rigid wall through ``point``; ``normal`` points to the disks.

    Attributes
    ----------
    point, normal
        (2,) m and unit vector.
    friction
        Coulomb coefficient; a contact takes the smaller one of disk and wall.
    velocity
        (normal, tangential) m/s; the tangent is ``(-n_y, n_x)``.
    span
        Range of the tangential coordinate (0 at ``point``) that this wall covers. A disk's reference position assigns
        it to a wall, so several walls can form one side.
    servo_force
        Normal force per metre of thickness held by a servo, N/m; None without servo.
    servo_speed
        Largest speed of the servo, m/s.
    servo_gain
        Part of the force deviation that the servo corrects per step, based on the stiffness of the wall's contacts; 1
        is PFC's stability limit.
    """

    point: Annotated[tuple[float, float], "two finite numbers, in m"]
    normal: Annotated[tuple[float, float], "two finite numbers"]
    friction: NotNegative = 0.0
    velocity: Annotated[tuple[float, float], "two finite numbers, in m/s"] = (0.0, 0.0)
    span: tuple[Annotated[float, AllowInfNan()], Annotated[float, AllowInfNan()]] = (-np.inf, np.inf)
    servo_force: Annotated[Positive, Unit("N/m")] | None = None  # a contact with a wall can only press
    servo_speed: Annotated[Positive, Unit("m/s")] = 0.1
    servo_gain: PositivePart = 0.5

    def __post_init__(self) -> None:
        """Refuse normals that are not unit vectors, and empty spans."""
        is_unit = bool(abs(np.hypot(*self.normal) - 1.0) < 1e-9)  # rounding of a hand-typed vector
        require(is_unit, "normal", quote(self.normal), "give a vector of length 1")
        require(self.span[0] < self.span[1], "span", quote(self.span), "give (lower, upper) with lower < upper")

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Distance of points from the wall, positive on the side of the disks, m."""
        return (x - self.point[0]) * self.normal[0] + (y - self.point[1]) * self.normal[1]

    def along(self, x: Floats, y: Floats) -> Floats:
        """Coordinate of points along the wall's tangent, m."""
        return (y - self.point[1]) * self.normal[0] - (x - self.point[0]) * self.normal[1]


@dataclass(frozen=True, slots=True)
class Bonds:
    """Cemented pairs of disks.

    Attributes
    ----------
    pairs
        (B, 2) indices of the disks.
    cement
        Their material.
    lanes
        (B,) bit l is set if the pair is cemented in lane l; all lanes by default.
    installation
        Start of a bond on a loaded contact. ``preserve`` transfers the contact's force to the linear group, or to the
        bond without one. ``zero`` drops it. In both the linear group acts about the distance at installation, also
        after the bond has broken. ``pfc_absolute`` drops it and sets the linear group to k_n times the overlap, as PFC
        does.
    """

    pairs: Integers
    cement: Cement = field(default_factory=Cement)
    lanes: Integers | None = None
    installation: Installation = "preserve"

    def __post_init__(self) -> None:
        """Refuse malformed pairs and ``pfc_absolute`` without linear group."""
        pairs = np.asarray(self.pairs)
        require(
            pairs.ndim == 2 and pairs.shape[1] == 2, "bonds.pairs", pairs.shape, "give an array of shape (B, 2)"
        )  # two ends
        whole = not pairs.size or np.issubdtype(pairs.dtype, np.integer)
        require(whole, "bonds.pairs", str(pairs.dtype), "give whole numbers")
        different = bool(np.all(pairs[:, 0] != pairs[:, 1]))
        require(different, "bonds.pairs", "a disk with itself", "bond two different disks")
        if self.lanes is not None:
            shape = np.shape(self.lanes)
            require(shape == (len(pairs),), "bonds.lanes", shape, f"give shape ({len(pairs)},)")
        known = get_args(Installation)
        require(self.installation in known, "installation", self.installation, f"choose one of {', '.join(known)}")
        if self.installation == "pfc_absolute":
            cure = "needs linear_modulus > 0 for its linear group"
            require(self.cement.linear_modulus > 0.0, "installation", self.installation, cure)

    @property
    def bits(self) -> npt.NDArray[np.uint32]:
        """(B,) lanes in which each pair is cemented, as bits."""
        if self.lanes is None:
            return np.full(len(self.pairs), 0xFFFFFFFF, dtype=np.uint32)
        return np.asarray(self.lanes, dtype=np.uint32)


@dataclass(frozen=True, slots=True)
class Preload:
    """Shear forces that contacts of the reference geometry already carry.

    Attributes
    ----------
    pairs
        (P, 2) indices of disks.
    shear
        (P,) N/m, the force on the second disk of each pair along ``t = (-n_y, n_x)``.
    """

    pairs: Integers
    shear: Floats


@dataclass(frozen=True, slots=True)
class Scene:
    """Disks and their boundary conditions; the reference geometry of all displacements.

    Attributes
    ----------
    x, y, radius
        (N,) m.
    sand
        Material of the disks.
    walls
        Rigid walls.
    bonds
        Cemented pairs; None without cement.
    damping
        Local damping factor alpha in [0, 1], one for all or (N,).
    held
        (N,) True for a disk whose velocity and spin no force changes.
    load
        (N, 3) constant external force x, y (N/m) and moment (N).
    gravity
        Acceleration x, y, m/s^2; the weight of each disk adds to its load.
    rotation
        False suppresses all rotation.
    rescaling
        Shear rescaling mode 1 of PFC (True) or 0. In mode 1, the shear force of a sticking contact is multiplied by
        ``sqrt(e / d)`` whenever its overlap falls from d to e. This never creates energy, but vibration wears the force
        off. Mode 0 keeps the force and may create energy.
    """

    x: Floats
    y: Floats
    radius: Floats
    sand: Sand = field(default_factory=Sand)
    walls: tuple[Wall, ...] = ()
    bonds: Bonds | None = None
    damping: float | Floats = 0.0
    held: npt.NDArray[np.bool_] | None = None
    load: Floats | None = None
    gravity: tuple[float, float] = (0.0, 0.0)
    rotation: bool = True
    rescaling: bool = True

    def __post_init__(self) -> None:
        """Refuse invalid arrays."""
        count = len(np.atleast_1d(self.radius))
        require(count > 0, "radius", "empty", "give at least one disk")
        for name in ("x", "y", "radius"):
            values = np.asarray(getattr(self, name))
            require(values.shape == (count,), name, values.shape, f"give an array of shape ({count},)")
            require(bool(np.all(np.isfinite(values))), name, "NaN or infinite", "give finite numbers in m")
            # Distances of single precision would lose most digits of an overlap.
            object.__setattr__(self, name, values.astype(float, copy=False))
        require(not isinstance(self.walls, Wall), "walls", "a single wall", "give a tuple of walls")
        require(bool(np.all(np.asarray(self.radius) > 0.0)), "radius", np.min(self.radius), "give positive radii in m")
        alpha = np.asarray(self.damping)
        require(bool(np.all((alpha >= 0.0) & (alpha <= 1.0))), "damping", self.damping, "give factors in [0, 1]")
        require(alpha.shape in ((), (count,)), "damping", alpha.shape, f"give one number or shape ({count},)")
        if self.held is not None:
            require(np.shape(self.held) == (count,), "held", np.shape(self.held), f"give shape ({count},)")
            kind = np.asarray(self.held).dtype
            require(kind.kind == "b", "held", str(kind), "give True or False for each disk")
        if self.load is not None:
            require(np.shape(self.load) == (count, 3), "load", np.shape(self.load), f"give shape ({count}, 3)")
            require(bool(np.all(np.isfinite(self.load))), "load", "NaN or infinite", "give finite forces and moments")
        plane = np.shape(self.gravity) == (2,) and bool(np.all(np.isfinite(self.gravity)))
        require(plane, "gravity", self.gravity, "give two finite accelerations in m/s^2")
        if self.bonds is not None and len(self.bonds.pairs):
            indices = np.asarray(self.bonds.pairs)
            inside = bool(indices.min() >= 0 and indices.max() < count)
            require(inside, "bonds.pairs", f"{indices.min()} to {indices.max()}", f"use indices 0 to {count - 1}")

    @property
    def count(self) -> int:
        """Number of disks."""
        return len(self.radius)

    @property
    def mass(self) -> Floats:
        """(N,) mass per metre of thickness, rho pi R^2, kg/m."""
        return self.sand.density * np.pi * np.asarray(self.radius) ** 2

    @property
    def inertia(self) -> Floats:
        """(N,) moment of inertia per metre of thickness, m R^2 / 2, kg m."""
        return self.mass * np.asarray(self.radius) ** 2 / 2.0

    @property
    def total_load(self) -> Floats:
        """(N, 3) loads and weights, N/m, N/m and N."""
        total = np.zeros((self.count, 3)) if self.load is None else np.array(self.load, dtype=float)
        total[:, :2] += self.mass[:, None] * np.asarray(self.gravity)
        return total

    def per_disk(self, value: npt.ArrayLike) -> Floats:
        """(N,) array of a single number or of values for each disk."""
        return np.broadcast_to(np.asarray(value, dtype=float), (self.count,)).copy()
