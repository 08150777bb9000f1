"""Predicted time-step limit against the true one, from the eigenvalues of what the kernel really does."""

from dataclasses import dataclass, replace

import numpy as np

from calcidem.app.studies.stability.scenes import Extreme, content_of, experiment_of
from calcidem.dem.engine.state import State, choose_features, no_recording, run_kernel, start
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.propagation import lane_bonds, wave_scene


@dataclass(frozen=True, slots=True)
class Limits:
    """Predicted and true critical step of a scene, s."""

    predicted: float
    true: float

    @property
    def ratio(self) -> float:
        """Predicted over true: at most 1 if the prediction is safe."""
        return self.predicted / self.true


def limits(scene: Extreme) -> Limits:
    """Critical steps of a scene in the linear regime, with local damping's reduction by ``sqrt(1 + alpha)`` in both.

    The scene's damping is taken for all disks, so that the true limit is ``2 / (omega_max sqrt(1 + alpha))``.
    """
    even = replace(scene, regime="linear")
    experiment = experiment_of(replace(even, step_fraction=0.8))
    bonded = experiment.ordering(scene.seed).at(content_of(scene, experiment)).bonded
    bonds = lane_bonds(experiment.packing, experiment.cement, [bonded], 1, "preserve")
    damped = replace(wave_scene(experiment.packing, experiment.sand, experiment.wave, bonds), damping=scene.damping)
    predicted = float(start(damped, features=choose_features(damped, "linear")).limit[0])
    undamped = replace(damped, damping=0.0)
    fastest = fastest_mode(start(undamped, features=choose_features(undamped, "linear")))
    return Limits(predicted, 2.0 / (fastest * np.sqrt(1.0 + scene.damping)))


def fastest_mode(state: State) -> float:
    """Largest angular frequency of a scene in the linear regime, rad/s."""
    root = np.sqrt(inertia_of(state))
    # Rotations are scaled so that the matrix is symmetric up to rounding.
    symmetric = root[:, None] * acceleration_matrix(state) / root
    return float(np.sqrt(np.linalg.eigvalsh(0.5 * (symmetric + symmetric.T))[-1]))


def inertia_of(state: State) -> Floats:
    """(3 N,) mass, mass and moment of inertia of each disk, in memory order."""
    scene = state.scene
    return np.column_stack([scene.mass, scene.mass, scene.inertia])[state.assembly.order].ravel()


def acceleration_matrix(state: State) -> Floats:
    """``M^-1 K`` of a scene in the linear regime, (3 N, 3 N) 1/s2; the state is used up.

    Its columns are what one step of the kernel does to the velocities when one coordinate is displaced.
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
