"""Modes and critical steps, against K and M that are put together here and solved by LAPACK."""

from collections.abc import Iterator
from functools import cache

import numpy as np
from common import GRAIN, cemented, contacts_of, features_of, history, inertias, sand_of, small_packing
from reference import Floats, Grain, Integers, Springs, stiffness_matrix
from scipy.linalg import eigh
from table import check

from calcidem.dem import Bonds, Cement, Scene, Wall, start

QUARTZ = Grain(modulus=6.5e11, ratio=0.25, density=2650.0, friction=0.5)
CEMENT = Cement(bond_modulus=8.0e10, bond_stiffness_ratio=1.7)
_EIGEN = "K from the springs' energies, M, scipy.linalg.eigh"


def boxed_packing(*, share_bonded: float = 0.0, damping: float = 0.0, load: Floats | None = None) -> Scene:
    """Packing of 280 disks between four walls, one of them rough, with a random share of its contacts bonded."""
    packing = small_packing()
    walls = (
        Wall((0.0, 0.0), (1.0, 0.0), friction=0.3),
        Wall((packing.width, 0.0), (-1.0, 0.0)),
        Wall((0.0, 0.0), (0.0, 1.0)),
        Wall((0.0, packing.height), (0.0, -1.0)),
    )
    chosen = np.random.default_rng(11).random(len(packing.pairs)) < share_bonded
    bonds = Bonds(packing.pairs[chosen], CEMENT) if share_bonded else None
    return Scene(packing.x, packing.y, packing.radius, sand_of(QUARTZ), walls, bonds, damping=damping, load=load)


def bond_stiffness(radius: Floats, pairs: Integers, cement: Cement) -> Floats:
    """(3, B) stiffness of beams of unit thickness as wide as the smaller disk: E A / l, that over kappa, E I / l."""
    first, second = radius[pairs].T
    width = 2.0 * np.minimum(first, second)
    normal = cement.bond_modulus * width / (first + second)
    return np.stack([normal, normal / cement.bond_stiffness_ratio, normal * width**2 / 12.0])


def packing_springs(scene: Scene) -> Springs:
    """Springs of `boxed_packing`."""
    springs = contacts_of(scene, QUARTZ)
    if scene.bonds is None:
        return springs
    pairs = np.asarray(scene.bonds.pairs)
    return cemented(springs, pairs, bond_stiffness(np.asarray(scene.radius), pairs, scene.bonds.cement))


@cache
def _all_modes(share_bonded: float) -> tuple[Scene, Floats, Floats, Floats]:
    """Scene, squared angular frequencies, mass-normal modes (3N, 3N) and inertias."""
    scene = boxed_packing(share_bonded=share_bonded)
    inertia = inertias(scene, QUARTZ)
    squared, shapes = eigh(stiffness_matrix(scene.count, packing_springs(scene)).toarray(), np.diag(inertia))
    return scene, squared, shapes, inertia


def _worst_mode(share_bonded: float) -> float:
    """Largest error of a squared frequency, over the mode's own or 1e-6 of the largest: all modes at once.

    The packing is thrown with random velocities; its displacements are taken apart into modes, and each has to obey
    the difference equation of the leapfrog with its own frequency.
    """
    scene, squared, shapes, inertia = _all_modes(share_bonded)
    generator = np.random.default_rng(3)
    velocity, spin = generator.standard_normal((scene.count, 2)), generator.standard_normal(scene.count) / 1e-3
    state = start(scene, features=features_of(scene, "linear"), velocity=velocity, spin=spin)
    path, _ = history(state, 600)
    moved = (path - path[0]).reshape(len(path), -1) @ (inertia[:, None] * shapes)
    second = moved[2:] - 2.0 * moved[1:-1] + moved[:-2]
    found = -(second * moved[1:-1]).sum(axis=0) / (moved[1:-1] ** 2).sum(axis=0) / float(state.time_step[0]) ** 2
    return float((np.abs(found - squared) / np.maximum(squared, 1e-6 * squared[-1])).max())


@check(
    "Packing of 280 disks, linear: all 840 frequencies, from one free vibration", source=_EIGEN, tolerance=1e-8,
    reason="rounding of eigenvectors and positions, over the square of slow modes' phases",
)  # fmt: skip
def _bare_modes() -> float:
    return _worst_mode(0.0)


@check(
    "Packing of 280 disks, half of its contacts bonded, linear: all 840 frequencies", source=_EIGEN, tolerance=1e-7,
    reason="as above, stiffnesses 2,000 apart",
)  # fmt: skip
def _bonded_modes() -> float:
    return _worst_mode(0.5)


def _exact_limit(scene: Scene, springs: Springs, grain: Grain) -> float:
    """Critical time step 2 / omega_max, lowered by local damping, s."""
    inertia = inertias(scene, grain) / (1.0 + float(np.max(scene.damping)))
    largest = eigh(
        stiffness_matrix(scene.count, springs).toarray(),
        np.diag(inertia),
        eigvals_only=True,
        subset_by_index=[3 * scene.count - 1] * 2,
    )[0]
    return float(2.0 / np.sqrt(largest))


@cache
def _limits_of_packings() -> Floats:
    """Reported over exact limit of the packing: bare, half and fully bonded, damped."""
    ratios = []
    for share, alpha in ((0.0, 0.0), (0.5, 0.0), (1.0, 0.0), (0.5, 0.7)):
        scene = boxed_packing(share_bonded=share, damping=alpha)
        exact = _exact_limit(scene, packing_springs(scene), QUARTZ)
        for law in ("linear", "finite"):
            state = start(scene, features=features_of(scene, law))
            ratios.append(float(state.critical_time_step[0]) / exact)
    return np.array(ratios)


def _gapped_scenes() -> Iterator[tuple[Scene, Springs]]:
    """Random disks up to two radii apart, all neighbours bonded, kappa 0.1 to 10."""
    generator = np.random.default_rng(5)
    for _ in range(60):
        count, wide = int(generator.integers(2, 10)), float(generator.uniform(0.0, 2.0))
        column, row = np.meshgrid(np.arange(3), np.arange(4))
        radius = 1e-3 * generator.uniform(0.6, 1.0, count)
        place = (2.0 + wide) * 1e-3 * np.column_stack([column.ravel(), row.ravel()])[:count] * [1.0, 0.95]
        place += generator.uniform(-0.02, 0.02, place.shape) * 1e-3
        near = np.hypot(*(place[:, None] - place[None]).transpose(2, 0, 1)) < (2.0 + wide) * 1.2e-3
        pairs = np.argwhere(np.triu(near, 1))
        cement = Cement(8e10, bond_stiffness_ratio=float(10.0 ** generator.uniform(-1.0, 1.0)))
        scene = Scene(place[:, 0], place[:, 1], radius, sand_of(GRAIN), bonds=Bonds(pairs, cement))
        apart = place[pairs[:, 1]] - place[pairs[:, 0]]
        distance = np.hypot(*apart.T)
        depth = radius[pairs].sum(axis=1) - distance
        yield scene, Springs(
            pairs[:, 0], pairs[:, 1], apart / distance[:, None], radius[pairs].T - depth / 2.0,
            bond_stiffness(radius, pairs, cement), np.zeros(len(pairs)),
        )  # fmt: skip


@check(
    "Critical step of the packing, bare and bonded, exceeds the exact one by",
    source=_EIGEN, tolerance=0.0, reason="it is a bound",
)  # fmt: skip
def _bound() -> float:
    return max(0.0, float(_limits_of_packings().max()) - 1.0)


@check(
    "Critical step of the packing, linear, falls short by", source=_EIGEN, tolerance=0.1,
    reason="a bound: a tight one costs nothing, a loose one costs steps",
)  # fmt: skip
def _shortfall() -> float:
    return 1.0 - float(_limits_of_packings()[::2].min())  # without what the finite law adds for impacts


@check(
    "Critical step of 60 scenes with bonds across gaps exceeds the exact one by",
    source=_EIGEN, tolerance=0.0, reason="it is a bound",
)  # fmt: skip
def _gaps() -> float:
    worst = 0.0
    for scene, springs in _gapped_scenes():
        exact = _exact_limit(scene, springs, GRAIN)
        for law in ("linear", "finite"):
            worst = max(
                worst, float(start(scene, features=features_of(scene, law)).critical_time_step[0]) / exact - 1.0
            )
    return worst
