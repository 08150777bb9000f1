"""The experiment of a stored campaign, rebuilt from the configuration in its database."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from calcidem.app.config.schema import FORMER_KEYS
from calcidem.dem.engine.material import Cement, Sand
from calcidem.dem.sample.cement import CementRule
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.arrival import PickRule
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.propagation import WaveRule
from calcidem.storage.errors import StoreError

T = TypeVar("T")


def experiment_of(physics: Mapping[str, Any], packing: Packing) -> Experiment:
    """Return what the cells of a campaign share.

    Parameters
    ----------
    physics
        Configuration as the database has it: `calcidem.app.config.schema.Configuration.physics`.
    packing
        The packing of the cells.

    Raises
    ------
    StoreError
        If a section is missing.
    ValueError
        If a section holds what this calcidem refuses.
    """
    sections = ("root_seed", "sand", "cement", "pattern", "wave", "pick")
    missing = [name for name in sections if name not in physics]
    if missing:
        raise StoreError(
            f"The stored configuration lacks {', '.join(missing)}: its cells can't be computed again.",
            "Only campaigns that 'calcidem run' made have a complete one.",
        )
    table = physics["wave"]["frequency"]
    return Experiment(
        packing=packing,
        sand=part(Sand, physics["sand"]),
        cement=part(Cement, physics["cement"]),
        cement_rule=part(CementRule, physics["pattern"]),
        wave=part(WaveRule, physics["wave"]),
        pick=part(PickRule, physics["pick"]),
        root_seed=physics["root_seed"],
        stiffness_factor=physics["sand"]["wave_stiffness_factor"],
        installation=physics["cement"]["installation"],
        method=physics["pick"]["method"],
        signal=physics["pick"]["signal"],
        least_quality=physics["pick"]["least_quality"],
        frequencies=(tuple(table["content"]), tuple(table["frequency"])),
    )


def part(kind: type[T], section: Mapping[str, Any]) -> T:
    """Return the dataclass whose fields are among the keys of a section."""
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]  # every caller's kind is a dataclass
    keys = {name: key for key, name in FORMER_KEYS.items()}
    values = {name: section[keys.get(name, name)] for name in names if keys.get(name, name) in section}
    return kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()})
