"""Command `calcidem stability`: runs and judges extreme scenes, along each quantity, in small packings and at random.

The results are Markdown tables and a figure of the verdicts.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calcidem.analysis.figures.style import BLUE, GREY, ORANGE, VERMILION, apply_style, letter_panels, new_figure, save
from calcidem.app.studies.accuracy.reference import signal_distance
from calcidem.app.studies.stability.limits import Detection, Endurance, Limits, detections, endurance
from calcidem.app.studies.stability.own_scenes import OWN_TOLERANCE, OwnScene
from calcidem.app.studies.stability.scenes import (
    BOXES,
    CONTENTS,
    FRICTIONS,
    QUANTITIES,
    REGIMES,
    STRESSES,
    Extreme,
    Packed,
    small_packing,
)
from calcidem.app.studies.tables import markdown_table, number
from calcidem.dem.engine.scene import Regime
from calcidem.dem.engine.step_control import UnstableRunError
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement, Outcome, measure
from calcidem.storage.files import write_text_atomically

_TOLERANCE = 0.05  # relative error of Vs above which a velocity is wrong, unless the cell states a larger error
_FINER = 4  # factor of the smaller step and denser samples in the deciding run
_ALIKE = 0.1
"""Distance of two signals (`signal_distance`) below which a pick in only one of them is a borderline case."""


class StabilityVerdict(StrEnum):
    """Verdict on a scene."""

    STABLE = "stable"
    REFUSED = "refused beforehand"
    DETECTED = "detected during the run"
    WRONG = "silently wrong"


@dataclass(frozen=True, slots=True)
class _Judgement:
    """Judgement of one scene."""

    scene: Extreme | Packed | OwnScene
    verdict: StabilityVerdict
    reason: str = ""
    """Reason in words."""
    vs: float | None = None
    """Velocity, m/s; None if there is none."""
    error: float | None = None
    """True relative error, or that of `OwnScene.error`; None if unknown."""


def _judge_scene(scene: Extreme) -> _Judgement:
    """Run a scene as a user would; if it gives a velocity, repeat it longer with a much smaller step."""
    return _judge_experiment(scene, scene.experiment)


def _judge_packing(scene: Packed, experiment: Experiment) -> _Judgement:
    """Judge a real packing; the deciding run is in the finite regime, which neglects nothing."""
    return _judge_experiment(scene, lambda: (experiment, scene.content), regime="finite")


def _judge_own_scene(scene: OwnScene) -> _Judgement:
    """Run a user-defined scene and compare its error with the tolerance."""
    try:
        error = scene.error()
    except ValueError as refusal:
        return _Judgement(scene, StabilityVerdict.REFUSED, str(refusal))
    except UnstableRunError as end:
        return _Judgement(scene, StabilityVerdict.DETECTED, str(end))
    right = error <= OWN_TOLERANCE
    return _Judgement(scene, StabilityVerdict.STABLE if right else StabilityVerdict.WRONG, error=error)


def _judge_experiment(
    scene: Extreme | Packed, make: Callable[[], tuple[Experiment, float]], regime: Regime | None = None
) -> _Judgement:
    """Run the experiment and content (percent) of ``make``; ``regime`` overrides that of the finer run."""

    def measured(experiment: Experiment) -> Measurement:
        return measure(experiment, content, [scene.seed], lanes=1)[0]

    try:
        experiment, content = make()
        found = measured(experiment)
    except ValueError as error:
        return _Judgement(scene, StabilityVerdict.REFUSED, str(error))
    if found.result.outcome != Outcome.DONE or found.vs is None:
        return _Judgement(scene, StabilityVerdict.DETECTED, found.result.reason)
    finer = replace(
        experiment.wave,
        step_fraction=experiment.wave.step_fraction / _FINER,
        samples_per_period=experiment.wave.samples_per_period * _FINER,
        slowest=experiment.wave.slowest / 2.0,
        regime=regime or scene.regime,
    )
    try:
        exact = measured(replace(experiment, wave=finer))
    except ValueError as error:  # the packing creeps too much for the deciding regime
        return _Judgement(scene, StabilityVerdict.REFUSED, f"without a reference: {error}")
    if exact.vs is None:
        distance = signal_distance(found.record, exact.record)
        reason, error_of_vs = f"{exact.result.reason} with a smaller step, signals {distance:.2g} apart", None
        right = distance < _ALIKE
    else:
        reason, error_of_vs = found.record.retry, found.vs / exact.vs - 1.0
        # The bound covers the neglect of a regime; 5 % cover the effect of a step on a reading.
        tolerance = 0.0 if experiment.wave.regime == "linear" and isinstance(scene, Packed) else _TOLERANCE
        right = abs(error_of_vs) <= max(tolerance, found.result.error.bound if found.result.error else 0.0)
    verdict = StabilityVerdict.STABLE if right else StabilityVerdict.WRONG
    return _Judgement(scene, verdict, reason, found.vs, error_of_vs)


def _walks(progress: Callable[[str], None] = lambda _: None) -> dict[str, tuple[_Judgement, ...]]:
    """Judge scenes along each quantity, in all regimes."""
    found = {}
    for name, quantity in QUANTITIES.items():
        progress(name)
        changes: list[dict[str, Any]] = [{name: value, "regime": each} for value in quantity.walk for each in REGIMES]
        scenes = [replace(quantity.base, **changed) for changed in changes]
        found[name] = tuple(_judge_scene(scene) for scene in scenes)
    return found


def _packing_map(
    stresses: Iterable[float] = STRESSES, progress: Callable[[str], None] = lambda _: None
) -> tuple[_Judgement, ...]:
    """Judge samples of small packings from nearly unjammed to well compressed, bare and cemented, in all regimes."""
    found = []
    for stress in stresses:
        for friction in FRICTIONS:
            progress(f"packing under {stress:g} Pa, friction {friction:g}")
            packing = small_packing(stress, friction)
            scenes = [Packed(stress, friction, content, regime) for content in CONTENTS for regime in REGIMES]
            found += [_judge_packing(scene, scene.experiment(packing)) for scene in scenes]
    return tuple(found)


_COLOURS = {
    StabilityVerdict.STABLE: BLUE,
    StabilityVerdict.REFUSED: GREY,
    StabilityVerdict.DETECTED: ORANGE,
    StabilityVerdict.WRONG: VERMILION,
}
_PANELS_ACROSS = 2
_CONTRASTS = (1.0, 1e2, 1e4, 1e6)
_FILLINGS = (0.0, 0.3, 1.0)  # parts of the contacts' capacity for cement
_PROGRESS = 64  # drawn scenes between two messages


@dataclass(frozen=True, slots=True)
class _Maps:
    """Results of the maps."""

    walks: dict[str, tuple[_Judgement, ...]]
    """Verdicts along each quantity, by its name."""
    packings: tuple[_Judgement, ...]
    """Verdicts on small packings."""
    limits: dict[float, tuple[Limits, ...]]
    """Time-step limits by stiffness contrast, for bare, partly and fully bonded scenes."""
    endurance: tuple[Endurance, ...]
    """Long runs."""
    detections: tuple[Detection, ...]
    """Runs with a forced step."""


def _tables(found: _Maps) -> str:
    """Return all tables of the maps."""
    parts = (
        _verdict_table("quantity", found.walks),
        _small_packing_table(found.packings),
        markdown_table(
            ("stiffness contrast", "bare", "30 % of the capacity", "fully bonded"),
            [(f"{contrast:g}", *(f"{one.ratio:.2f}" for one in row)) for contrast, row in found.limits.items()],
        ),
        markdown_table(
            (
                *("regime", "steps", "energy without damping, largest change over kinetic"),
                *("left alone, motion over overlap", "stored and continued"),
            ),
            [
                (
                    row.regime,
                    f"{row.steps}",
                    number(row.drift),
                    number(row.residual_motion),
                    "same bits" if row.restarted else "other bits",
                )
                for row in found.endurance
            ],
        ),
        markdown_table(
            ("step over the true limit", "regime", "ended after steps", "steps between looks", "reason"),
            [
                (
                    f"{row.factor:g}",
                    row.regime,
                    "not ended" if row.steps is None else f"{row.steps}",
                    f"{row.looks}",
                    row.problem or "-",
                )
                for row in found.detections
            ],
        ),
    )
    return "\n\n".join(parts) + "\n"


def _verdict_table(title: str, found: Mapping[str, Iterable[_Judgement]]) -> str:
    """Return the number of scenes of each verdict in every row."""
    counts = {name: Counter(judgement.verdict for judgement in row) for name, row in found.items()}
    rows = [(name, *(f"{count[verdict]}" for verdict in StabilityVerdict)) for name, count in counts.items()]
    return markdown_table((title, *StabilityVerdict), rows)


def _random_tables(found: Mapping[str, Sequence[_Judgement]]) -> str:
    """Return the verdicts of each box or kind, the errors, and every scene that was wrong."""
    known = {
        box: [abs(judgement.error) for judgement in row if judgement.error is not None] for box, row in found.items()
    }
    errors = [
        (box, f"{len(row)}", number(float(np.median(row))), number(max(row))) for box, row in known.items() if row
    ]
    parts = [_verdict_table("box", found), markdown_table(("box", "compared", "error, median", "worst"), errors)]
    wrong = [judgement for row in found.values() for judgement in row if judgement.verdict == StabilityVerdict.WRONG]
    parts.append("\n".join(f"wrong: {judgement}" for judgement in wrong))
    return "\n\n".join(part for part in parts if part) + "\n"


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
    if judgement.verdict == StabilityVerdict.STABLE and judgement.vs is not None:
        return f"{judgement.vs:.3g} m/s" + (f" ({judgement.error:+.1e})" if judgement.error is not None else "")
    # "amplitude = 1: unbalanced forces ..., more than ..." has its cause second, other reasons have it first.
    clauses = judgement.reason.split(": ")
    return f"{judgement.verdict}: {clauses[1 if ' = ' in clauses[0] else 0].split(',')[0]}"


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


def stability(
    *,
    out: Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[str, dict[str, Any]]:
    """Map stable, refused and detected scenes: tables, and the same results for programs.

    ``out`` receives ``stability.png``, ``.md`` and ``.json``.
    """
    found = _Maps(
        walks=_walks(progress),
        packings=_packing_map(progress=progress),
        limits={
            contrast: tuple(Limits.of_scene(Extreme(contrast=contrast, content=content)) for content in _FILLINGS)
            for contrast in _CONTRASTS
        },
        endurance=endurance(),
        detections=detections(),
    )
    text = _tables(found)
    if out is not None:
        save(_draw_maps(found.walks), out, "stability", ("png",))
        write_text_atomically(out / "stability.md", text)
        write_text_atomically(out / "stability.json", json.dumps(asdict(found), indent=1))
    return text, asdict(found)


def random_scenes(
    count: int,
    draw: int,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[str, dict[str, Any]]:
    """Judge ``count`` scenes drawn at random from each of the `BOXES`, and as many own scenes of all kinds.

    ``draw`` is the seed of the draw. Returns tables, and the judgements by box or kind for programs.
    """
    found: dict[str, list[_Judgement]] = {}
    for box in BOXES:
        found[box] = []
        for scene in Extreme.draw(count, draw, box):
            found[box].append(_judge_scene(scene))
            if len(found[box]) % _PROGRESS == 0:
                progress(f"{box}: {len(found[box])} of {count}")
    for own in OwnScene.draw(count, draw):
        found.setdefault(own.kind, []).append(_judge_own_scene(own))
    return _random_tables(found), {box: [asdict(judgement) for judgement in row] for box, row in found.items()}
