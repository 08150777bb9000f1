"""Predicted and true time-step limit, and time until a run above it is ended.

The true limit follows from the eigenvalues of the kernel's actual step.
"""

from dataclasses import dataclass, replace

import numpy as np

from calcidem.app.studies.stability.scenes import REGIMES, Extreme, content_of, experiment_of_scene, scene_at_rest
from calcidem.dem.engine.leapfrog import State, no_recording, run_kernel
from calcidem.dem.engine.scene import Regime
from calcidem.dem.engine.state import choose_features, start
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.propagation import prepare_recorder

_FACTORS = (0.99, 1.01, 1.05, 1.2, 2.0)  # step over the true limit


@dataclass(frozen=True, slots=True)
class Limits:
    """Critical time steps of a scene, s: from the per-particle bound, and from the largest eigenvalue."""

    predicted: float
    true: float

    @property
    def ratio(self) -> float:
        """Predicted over true: at most 1 if the prediction is safe."""
        return self.predicted / self.true


@dataclass(frozen=True, slots=True)
class Detection:
    """One run with a forced step."""

    factor: float
    """Step over the true limit from the eigenvalues."""
    regime: Regime
    """See `state.start`."""
    steps: int | None
    """Steps after which a guard ended it; None if none did."""
    problem: str
    """Message of the guard."""
    looks: int
    """Steps between two checks by the guards."""


def limits(scene: Extreme) -> Limits:
    """Critical steps of a scene in the linear regime, both reduced by ``sqrt(1 + alpha)`` for local damping.

    All disks have the scene's damping, so the true limit is ``2 / (omega_max sqrt(1 + alpha))``.
    """
    damped, _ = scene_at_rest(replace(scene, regime="linear", step_fraction=0.8), scene.damping)
    predicted = float(start(damped, features=choose_features(damped, "linear")).critical_time_step[0])
    undamped = replace(damped, damping=0.0)
    fastest = fastest_mode(start(undamped, features=choose_features(undamped, "linear")))
    return Limits(predicted, 2.0 / (fastest * np.sqrt(1.0 + scene.damping)))


def fastest_mode(state: State) -> float:
    """Largest angular frequency of a scene in the linear regime, rad/s."""
    root = np.sqrt(inertia_of(state))
    # Rotations are scaled to make the matrix symmetric up to rounding.
    symmetric = root[:, None] * acceleration_matrix(state) / root
    return float(np.sqrt(np.linalg.eigvalsh(0.5 * (symmetric + symmetric.T))[-1]))


def inertia_of(state: State) -> Floats:
    """(3 N,) mass, mass and moment of inertia of each disk, in memory order."""
    scene = state.scene
    return np.column_stack([scene.mass, scene.mass, scene.inertia])[state.assembly.order].ravel()


def acceleration_matrix(state: State) -> Floats:
    """``M^-1 K`` of a scene in the linear regime, (3 N, 3 N) 1/s2; the state is changed.

    Its columns follow from the change of velocities in one kernel step after displacing one coordinate.
    """
    count, step = state.scene.count, float(state.time_step[0])
    matrix = np.zeros((3 * count, 3 * count))
    displacement, velocity = state.motion.displacement, state.motion.velocity
    for column in range(3 * count):
        displacement[...], velocity[...] = 0.0, 0.0
        displacement[column // 3, column % 3, 0] = 1.0
        run_kernel(state, 1, no_recording(state))
        matrix[:, column] = -velocity[:, :, 0].ravel() / step
    return matrix


def detections() -> tuple[Detection, ...]:
    """Force steps around the true limit in all regimes of the plain lattice."""
    return tuple(_force_step(factor, regime) for factor in _FACTORS for regime in REGIMES)


def _force_step(factor: float, regime: Regime) -> Detection:
    """Transmit a pulse through the plain lattice with a step that configurations do not allow."""
    scene = Extreme(regime=regime, damping=0.0)
    experiment = experiment_of_scene(scene)
    experiment = replace(experiment, wave=replace(experiment.wave, boundary_damping=0.0))
    content = content_of(scene, experiment)
    bonded = experiment.ordering(scene.seed).at(content).bonded
    recorder = prepare_recorder(experiment, [bonded], experiment.frequency(content), 1, check=lambda: None)
    step = recorder.state.time_step * 0.0 + factor * limits(scene).true
    recorder.state = replace(recorder.state, time_step=step)
    record = recorder.run(lambda _: False, lambda: None)[0]
    return Detection(factor, regime, record.steps if record.problem else None, record.problem, recorder.steps_per_look)
