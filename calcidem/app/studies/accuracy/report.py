"""Results as Markdown tables and as a figure of error over run time."""

from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import spearmanr

from calcidem.analysis.figures.style import BLACK, BLUE, GREY, VERMILION, apply_style, new_figure
from calcidem.app.studies.accuracy.questions import Findings
from calcidem.app.studies.accuracy.reference import CONVERGENCE_STEPS, HALVING, CellError
from calcidem.app.studies.accuracy.settings import DEFAULT, UNDAMPED
from calcidem.app.studies.accuracy.study import Study, covered_share
from calcidem.app.studies.results import markdown_table, number

_TARGETS = (0.005, 0.002, 0.001)
_MANY_CELLS = 40  # most cells in a table; more are only in the JSON
_SMALLEST = 1e-6  # smaller errors, including zero, are drawn here
_STAIRS = 4  # levels of staggered labels


def accuracy_tables(findings: Findings, targets: Sequence[float] = _TARGETS) -> dict[str, str]:
    """Return all measured tables as Markdown, by name."""
    study = findings.study
    wanted = [f"- {100 * target:g} %: {study.cheapest_in_words(target)}" for target in targets]
    parts = {
        "opening": _opening(study),
        "settings": _settings_table(study),
        "targets": "\n".join(["Cheapest setting whose worst error stays below a target:\n", *wanted]),
        "contents": _content_table(study),
        "cells": _cell_table(study),
        "damping": _damping_table(study),
        **_other_tables(findings),
    }
    return {name: table for name, table in parts.items() if table}


def accuracy_page(findings: Findings) -> str:
    """Return all tables as a page of Markdown, each between comments with its name for other programs."""
    parts = accuracy_tables(findings).items()
    return "\n\n".join(f"<!-- {name} -->\n{table}\n<!-- end -->" for name, table in parts) + "\n"


def _own_cells(study: Study) -> list[CellError]:
    """Cells of the default setting."""
    return [cell for cell in study.cells if cell.setting == DEFAULT]


def _opening(study: Study) -> str:
    """Summarise the most important numbers."""
    row = next(row for row in study.summaries if row.setting == DEFAULT)
    names = {summary.setting for summary in study.summaries if summary.numerical}
    numerical = [cell for cell in study.cells if cell.setting in names]
    changes = [abs(cell.halving) for cell in study.references if cell.halving is not None]
    return (
        f"Default against the reference, {row.cells} cells: median {row.median:.1e}, worst {row.worst:.1e}, "
        f"{study.reference_seconds / row.seconds:.0f} times faster ({row.seconds:.2f} s against "
        f"{study.reference_seconds:.1f} s of processor time a cell). The last halving of the reference's step "
        f"changed Vs by {max(changes, default=0.0):.1e} at most; {sum(change < HALVING for change in changes)} of "
        f"{len(changes)} cells are below {HALVING:g}. "
        f"The error is at most the cell's own bound in {100 * row.covered:.1f} % of the cells; its rank correlation "
        f"with the expected error is {_rank_correlation(_own_cells(study)):.2f}, over all numerical settings "
        f"{_rank_correlation(numerical):.2f}."
    )


def _settings_table(study: Study) -> str:
    """Return one line for each setting; those that change the exact answer are marked."""
    header = ("setting", "Vs median", "Vs worst", "first arrival", "signal (L2)", "within bound", "s a cell")
    rows = [
        (
            row.setting if row.numerical else f"*{row.setting}*",
            *(row.median, row.worst, row.arrival, row.signal),
            f"{100 * row.covered:.0f} %" if row.numerical and np.isfinite(row.covered) else "-",
            f"{row.seconds:.3f}",
            row.lost,
        )
        for row in study.summaries
    ]
    return markdown_table((*header, "cells lost"), rows)


def _content_table(study: Study) -> str:
    """Return reference and default at each content."""
    rows = []
    for content in sorted({cell.content for cell in study.references}):
        exact = [cell for cell in study.references if cell.content == content]
        found = [cell for cell in _own_cells(study) if cell.content == content]
        errors = [abs(cell.vs_error) for cell in found if cell.vs_error is not None]
        if not errors:
            continue
        halving = max((abs(cell.halving) for cell in exact if cell.halving is not None), default=np.nan)
        bound = np.median([cell.bound for cell in found if cell.bound is not None])
        expected = np.median([cell.expected for cell in found if cell.expected is not None])
        reference = (f"{content:g}", len(errors), f"{min(cell.step_fraction for cell in exact):g}", halving)
        default = (np.median(errors), max(errors), expected, f"{100 * covered_share(found):.0f} %", bound)
        rows.append((*reference, *default))
    header = (
        *("content %", "cells", "reference's step / limit, smallest", "Vs by its last halving, largest"),
        *("default: median", "worst", "expected, median", "within bound", "bound, median"),
    )
    return markdown_table(header, rows)


def _cell_table(study: Study) -> str:
    """Return every cell of the default with its reference, unless there are too many."""
    found = {(cell.seed, cell.content): cell for cell in _own_cells(study)}
    if not found or len(study.references) > _MANY_CELLS:
        return ""
    rows = []
    for exact in study.references:
        cell = found[exact.seed, exact.content]
        reference = (number(exact.vs, ".2f"), f"{exact.step_fraction:g}", exact.halving, number(cell.vs, ".2f"))
        errors = (cell.vs_error, cell.expected, cell.bound, cell.arrival_error, cell.signal_error)
        rows.append((f"{exact.content:g}", exact.seed, *reference, *errors))
    header = ("content %", "seed", "reference Vs, m/s", "its step / limit", "Vs by its last halving", "default Vs, m/s")
    return markdown_table((*header, "error", "expected", "own bound", "first arrival", "signal (L2)"), rows)


def _damping_table(study: Study) -> str:
    """Return the ratio of velocities with and without local damping at each content."""
    own = {(cell.seed, cell.content): cell.vs for cell in _own_cells(study)}
    ratios: dict[float, list[float]] = {}
    for cell in study.cells:
        before = own.get((cell.seed, cell.content))
        if cell.setting == UNDAMPED and cell.vs is not None and before is not None:
            ratios.setdefault(cell.content, []).append(before / cell.vs)
    rows = [
        (f"{content:g}", len(found), *(f"{value:.3f}" for value in (np.median(found), min(found), max(found))))
        for content, found in sorted(ratios.items())
    ]
    header = ("content %", "cells", "Vs as configured over Vs without damping: median", "smallest", "largest")
    return markdown_table(header, rows)


def _other_tables(findings: Findings) -> dict[str, str]:
    """Return the tables with their own reference; the finite regime's line is an effect of the amplitude."""
    halvings = [f"{2 * step:g} to {step:g}" for step in CONVERGENCE_STEPS[1:]]
    orders = [
        (
            *(f"{row.content:g}", row.regime, "as configured" if row.damped else "none"),
            *row.changes,
            *(f"{order:.2f}" for order in row.orders),
        )
        for row in findings.convergence
    ]
    amplitudes = [
        (
            f"{row.amplitude:g}",
            f"*{row.regime}, effect of the amplitude*" if row.regime == "finite" else row.regime,
            *(row.median, row.worst, row.cells, row.lost),
            row.refusal.split(":")[0],
        )
        for row in findings.amplitudes
    ]
    equilibrium = [
        (f"{row.unbalanced_force_ratio:g}", row.changed_contacts, row.median, row.worst, row.cells)
        for row in findings.equilibrium
    ]
    scatter = [
        (
            *(f"{row.content:g}", row.numerical, row.worst, f"{row.bias:+.1e}"),
            *(row.deviation, row.samples, row.statistical),
        )
        for row in findings.scatter
    ]
    seeds = findings.scatter[0].seeds if findings.scatter else 0
    of_scatter = (
        *("content %", "numerical error: median", "worst", "mean with sign", "scatter (sd / mean)"),
        *("of samples", f"statistical error of the mean of {seeds} seeds"),
    )
    of_orders = ("content %", "regime", "local damping", f"signal, {halvings[0]}", *halvings[1:], "order", "order")
    of_amplitudes = ("amplitude, m/s", "regime", "Vs median", "Vs worst", "cells", "cells lost", "refused")
    of_equilibrium = ("unbalanced-force ratio", "changed contacts", "Vs median", "Vs worst", "cells")
    return {
        "convergence": markdown_table(of_orders, orders),
        "amplitudes": markdown_table(of_amplitudes, amplitudes),
        "equilibrium": markdown_table(of_equilibrium, equilibrium),
        "scatter": markdown_table(of_scatter, scatter),
    }


@apply_style
def draw_error_against_run_time(study: Study) -> "Figure":
    """Draw median and largest error of Vs over the processor time of a cell."""
    figure = new_figure(3.6)
    axes = figure.subplots()
    rows = [row for row in study.summaries if row.numerical and row.cells]
    front = study.pareto

    def drawable(error: float) -> float:
        return max(error, _SMALLEST)

    axes.plot([row.seconds for row in front], [drawable(row.median) for row in front], color=BLUE, label="Pareto front")
    for row in rows:
        colour = VERMILION if row.setting == DEFAULT else BLUE if row in front else GREY
        axes.plot([row.seconds] * 2, [drawable(row.median), drawable(row.worst)], color=colour, linewidth=0.8)
        size = 5 if row.setting == DEFAULT else 3
        axes.plot(row.seconds, drawable(row.median), "o", color=colour, markersize=size)
    named = sorted({*front, *(row for row in rows if row.setting == DEFAULT)}, key=lambda row: row.seconds)
    for place, row in enumerate(named):
        # Labels are below the marks and their bars, and staggered, since settings of equal cost are close together.
        axes.annotate(
            row.setting,
            (row.seconds, drawable(row.median)),
            xytext=(-10, -10 - 9 * (place % _STAIRS)),
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
        ylim=(0.4 * min(drawable(row.median) for row in rows), None),
    )
    axes.legend(loc="lower left")
    return figure


def _rank_correlation(cells: Iterable[CellError]) -> float:
    """Spearman's rank correlation of expected and actual errors of cells; NaN below three cells."""
    pairs = {
        (cell.expected, abs(cell.vs_error)) for cell in cells if cell.vs_error is not None and cell.expected is not None
    }  # a set: without cement all seeds are the same cell
    if len(pairs) <= 2:  # two always agree
        return np.nan
    expected, found = np.array(list(pairs)).T
    return float(spearmanr(expected, found).statistic)
