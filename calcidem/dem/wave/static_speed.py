"""Speed of long shear waves in a cemented sample, from its static stiffness: what a velocity can be compared with."""

import numpy as np

from calcidem.dem.engine.scene import Bonds
from calcidem.dem.engine.state import start
from calcidem.dem.engine.statics import shear_modulus
from calcidem.dem.kernels.layout import Flags
from calcidem.dem.sample.settling import settle
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.scene import wave_scene


def static_speed(experiment: Experiment, bonded: Flags) -> float:
    """Speed sqrt(G / rho) of shear waves much longer than a disk, m/s.

    Parameters
    ----------
    experiment
        What the sample shares with others; its packing touches all four walls.
    bonded
        (C,) True for each of the packing's pairs that is cemented.

    Raises
    ------
    ValueError
        See `calcidem.dem.engine.statics.shear_modulus`, which gives G between the disks that touch the walls.
    SettlingError
        If new bonds change the forces of the sample and it does not come to rest.

    Notes
    -----
    rho is the density of the grains times the share of the area that they fill. The wave itself is slower: local
    damping takes a part of each force that moves a disk. docs/velocity.md compares the two.
    """
    packing, sand = experiment.stiffen()
    rule, keeps_forces = experiment.wave, experiment.installation == "preserve"
    bonds = Bonds(packing.pairs[bonded], experiment.cement, installation=experiment.installation)
    scene = wave_scene(packing, sand, rule, bonds if np.any(bonded) else None)
    state = start(scene, regime="linear" if keeps_forces else rule.regime, preload=packing.preload)
    if np.any(bonded) and not keeps_forces:
        state = settle(state, rule.unbalanced_force_ratio, rule.most_settling_steps)
    x, y, radius = packing.x, packing.y, packing.radius
    distances = (x, packing.width - x, y, packing.height - y)
    modulus = shear_modulus(state, [np.flatnonzero(distance < radius) for distance in distances])
    return float(np.sqrt(modulus / (sand.density * (1.0 - packing.report.porosity))))
