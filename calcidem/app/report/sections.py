"""What a report has: tables by name, and the sections in which tables and figures stand."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError
from calcidem.app.report.comparison import COMPARISON_TABLES
from calcidem.app.report.provenance import PROVENANCE_TABLES
from calcidem.app.report.results import RESULT_TABLES
from calcidem.app.report.wording import Table

Made = TypeVar("Made")

TABLES: dict[str, Callable[[CampaignAnalysis], Table | None]] = RESULT_TABLES | COMPARISON_TABLES | PROVENANCE_TABLES
"""Makers of tables by their names in files; None where a campaign has nothing to show."""


@dataclass(frozen=True, slots=True)
class SectionPlan:
    """What stands in a section of the page."""

    anchor: str
    title: str
    """Name in links, and heading."""
    figures: tuple[str, ...] = ()
    tables: tuple[str, ...] = ()
    folded: tuple[str, ...] = ()
    """Names of `CAMPAIGN_FIGURES` and of `TABLES`, in their order; folded tables open on a click."""


PAGE_SECTIONS = (
    SectionPlan(
        "velocities",
        "Shear-wave velocity",
        ("vs_range", "histograms"),
        ("velocities", "measured", "meaning", "outcomes", "growth"),
    ),
    SectionPlan("samples", "Samples and measurement", ("samples", "measurement", "signals", "methods", "dispersion")),
    SectionPlan(
        "paths",
        "Preferential paths and connectivity",
        ("paths", "correlations", "weight_scan", "laws"),
        ("features", "laws"),
    ),
    SectionPlan("errors", "Errors and run time", ("narrowing",), ("errors_and_cost", "two_velocities")),
    SectionPlan("published", "The published study", (), ("published",)),
    SectionPlan("provenance", "What was run", (), ("parameters", "packing", "runs"), ("configuration",)),
)


def make_or_explain(make: Callable[[CampaignAnalysis], Made], analysis: CampaignAnalysis) -> tuple[Made | None, str]:
    """Give what a maker makes and no reason, or nothing and the reason why the campaign lacks what it needs."""
    try:
        return make(analysis), ""
    except UnavailableError as error:
        return None, str(error)
