"""Settings of transmission, propagation and recording of a shear wave, and its pulse: shape and frequency."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from annotated_types import Interval, Unit

from calcidem.dem.engine.fields import NotNegative, Part, Positive, PositivePart, checked
from calcidem.dem.engine.portable import sine_of_turns
from calcidem.dem.engine.scene import Law, Precision
from calcidem.dem.kernels.layout import Floats

Transmitter = Literal["wall", "driven"]

FEWEST_SAMPLES = 20  # samples per period of the pulse; with 20 a peak shifts by 0.1 % (docs/velocity.md)


@checked
@dataclass(frozen=True, slots=True)
class WaveRule:
    """Transmission, propagation and recording of the wave (section 2.2.2 and Table 1 of the paper).

    Attributes
    ----------
    amplitude
        v0 of ``v(t) = v0 (1 - cos 2 pi f t)``, m/s.
    transmitter
        ``wall``: the band of the left wall moves and drives the disks by friction. ``driven``: the disks at this band
        have a prescribed motion without rotation.
    transmitter_half_width, receiver_half_width
        Half-width of the band in the wall, m.
    band_friction
        Coulomb coefficient of the bands.
    damping
        Local damping factor of the sample.
    boundary_damping
        Local damping factor of the layers at floor and lid.
    boundary_thickness
        Thickness of these layers, m.
    law
        Contact law. ``linear``: constant stiffnesses, so contacts neither slip nor open. ``finite``: Hertz and Coulomb
        at displacements of any size. ``auto``: linear at contents where the check confirms it, else finite.
    both_sides
        Whether the wave comes from either side, in twice the time: the effective velocity is the mean.
    precision
        Precision of the kernel's numbers.
    step_fraction
        Time step over the stability limit.
    samples_per_period
        Samples of the section per period of the pulse, at low contents down to half of it, since steps are longer. With
        40 a peak shifts by 2e-4, with 20 by 1e-3.
    slowest
        Slowest velocity covered by the length of the record, m/s.
    listening_depth
        Depth before the receiver in which disks that do not touch it are recorded, m.
    most_broken_bonds
        Largest share of bonds that the pulse may break.
    unbalanced_force_ratio
        Ratio at which a sample has settled after bonds changed its forces.
    most_settling_steps
        Most time steps for settling.
    whole_domain
        Whether disks that the wave cannot reach are computed, too.
    """

    amplitude: Annotated[Positive, Unit("m/s")] = 1.0e-3
    transmitter: Transmitter = "wall"
    transmitter_half_width: Annotated[Positive, Unit("m")] = 0.01
    receiver_half_width: Annotated[Positive, Unit("m")] = 0.03
    band_friction: Annotated[Positive, "a positive coefficient: a smooth transmitter moves nothing"] = 0.7
    damping: Annotated[
        float,
        Interval(ge=0.0, le=0.7),  # with more, Vs may depend on the step (docs/accuracy.md, "Chatter")
        "a factor in [0, 0.7] (boundary_damping may be 1): with more the wave decays within a few grains, and "
        "its velocity depends on the time step",
    ] = 0.3
    boundary_damping: Part = 1.0
    boundary_thickness: Annotated[NotNegative, Unit("m")] = 0.05
    law: Literal["auto", "linear", "finite"] = "auto"
    both_sides: bool = False
    precision: Precision = "float64"
    step_fraction: Annotated[PositivePart, "0.05 to 0.95: above 1 the scheme is unstable"] = 0.8
    samples_per_period: Annotated[
        int, Interval(ge=FEWEST_SAMPLES), f"{FEWEST_SAMPLES} or more: a peak cannot be read from fewer"
    ] = 40
    slowest: Annotated[Positive, Unit("m/s")] = 60.0
    listening_depth: Annotated[Positive, Unit("m")] = 0.01
    most_broken_bonds: Part = 0.0
    unbalanced_force_ratio: Positive = 1.0e-6
    most_settling_steps: Annotated[int, Interval(ge=1)] = 2_000_000
    whole_domain: bool = False

    @property
    def contact_law(self) -> Law:
        """Law of the engine; until a check has decided (`check.check_content`), that which neglects nothing."""
        return "linear" if self.law == "linear" else "finite"


EXCITATION = (
    (0.0, 4.0e3),
    (0.11, 4.0e3),
    (0.23, 5.0e3),
    (0.34, 7.0e3),
    (0.45, 8.0e3),
    (0.55, 8.0e3),
    (0.66, 8.0e3),
    (1.24, 8.0e3),
    (1.88, 8.0e3),
    (2.55, 8.0e3),
    (3.17, 8.0e3),
    (4.0, 10.0e3),
    (5.0, 15.0e3),
    (6.0, 20.0e3),
    (7.0, 25.0e3),
    (8.0, 25.0e3),
    (9.0, 25.0e3),
)
"""Table 2 of the paper: calcite content, percent of the sand's mass, and excitation frequency, Hz."""


@dataclass(frozen=True, slots=True)
class Pulse:
    """One period of ``v(t) = v0 (1 - cos 2 pi f t)``, then rest (paper, section 2.2.2)."""

    amplitude: float
    """v0, m/s; the peak velocity is twice this. The paper's 5 m/s is a shock at 5 kPa, not a small strain."""
    frequency: float
    """f, Hz."""

    def __post_init__(self) -> None:
        """Refuse a pulse without motion or without end."""
        if not 0.0 < abs(self.amplitude) < np.inf:
            raise ValueError(f"amplitude = {self.amplitude} m/s: give a finite velocity other than 0")
        if not 0.0 < self.frequency < np.inf:
            raise ValueError(f"frequency = {self.frequency} Hz: give a positive, finite frequency")

    @property
    def stroke(self) -> float:
        """Displacement that remains after the pulse, v0 / f, m."""
        return self.amplitude / self.frequency

    def velocity(self, time: npt.ArrayLike) -> Floats:
        """Return the velocity at times (s, any shape), m/s; zero before 0 and after one period."""
        cycle = np.clip(self.frequency * np.asarray(time, dtype=float), 0.0, 1.0)
        return np.asarray(self.amplitude * (2.0 * sine_of_turns(0.5 * cycle) ** 2))


def cutoff_frequency(stiffness: float, mass: float) -> float:
    """Cut-off frequency of a chain of grains, Hz.

    Parameters
    ----------
    stiffness
        Contact stiffness in the direction of the motion, N/m.
    mass
        Mass of a grain, kg.

    Notes
    -----
    The highest frequency of a chain is ``omega = 2 sqrt(k / m)`` (L. Brillouin, Wave Propagation in Periodic
    Structures, 1946), so ``f = sqrt(k / m) / pi``. Its long waves have the speed ``V = d sqrt(k / m)`` for a spacing d,
    so ``f = V / (pi d)``.
    """
    return float(np.sqrt(stiffness / mass) / np.pi)
