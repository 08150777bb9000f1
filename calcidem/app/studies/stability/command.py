"""The command `calcidem stability`: maps of extreme scenes, scenes drawn at random, limits, long runs, detection."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from calcidem.analysis.figures.style import save
from calcidem.app.studies.stability.endurance import Endurance, endurance
from calcidem.app.studies.stability.limits import Detection, Limits, detections, limits
from calcidem.app.studies.stability.own_scenes import draw_own_scenes
from calcidem.app.studies.stability.report import draw_maps, stability_tables
from calcidem.app.studies.stability.scenes import BOXES, Extreme, draw_scenes
from calcidem.app.studies.stability.verdict import Judgement, judge_own_scene, judge_scene, packing_map, walks
from calcidem.storage.files import write_text_atomically

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
    text = stability_tables(found.walks, found.packings, found.limits, found.endurance, found.detections)
    if out is not None:
        save(draw_maps(found.walks), out, "stability", ("png",))
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
