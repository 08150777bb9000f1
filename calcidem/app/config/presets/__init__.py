"""Example configurations, and their packings."""

from importlib.resources import files
from importlib.resources.abc import Traversable
from shlex import quote

PRESETS = ("quick", "paper", "paper-as-printed")
"""Names of the example configurations in calcidem."""


def preset_text(name: str) -> str:
    """Text of an example configuration in `PRESETS`; `ValueError` for another name."""
    if name not in PRESETS:
        raise ValueError(f"name = '{name}': there is no such preset; give one of {', '.join(PRESETS)}")
    return files(__name__).joinpath(f"{name}.toml").read_text(encoding="utf-8")


def slurm_job(configuration: str) -> str:
    """Text of a Slurm job, also of an array, for the file of a configuration."""
    text = files(__name__).joinpath("slurm.sbatch").read_text(encoding="utf-8")
    return text.replace("default=calcidem.toml", f"default={quote(configuration)}")


def preset_packings() -> dict[str, Traversable]:
    """Files of the packings of all examples, by the first 32 digits of their `Configuration.packing_hash`."""
    return {file.name.removesuffix(".npz"): file for file in files(__name__).joinpath("packings").iterdir()}
