"""Example configurations, and the packings they are computed on."""

from importlib.resources import files


def preset_text(name: str) -> str:
    """Text of an example configuration: ``quick``, ``paper``, ``paper-literal`` or ``paper-locked``."""
    return files(__name__).joinpath(f"{name}.toml").read_text(encoding="utf-8")


def preset_packing(packing_hash: str) -> bytes | None:
    """Archive of the packing with this `Configuration.packing_hash`, None if no example has it."""
    file = files(__name__).joinpath("packings", f"{packing_hash[:32]}.npz")
    return file.read_bytes() if file.is_file() else None
