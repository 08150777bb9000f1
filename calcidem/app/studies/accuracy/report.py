"""Command `calcidem accuracy`: a study of the configuration's scenes, as Markdown tables, JSON and a figure."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import spearmanr

from calcidem.analysis.figures.style import BLACK, BLUE, GREY, VERMILION, apply_style, new_figure
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.accuracy.questions import Rows, answer_questions
from calcidem.app.studies.accuracy.settings import DEFAULT, UNDAMPED, Setting, settings
from calcidem.app.studies.accuracy.study import HALVING, CellError, Study, covered_share, run_study
from calcidem.app.studies.cells import Cells
from calcidem.app.studies.results import StudyResult, markdown_table, number


def accuracy(
    configuration: Configuration,
    cells: Cells,
    velocities: Mapping[float, Sequence[float]] | None = None,
    *,
    only: Sequence[str] = (),
    target: str | None = None,
) -> StudyResult:
    """Measure error over run time.

    ``velocities`` at each content, m/s, supply the scatter of the samples; without them a few samples are measured.
    With names of settings in ``only``, only these and the default are compared with the reference. ``target`` is an
    error for which the text names the cheapest setting. `ValueError` for an unknown name or target.
    """
    rounds = {"rounds": 1} if only else {}
    study = run_study(cells, compared=choose_settings(cells, only), **rounds)
    questions = {} if only else answer_questions(study, configuration, cells, velocities)
    parts = accuracy_tables(study, questions)
    text = "\n\n".join(parts.values())
    if target is not None:
        chosen = study.cheapest_in_words(parse_target(target))
        text += f"\nCheapest setting with an error of at most {target}: {chosen}"
    page = "\n\n".join(f"<!-- {name} -->\n{table}\n<!-- end -->" for name, table in parts.items()) + "\n"
    hashes = {"campaign_hash": configuration.hash, "packing_hash": cells.experiment.packing.content_hash}
    found = _rounded({**hashes, "study": asdict(study), **questions})
    told = json.dumps(found, separators=(",", ":"))
    figures = {"": partial(draw_error_against_run_time, study)}
    return StudyResult(text, page, json.loads(told)["study"]["cells"], told, figures=figures)


def choose_settings(cells: Cells, only: Sequence[str]) -> list[Setting]:
    """Return the default and the settings of these names, all without names; `ValueError` for an unknown name."""
    known = {setting.name: setting for setting in settings(cells.experiment, cells.contents)}
    for name in only:
        if name not in known:
            raise ValueError(f"only = {name}: choose among {', '.join(known)}")
    return [known[DEFAULT], *(known[name] for name in only or known if name != DEFAULT)]


def parse_target(text: str) -> float:
    """Parse ``0.5%`` or ``0.005`` as 0.005."""
    digits, scale = (text[:-1], 0.01) if text.rstrip().endswith("%") else (text, 1.0)
    try:
        value = float(digits) * scale
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise ValueError(f"target = {text}: give a part of Vs such as 0.5% or 0.005")
    return value


def _rounded(value: object) -> object:
    """A value for JSON: numbers to five digits, None for those that are not finite."""
    if isinstance(value, dict):
        return {f"{key:g}" if isinstance(key, float) else str(key): _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.5g}") if np.isfinite(value) else None
    return value


def accuracy_tables(study: Study, questions: Mapping[str, Rows]) -> dict[str, str]:
    """Return all measured tables as Markdown, by name."""
    wanted = [f"- {100 * target:g} %: {study.cheapest_in_words(target)}" for target in (0.005, 0.002, 0.001)]
    parts = {
        "opening": _opening(study),
        "settings": _settings_table(study),
        "left_out": _left_out_table(study),
        "targets": "\n".join(["Cheapest setting whose worst error stays below a target:\n", *wanted]),
        "contents": _content_table(study),
        "cells": _cell_table(study),
        "damping": _damping_table(study),
        **{name: _table_of(rows) for name, rows in questions.items()},
    }
    return {name: table for name, table in parts.items() if table}


def _table_of(rows: Rows) -> str:
    """Markdown table of the rows of a question."""
    forms = {"mean with sign": "+.1e", "order 1": ".2f", "order 2": ".2f"}
    forms |= dict.fromkeys(("content %", "amplitude, m/s", "unbalanced-force ratio"), "g")
    shown = [[format(value, forms[name]) if name in forms else value for name, value in row.items()] for row in rows]
    return markdown_table(tuple(rows[0]), shown) if rows else ""


def _left_out_table(study: Study) -> str:
    """Return what the computation leaves out, why that is safe, and what it would cost."""
    own = study.summaries[0]
    rows = [
        (
            row.adds,
            row.why,
            f"{row.seconds / own.seconds:.2f} x the time",
            f"{row.change:.1e}" if np.isfinite(row.change) else "no velocity to compare",
        )
        for row in study.summaries
        if row.adds and np.isfinite(row.seconds)
    ]
    return markdown_table(("left out", "why that is safe", "with it", "Vs changes by at most"), rows)


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
    """Return every cell of the default with its reference, unless there are many: those are in the JSON."""
    found = {(cell.seed, cell.content): cell for cell in _own_cells(study)}
    if not found or len(study.references) > 40:
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


@apply_style
def draw_error_against_run_time(study: Study) -> "Figure":
    """Draw median and largest error of Vs over the processor time of a cell."""
    figure = new_figure(3.6)
    axes = figure.subplots()
    rows = [row for row in study.summaries if row.numerical and row.cells]
    front = study.pareto

    def drawable(error: float) -> float:
        return max(error, 1e-6)  # smaller errors, including zero, are drawn there

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
            xytext=(-10, -10 - 9 * (place % 4)),
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
