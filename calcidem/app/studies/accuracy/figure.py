"""Figure: error of the velocity against run time, one mark a setting, the Pareto front and the default."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calcidem.analysis.figures.style import BLACK, BLUE, GREY, VERMILION, apply_style, new_figure
from calcidem.app.studies.accuracy.settings import DEFAULT
from calcidem.app.studies.accuracy.study import Study, Summary, pareto

SMALLEST = 1e-6  # errors below this are drawn here: a setting that changes nothing has none
STAIRS = 4  # names one below the other, before they begin again


@apply_style
def error_against_run_time(study: Study) -> "Figure":
    """Draw median and largest error of Vs against the processor time of a cell."""
    figure = new_figure(3.6)
    axes = figure.subplots()
    rows = [row for row in study.summaries if row.numerical and row.cells]
    front = pareto(rows)
    axes.plot([row.seconds for row in front], [shown(row.median) for row in front], color=BLUE, label="Pareto front")
    for row in rows:
        mark(axes, row, on_front=row in front)
    named = sorted({*front, *(row for row in rows if row.setting == DEFAULT)}, key=lambda row: row.seconds)
    for number, row in enumerate(named):
        # Below the marks, where no bar is, and one below the other, because settings of one price stand close together.
        axes.annotate(
            row.setting,
            (row.seconds, shown(row.median)),
            xytext=(-10, -10 - 9 * (number % STAIRS)),
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
        ylim=(0.4 * min(shown(row.median) for row in rows), None),
    )
    axes.legend(loc="lower left")
    return figure


def mark(axes: "Axes", row: Summary, *, on_front: bool) -> None:
    """Draw one setting: a bar from median to worst error."""
    colour = VERMILION if row.setting == DEFAULT else BLUE if on_front else GREY
    axes.plot([row.seconds] * 2, [shown(row.median), shown(row.worst)], color=colour, linewidth=0.8)
    axes.plot(row.seconds, shown(row.median), "o", color=colour, markersize=5 if row.setting == DEFAULT else 3)


def shown(error: float) -> float:
    """Error as it can be drawn on a logarithmic axis."""
    return max(error, SMALLEST)
