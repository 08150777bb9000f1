"""Plane waves in square and hexagonal lattices of disks that turn.

The displacements of a plane wave are given to a patch of the lattice as velocities. In a step of the leapfrog a disk learns
of its neighbours only, so its middle moves as in a lattice without end until as many steps are done as it has layers.
"""

from functools import cache

import numpy as np
from chains import grid_frequency
from common import GRAIN, features_of, history, sand_of
from reference import Floats, bloch_matrices
from table import check

from calcidem.dem import Scene, State, start

_RADIUS = 1.2e-3
_STEPS = 19
_LAYERS = 20
SQUARE, HEXAGONAL = 4, 6
_MATRIX = (
    "dynamical matrix of an infinite lattice: Suiker, Metrikine and de Borst (2001), doi:10.1016/S0020-7683(00)00104-9"
)


def _dynamical_matrix(kind: int, wave: Floats, overlap: float, *, tilting: bool) -> "np.ndarray":
    """(3, 3) matrix of a lattice of so many neighbours for a wave vector (2,)."""
    spacing, coefficient = 2.0 * _RADIUS - overlap, float(GRAIN.hertz(_RADIUS, _RADIUS))
    normal = 1.5 * coefficient * np.sqrt(overlap)
    stiffness = normal, GRAIN.shear_share * normal, 0.0, coefficient * overlap**1.5 / spacing * tilting
    angles = 2.0 * np.pi * np.arange(kind) / kind
    return bloch_matrices(wave[None], angles, spacing, stiffness, float(GRAIN.mass(_RADIUS)), _RADIUS)[0]


@cache
def _patch(kind: int, overlap: float) -> tuple[Scene, int]:
    """Patch of 41 x 41 disks and the one in its middle."""
    size = 2 * _LAYERS + 1
    column, row = np.meshgrid(np.arange(size), np.arange(size))
    spacing = 2.0 * _RADIUS - overlap
    x, y = (column + 0.5 * (row % 2), row * np.sqrt(0.75)) if kind == HEXAGONAL else (column, row)
    x, y = spacing * x.ravel().astype(float), spacing * y.ravel().astype(float)
    return Scene(x, y, np.full(x.size, _RADIUS), sand_of(GRAIN)), size * _LAYERS + _LAYERS


def _plane_wave(scene: Scene, middle: int, wave: Floats, shape: "np.ndarray", law: str) -> State:
    """Lattice at the start of a standing wave."""
    phase = np.exp(1j * (wave[0] * (scene.x - scene.x[middle]) + wave[1] * (scene.y - scene.y[middle])))
    motion = (phase[:, None] * shape).real
    # Where the patch is pressed its free edges burst, and a step that is watched would follow the limit that they set.
    return start(
        scene, features=features_of(scene, law), velocity=motion[:, :2].copy(),
        spin=np.sqrt(2.0) / _RADIUS * motion[:, 2], step_fraction=0.95, steps_per_contact=0.0,
    )  # fmt: skip


def _worst_branch(kind: int, overlap: float, waves: Floats, law: str, amplitude: float) -> float:
    """Largest relative error of a frequency over wave vectors (times the spacing) and their three branches."""
    scene, middle = _patch(kind, overlap)
    worst = 0.0
    for vector in waves:
        wave = vector / (2.0 * _RADIUS - overlap)
        squared, shapes = np.linalg.eigh(_dynamical_matrix(kind, wave, overlap, tilting=law == "finite"))
        for branch in range(3):
            shape = shapes[:, branch]
            strongest = int(np.argmax(np.abs(shape)))
            shape = amplitude * shape * np.abs(shape[strongest]) / shape[strongest]  # real where it is read
            state = _plane_wave(scene, middle, wave, shape, law)
            path, _ = history(state, _STEPS)
            found = grid_frequency((path - path[0])[:, middle, strongest], float(state.time_step[0]))
            worst = max(worst, abs(found / np.sqrt(squared[branch]) - 1.0))
    return worst


def _wave_vectors(count: int) -> Floats:
    """(count, 2) wave vectors times the spacing, of all directions and up to beyond the zone's edge."""
    generator = np.random.default_rng(7)
    angle, size = generator.uniform(0.0, 2.0 * np.pi, count), generator.uniform(0.3, 3.6, count)
    return size[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


_ROUNDING = "rounding, divided by the square of the phase of a step"


@check(
    "Square lattice: full dispersion with rotations, 12 wave vectors in all directions, 3 branches",
    source=_MATRIX, tolerance=1e-9, reason=_ROUNDING,
)  # fmt: skip
def _square() -> float:
    return _worst_branch(SQUARE, 2e-6, _wave_vectors(12), "linear", 1e-2)


@check(
    "Hexagonal lattice: the same", source=_MATRIX, tolerance=1e-9, reason=_ROUNDING,
)  # fmt: skip
def _hexagonal() -> float:
    return _worst_branch(HEXAGONAL, 2e-6, _wave_vectors(12), "linear", 1e-2)


@check(
    "Hexagonal lattice under pressure, finite displacement: the same, 6 wave vectors",
    source="the same matrix, with -F_n / a for turning normals", tolerance=1e-5,
    reason="amplitude 1e-6 of the overlap; leaving the pressure out would cost 2e-3",
)  # fmt: skip
def _pressed() -> float:
    return _worst_branch(HEXAGONAL, 1e-2 * _RADIUS, _wave_vectors(6), "finite", 1e-5)


def _long_waves(kind: int, angles: Floats, speeds: Floats) -> float:
    """Largest error of the S and the P speed of waves of 200 spacings, against closed forms (2,)."""
    overlap, size = 2e-6, 2.0 * np.pi / 200.0
    scene, middle = _patch(kind, overlap)
    worst = 0.0
    for angle in angles:
        wave = size / (2.0 * _RADIUS - overlap) * np.array([np.cos(angle), np.sin(angle)])
        _, shapes = np.linalg.eigh(_dynamical_matrix(kind, wave, overlap, tilting=False))
        for branch in range(2):
            shape = 1e-2 * shapes[:, branch]
            axis = int(np.argmax(np.abs(shape)))
            shape = shape * np.abs(shape[axis]) / shape[axis]
            state = _plane_wave(scene, middle, wave, shape, "linear")
            path, _ = history(state, _STEPS)
            found = grid_frequency((path - path[0])[:, middle, axis], float(state.time_step[0]))
            worst = max(worst, abs(found / np.hypot(*wave) / speeds[branch] - 1.0))
    return worst


def _stiffness_over_mass() -> tuple[float, float]:
    """k_n a^2 / m and k_s a^2 / m of the lattices of `_long_waves`, m^2/s^2."""
    normal = 1.5 * float(GRAIN.hertz(_RADIUS, _RADIUS)) * np.sqrt(2e-6)
    scale = (2.0 * _RADIUS - 2e-6) ** 2 / float(GRAIN.mass(_RADIUS))
    return scale * normal, GRAIN.shear_share * scale * normal


@check(
    # Hexagonal lattice: c_s^2 = 3/8 (k_n + k_s) a^2 / m, c_p^2 = 3/8 (3 k_n + k_s) a^2 / m in all directions.
    "Hexagonal lattice: speeds of long S and P waves",
    source="continuum limit; the arms cancel for disks that rotate freely", tolerance=2e-4,
    reason="waves of 200 spacings: (q a)^2 / 24 to / 8 = 4e-5 to 1.2e-4",
)  # fmt: skip
def _hexagonal_speeds() -> float:
    normal, shear = _stiffness_over_mass()
    speeds = np.sqrt(0.375 * np.array([normal + shear, 3.0 * normal + shear]))
    return _long_waves(HEXAGONAL, np.array([0.0, 0.2, 0.5, 1.1]), speeds)


@check(
    # Square lattice: c_p^2 = k_n a^2 / m and c_s^2 = k_s a^2 / (2 m) along its axes.
    "Square lattice: speeds of long S and P waves along its axes",
    source="continuum limit; half the shear goes into rotation", tolerance=2e-4,
    reason="waves of 200 spacings, as above",
)  # fmt: skip
def _square_speeds() -> float:
    normal, shear = _stiffness_over_mass()
    return _long_waves(SQUARE, np.array([0.0, 0.5 * np.pi]), np.sqrt(np.array([shear / 2.0, normal])))
