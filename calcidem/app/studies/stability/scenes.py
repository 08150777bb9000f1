"""Small extreme scenes: a lattice of disks in a box with everything that may go wrong as a number, and small packings.

The packings are at the edge of rigidity: hardly pressed (nearly unjammed), or with hardly enough contacts. A packing of
disks with friction is isostatic at three contacts a disk, one without friction at four; friction while packing decides
which of the two is come near.
"""

from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import qmc

from calcidem.dem.engine.assembly import near_pairs
from calcidem.dem.engine.material import Cement, Sand
from calcidem.dem.engine.scene import Preload, Regime
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.cement import CementRule
from calcidem.dem.sample.compaction import make_packing
from calcidem.dem.sample.packing import Packing, PackingReport, PackingRule
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.pulse import cutoff_frequency
from calcidem.dem.wave.reading import PickRule
from calcidem.dem.wave.rule import WaveRule

_RADIUS = 1.25e-3  # m, of the largest disks
_DISKS_ACROSS, _DISKS_UP = 6, 10
_SMALLEST_RATIO = 2.5  # a disk smaller than this part of its neighbours fits into the pore between four of them
_SMALL_DISKS = 0.2  # of the pores that hold one
REGIMES: tuple[Regime, ...] = ("linear", "small", "finite")
RANGES = {
    "step_fraction": (0.5, 1.1),
    "contrast": (0.0, 6.0),
    "damping": (0.0, 1.0),
    "amplitude": (-9.0, 1.0),
    "frequency": (-1.0, 0.0),
    "size_ratio": (-0.5, 1.3),
    "content": (0.0, 1.0),
    "confinement": (0.0, 8.0),
    "missing": (-0.6, 0.3),
    "strength": (-2.0, 6.0),
}
"""Lower and upper end of every quantity of `Extreme`; powers of ten for those of `_POWERS`."""
PLAUSIBLE = {
    "step_fraction": (0.5, 1.0),
    "contrast": (0.0, 4.5),
    "damping": (0.0, 0.5),
    "amplitude": (-7.5, -4.5),
    "frequency": (-0.75, -0.2),
    "size_ratio": (-0.5, 0.5),
    "content": (0.0, 0.5),
    "confinement": (3.3, 5.3),
    "missing": (-0.6, 0.01),
    "strength": (1.0, 6.0),
}
"""The same for scenes that mostly have a velocity, so that there is something to be wrong about."""
BOXES = {"extreme": RANGES, "plausible": PLAUSIBLE}
_PICK = PickRule(largest_error=1.0)
"""The boxes are short against the wave: it is judged whether the reading depends on the step, not what it is of."""
_POWERS = {"contrast", "amplitude", "frequency", "size_ratio", "confinement", "strength"}
_FLOATER = 0.12  # radius of a floating disk over that of its neighbours; three in a row fit into a pore

STRESSES = (1.0e2, 5.0e3, 5.0e5)  # on a small packing, Pa
FRICTIONS = (0.0, 0.2, 1.0)  # while packing
CONTENTS = (0.0, 2.0)  # of small packings, percent
_BOX_WIDTH, _BOX_HEIGHT = 0.025, 0.04  # m
_UNBALANCED_FORCE_RATIO = 1.0e-7  # so few contacts take long to come to rest
_STROKE = 0.1  # of the pulse over the mean overlap
_SLOW_PULSE = 0.1  # frequency of the pulse over the cut-off of the pressed contacts
_CEMENTED_FREQUENCY = 2.0e4  # Hz: bonds carry the wave, whatever presses the contacts


@dataclass(frozen=True, slots=True)
class Extreme:
    """One scene of the map.

    Attributes
    ----------
    step_fraction
        Step over its predicted limit; above 1 it has to be refused.
    contrast
        Stiffness of bonds over that of the pressed contacts.
    damping
        Local damping factor.
    amplitude
        v0 of the pulse, m/s.
    frequency
        Over the cut-off of a chain of such contacts.
    size_ratio
        Largest over smallest radius; below 2.5 all disks are equal.
    content
        Part of the contacts' capacity for cement that is used; 1 bonds everything.
    confinement
        Stress that presses the disks, Pa.
    missing
        Part of the disks taken away: towards the loss of rigidity, with grains that touch nothing. Below 0 none is.
    strength
        Strength of bonds over the stress of the pulse in them.
    floating
        Tiny disks in the pore in the middle: they touch each other, if they are several, and nothing else.
    regime
        See `state.start`.
    seed
        Of the disorder and of the cement.
    """

    step_fraction: float = 0.8
    contrast: float = 1.0e3
    damping: float = 0.3
    amplitude: float = 1.0e-4
    frequency: float = 0.2
    size_ratio: float = 1.2
    content: float = 0.3
    confinement: float = 1.0e5
    missing: float = 0.0
    strength: float = 1.0e6
    floating: int = 0
    regime: Regime = "linear"
    seed: int = 1


@dataclass(frozen=True, slots=True)
class Packed:
    """One sample of a small packing.

    Attributes
    ----------
    stress
        On the lid, Pa.
    friction
        Between the disks while packing.
    content
        Percent.
    regime
        See `state.start`.
    seed
        Of packing and cement.
    """

    stress: float
    friction: float
    content: float
    regime: Regime
    seed: int = 1


def draw_scenes(count: int, seed: int, box: str = "extreme") -> tuple[Extreme, ...]:
    """Latin hypercube over all quantities of one of the `BOXES`, with regimes taking turns."""
    return tuple(
        Extreme(**values, regime=REGIMES[number % len(REGIMES)], seed=number)
        for number, values in enumerate(draw_quantities(BOXES[box], _POWERS, count, seed))
    )


def draw_quantities(
    ranges: Mapping[str, tuple[float, float]], powers: Container[str], count: int, seed: int
) -> list[dict[str, Any]]:
    """Latin hypercube over the ranges of quantities, which are powers of ten for some: the values of each scene."""
    sample = qmc.scale(qmc.LatinHypercube(len(ranges), rng=seed).random(count), *np.array(list(ranges.values())).T)
    return [
        {name: float(10.0**value if name in powers else value) for name, value in zip(ranges, row, strict=True)}
        for row in sample
    ]


def experiment_of_scene(extreme: Extreme) -> Experiment:
    """Experiment for `measurement.measure`, whose single content is `content_of` it.

    Raises
    ------
    ValueError
        If the scene is refused.
    """
    sand = Sand()
    packing = _lattice(extreme, sand)
    stiffness = _pressed_stiffness(packing, _RADIUS, sand)
    modulus = extreme.contrast * stiffness
    stress = max(extreme.amplitude * np.sqrt(sand.density * modulus), 1e-3)
    cement = Cement(
        bond_modulus=modulus,
        tensile_strength=extreme.strength * stress,
        cohesion=extreme.strength * stress,
    )
    width = 0.5 * float(packing.radius.min())
    cut_off = cutoff_frequency(stiffness, sand.density * np.pi * _RADIUS**2)
    frequency = extreme.frequency * cut_off
    wave = WaveRule(
        amplitude=extreme.amplitude,
        damping=extreme.damping,
        regime=extreme.regime,
        step_fraction=extreme.step_fraction,
        transmitter_half_width=4.0 * _RADIUS,
        receiver_half_width=6.0 * _RADIUS,
        boundary_thickness=2.0 * _RADIUS,
        listening_depth=0.29 * packing.width,
        slowest=2.0 * _RADIUS * cut_off,
    )
    return Experiment(
        packing,
        sand=sand,
        cement=cement,
        cement_rule=CementRule(p_diameter=width, c_diameter=width, threshold=100.0),
        wave=wave,
        pick=_PICK,
        root_seed=extreme.seed,
        frequencies=((0.0, 100.0), (frequency, frequency)),
    )


def content_of(extreme: Extreme, experiment: Experiment) -> float:
    """Content that is the scene's part of what its contacts can hold, percent."""
    return extreme.content * experiment.ordering(extreme.seed).maximum_content


def _lattice(extreme: Extreme, sand: Sand) -> Packing:
    """Square lattice of disks in equilibrium under the confining stress; small disks and gaps sown in at random."""
    generator = np.random.default_rng(extreme.seed)
    overlap = _overlap_under(extreme.confinement, sand)
    spacing = 2.0 * _RADIUS - overlap
    # A wall is twice as stiff as a disk is in R~, so that the same force presses it less.
    to_wall = _RADIUS - overlap / 2.0 ** (1.0 / 3.0)
    column, row = np.meshgrid(np.arange(_DISKS_ACROSS), np.arange(_DISKS_UP))
    kept = generator.random(column.size) >= extreme.missing
    x, y = (to_wall + index.ravel()[kept] * spacing for index in (column, row))
    radius = np.full(len(x), _RADIUS)
    small = _RADIUS / extreme.size_ratio
    if extreme.size_ratio > _SMALLEST_RATIO:
        # They sit in the pores and touch one disk so slightly that the balance does not change.
        hosts = np.flatnonzero(generator.random(len(x)) < _SMALL_DISKS)
        apart = (_RADIUS + small - 1e-3 * min(overlap, small)) * np.sqrt(0.5)
        x, y = np.append(x, x[hosts] + apart), np.append(y, y[hosts] + apart)
        radius = np.append(radius, np.full(len(hosts), small))
    inside = (x < spacing * (_DISKS_ACROSS - 1) + 1.1 * to_wall) & (y < spacing * (_DISKS_UP - 1) + 1.1 * to_wall)
    x, y, radius = _with_floaters(extreme.floating, x[inside], y[inside], radius[inside], to_wall, spacing)
    pairs = near_pairs(np.column_stack([x, y]), radius, 0.0)
    return Packing(
        x,
        y,
        radius,
        width=spacing * (_DISKS_ACROSS - 1) + 2.0 * to_wall,
        height=spacing * (_DISKS_UP - 1) + 2.0 * to_wall,
        preload=Preload(pairs, np.zeros(len(pairs))),
        report=_report_of(extreme, overlap),
    )


def _with_floaters(
    count: int, x: Floats, y: Floats, radius: Floats, to_wall: float, spacing: float
) -> tuple[Floats, Floats, Floats]:
    """Disks and a row of floating ones in the pore in the middle of the lattice."""
    own = _FLOATER * _RADIUS
    # They overlap by rounding alone, so that they touch without pushing.
    along = 2.0 * own * (1.0 - 1e-12) * (np.arange(count) - 0.5 * (count - 1))
    middle = to_wall + spacing * np.array([_DISKS_ACROSS // 2 - 0.5, _DISKS_UP // 2 - 0.5])
    return (
        np.append(x, middle[0] + along),
        np.append(y, np.full(count, middle[1])),
        np.append(radius, np.full(count, own)),
    )


def _report_of(extreme: Extreme, overlap: float) -> PackingReport:
    """Report of a lattice: what the wave stage reads of it."""
    return PackingReport(
        porosity=0.1,
        coordination_number=6.0,
        coordination_number_without_rattlers=6.0,
        rattlers=0,
        wall_stress=(extreme.confinement,) * 4,
        mean_overlap=overlap,
        largest_overlap=overlap,
        unbalanced_ratio=0.0,
        steps=0,
        seconds=0.0,
    )


def _overlap_under(stress: float, sand: Sand) -> float:
    """Overlap of the contacts of a lattice that a stress (Pa) presses, m: force = stress times diameter, Hertz."""
    coefficient = float(sand.hertz_coefficient(np.array(_RADIUS), np.array(_RADIUS)))
    return float((stress * 2.0 * _RADIUS / coefficient) ** (2.0 / 3.0))


def small_packing(stress: float, friction: float, seed: int = 1) -> Packing:
    """About 150 disks at rest under a stress, Pa."""
    rule = PackingRule(
        width=_BOX_WIDTH,
        height=_BOX_HEIGHT,
        stress=stress,
        friction_preparation=friction,
        unbalanced_force_ratio=_UNBALANCED_FORCE_RATIO,
    )
    return make_packing(rule, Sand(), np.random.default_rng(seed))


def experiment_of_packing(packing: Packing, scene: Packed) -> Experiment:
    """Experiment with a pulse that is small against the overlaps and slow against the cut-off of the contacts."""
    sand = Sand()
    radius = float(np.mean(packing.radius))
    cut_off = cutoff_frequency(_pressed_stiffness(packing, radius, sand), sand.density * np.pi * radius**2)
    frequency = _CEMENTED_FREQUENCY if scene.content > 0.0 else _SLOW_PULSE * cut_off
    wave = WaveRule(
        amplitude=_STROKE * packing.report.mean_overlap * frequency,
        transmitter_half_width=_BOX_HEIGHT / 5.0,
        receiver_half_width=_BOX_HEIGHT / 5.0,
        boundary_thickness=_BOX_HEIGHT / 8.0,
        listening_depth=5.0 * radius,
        slowest=0.3 * radius * cut_off,
        regime=scene.regime,
    )
    return replace(Experiment(packing, sand=sand, wave=wave), frequencies=((0.0, 100.0), (frequency, frequency)))


def _pressed_stiffness(packing: Packing, radius: float, sand: Sand) -> float:
    """Normal stiffness, N/m, of a contact of mean overlap between disks of a radius (m), Hertz."""
    coefficient = float(sand.hertz_coefficient(np.array(radius), np.array(radius)))
    return float(1.5 * coefficient * np.sqrt(packing.report.mean_overlap))
