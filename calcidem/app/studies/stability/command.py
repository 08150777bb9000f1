"""Command `calcidem stability`: runs and judges extreme scenes, along each quantity, in small packings and at random.

The results are Markdown tables and a figure of the verdicts.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calcidem.analysis.figures.style import BLUE, GREY, ORANGE, VERMILION, apply_style, letter_panels, new_figure
from calcidem.app.studies.cells import signal_distance
from calcidem.app.studies.results import StudyResult, markdown_table
from calcidem.app.studies.stability.limits import Limits, detections, endurance
from calcidem.app.studies.stability.own_scenes import OWN_TOLERANCE, OwnScene
from calcidem.app.studies.stability.scenes import BOXES, QUANTITIES, REGIMES, Extreme, Packed
from calcidem.dem.engine.step_control import UnstableRunError
from calcidem.dem.wave.measurement import measure

_TOLERANCE = 0.05  # relative error of Vs above which a velocity is wrong, unless the cell states a larger error
_FINER = 4  # factor of the smaller step and denser samples in the deciding run
_ALIKE = 0.1
"""Distance of two signals (`signal_distance`) below which a pick in only one of them is a borderline case."""
_CONTRASTS = (1.0, 1e2, 1e4, 1e6)
_FILLINGS = (0.0, 0.3, 1.0)  # parts of the contacts' capacity for cement
_PROGRESS = 64  # scenes between two messages

_AnyScene = Extreme | Packed | OwnScene


class _StabilityVerdict(StrEnum):
    """Verdict on a scene."""

    STABLE = "stable"
    REFUSED = "refused beforehand"
    DETECTED = "detected during the run"
    WRONG = "silently wrong"


@dataclass(frozen=True, slots=True)
class _Judgement:
    """Judgement of one scene."""

    scene: _AnyScene
    verdict: _StabilityVerdict
    reason: str = ""
    """Reason in words."""
    vs: float | None = None
    """Velocity, m/s; None if there is none."""
    error: float | None = None
    """True relative error, or that of `OwnScene.error`; None if unknown."""


def stability(progress: Callable[[str], None] = lambda _: None) -> StudyResult:
    """Map stable, refused and detected scenes: along each quantity and in small packings, in all regimes.

    The small packings are nearly unjammed to well compressed, bare and cemented. Limits of the time step, long runs and
    runs with a forced step come with them.
    """
    walks = _judge_all(Extreme.along_quantities(), progress)
    packed = _judge_all(Packed.samples(), progress)
    packings = [judgement for row in packed.values() for judgement in row]
    by_contrast = {
        contrast: [Limits.of_scene(Extreme(contrast=contrast, content=content)) for content in _FILLINGS]
        for contrast in _CONTRASTS
    }
    long_runs, forced = endurance(), detections()
    tables = (
        _verdict_table("quantity", walks),
        _small_packing_table(packings),
        markdown_table(
            ("stiffness contrast", "bare", "30 % of the capacity", "fully bonded"),
            [(f"{contrast:g}", *(f"{one.ratio:.2f}" for one in row)) for contrast, row in by_contrast.items()],
        ),
        markdown_table(
            (
                *("regime", "steps", "energy without damping, largest change over kinetic"),
                *("left alone, motion over overlap", "stored and continued"),
            ),
            [
                (row.regime, row.steps, row.drift, row.residual_motion, f"{'same' if row.restarted else 'other'} bits")
                for row in long_runs
            ],
        ),
        markdown_table(
            ("step over the true limit", "regime", "ended after steps", "steps between looks", "reason"),
            [
                (
                    f"{row.factor:g}",
                    row.regime,
                    "not ended" if row.steps is None else row.steps,
                    row.looks,
                    row.problem or "-",
                )
                for row in forced
            ],
        ),
    )
    others = {"packings": packings, "limits": by_contrast, "endurance": long_runs, "detections": forced}
    return _result(tables, "quantity", walks, others, {"": partial(_draw_maps, walks)})


def random_scenes(count: int, draw: int, progress: Callable[[str], None] = lambda _: None) -> StudyResult:
    """Judge ``count`` scenes drawn at random from each of the `BOXES`, and as many own scenes of all kinds.

    ``draw`` is the seed of the draw. The tables have the verdicts of each box or kind, the errors, and every scene that
    was wrong.
    """
    scenes: dict[str, list[_AnyScene]] = {box: [*Extreme.draw(count, draw, box)] for box in BOXES}
    for own in OwnScene.draw(count, draw):
        scenes.setdefault(own.kind, []).append(own)
    found = _judge_all(scenes, progress)
    known = {box: [abs(one.error) for one in row if one.error is not None] for box, row in found.items()}
    errors = [(box, len(row), float(np.median(row)), max(row)) for box, row in known.items() if row]
    wrong = [one for row in found.values() for one in row if one.verdict == _StabilityVerdict.WRONG]
    tables = (
        _verdict_table("box", found),
        markdown_table(("box", "compared", "error, median", "worst"), errors),
        "\n".join(f"wrong: {judgement}" for judgement in wrong),
    )
    return _result(tables, "box", found)


def _judge_all(
    scenes: Mapping[str, Sequence[_AnyScene]], progress: Callable[[str], None]
) -> dict[str, tuple[_Judgement, ...]]:
    """Judge groups of scenes."""
    found = {}
    for name, group in scenes.items():
        judgements = []
        for number, scene in enumerate(group):
            if number % _PROGRESS == 0:
                progress(f"{name}: {number} of {len(group)} scenes")
            judgements.append(_judge_scene(scene))
        found[name] = tuple(judgements)
    return found


def _result(
    tables: Iterable[str],
    title: str,
    found: Mapping[str, Sequence[_Judgement]],
    others: Mapping[str, Any] | None = None,
    figures: Mapping[str, Callable[[], Figure]] | None = None,
) -> StudyResult:
    """Result of a study of scenes; ``title`` is the name of their groups in its rows."""
    groups = {name: [asdict(judgement) for judgement in row] for name, row in found.items()}
    whole = groups if others is None else {"walks": groups, **others}
    return StudyResult(
        text="\n\n".join(table for table in tables if table) + "\n",
        rows=[{title: name, **judgement} for name, row in groups.items() for judgement in row],
        json=json.dumps(whole, indent=1, default=asdict),
        figures=figures or {},
        is_wrong=any(one.verdict == _StabilityVerdict.WRONG for row in found.values() for one in row),
    )


def _judge_scene(scene: _AnyScene) -> _Judgement:
    """Run a scene as a user would, and compare its error with the tolerance."""
    if not isinstance(scene, OwnScene):
        return _judge_wave_scene(scene)
    try:
        error = scene.error()
    except ValueError as refusal:
        return _Judgement(scene, _StabilityVerdict.REFUSED, str(refusal))
    except UnstableRunError as end:
        return _Judgement(scene, _StabilityVerdict.DETECTED, str(end))
    right = error <= OWN_TOLERANCE
    return _Judgement(scene, _StabilityVerdict.STABLE if right else _StabilityVerdict.WRONG, error=error)


def _judge_wave_scene(scene: Extreme | Packed) -> _Judgement:
    """Run a scene; if it gives a velocity, repeat it longer with a much smaller step.

    The deciding run of a packing is in the finite regime, which neglects nothing.
    """
    try:
        experiment, content = scene.experiment()
        (found,) = measure(experiment, content, [scene.seed], lanes=1)
    except ValueError as error:
        return _Judgement(scene, _StabilityVerdict.REFUSED, str(error))
    if found.vs is None:
        return _Judgement(scene, _StabilityVerdict.DETECTED, found.reason)
    finer = replace(
        experiment.wave,
        step_fraction=experiment.wave.step_fraction / _FINER,
        samples_per_period=experiment.wave.samples_per_period * _FINER,
        slowest=experiment.wave.slowest / 2.0,
        regime="finite" if isinstance(scene, Packed) else scene.regime,
    )
    try:
        (exact,) = measure(replace(experiment, wave=finer), content, [scene.seed], lanes=1)
    except ValueError as error:  # the packing creeps too much for the deciding regime
        return _Judgement(scene, _StabilityVerdict.REFUSED, f"without a reference: {error}")
    if exact.vs is None:
        distance = signal_distance(found.section, exact.section)
        reason, error_of_vs = f"{exact.reason} with a smaller step, signals {distance:.2g} apart", None
        right = distance < _ALIKE
    else:
        reason, error_of_vs = found.section.retry, found.vs / exact.vs - 1.0
        # The bound covers the neglect of a regime; 5 % cover the effect of a step on a reading.
        tolerance = 0.0 if experiment.wave.regime == "linear" and isinstance(scene, Packed) else _TOLERANCE
        right = abs(error_of_vs) <= max(tolerance, found.error_bound or 0.0)
    verdict = _StabilityVerdict.STABLE if right else _StabilityVerdict.WRONG
    return _Judgement(scene, verdict, reason, found.vs, error_of_vs)


def _verdict_table(title: str, found: Mapping[str, Iterable[_Judgement]]) -> str:
    """Return the number of scenes of each verdict in every row."""
    counts = {name: Counter(judgement.verdict for judgement in row) for name, row in found.items()}
    rows = [(name, *(count[verdict] for verdict in _StabilityVerdict)) for name, count in counts.items()]
    return markdown_table((title, *_StabilityVerdict), rows)


def _small_packing_table(found: Sequence[_Judgement]) -> str:
    """Return the verdict of each small packing in each regime."""
    rows: dict[tuple[float, float, float], dict[str, str]] = {}
    for judgement in found:
        scene = judgement.scene
        if isinstance(scene, Packed):
            key = (scene.stress, scene.friction, scene.content)
            rows.setdefault(key, {})[scene.regime] = _describe_judgement(judgement)
    return markdown_table(
        ("stress, Pa", "friction", "content %", *REGIMES),
        [(*(f"{value:g}" for value in key), *(row.get(regime, "") for regime in REGIMES)) for key, row in rows.items()],
    )


def _describe_judgement(judgement: _Judgement) -> str:
    """Return the velocity and its error, or the verdict and the start of its reason."""
    if judgement.verdict == _StabilityVerdict.STABLE and judgement.vs is not None:
        return f"{judgement.vs:.3g} m/s" + (f" ({judgement.error:+.1e})" if judgement.error is not None else "")
    # "amplitude = 1: unbalanced forces ..., more than ..." has its cause second, other reasons have it first.
    clauses = judgement.reason.split(": ")
    return f"{judgement.verdict}: {clauses[1 if ' = ' in clauses[0] else 0].split(',')[0]}"


_COLOURS = {
    _StabilityVerdict.STABLE: BLUE,
    _StabilityVerdict.REFUSED: GREY,
    _StabilityVerdict.DETECTED: ORANGE,
    _StabilityVerdict.WRONG: VERMILION,
}
_PANELS_ACROSS = 2


@apply_style
def _draw_maps(found: Mapping[str, Sequence[_Judgement]]) -> "Figure":
    """Draw one row of marks for each regime along each quantity."""
    rows = -(-len(found) // _PANELS_ACROSS)
    figure = new_figure(1.6 * rows)
    panels = figure.subplots(rows, _PANELS_ACROSS, squeeze=False).ravel()
    for axes, (name, row) in zip(panels, found.items(), strict=False):
        quantity = QUANTITIES[name]
        for judgement in row:
            if isinstance(judgement.scene, Extreme):
                place = quantity.walk.index(getattr(judgement.scene, name)), REGIMES.index(judgement.scene.regime)
                axes.plot(*place, "s", color=_COLOURS[judgement.verdict], markersize=6)
        axes.set_xticks(range(len(quantity.walk)), [f"{value:g}" for value in quantity.walk], fontsize=6)
        axes.set_yticks(range(len(REGIMES)), REGIMES, fontsize=7)
        axes.set(ylim=(-0.6, len(REGIMES) - 0.4), xlabel=quantity.label, ylabel="regime")
    letter_panels(panels[: len(found)])
    for axes in panels[len(found) :]:
        axes.set_axis_off()
    handles = [panels[0].plot([], [], "s", color=colour, label=verdict)[0] for verdict, colour in _COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure
