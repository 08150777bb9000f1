"""Example configurations."""

from importlib.resources import files


def preset_text(name: str) -> str:
    """Text of an example configuration: ``quick``, ``paper``, ``paper-literal`` or ``paper-locked``."""
    return files(__name__).joinpath(f"{name}.toml").read_text(encoding="utf-8")
