"""What a report has: tables by name, and the sections in which tables and figures stand."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError
from calcidem.app.report.comparison import measured_table, published_table
from calcidem.app.report.provenance import configuration_table, packing_table, parameter_table, run_table
from calcidem.app.report.results import (
    cost_table,
    departure_table,
    feature_table,
    growth_table,
    law_table,
    meaning_table,
    outcome_table,
    velocity_table,
)
from calcidem.app.report.wording import Table

Made = TypeVar("Made")

TABLES: Mapping[str, Callable[[CampaignAnalysis], Table | None]] = {
    "velocities": velocity_table,
    "meaning": meaning_table,
    "outcomes": outcome_table,
    "growth": growth_table,
    "features": feature_table,
    "laws": law_table,
    "errors_and_cost": cost_table,
    "two_velocities": departure_table,
    "measured": measured_table,
    "published": published_table,
    "parameters": lambda analysis: parameter_table(analysis.config),
    "packing": packing_table,
    "runs": lambda analysis: run_table(analysis.store.runs()),
    "configuration": configuration_table,
}
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
