"""Runs and judges extreme scenes: singly, along one quantity at a time, and in small packings."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from calcidem.app.studies.accuracy.reference import signal_distance
from calcidem.app.studies.stability.own_scenes import OWN_TOLERANCE, OwnScene, error_of_run
from calcidem.app.studies.stability.scenes import (
    CONTENTS,
    FRICTIONS,
    QUANTITIES,
    REGIMES,
    STRESSES,
    Extreme,
    Packed,
    content_of,
    experiment_of_packing,
    experiment_of_scene,
    small_packing,
)
from calcidem.dem.engine.scene import Regime
from calcidem.dem.engine.step_control import UnstableRunError
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement, Outcome, measure

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
class Judgement:
    """Judgement of one scene."""

    scene: Extreme | Packed | OwnScene
    verdict: StabilityVerdict
    reason: str = ""
    """Reason in words."""
    vs: float | None = None
    """Velocity, m/s; None if there is none."""
    error: float | None = None
    """True relative error, or that of `own_scenes.error_of_run`; None if unknown."""


def judge_scene(scene: Extreme) -> Judgement:
    """Run a scene as a user would; if it gives a velocity, repeat it longer with a much smaller step."""

    def make() -> tuple[Experiment, float]:
        experiment = experiment_of_scene(scene)
        return experiment, content_of(scene, experiment)

    return _judge_experiment(scene, make)


def _judge_packing(scene: Packed, experiment: Experiment) -> Judgement:
    """Judge a real packing; the deciding run is in the finite regime, which neglects nothing."""
    return _judge_experiment(scene, lambda: (experiment, scene.content), regime="finite")


def judge_own_scene(scene: OwnScene) -> Judgement:
    """Run a user-defined scene and compare its error with the tolerance."""
    try:
        error = error_of_run(scene)
    except ValueError as refusal:
        return Judgement(scene, StabilityVerdict.REFUSED, str(refusal))
    except UnstableRunError as end:
        return Judgement(scene, StabilityVerdict.DETECTED, str(end))
    right = error <= OWN_TOLERANCE
    return Judgement(scene, StabilityVerdict.STABLE if right else StabilityVerdict.WRONG, error=error)


def _judge_experiment(
    scene: Extreme | Packed, make: Callable[[], tuple[Experiment, float]], regime: Regime | None = None
) -> Judgement:
    """Run the experiment and content (percent) of ``make``; ``regime`` overrides that of the finer run."""

    def measured(experiment: Experiment) -> Measurement:
        return measure(experiment, content, [scene.seed], lanes=1)[0]

    try:
        experiment, content = make()
        found = measured(experiment)
    except ValueError as error:
        return Judgement(scene, StabilityVerdict.REFUSED, str(error))
    if found.result.outcome != Outcome.DONE or found.vs is None:
        return Judgement(scene, StabilityVerdict.DETECTED, found.result.reason)
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
        return Judgement(scene, StabilityVerdict.REFUSED, f"without a reference: {error}")
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
    return Judgement(scene, verdict, reason, found.vs, error_of_vs)


def walks(progress: Callable[[str], None] = lambda _: None) -> dict[str, tuple[Judgement, ...]]:
    """Judge scenes along each quantity, in all regimes."""
    found = {}
    for name, quantity in QUANTITIES.items():
        progress(name)
        changes: list[dict[str, Any]] = [{name: value, "regime": each} for value in quantity.walk for each in REGIMES]
        scenes = [replace(quantity.base, **changed) for changed in changes]
        found[name] = tuple(judge_scene(scene) for scene in scenes)
    return found


def packing_map(
    stresses: Iterable[float] = STRESSES, progress: Callable[[str], None] = lambda _: None
) -> tuple[Judgement, ...]:
    """Judge samples of small packings from nearly unjammed to well compressed, bare and cemented, in all regimes."""
    found = []
    for stress in stresses:
        for friction in FRICTIONS:
            progress(f"packing under {stress:g} Pa, friction {friction:g}")
            packing = small_packing(stress, friction)
            scenes = [Packed(stress, friction, content, regime) for content in CONTENTS for regime in REGIMES]
            found += [_judge_packing(scene, experiment_of_packing(packing, scene)) for scene in scenes]
    return tuple(found)
