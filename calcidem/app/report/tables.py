"""Tables of results: velocities, outcomes, growth, features, laws, numerical error and run time; numbers as text."""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.contact_network import NETWORK_FEATURES
from calcidem.analysis.correlation import Correlations, correlate, seed_permutation_test
from calcidem.analysis.error_budget import median_known
from calcidem.analysis.intervals import Interval
from calcidem.analysis.packing_graph import FEATURES, describe_feature
from calcidem.analysis.published import published_study
from calcidem.analysis.shear_wave import FEWEST_WAVELENGTHS, damping_ratio, small_strain_modulus
from calcidem.ends import Verdict
from calcidem.storage.records.error_budget import MOST_PULSE_EFFECT, NORMAL_95

ABSENT = "\N{EN DASH}"

EXCEPTIONAL = frozenset({"broken_bonds"})
"""Quantities that are not shown if they are zero."""


@dataclass(frozen=True, slots=True)
class Table:
    """Table of a report."""

    caption: str
    """Caption: contents of the table, and how to read it."""
    header: tuple[str, ...]
    """Name of each column; units in brackets."""
    rows: tuple[tuple[str, ...], ...]
    """Cells as text, each row as long as the header."""
    marked: frozenset[int] = frozenset()
    """Indices of rows that need attention."""


def decimal(value: float | None, decimals: int = 0) -> str:
    """Return a number with a fixed number of decimals; a dash if missing."""
    if value is None or not math.isfinite(value):
        return ABSENT
    return f"{value:.{decimals}f}".replace("-", "\N{MINUS SIGN}")


def significant(value: float | None, digits: int = 3) -> str:
    """Return a number with some significant digits, large and small ones with a power of ten."""
    if value is None or not math.isfinite(value):
        return ABSENT
    rounded = float(f"{value:.{digits}g}")
    if rounded == 0 or 1e-3 <= abs(rounded) < 1e5:
        text = f"{rounded:.12f}".rstrip("0").rstrip(".")
    else:
        mantissa, _, exponent = f"{rounded:.{digits - 1}e}".partition("e")
        mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        power = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        text = f"{mantissa} \N{MULTIPLICATION SIGN} 10{power}"
    return text.replace("-", "\N{MINUS SIGN}")


def bounds(interval: Interval, decimals: int = 0) -> str:
    """Return both ends of an interval; a dash if undefined."""
    if not math.isfinite(interval.low):
        return ABSENT
    return f"{decimal(interval.low, decimals)} to {decimal(interval.high, decimals)}"


def with_bounds(value: float, interval: Interval, decimals: int = 0) -> str:
    """Return a value with its interval in brackets."""
    return f"{decimal(value, decimals)} ({bounds(interval, decimals)})"


def probability(value: float) -> str:
    """Return a p-value with two digits."""
    if not math.isfinite(value):
        return ABSENT
    return "< 0.001" if value < 0.001 else f"{value:.2g}"


def readable_unit(unit: str) -> str:
    """Return a UDUNITS string for people; empty for pure numbers."""
    return {"1": "", "percent": "%", "m s-1": "m/s"}.get(unit, unit)


def _velocity_table(analysis: CampaignAnalysis) -> Table:
    """Vs at each content with its intervals."""
    rows = [
        (
            f"{row.content:g}",
            str(row.vs.n),
            with_bounds(row.vs.mean, row.vs.mean_interval),
            with_bounds(row.vs.standard_deviation, row.vs.standard_deviation_interval, 1),
            decimal(budget.scatter, 1),
            bounds(row.vs.prediction_interval),
            decimal(row.vs.skewness, 2),
            decimal(row.vs.kurtosis, 2),
            probability(row.vs.p_small_sample),
            str(row.missing),
            str(row.failed),
        )
        for row, budget in zip(analysis.distributions, analysis.budgets, strict=True)
    ]
    return Table(
        "Shear-wave velocity at each content. Brackets hold 95 % intervals for further seeds of the same packing: of "
        "the mean by Student's t (without cement, where all seeds are one sample, by its error), of the "
        "standard deviation by chi-square (fewer than 8 samples) or by Bonett's formula, which corrects for "
        "kurtosis. Reading error is the standard deviation that errors of the readings alone would give, their "
        "root mean square. The range of new samples holds for "
        "normal velocities. p is that of the Jarque-Bera test simulated for this number of samples. Cells not "
        "computed yet and cells without a velocity have separate columns; the other columns exclude them. Marked "
        "rows have such cells.",
        (
            "content (%)",
            "n",
            "mean (m/s)",
            "standard deviation (m/s)",
            "reading error (m/s)",
            "95 % of new samples (m/s)",
            "skewness",
            "kurtosis",
            "p, normal",
            "missing",
            "failed",
        ),
        tuple(rows),
        frozenset(i for i, row in enumerate(analysis.distributions) if row.missing or row.failed),
    )


def _meaning_table(analysis: CampaignAnalysis) -> Table:
    """Quantities of the velocities: modulus, wavelengths, calcite and, where computed, static speed."""
    static = bool(np.isfinite(analysis.cells["static_speed"]).any())
    rows = []
    for row, budget in zip(analysis.distributions, analysis.budgets, strict=True):
        column = analysis.distinct.sel(content=row.content)
        rows.append(
            (
                f"{row.content:g}",
                decimal(row.vs.mean),
                significant(
                    math.nan if budget.loud else small_strain_modulus(float(column["effective_vs"].mean())) / 1e6
                ),
                decimal(median_known(column["wavelengths_on_path"]), 2),
                decimal(median_known(column["wavelength_over_d50"]), 1),
                decimal(median_known(column["content_of_contacts"]), 2),
                *(
                    (
                        decimal(median_known(column["static_speed"])),
                        decimal(median_known(column["effective_vs"] / column["static_speed"]), 2),
                    )
                    if static
                    else ()
                ),
            )
        )
    alpha = analysis.config.get("wave", {}).get("damping", math.nan)
    header = (
        "content (%)",
        "mean Vs (m/s)",
        "G0 (MPa)",
        "wavelengths on the path",
        "wavelength / d50",
        "calcite by Eq. 2 (%)",
    )
    return Table(
        "What Vs stands for (medians). G0 = rho c\N{SUPERSCRIPT TWO} of the mean effective_vs, not where the pulse "
        "changes it, for a soil of "
        f"{published_study().parameters['soil_density']:g} kg/m\N{SUPERSCRIPT THREE}. Local damping of {alpha:g} is a "
        f"damping ratio of {damping_ratio(alpha):.3f}, and slows fronts. Marked: fewer than "
        f"{FEWEST_WAVELENGTHS:g} wavelengths between transmitter and receiver. d50 is that by mass. Calcite by Eq. 2 "
        "counts each cemented contact once; the content counts overlapping clusters in full."
        + (" Static speed: of long waves, from the stiffness of the sample at rest." if static else ""),
        (*header, *(("static speed (m/s)", "effective Vs / static speed") if static else ())),
        tuple(rows),
        frozenset(near_field_rows(analysis)),
    )


def near_field_rows(analysis: CampaignAnalysis) -> list[int]:
    """Indices of contents at which at least half of the cells have too few wavelengths on the path."""
    found = (
        median_known(analysis.distinct["wavelengths_on_path"].sel(content=row.content))
        for row in analysis.distributions
    )
    return [place for place, number in enumerate(found) if number < FEWEST_WAVELENGTHS]


def _outcome_table(analysis: CampaignAnalysis) -> Table | None:
    """Cells without a velocity by outcome and reason, the most frequent first; None without any."""
    status, reason = analysis.status.to_numpy(), analysis.cells["reason"].to_numpy()
    contents = np.broadcast_to(analysis.vs["content"].to_numpy(), status.shape)
    rows = tuple(
        (outcome.replace("_", " "), text, ", ".join(f"{c:g}" for c in where), str(count))
        for outcome, text, where, count in count_reasons(status.ravel(), reason.ravel(), contents.ravel())
    )
    if not rows:
        return None
    return Table("Cells without a velocity, with reasons.", ("outcome", "reason", "contents (%)", "cells"), rows)


def count_reasons(
    status: NDArray[np.object_], reason: NDArray[np.object_], content: NDArray[np.float64]
) -> list[tuple[str, str, list[float], int]]:
    """Return outcome, reason, contents (percent) and number of cells without a velocity, the most frequent first.

    The arguments are columns of all cells, (N,); the status is empty without an outcome.
    """
    failed = np.flatnonzero((status != "") & (status != "done"))
    found: Counter[tuple[str, str]] = Counter()
    where: dict[tuple[str, str], set[float]] = {}
    for outcome, text, at in zip(status[failed], reason[failed], content[failed], strict=True):
        verdict = Verdict.of(str(text))  # the numbers that follow it differ from cell to cell
        key = (str(outcome), verdict.explained if verdict else str(text))
        found[key] += 1
        where.setdefault(key, set()).add(float(at))
    return [(*key, sorted(where[key]), count) for key, count in found.most_common(20)]


def _growth_table(analysis: CampaignAnalysis) -> Table | None:
    """Growth of the mean in the four published stages; None for other sands, or if no stage has two contents."""
    if not published_study().has_sand_of(analysis.config):
        return None
    published = {stage.name: stage.rate for stage in published_study().stages}
    rows = tuple(
        (
            growth.stage,
            f"{growth.contents[0]:g} to {growth.contents[-1]:g}",
            decimal(growth.end_point_slope, 1),
            decimal(growth.least_squares_slope, 1),
            decimal(published[growth.stage], 1),
        )
        for growth in analysis.stages
        if len(growth.contents) > 1
    )
    if not rows:
        return None
    return Table(
        "Growth of mean Vs in the four stages, in m/s per percent: slope between the end points (as published), "
        "slope of the straight line through all means, and the published slope.",
        ("stage", "contents (%)", "end points", "least squares", "published"),
        rows,
    )


def _feature_table(analysis: CampaignAnalysis) -> Table:
    """The eight features of the path, their definitions, and their correlation with Vs."""
    return _correlation_table("the preferential path", FEATURES, analysis.correlations, analysis.feature_tests)


def _network_table(analysis: CampaignAnalysis) -> Table:
    """The features of the cement as a network, likewise."""
    return _correlation_table(
        "the cement as a network", NETWORK_FEATURES, analysis.network_correlations, analysis.network_tests
    )


def _own_table(analysis: CampaignAnalysis) -> Table | None:
    """Features of other packages, likewise; None without any."""
    if not analysis.features:
        return None
    table = analysis.own_table
    told = {name: (name.replace("_", " "), describe_feature(feature)) for name, feature in analysis.features.items()}
    return _correlation_table("other packages", told, correlate(table), seed_permutation_test(table, "vs"))


def _correlation_table(
    subject: str, features: Mapping[str, tuple[str, str]], matrices: Correlations, tests: xr.Dataset
) -> Table:
    """Features with symbol and definition, and their correlation with Vs."""

    def coefficient(matrix: xr.Dataset, name: str) -> str:
        cell = matrix.sel(variable=name, other="vs")
        low, high = float(cell["pearson_low"]), float(cell["pearson_high"])
        if not math.isfinite(float(cell["pearson"])):
            return decimal(math.nan)
        return f"{decimal(float(cell['pearson']), 2)} ({decimal(low, 2)} to {decimal(high, 2)})"

    rows = tuple(
        (
            symbol,
            definition,
            coefficient(matrices.overall, name),
            decimal(float(matrices.overall["spearman"].sel(variable=name, other="vs")), 2),
            coefficient(matrices.within, name),
            probability(float(tests["p_corrected"].sel(variable=name))),
        )
        for name, (symbol, definition) in features.items()
    )
    return Table(
        f"Features of {subject} and Pearson's correlation with Vs, with 95 % intervals. Over all "
        "contents a common growth with content inflates it. Within one content, less the mean and over the standard "
        "deviation of each content, it measures how much of the scatter a feature explains. Its p-value is corrected "
        "for the number of features: seeds are exchanged at random, and the largest coefficient counts.",
        ("feature", "definition", "with Vs, all contents", "Spearman", "with Vs, within one content", "p, corrected"),
        rows,
    )


def _law_table(analysis: CampaignAnalysis) -> Table:
    """The laws between C_d,n and Vs with their intervals and errors."""
    published = {law.name: law for law in published_study().laws}
    compared = published_study().has_sand_of(analysis.config)
    rows = []
    for law in (analysis.physical_law, analysis.scanned_law, analysis.conductance_law):
        fit, check, other = law.fit, law.check, published.get(law.name)
        rows.append(
            (
                law.name,
                f"{law.weights.hertz:.3f} / {law.weights.bond:.3f}" if law.weights else ABSENT,
                with_bounds(fit.a, fit.a_interval),
                with_bounds(fit.b, fit.b_interval, 2),
                with_bounds(fit.c, fit.c_interval),
                decimal(fit.residual_standard_deviation),
                decimal(check.root_mean_square_error),
                f"{100 * check.coverage:.0f} %",
            )
        )
        if compared and other:
            rows.append(
                (
                    f"{law.name}, published",
                    f"{other.weights.hertz:.3f} / {other.weights.bond:.3f}",
                    decimal(other.a),
                    decimal(other.conclusions_b, 2),
                    decimal(other.c),
                    *(3 * (ABSENT,)),
                )
            )
    return Table(
        "Laws Vs = a C^b + c with 95 % intervals; C is C_d,n with these weights, or the conductance G. The error for "
        "unseen seeds is the root mean square over samples of a seed that the law was not fitted to, the coverage how "
        "many of these fall into their 95 % prediction interval.",
        (
            "weights by",
            "sand / cement",
            "a (m/s)",
            "b",
            "c (m/s)",
            "residual deviation (m/s)",
            "error for unseen seeds (m/s)",
            "coverage",
        ),
        tuple(rows),
    )


def _cost_table(analysis: CampaignAnalysis) -> Table:
    """Numerical and statistical errors, and run times."""
    rows = []
    for row, budget in zip(analysis.distributions, analysis.budgets, strict=True):
        column = analysis.distinct.sel(content=row.content)
        relative = 100 * row.vs.standard_deviation / (row.vs.mean * math.sqrt(row.vs.n)) if row.vs.n > 1 else math.nan
        rows.append(
            (
                f"{row.content:g}",
                decimal(median_known(column["frequency"]) / 1e3, 1),
                significant(1e9 * median_known(column["time_step"])),
                decimal(median_known(column["time_step"] / column["stability_limit"]), 2),
                decimal(median_known(column["steps"])),
                *(
                    significant(100 * part, 2)
                    for part in (budget.total, budget.reading, budget.numerical, budget.pulse)
                ),
                decimal(relative, 2),
                significant(median_known(column["seconds"])),
            )
        )
    return Table(
        "Standard errors and cost at each content (medians). The standard error of Vs of one cell is the root of the "
        "sum of squares of three parts: that of the reading; that of the simulation, by contact law, time step, "
        "sampling and precision; and the effect of the pulse's strength. The latter two are measured for each content: "
        "two samples are computed again with everything changed that must not matter. In 95 % of cells Vs is off by "
        f"less than {NORMAL_95:g} standard errors.",
        (
            "content (%)",
            "frequency (kHz)",
            "time step (ns)",
            "step / limit",
            "steps",
            "standard error of Vs (%)",
            "of it reading (%)",
            "of it simulation (%)",
            "of it pulse (%)",
            "standard error of the mean (%)",
            "time for a cell (s)",
        ),
        tuple(rows),
    )


def _two_velocities_table(analysis: CampaignAnalysis) -> Table | None:
    """Both velocities, their ratio and its known bias, and the pulse's effect; None if no cell has both."""
    cells = analysis.distinct
    if not bool((cells["vs"] * cells["effective_vs"]).notnull().any()):
        return None
    rows, loud = [], set()
    for place, (row, budget) in enumerate(zip(analysis.distributions, analysis.budgets, strict=True)):
        column = analysis.distinct.sel(content=row.content)
        effective = column["effective_vs"]
        if budget.loud:
            loud.add(place)
        rows.append(
            (
                f"{row.content:g}",
                decimal(median_known(column["wavelengths_on_path"]), 1),
                decimal(float(effective.mean())),
                significant(100 * float(effective.std(ddof=1) / effective.mean()), 2),
                significant(100 * median_known(column["effective_error"]), 2),
                significant(100 * (median_known(column["vs"] / effective) - 1.0), 2),
                significant(100 * median_known(column["vs_bias"]), 2),
                significant(100 * budget.pulse, 2),
            )
        )
    return Table(
        "The two velocities of a cell (medians, unless stated otherwise). vs is the distance over the travel time of a "
        "peak, as in the paper. effective_vs is that of the damped wave that fits the whole section; it belongs to the "
        "sample. On a short path in a strip a peak is early; the fitted wave says by how much (bias). Marked: contents "
        f"whose velocities depend on the pulse, by a standard error above {100 * MOST_PULSE_EFFECT:g} %.",
        (
            "content (%)",
            "wavelengths on the path",
            "mean effective_vs (m/s)",
            "its standard deviation (%)",
            "its standard error (%)",
            "vs above it (%)",
            "of it bias (%)",
            "effect of the pulse (%)",
        ),
        tuple(rows),
        frozenset(loud),
    )


RESULT_TABLES: dict[str, Callable[[CampaignAnalysis], Table | None]] = {
    "velocities": _velocity_table,
    "meaning": _meaning_table,
    "outcomes": _outcome_table,
    "growth": _growth_table,
    "features": _feature_table,
    "network_features": _network_table,
    "own_features": _own_table,
    "laws": _law_table,
    "errors_and_cost": _cost_table,
    "two_velocities": _two_velocities_table,
}
"""Functions that make these tables, by name in files; they return None without data."""
