"""Discrete elements: packings, contact laws, cement, waves; knows nothing of campaigns and databases.

For scenes of your own: build a `Scene` from arrays, `start` it, `advance` it, and read positions, `contact_forces` and
`energies`; that is what this package exports. docs/scenes.md explains it with an example.

The rooms: ``kernels`` holds the compiled loop and the contact laws, ``engine`` makes scenes, advances and reads their
states, ``sample`` makes packings and cements them, ``wave`` sends a pulse through a sample and picks its arrival.
"""

from calcidem.dem.engine.material import Cement, Sand
from calcidem.dem.engine.readout import (
    ContactForces,
    Energies,
    contact_forces,
    energies,
    net_forces,
    unbalanced_ratio,
    wall_reactions,
)
from calcidem.dem.engine.scene import Bonds, Preload, Scene, Wall
from calcidem.dem.engine.state import State, advance, choose_features, start

__all__ = [
    "Bonds",
    "Cement",
    "ContactForces",
    "Energies",
    "Preload",
    "Sand",
    "Scene",
    "State",
    "Wall",
    "advance",
    "choose_features",
    "contact_forces",
    "energies",
    "net_forces",
    "start",
    "unbalanced_ratio",
    "wall_reactions",
]
