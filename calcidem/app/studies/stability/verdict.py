"""Runs an extreme scene and says what became of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

from calcidem.app.studies.accuracy.reference import signal_distance
from calcidem.app.studies.stability.packings import Packed
from calcidem.app.studies.stability.scenes import Extreme, content_of, experiment_of
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement, Outcome, measure

TOLERANCE = 0.05  # relative error of Vs beyond which a number is wrong, unless the cell itself states more
FINER = 4  # times smaller step, and denser samples, of the run that decides
ALIKE = 0.1
"""Distance of two signals (`signal_distance`) up to which a pick that only one of them gives is a close call."""


class Verdict(StrEnum):
    """What became of a scene."""

    STABLE = "stable"
    REFUSED = "refused beforehand"
    DETECTED = "detected during the run"
    WRONG = "silently wrong"


@dataclass(frozen=True, slots=True)
class Judgement:
    """Verdict on a scene, with its reason in words, the velocity if there is one, and its true relative error."""

    scene: Extreme | Packed
    verdict: Verdict
    reason: str = ""
    vs: float | None = None
    error: float | None = None


def judge(scene: Extreme) -> Judgement:
    """Run a scene as a user would, and once more with a far smaller step, for longer, if it gave a velocity."""

    def make() -> tuple[Experiment, float]:
        experiment = experiment_of(scene)
        return experiment, content_of(scene, experiment)

    return judged(scene, make)


def judge_packed(scene: Packed, experiment: Experiment) -> Judgement:
    """Do the same on a real packing."""
    return judged(scene, lambda: (experiment, scene.content))


def judged(scene: Extreme | Packed, make: Callable[[], tuple[Experiment, float]]) -> Judgement:
    """Run what ``make`` gives: an experiment, and a content in percent."""
    try:
        experiment, content = make()
        found = measured(experiment, content, scene)
    except ValueError as error:
        return Judgement(scene, Verdict.REFUSED, str(error))
    if found.outcome != Outcome.DONE or found.vs is None:
        return Judgement(scene, Verdict.DETECTED, found.reason)
    finer = replace(
        experiment.wave,
        step_fraction=experiment.wave.step_fraction / FINER,
        samples_per_period=experiment.wave.samples_per_period * FINER,
        slowest=experiment.wave.slowest / 2.0,
    )
    return compared(scene, experiment, found, measured(replace(experiment, wave=finer), content, scene))


def measured(experiment: Experiment, content: float, scene: Extreme | Packed) -> Measurement:
    """Measure the scene's one sample."""
    return measure(experiment, content, [scene.seed], lanes=1)[0]


def compared(scene: Extreme | Packed, experiment: Experiment, found: Measurement, exact: Measurement) -> Judgement:
    """Hold a velocity against that of a far smaller step."""
    if found.vs is None or exact.vs is None:
        amplitude = experiment.wave.amplitude
        distance = signal_distance(found.record, amplitude, exact.record, amplitude)
        verdict = Verdict.STABLE if distance < ALIKE else Verdict.WRONG
        return Judgement(scene, verdict, f"{exact.reason} with a smaller step, signals {distance:.2g} apart", found.vs)
    error = found.vs / exact.vs - 1.0
    right = abs(error) <= max(TOLERANCE, found.error_estimate or 0.0)
    return Judgement(scene, Verdict.STABLE if right else Verdict.WRONG, found.record.retry, found.vs, error)
