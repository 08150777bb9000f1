"""How many steps an unstable run goes on before a guard ends it, with steps forced above the limit."""

from dataclasses import dataclass, replace

from calcidem.app.studies.stability.limits import limits
from calcidem.app.studies.stability.scenes import REGIMES, Extreme, content_of, experiment_of
from calcidem.dem.engine.scene import Regime
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.propagation import prepared

FACTORS = (0.99, 1.01, 1.05, 1.2, 2.0)  # step over the true limit


@dataclass(frozen=True, slots=True)
class Detection:
    """One run with a forced step.

    Attributes
    ----------
    factor
        Step over the true limit, that of the eigenvalues.
    regime
        See `state.start`.
    steps
        After which a guard ended it; None if none did.
    problem
        What the guard said.
    looks
        Steps between two looks of the guards.
    """

    factor: float
    regime: Regime
    steps: int | None
    problem: str
    looks: int


def detections(factors: tuple[float, ...] = FACTORS) -> tuple[Detection, ...]:
    """Force steps around the true limit in all regimes of the plain lattice."""
    return tuple(forced(factor, regime) for factor in factors for regime in REGIMES)


def forced(factor: float, regime: Regime) -> Detection:
    """Send a pulse through the plain lattice with a step that nobody could ask for."""
    scene = Extreme(regime=regime, damping=0.0)
    experiment = experiment_of(scene)
    undamped = replace(experiment.wave, boundary_damping=0.0)
    return forced_run(
        replace(experiment, wave=undamped),
        content_of(scene, experiment),
        scene.seed,
        factor,
        factor * limits(scene).true,
    )


def forced_run(experiment: Experiment, content: float, seed: int, factor: float, step: float) -> Detection:
    """Send a pulse through one sample of an experiment with any step, s."""
    bonded = experiment.ordering(seed).at(content).bonded
    packing, sand = experiment.stiffened()
    recorder = prepared(
        packing,
        sand,
        experiment.cement,
        [bonded],
        experiment.frequency(content),
        experiment.wave,
        heard_enough=lambda _: False,
        lanes=1,
        installation=experiment.installation,
        check=lambda: None,
    )
    recorder.state = replace(recorder.state, time_step=recorder.state.time_step * 0.0 + step)
    record = recorder.run(packing.width, lambda: None)[0]
    steps = record.steps if record.problem else None
    return Detection(factor, experiment.wave.regime, steps, record.problem, recorder.steps_per_look)
