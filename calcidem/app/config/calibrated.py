"""Detection of calibrated values of example configurations that are used for another material."""

import tomllib
from typing import Any

from calcidem.app.config.presets import PRESETS, preset_text
from calcidem.app.config.reader import read_configuration
from calcidem.app.config.reference import written
from calcidem.app.config.schema import Configuration

_MATERIAL = ("sand.shear_modulus", "sand.poisson_ratio", "cement.bond_modulus", "cement.linear_modulus")
"""Keys of the materials to which values are calibrated, as in `Configuration.physics`."""

_CALIBRATED = (
    "sand.wave_stiffness_factor",
    "pattern.p_share",
    "pattern.p_patch_diameter",
    "pattern.cluster_area",
)
"""Keys that the comments of the examples call calibrated."""


def calibration_note(configuration: Configuration) -> str:
    """Message about values calibrated for another material, with a remedy; empty without any."""
    for preset in PRESETS:
        fitted, default = read_configuration(tomllib.loads(preset_text(preset))), Configuration()
        kept = [
            name for name in _CALIBRATED if _value(configuration, name) == _value(fitted, name) != _value(default, name)
        ]
        changed = [name for name in _MATERIAL if _value(configuration, name) != _value(fitted, name)]
        if kept and changed:
            values = ", ".join(f"{name} = {written(_value(fitted, name))}" for name in kept)
            former = ", ".join(f"{name} = {written(_value(fitted, name))}" for name in changed)
            present = ", ".join(written(_value(configuration, name)) for name in changed)
            return (
                f"Note: {values}: calibrated with {former} (preset {preset}), but here that is {present}. Leave the "
                "calibrated values out, or fit them to measurements of this material with 'calcidem calibrate'."
            )
    return ""


def _value(configuration: Configuration, name: str) -> Any:  # noqa: ANN401 - numbers and words
    """Value of ``section.key``; None where a later key has its default, which campaigns do not store."""
    section, key = name.split(".")
    return configuration.physics[section].get(key)
