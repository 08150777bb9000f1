"""Waves in straight chains of equal disks."""

import numpy as np
from common import GRAIN, features_of, history, sand_of
from reference import Floats, soliton_constant
from table import check

from calcidem.dem import Scene, State, start

_RADIUS = 1.6e-3
_HERTZ = float(GRAIN.hertz(_RADIUS, _RADIUS))
_MASS = float(GRAIN.mass(_RADIUS))


@check(
    "Nesterenko's solitary wave: speed from peak speed",
    source="Nesterenko (1983), doi:10.1007/BF00905892; constant from the exact travelling wave, English and Pego (2005), doi:10.1090/S0002-9939-05-07851-2",
    tolerance=1e-5, reason="80 steps a disk: errors of speed and peak cancel but for higher orders", quick=True,
)  # fmt: skip
def _soliton() -> float:
    count, speed = 70, 2.0
    scale = (_HERTZ / _MASS) ** 0.4 * speed**0.2  # disks a second
    scene = Scene(2.0 * _RADIUS * np.arange(count), np.zeros(count), np.full(count, _RADIUS), sand_of(GRAIN))
    velocity = np.zeros((count, 2))
    velocity[0, 0] = speed
    step = 1.0 / (80.0 * scale)
    state = start(scene, features=features_of(scene), velocity=velocity, time_step=step)
    _, speeds = history(state, int(60 * 80 / 0.9))
    times, peaks = zip(*(_peak(speeds[:, disk, 0]) for disk in range(35, 51)), strict=True)
    pace = np.polyfit(np.arange(16), np.array(times) * step, 1)[0]  # s a disk
    peak = float(np.mean(peaks))
    return float(abs(1.0 / pace / ((_HERTZ / _MASS) ** 0.4 * peak**0.2) / soliton_constant() - 1.0))


def _peak(values: Floats) -> tuple[float, float]:
    """Place and height of the largest of equally spaced values, by a parabola."""
    top = int(np.argmax(values))
    before, at, after = values[top - 1 : top + 2]
    shift = 0.5 * (before - after) / (before - 2.0 * at + after)
    return top + shift, float(at - 0.25 * (before - after) * shift)


def _loaded(overlap: float, count: int, mode: int, speed: float, law: str, *, across: bool = False) -> State:
    """Chain between held ends, every contact with the same overlap, kicked in one of its standing waves."""
    spacing = 2.0 * _RADIUS - overlap
    place = spacing * np.arange(count + 1.0)
    held = np.isin(np.arange(count + 1), [0, count])
    scene = Scene(place, np.zeros(count + 1), np.full(count + 1, _RADIUS), sand_of(GRAIN), held=held)
    shape = speed * np.sin(np.pi * mode * np.arange(count + 1) / count) * ~held
    velocity = np.column_stack([0.0 * shape, shape] if across else [shape, 0.0 * shape])
    return start(scene, features=features_of(scene, law), velocity=velocity, step_fraction=0.5)


def grid_frequency(signal: Floats, dt: float) -> float:
    """Angular frequency sqrt(k / m) of a mode from its displacements at the steps of the leapfrog."""
    second = signal[2:] - 2.0 * signal[1:-1] + signal[:-2]
    return float(np.sqrt(-np.sum(second * signal[1:-1]) / np.sum(signal[1:-1] ** 2)) / dt)


@check(
    # Chain: dispersion on the leapfrog grid, sin(omega dt / 2) = dt sqrt(k / m) sin(q a / 2), all 23 modes.
    "Chain: dispersion on the leapfrog grid, all 23 modes",
    source="Brillouin, Wave Propagation in Periodic Structures (1946)", tolerance=1e-10, reason="rounding over 300 steps",
    quick=True,
)  # fmt: skip
def _dispersion() -> float:
    worst, bays, overlap = 0.0, 24, 3e-6
    stiffness = 1.5 * _HERTZ * np.sqrt(overlap)
    for mode in range(1, bays):
        state = _loaded(overlap, bays, mode, 1e-2, "linear")
        dt = float(state.time_step[0])
        path, _ = history(state, 300, 3)
        moved = (path - path[0])[:, :, 0]
        angle = 2.0 * np.arcsin(dt * np.sqrt(stiffness / _MASS) * np.sin(0.5 * np.pi * mode / bays))
        shape = 1e-2 * np.sin(np.pi * mode * np.arange(bays + 1) / bays)
        expected = dt * np.sin(angle * np.arange(0, 301, 3)) / np.sin(angle)
        worst = max(worst, float(np.abs(moved - np.outer(expected, shape)).max() / np.abs(expected).max()))
    return worst


@check(
    # Precompressed Hertz chain, finite displacement: long-wave speed a sqrt(3/2 h d^0.5 / m), forces over 6 decades.
    "Precompressed Hertz chain: long-wave speed, forces over 6 decades",
    source="Hertz tangent; c grows with F^(1/6), Coste, Falcon and Fauve (1997), doi:10.1103/PhysRevE.56.6104",
    tolerance=1e-5, reason="amplitude 1e-3 of the overlap, which counts squared, and rounding of positions", quick=True,
)  # fmt: skip
def _speeds() -> float:
    worst, bays = 0.0, 24
    for overlap in 10.0 ** np.arange(-9.0, -4.5):
        spacing = 2.0 * _RADIUS - overlap
        expected = spacing * np.sqrt(1.5 * _HERTZ * np.sqrt(overlap) / _MASS)
        frequency = expected * np.pi / (bays * spacing)
        state = _loaded(overlap, bays, 1, 1e-3 * overlap * frequency, "finite")
        path, _ = history(state, 400)
        found = grid_frequency((path - path[0])[:, bays // 2, 0], float(state.time_step[0]))
        bend = 2.0 * np.sin(np.pi / bays / 2.0) / (np.pi / bays)  # the chain's own dispersion
        worst = max(worst, abs(found / frequency / bend - 1.0))
    return worst
