"""Command `calcidem accuracy`: a study of the configuration's scenes, as Markdown tables, JSON and a figure."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from calcidem.analysis.figures.style import BLACK, BLUE, GREY, VERMILION, apply_style, new_figure
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.accuracy.questions import Rows, answer_questions
from calcidem.app.studies.accuracy.settings import DEFAULT, UNDAMPED, Setting, settings
from calcidem.app.studies.accuracy.study import HALVING, CellError, Study, covered_share, run_study
from calcidem.app.studies.study import Cells, StudyResult, markdown_table, number


def accuracy(
    configuration: Configuration,
    cells: Cells,
    velocities: Mapping[float, Sequence[float]] | None = None,
    *,
    only: Sequence[str] = (),
    target: str | None = None,
    tell: Callable[[StudyResult], object] = lambda _: None,
) -> StudyResult:
    """Measure error over run time.

    ``velocities`` at each content, m/s, supply the scatter of the samples; without them a few samples are measured.
    With names of settings in ``only``, only these and the default are compared with the reference. ``target`` is an
    error for which the text names the cheapest setting. ``tell`` receives the results after each content.
    `ValueError` for an unknown name or target, and if no content can be computed.
    """

    def result(study: Study, questions: Mapping[str, Rows]) -> StudyResult:
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

    rounds = {"rounds": 1} if only else {}
    compared = choose_settings(cells, only)
    study = run_study(cells, compared=compared, tell=lambda study: tell(result(study, {})), **rounds)
    return result(study, {} if only else answer_questions(study, configuration, cells, velocities))


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
    row, own = study.summaries[0], _own_cells(study)
    changes = [abs(cell.halving) for cell in study.references if cell.halving is not None]
    if not row.cells:
        return "No cell has a velocity with the default and in the reference."
    return (
        f"Default against the reference, {row.cells} cells: median {row.median:.1e}, worst {row.worst:.1e}, of the "
        f"effective velocity {row.effective_median:.1e} and {row.effective_worst:.1e}; "
        f"{study.reference_seconds / row.seconds:.0f} times faster ({row.seconds:.2f} s against "
        f"{study.reference_seconds:.1f} s of processor time a cell). The last halving of the reference's step "
        f"changed Vs by {max(changes, default=0.0):.1e} at most; {sum(change < HALVING for change in changes)} of "
        f"{len(changes)} cells are below {HALVING:g}. "
        f"The error is within 1.96 stated standard errors in {_covered(own)} of the cells, that of the effective "
        f"velocity in {_covered_effective(own)}."
    )


def _covered(cells: Sequence[CellError]) -> str:
    """Share of the cells with an error of Vs within the stated one."""
    return _percent(covered_share([cell.vs_error for cell in cells], [cell.stated for cell in cells]))


def _covered_effective(cells: Sequence[CellError]) -> str:
    """The same of the effective velocity."""
    errors, stated = [cell.effective_error for cell in cells], [cell.stated for cell in cells]
    return _percent(covered_share(errors, stated))


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "-"


def _settings_table(study: Study) -> str:
    """Return one line for each setting; those that change the exact answer are marked."""
    header = (
        "setting",
        "Vs median",
        "worst",
        "effective Vs median",
        "worst",
        "first arrival",
        "signal (L2)",
        "s a cell",
    )
    rows = [
        (
            row.setting if row.numerical else f"*{row.setting}*",
            *(row.median, row.worst, row.effective_median, row.effective_worst, row.arrival, row.signal),
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
        halving = max((abs(cell.halving) for cell in exact if cell.halving is not None), default=None)
        errors = [abs(cell.vs_error) for cell in found if cell.vs_error is not None]
        effective = [abs(cell.effective_error) for cell in found if cell.effective_error is not None]
        rows.append(
            (
                f"{content:g}",
                len(errors),
                f"{min(cell.step_fraction for cell in exact):g}",
                halving,
                found[0].stated,
                *(_middle(errors), max(errors, default=None), _covered(found)),
                *(_middle(effective), max(effective, default=None), _covered_effective(found)),
            )
        )
    header = (
        *("content %", "cells", "reference's step / limit, smallest", "Vs by its last halving, largest"),
        "stated standard error",
        *("error of Vs: median", "worst", "within 1.96 of it"),
        *("error of effective Vs: median", "worst", "within 1.96 of it"),
    )
    return markdown_table(header, rows)


def _middle(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _cell_table(study: Study) -> str:
    """Return every cell of the default with its reference, unless there are many: those are in the JSON."""
    found = {(cell.seed, cell.content): cell for cell in _own_cells(study)}
    if len(study.references) > 40:
        return ""
    rows = []
    for exact in study.references:
        cell = found[exact.seed, exact.content]
        reference = (number(exact.vs, ".2f"), f"{exact.step_fraction:g}", exact.halving, number(cell.vs, ".2f"))
        errors = (cell.stated, cell.vs_error, cell.effective_error)
        rows.append((f"{exact.content:g}", exact.seed, *reference, *errors, cell.arrival_error, cell.signal_error))
    header = ("content %", "seed", "reference Vs, m/s", "its step / limit", "Vs by its last halving", "default Vs, m/s")
    columns = ("stated error", "error", "error of effective Vs", "first arrival", "signal (L2)")
    return markdown_table((*header, *columns), rows)


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
        xlim=(0.3 * min((row.seconds for row in rows), default=0.01), 1.5 * study.reference_seconds),
        ylim=(0.4 * min((drawable(row.median) for row in rows), default=1e-6), None),
    )
    axes.legend(loc="lower left")
    return figure
