"""Settings of transmission, propagation and recording of a shear wave, and checks beforehand."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval, Unit

from calcidem.dem.engine.fields import NotNegative, Part, Positive, PositivePart, checked, require
from calcidem.dem.engine.scene import Precision, Regime
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.pulse import Pulse

Transmitter = Literal["wall", "driven"]

WHOLE_DOMAIN = "whole_domain"
FEWEST_SAMPLES = 20  # samples per period of the pulse; with 20 a peak shifts by 0.1 % (docs/reading.md)


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
    regime
        ``finite``: displacements of any size; ``small``: fixed geometry; ``linear``: fixed stiffness as well.
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
        Interval(ge=0.0, le=0.7),  # with more, Vs may depend on the step (docs/stability.md, "Drawn at random")
        "a factor in [0, 0.7] (boundary_damping may be 1): with more the wave decays within a few grains, and "
        "its velocity depends on the time step",
    ] = 0.3
    boundary_damping: Part = 1.0
    boundary_thickness: Annotated[NotNegative, Unit("m")] = 0.05
    regime: Regime = "linear"
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


def refuse_loud_pulse(packing: Packing, rule: WaveRule, frequency: float) -> None:
    """Raise a `ValueError` if a pulse moves the transmitter too far for the regime.

    Constant stiffnesses require a stroke of the order of the mean overlap, a fixed geometry one much smaller than a
    disk.
    """
    refuse_long_stroke(rule, frequency, packing.report.mean_overlap, float(packing.radius.min()))


def refuse_long_stroke(rule: WaveRule, frequency: float, overlap: float, radius: float) -> None:
    """Same as `refuse_loud_pulse`, from the mean overlap and the smallest radius, m."""
    stroke = Pulse(rule.amplitude, frequency).stroke
    bounds = {"linear": (5.0 * overlap, "5 mean overlaps"), "small": (0.05 * radius, "0.05 radii of the smallest disk")}
    if rule.regime in bounds:
        bound, meaning = bounds[rule.regime]
        require(
            stroke <= bound,
            "amplitude",
            rule.amplitude,
            f"moves the transmitter by {stroke:.3g} m, more than {meaning} ({bound:.3g} m), too far for the regime "
            f'{rule.regime}: choose regime = "finite" or an amplitude of at most '
            f"{bound * frequency:.3g} m/s",
        )
