"""Whether the printed numbers of the reproduced study agree: `python docs/reproduction/published_check.py`.

The printed moments, means and weights go through the same code as a campaign's own, and what comes out is
compared with the numbers printed beside them. Nothing is corrected: a disagreement is reported, and both sides
stay as they are.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calcidem.analysis.distribution import normality_of_moments
from calcidem.analysis.fits import power_law
from calcidem.analysis.measured import (
    PublishedLaw,
    PublishedStudy,
    published_study,
)
from calcidem.analysis.packing_graph import ContactWeights
from calcidem.analysis.velocity import FEWEST_WAVELENGTHS, wavelengths

_PAPER_SIGNIFICANCE = 0.05
"""The paper calls a sample not normal where the asymptotic p-value is below this (section 2.4)."""

_RATE_ROUNDING = 0.01
"""Means and rates printed with two decimals agree to about this, in m/s per percent."""

_WEIGHT_ROUNDING = 0.0015
"""1/C printed with three digits fixes C^(-2/3) to 0.001, and that is rounded to 0.0005 once more."""

_RANGE_ROUNDING = 0.005
"""Weights and ranges as printed fix the smallest C_d,n of a packing to about this."""

_NORMAL_KURTOSIS = 3.0


STAGES = {"I": (0.11, 0.66), "II": (1.24, 3.17), "III": (4.0, 6.0), "IV": (7.0, 9.0)}
"""First and last content of each stage, percent, whose end points give the printed growth rates. The text of the paper
has other bounds (0.66, 2.55 and 6 %), which do not give these rates.
"""


@dataclass(frozen=True, slots=True)
class StageGrowth:
    """Growth of mean Vs within one stage."""

    stage: str
    """Roman numeral, as in the paper."""
    contents: tuple[float, ...]
    """Contents of the campaign in this range, in percent."""
    end_point_slope: float
    """Difference of the means at the last and first content over the difference of content, in m/s per percent: the
    paper's rate.
    """
    least_squares_slope: float
    """Slope of the regression line through all means, in m/s per percent. Both are NaN with fewer than two contents."""


def growth_by_stage(
    content: ArrayLike, mean_vs: ArrayLike, stages: Mapping[str, tuple[float, float]] = STAGES
) -> tuple[StageGrowth, ...]:
    """Return the growth rate of each stage from contents (%) and mean velocities (m/s), both (k,), without NaN."""
    contents, means = np.asarray(content, dtype=np.float64), np.asarray(mean_vs, dtype=np.float64)
    order = np.argsort(contents)
    contents, means = contents[order], means[order]
    growth = []
    for stage, (low, high) in stages.items():
        # Contents are parsed from decimal text; a difference in the last bit must not exclude one.
        inside = (contents >= low - 1e-9) & (contents <= high + 1e-9) & np.isfinite(means)
        x, y = contents[inside], means[inside]
        enough = x.size > 1
        growth.append(
            StageGrowth(
                stage=stage,
                contents=tuple(x.tolist()),
                end_point_slope=float((y[-1] - y[0]) / (x[-1] - x[0])) if enough else math.nan,
                least_squares_slope=float(np.polyfit(x, y, 1)[0]) if enough else math.nan,
            )
        )
    return tuple(growth)


@dataclass(frozen=True, slots=True)
class VerdictCheck:
    """The printed verdict on normality of one content, and the one its printed moments give.

    Attributes
    ----------
    content
        Calcite content in percent.
    printed_normal
        What Table 3 marks.
    statistic, p_asymptotic, p_small_sample
        Jarque-Bera test of the printed moments.
    """

    content: float
    printed_normal: bool
    statistic: float
    p_asymptotic: float
    p_small_sample: float

    @property
    def computed_normal(self) -> bool:
        """The verdict by the paper's own rule."""
        return self.p_asymptotic >= _PAPER_SIGNIFICANCE

    @property
    def agrees(self) -> bool:
        """Whether the two verdicts are the same."""
        return self.printed_normal == self.computed_normal


@dataclass(frozen=True, slots=True)
class StatementCheck:
    """One comparison of a printed number with the one that follows from other printed numbers.

    Attributes
    ----------
    place
        Where in the paper.
    printed, computed
        The two sides, in words.
    agrees
        Whether they agree within the rounding of the printed numbers.
    """

    place: str
    printed: str
    computed: str
    agrees: bool


def check_verdicts(study: PublishedStudy | None = None) -> tuple[VerdictCheck, ...]:
    """Test each row of Table 3 for normality and compare with its mark."""
    study = study or published_study()
    return tuple(
        VerdictCheck(content, row.normal, *normality_of_moments(study.seeds, row.skewness, row.kurtosis))
        for content, row in study.velocities
    )


def check_study(study: PublishedStudy | None = None) -> tuple[StatementCheck, ...]:
    """Make every comparison, those that agree included."""
    study = study or published_study()
    return (
        *_compare_verdicts(study),
        *_compare_rates(study),
        *_compare_variances(study),
        *_compare_claims(study),
        *(finding for law in study.laws for finding in _compare_law(law, study)),
        _compare_coordination_number(study),
        *_compare_wavelengths(study),
        _compare_calcite(study),
    )


def _compare_verdicts(study: PublishedStudy) -> list[StatementCheck]:
    words = {True: "normal", False: "not normal"}
    return [
        StatementCheck(
            place=f"Table 3, {check.content:g} %",
            printed=f"marked {words[check.printed_normal]}",
            computed=f"{words[check.computed_normal]}: Jarque-Bera {check.statistic:.2f} from "
            f"the printed moments and n = {study.seeds}, p = {check.p_asymptotic:.2g} "
            f"(simulated for this n: {check.p_small_sample:.2g})",
            agrees=check.agrees,
        )
        for check in check_verdicts(study)
    ]


def _growth(study: PublishedStudy, stages: Mapping[str, tuple[float, float]]) -> tuple[StageGrowth, ...]:
    contents, means = zip(*((content, row.mean) for content, row in study.velocities), strict=True)
    return growth_by_stage(contents, means, stages)


def _compare_rates(study: PublishedStudy) -> list[StatementCheck]:
    text = {stage["name"]: tuple(stage["text_range"]) for stage in study.stages}
    findings = []
    for basis, stages in {"": STAGES, ", its own borders": text}.items():
        for printed, growth in zip(study.stages, _growth(study, stages), strict=True):
            rate = growth.end_point_slope
            findings.append(
                StatementCheck(
                    place=f"Section 3.2.1, stage {printed['name']}{basis}",
                    printed=f"rate {printed['rate']:.2f} m/s per percent",
                    computed=f"{rate:.2f} from the means at {growth.contents[0]:g} and {growth.contents[-1]:g} %",
                    agrees=abs(rate - printed["rate"]) < _RATE_ROUNDING,
                )
            )
    return findings


def _compare_variances(study: PublishedStudy) -> list[StatementCheck]:
    rows = dict(study.velocities)
    findings = []
    for stage, growth in zip(study.stages, _growth(study, STAGES), strict=True):
        deviations = [rows[content].standard_deviation for content in growth.contents]
        low, high = min(deviations), max(deviations)
        least, most = stage["variance_range"]
        findings.append(
            StatementCheck(
                place=f"Section 3.2.1, stage {stage['name']}",
                printed=f"variance {least:g} to {most:g}",
                computed=f"Table 3 has standard deviations of {low:g} to {high:g} m/s, so variances of "
                f"{low**2:.0f} to {high**2:.0f} (m/s)^2",
                agrees=round(most) == round(high**2),
            )
        )
    return findings


def _compare_claims(study: PublishedStudy) -> list[StatementCheck]:
    rates = {stage["name"]: stage["rate"] for stage in study.stages}
    fastest = max(rates, key=rates.__getitem__)
    in_stage = {
        name: [(content, row) for content, row in study.velocities if row.stage == name] for name in ("I", "II", "IV")
    }
    negative = [f"{row.skewness:g} at {content:g} %" for content, row in in_stage["I"] if row.skewness <= 0]
    flat = [
        f"{row.kurtosis:g} at {content:g} %" for content, row in in_stage["II"] if row.kurtosis <= 2 * _NORMAL_KURTOSIS
    ]
    positive = [f"{row.skewness:g} at {content:g} %" for content, row in in_stage["IV"] if row.skewness >= 0]
    return [
        StatementCheck(
            place="Section 3.2.1, stage III",
            printed="its rate is the highest of the four stages",
            computed=f"the highest printed rate is {rates[fastest]:.2f}, of stage {fastest}",
            agrees=fastest == "III",
        ),
        _compare_claim("stage I", "positive skewness", negative),
        _compare_claim("stage II", "kurtosis more than twice that of a normal distribution, 6", flat),
        _compare_claim("stage IV", "negative skewness", positive),
    ]


def _compare_claim(stage: str, printed: str, exceptions: list[str]) -> StatementCheck:
    return StatementCheck(
        place=f"Section 3.2.1, {stage}",
        printed=printed,
        computed=f"Table 3 has {', '.join(exceptions)}" if exceptions else "so it is in every row of Table 3",
        agrees=not exceptions,
    )


def _compare_law(law: PublishedLaw, study: PublishedStudy) -> list[StatementCheck]:
    low, high = law.connectivity_range.low, law.connectivity_range.high
    span = f"C_d,n from {low:g} to {high:g}"
    fastest = float(power_law(np.array(low), law.a, law.conclusions_b, law.c))
    # Three standard deviations above the largest mean: hardly one of 1972 normal values is larger.
    plausible = max(row.mean + 3 * row.standard_deviation for _, row in study.velocities)
    smallest = _smallest_connectivity(high, law.weights)
    return [
        StatementCheck(
            place=f"Table 4, {law.name}, exponent",
            printed=f"{law.table_b:g} in the table, {law.conclusions_b:g} in the conclusions",
            computed="Vs falls as C_d,n grows, so the exponent is negative",
            agrees=law.table_b == law.conclusions_b,
        ),
        StatementCheck(
            place=f"Table 4, {law.name}, law",
            printed=span,
            computed=f"the law gives {fastest:.0f} m/s at {low:g}; Table 3 hardly allows more than {plausible:.0f} m/s",
            agrees=fastest <= plausible,
        ),
        StatementCheck(
            place=f"Table 4, {law.name}, range",
            printed=span,
            computed=f"in one packing whose uncemented path has C_d,n = {high:g}, cement on every contact "
            f"brings it down to {smallest:.3f}, not below",
            agrees=low >= smallest - _RANGE_ROUNDING,
        ),
    ]


def _smallest_connectivity(uncemented: float, weights: ContactWeights) -> float:
    """Give C_d,n with every contact cemented, from C_d,n with none, by Eq. 9.

    Uncemented, C_d,n is largest, and the shortest path has n times the contacts of a straight row. With every
    contact cemented the path is the same one, and any other cementation has a longer one. One packing has
    one n.
    """
    difference = weights.hertz - weights.bond
    n = (uncemented * difference + weights.bond) / weights.hertz
    return weights.bond * (n - 1) / difference


def _compare_coordination_number(study: PublishedStudy) -> StatementCheck:
    weights = next(law.weights for law in study.laws if law.name == "physical meaning")
    number = 1 / weights.bond
    hertz = ContactWeights.from_coordination_number(number).hertz
    return StatementCheck(
        place="Table 4 and Eq. 8",
        printed=f"weights {weights.hertz:g} and {weights.bond:g}",
        computed=f"a coordination number of 1 / {weights.bond:g} = {number:.2f} gives {hertz:.3f} and {weights.bond:g}",
        agrees=abs(hertz - weights.hertz) < _WEIGHT_ROUNDING,
    )


def _compare_wavelengths(study: PublishedStudy) -> list[StatementCheck]:
    """Check both conditions of section 3.1.3 against Tables 2 and 3: wavelengths are mean Vs over frequency."""
    distance, *diameters = _lengths(study)
    median = (sum(diameter**3 for diameter in diameters) / 2) ** (1 / 3)  # by mass, of a uniform distribution
    found = [
        (content, *wavelengths(row.mean, study.frequencies[content], distance, median))
        for content, row in study.velocities
    ]
    near = [f"{number:.2f} at {content:g} %" for content, number, _ in found if number < FEWEST_WAVELENGTHS]
    longest = 10.0  # wavelength in median diameters, as printed
    long = [over for _, _, over in found if over >= longest]
    return [
        StatementCheck(
            place="Section 3.1.3 and Tables 2, 3",
            printed=f"L / lambda > {FEWEST_WAVELENGTHS:g}",
            computed=f"{len(near)} of {len(found)} contents have less: {', '.join(near)}",
            agrees=not near,
        ),
        StatementCheck(
            place="Section 3.1.3 and Tables 2, 3",
            printed=f"lambda / d50 < {longest:g}",
            computed=f"{len(long)} of {len(found)} contents have more, {min(long):.1f} to {max(long):.1f} with d50 = "
            f"{1e3 * median:.2f} mm by mass",
            agrees=not long,
        ),
    ]


def _lengths(study: PublishedStudy) -> tuple[float, float, float]:
    """Distance of the wave, and smallest and largest diameter of the grains, m."""
    printed = study.parameters
    return printed["wave_distance"], printed["grain_diameter_smallest"], printed["grain_diameter_largest"]


def _compare_calcite(study: PublishedStudy) -> StatementCheck:
    """Check the largest content against Eq. 2 at every contact of the packing that the printed numbers describe."""
    printed, (_, smallest, largest) = study.parameters, _lengths(study)
    grain = math.pi / 4 * (smallest**2 + smallest * largest + largest**2) / 3
    grains = printed["box_width"] * printed["box_height"] * (1 - printed["porosity"]) / grain
    coordination_number = 1 / next(law.weights.bond for law in study.laws if law.name == "physical meaning")
    diameter, width = (smallest + largest) / 2, printed["single_precipitate_larger"]
    angle = math.asin(width / diameter)
    height = diameter / 2 * (1 - math.cos(angle))
    calcite = 2 * (width * height - (diameter**2 / 4 * angle - width / 2 * (diameter / 2 - height)))
    densities = printed["calcite_density"] / printed["sand_density"]
    capacity = 100 * coordination_number / 2 * calcite / grain * densities
    most = max(study.frequencies)
    return StatementCheck(
        place="Table 2 and Eq. 2",
        printed=f"contents up to {most:g} %",
        computed=f"Eq. 2 with cement of {1e3 * width:g} mm at every contact of {grains:.0f} grains with a coordination "
        f"number of {coordination_number:.2f} gives {capacity:.1f} %: more is there only if calcite of overlapping "
        "clusters counts twice",
        agrees=most <= capacity,
    )


def main() -> None:
    """Print what does not agree."""
    findings = check_study()
    wrong = [finding for finding in findings if not finding.agrees]
    print(f"{len(wrong)} of {len(findings)} statements do not follow from the printed numbers:")
    print("| place | printed | computed from what is printed |\n|---|---|---|")
    for finding in wrong:
        print(f"| {finding.place} | {finding.printed} | {finding.computed} |")


if __name__ == "__main__":
    main()
