"""Measurements of others: laboratory velocities, compared with a campaign, and the numbers of the reproduced study.

"Sand Stiffness Variability Induced by Stochastic Distributions of Calcite Precipitates: A Monte Carlo-DEM Study",
Tables 1 to 4 and section 3.2.1. `published.toml` in this folder has them as printed;
docs/reproduction/published_check.py checks their consistency.
"""

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any

import numpy as np

from calcidem.analysis.distribution import ContentDistribution
from calcidem.analysis.intervals import Interval
from calcidem.analysis.packing_graph import ContactWeights
from calcidem.storage.records import NORMAL_95


@dataclass(frozen=True, slots=True)
class Target:
    """Laboratory measurement of one specimen, or of several of one content."""

    content: float
    """Percent."""
    vs: float
    """Mean, m/s."""
    sd: float | None = None
    """Standard deviation between samples, m/s; None if unknown or not to be fitted."""
    samples: int | None = None
    """Number of samples of both, 1 for a specimen; None if they count as exact."""
    stress: float | None = None
    """Confining stress, Pa; None if unknown."""


def group_specimens(measured: Sequence[Target]) -> tuple[tuple[Target, tuple[Target, ...]], ...]:
    """Join measurements of one confining stress and one content; return those of each group after their mean.

    Specimens are joined if their contents differ by at most a tenth of the lowest and 0.1 %.
    """
    groups: list[list[Target]] = []
    for row in sorted(measured, key=lambda row: (row.stress or 0.0, row.content)):
        for group in reversed(groups):  # a mean may lie between specimens of one group
            first, reach = group[0], 1e-6  # percent: contents are parsed from text
            if first.samples == row.samples == 1:
                reach = 0.1 * first.content + 0.1
            if row.stress == first.stress and row.content <= first.content + reach:
                group.append(row)
                break
        else:
            groups.append([row])
    return tuple((_joined(rows), tuple(rows)) for rows in groups)


def _joined(rows: Sequence[Target]) -> Target:
    """Mean and standard deviation of all samples of some measurements; each number is unknown if one of theirs is."""
    if len(rows) == 1 and rows[0].samples != 1:
        return rows[0]
    scatters = [0.0 if row.samples == 1 else math.nan if row.sd is None else row.sd for row in rows]
    content, vs, sd = np.array([(row.content, row.vs, each) for row, each in zip(rows, scatters, strict=True)]).T
    numbers = [row.samples for row in rows if row.samples is not None]
    if len(numbers) < len(rows):
        variance = float((sd * sd + (vs - vs.mean()) ** 2).mean())
        scatter = math.sqrt(variance) if variance > 0.0 else None
        return Target(round(float(content.mean()), 3), float(vs.mean()), scatter, None, rows[0].stress)
    count = np.array(numbers)
    total, mean = int(count.sum()), float((count * vs).sum() / count.sum())
    squares = float(((count - 1) * sd**2 + count * (vs - mean) ** 2).sum())
    scatter = math.sqrt(squares / (total - 1)) if squares > 0.0 else None  # one specimen has none
    return Target(round(float((count * content).sum() / total), 3), mean, scatter, total, rows[0].stress)


@dataclass(frozen=True, slots=True)
class _Misfit:
    """Comparison of a campaign with measurements at one content."""

    measured: Target
    """Measurement, the mean of a group."""
    mean: float
    standard_deviation: float
    """Values of the campaign there, m/s, interpolated linearly between its contents; NaN if there is one sample."""
    interpolated: bool
    """True if the campaign lacks the content itself."""
    difference: float
    """Relative difference of the mean from the measured one."""
    standard_errors: float
    """Difference of both means over its standard error; NaN if that is zero or unknown."""
    deviation_ratio: float
    """Standard deviation over the measured one; NaN if the latter is unknown."""
    outside: int
    compared: int
    """Measured values outside the interval of 95 % of new samples at their own content, and all with such an interval.
    """


def misfits(distributions: Sequence[ContentDistribution], measured: Sequence[Target]) -> tuple[_Misfit, ...]:
    """Compare a campaign with measured velocities by groups, except those outside the range of its contents.

    The distributions are in order of content; contents without a velocity do not count.
    """
    rows = [row for row in distributions if row.vs.n]
    contents = np.array([row.content for row in rows])
    columns = np.array([_compared_numbers(row) for row in rows])
    inside = [row for row in measured if rows and is_covered(row, contents[0], contents[-1])]
    found = []
    for target, members in group_specimens(inside):
        here = [float(np.interp(target.content, contents, column)) for column in columns.T[:3]]
        mean, deviation, error = here
        scatter = deviation if target.sd is None else target.sd
        of_target = 0.0 if target.samples is None else scatter / math.sqrt(target.samples)
        both = math.hypot(error, of_target)  # NaN if one is unknown: an error of zero would make any difference large
        of_new = [[np.interp(row.content, contents, column) for column in columns.T[3:]] for row in members]
        found.append(
            _Misfit(
                measured=target,
                mean=mean,
                standard_deviation=deviation or math.nan,
                interpolated=bool(np.min(np.abs(contents - target.content)) > 1e-6),
                difference=mean / target.vs - 1.0,
                standard_errors=(mean - target.vs) / both if both else math.nan,
                deviation_ratio=deviation / target.sd if deviation and target.sd else math.nan,
                outside=sum(row.vs < low or row.vs > high for row, (low, high) in zip(members, of_new, strict=True)),
                compared=sum(low <= high for low, high in of_new),
            )
        )
    return tuple(sorted(found, key=lambda one: one.measured.content))


def _compared_numbers(row: ContentDistribution) -> tuple[float, ...]:
    """Mean, standard deviation, standard error of the mean, and interval of 95 % of new samples; NaN if unknown.

    The one sample without cement has only the error of its velocity.
    """
    vs = row.vs
    if row.content == 0.0:
        interval = vs.mean_interval
        return vs.mean, 0.0, interval.half_width / NORMAL_95, interval.low, interval.high
    interval, error = vs.prediction_interval, vs.standard_deviation / math.sqrt(vs.n)
    return vs.mean, vs.standard_deviation, error, interval.low, interval.high


def is_covered(row: Target, lowest: float, highest: float) -> bool:
    """Whether a measurement lies within a range of contents, percent."""
    return lowest - 1e-6 <= row.content <= highest + 1e-6


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
    frequencies: Mapping[float, float]
    """Table 2: excitation frequency in Hz of each content in percent, ascending."""
    velocities: tuple[tuple[float, PublishedVelocity], ...]
    """The rows of Table 3, each as (content in percent, row), ascending; there is none for 0 %."""
    stages: tuple[Mapping[str, Any], ...]
    """Section 3.2.1: name, growth rate in m/s per percent, and the ends of the ranges in its text, as in that file."""
    laws: tuple[PublishedLaw, ...]
    """Table 4."""

    def has_sand_of(self, config: Mapping[str, Any]) -> bool:
        """Return whether a configuration has the published sand and box, at any stress and cement."""
        grading = [self.parameters["grain_diameter_smallest"], self.parameters["grain_diameter_largest"]]
        sections = {name: config.get(name, {}) for name in ("packing", "sand")}
        return sections["packing"].get("diameter") == grading and all(
            sections[section].get(key) == self.parameters[name]
            for section, key, name in ((*path.split("."), name) for path, name in PUBLISHED_KEYS.items())
            if section in sections and key != "stress"
        )


@cache
def published_study() -> PublishedStudy:
    """Read the printed numbers."""
    data = tomllib.loads(resources.files(__package__).joinpath("published.toml").read_text(encoding="utf-8"))
    return PublishedStudy(
        **data["source"],
        parameters=MappingProxyType(data["parameters"]),
        frequencies=MappingProxyType({row["content"]: row["frequency"] for row in data["contents"]}),
        velocities=tuple((row["content"], PublishedVelocity(**row["vs"])) for row in data["contents"] if "vs" in row),
        stages=tuple(map(MappingProxyType, data["stages"])),
        laws=tuple(
            PublishedLaw(
                weights=ContactWeights(row.pop("hertz"), row.pop("bond")),
                connectivity_range=Interval(*row.pop("connectivity_range")),
                **row,
            )
            for row in data["laws"]
        ),
    )
