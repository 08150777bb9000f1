"""Real small packings at the edge of rigidity: hardly pressed (nearly unjammed), and with hardly enough contacts.

A packing of disks with friction is isostatic at three contacts a disk, one without friction at four; friction while
packing decides which of the two is come near.
"""

from dataclasses import dataclass, replace

import numpy as np

from calcidem.app.studies.stability.scenes import pressed_stiffness
from calcidem.dem.engine.material import Sand
from calcidem.dem.engine.scene import Regime
from calcidem.dem.sample.packing import Packing, PackingRule, make_packing
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.pulse import cutoff_frequency
from calcidem.dem.wave.rule import WaveRule

STRESSES = (1.0e2, 5.0e3, 5.0e5)  # Pa
FRICTIONS = (0.0, 0.2, 1.0)  # while packing
CONTENTS = (0.0, 2.0)  # percent
WIDTH, HEIGHT = 0.025, 0.04  # m
BALANCE = 1.0e-7  # unbalanced-force ratio; so few contacts take long to come to rest
STROKE = 0.1  # of the pulse over the mean overlap
SLOW = 0.1  # frequency of the pulse over the cut-off of the pressed contacts
CEMENTED = 2.0e4  # frequency for cemented samples, Hz: bonds carry the wave, whatever presses the contacts


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


def small_packing(stress: float, friction: float, seed: int = 1) -> Packing:
    """About 150 disks at rest under a stress, Pa."""
    rule = PackingRule(
        width=WIDTH, height=HEIGHT, stress=stress, friction_preparation=friction, unbalanced_force_ratio=BALANCE
    )
    return make_packing(rule, Sand(), np.random.default_rng(seed))


def packed_experiment(packing: Packing, scene: Packed) -> Experiment:
    """Experiment with a pulse that is small against the overlaps and slow against the cut-off of the contacts."""
    sand = Sand()
    radius = float(np.mean(packing.radius))
    cut_off = cutoff_frequency(pressed_stiffness(packing, radius, sand), sand.density * np.pi * radius**2)
    frequency = CEMENTED if scene.content > 0.0 else SLOW * cut_off
    wave = WaveRule(
        amplitude=STROKE * packing.report.mean_overlap * frequency,
        transmitter_half_width=HEIGHT / 5.0,
        receiver_half_width=HEIGHT / 5.0,
        boundary_thickness=HEIGHT / 8.0,
        listening_depth=5.0 * radius,
        slowest=0.3 * radius * cut_off,
        regime=scene.regime,
    )
    return replace(Experiment(packing, sand=sand, wave=wave), frequencies=((0.0, 100.0), (frequency, frequency)))
