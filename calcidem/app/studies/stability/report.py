"""Verdicts, limits, long runs and detections as Markdown tables."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from calcidem.app.studies.stability.detection import Detection
from calcidem.app.studies.stability.endurance import Endurance
from calcidem.app.studies.stability.limits import Limits
from calcidem.app.studies.stability.packings import Packed
from calcidem.app.studies.stability.scenes import REGIMES
from calcidem.app.studies.stability.verdict import Judgement, Verdict


def tables(
    walks: Mapping[str, Sequence[Judgement]],
    packings: Sequence[Judgement],
    limits: Mapping[float, Sequence[Limits]],
    endurance: Sequence[Endurance],
    detections: Sequence[Detection],
) -> str:
    """Give all tables of the maps."""
    parts = (
        verdict_table("quantity", walks),
        packing_table(packings),
        limit_table(limits),
        endurance_table(endurance),
        detection_table(detections),
    )
    return "\n\n".join("\n".join(lines) for lines in parts) + "\n"


def verdict_table(title: str, found: Mapping[str, Iterable[Judgement]]) -> list[str]:
    """Give the number of scenes of each verdict in every row."""
    lines = [f"| {title} | " + " | ".join(Verdict) + " |", "|---|" + "---|" * len(Verdict)]
    for name, row in found.items():
        count = Counter(judgement.verdict for judgement in row)
        lines.append(f"| {name} | " + " | ".join(str(count[verdict]) for verdict in Verdict) + " |")
    return lines


def draw_tables(found: Mapping[str, Sequence[Judgement]]) -> str:
    """Give the verdicts of each box, the errors of the velocities, and every scene that was wrong."""
    lines = [*verdict_table("box", found), "", "| box | velocities | error, median | worst |", "|---|---|---|---|"]
    for box, row in found.items():
        errors = [abs(judgement.error) for judgement in row if judgement.error is not None]
        if errors:
            lines.append(f"| {box} | {len(errors)} | {np.median(errors):.1e} | {max(errors):.1e} |")
    wrong = [judgement for row in found.values() for judgement in row if judgement.verdict == Verdict.WRONG]
    lines += ["", *(f"wrong: {judgement}" for judgement in wrong)]
    return "\n".join(lines).rstrip() + "\n"


def packing_table(found: Sequence[Judgement]) -> list[str]:
    """Give the verdict of each small packing in each regime."""
    lines = [f"| stress, Pa | friction | content % | {' | '.join(REGIMES)} |", "|---|---|---|" + "---|" * len(REGIMES)]
    rows: dict[tuple[float, float, float], dict[str, str]] = {}
    for judgement in found:
        scene = judgement.scene
        if isinstance(scene, Packed):
            key = (scene.stress, scene.friction, scene.content)
            rows.setdefault(key, {})[scene.regime] = described(judgement)
    for key, row in rows.items():
        place = " | ".join(f"{number:g}" for number in key)
        lines.append(f"| {place} | " + " | ".join(row.get(regime, "") for regime in REGIMES) + " |")
    return lines


def described(judgement: Judgement) -> str:
    """Give the velocity and its error, or the verdict and the start of its reason."""
    if judgement.verdict == Verdict.STABLE and judgement.vs is not None:
        return f"{judgement.vs:.3g} m/s" + (f" ({judgement.error:+.1e})" if judgement.error is not None else "")
    # Of "amplitude = 1: unbalanced forces ..., more than ..." the cause is wanted, of others the first clause.
    clauses = judgement.reason.split(": ")
    return f"{judgement.verdict}: {clauses[1 if ' = ' in clauses[0] else 0].split(',')[0]}"


def limit_table(limits: Mapping[float, Sequence[Limits]]) -> list[str]:
    """Give predicted over true time-step limit for bare, partly and fully bonded scenes."""
    lines = ["| stiffness contrast | bare | 30 % of the capacity | fully bonded |", "|---|---|---|---|"]
    for contrast, row in limits.items():
        lines.append(f"| {contrast:g} | " + " | ".join(f"{limit.ratio:.2f}" for limit in row) + " |")
    return lines


def endurance_table(rows: Iterable[Endurance]) -> list[str]:
    """Give what long runs do in each regime."""
    lines = [
        (
            "| regime | steps | energy without damping, largest change over kinetic | left alone, motion over overlap "
            "| stored and gone on with |"
        ),
        "|---|---|---|---|---|",
    ]
    for row in rows:
        same = "same bits" if row.restarted else "other bits"
        lines.append(f"| {row.regime} | {row.steps} | {row.drift:.1e} | {row.unrest:.1e} | {same} |")
    return lines


def detection_table(rows: Iterable[Detection]) -> list[str]:
    """Give the steps until a forced step is found out."""
    lines = ["| step over the true limit | regime | ended after steps | steps between looks | reason |"]
    lines.append("|---|---|---|---|---|")
    for row in rows:
        steps = "not ended" if row.steps is None else str(row.steps)
        lines.append(f"| {row.factor:g} | {row.regime} | {steps} | {row.looks} | {row.problem or '-'} |")
    return lines
