"""What the words of tables mean, for readers who meet them there for the first time."""

from collections.abc import Mapping

from calcidem.app.report.wording import Table

_MEANINGS: Mapping[str, str] = {
    "content": "Mass of calcite over mass of sand.",
    "n": "Number of samples with a velocity.",
    "standard deviation": "Scatter of Vs between samples that differ in the places of their cement only.",
    "reading error": "Part of the scatter that comes from reading the arrivals, and not from the samples.",
    "95 % of new samples": "Range that holds 95 of 100 further samples, if Vs is normally distributed.",
    "skewness": "Asymmetry of the distribution: 0 if it is symmetric, positive if fast samples lie far out.",
    "kurtosis": "Weight of the tails: 3 for a normal distribution.",
    "p, normal": "Probability of such skewness and kurtosis if Vs is normally distributed.",
    "missing": "Cells that are not computed yet.",
    "failed": "Cells that were computed and gave no velocity.",
    "G0": "Shear modulus at small strain: density of the soil times Vs squared.",
    "wavelengths on the path": "Distance from transmitter to receiver over the wavelength Vs / f.",
    "wavelength / d50": "Wavelength over the median diameter of the grains.",
    "calcite by Eq. 2": "Content that the cemented contacts stand for by the paper's Eq. 2, each counted once.",
    "static speed": "Speed of very long shear waves, from the stiffness of the sample at rest.",
    "with Vs, all contents": "Pearson's correlation: 1 or -1 on a straight line, 0 if they are unrelated.",
    "Spearman": "Correlation of the ranks, which does not ask for a straight line.",
    "p, corrected": "Probability that one of the features correlates so well if none has to do with Vs.",
    "residual deviation": "Scatter of Vs about the law.",
    "coverage": "Share of samples that lie in the 95 % interval predicted for them.",
    "step / limit": "Time step over the largest one at which the computation is stable.",
    "standard error of the mean": "Uncertainty of the mean of Vs, which falls with the number of samples.",
    "median of path_vs / vs": "Velocity from station to station over that from transmitter to receiver.",
    "coordination number": "Mean number of contacts of a grain.",
    "unbalanced-force ratio": "Mean net force on a grain over the mean contact force; near 0 at rest.",
    "porosity": "Area of the voids over area of the box.",
}
"""Meanings by the words of headers and of first columns, units left out."""


def explained_terms(table: Table) -> tuple[tuple[str, str], ...]:
    """Give the terms of a table, from its header and its first column, with their meanings."""
    words = (*table.header, *(row[0] for row in table.rows))
    found = dict.fromkeys(word.partition(" (")[0] for word in words)
    return tuple((word, _MEANINGS[word]) for word in found if word in _MEANINGS)
