"""The table of a sensitivity study, in Markdown."""

import math
from collections.abc import Mapping, Sequence

from calcidem.analysis.sensitivity import Change
from calcidem.app.report.wording import ABSENT
from calcidem.app.studies.sensitivity.plan import REFERENCE, Variant


def sensitivity_table(variants: Sequence[Variant], changes: Mapping[str, Sequence[Change]]) -> str:
    """Table with a row for each variant and a column for each content of the reference.

    A place has mean and standard deviation in m/s; below them the change of the mean, and the ratio of standard
    deviations with its 95 % interval, in bold where the interval excludes 1.
    """
    contents = [change.content for change in changes.get(REFERENCE, ())]
    header = ["choice", "value", *(f"{content:g} %" for content in contents)]
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    former = ""
    for variant in variants:
        found = {change.content: change for change in changes.get(variant.name, ())}
        if not found:
            continue
        choice = variant.choice if variant.choice != former else ""
        former = variant.choice
        places = [place(found.get(content), is_reference=variant.name == REFERENCE) for content in contents]
        value = variant.value if variant.against == REFERENCE else f"{variant.value} (against {variant.against})"
        lines.append(f"| {' | '.join([choice, value, *places])} |")
    return "\n".join(lines) + "\n"


def place(change: Change | None, *, is_reference: bool) -> str:
    """One place of the table."""
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
