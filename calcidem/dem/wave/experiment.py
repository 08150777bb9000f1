"""Settings common to all samples: packing, materials, cement, wave and picking."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar, TypeVarTuple

import numpy as np

from calcidem.dem.engine.fields import require
from calcidem.dem.engine.material import Cement, Sand
from calcidem.dem.engine.portable import interpolate
from calcidem.dem.engine.scene import Installation, Scene
from calcidem.dem.sample.cement import CementOrdering, CementRule, draw_cement
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.pulse import excitation_frequency
from calcidem.dem.wave.reading import PickRule
from calcidem.dem.wave.rule import WaveRule
from calcidem.dem.wave.scene import Domain, domain_of, driven_disks, listening_disks, station_disks, wave_scene
from calcidem.dem.wave.strip_wave import clamp_of_strip

WAVELENGTHS = 2.5
"""Path over wavelength: with fewer wavelengths the near field disturbs, with many more little propagates."""

_Found = TypeVar("_Found")
_Arguments = TypeVarTuple("_Arguments")


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
    """See `scene.Bonds`."""
    is_checked: bool = True
    """Measure the numerical error of each content, and choose law and time step by it (`check.check_content`)."""
    frequencies: tuple[tuple[float, ...], tuple[float, ...]] | Callable[["Experiment", float], float] | None = None
    """(contents in percent, frequencies in Hz), interpolated linearly; None takes Table 2 of the paper. Or a function
    of an experiment and a content, percent, that returns the frequency in Hz and is called once for each content.
    """
    gpu: bool = False
    """Propagate waves on a GPU, with the same bits (`calcidem.dem.engine.gpu`)."""
    _kept: dict[tuple[Callable[..., Any], tuple[Any, ...]], Any] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        """Refuse invalid factors, and settings that the linear regime excludes."""
        require(self.stiffness_factor > 0.0, "stiffness_factor", self.stiffness_factor, "give a positive factor")
        require(
            self.installation == "preserve" or self.wave.law != "linear",
            "installation",
            self.installation,
            'changes the contact forces, which are fixed with law = "linear"; choose "auto" or "finite"',
        )

    def frequency(self, content: float) -> float:
        """Excitation frequency at a content (percent), Hz."""
        if self.frequencies is None:
            return excitation_frequency(content)
        if callable(self.frequencies):
            return self.once(self.frequencies, content)
        return interpolate(content, *self.frequencies)

    @property
    def clamp(self) -> float:
        """K of the strip between the damped layers, 1/m, see `strip_wave`."""
        return clamp_of_strip(self.packing.height - 2.0 * self.wave.boundary_thickness)

    def with_wave(self, **changes: Any) -> "Experiment":  # noqa: ANN401 - fields of several types
        """The experiment with changed fields of its `WaveRule`; the same one for the same fields."""
        return self.once(_with_rule, replace(self.wave, **changes))

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


def _with_rule(experiment: Experiment, wave: WaveRule) -> Experiment:
    return replace(experiment, wave=wave)


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
