from dataclasses import replace

import numpy as np
import pytest
from scenes import GROUPED, LINEAR, RADIUS, SOFT, SOFT_CEMENT, hexagonal
from scipy import sparse
from scipy.sparse.linalg import eigsh

from calcidem.dem.engine.leapfrog import State, no_recording, run_kernel
from calcidem.dem.engine.scene import Bonds, Scene, Wall
from calcidem.dem.engine.state import advance, start
from calcidem.dem.kernels.layout import Features, Floats

pytestmark = pytest.mark.slow

LAWS = {"linear": LINEAR, "finite": GROUPED}


def disordered(seed: int = 3, alpha: float = 0.0) -> Scene:
    """About 100 unequal disks between a rough and a smooth wall, a third of the contacts cemented."""
    generator = np.random.default_rng(seed)
    x, y = hexagonal(10, 10, 1.97 * RADIUS)
    x, y = x + generator.uniform(-0.005, 0.005, 100) * RADIUS, y + generator.uniform(-0.005, 0.005, 100) * RADIUS
    radius = RADIUS * generator.uniform(0.995, 1.005, 100)
    walls = (
        Wall((x.min() - 0.99 * RADIUS, 0.0), (1.0, 0.0), friction=0.5),
        Wall((0.0, y.max() + 0.99 * RADIUS), (0.0, -1.0)),
    )
    touching = [
        (i, j) for i in range(100) for j in range(i) if np.hypot(x[i] - x[j], y[i] - y[j]) < radius[i] + radius[j]
    ]
    bonds = Bonds(np.array(touching)[generator.random(len(touching)) < 0.3], SOFT_CEMENT)
    return Scene(x, y, radius, SOFT, walls=walls, bonds=bonds, damping=alpha)


def rows(count: int, ends: list[tuple[int, float]], n: Floats, arms: list[float]) -> tuple[sparse.csr_array, ...]:
    """Row vectors that give approach, slide and twist of a contact from all displacements (x, y, rotation)."""
    normal, slide, twist = (sparse.lil_array((1, 3 * count)) for _ in range(3))
    for (disk, side), arm in zip(ends, arms, strict=True):
        normal[0, [3 * disk, 3 * disk + 1]] = side * n
        slide[0, [3 * disk, 3 * disk + 1]] = side * np.array([-n[1], n[0]])
        slide[0, 3 * disk + 2] = -arm
        twist[0, 3 * disk + 2] = side
    return normal.tocsr(), slide.tocsr(), twist.tocsr()


def stiffness_matrix(scene: Scene) -> sparse.csr_array:
    """K from the energy of every spring, 1/2 k (row u)^2."""
    total = sparse.csr_array((3 * scene.count, 3 * scene.count))
    assert scene.bonds is not None
    cement = scene.bonds.cement
    bonded = {tuple(sorted(pair)) for pair in scene.bonds.pairs.tolist()}
    place = np.column_stack([scene.x, scene.y])
    for i in range(scene.count):
        for j in range(i + 1, scene.count):
            apart = place[j] - place[i]
            overlap = scene.radius[i] + scene.radius[j] - np.hypot(*apart)
            if overlap <= 0.0:
                continue
            radii = scene.radius[[i]], scene.radius[[j]]
            hertz = 1.5 * scene.sand.hertz_coefficient(*radii)[0] * np.sqrt(overlap)
            springs = [hertz, scene.sand.shear_ratio * hertz, 0.0]
            if (i, j) in bonded:
                bond, group = cement.bond_stiffness(*radii)[0], cement.linear_stiffness(*radii)[0]
                springs = [bond[0] + group[0], bond[1] + group[1], bond[2]]
            arms = [scene.radius[k] - 0.5 * overlap for k in (i, j)]
            for k, row in zip(
                springs, rows(scene.count, [(i, -1.0), (j, 1.0)], apart / np.hypot(*apart), arms), strict=True
            ):
                total = total + k * (row.T @ row)
    for wall in scene.walls:
        for disk, distance in enumerate(wall.distance(place[:, 0], place[:, 1])):
            overlap = scene.radius[disk] - distance
            if overlap > 0.0:
                hertz = 1.5 * float(scene.sand.hertz_coefficient(scene.radius[[disk]])[0]) * np.sqrt(overlap)
                shear = scene.sand.shear_ratio * hertz if wall.friction > 0.0 else 0.0
                arm = scene.radius[disk] - 0.5 * overlap
                for k, row in zip(
                    (hertz, shear), rows(scene.count, [(disk, 1.0)], np.array(wall.normal), [arm])[:2], strict=True
                ):
                    total = total + k * (row.T @ row)
    return total.tocsr()


@pytest.fixture(scope="module")
def modes() -> tuple[Scene, Floats, Floats]:
    """Scene, all angular frequencies and some of its modes: the slowest, the fastest and two in between."""
    scene = disordered()
    inertia = np.column_stack([scene.mass, scene.mass, scene.inertia]).ravel()
    scaling = sparse.diags_array(inertia**-0.5)
    matrix = (scaling @ stiffness_matrix(scene) @ scaling).tocsc()
    middle = float(np.sort(np.linalg.eigvalsh(matrix.toarray()))[150])
    found = [
        eigsh(matrix, 3, sigma=0.0),
        eigsh(matrix, 2, sigma=middle * (1.0 + 1e-9)),
        eigsh(matrix, 3, which="LM"),
    ]
    squared = np.concatenate([values for values, _ in found])
    shapes = np.concatenate([vectors for _, vectors in found], axis=1) * (inertia**-0.5)[:, None]
    return scene, np.sqrt(np.abs(squared)), shapes.reshape(scene.count, 3, 8)


def launched_in(scene: Scene, shapes: Floats, fraction_of_exact: float, fastest: float, features: Features) -> State:
    """Each lane one step after time zero in one mode, with a step given as part of the exact limit."""
    step = np.full(features.lanes, fraction_of_exact * 2.0 / fastest)
    state = replace(start(scene, features=features), time_step=step)
    state.motion.velocity[...] = shapes[state.assembly.order]
    return advance(state, 1)


def test_a_packing_swings_in_the_modes_of_an_independent_eigen_solve(modes: tuple[Scene, Floats, Floats]) -> None:
    """Let go in a mode of K and M, the disks stay in it and swing with the frequency of the leapfrog grid."""
    scene, frequencies, shapes = modes
    for omega, shape in zip(frequencies, np.moveaxis(shapes, -1, 0), strict=True):
        state = launched_in(scene, shape[:, :, None], 0.6, frequencies[-1], LINEAR)
        dt = float(state.time_step[0])
        angle, done = 2.0 * np.arcsin(0.5 * omega * dt), 1
        # Eigenvectors from an iterative solver are good to 1e-10 or so; what is missing swings on its own.
        scale = np.abs(shape).max(axis=0) / omega
        for step in (1, 40, 160, 400):
            run_kernel(state, step - done, no_recording(state))
            done = step
            expected = dt * np.sin(step * angle) / np.sin(angle) * shape
            error = np.abs(state.motion.displacement[:, :, 0] - expected[state.assembly.order]).max(axis=0)
            assert np.all(error < 1e-7 * scale), (step, omega)


@pytest.mark.parametrize("alpha", [0.0, 0.3, 1.0])
def test_the_limit_is_below_the_exact_one_and_not_far_below(modes: tuple[Scene, Floats, Floats], alpha: float) -> None:
    """`State.critical_time_step` lies between 90 and 100 % of 2 / (omega_max sqrt(1 + alpha))."""
    scene, omega, _ = modes
    exact = 2.0 / (omega[-1] * np.sqrt(1.0 + alpha))
    limit = start(replace(scene, damping=alpha), features=LINEAR).critical_time_step
    assert np.all((limit > 0.9 * exact) & (limit <= exact))


@pytest.mark.parametrize("alpha", [0.0, 0.3])
def test_the_exact_limit_is_the_border_of_stability(modes: tuple[Scene, Floats, Floats], alpha: float) -> None:
    """At 0.99 of the exact limit the motion stays bounded, at 1.02 of it grows without bound."""
    scene, omega, shapes = modes
    damped, critical = replace(scene, damping=alpha), omega[-1] * np.sqrt(1.0 + alpha)
    shape = shapes[:, :, -1:]
    sizes = []
    for fraction in (0.99, 1.02):
        state = launched_in(damped, shape, fraction, critical, LINEAR)
        first = np.abs(state.motion.displacement).max()
        sizes.append(np.abs(advance(state, 1000).motion.displacement).max() / first)
    # On the grid the amplitude of a mode at 0.99 of the limit is 1 / cos(asin(0.99)) = 7 times that of a slow one.
    assert sizes[0] < 10.0
    assert not sizes[1] < 1e6


def resting_heap() -> Scene:
    """Disks at rest without forces: hexagonal, all contacts at the same overlap, boxed in by held disks."""
    x, y = hexagonal(8, 8, 1.99 * RADIUS)
    edge = (x < x.min() + RADIUS * 1.5) | (x > x.max() - RADIUS * 1.5) | (y == y.min()) | (y == y.max())
    inner = [(i, j) for i in range(64) for j in range(i) if np.hypot(x[i] - x[j], y[i] - y[j]) < 2.0 * RADIUS]
    bonds = Bonds(np.array(inner)[::3], SOFT_CEMENT)
    return Scene(x, y, np.full(64, RADIUS), SOFT, bonds=bonds, held=edge)


def difference(first: str, second: str, speed: float) -> float:
    """How much two laws differ after some steps from the same kick, relative to the motion."""
    scene = resting_heap()
    velocity = speed * np.random.default_rng(1).standard_normal((scene.count, 2)) * ~np.asarray(scene.held)[:, None]
    moved = []
    for law in (first, second):
        state = start(scene, features=LAWS[law], velocity=velocity, time_step=1e-7)
        moved.append(advance(state, 600).motion.displacement[:, :2])
    return float(np.abs(moved[0] - moved[1]).max() / np.abs(moved[0]).max())


@pytest.mark.full
def test_linear_and_finite_agree_but_for_the_turning_of_loaded_contacts() -> None:
    """What is left at small amplitude is F_n / (k_n R): a loaded contact pushes sideways when it turns."""
    # 2/3 of an overlap of 0.01 radii over a spacing of 2 radii is 0.3 %; it does not depend on the amplitude.
    large, tiny = difference("linear", "finite", 1e-4), difference("linear", "finite", 1e-6)
    assert tiny < 3e-3
    assert tiny == pytest.approx(large, rel=0.1)
