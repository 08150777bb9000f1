"""Sliding, rolling, and the local damping of an oscillator."""

from functools import cache

import numpy as np
from common import GRAIN, features_of, history, sand_of, stability_limit
from reference import Floats
from table import check

from calcidem.dem import Bonds, Cement, Scene, State, Wall, advance, start

_RADIUS, _WEIGHT = 2.3e-3, 7.0


def _on_floor(speed: float, fraction: float, *, rotation: bool) -> tuple[State, float]:
    """Disk that its weight presses on a rough floor, thrown along it, and its overlap."""
    depth = (_WEIGHT / float(GRAIN.hertz(_RADIUS))) ** (2.0 / 3.0)
    floor = Wall((0.0, 0.0), (0.0, 1.0), friction=2.0)  # the smaller coefficient counts: the grain's
    scene = Scene(
        np.zeros(1), np.array([_RADIUS - depth]), np.array([_RADIUS]), sand_of(GRAIN), (floor,),
        load=np.array([[0.0, -_WEIGHT, 0.0]]), rotation=rotation,
    )  # fmt: skip
    velocity, features = np.array([[speed, 0.0]]), features_of(scene)
    step = fraction * stability_limit(scene)
    largest = 0.5 * start(scene, features=features, velocity=velocity).critical_time_step[0]
    return start(scene, features=features, velocity=velocity, time_step=min(step, largest)), depth


@check(
    # Coulomb: a block slides v^2 / (2 mu g) + mu N / (2 k_s) before it turns back.
    "Coulomb: distance of a sliding block",
    source="Newton; while it slides, the shear spring holds mu N", tolerance=1e-4,
    reason="it begins to slide within a step, one of 450",
)  # fmt: skip
def _block() -> float:
    speed = 0.05
    state, depth = _on_floor(speed, 0.01, rotation=False)
    mass, limit = float(GRAIN.mass(_RADIUS)), GRAIN.friction * _WEIGHT
    stiffness = GRAIN.shear_share * 1.5 * float(GRAIN.hertz(_RADIUS)) * np.sqrt(depth)
    expected = mass * speed**2 / (2.0 * limit) + limit / (2.0 * stiffness)
    steps = int(1.1 * mass * speed / limit / state.time_step[0])
    path, _ = history(state, steps)
    return abs(float(path[:, 0, 0].max()) / expected - 1.0)


@check(
    # Coulomb: a disk thrown without spin rolls at last, at v / (1 + I / (m a^2)), a the lever arm.
    "Coulomb: final speed of a disk thrown without spin",
    source="angular momentum about the floor", tolerance=2e-3,
    reason="rolling swings on the shear spring, by mu N over k_s a part", quick=True,
)  # fmt: skip
def _bowling() -> float:
    speed = 1.0
    state, depth = _on_floor(speed, 0.05, rotation=True)
    mass = float(GRAIN.mass(_RADIUS))
    arm = _RADIUS - depth / 2.0
    share = 1.0 + 2.0 * arm**2 / _RADIUS**2  # 1 + m a^2 / I: the rim at the contact is at rest
    until = speed * mass / (GRAIN.friction * _WEIGHT) / share  # when slipping ends
    state = advance(state, int(1.5 * until / state.time_step[0]))
    _, speeds = history(state, int(0.5 * until / state.time_step[0]), 4)
    expected = speed * (1.0 - 1.0 / share)
    return abs(float(speeds[:, 0, 0].mean()) / expected - 1.0)


_CEMENT = Cement(bond_modulus=3.1e8, bond_stiffness_ratio=1.7, linear_modulus=0.9e8)


def _oscillator(alpha: float, fraction: float, n: tuple[float, float]) -> tuple[State, float]:
    """Disk on a bond to a held disk, kicked along it, with the step as a part of the period; angular frequency."""
    radius = np.array([1.1e-3, 1.7e-3])
    place = np.outer([0.0, radius.sum()], n)
    scene = Scene(
        place[:, 0], place[:, 1], radius, sand_of(GRAIN), bonds=Bonds(np.array([[0, 1]]), _CEMENT),
        held=np.array([True, False]), damping=alpha,
    )  # fmt: skip
    stiffness = (_CEMENT.bond_modulus + _CEMENT.linear_modulus) * 2.0 * radius[0] / radius.sum()
    omega = float(np.sqrt(stiffness / GRAIN.mass(radius[1])))
    step = fraction * 2.0 * np.pi / omega
    velocity = np.outer([0.0, 1e-3], n)
    return start(scene, features=features_of(scene, "linear"), velocity=velocity, time_step=step), omega


@check(
    # Linear oscillator: frequency of the leapfrog grid, (2 / dt) asin(omega dt / 2).
    "Linear oscillator: frequency on the leapfrog grid", source="central differences",
    tolerance=1e-10, reason="rounding over 2,000 steps", quick=True,
)  # fmt: skip
def _frequency() -> float:
    state, omega = _oscillator(0.0, 0.13, (0.6, 0.8))
    path, _ = history(state, 2000)
    moved = (path - path[0])[:, 1, :2] @ [0.6, 0.8]
    dt = float(state.time_step[0])
    angle = 2.0 * np.arcsin(omega * dt / 2.0)
    expected = 1e-3 * dt / np.sin(angle) * np.sin(angle * np.arange(2001))
    return float(np.abs(moved - expected).max() / expected.max())


@cache
def _damped(alpha: float) -> tuple[Floats, Floats, float]:
    """Extremes of a damped oscillator along x, their times and its angular frequency; 1,000 steps a period."""
    state, omega = _oscillator(alpha, 1e-3, (1.0, 0.0))
    path, _ = history(state, 2600)
    x = path[:, 1, 0] - path[0, 1, 0]
    turns = np.flatnonzero((x[1:-1] - x[:-2]) * (x[2:] - x[1:-1]) < 0.0) + 1
    return np.abs(x[turns]), turns * float(state.time_step[0]), omega


@check(
    # Oscillator with local damping: each half cycle shrinks by sqrt((1 - alpha) / (1 + alpha)); alpha 0.05 to 0.9.
    "Oscillator with local damping: decay of half cycles, alpha 0.05 to 0.9",
    source="energy of the half cycles", tolerance=4e-4,
    reason="the sign of the velocity is half a step late at each turn: (omega dt)^2 = 4e-5 times a few",
)  # fmt: skip
def _decay() -> float:
    worst = 0.0
    for alpha in (0.05, 0.3, 0.7, 0.9):
        extremes, _, _ = _damped(alpha)
        ratio = np.sqrt((1.0 - alpha) / (1.0 + alpha))
        worst = max(worst, float(np.abs(extremes[1:] / extremes[:-1] / ratio - 1.0).max()))
    return worst


@check(
    # Oscillator with local damping: half cycles last pi / (2 omega) (1 / sqrt(1 - alpha) + 1 / sqrt(1 + alpha)).
    "Oscillator with local damping: duration of half cycles",
    source="quarter periods of the two stiffnesses", tolerance=1e-2,
    reason="a velocity that turns within a step keeps the kick of the other branch: up to (1 + alpha) / (1 - alpha) steps of 500", quick=True,
)  # fmt: skip
def _half_cycle() -> float:
    worst = 0.0
    for alpha in (0.05, 0.3, 0.7):
        _, times, omega = _damped(alpha)
        expected = np.pi / (2.0 * omega) * (1.0 / np.sqrt(1.0 - alpha) + 1.0 / np.sqrt(1.0 + alpha))
        worst = max(worst, float(np.abs(np.diff(times) / expected - 1.0).max()))
    return worst
