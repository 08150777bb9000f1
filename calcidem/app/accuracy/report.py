"""A study as Markdown tables and as JSON."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from calcidem.analysis.distribution import describe
from calcidem.app.accuracy.settings import DEFAULT
from calcidem.app.accuracy.study import Study, Summary, cheapest, default_of

if TYPE_CHECKING:
    from calcidem.dem.kernels.layout import Floats


def tables(study: Study, targets: Sequence[float] = (0.005, 0.002, 0.001)) -> str:
    """Give all tables of a study as Markdown."""
    row = default_of(study)
    chosen = [f"- {100 * target:g} %: {name_of(cheapest(study, target))}" for target in targets]
    return "\n".join(
        [
            (
                f"Default against the reference, {row.cells} cells: median {row.median:.1e}, worst {row.worst:.1e}, "
                f"{study.reference_seconds / row.seconds:.0f} times faster ({row.seconds:.2f} s against "
                f"{study.reference_seconds:.1f} s a cell). "
                f"Halving the reference's step changes Vs by {study.halving:.1e} "
                "at most."
            ),
            "",
            *settings_table(study.summaries),
            "",
            "Cheapest setting whose worst error stays below a target:",
            "",
            *chosen,
            "",
            *order_lines(study),
            "",
            *scatter_table(study),
            "",
        ]
    )


def settings_table(summaries: Sequence[Summary]) -> list[str]:
    """Give one line for each setting; those that ask another question are marked."""
    lines = [
        "| setting | Vs median | Vs worst | first arrival | signal (L2) | s a cell | cells lost |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in summaries:
        name = row.setting if row.numerical else f"*{row.setting}*"
        numbers = " | ".join(f"{value:.1e}" for value in (row.median, row.worst, row.arrival, row.signal))
        lines.append(f"| {name} | {numbers} | {row.seconds:.3f} | {row.lost} |")
    return lines


def scatter_table(study: Study) -> list[str]:
    """Give numerical error beside the scatter of the samples, per content, for the default setting."""
    lines = [
        (
            "| content % | numerical error, worst | estimated, largest | scatter of the samples (sd / mean) "
            "| seeds at which the mean is as uncertain as the numbers |"
        ),
        "|---|---|---|---|---|",
    ]
    cells = [cell for cell in study.cells if cell.setting == DEFAULT]
    for content in sorted({cell.content for cell in cells}):
        row = [cell for cell in cells if cell.content == content and cell.vs_error is not None]
        if len(row) < 2:  # noqa: PLR2004 - a scatter needs two
            continue
        worst = max(abs(cell.vs_error or 0.0) for cell in row)
        spread = describe([cell.vs for cell in row if cell.vs is not None])
        scatter = spread.standard_deviation / spread.mean
        estimate = max(cell.estimate or 0.0 for cell in row)
        needed = f"{(scatter / worst) ** 2:.0f}" if worst > 0.0 else "any"
        lines.append(f"| {content:g} | {worst:.1e} | {estimate:.1e} | {scatter:.1e} | {needed} |")
    return lines


def order_lines(study: Study) -> list[str]:
    """Give the observed order of convergence in the step: the slope of the error against the step."""
    order = observed_order(study)
    if order is None:
        return ["Observed order in the step: not to be seen, the steps' errors are below those of the sampling."]
    return [f"Observed order of convergence in the step: {order:.1f} (Vs, against the smallest step measured)."]


def observed_order(study: Study) -> float | None:
    """Order in the step from the error of Vs against the finest step: slope of a straight line in double logarithms.

    Vs of the finest step of the study is taken for exact, cell by cell, so that nothing but the step differs.
    """
    by_step: dict[float, dict[tuple[int, float], float]] = {}
    for cell in study.cells:
        knob, _, value = cell.setting.partition(" ")
        if knob == "step_fraction" and cell.vs is not None:
            by_step.setdefault(float(value), {})[cell.seed, cell.content] = cell.vs
    if len(by_step) < 3:  # noqa: PLR2004 - one for the reference, two for a line
        return None
    finest, *others = sorted(by_step)
    steps = np.array(others)
    errors = np.array([typical_change(by_step[step], by_step[finest]) for step in others])
    if not np.all(errors > 0.0):
        return None
    # An error e(h) - e(h0) of order p is h^p - h0^p; for p near 1 the line is drawn against h - h0.
    return float(np.polyfit(np.log(steps - finest), np.log(errors), 1)[0])


def typical_change(found: dict[tuple[int, float], float], exact: dict[tuple[int, float], float]) -> float:
    """Root mean square of the relative changes of Vs of the cells in both."""
    changes: Floats = np.array([found[key] / exact[key] - 1.0 for key in found.keys() & exact.keys()])
    return float(np.sqrt(np.mean(changes**2))) if len(changes) else 0.0


def name_of(row: Summary | None) -> str:
    """Name of a setting with its cost."""
    return "none of those measured" if row is None else f"{row.setting}, {row.seconds:.2f} s a cell"


def as_json(study: Study) -> str:
    """Whole study as JSON."""
    return json.dumps(asdict(study), indent=1)
