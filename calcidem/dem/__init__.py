"""Discrete elements: packings, contact laws, cement, waves; knows nothing of campaigns and databases.

For scenes of your own: build a `Scene` from arrays, `start` it, `advance` it, and read positions, `contact_forces` and
`energies`; that is what this package exports. docs/scenes.md explains it with an example.

The rooms: ``kernels`` holds the compiled loop and the contact laws, ``engine`` makes scenes, advances and reads their
states, ``sample`` makes packings and cements them, ``wave`` sends a pulse through a sample and picks its arrival.
"""

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.material import Cement, Sand
from calcidem.dem.engine.readout import (
    ContactForces,
    Energies,
    WallForces,
    contact_forces,
    energies,
    net_forces,
    overlaps,
    unbalanced_ratio,
    wall_contacts,
    wall_overlaps,
    wall_reactions,
)
from calcidem.dem.engine.scene import Bonds, Preload, Scene, Wall
from calcidem.dem.engine.stability import critical_time_step
from calcidem.dem.engine.state import advance, choose_features, start
from calcidem.dem.engine.step_control import UnstableRunError

__all__ = [
    "Bonds",
    "Cement",
    "ContactForces",
    "Energies",
    "Preload",
    "Sand",
    "Scene",
    "State",
    "UnstableRunError",
    "Wall",
    "WallForces",
    "advance",
    "choose_features",
    "contact_forces",
    "critical_time_step",
    "energies",
    "net_forces",
    "overlaps",
    "start",
    "unbalanced_ratio",
    "wall_contacts",
    "wall_overlaps",
    "wall_reactions",
]
