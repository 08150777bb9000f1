"""Tables that hold the campaign beside the published study and beside measured velocities."""

import math
from collections.abc import Callable

from scipy import stats

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.distribution import Distribution
from calcidem.analysis.figures.registry import published_velocities
from calcidem.analysis.measured import misfits, root_mean_square_misfit
from calcidem.analysis.published import PublishedVelocity, published_study
from calcidem.app.report.wording import ABSENT, Table, decimal, with_bounds

_SIGNIFICANCE = 0.05
_MANY_ERRORS = 2.0


def _published_table(analysis: CampaignAnalysis) -> Table | None:
    """Mean, deviation and normality beside the published ones; None for other sands and contents."""
    published = published_velocities(analysis)
    if not published:
        return None
    here = {round(row.content, 6): row.vs for row in analysis.distributions}
    rows: list[tuple[str, ...]] = []
    marked: set[int] = set()
    for content, row in published:
        vs = here[round(content, 6)]
        p_value = vs.normality.p_small_sample
        if _differs(vs, row):
            marked.add(len(rows))
        rows.append(
            (
                f"{content:g}",
                with_bounds(vs.mean, vs.mean_interval),
                decimal(row.mean),
                f"{decimal(100 * (vs.mean / row.mean - 1), 1)} %" if vs.n else ABSENT,
                with_bounds(vs.standard_deviation, vs.standard_deviation_interval),
                decimal(row.standard_deviation),
                _normal(None if math.isnan(p_value) else p_value >= _SIGNIFICANCE),
                _normal(row.normal),
            )
        )
    return Table(
        "This campaign and the published one. Marked: the two means differ by more than their errors explain "
        "(Welch's test at 5 %, with the published standard deviation and number of samples). Normal: not rejected by "
        "the Jarque-Bera test at 5 %. Some printed verdicts do not follow from the printed skewness and kurtosis, see "
        "docs/reproduction.md.",
        (
            "content (%)",
            "mean (m/s)",
            "published",
            "difference",
            "standard deviation (m/s)",
            "published",
            "normal here",
            "printed as normal",
        ),
        tuple(rows),
        frozenset(marked),
    )


def _measured_table(analysis: CampaignAnalysis) -> Table | None:
    """Mean and scatter beside measured ones; None if none are given."""
    if not analysis.measured:
        return None
    found = misfits(analysis.distributions, analysis.measured)
    rows = tuple(
        (
            f"{one.measured.content:g}{' (interpolated)' if one.interpolated else ''}",
            decimal(one.mean),
            decimal(one.measured.vs),
            decimal(100 * one.difference, 1),
            decimal(one.standard_errors, 1),
            decimal(one.standard_deviation),
            ABSENT if one.measured.sd is None else decimal(one.measured.sd),
            decimal(one.deviation_ratio, 2),
        )
        for one in found
    )
    outside = len(analysis.measured) - len(found)
    return Table(
        f"This campaign and measured velocities: root mean square of the differences of the means "
        f"{decimal(100 * root_mean_square_misfit(found), 1)} %. Between the campaign's contents by straight lines. A "
        "standard error is that of the difference of both means. Marked: more than two of them. "
        f"Measured contents outside the campaign's range: {outside}.",
        (
            "content (%)",
            "mean (m/s)",
            "measured mean (m/s)",
            "difference (%)",
            "in standard errors",
            "standard deviation (m/s)",
            "measured deviation (m/s)",
            "ratio",
        ),
        rows,
        frozenset(i for i, one in enumerate(found) if abs(one.standard_errors) > _MANY_ERRORS),
    )


def _differs(here: Distribution, published: PublishedVelocity) -> bool:
    """Say whether two means differ; a mean without scatter cannot be compared."""
    if not here.standard_deviation > 0:
        return False
    test = stats.ttest_ind_from_stats(
        here.mean,
        here.standard_deviation,
        here.n,
        published.mean,
        published.standard_deviation,
        published_study().seeds,
        equal_var=False,
    )
    return bool(test.pvalue < _SIGNIFICANCE)


def _normal(verdict: bool | None) -> str:
    return ABSENT if verdict is None else "yes" if verdict else "no"


COMPARISON_TABLES: dict[str, Callable[[CampaignAnalysis], Table | None]] = {
    "measured": _measured_table,
    "published": _published_table,
}
"""Makers of these tables by their names in files; None where a campaign has nothing to show."""
