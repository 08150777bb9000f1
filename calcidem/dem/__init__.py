"""Discrete elements: packings, contact laws, cement, waves; independent of campaigns and databases.

For scenes of your own: build a `Scene` from arrays, `start` it, `advance` it, and read positions, `contact_forces` and
`energies`; that is what this package exports. docs/scenes.md explains it with an example.

Folders: ``kernels`` has the compiled loop and the contact laws, ``engine`` makes scenes, advances and reads their
states, ``sample`` makes packings and cements them, ``wave`` transmits a pulse through a sample and reads its velocity.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calcidem.dem.engine.leapfrog import State
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
    from calcidem.dem.engine.scene import Bonds, Cement, Preload, Sand, Scene, Wall
    from calcidem.dem.engine.stability import critical_time_step
    from calcidem.dem.engine.state import UnstableRunError, advance, choose_features, start

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

_MODULES = {
    name: f"calcidem.dem.engine.{module}"
    for module, names in {
        "leapfrog": "State",
        "readout": "ContactForces Energies WallForces contact_forces energies net_forces overlaps unbalanced_ratio "
        "wall_contacts wall_overlaps wall_reactions",
        "scene": "Bonds Cement Preload Sand Scene Wall",
        "stability": "critical_time_step",
        "state": "UnstableRunError advance choose_features start",
    }.items()
    for name in names.split()
}


def __getattr__(name: str) -> object:
    """Import on first use, so that users of rules and packings do not load the engine."""
    if name not in _MODULES:
        raise AttributeError(f"module 'calcidem.dem' has no attribute '{name}'")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """All public names, imported or not."""
    return sorted({*(name for name in globals() if name.startswith("_")), *__all__})
