"""Extreme scenes beyond one campaign: tables and figure of docs/accuracy.md.

    python benchmarks/stability/run.py --out DIR            # along each quantity, small packings, limits, long runs
    python benchmarks/stability/run.py --scenes 512 --draw 1    # drawn at random, waves and scenes of one's own

Exit code 1 if a scene is silently wrong. The first takes about 10 minutes, the second about 20.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

sys.path.append(str(Path(__file__).parent))

from extreme_scenes import BOXES, LAWS, QUANTITIES, Extreme, Packed
from own_scenes import OwnScene
from step_limits import Limits, detections, endurance

from calcidem.analysis.figures.style import apply_style, letter_panels, new_figure, save
from calcidem.app.studies.stability import VERDICT_COLOURS, Judgement, SceneVerdict, count_verdicts
from calcidem.app.studies.study import markdown_table

Scene = Extreme | Packed | OwnScene
Judged = Mapping[str, Sequence[tuple[Scene, Judgement]]]


def judge_all(groups: Mapping[str, Sequence[Scene]]) -> Judged:
    """Judge groups of scenes; print the number of each verdict, and each scene that is silently wrong."""
    judged = {}
    for name, scenes in groups.items():
        print(f"{name}: {len(scenes)} scenes", file=sys.stderr, flush=True)
        judged[name] = [(scene, scene.judge()) for scene in scenes]
    rows = count_verdicts({name: [found.verdict for _, found in row] for name, row in judged.items()})
    print(markdown_table(("scenes", *SceneVerdict), rows) + "\n")
    for scene, found in wrong(judged):
        print(f"wrong: {scene}: {found}\n")
    return judged


def wrong(judged: Judged) -> list[tuple[Scene, Judgement]]:
    """Scenes that are silently wrong."""
    return [pair for row in judged.values() for pair in row if pair[1].verdict == SceneVerdict.WRONG]


def maps(folder: Path) -> Judged:
    """Scenes along each quantity and small packings; tables of the step's limit, of long runs and of forced steps."""
    walks = judge_all(Extreme.along_quantities())
    folder.mkdir(parents=True, exist_ok=True)
    save(draw_maps(walks), folder, "stability", ("png",))
    packings = judge_all(Packed.samples())
    print_packings(packings)
    fillings = {"bare": 0.0, "30 % of the capacity": 0.3, "fully bonded": 1.0}
    ratios = [
        (
            f"{contrast:g}",
            *(f"{Limits.of_scene(Extreme(contrast=contrast, content=each)).ratio:.2f}" for each in fillings.values()),
        )
        for contrast in (1.0, 1e2, 1e4, 1e6)
    ]
    print(markdown_table(("stiffness contrast", *fillings), ratios) + "\n")
    print(
        markdown_table(
            ("law", "steps", "energy change over kinetic", "motion at rest over overlap", "continued: same bits"),
            [(row.law, row.steps, row.drift, row.residual_motion, row.restarted) for row in endurance()],
        )
        + "\n"
    )
    print(
        markdown_table(
            ("step over the true limit", "law", "ended after steps", "steps between looks", "reason"),
            [(f"{row.factor:g}", row.law, row.steps or "not ended", row.looks, row.problem) for row in detections()],
        )
    )
    return walks | packings


def print_packings(packings: Judged) -> None:
    """Print velocities and largest error of the small packings with each law."""
    pairs = [pair for row in packings.values() for pair in row]
    by_law = {law: [found for scene, found in pairs if scene.law == law] for law in LAWS}
    counts = [sum(found.vs is not None for found in row) for row in by_law.values()]
    errors = [max(abs(found.error or 0.0) for found in row) for row in by_law.values()]
    rows = (
        ("velocities, of 18", *counts),
        ("largest error against the finite law with a quarter of the step", *errors),
    )
    print(markdown_table(("law", *by_law), rows) + "\n")


def random_scenes(count: int, draw: int) -> Judged:
    """Scenes drawn from each box, and of one's own; prints their errors."""
    groups: dict[str, list[Scene]] = {box: [*Extreme.draw(count, draw, box)] for box in BOXES}
    for own in OwnScene.draw(count, draw):
        groups.setdefault(own.kind, []).append(own)
    judged = judge_all(groups)
    known = {name: [abs(found.error) for _, found in row if found.error is not None] for name, row in judged.items()}
    errors = [(name, len(row), float(np.median(row)), max(row)) for name, row in known.items() if row]
    print(markdown_table(("scenes", "compared", "error, median", "worst"), errors))
    return judged


@apply_style
def draw_maps(walks: Judged) -> Figure:
    """Draw one row of marks for each law along each quantity."""
    across = 2
    down = -(-len(walks) // across)
    figure = new_figure(1.6 * down)
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for axes, (name, row) in zip(panels, walks.items(), strict=False):
        quantity = QUANTITIES[name]
        for scene, found in row:
            place = quantity.walk.index(getattr(scene, name)), LAWS.index(scene.law)
            axes.plot(*place, "s", color=VERDICT_COLOURS[found.verdict], markersize=6)
        axes.set_xticks(range(len(quantity.walk)), [f"{value:g}" for value in quantity.walk], fontsize=6)
        axes.set_yticks(range(len(LAWS)), LAWS, fontsize=7)
        axes.set(ylim=(-0.6, len(LAWS) - 0.4), xlabel=quantity.label, ylabel="law")
    letter_panels(panels[: len(walks)])
    for axes in panels[len(walks) :]:
        axes.set_axis_off()
    handles = [
        panels[0].plot([], [], "s", color=colour, label=verdict)[0] for verdict, colour in VERDICT_COLOURS.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(), metavar="DIR", help="folder of the figure")
    parser.add_argument("--scenes", type=int, default=0, metavar="N", help="draw as many scenes at random, instead")
    parser.add_argument("--draw", type=int, default=1, metavar="SEED", help="seed of the random scenes")
    given = parser.parse_args()
    found = random_scenes(given.scenes, given.draw) if given.scenes else maps(given.out)
    sys.exit(bool(wrong(found)))
