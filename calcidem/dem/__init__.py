"""Discrete elements: packings, contact laws, cement, waves; independent of campaigns and databases.

For scenes of your own: build a `Scene` from arrays, `start` it, `advance` it, and read positions, `contact_forces` and
`energies`; that is what this package exports. docs/scenes.md explains it with an example.

Folders: ``kernels`` has the compiled loop and the contact laws, ``engine`` makes scenes, advances and reads their
states, ``sample`` makes packings and cements them, ``wave`` transmits a pulse through a sample and reads its velocity.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calcidem.dem.engine.leapfrog import State as State
    from calcidem.dem.engine.readout import ContactForces as ContactForces
    from calcidem.dem.engine.readout import Energies as Energies
    from calcidem.dem.engine.readout import WallForces as WallForces
    from calcidem.dem.engine.readout import contact_forces as contact_forces
    from calcidem.dem.engine.readout import energies as energies
    from calcidem.dem.engine.readout import net_forces as net_forces
    from calcidem.dem.engine.readout import overlaps as overlaps
    from calcidem.dem.engine.readout import unbalanced_ratio as unbalanced_ratio
    from calcidem.dem.engine.readout import wall_contacts as wall_contacts
    from calcidem.dem.engine.readout import wall_overlaps as wall_overlaps
    from calcidem.dem.engine.readout import wall_reactions as wall_reactions
    from calcidem.dem.engine.scene import Bonds as Bonds
    from calcidem.dem.engine.scene import Cement as Cement
    from calcidem.dem.engine.scene import Preload as Preload
    from calcidem.dem.engine.scene import Sand as Sand
    from calcidem.dem.engine.scene import Scene as Scene
    from calcidem.dem.engine.scene import Wall as Wall
    from calcidem.dem.engine.stability import critical_time_step as critical_time_step
    from calcidem.dem.engine.state import UnstableRunError as UnstableRunError
    from calcidem.dem.engine.state import advance as advance
    from calcidem.dem.engine.state import choose_features as choose_features
    from calcidem.dem.engine.state import start as start

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

__all__ = [*_MODULES]  # noqa: PLE0604 - names of a table


def __getattr__(name: str) -> object:
    """Import on first use, so that users of rules and packings do not load the engine."""
    if name not in _MODULES:
        raise AttributeError(f"module 'calcidem.dem' has no attribute '{name}'")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """All public names, imported or not."""
    return sorted({*(name for name in globals() if name.startswith("_")), *__all__})
