"""Everything that samples have in common: packing, materials, cement, wave and picking."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from calcidem.dem.engine.fields import require
from calcidem.dem.engine.material import Cement, Sand
from calcidem.dem.engine.portable import interpolate
from calcidem.dem.engine.scene import Installation
from calcidem.dem.sample.cement import CementOrdering, CementRule, draw_cement
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.domain import listening_disks, station_disks
from calcidem.dem.wave.pick import PickRule
from calcidem.dem.wave.pulse import excitation_frequency
from calcidem.dem.wave.rule import WaveRule

Method = Literal["peak", "first_arrival", "cross_correlation"]
ReceivedSignal = Literal["velocity", "force"]


@dataclass(frozen=True, slots=True, eq=False)
class Experiment:
    """Everything that samples of many seeds and contents have in common; equal to itself alone.

    Attributes
    ----------
    packing, sand, cement, cement_rule, wave, pick
        See their classes.
    root_seed
        Root of all random numbers.
    stiffness_factor
        Multiplies the grains' shear modulus, and with it all contact forces and the confining stress, in the wave
        stage. 1 is the packing as it was made; anything else is a calibration.
    installation
        See `scene.Bonds`.
    method
        Reading that becomes Vs.
    least_quality
        Readings of lower quality are not trusted.
    early_stop
        End a record as soon as its reading is settled, or what still moves cannot become one; it does not change the
        reading.
    signal
        Received signal that is read.
    frequencies
        (contents in percent, frequencies in Hz), interpolate between; None takes Table 2 of the paper.
    """

    packing: Packing
    sand: Sand = field(default_factory=Sand)
    cement: Cement = field(default_factory=Cement)
    cement_rule: CementRule = field(default_factory=CementRule)
    wave: WaveRule = field(default_factory=WaveRule)
    pick: PickRule = field(default_factory=PickRule)
    root_seed: int = 0
    stiffness_factor: float = 1.0
    installation: Installation = "preserve"
    method: Method = "peak"
    signal: ReceivedSignal = "velocity"
    least_quality: float = 0.1
    early_stop: bool = True
    frequencies: tuple[tuple[float, ...], tuple[float, ...]] | None = None

    def __post_init__(self) -> None:
        """Refuse what the linear regime cannot do and factors without meaning."""
        require(self.stiffness_factor > 0.0, "stiffness_factor", self.stiffness_factor, "give a positive factor")
        require(
            self.installation == "preserve" or self.wave.regime != "linear",
            "installation",
            self.installation,
            'changes the contact forces, which regime = "linear" takes as they are; choose "small" or "finite"',
        )

    def frequency(self, content: float) -> float:
        """Excitation frequency at a content (percent), Hz."""
        if self.frequencies is None:
            return excitation_frequency(content)
        return interpolate(content, *self.frequencies)

    @property
    def distance(self) -> float:
        """Way of the wave, m: from the transmitter to the mean place of the disks that are listened to, or to the wall.

        The received velocity is the plain mean of those disks, so a wave passes its middle at their mean x.
        """
        return self.packing.width if self.signal == "force" else _mean_place_of_listeners(self)

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

    @property
    def stations(self) -> tuple[float, ...]:
        """Where the stations are, as parts of the way."""
        return _places_of_stations(self)


@lru_cache(maxsize=8)
def _places_of_stations(experiment: Experiment) -> tuple[float, ...]:
    """Mean x of the disks of each station, over the distance."""
    packing, way = experiment.packing, _mean_place_of_listeners(experiment)
    return tuple(float(np.mean(packing.x[disks])) / way for disks in station_disks(packing, experiment.wave))


@lru_cache(maxsize=8)  # it is asked for at each look at each record
def _mean_place_of_listeners(experiment: Experiment) -> float:
    """Mean x of the disks that are listened to, m."""
    return float(np.mean(experiment.packing.x[listening_disks(experiment.packing, experiment.wave)]))
