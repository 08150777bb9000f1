"""The printed numbers of the study this project reproduces, as data.

"Sand Stiffness Variability Induced by Stochastic Distributions of Calcite Precipitates: A Monte Carlo-DEM
Study", Tables 1 to 4 and section 3.2.1. `published.toml` in this folder has them as printed;
docs/reproduction/published_check.py checks their consistency.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any

from calcidem.analysis.connectivity import ContactWeights
from calcidem.analysis.intervals import Interval


@dataclass(frozen=True, slots=True)
class PublishedVelocity:
    """One row of Table 3."""

    stage: str
    """Roman numeral of its stage."""
    mean: float
    standard_deviation: float
    """m/s."""
    skewness: float
    kurtosis: float
    """Moments (0 and 3 for a normal distribution)."""
    normal: bool
    """True if marked normal."""


@dataclass(frozen=True, slots=True)
class PublishedContent:
    """One calcite content of Tables 2 and 3."""

    content: float
    """Percent of sand mass."""
    frequency: float
    """Excitation frequency in Hz."""
    vs: PublishedVelocity | None
    """Its row of Table 3, if any."""


@dataclass(frozen=True, slots=True)
class PublishedStage:
    """A stage of section 3.2.1."""

    name: str
    """Roman numeral."""
    text_range: Interval
    """Bounds in the text, in percent."""
    rate: float
    """Growth rate in m/s per percent."""
    variance_range: Interval
    """Range of "variance" in the text, m/s."""


@dataclass(frozen=True, slots=True)
class PublishedLaw:
    """A column of Table 4: Vs = a C_d,n^b + c, with Vs, a and c in m/s.

    Attributes
    ----------
    a, c
        Parameters of the law.
    """

    name: str
    """Choice of the weights."""
    weights: ContactWeights
    """The contact weights."""
    connectivity_range: Interval
    """Range of C_d,n."""
    a: float
    table_b: float
    conclusions_b: float
    """Exponent printed in the table, and in the conclusions."""
    c: float


@dataclass(frozen=True, slots=True)
class PublishedStudy:
    """All printed numbers."""

    title: str
    """Title of the paper."""
    seeds: int
    samples: int
    """Number of random distributions of calcite, and of samples."""
    parameters: Mapping[str, float]
    """Table 1 in SI units; names as in `published.toml`."""
    contents: tuple[PublishedContent, ...]
    """Tables 2 and 3, ascending."""
    stages: tuple[PublishedStage, ...]
    """Section 3.2.1."""
    laws: tuple[PublishedLaw, ...]
    """Table 4."""

    @property
    def velocities(self) -> tuple[tuple[float, PublishedVelocity], ...]:
        """The rows of Table 3, each as (content in percent, row)."""
        return tuple((row.content, row.vs) for row in self.contents if row.vs is not None)


@cache
def published_study() -> PublishedStudy:
    """Read the printed numbers."""
    data = tomllib.loads(resources.files(__package__).joinpath("published.toml").read_text(encoding="utf-8"))
    return PublishedStudy(
        **data["source"],
        parameters=MappingProxyType(data["parameters"]),
        contents=tuple(
            PublishedContent(row["content"], row["frequency"], PublishedVelocity(**row["vs"]) if "vs" in row else None)
            for row in data["contents"]
        ),
        stages=tuple(PublishedStage(**_with_intervals(row)) for row in data["stages"]),
        laws=tuple(
            PublishedLaw(weights=ContactWeights(row.pop("hertz"), row.pop("bond")), **_with_intervals(row))
            for row in data["laws"]
        ),
    )


PUBLISHED_KEYS = {
    "packing.width": "box_width",
    "packing.height": "box_height",
    "packing.porosity": "porosity",
    "packing.stress": "confining_stress",
    "sand.shear_modulus": "sand_shear_modulus",
    "sand.poisson_ratio": "sand_poisson_ratio",
    "sand.density": "sand_density",
    "sand.friction": "friction",
    "cement.bond_modulus": "bond_effective_modulus",
    "cement.tensile_strength": "bond_tensile_strength",
    "cement.cohesion": "bond_cohesion",
    "pattern.calcite_density": "calcite_density",
    "pattern.cluster_diameter": "cluster_size",
    "wave.amplitude": "pulse_velocity",
    "wave.damping": "local_damping",
    "wave.band_friction": "wall_friction",
}
"""Published parameter of each configuration key."""


def is_published_sand(config: Mapping[str, Any]) -> bool:
    """Return whether a configuration has the published sand and box, at any stress and cement."""
    published = published_study().parameters
    grading = [published["grain_diameter_smallest"], published["grain_diameter_largest"]]
    sections = {name: config.get(name, {}) for name in ("packing", "sand")}
    return sections["packing"].get("diameter") == grading and all(
        sections[section].get(key) == published[name]
        for section, key, name in ((*path.split("."), name) for path, name in PUBLISHED_KEYS.items())
        if section in sections and key != "stress"
    )


def _with_intervals(row: dict[str, Any]) -> dict[str, Any]:
    """Convert pairs of numbers in a row to intervals."""
    return {name: Interval(*value) if isinstance(value, list) else value for name, value in row.items()}
