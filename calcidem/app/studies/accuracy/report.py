"""What was found, as Markdown tables and as a figure of error against run time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calcidem.analysis.figures.style import BLACK, BLUE, GREY, VERMILION, apply_style, new_figure
from calcidem.app.studies.accuracy.amplitudes import AmplitudeRow
from calcidem.app.studies.accuracy.equilibrium import EquilibriumRow
from calcidem.app.studies.accuracy.findings import Findings
from calcidem.app.studies.accuracy.reference import CONVERGENCE_STEPS, HALVING, Convergence
from calcidem.app.studies.accuracy.scatter import Scatter
from calcidem.app.studies.accuracy.settings import DEFAULT, UNDAMPED
from calcidem.app.studies.accuracy.study import (
    Study,
    Summary,
    cheapest,
    covered_share,
    default_of,
    pareto,
    rank_correlation,
)

_TARGETS = (0.005, 0.002, 0.001)
_MANY_CELLS = 40  # above which the table of cells is left to the JSON
_SMALLEST = 1e-6  # errors below this are drawn here: a setting that changes nothing has none
_STAIRS = 4  # names one below the other, before they begin again


def accuracy_tables(findings: Findings, targets: Sequence[float] = _TARGETS) -> dict[str, str]:
    """Give all tables as Markdown, by name; those that were not measured are left out."""
    study = findings.study
    parts = {
        "opening": [_opening(study)],
        "settings": _settings_table(study.summaries),
        "targets": [
            "Cheapest setting whose worst error stays below a target:\n",
            *(f"- {100 * target:g} %: {name_of(cheapest(study, target))}" for target in targets),
        ],
        "contents": _content_table(study),
        "cells": _cell_table(study),
        "damping": _damping_table(study),
        "convergence": _convergence_table(findings.convergence),
        "amplitudes": _amplitude_table(findings.amplitudes),
        "equilibrium": _equilibrium_table(findings.equilibrium),
        "scatter": _scatter_table(findings.scatter),
    }
    return {name: "\n".join(lines) for name, lines in parts.items() if lines}


def accuracy_page(findings: Findings) -> str:
    """Give all tables as a page of Markdown, each between comments that name it: a program may take them over."""
    parts = accuracy_tables(findings).items()
    return "\n\n".join(f"<!-- {name} -->\n{table}\n<!-- end -->" for name, table in parts) + "\n"


def _opening(study: Study) -> str:
    """Say the most important numbers."""
    row = default_of(study)
    own = [cell for cell in study.cells if cell.setting == DEFAULT]
    names = {summary.setting for summary in study.summaries if summary.numerical}
    numerical = [cell for cell in study.cells if cell.setting in names]
    return (
        f"Default against the reference, {row.cells} cells: median {row.median:.1e}, worst {row.worst:.1e}, "
        f"{study.reference_seconds / row.seconds:.0f} times faster ({row.seconds:.2f} s against "
        f"{study.reference_seconds:.1f} s of processor time a cell). The last halving of the reference's step "
        f"changed Vs by {study.halving:.1e} at most; {_converged_share(study)}. "
        f"The error is at most the cell's own bound in {100 * row.covered:.1f} % of the cells; its rank correlation "
        f"with the expected error is {rank_correlation(own):.2f}, over all numerical settings "
        f"{rank_correlation(numerical):.2f}."
    )


def _converged_share(study: Study) -> str:
    """Say in how many cells the reference's step is small enough."""
    changes = [abs(cell.halving) for cell in study.references if cell.halving is not None]
    return f"{sum(change < HALVING for change in changes)} of {len(changes)} cells are below {HALVING:g}"


def _settings_table(summaries: Sequence[Summary]) -> list[str]:
    """Give one line for each setting; those that ask another question are marked."""
    lines = [
        "| setting | Vs median | Vs worst | first arrival | signal (L2) | within bound | s a cell | cells lost |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in summaries:
        name = row.setting if row.numerical else f"*{row.setting}*"
        numbers = " | ".join(f"{value:.1e}" for value in (row.median, row.worst, row.arrival, row.signal))
        honest = f"{100 * row.covered:.0f} %" if row.numerical and np.isfinite(row.covered) else "-"
        lines.append(f"| {name} | {numbers} | {honest} | {row.seconds:.3f} | {row.lost} |")
    return lines


def _content_table(study: Study) -> list[str]:
    """Give reference and default at each content."""
    lines = [
        (
            "| content % | cells | reference's step / limit, smallest | Vs by its last halving, largest "
            "| default: median | worst | expected, median | within bound | bound, median |"
        ),
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for content in sorted({cell.content for cell in study.references}):
        exact = [cell for cell in study.references if cell.content == content]
        found = [cell for cell in study.cells if cell.setting == DEFAULT and cell.content == content]
        errors = [abs(cell.vs_error) for cell in found if cell.vs_error is not None]
        if not errors:
            continue
        halving = max((abs(cell.halving) for cell in exact if cell.halving is not None), default=np.nan)
        finest = min(cell.step_fraction for cell in exact)
        bound = np.median([cell.bound for cell in found if cell.bound is not None])
        expected = np.median([cell.expected for cell in found if cell.expected is not None])
        lines.append(
            f"| {content:g} | {len(errors)} | {finest:g} | {halving:.1e} | {np.median(errors):.1e} "
            f"| {max(errors):.1e} | {expected:.1e} | {100 * covered_share(found):.0f} % | {bound:.1e} |"
        )
    return lines


def _cell_table(study: Study) -> list[str]:
    """Give every cell of the default beside its reference, unless they are too many to read."""
    found = {(cell.seed, cell.content): cell for cell in study.cells if cell.setting == DEFAULT}
    if not found or len(study.references) > _MANY_CELLS:
        return []
    lines = [
        (
            "| content % | seed | reference Vs, m/s | its step / limit | Vs by its last halving | default Vs, m/s "
            "| error | expected | own bound | first arrival | signal (L2) |"
        ),
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for exact in study.references:
        cell = found[exact.seed, exact.content]
        numbers = (cell.vs_error, cell.expected, cell.bound, cell.arrival_error, cell.signal_error)
        errors = " | ".join(_or_dash(number) for number in numbers)
        lines.append(
            f"| {exact.content:g} | {exact.seed} | {_or_dash(exact.vs, '.2f')} | {exact.step_fraction:g} "
            f"| {_or_dash(exact.halving)} | {_or_dash(cell.vs, '.2f')} | {errors} |"
        )
    return lines


def _damping_table(study: Study) -> list[str]:
    """Give the velocity without local damping in the sample over that of the default, at each content."""
    own = {(cell.seed, cell.content): cell.vs for cell in study.cells if cell.setting == DEFAULT}
    ratios: dict[float, list[float]] = {}
    for cell in study.cells:
        before = own.get((cell.seed, cell.content))
        if cell.setting == UNDAMPED and cell.vs is not None and before is not None:
            ratios.setdefault(cell.content, []).append(before / cell.vs)
    lines = [
        "| content % | cells | Vs as configured over Vs without damping: median | smallest | largest |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {content:g} | {len(found)} | {np.median(found):.3f} | {min(found):.3f} | {max(found):.3f} |"
        for content, found in sorted(ratios.items())
    ]
    return lines if ratios else []


def _convergence_table(rows: Sequence[Convergence]) -> list[str]:
    """Give change of the signal and observed order for each halving of the step."""
    if not rows:
        return []
    halvings = [f"{2 * step:g} to {step:g}" for step in CONVERGENCE_STEPS[1:]]
    lines = [
        f"| content % | regime | local damping | signal, {' | '.join(halvings)} | order | order |",
        "|---|---|---|" + "---|" * (len(halvings) + 2),
    ]
    for row in rows:
        changes = " | ".join(f"{change:.1e}" for change in row.changes)
        orders = " | ".join(f"{order:.2f}" for order in row.orders)
        damping = "as configured" if row.damped else "none"
        lines.append(f"| {row.content:g} | {row.regime} | {damping} | {changes} | {orders} |")
    return lines


def _amplitude_table(rows: Sequence[AmplitudeRow]) -> list[str]:
    """Give the error of the regimes at each amplitude; the finite regime's own line is an effect, and marked."""
    if not rows:
        return []
    lines = [
        "| amplitude, m/s | regime | Vs median | Vs worst | cells | cells lost | refused |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        name = f"*{row.regime}, effect of the amplitude*" if row.regime == "finite" else row.regime
        reason = row.refusal.split(":")[0] if row.refusal else ""
        lines.append(
            f"| {row.amplitude:g} | {name} | {_or_dash(row.median)} | {_or_dash(row.worst)} | {row.cells} | {row.lost} "
            f"| {reason} |"
        )
    return lines


def _equilibrium_table(rows: Sequence[EquilibriumRow]) -> list[str]:
    """Give what the unbalanced forces left in a packing do."""
    if not rows:
        return []
    return [
        "| unbalanced-force ratio | changed contacts | Vs median | Vs worst | cells |",
        "|---|---|---|---|---|",
        *(
            f"| {row.unbalanced_force_ratio:g} | {row.changed_contacts} | {row.median:.1e} | {row.worst:.1e} "
            f"| {row.cells} |"
            for row in rows
        ),
    ]


def _scatter_table(rows: Sequence[Scatter]) -> list[str]:
    """Give statistical and numerical error beside each other, per content, for the default setting."""
    if not rows:
        return []
    lines = [
        (
            "| content % | numerical error: median | worst | mean with sign | scatter (sd / mean) | of samples "
            f"| statistical error of the mean of {rows[0].seeds} seeds |"
        ),
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row.content:g} | {row.numerical:.1e} | {row.worst:.1e} | {row.bias:+.1e} | {row.deviation:.1e} "
        f"| {row.samples} | {row.statistical:.1e} |"
        for row in rows
    ]
    return lines


def _or_dash(value: float | None, form: str = ".1e") -> str:
    """Write a number, or a dash."""
    return "-" if value is None else format(value, form)


def name_of(row: Summary | None) -> str:
    """Name of a setting with its cost."""
    return "none of those measured" if row is None else f"{row.setting}, {row.seconds:.2f} s a cell"


@apply_style
def draw_error_against_run_time(study: Study) -> "Figure":
    """Draw median and largest error of Vs against the processor time of a cell."""
    figure = new_figure(3.6)
    axes = figure.subplots()
    rows = [row for row in study.summaries if row.numerical and row.cells]
    front = pareto(rows)
    axes.plot(
        [row.seconds for row in front], [_drawable(row.median) for row in front], color=BLUE, label="Pareto front"
    )
    for row in rows:
        _draw_setting(axes, row, on_front=row in front)
    named = sorted({*front, *(row for row in rows if row.setting == DEFAULT)}, key=lambda row: row.seconds)
    for number, row in enumerate(named):
        # Below the marks, where no bar is, and one below the other, because settings of one price stand close together.
        axes.annotate(
            row.setting,
            (row.seconds, _drawable(row.median)),
            xytext=(-10, -10 - 9 * (number % _STAIRS)),
            textcoords="offset points",
            fontsize=6.5,
            color=BLACK,
            ha="right",
            arrowprops={"arrowstyle": "-", "color": GREY, "linewidth": 0.5, "shrinkA": 0, "shrinkB": 2},
        )
    axes.axvline(study.reference_seconds, color=GREY, linestyle=":", label="reference")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="processor time of a cell (s)",
        ylabel="relative error of $V_s$: median to worst",
        xlim=(0.3 * min(row.seconds for row in rows), 1.5 * study.reference_seconds),
        ylim=(0.4 * min(_drawable(row.median) for row in rows), None),
    )
    axes.legend(loc="lower left")
    return figure


def _draw_setting(axes: "Axes", row: Summary, *, on_front: bool) -> None:
    """Draw one setting: a bar from median to worst error."""
    colour = VERMILION if row.setting == DEFAULT else BLUE if on_front else GREY
    axes.plot([row.seconds] * 2, [_drawable(row.median), _drawable(row.worst)], color=colour, linewidth=0.8)
    axes.plot(row.seconds, _drawable(row.median), "o", color=colour, markersize=5 if row.setting == DEFAULT else 3)


def _drawable(error: float) -> float:
    """Error as it can be drawn on a logarithmic axis."""
    return max(error, _SMALLEST)
