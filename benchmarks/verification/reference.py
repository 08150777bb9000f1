"""What the checks compare with, written from the textbooks; nothing here comes from calcidem.

Disks have unit thickness: m = rho pi R^2, I = m R^2 / 2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.integrate import solve_ivp
from scipy.special import gamma

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

HERTZ_TIME = 4.0 * np.sqrt(np.pi) * gamma(0.4) / (5.0 * gamma(0.9))
"""Duration of a Hertz impact times speed over largest overlap: Johnson, Contact Mechanics (1985), section 11.4."""


@dataclass(frozen=True, slots=True)
class Grain:
    """Material of the grains.

    Attributes
    ----------
    modulus, ratio
        Shear modulus, Pa, and Poisson's ratio.
    density
        kg/m^3.
    friction
        Coulomb coefficient.
    """

    modulus: float
    ratio: float
    density: float
    friction: float

    def mass(self, radius: npt.ArrayLike) -> Floats:
        """Mass of disks, kg/m."""
        return self.density * np.pi * np.asarray(radius, float) ** 2

    def hertz(self, first: npt.ArrayLike, second: npt.ArrayLike = np.inf) -> Floats:
        """Coefficient of overlap^1.5: ``4/3 E* sqrt(R*)``, with a wall (infinite radius) of the same material."""
        young = 2.0 * self.modulus * (1.0 + self.ratio)
        effective = young / (2.0 * (1.0 - self.ratio**2))
        curvature = 1.0 / np.asarray(first, float) + 1.0 / np.asarray(second, float)
        return 4.0 / 3.0 * effective / np.sqrt(curvature)

    @property
    def shear_share(self) -> float:
        """Shear over normal stiffness, Mindlin (1949): 8 G* a over 2 E* a with 1 / G* = 2 (2 - nu) / G."""
        young = 2.0 * self.modulus * (1.0 + self.ratio)
        normal = 2.0 * young / (2.0 * (1.0 - self.ratio**2))
        return float(8.0 * self.modulus / (2.0 * (2.0 - self.ratio)) / normal)


def largest_overlap(mass: float, coefficient: float, speed: float) -> float:
    """Overlap at which ``2/5 h d^2.5`` holds the energy ``m v^2 / 2``, m."""
    return float((1.25 * mass * speed**2 / coefficient) ** 0.4)


@dataclass(frozen=True, slots=True)
class Springs:
    """Contacts of constant stiffness.

    Attributes
    ----------
    first, second
        (C,) disks; -1 as the first stands for a wall.
    normal
        (C, 2) unit vectors from the first to the second.
    arms
        (2, C) from the centres to the contact, m.
    stiffness
        (3, C) normal, shear (N/m), rotational (N m).
    tilt
        (C,) force over distance of loaded contacts, N/m, that turn with their disks; 0 where normals stay.
    """

    first: Integers
    second: Integers
    normal: Floats
    arms: Floats
    stiffness: Floats
    tilt: Floats


def stiffness_matrix(count: int, springs: Springs) -> sparse.csr_array:
    """(3N, 3N) second derivative of the energy of all springs; degrees of freedom x, y, rotation of each disk."""
    (n_x, n_y), (first, second), number = springs.normal.T, springs.arms, len(springs.first)
    ends = np.column_stack([springs.first, springs.second])
    columns = (3 * np.maximum(ends, 0)[:, :, None] + np.arange(3)).ravel()
    there = np.repeat(ends >= 0, 3, axis=1)
    total = sparse.csr_array((3 * count, 3 * count))
    for stretch, weight in zip(_stretches(n_x, n_y, first, second), (*springs.stiffness, -springs.tilt), strict=True):
        parts = np.column_stack([np.broadcast_to(part, number) for ends_own in stretch for part in ends_own]) * there
        rows = np.repeat(np.arange(number), 6)
        spring = sparse.csr_array((parts.ravel(), (rows, columns)), shape=(number, 3 * count))
        total = total + spring.T @ sparse.diags_array(weight) @ spring
    return total


def bloch_matrices(
    waves: Floats, angles: Floats, spacing: float, stiffness: Sequence[float], mass: float, radius: float
) -> "np.ndarray":
    """(K, 3, 3) Hermitian matrices of x, y and ``R theta / sqrt 2`` of a disk in an endless lattice over its mass, 1/s^2.

    ``waves`` (K, 2) are wave vectors, ``angles`` (Z,) the directions of the neighbours; ``stiffness`` (4,) as of `Springs`,
    with the tilt last.
    """
    matrices = np.zeros((len(waves), 3, 3), dtype=complex)
    scale = np.array([1.0, 1.0, np.sqrt(2.0) / radius])
    for n_x, n_y in zip(np.cos(angles), np.sin(angles), strict=True):
        phase = np.exp(1j * spacing * (waves @ [n_x, n_y]))[:, None]
        for (own, other), weight in zip(
            _stretches(n_x, n_y, 0.5 * spacing, 0.5 * spacing), (*stiffness[:3], -stiffness[3]), strict=True
        ):
            row = (np.array(own) + phase * np.array(other)) * scale
            # Half of each contact belongs to each of its two disks.
            matrices += 0.5 * weight * row.conj()[:, :, None] * row[:, None, :]
    return matrices / mass


def _stretches(n_x: Any, n_y: Any, first: Any, second: Any) -> tuple[tuple[tuple[Any, ...], tuple[Any, ...]], ...]:  # noqa: ANN401 - numbers or arrays
    """Normal, shear, rotation and tilt of a contact for unit motions x, y, rotation of its first and second disk."""
    return (
        ((-n_x, -n_y, 0.0), (n_x, n_y, 0.0)),
        ((n_y, -n_x, -first), (-n_y, n_x, -second)),
        ((0.0, 0.0, -1.0), (0.0, 0.0, 1.0)),
        ((n_y, -n_x, 0.0), (-n_y, n_x, 0.0)),
    )


@dataclass(frozen=True, slots=True)
class Oblique:
    """Two disks that just touch along x and fly into one another.

    Attributes
    ----------
    radius
        (2,) m.
    velocity
        (2, 2) m/s.
    spin
        (2,) rad/s.
    """

    radius: Floats
    velocity: Floats
    spin: Floats


def oblique_impact(grain: Grain, impact: Oblique) -> Floats:
    """Velocities and spins after the contact, (2, 3), by adaptive integration of Hertz, Mindlin and Coulomb.

    Continuous in time, with the moments of stick and slip found as events: ``F_s' = -k_s u_s'`` where it sticks, and
    ``F_s' = F_s k_s' / k_s`` more while the contact unloads (rescaling mode 1); ``|F_s| = mu F_n`` where it slips.
    """
    mass = grain.mass(impact.radius)
    inertia = mass * impact.radius**2 / 2.0
    coefficient = float(grain.hertz(*impact.radius))
    state, slips = _just_after_touch(grain, impact, coefficient)
    smallest = float(impact.radius.sum() - np.hypot(*(state[2:4] - state[0:2]))) / 2.0  # a contact slips long before

    def kinematics(state: Floats) -> tuple[Floats, float, float, float, Floats]:
        """Normal, overlap, its rate, rate of slide, arms."""
        apart = state[2:4] - state[0:2]
        distance = float(np.hypot(*apart))
        n = apart / distance
        relative = state[6:8] - state[4:6]
        overlap = float(impact.radius.sum() - distance)
        arms = impact.radius - overlap / 2.0
        slide = -n[1] * relative[0] + n[0] * relative[1] - arms @ state[8:10]
        return n, overlap, -float(n @ relative), float(slide), arms

    def stick_rate(state: Floats) -> float:
        """Rate of the shear force of a contact that sticks."""
        _, overlap, closing, slide, _ = kinematics(state)
        root = np.sqrt(max(overlap, 0.0))
        carried = 0.5 * state[10] * closing / overlap if closing < 0.0 < smallest < overlap else 0.0
        return float(carried - 1.5 * grain.shear_share * coefficient * root * slide)

    def limit_rate(state: Floats) -> float:
        """Rate of the friction limit."""
        _, overlap, closing, _, _ = kinematics(state)
        return float(1.5 * grain.friction * coefficient * np.sqrt(max(overlap, 0.0)) * closing)

    def motion(_: float, state: Floats, slips: float) -> Floats:
        n, overlap, _, _, arms = kinematics(state)
        normal = coefficient * max(overlap, 0.0) ** 1.5
        shear = slips * grain.friction * normal if slips else state[10]
        force = normal * n + shear * np.array([-n[1], n[0]])
        rate = slips * limit_rate(state) if slips else stick_rate(state)
        return np.concatenate(
            [state[4:8], -force / mass[0], force / mass[1], -shear * arms / inertia, [rate]], dtype=float
        )

    def parted(_: float, state: Floats, __: float) -> float:
        return kinematics(state)[1]

    def turned(_: float, state: Floats, slips: float) -> float:
        if slips:
            return limit_rate(state) - slips * stick_rate(state)
        overlap = kinematics(state)[1]
        return float(abs(state[10]) - grain.friction * coefficient * max(overlap, 0.0) ** 1.5)

    parted.terminal, parted.direction = True, -1.0  # type: ignore[attr-defined]
    turned.terminal, turned.direction = True, 1.0  # type: ignore[attr-defined]
    time, end = 0.0, 100.0 * float(impact.radius.sum()) / float(np.abs(impact.velocity).max())
    while True:
        piece = solve_ivp(
            motion, (time, end), state, "DOP853", events=(parted, turned), args=(slips,), rtol=1e-11, atol=1e-18
        )
        state, time = piece.y[:, -1].copy(), float(piece.t[-1])
        if len(piece.t_events[0]):
            return np.column_stack([state[4:8].reshape(2, 2), state[8:10]])
        slips = 0.0 if slips else float(np.sign(state[10]))


def _just_after_touch(grain: Grain, impact: Oblique, coefficient: float) -> tuple[Floats, float]:
    """State a billionth of the way into the contact, where forces grow with overlap^1.5, and whether it slips."""
    mass = grain.mass(impact.radius)
    closing = float(impact.velocity[0, 0] - impact.velocity[1, 0])
    slide = float(impact.velocity[1, 1] - impact.velocity[0, 1] - impact.radius @ impact.spin)
    deepest = largest_overlap(float(mass.prod() / mass.sum()), coefficient, closing)
    overlap = 1e-7 * deepest
    wanted = -grain.shear_share * slide / closing
    slips = float(np.sign(wanted)) if abs(wanted) >= grain.friction else 0.0
    shear = (slips * grain.friction if slips else wanted) * coefficient * overlap**1.5
    place = [0.0, 0.0, float(impact.radius.sum()) - overlap, 0.0]
    return np.concatenate([place, impact.velocity.ravel(), impact.spin, [shear]]), slips


def soliton_constant(power: float = 1.5) -> float:
    """K of the solitary wave in a chain of touching disks, ``V = K a (h / m)^(2/5) v^(1/5)`` with the peak speed v.

    The overlap of a travelling wave is its force averaged with a triangle as wide as two disks (English and Pego 2005,
    doi:10.1090/S0002-9939-05-07851-2), solved here by iteration; the speed of a disk is the force over one disk.
    """
    step = 1.0 / 400.0
    place = np.arange(-2400, 2401) * step
    triangle = np.maximum(0.0, 1.0 - np.abs(np.arange(-400, 401) * step)) * step
    wave = np.exp(-((place / 1.0) ** 2))
    for _ in range(200):
        following = np.convolve(wave**power, triangle, mode="same")
        size = float(np.sum(wave**2) / np.sum(wave * following))
        wave = following * size ** (power / (power - 1.0))
    inside = np.abs(place) <= 0.5 + 1e-9
    weights = np.where(np.isclose(np.abs(place), 0.5), 0.5, 1.0)[inside] * step
    speed = float(np.sum(weights * wave[inside] ** power))  # of the middle disk, with V = m = h = a = 1
    return float(speed**-0.2)
