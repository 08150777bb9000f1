"""Figure: verdicts along each quantity."""

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from calcidem.analysis.figures.style import BLUE, GREY, ORANGE, VERMILION, apply_style, new_figure
from calcidem.app.studies.stability.maps import WALKS
from calcidem.app.studies.stability.scenes import REGIMES, Extreme
from calcidem.app.studies.stability.verdict import Judgement, Verdict

COLOURS = {Verdict.STABLE: BLUE, Verdict.REFUSED: GREY, Verdict.DETECTED: ORANGE, Verdict.WRONG: VERMILION}
COLUMNS = 2


@apply_style
def draw_maps(found: Mapping[str, Sequence[Judgement]]) -> "Figure":
    """Draw one row of marks for each regime along each quantity."""
    rows = -(-len(found) // COLUMNS)
    figure = new_figure(1.4 * rows)
    panels = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes, (name, row) in zip(panels, found.items(), strict=False):
        for judgement in row:
            if isinstance(judgement.scene, Extreme):
                place = WALKS[name].index(getattr(judgement.scene, name)), REGIMES.index(judgement.scene.regime)
                axes.plot(*place, "s", color=COLOURS[judgement.verdict], markersize=6)
        axes.set_xticks(range(len(WALKS[name])), [f"{value:g}" for value in WALKS[name]], fontsize=6)
        axes.set_yticks(range(len(REGIMES)), REGIMES, fontsize=7)
        axes.set(ylim=(-0.6, len(REGIMES) - 0.4), title=name.replace("_", " "))
    for axes in panels[len(found) :]:
        axes.set_axis_off()
    handles = [panels[0].plot([], [], "s", color=colour, label=verdict)[0] for verdict, colour in COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure
