"""Tables of results: velocities, outcomes, features, laws, numerical error and run time."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.correlation import correlate, seed_permutation_test
from calcidem.analysis.intervals import Interval
from calcidem.analysis.packing_graph import FEATURES, NETWORK_FEATURES, describe_feature
from calcidem.analysis.velocity import (
    FEWEST_WAVELENGTHS,
    SOIL_DENSITY,
    damping_ratio,
    median_known,
    small_strain_modulus,
)
from calcidem.ends import Verdict
from calcidem.storage.records import MOST_PULSE_EFFECT, NORMAL_95, NOT_PLANNED, depends_on_pulse
from calcidem.wording import ABSENT, decimal, significant


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

    @classmethod
    def of(cls, caption: str, rows: Sequence[Mapping[str, str]], marked: Iterable[int] = ()) -> Self:
        """Table of rows, at least one, by the names of the columns."""
        return cls(caption, tuple(rows[0]), tuple(tuple(row.values()) for row in rows), frozenset(marked))


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


def _velocity_table(analysis: CampaignAnalysis) -> Table:
    """Vs at each content with its intervals."""
    rows = [
        {
            "content (%)": f"{row.content:g}",
            "n": str(row.vs.n),
            "mean (m/s)": with_bounds(row.vs.mean, row.vs.mean_interval),
            "standard deviation (m/s)": with_bounds(row.vs.standard_deviation, row.vs.standard_deviation_interval, 1),
            "reading error (m/s)": decimal(row.budget.scatter, 1),
            "95 % of new samples (m/s)": bounds(row.vs.prediction_interval),
            "skewness": decimal(row.vs.skewness, 2),
            "kurtosis": decimal(row.vs.kurtosis, 2),
            "p, normal": probability(row.vs.p_small_sample),
            "missing": str(row.missing),
            "failed": str(row.failed),
        }
        for row in analysis.distributions
    ]
    return Table.of(
        "Shear-wave velocity at each content. Brackets hold 95 % intervals for further seeds of the same packing: of "
        "the mean by Student's t (without cement, where all seeds are one sample, by its error), of the "
        "standard deviation by chi-square (fewer than 8 samples) or by Bonett's formula, which corrects for "
        "kurtosis. Reading error is the standard deviation that errors of the readings alone would give, their "
        "root mean square. The range of new samples holds for "
        "normal velocities. p is that of the Jarque-Bera test simulated for this number of samples. Cells not "
        "computed yet and cells without a velocity have separate columns; the other columns exclude them. Marked "
        "rows have such cells.",
        rows,
        (i for i, row in enumerate(analysis.distributions) if row.missing or row.failed),
    )


def _meaning_table(analysis: CampaignAnalysis) -> Table:
    """Quantities of the velocities: modulus, wavelengths, calcite and, where computed, static speed."""
    static = bool(np.isfinite(analysis.cells["static_speed"]).any())
    rows, near = [], []
    for place, row in enumerate(analysis.distributions):
        column = analysis.distinct.sel(content=row.content)
        if median_known(column["wavelengths_on_path"]) < FEWEST_WAVELENGTHS:
            near.append(place)
        modulus = small_strain_modulus(float(column["effective_vs"].mean())) / 1e6
        if depends_on_pulse(analysis.cells["pulse_effect"].sel(content=row.content)).any():  # also of cells without Vs
            modulus = math.nan
        ratio = median_known(column["effective_vs"] / column["static_speed"])
        of_long_waves = {
            "static speed (m/s)": decimal(median_known(column["static_speed"])),
            "effective Vs / static speed": decimal(ratio, 2),
        }
        rows.append(
            {
                "content (%)": f"{row.content:g}",
                "mean Vs (m/s)": decimal(row.vs.mean),
                "G0 (MPa)": significant(modulus),
                "wavelengths on the path": decimal(median_known(column["wavelengths_on_path"]), 2),
                "wavelength / d50": decimal(median_known(column["wavelength_over_d50"]), 1),
                "calcite by Eq. 2 (%)": decimal(median_known(column["content_of_contacts"]), 2),
                **(of_long_waves if static else {}),
            }
        )
    alpha = analysis.config.get("wave", {}).get("damping", math.nan)
    return Table.of(
        "What Vs stands for (medians). G0 = rho c\N{SUPERSCRIPT TWO} of the mean effective_vs, not where the pulse "
        "changes it, for a soil of "
        f"{SOIL_DENSITY:g} kg/m\N{SUPERSCRIPT THREE}. Local damping of {alpha:g} is a "
        f"damping ratio of {damping_ratio(alpha):.3f}, and slows fronts. Marked: fewer than "
        f"{FEWEST_WAVELENGTHS:g} wavelengths between transmitter and receiver. d50 is that by mass. Calcite by Eq. 2 "
        "counts each cemented contact once; the content counts overlapping clusters in full."
        + (" Static speed: of long waves, from the stiffness of the sample at rest." if static else ""),
        rows,
        near,
    )


def _outcome_table(analysis: CampaignAnalysis) -> Table | None:
    """Cells without a velocity by outcome and reason, the most frequent first; None without any."""
    status, reason = analysis.status.to_numpy(), analysis.cells["reason"].to_numpy()
    contents = np.broadcast_to(analysis.vs["content"].to_numpy(), status.shape)
    rows = tuple(
        {
            "outcome": outcome.replace("_", " "),
            "reason": text,
            "contents (%)": ", ".join(f"{c:g}" for c in where),
            "cells": str(count),
        }
        for outcome, text, where, count in count_reasons(status.ravel(), reason.ravel(), contents.ravel())
    )
    if not rows:
        return None
    return Table.of("Cells without a velocity, with reasons.", rows)


def count_reasons(
    status: NDArray[np.object_], reason: NDArray[np.object_], content: NDArray[np.float64]
) -> list[tuple[str, str, list[float], int]]:
    """Return outcome, reason, contents (percent) and number of cells without a velocity, the most frequent first.

    The arguments are columns of all cells, (N,); the status is empty without an outcome. Without cement all seeds are
    one sample, which counts once.
    """
    failed = np.flatnonzero(~np.isin(status, ("", "done", NOT_PLANNED)))
    found: Counter[tuple[str, str]] = Counter()
    where: dict[tuple[str, str], set[float]] = {}
    for outcome, text, at in zip(status[failed], reason[failed], content[failed], strict=True):
        verdict = Verdict.of(str(text))  # the numbers that follow it differ from cell to cell
        key = (str(outcome), verdict.explained if verdict else str(text))
        contents = where.setdefault(key, set())
        found[key] += bool(at) or 0.0 not in contents
        contents.add(float(at))
    return [(*key, sorted(where[key]), count) for key, count in found.most_common(20)]


def _correlation_table(subject: str, features: Mapping[str, tuple[str, str]], table: xr.Dataset) -> Table:
    """Features with symbol and definition, and their correlation with Vs."""
    matrices, tests = correlate(table), seed_permutation_test(table, "vs")

    def coefficient(cell: xr.Dataset) -> str:
        value, low, high = (float(cell[name]) for name in ("pearson", "pearson_low", "pearson_high"))
        return with_bounds(value, Interval(low, high), 2) if math.isfinite(value) else ABSENT

    rows = tuple(
        {
            "feature": symbol,
            "definition": definition,
            "with Vs, all contents": coefficient(matrices.overall.sel(variable=name, other="vs")),
            "Spearman": decimal(float(matrices.overall["spearman"].sel(variable=name, other="vs")), 2),
            "with Vs, within one content": coefficient(tests.sel(variable=name)),
            "p, corrected": probability(float(tests["p_corrected"].sel(variable=name))),
        }
        for name, (symbol, definition) in features.items()
    )
    return Table.of(
        f"Features of {subject} and Pearson's correlation with Vs, with 95 % intervals. Over all contents a common "
        "growth with content inflates it, and its interval takes cells as independent. Within one content, less the "
        "mean and over the standard deviation of each content, it measures how much of the scatter a feature explains. "
        "Its interval and p-value exchange seeds at random. The p-value is corrected for the number of features: the "
        "largest coefficient counts.",
        rows,
    )


def _law_table(analysis: CampaignAnalysis) -> Table:
    """The laws between C_d,n and Vs with their intervals and errors."""
    laws, printed_laws = analysis.compared_laws
    published, rows = {law.name: law for law in printed_laws}, []
    for law in (*laws, analysis.conductance_law):
        fit, check, other = law.fit, law.check, published.get(law.name)
        rows.append(
            {
                "weights by": law.name,
                "sand / cement": f"{law.weights.hertz:.3f} / {law.weights.bond:.3f}" if law.weights else ABSENT,
                "a (m/s)": with_bounds(fit.a, fit.a_interval),
                "b": with_bounds(fit.b, fit.b_interval, 2),
                "c (m/s)": with_bounds(fit.c, fit.c_interval),
                "residual deviation (m/s)": decimal(fit.residual_standard_deviation),
                "error for unseen seeds (m/s)": decimal(check.root_mean_square_error),
                "coverage": f"{100 * check.coverage:.0f} %",
            }
        )
        if other:
            printed = {
                "weights by": f"{law.name}, published",
                "sand / cement": f"{other.weights.hertz:.3f} / {other.weights.bond:.3f}",
                "a (m/s)": decimal(other.a),
                "b": decimal(other.conclusions_b, 2),
                "c (m/s)": decimal(other.c),
            }
            rows.append(dict.fromkeys(rows[0], ABSENT) | printed)
    return Table.of(
        "Laws Vs = a C^b + c with 95 % intervals; C is C_d,n with these weights, or the conductance G. The error for "
        "unseen seeds is the root mean square over samples of a seed that the law was not fitted to, the coverage how "
        "many of these fall into their 95 % prediction interval.",
        rows,
    )


def _cost_table(analysis: CampaignAnalysis) -> Table:
    """Numerical and statistical errors, and run times."""
    rows = []
    for row in analysis.distributions:
        column = analysis.distinct.sel(content=row.content)
        # Of all cells: without cement another seed than the first may have been computed.
        seconds = analysis.cells["seconds"].sel(content=row.content)
        laws = np.unique(analysis.cells["law"].sel(content=row.content).astype(str))
        relative = 100 * row.vs.standard_deviation / (row.vs.mean * math.sqrt(row.vs.n)) if row.vs.n > 1 else math.nan
        rows.append(
            {
                "content (%)": f"{row.content:g}",
                "frequency (kHz)": decimal(median_known(column["frequency"]) / 1e3, 1),
                "contact law": ", ".join(filter(None, laws)) or ABSENT,
                "time step (ns)": significant(1e9 * median_known(column["time_step"])),
                "step / limit": decimal(median_known(column["time_step"] / column["stability_limit"]), 2),
                "steps": decimal(median_known(column["steps"])),
                "standard error of Vs (%)": significant(100 * row.budget.total, 2),
                "of it reading (%)": significant(100 * row.budget.reading, 2),
                "of it simulation (%)": significant(100 * row.budget.numerical, 2),
                "of it pulse (%)": significant(100 * row.budget.pulse, 2),
                "standard error of the mean (%)": decimal(relative, 2),
                "time for a cell (s)": significant(median_known(seconds)),
            }
        )
    return Table.of(
        "Standard errors and cost at each content (medians). The standard error of Vs of one cell is the root of the "
        "sum of squares of three parts: that of the reading; that of the simulation, by contact law, time step, "
        "sampling and precision; and the effect of the sense of the pulse. The latter two are measured for each "
        "content: two samples are computed again with finer settings and the reversed pulse. In 95 % of cells Vs is "
        f"off by less than {NORMAL_95:g} standard errors.",
        rows,
    )


def _two_velocities_table(analysis: CampaignAnalysis) -> Table | None:
    """Both velocities, their ratio and its known bias, and the pulse's effect; None if no cell has both."""
    cells = analysis.distinct
    if not bool((cells["vs"] * cells["effective_vs"]).notnull().any()):
        return None
    rows, loud = [], set()
    for place, row in enumerate(analysis.distributions):
        column = analysis.distinct.sel(content=row.content)
        effective = column["effective_vs"]
        if depends_on_pulse(analysis.cells["pulse_effect"].sel(content=row.content)).any():
            loud.add(place)
        rows.append(
            {
                "content (%)": f"{row.content:g}",
                "wavelengths on the path": decimal(median_known(column["wavelengths_on_path"]), 1),
                "mean effective_vs (m/s)": decimal(float(effective.mean())),
                "its standard deviation (%)": significant(100 * float(effective.std(ddof=1) / effective.mean()), 2),
                "its standard error (%)": significant(100 * median_known(column["effective_error"]), 2),
                "by the side (%)": significant(100 * median_known(column["side_error"]), 2),
                "vs above it (%)": significant(100 * (median_known(column["vs"] / effective) - 1.0), 2),
                "of it bias (%)": significant(100 * median_known(column["vs_bias"]), 2),
                "effect of the pulse (%)": significant(100 * row.budget.pulse, 2),
            }
        )
    return Table.of(
        "The two velocities of a cell (medians, unless stated otherwise). vs is the distance over the travel time of a "
        "peak, as in the paper. effective_vs is that of the damped wave that fits the whole section. It belongs to the "
        "sample, so from one side its standard error is at least that by the side, measured for the content; in the "
        "mean of both sides this part is smaller by the root of 2. On a short path in a strip a peak is early; the "
        "fitted wave says by how much (bias). Marked: contents whose "
        f"velocities depend on the pulse, by a standard error above {100 * MOST_PULSE_EFFECT:g} %.",
        rows,
        frozenset(loud),
    )


RESULT_TABLES: dict[str, Callable[[CampaignAnalysis], Table | None]] = {
    "velocities": _velocity_table,
    "meaning": _meaning_table,
    "outcomes": _outcome_table,
    "features": lambda analysis: _correlation_table("the preferential path", FEATURES, analysis.table),
    "network_features": lambda analysis: _correlation_table(
        "the cement as a network", NETWORK_FEATURES, analysis.network_table
    ),
    "own_features": lambda analysis: (
        _correlation_table(
            "other packages",
            {name: (name.replace("_", " "), describe_feature(one)) for name, one in analysis.features.items()},
            analysis.own_table,
        )
        if analysis.features
        else None
    ),
    "laws": _law_table,
    "errors_and_cost": _cost_table,
    "two_velocities": _two_velocities_table,
}
"""Functions that make these tables, by name in files; they return None without data."""
