"""Computation of missing cells of variants, and their comparison in a Markdown table."""

import math
from collections.abc import Callable, Mapping, Sequence

import xarray as xr

from calcidem.analysis.sensitivity import Change, paired_changes
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.run import run
from calcidem.app.report.wording import ABSENT
from calcidem.app.studies.sensitivity.plan import REFERENCE, Variant
from calcidem.app.studies.tables import markdown_table
from calcidem.storage.errors import UnknownCampaignError


def compute_variants(variants: Sequence[Variant], say: Callable[[str], None]) -> None:
    """Compute all cells that the database lacks, variant by variant; the same call continues after a stop.

    `CampaignMismatchError` if the database has a variant of that name with other parameters.
    """
    for number, variant in enumerate(variants, start=1):
        say(f"{number} of {len(variants)}: {variant.name}")
        run(variant.configuration).close()


def _variant_velocities(variant: Variant) -> xr.DataArray | None:
    """Vs of the planned cells of a variant, m/s along (seed, content); None if none was computed."""
    plan = variant.configuration.campaign
    try:
        with open_campaign(variant.configuration.database, variant.name) as campaign:
            # A database may contain more cells from an earlier plan.
            return campaign.vs().reindex(seed=list(plan.seed_numbers), content=sorted(plan.contents))
    except UnknownCampaignError:
        return None


def compare_variants(variants: Sequence[Variant]) -> dict[str, tuple[Change, ...]]:
    """Compare every computed variant with its reference variant, by its name."""
    found = {variant.name: _variant_velocities(variant) for variant in variants}
    compared = {}
    for variant in variants:
        own, other = found[variant.name], found[variant.against]
        if own is not None and other is not None:
            compared[variant.name] = paired_changes(own, other)
    return compared


def sensitivity_table(variants: Sequence[Variant], changes: Mapping[str, Sequence[Change]]) -> str:
    """Table with a row for each variant and a column for each content of the reference.

    An entry has mean and standard deviation in m/s. Below them are the change of the mean, and the ratio of standard
    deviations with its 95 % interval, in bold if the interval excludes 1.
    """
    contents = [change.content for change in changes.get(REFERENCE, ())]
    rows = []
    former = ""
    for variant in variants:
        found = {change.content: change for change in changes.get(variant.name, ())}
        if not found:
            continue
        choice = variant.choice if variant.choice != former else ""
        former = variant.choice
        entries = [_table_entry(found.get(content), is_reference=variant.name == REFERENCE) for content in contents]
        value = variant.value if variant.against == REFERENCE else f"{variant.value} (against {variant.against})"
        rows.append((choice, value, *entries))
    return markdown_table(("choice", "value", *(f"{content:g} %" for content in contents)), rows) + "\n"


def _table_entry(change: Change | None, *, is_reference: bool) -> str:
    """One entry of the table."""
    if change is None or not change.measured:
        return ABSENT if change is None else f"none of {change.planned} read"
    text = f"{change.mean:.0f} ± {change.standard_deviation:.0f}"
    if not is_reference and math.isfinite(change.deviation_ratio):
        interval = change.deviation_ratio_interval
        scatter = f"x {change.deviation_ratio:.2f} ({interval.low:.2f} to {interval.high:.2f})"
        scatter = scatter if interval.contains(1.0) else f"**{scatter}**"
        text += f"<br>{100.0 * (change.mean_ratio - 1.0):+.1f} %, {scatter}"
    if change.measured < change.planned:
        text += f"<br>{change.measured} of {change.planned} read"
    return text
