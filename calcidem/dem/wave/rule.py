"""Settings of transmission, propagation and recording of a shear wave, and checks beforehand."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval, Unit

from calcidem.dem.engine.fields import NotNegative, Part, Positive, PositivePart, checked
from calcidem.dem.engine.scene import Precision

Transmitter = Literal["wall", "driven"]
Law = Literal["auto", "linear", "finite"]

WHOLE_DOMAIN = "whole_domain"
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
        have a prescribed motion without rotation, see `scene.driven_disks`.
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
        at displacements of any size. ``auto``: linear at contents where the check confirms it (`check`), else finite.
    precision
        Precision of the kernel's numbers.
    step_fraction
        Time step over the stability limit.
    samples_per_period
        Samples of the section per period of the pulse. With 40 a peak shifts by 2e-4, with 20 by 1e-3.
    slowest
        Slowest velocity covered by the length of the record, m/s.
    listening_depth
        Depth before the receiver in which disks that do not touch it are recorded, m.
    most_broken_bonds
        Largest share of bonds that the pulse may break.
    unbalanced_force_ratio
        Ratio at which a sample has settled after bonds changed its forces.
    most_settling_steps
        Largest number of time steps for settling.
    keep
        Kernel features kept without need (`kernels.features.Features`), and ``whole_domain`` to keep disks that the
        wave cannot reach (`scene.domain_of`).
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
    law: Law = "auto"
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
    keep: tuple[str, ...] = ()

    @property
    def regime(self) -> Literal["linear", "finite"]:
        """Regime of the engine; until the check has decided, that which neglects nothing."""
        return "linear" if self.law == "linear" else "finite"
