"""Small extreme scenes: a lattice of disks in a box with a parameter for each possible fault, and small packings.

The packings are close to losing rigidity: under little stress (nearly unjammed), or with barely enough contacts. A
packing of disks is isostatic at three contacts per disk with friction, at four without. Friction during packing selects
which limit is approached.
"""

from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any, Self

import numpy as np

from calcidem.app.studies.stability import Judgement, capacity, draw_latin, judge_scene, pressed_stiffness
from calcidem.dem.engine.assembly import near_pairs
from calcidem.dem.engine.scene import Cement, Law, Preload, Sand, Scene
from calcidem.dem.sample.cement import CementRule
from calcidem.dem.sample.compaction import make_packing
from calcidem.dem.sample.packing import Packing, PackingReport, PackingRule
from calcidem.dem.wave.experiment import Experiment, WaveRule, cutoff_frequency, lane_bonds, wave_scene
from calcidem.dem.wave.reading import PickRule

_RADIUS = 1.25e-3  # radius of the largest disks, m
_DISKS_ACROSS, _DISKS_UP = 6, 10
_SMALLEST_RATIO = 2.5  # radius ratio above which the small disk fits into the pore between four neighbours
_SMALL_DISKS = 0.2  # share of pores with a small disk
LAWS: tuple[Law, ...] = ("auto", "linear", "finite")
BOXES = ("extreme", "plausible")
"""Ranges for drawing scenes, see `_SceneQuantity`."""
_PICK = PickRule(largest_error=1.0)
"""The boxes are short compared with the wavelength; only the dependence of the reading on the step is judged."""
_FLOATER = 0.12  # radius of a floating disk over that of its neighbours; three in a row fit into a pore

_STRESSES = (1.0e2, 5.0e3, 5.0e5)  # stresses on small packings, Pa
_FRICTIONS = (0.0, 0.2, 1.0)  # coefficients during packing
_CONTENTS = (0.0, 2.0)  # contents of small packings, percent
_BOX_WIDTH, _BOX_HEIGHT = 0.025, 0.04  # m
_UNBALANCED_FORCE_RATIO = 1.0e-7  # packings with so few contacts come to rest slowly
_STROKE = 0.1  # stroke of the pulse over the mean overlap
_SLOW_PULSE = 0.1  # frequency of the pulse over the cut-off of the pressed contacts
_CEMENTED_FREQUENCY = 2.0e4  # Hz: bonds carry the wave at any stress


@dataclass(frozen=True, slots=True)
class Extreme:
    """One scene of the map."""

    step_fraction: float = 0.8
    """Step over its predicted limit; values above 1 must be refused."""
    contrast: float = 1.0e3
    """Stiffness of bonds over that of the pressed contacts."""
    damping: float = 0.3
    """Local damping factor."""
    amplitude: float = 1.0e-4
    """v0 of the pulse, m/s."""
    frequency: float = 0.2
    """Frequency over the cut-off of a chain of such contacts."""
    size_ratio: float = 1.2
    """Largest over smallest radius; below 2.5 all disks are equal."""
    content: float = 0.3
    """Used part of the contacts' capacity for cement; 1 bonds all contacts."""
    confinement: float = 1.0e5
    """Confining stress, Pa."""
    missing: float = 0.0
    """Share of removed disks: towards the loss of rigidity, with rattlers. None below 0."""
    strength: float = 1.0e6
    """Strength of bonds over the stress of the pulse in them."""
    floating: int = 0
    """Number of tiny disks in the central pore, which touch only each other."""
    law: Law = "auto"
    """See `WaveRule`."""
    seed: int = 1
    """Seed of disorder and cement."""

    def experiment(self) -> tuple[Experiment, float]:
        """Experiment for `measurement.measure`, and its content: the part of the capacity of its contacts, percent.

        `ValueError` if the scene is refused.
        """
        sand = Sand()
        packing = _lattice(self, sand)
        stiffness = pressed_stiffness(_RADIUS, packing.report.mean_overlap, sand)
        modulus = self.contrast * stiffness
        stress = max(self.amplitude * np.sqrt(sand.density * modulus), 1e-3)
        cement = Cement(
            bond_modulus=modulus,
            tensile_strength=self.strength * stress,
            cohesion=self.strength * stress,
        )
        width = 0.5 * float(packing.radius.min())
        cut_off = cutoff_frequency(stiffness, sand.density * np.pi * _RADIUS**2)
        frequency = self.frequency * cut_off
        wave = WaveRule(
            amplitude=self.amplitude,
            damping=self.damping,
            law=self.law,
            step_fraction=self.step_fraction,
            transmitter_half_width=4.0 * _RADIUS,
            receiver_half_width=6.0 * _RADIUS,
            boundary_thickness=2.0 * _RADIUS,
            listening_depth=0.29 * packing.width,
            slowest=2.0 * _RADIUS * cut_off,
        )
        experiment = Experiment(
            packing,
            sand=sand,
            cement=cement,
            cement_rule=CementRule(p_diameter=width, c_diameter=width, threshold=100.0),
            wave=wave,
            pick=_PICK,
            root_seed=self.seed,
            frequencies=((0.0, 100.0), (frequency, frequency)),
        )
        return experiment, self.content * capacity(experiment, self.seed)

    def judge(self) -> Judgement:
        """Run the scene and compare it with a finer one."""
        return judge_scene(self.experiment, self.seed)

    def at_rest(self, damping: float) -> tuple[Scene, Packing]:
        """Cemented scene without a pulse, with one damping factor for all disks, and its packing."""
        experiment, content = self.experiment()
        packing = experiment.packing
        bonded = experiment.ordering(self.seed).at(content).bonded
        bonds = lane_bonds(packing, experiment.cement, [bonded], 1, "preserve")
        return replace(wave_scene(packing, experiment.sand, experiment.wave, bonds), damping=damping), packing

    @classmethod
    def along_quantities(cls) -> dict[str, list[Self]]:
        """Scenes along each quantity, with all laws."""
        found = {}
        for name, quantity in QUANTITIES.items():
            base: dict[str, Any] = asdict(quantity.base)
            values = ({name: value, "law": each} for value in quantity.walk for each in LAWS)
            found[name] = [cls(**base | changed) for changed in values]
        return found

    @classmethod
    def draw(cls, count: int, seed: int, box: str = "extreme") -> tuple[Self, ...]:
        """Latin hypercube over all quantities of one of the `BOXES`, with alternating laws."""
        ends = {name: getattr(quantity, box) for name, quantity in QUANTITIES.items()}
        ranges = {name: both for name, both in ends.items() if both is not None}
        powers = {name for name, quantity in QUANTITIES.items() if quantity.powers}
        return tuple(
            cls(**values, law=LAWS[number % len(LAWS)], seed=number)
            for number, values in enumerate(draw_latin(ranges, powers, count, seed))
        )


@dataclass(frozen=True, slots=True)
class _SceneQuantity:
    """Properties of a field of `Extreme` for the maps."""

    label: str
    """Label of the axis of a map."""
    walk: tuple[float, ...]
    """Values of a map; all other numbers are those of ``base``."""
    extreme: tuple[float, float] | None = None
    plausible: tuple[float, float] | None = None
    """Range of random draws, over all scenes and over scenes that mostly have a velocity to check; without a range the
    field is not drawn.
    """
    powers: bool = False
    """True if the ranges are powers of ten."""
    base: Extreme = Extreme()


QUANTITIES = {
    "step_fraction": _SceneQuantity(
        "time step / its predicted limit", (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2), (0.5, 1.1), (0.5, 1.0)
    ),
    "contrast": _SceneQuantity(
        "stiffness of bonds / of contacts", (1.0, 10.0, 1e2, 1e3, 1e4, 1e5, 1e6), (0.0, 6.0), (0.0, 4.5), powers=True
    ),
    "damping": _SceneQuantity("local damping factor", (0.0, 0.1, 0.3, 0.5, 0.6, 0.7, 0.9, 1.0), (0.0, 1.0), (0.0, 0.5)),
    "amplitude": _SceneQuantity(
        "velocity of the pulse $v_0$ (m/s)",
        (1e-9, 1e-7, 1e-5, 1e-3, 1e-1, 1.0, 10.0),
        (-9.0, 1.0),
        (-7.5, -4.5),
        powers=True,
    ),
    "frequency": _SceneQuantity(
        "frequency / cut-off of the contacts",
        (0.03, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0),
        (-1.0, 0.0),
        (-0.75, -0.2),
        powers=True,
    ),
    "size_ratio": _SceneQuantity(
        "largest / smallest radius", (1.0, 3.0, 5.0, 10.0, 20.0), (-0.5, 1.3), (-0.5, 0.5), powers=True
    ),
    "content": _SceneQuantity(
        "share of the capacity for cement", (0.0, 0.1, 0.3, 0.6, 0.9, 1.0), (0.0, 1.0), (0.0, 0.5)
    ),
    "confinement": _SceneQuantity(
        "confining stress (Pa)", (1.0, 1e2, 1e4, 1e6, 1e8), (0.0, 8.0), (3.3, 5.3), powers=True
    ),
    "missing": _SceneQuantity(
        "share of the disks taken away", (0.0, 0.02, 0.05, 0.1, 0.2, 0.3), (-0.6, 0.3), (-0.6, 0.01)
    ),
    "strength": _SceneQuantity(
        "strength of bonds / stress of the pulse",
        (1e-2, 0.1, 0.3, 0.5, 1.0, 3.0, 1e2, 1e4),
        (-2.0, 6.0),
        (1.0, 6.0),
        powers=True,
        base=Extreme(amplitude=1e-3),  # a pulse that can break bonds
    ),
    "floating": _SceneQuantity("number of floating disks", (0, 1, 2, 3), base=Extreme(content=1.0, contrast=1.0)),
}


@dataclass(frozen=True, slots=True)
class Packed:
    """Sample of a small packing."""

    stress: float
    """Stress on the lid, Pa."""
    friction: float
    """Friction between the disks during packing."""
    content: float
    """Percent."""
    law: Law
    """See `WaveRule`."""
    seed: int = 1
    """Seed of packing and cement."""

    @classmethod
    def samples(cls) -> dict[str, list[Self]]:
        """Samples of each packing, from nearly unjammed to well compressed, bare and cemented, with all laws."""
        return {
            f"packing under {stress:g} Pa, friction {friction:g}": [
                cls(stress, friction, content, law) for content, law in product(_CONTENTS, LAWS)
            ]
            for stress, friction in product(_STRESSES, _FRICTIONS)
        }

    def experiment(self) -> tuple[Experiment, float]:
        """Experiment and content; its pulse is much smaller than the overlaps and far below the contacts' cut-off."""
        sand, packing = Sand(), small_packing(self.stress, self.friction, self.seed)
        radius = float(np.mean(packing.radius))
        cut_off = cutoff_frequency(
            pressed_stiffness(radius, packing.report.mean_overlap, sand), sand.density * np.pi * radius**2
        )
        frequency = _CEMENTED_FREQUENCY if self.content > 0.0 else _SLOW_PULSE * cut_off
        wave = WaveRule(
            amplitude=_STROKE * packing.report.mean_overlap * frequency,
            transmitter_half_width=_BOX_HEIGHT / 5.0,
            receiver_half_width=_BOX_HEIGHT / 5.0,
            boundary_thickness=_BOX_HEIGHT / 8.0,
            listening_depth=5.0 * radius,
            slowest=0.3 * radius * cut_off,
            law=self.law,
        )
        experiment = Experiment(packing, sand=sand, wave=wave, frequencies=((0.0, 100.0), (frequency, frequency)))
        return experiment, self.content

    def judge(self) -> Judgement:
        """Run the sample and compare it with a finer one."""
        return judge_scene(self.experiment, self.seed)


def _lattice(extreme: Extreme, sand: Sand) -> Packing:
    """Square lattice of disks in equilibrium under the confining stress, with random small disks and gaps."""
    generator = np.random.default_rng(extreme.seed)
    # Hertz: the force is stress times diameter.
    coefficient = float(sand.hertz_coefficient(np.array(_RADIUS), np.array(_RADIUS)))
    overlap = float((extreme.confinement * 2.0 * _RADIUS / coefficient) ** (2.0 / 3.0))
    spacing = 2.0 * _RADIUS - overlap
    # A wall contact has twice the R~ of two disks, so the same force gives a smaller overlap.
    to_wall = _RADIUS - overlap / 2.0 ** (1.0 / 3.0)
    column, row = np.meshgrid(np.arange(_DISKS_ACROSS), np.arange(_DISKS_UP))
    kept = generator.random(column.size) >= extreme.missing
    x, y = (to_wall + index.ravel()[kept] * spacing for index in (column, row))
    radius = np.full(len(x), _RADIUS)
    small = _RADIUS / extreme.size_ratio
    if extreme.size_ratio > _SMALLEST_RATIO:
        # They lie in the pores and touch one disk so lightly that the balance does not change.
        hosts = np.flatnonzero(generator.random(len(x)) < _SMALL_DISKS)
        apart = (_RADIUS + small - 1e-3 * min(overlap, small)) * np.sqrt(0.5)
        x, y = np.append(x, x[hosts] + apart), np.append(y, y[hosts] + apart)
        radius = np.append(radius, np.full(len(hosts), small))
    inside = (x < spacing * (_DISKS_ACROSS - 1) + 1.1 * to_wall) & (y < spacing * (_DISKS_UP - 1) + 1.1 * to_wall)
    # Floating disks form a row in the central pore and overlap only by rounding: they touch without force.
    count, own = extreme.floating, _FLOATER * _RADIUS
    along = 2.0 * own * (1.0 - 1e-12) * (np.arange(count) - 0.5 * (count - 1))
    middle = to_wall + spacing * np.array([_DISKS_ACROSS // 2 - 0.5, _DISKS_UP // 2 - 0.5])
    x, y = np.append(x[inside], middle[0] + along), np.append(y[inside], np.full(count, middle[1]))
    radius = np.append(radius[inside], np.full(count, own))
    pairs = near_pairs(np.column_stack([x, y]), radius, 0.0)
    return Packing(
        x,
        y,
        radius,
        width=spacing * (_DISKS_ACROSS - 1) + 2.0 * to_wall,
        height=spacing * (_DISKS_UP - 1) + 2.0 * to_wall,
        preload=Preload(pairs, np.zeros(len(pairs))),
        report=PackingReport(
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
        ),
    )


@lru_cache(maxsize=1)
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
