"""Settings common to all samples (packing, materials, cement, wave, picking), and the scene of a shear wave from them.

The scene is a cemented packing between transmitter and receiver, bands of the side walls at mid-height. Strongly damped
layers at floor and lid represent the soil beyond (section 2.2.2 and Fig. 4 of the paper).

Disks that the wave cannot reach are left out. A layer with a local damping factor of 1 removes any force that
accelerates a disk, so a wave decays within a few diameters. At a depth of four diameters, a billionth of the pulse's
stroke remains at every content. Deeper disks only cost time, as do disks without contacts if none can form.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, Literal, TypeVar, TypeVarTuple

import numpy as np
from annotated_types import Interval, Unit

from calcidem.dem.engine.fields import NotNegative, Part, Positive, PositivePart, checked, require
from calcidem.dem.engine.portable import interpolate
from calcidem.dem.engine.scene import Bonds, Cement, Installation, Law, Precision, Preload, Sand, Scene, Wall
from calcidem.dem.kernels.layout import Flags, Integers
from calcidem.dem.sample.cement import CementOrdering, CementRule, draw_cement
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.reading import PickRule
from calcidem.dem.wave.section import clamp_of_strip

WAVELENGTHS = 2.5
"""Path over wavelength: with fewer wavelengths the near field disturbs, with many more little propagates."""


_Found = TypeVar("_Found")
_Arguments = TypeVarTuple("_Arguments")

TRANSMITTER = 1  # index of the wall of `wave_scene`
DEEPEST_LISTENING = 0.3
"""Largest listening depth over box width; beyond it, velocities in a lattice are over 10 % high."""


Transmitter = Literal["wall", "driven"]

FEWEST_SAMPLES = 20  # samples per period of the pulse; with 20 a peak shifts by 0.1 %


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


def wave_scene(packing: Packing, sand: Sand, rule: WaveRule, bonds: Bonds | None) -> Scene:
    """The packing between transmitter and receiver."""
    width, height, middle = packing.width, packing.height, packing.height / 2.0
    for name in ("transmitter_half_width", "receiver_half_width"):
        half = getattr(rule, name)
        require(half < middle, name, half, f"has to be less than half the height of the sample, {middle:.4g} m")
    require(
        rule.boundary_thickness < middle,
        "boundary_thickness",
        rule.boundary_thickness,
        f"has to be less than half the height of the sample, {middle:.4g} m",
    )
    rubbing = rule.band_friction if rule.transmitter == "wall" else 0.0
    transmitter, receiver = rule.transmitter_half_width, rule.receiver_half_width
    walls = (
        # The tangent of the left wall points up, of the right wall down; both start at mid-height.
        Wall((0.0, middle), (1.0, 0.0), span=(-np.inf, -transmitter)),
        Wall((0.0, middle), (1.0, 0.0), friction=rubbing, span=(-transmitter, transmitter)),
        Wall((0.0, middle), (1.0, 0.0), span=(transmitter, np.inf)),
        Wall((width, middle), (-1.0, 0.0), span=(receiver, np.inf)),
        Wall((width, middle), (-1.0, 0.0), friction=rule.band_friction, span=(-receiver, receiver)),
        Wall((width, middle), (-1.0, 0.0), span=(-np.inf, -receiver)),
        Wall((0.0, 0.0), (0.0, 1.0)),
        # The servo of the lid is active only while a cemented sample settles.
        Wall((0.0, height), (0.0, -1.0), servo_force=packing.report.wall_stress[-1] * width),
    )
    inside = np.abs(packing.y - middle) < middle - rule.boundary_thickness
    return Scene(
        x=packing.x,
        y=packing.y,
        radius=packing.radius,
        sand=sand,
        walls=walls,
        bonds=bonds,
        damping=np.where(inside, rule.damping, rule.boundary_damping),
    )


def lane_bonds(
    packing: Packing, cement: Cement, bonded: Sequence[Flags], lanes: int, installation: Installation
) -> Bonds | None:
    """Cement of all lanes as one set of bonds; None if no sample has any."""
    # Spare lanes repeat the first sample, so all lanes compute valid numbers.
    filled = [*bonded, *[bonded[0]] * (lanes - len(bonded))]
    bits = sum(np.asarray(flags, dtype=np.uint32) << np.uint32(lane) for lane, flags in enumerate(filled))
    cemented = np.flatnonzero(bits)
    if not len(cemented):
        return None
    return Bonds(packing.pairs[cemented], cement, np.asarray(bits)[cemented], installation)


@dataclass(frozen=True, slots=True)
class Domain:
    """Computed disks."""

    packing: Packing
    """Only these disks, in the whole box."""
    pairs: Integers
    """(C,) pairs of the whole packing that lie between computed disks."""
    held: Flags
    """(N,) computed disks that touch one left out; they stay in place."""


def domain_of(packing: Packing, rule: WaveRule, installation: Installation) -> Domain:
    """Disks that a wave can reach, and listening disks.

    Parameters
    ----------
    packing, rule
        Packing and wave. The whole packing is kept if the layers damp by less than 1 or the rule requires it.
    installation
        Installation of the bonds. If it changes the contact forces, the whole packing settles again.
    """
    count = len(packing.x)
    if rule.whole_domain or installation != "preserve":
        return Domain(packing, np.arange(len(packing.pairs)), np.zeros(count, dtype=bool))
    kept = np.ones(count, dtype=bool)
    if rule.boundary_damping >= 1.0:
        # Six mean diameters of a damping layer are computed; after four, a billionth of the stroke remains.
        middle, bands = packing.height / 2.0, max(rule.transmitter_half_width, rule.receiver_half_width)
        reach = max(middle - rule.boundary_thickness, bands) + 6.0 * 2.0 * float(packing.radius.mean())
        kept = np.asarray(np.abs(packing.y - middle) < reach)
    if rule.contact_law != "finite":
        kept &= np.bincount(packing.pairs.ravel(), minlength=count) > 0
    kept[listening_disks(packing, rule)] = True
    inside = kept[packing.pairs]
    pairs = np.flatnonzero(inside.all(axis=1))
    held = np.zeros(count, dtype=bool)
    held[packing.pairs[~inside.all(axis=1)].ravel()] = True
    number = np.cumsum(kept) - 1
    part = replace(
        packing,
        x=packing.x[kept],
        y=packing.y[kept],
        radius=packing.radius[kept],
        preload=Preload(number[packing.pairs[pairs]], packing.preload.shear[pairs]),
    )
    return Domain(part, pairs, held[kept])


def listening_disks(packing: Packing, rule: WaveRule) -> Integers:
    """Disks in the receiver's band that are near the wall but do not touch it.

    `ValueError` if there is none, or if disks far from the wall would blur the arrival.
    """
    depth, deepest = rule.listening_depth, DEEPEST_LISTENING * packing.width
    require(
        depth <= deepest,
        "listening_depth",
        depth,
        f"the wave reaches disks so far apart at different times; give at most {DEEPEST_LISTENING:g} of the box's "
        f"width, {deepest:.4g} m",
    )
    gap = packing.width - packing.x - packing.radius
    in_band = np.abs(packing.y - packing.height / 2.0) < rule.receiver_half_width
    found = np.flatnonzero(in_band & (gap > 0.0) & (packing.width - packing.x < depth))
    cure = "holds no disk at the receiver: make it or receiver_half_width larger"
    require(len(found) > 0, "listening_depth", depth, cure)
    return found


def station_disks(packing: Packing, rule: WaveRule) -> tuple[Integers, ...]:
    """Disks of each station, starting at the transmitter: slices of equal thickness before the listening disks.

    There are 9 of them, fewer if slices would be thinner than the largest disk, and none if one would be empty. The
    first eighth of the path is left out, because P and S wave have not separated there. They are as high as the
    receiver, and at most the middle half of the strip between the damped layers: there the wave has more than half of
    its energy density, and it follows the stiffness better than outside.
    """
    begin, end = 0.125 * packing.width, packing.width - rule.listening_depth
    count = min(9, max(0, int((end - begin) / (2.0 * float(packing.radius.max())))))  # 18 improve no reading
    half = min(rule.receiver_half_width, 0.25 * (packing.height - 2.0 * rule.boundary_thickness))
    in_band = np.abs(packing.y - packing.height / 2.0) < half
    slices = pairwise(np.linspace(begin, end, count + 1))
    found = tuple(np.flatnonzero(in_band & (a <= packing.x) & (packing.x < b)) for a, b in slices)
    return found if all(map(len, found)) else ()


def driven_disks(packing: Packing, rule: WaveRule) -> Integers:
    """Disks with prescribed motion: those that overlap the left wall within the transmitter's band.

    The reference geometry at rest decides, so they are the same in all samples of a packing. Empty if the wall itself
    is the transmitter. `ValueError` if no disk touches the band.
    """
    if rule.transmitter == "wall":
        return np.zeros(0, dtype=np.int64)
    in_band = np.abs(packing.y - packing.height / 2.0) < rule.transmitter_half_width
    found = np.flatnonzero(in_band & (packing.x < packing.radius))
    cure = "no disk touches the transmitter: make it wider"
    require(len(found) > 0, "transmitter_half_width", rule.transmitter_half_width, cure)
    return found


def refuse_idle_bands(packing: Packing, rule: WaveRule) -> None:
    """Raise a `ValueError` unless disks touch both bands."""
    off_centre = np.abs(packing.y - packing.height / 2.0)
    for name, distance in (("transmitter", packing.x), ("receiver", packing.width - packing.x)):
        half = getattr(rule, f"{name}_half_width")
        is_touched = bool(np.any((off_centre < half) & (distance < packing.radius)))
        cure = f"no disk touches the {name}, here or with the wave from the other side: make it wider"
        require(is_touched, f"{name}_half_width", half, cure)


def clamp_of_layers(height: float, rule: WaveRule) -> float:
    """K of a sample of a height, m, between its layers, 1/m; 0 without any: smooth walls hold nothing."""
    if rule.boundary_thickness == 0.0 or rule.boundary_damping <= rule.damping:
        return 0.0
    return clamp_of_strip(height - 2.0 * rule.boundary_thickness)


@dataclass(frozen=True, eq=False)
class Experiment:
    """Settings common to samples of many seeds and contents; compared by identity.

    Expensive results for all batches (`domain`, `bare_scene`, `places`, limits of the step) are computed on first use
    and kept as long as the experiment.
    """

    packing: Packing
    sand: Sand = field(default_factory=Sand)
    cement: Cement = field(default_factory=Cement)
    cement_rule: CementRule = field(default_factory=CementRule)
    wave: WaveRule = field(default_factory=WaveRule)
    pick: PickRule = field(default_factory=PickRule)
    """See their classes."""
    root_seed: int = 0
    """Root of all random numbers."""
    stiffness_factor: float = 1.0
    """Multiplies the grains' shear modulus, and with it all contact forces and the confining stress, in the wave stage.
    1 leaves the packing unchanged; any other value is a calibration.
    """
    installation: Installation = "preserve"
    """See `engine.scene.Bonds`."""
    is_checked: bool = True
    """Measure the numerical error of each content, and choose law and time step by it (`check.check_content`)."""
    frequencies: tuple[tuple[float, ...], tuple[float, ...]] | Callable[["Experiment", float], float] = (
        tuple(content for content, _ in EXCITATION),
        tuple(frequency for _, frequency in EXCITATION),
    )
    """(contents in percent, frequencies in Hz), interpolated linearly; by default Table 2 of the paper. Or a function
    of an experiment and a content, percent, that returns the frequency in Hz and is called once for each content.
    """
    gpu: bool = False
    """Propagate waves on a GPU, with the same bits (`calcidem.dem.kernels.gpu`)."""
    _kept: dict[tuple[Callable[..., Any], tuple[Any, ...]], Any] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        """Refuse invalid factors, and settings that the linear law excludes."""
        require(self.stiffness_factor > 0.0, "stiffness_factor", self.stiffness_factor, "give a positive factor")
        require(
            self.installation == "preserve" or self.wave.law != "linear",
            "installation",
            self.installation,
            'changes the contact forces, which are fixed with law = "linear"; choose "auto" or "finite"',
        )

    def frequency(self, content: float) -> float:
        """Excitation frequency at a content (percent), Hz."""
        if callable(self.frequencies):
            return self.once(self.frequencies, content)
        return interpolate(content, *self.frequencies)

    @property
    def clamp(self) -> float:
        """K of the strip between the damped layers, 1/m, see `StripWave`."""
        return clamp_of_layers(self.packing.height, self.wave)

    def with_wave(self, **changes: Any) -> "Experiment":  # noqa: ANN401 - fields of several types
        """The experiment with changed fields of its `WaveRule`; the same one for the same fields."""
        return self.once(Experiment._with_rule, replace(self.wave, **changes))

    def _with_rule(self, wave: WaveRule) -> "Experiment":
        return replace(self, wave=wave)

    def once(
        self,
        compute: Callable[["Experiment", *_Arguments], _Found],
        *arguments: *_Arguments,
        **others: Any,  # noqa: ANN401 - arguments of several types
    ) -> _Found:
        """Value of a function of this experiment and of hashable arguments, computed on first use.

        The value must not depend on ``others``, further arguments of the function.
        """
        key = (compute, arguments)
        if key not in self._kept:
            self._kept[key] = compute(self, *arguments, **others)
        found: _Found = self._kept[key]
        return found

    @cached_property
    def domain(self) -> Domain:
        """Computed part of the packing, stiffened."""
        return domain_of(self.stiffen()[0], self.wave, self.installation)

    @cached_property
    def bare_scene(self) -> Scene:
        """Scene of that part without cement."""
        held = self.domain.held.copy()
        held[driven_disks(self.domain.packing, self.wave)] = True
        return replace(wave_scene(self.domain.packing, self.stiffen()[1], self.wave, None), held=held)

    @cached_property
    def places(self) -> tuple[float, ...]:
        """Path from the transmitter to each station, and last to the receiver, m.

        A station records the plain mean velocity of its disks, so its place is their mean x. Driven disks transmit the
        wave from their mean x, a wall from its surface.
        """
        packing, wave = self.domain.packing, self.wave
        driven, groups = driven_disks(packing, wave), (*station_disks(packing, wave), listening_disks(packing, wave))
        begin = float(np.mean(packing.x[driven])) if len(driven) else 0.0
        return tuple(float(np.mean(packing.x[disks])) - begin for disks in groups)

    @property
    def distance(self) -> float:
        """Path from the transmitter to the receiver, m."""
        return self.places[-1]

    def ordering(self, seed: int) -> CementOrdering:
        """Order in which the contacts and clusters of a seed are cemented."""
        return draw_cement(self.packing, self.cement_rule, seed=seed, root_seed=self.root_seed)

    def stiffen(self) -> tuple[Packing, Sand]:
        """Packing and sand of the wave stage."""
        factor = self.stiffness_factor
        preload = replace(self.packing.preload, shear=self.packing.preload.shear * factor)
        left, right, floor, lid = self.packing.report.wall_stress
        stress = (factor * left, factor * right, factor * floor, factor * lid)
        report = replace(self.packing.report, wall_stress=stress)
        sand = replace(self.sand, shear_modulus=self.sand.shear_modulus * factor)
        return replace(self.packing, preload=preload, report=report), sand


def suitable_frequency(experiment: Experiment, content: float) -> float:
    """Return the frequency at which the path from transmitter to receiver is 2.5 wavelengths, Hz.

    The wavelength follows from the static speed, which needs no signal: the median over the cement patterns of the
    seeds 0, 1 and 2. The frequency is rounded to two digits. It depends only on experiment and content, and is the same
    on each rank and processor. `ValueError` if a sample has no stiffness.

    Parameters
    ----------
    experiment
        Common settings; its frequencies are ignored.
    content
        Percent of the sand's mass.

    Notes
    -----
    On longer paths little of the pulse arrives; on shorter ones peaks travel visibly faster than the wave
    (`calcidem.dem.wave.reading.Reading.bias`).
    """
    # The median of three patterns is within some percent of that of hundreds.
    speed = expected_speed(experiment, content, 3)
    return float(f"{WAVELENGTHS * speed / experiment.distance:.2g}")


def expected_speed(experiment: Experiment, content: float, patterns: int) -> float:
    """Return the median static speed over cement patterns, those of the seeds from 0 on, m/s.

    `ValueError` if a sample has no stiffness.

    Parameters
    ----------
    experiment
        Common settings; its frequencies are ignored.
    content
        Percent of the sand's mass.
    patterns
        Number of patterns; without cement they are all the same.
    """
    # Every configuration imports this module; only a call loads the engine.
    from calcidem.dem.wave.static_speed import static_speed  # noqa: PLC0415

    seeds = range(patterns if content > 0.0 else 1)
    bonded = [experiment.ordering(seed).at(content).bonded for seed in seeds]
    return float(np.median([static_speed(experiment, flags).speed for flags in bonded]))


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
