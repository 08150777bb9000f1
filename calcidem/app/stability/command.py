"""The command `calcidem stability`: maps of extreme scenes, and predicted against true time-step limits."""

import json as to_json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from calcidem.analysis.figures.style import BLUE, GREY, ORANGE, VERMILION, new_figure, save, styled
from calcidem.app.stability.limits import limits
from calcidem.app.stability.maps import WALKS, walks
from calcidem.app.stability.scenes import REGIMES, Extreme
from calcidem.app.stability.verdict import Judgement, Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = {Verdict.STABLE: BLUE, Verdict.REFUSED: GREY, Verdict.DETECTED: ORANGE, Verdict.WRONG: VERMILION}
CONTRASTS = (1.0, 1e2, 1e4, 1e6)


def stability(
    *,
    out: Path | None = None,
    json: bool = False,
    say: Callable[[str], None],
    progress: Callable[[str], None] = lambda _: None,
) -> None:
    """Map what is stable, refused and detected; ``out`` takes ``stability.png``, ``.md`` and ``.json``."""
    found = walks(progress=progress)
    as_json = to_json.dumps({name: [asdict(judgement) for judgement in row] for name, row in found.items()}, indent=1)
    text = "\n".join([*map_table(found), "", *limit_table(CONTRASTS)])
    if out is not None:
        save(draw_maps(found), out, "stability", ("png",))
        (out / "stability.md").write_text(text + "\n")
        (out / "stability.json").write_text(as_json)
    say(as_json if json else text)


def map_table(found: Mapping[str, Sequence[Judgement]]) -> list[str]:
    """Give the number of scenes of each verdict along every walk, as Markdown."""
    lines = ["| quantity | " + " | ".join(Verdict) + " |", "|---|" + "---|" * len(Verdict)]
    for name, row in found.items():
        count = Counter(judgement.verdict for judgement in row)
        lines.append(f"| {name} | " + " | ".join(str(count[verdict]) for verdict in Verdict) + " |")
    return lines


def limit_table(contrasts: Sequence[float]) -> list[str]:
    """Give predicted over true time-step limit for bare, partly and fully bonded scenes, as Markdown."""
    contents = (0.0, 0.3, 1.0)
    lines = ["| stiffness contrast | bare | 30 % of the capacity | fully bonded |", "|---|---|---|---|"]
    for contrast in contrasts:
        ratios = [limits(Extreme(contrast=contrast, content=content)).ratio for content in contents]
        lines.append(f"| {contrast:g} | " + " | ".join(f"{ratio:.2f}" for ratio in ratios) + " |")
    return lines


@styled
def draw_maps(found: Mapping[str, Sequence[Judgement]]) -> "Figure":
    """Draw one row of marks for each regime along each quantity."""
    figure = new_figure(7.0)
    panels = figure.subplots(5, 2).ravel()
    for axes, (name, row) in zip(panels, found.items(), strict=False):
        for judgement in row:
            place = WALKS[name].index(getattr(judgement.scene, name)), REGIMES.index(judgement.scene.regime)
            axes.plot(*place, "s", color=COLOURS[judgement.verdict], markersize=6)
        axes.set_xticks(range(len(WALKS[name])), [f"{value:g}" for value in WALKS[name]], fontsize=6)
        axes.set_yticks(range(len(REGIMES)), REGIMES, fontsize=7)
        axes.set(ylim=(-0.6, len(REGIMES) - 0.4), title=name.replace("_", " "))
    handles = [panels[0].plot([], [], "s", color=colour, label=verdict)[0] for verdict, colour in COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure
