"""Predicted and true time-step limit, time until a run above it is ended, and long runs below it.

The true limit follows from the eigenvalues of the kernel's actual step.
"""

import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, Self, get_args

import numpy as np
from extreme_scenes import Extreme

from calcidem.dem.engine.leapfrog import State, duplicate, no_recording, run_kernel
from calcidem.dem.engine.readout import energies
from calcidem.dem.engine.scene import Law
from calcidem.dem.engine.state import advance, choose_features, start
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.propagation import SAMPLES_PER_CHUNK, prepare_recorder

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

    @classmethod
    def of_scene(cls, scene: Extreme) -> Self:
        """Critical steps of a scene in the linear law, both reduced by ``sqrt(1 + alpha)`` for local damping.

        All disks have the scene's damping, so the true limit is ``2 / (omega_max sqrt(1 + alpha))``.
        """
        damped, _ = replace(scene, step_fraction=0.8).at_rest(scene.damping)
        predicted = float(start(damped, features=choose_features(damped, "linear")).critical_time_step[0])
        undamped = replace(damped, damping=0.0)
        # More features than the scene needs: those of a kernel that the tests have compiled.
        features = replace(choose_features(undamped, "linear"), damping=True, loads=True, bonds=True, linear_group=True)
        fastest = fastest_mode(start(undamped, features=features))
        return cls(predicted, 2.0 / (fastest * np.sqrt(1.0 + scene.damping)))


@dataclass(frozen=True, slots=True)
class Detection:
    """One run with a forced step."""

    factor: float
    """Step over the true limit from the eigenvalues."""
    law: Literal["linear", "finite"]
    """See `WaveRule`."""
    steps: int | None
    """Steps after which a guard ended it; None if none did."""
    problem: str
    """Message of the guard."""
    looks: int
    """Steps between two checks by the guards."""


def fastest_mode(state: State) -> float:
    """Largest angular frequency of a scene in the linear law, rad/s."""
    root = np.sqrt(_inertia_of(state))
    # Rotations are scaled to make the matrix symmetric up to rounding.
    symmetric = root[:, None] * _acceleration_matrix(state) / root
    return float(np.sqrt(np.linalg.eigvalsh(0.5 * (symmetric + symmetric.T))[-1]))


def _inertia_of(state: State) -> Floats:
    """(3 N,) mass, mass and moment of inertia of each disk, in memory order."""
    scene = state.scene
    return np.column_stack([scene.mass, scene.mass, scene.inertia])[state.assembly.order].ravel()


def _acceleration_matrix(state: State) -> Floats:
    """``M^-1 K`` of a scene in the linear law, (3 N, 3 N) 1/s2; the state is changed.

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
    """Force steps around the true limit with both laws in the plain lattice."""
    return tuple(force_step(factor, law) for factor in _FACTORS for law in ("linear", "finite"))


def force_step(factor: float, law: Literal["linear", "finite"]) -> Detection:
    """Transmit a pulse through the plain lattice with a step that configurations do not allow."""
    scene = Extreme(law=law, damping=0.0)
    experiment, content = scene.experiment()
    experiment = experiment.with_wave(boundary_damping=0.0)
    bonded = experiment.ordering(scene.seed).at(content).bonded
    recorder = prepare_recorder(experiment, [bonded], experiment.frequency(content), 1, raise_if_stopped=lambda: None)
    step = recorder.state.time_step * 0.0 + factor * Limits.of_scene(scene).true
    recorder.state = replace(recorder.state, time_step=step)
    record = recorder.run(lambda _: False, lambda: None)[0]
    looks = SAMPLES_PER_CHUNK * recorder.stride
    return Detection(factor, law, record.steps if record.problem else None, record.problem, looks)


_LONG = 100_000  # steps
_LOOKS = 20  # energy checks in a run
_MOTION = 1.0e-2  # motion of the disks per stability limit over the mean overlap: no contact opens or slips
_PRESSED_LATTICE = Extreme(confinement=1e6)


@dataclass(frozen=True, slots=True)
class Endurance:
    """Results of long runs of one law."""

    law: Law
    """See `state.start`."""
    steps: int
    """Steps of each run."""
    drift: float
    """Largest change of the energy without damping over its first value."""
    residual_motion: float
    """Largest displacement of a disk of an undisturbed balanced scene, over the mean overlap."""
    restarted: bool
    """Whether a run continued from a stored state half-way ended with the same bits."""


def endurance() -> tuple[Endurance, ...]:
    """Long runs of a lattice with a third of its cement, in all laws."""
    return tuple(
        Endurance(law, _LONG, energy_drift(law, _LONG), _residual_motion(law, _LONG), _restart_keeps_bits(law))
        for law in get_args(Law)
    )


def _moving_state(law: Law) -> State:
    """Pressed lattice without damping, with random velocities so small that no contact opens or slips."""
    scene, packing = _PRESSED_LATTICE.at_rest(0.0)
    features = replace(choose_features(scene, law, account=True), servo=False)
    limit = float(start(scene, features=features).critical_time_step[0])
    speed = _MOTION * packing.report.mean_overlap / limit
    return start(scene, features=features, velocity=speed * np.random.default_rng(1).standard_normal((scene.count, 2)))


def energy_drift(law: Law, steps: int) -> float:
    """Largest change of the energy balance without damping, over the kinetic energy at the start.

    The linear law has an exact invariant, ``v(n - 1/2) M v(n + 1/2) / 2 + x K x / 2``; the others have `energies`.
    """
    state = advance(_moving_state(law), 1)
    balance = _linear_invariant(state) if law == "linear" else lambda state: energies(state).imbalance
    begin, kinetic = balance(state), 0.5 * float(_inertia_of(state) @ state.motion.velocity[:, :, 0].ravel() ** 2)
    largest = 0.0
    for _ in range(_LOOKS):
        state = advance(state, steps // _LOOKS)
        largest = max(largest, abs(balance(state) - begin) / kinetic)
    return largest


def _linear_invariant(state: State) -> Callable[[State], float]:
    """Energy conserved by the leapfrog to rounding in the linear law, as a function of the state, J/m."""
    inertia, matrix, step = _inertia_of(state), _acceleration_matrix(duplicate(state)), float(state.time_step[0])

    def energy(now: State) -> float:
        place, before = (
            field[:, :, 0].ravel().astype(float) for field in (now.motion.displacement, now.motion.velocity)
        )
        pull = matrix @ place
        return 0.5 * float(inertia @ (before * (before - step * pull) + place * pull))

    return energy


def _residual_motion(law: Law, steps: int) -> float:
    """Largest displacement in an undisturbed balanced scene, over the mean overlap."""
    scene, packing = _PRESSED_LATTICE.at_rest(0.3)
    state = start(scene, features=replace(choose_features(scene, law), servo=False))
    return float(np.abs(advance(state, steps).motion.displacement[:, :2]).max()) / packing.report.mean_overlap


def _restart_keeps_bits(law: Law, steps: int = 1000) -> bool:
    """Whether a run continued from a stored state half-way ends with the same bits as an uninterrupted one."""
    state = _moving_state(law)
    half = advance(state, steps // 2)
    again = advance(pickle.loads(pickle.dumps(half)), steps - steps // 2)  # noqa: S301 - what was just written
    return bool(np.array_equal(advance(state, steps).motion.velocity, again.motion.velocity))
