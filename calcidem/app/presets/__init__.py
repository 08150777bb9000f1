"""Example configurations."""

from importlib.resources import files


def preset_text(name: str) -> str:
    """Text of an example configuration: ``quick`` or ``paper``."""
    return files(__name__).joinpath(f"{name}.toml").read_text(encoding="utf-8")
