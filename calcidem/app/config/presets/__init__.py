"""Example configurations, and their packings."""

from importlib.resources import files
from importlib.resources.abc import Traversable

PRESETS = ("quick", "paper", "paper-as-printed")
"""Names of the example configurations in calcidem."""


def preset_text(name: str) -> str:
    """Text of an example configuration in `PRESETS`; `ValueError` for another name."""
    if name not in PRESETS:
        raise ValueError(f"name = '{name}': there is no such preset; give one of {', '.join(PRESETS)}")
    return files(__name__).joinpath(f"{name}.toml").read_text(encoding="utf-8")


def preset_packings() -> dict[str, Traversable]:
    """Files of the packings of all examples, by the first 32 digits of their `Configuration.packing_hash`."""
    return {file.name.removesuffix(".npz"): file for file in files(__name__).joinpath("packings").iterdir()}
