"""Long runs: energy without damping, rest, and continuation from a stored state."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calcidem.app.studies.stability.limits import acceleration_matrix, inertia_of
from calcidem.app.studies.stability.scenes import REGIMES, Extreme, scene_at_rest
from calcidem.dem.engine.leapfrog import State, duplicate
from calcidem.dem.engine.readout import energies
from calcidem.dem.engine.scene import Regime
from calcidem.dem.engine.state import advance, choose_features, start

_LONG = 100_000  # steps
_LOOKS = 20  # energy checks in a run
_MOTION = 1.0e-2  # motion of the disks per stability limit over the mean overlap: no contact opens or slips
_PRESSED_LATTICE = Extreme(confinement=1e6)


@dataclass(frozen=True, slots=True)
class Endurance:
    """Results of long runs of one regime."""

    regime: Regime
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
    """Long runs of a lattice with a third of its cement, in all regimes."""
    return tuple(
        Endurance(
            regime, _LONG, _energy_drift(regime, _LONG), _residual_motion(regime, _LONG), _restart_keeps_bits(regime)
        )
        for regime in REGIMES
    )


def _moving_state(regime: Regime) -> State:
    """Pressed lattice without damping, with random velocities so small that no contact opens or slips."""
    scene, packing = scene_at_rest(replace(_PRESSED_LATTICE, regime=regime), 0.0)
    features = replace(choose_features(scene, regime, account=True), servo=False)
    limit = float(start(scene, features=features).critical_time_step[0])
    speed = _MOTION * packing.report.mean_overlap / limit
    return start(scene, features=features, velocity=speed * np.random.default_rng(1).standard_normal((scene.count, 2)))


def _energy_drift(regime: Regime, steps: int) -> float:
    """Largest change of the energy balance without damping, over the kinetic energy at the start.

    The linear regime has an exact invariant, ``v(n - 1/2) M v(n + 1/2) / 2 + x K x / 2``; the others have `energies`.
    """
    state = advance(_moving_state(regime), 1)
    balance = _linear_invariant(state) if regime == "linear" else lambda state: energies(state).imbalance
    begin, kinetic = balance(state), 0.5 * float(inertia_of(state) @ state.motion.velocity[:, :, 0].ravel() ** 2)
    largest = 0.0
    for _ in range(_LOOKS):
        state = advance(state, steps // _LOOKS)
        largest = max(largest, abs(balance(state) - begin) / kinetic)
    return largest


def _linear_invariant(state: State) -> Callable[[State], float]:
    """Energy conserved by the leapfrog to rounding in the linear regime, as a function of the state, J/m."""
    inertia, matrix, step = inertia_of(state), acceleration_matrix(duplicate(state)), float(state.time_step[0])

    def energy(now: State) -> float:
        place, before = (
            field[:, :, 0].ravel().astype(float) for field in (now.motion.displacement, now.motion.velocity)
        )
        pull = matrix @ place
        return 0.5 * float(inertia @ (before * (before - step * pull) + place * pull))

    return energy


def _residual_motion(regime: Regime, steps: int) -> float:
    """Largest displacement in an undisturbed balanced scene, over the mean overlap."""
    scene, packing = scene_at_rest(replace(_PRESSED_LATTICE, regime=regime), 0.3)
    state = start(scene, features=replace(choose_features(scene, regime), servo=False))
    return float(np.abs(advance(state, steps).motion.displacement[:, :2]).max()) / packing.report.mean_overlap


def _restart_keeps_bits(regime: Regime, steps: int = 1000) -> bool:
    """Whether a run continued from a stored state half-way ends with the same bits as an uninterrupted one."""
    state = _moving_state(regime)
    half = advance(state, steps // 2)
    again = advance(pickle.loads(pickle.dumps(half)), steps - steps // 2)  # noqa: S301 - what was just written
    return bool(np.array_equal(advance(state, steps).motion.velocity, again.motion.velocity))
