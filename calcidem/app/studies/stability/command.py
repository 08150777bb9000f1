"""The command `calcidem stability`: maps of extreme scenes, scenes drawn at random, limits, long runs, detection.

Verdicts, limits, long runs and detections as Markdown tables, and a figure of the verdicts.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calcidem.analysis.figures.style import BLUE, GREY, ORANGE, VERMILION, apply_style, letter_panels, new_figure, save
from calcidem.app.studies.stability.endurance import Endurance, endurance
from calcidem.app.studies.stability.limits import Detection, Limits, detections, limits
from calcidem.app.studies.stability.own_scenes import draw_own_scenes
from calcidem.app.studies.stability.scenes import BOXES, REGIMES, Extreme, Packed, draw_scenes
from calcidem.app.studies.stability.verdict import (
    WALKS,
    Judgement,
    StabilityVerdict,
    judge_own_scene,
    judge_scene,
    packing_map,
    walks,
)
from calcidem.storage.files import write_text_atomically

_COLOURS = {
    StabilityVerdict.STABLE: BLUE,
    StabilityVerdict.REFUSED: GREY,
    StabilityVerdict.DETECTED: ORANGE,
    StabilityVerdict.WRONG: VERMILION,
}
_PANELS_ACROSS = 2
_AXIS_LABELS = {
    "step_fraction": "time step / its predicted limit",
    "contrast": "stiffness of bonds / of contacts",
    "damping": "local damping factor",
    "amplitude": "velocity of the pulse $v_0$ (m/s)",
    "frequency": "frequency / cut-off of the contacts",
    "size_ratio": "largest / smallest radius",
    "content": "share of the capacity for cement",
    "confinement": "confining stress (Pa)",
    "missing": "share of the disks taken away",
    "strength": "strength of bonds / stress of the pulse",
    "floating": "number of floating disks",
}
"""What the quantities of `Extreme` are on the axes of the maps."""


def _stability_tables(
    walks: Mapping[str, Sequence[Judgement]],
    packings: Sequence[Judgement],
    limits: Mapping[float, Sequence[Limits]],
    endurance: Sequence[Endurance],
    detections: Sequence[Detection],
) -> str:
    """Give all tables of the maps."""
    parts = (
        _verdict_table("quantity", walks),
        _small_packing_table(packings),
        _limit_table(limits),
        _endurance_table(endurance),
        _detection_table(detections),
    )
    return "\n\n".join("\n".join(lines) for lines in parts) + "\n"


def _verdict_table(title: str, found: Mapping[str, Iterable[Judgement]]) -> list[str]:
    """Give the number of scenes of each verdict in every row."""
    lines = [f"| {title} | " + " | ".join(StabilityVerdict) + " |", "|---|" + "---|" * len(StabilityVerdict)]
    for name, row in found.items():
        count = Counter(judgement.verdict for judgement in row)
        lines.append(f"| {name} | " + " | ".join(str(count[verdict]) for verdict in StabilityVerdict) + " |")
    return lines


def random_scene_tables(found: Mapping[str, Sequence[Judgement]]) -> str:
    """Give the verdicts of each box or kind, the errors, and every scene that was wrong."""
    lines = [*_verdict_table("box", found), "", "| box | compared | error, median | worst |", "|---|---|---|---|"]
    for box, row in found.items():
        errors = [abs(judgement.error) for judgement in row if judgement.error is not None]
        if errors:
            lines.append(f"| {box} | {len(errors)} | {np.median(errors):.1e} | {max(errors):.1e} |")
    wrong = [judgement for row in found.values() for judgement in row if judgement.verdict == StabilityVerdict.WRONG]
    lines += ["", *(f"wrong: {judgement}" for judgement in wrong)]
    return "\n".join(lines).rstrip() + "\n"


def _small_packing_table(found: Sequence[Judgement]) -> list[str]:
    """Give the verdict of each small packing in each regime."""
    lines = [f"| stress, Pa | friction | content % | {' | '.join(REGIMES)} |", "|---|---|---|" + "---|" * len(REGIMES)]
    rows: dict[tuple[float, float, float], dict[str, str]] = {}
    for judgement in found:
        scene = judgement.scene
        if isinstance(scene, Packed):
            key = (scene.stress, scene.friction, scene.content)
            rows.setdefault(key, {})[scene.regime] = _describe_judgement(judgement)
    for key, row in rows.items():
        place = " | ".join(f"{number:g}" for number in key)
        lines.append(f"| {place} | " + " | ".join(row.get(regime, "") for regime in REGIMES) + " |")
    return lines


def _describe_judgement(judgement: Judgement) -> str:
    """Give the velocity and its error, or the verdict and the start of its reason."""
    if judgement.verdict == StabilityVerdict.STABLE and judgement.vs is not None:
        return f"{judgement.vs:.3g} m/s" + (f" ({judgement.error:+.1e})" if judgement.error is not None else "")
    # Of "amplitude = 1: unbalanced forces ..., more than ..." the cause is wanted, of others the first clause.
    clauses = judgement.reason.split(": ")
    return f"{judgement.verdict}: {clauses[1 if ' = ' in clauses[0] else 0].split(',')[0]}"


def _limit_table(limits: Mapping[float, Sequence[Limits]]) -> list[str]:
    """Give predicted over true time-step limit for bare, partly and fully bonded scenes."""
    lines = ["| stiffness contrast | bare | 30 % of the capacity | fully bonded |", "|---|---|---|---|"]
    for contrast, row in limits.items():
        lines.append(f"| {contrast:g} | " + " | ".join(f"{limit.ratio:.2f}" for limit in row) + " |")
    return lines


def _endurance_table(rows: Iterable[Endurance]) -> list[str]:
    """Give what long runs do in each regime."""
    lines = [
        (
            "| regime | steps | energy without damping, largest change over kinetic | left alone, motion over overlap "
            "| stored and continued |"
        ),
        "|---|---|---|---|---|",
    ]
    for row in rows:
        same = "same bits" if row.restarted else "other bits"
        lines.append(f"| {row.regime} | {row.steps} | {row.drift:.1e} | {row.residual_motion:.1e} | {same} |")
    return lines


def _detection_table(rows: Iterable[Detection]) -> list[str]:
    """Give the steps until a forced step is found out."""
    lines = ["| step over the true limit | regime | ended after steps | steps between looks | reason |"]
    lines.append("|---|---|---|---|---|")
    for row in rows:
        steps = "not ended" if row.steps is None else str(row.steps)
        lines.append(f"| {row.factor:g} | {row.regime} | {steps} | {row.looks} | {row.problem or '-'} |")
    return lines


@apply_style
def _draw_maps(found: Mapping[str, Sequence[Judgement]]) -> "Figure":
    """Draw one row of marks for each regime along each quantity."""
    rows = -(-len(found) // _PANELS_ACROSS)
    figure = new_figure(1.6 * rows)
    panels = figure.subplots(rows, _PANELS_ACROSS, squeeze=False).ravel()
    for axes, (name, row) in zip(panels, found.items(), strict=False):
        for judgement in row:
            if isinstance(judgement.scene, Extreme):
                place = WALKS[name].index(getattr(judgement.scene, name)), REGIMES.index(judgement.scene.regime)
                axes.plot(*place, "s", color=_COLOURS[judgement.verdict], markersize=6)
        axes.set_xticks(range(len(WALKS[name])), [f"{value:g}" for value in WALKS[name]], fontsize=6)
        axes.set_yticks(range(len(REGIMES)), REGIMES, fontsize=7)
        axes.set(ylim=(-0.6, len(REGIMES) - 0.4), xlabel=_AXIS_LABELS[name], ylabel="regime")
    letter_panels(panels[: len(found)])
    for axes in panels[len(found) :]:
        axes.set_axis_off()
    handles = [panels[0].plot([], [], "s", color=colour, label=verdict)[0] for verdict, colour in _COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure


_CONTRASTS = (1.0, 1e2, 1e4, 1e6)
_FILLINGS = (0.0, 0.3, 1.0)  # part of the contacts' capacity for cement
_PROGRESS = 64  # drawn scenes between two words


@dataclass(frozen=True, slots=True)
class _Maps:
    """What the maps gave.

    Attributes
    ----------
    walks
        Verdicts along each quantity, by its name.
    packings
        Verdicts on small packings.
    limits
        Time-step limits by stiffness contrast, for bare, partly and fully bonded scenes.
    endurance
        Long runs.
    detections
        Runs with a forced step.
    """

    walks: dict[str, tuple[Judgement, ...]]
    packings: tuple[Judgement, ...]
    limits: dict[float, tuple[Limits, ...]]
    endurance: tuple[Endurance, ...]
    detections: tuple[Detection, ...]


def stability(
    *,
    out: Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[str, dict[str, Any]]:
    """Map what is stable, refused and detected: tables, and the same for programs.

    ``out`` takes ``stability.png``, ``.md`` and ``.json``.
    """
    found = _Maps(
        walks=walks(progress=progress),
        packings=packing_map(progress=progress),
        limits={contrast: _limits_at(contrast) for contrast in _CONTRASTS},
        endurance=endurance(),
        detections=detections(),
    )
    text = _stability_tables(found.walks, found.packings, found.limits, found.endurance, found.detections)
    if out is not None:
        save(_draw_maps(found.walks), out, "stability", ("png",))
        write_text_atomically(out / "stability.md", text)
        write_text_atomically(out / "stability.json", json.dumps(asdict(found), indent=1))
    return text, asdict(found)


def _limits_at(contrast: float) -> tuple[Limits, ...]:
    """Predicted and true limits of bare, partly and fully bonded scenes."""
    return tuple(limits(Extreme(contrast=contrast, content=content)) for content in _FILLINGS)


def random_scenes(
    count: int,
    draw: int,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, list[Judgement]]:
    """Judge scenes drawn at random from each of the `scenes.BOXES`, and scenes of one's own of all kinds.

    Parameters
    ----------
    count
        Of the scenes of each box, and of one's own.
    draw
        Seed of the draw; another one draws other scenes.
    progress
        Told what is done.

    Returns
    -------
    dict
        Verdicts by box or kind, for `random_scene_tables`.
    """
    found: dict[str, list[Judgement]] = {}
    for box in BOXES:
        found[box] = []
        for scene in draw_scenes(count, draw, box):
            found[box].append(judge_scene(scene))
            if len(found[box]) % _PROGRESS == 0:
                progress(f"{box}: {len(found[box])} of {count}")
    for own in draw_own_scenes(count, draw):
        found.setdefault(own.kind, []).append(judge_own_scene(own))
    return found
