"""Example configurations, and the packings they are computed on."""

from importlib.resources import files
from importlib.resources.abc import Traversable

PRESETS = ("quick", "paper", "paper-small-pulse", "paper-literal", "paper-locked")
"""Names of the example configurations that come with calcidem."""


def preset_text(name: str) -> str:
    """Text of one of the example configurations in `PRESETS`; `ValueError` for another name."""
    if name not in PRESETS:
        raise ValueError(f"name = '{name}': there is no such preset; give one of {', '.join(PRESETS)}")
    return files(__name__).joinpath(f"{name}.toml").read_text(encoding="utf-8")


def preset_packing(packing_hash: str) -> bytes | None:
    """Archive of the packing with this `Configuration.packing_hash`, None if no example has it."""
    file = files(__name__).joinpath("packings", f"{packing_hash[:32]}.npz")
    return file.read_bytes() if file.is_file() else None


def preset_packings() -> list[Traversable]:
    """The files with the packings of all examples."""
    return list(files(__name__).joinpath("packings").iterdir())
