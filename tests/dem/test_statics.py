"""The static stiffness against closed forms, a dense twin made of the naive laws, and the wave of a lattice."""

from dataclasses import replace

import numpy as np
import pytest
from naive import Twin, add_pair, make_twin
from scenes import LINEAR, RADIUS, SOFT, SOFT_CEMENT, SPACING, hexagonal

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.scene import Bonds, Scene
from calcidem.dem.engine.state import start
from calcidem.dem.engine.statics import shear_modulus
from calcidem.dem.kernels.layout import Floats, Integers
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.rule import WaveRule
from calcidem.dem.wave.static_speed import static_speed


def rows_of(columns: int, rows: int) -> list[Integers]:
    """Left, right, lower and upper row of a lattice."""
    index = np.arange(columns * rows).reshape(rows, columns)
    return [index[:, 0], index[:, -1], index[0], index[-1]]


def lattice_error(size: int) -> float:
    """Relative error of the modulus of a hexagonal lattice, from its closed form sqrt(3) / 4 (k_n + k_s)."""
    x, y = hexagonal(size, size, SPACING)
    scene = Scene(x, y, np.full(size * size, RADIUS), SOFT)
    found = shear_modulus(start(scene, regime="linear"), rows_of(size, size))
    radius = np.array([RADIUS])
    normal = 1.5 * float(SOFT.hertz_coefficient(radius, radius)[0]) * np.sqrt(2.0 * RADIUS - SPACING)
    # c_s^2 = 3/8 (k_n + k_s) a^2 / m, and a disk takes sqrt(3) / 2 a^2 of the plane.
    return found / (np.sqrt(3.0) / 4.0 * (1.0 + SOFT.shear_ratio) * normal) - 1.0


def test_a_hexagonal_lattice_has_the_modulus_of_its_shear_wave() -> None:
    """G tends to rho c_s^2 with one over the size: the disks of the zigzag rows lack neighbours and turn otherwise."""
    small, large = lattice_error(17), lattice_error(33)
    assert abs(small) < 0.01
    assert abs(2.0 * large - small) < 2e-5  # what is left beyond the first order


def jumbled(seed: int, *, bonded: bool) -> tuple[State, list[Integers]]:
    """Twenty-five unequal disks with some bonds, and their rows."""
    generator = np.random.default_rng(seed)
    x, y = hexagonal(5, 5, 1.97 * RADIUS)
    x, y = x + generator.uniform(-5e-3, 5e-3, 25) * RADIUS, y + generator.uniform(-5e-3, 5e-3, 25) * RADIUS
    near = [(i, j) for i in range(25) for j in range(i) if np.hypot(x[i] - x[j], y[i] - y[j]) < 2.0 * RADIUS]
    bonds = Bonds(np.array(near)[generator.random(len(near)) < 0.4], SOFT_CEMENT) if bonded else None
    scene = Scene(x, y, RADIUS * generator.uniform(0.995, 1.005, 25), SOFT, bonds=bonds)
    features = LINEAR if bonded else replace(LINEAR, bonds=False, linear_group=False)
    return start(scene, features=features), rows_of(5, 5)


def dense_modulus(state: State, edges: list[Integers]) -> float:
    """The modulus from forces that the naive laws give for a unit motion of each disk, solved as a dense system."""
    scene, count = state.scene, state.scene.count
    twin = make_twin(scene, state.features, 1.0, np.zeros((count, 2)), np.zeros(count))
    stiffness = _naive_stiffness(twin)
    for row in edges:
        stiffness -= 0.5 * _naive_stiffness(twin, frozenset(row.tolist()))
    moved = np.zeros((count, 3))
    moved[:, 1] = scene.x
    driven = np.zeros((count, 3), dtype=bool)
    driven[np.unique(np.concatenate(edges)), :2] = True
    free, moved = ~driven.ravel(), moved.ravel()
    moved[free] = -np.linalg.solve(stiffness[np.ix_(free, free)], stiffness[np.ix_(free, ~free)] @ moved[~free])
    energy = 0.5 * moved @ stiffness @ moved
    left, right, lower, upper = edges
    area = (scene.x[right].mean() - scene.x[left].mean()) * (scene.y[upper].mean() - scene.y[lower].mean())
    return 2.0 * energy / area


def _naive_stiffness(twin: Twin, only: frozenset[int] | None = None) -> Floats:
    """(3 N, 3 N) less the forces and moments of unit motions, in all contacts or in those among some disks."""
    count = twin.scene.count
    stiffness = np.empty((3 * count, 3 * count))
    for column in range(3 * count):
        twin.moved[...] = 0.0
        twin.moved.flat[column] = 1.0
        force = np.zeros((count, 3))
        for i in range(count):
            for j in range(i + 1, count):
                if only is None or {i, j} <= only:
                    add_pair(twin, i, j, 0.0, force)
        stiffness[:, column] = -force.ravel()
    return stiffness


@pytest.mark.parametrize("bonded", [False, True])
def test_a_dense_twin_has_the_same_modulus(bonded: bool) -> None:
    """A disordered heap, with and without cement, has the modulus that the naive laws give."""
    state, edges = jumbled(3, bonded=bonded)
    # Springs of 1e-9 of a contact's hold the disks of the sparse solution.
    assert shear_modulus(state, edges) == pytest.approx(dense_modulus(state, edges), rel=1e-7)


def test_the_mirror_image_and_the_turned_sample_are_as_stiff() -> None:
    """Mirrored at a vertical line, or turned by 180 degrees, a heap has the same modulus."""
    state, (left, right, lower, upper) = jumbled(4, bonded=True)
    scene, found = state.scene, shear_modulus(state, (left, right, lower, upper))
    mirrored = start(replace(scene, x=-np.asarray(scene.x)), features=state.features)
    assert shear_modulus(mirrored, (right, left, lower, upper)) == pytest.approx(found, rel=1e-9)
    turned = start(replace(scene, x=-np.asarray(scene.x), y=-np.asarray(scene.y)), features=state.features)
    assert shear_modulus(turned, (right, left, upper, lower)) == pytest.approx(found, rel=1e-9)


def test_more_cement_never_makes_a_sample_slower(small_packing: Packing) -> None:
    """Springs that are added only stiffen: with the same seed the speed grows with the content."""
    experiment = Experiment(packing=small_packing, wave=WaveRule(boundary_thickness=0.012))
    ordering = experiment.ordering(1)
    speeds = [static_speed(experiment, ordering.at(content).bonded) for content in (0.0, 0.3, 0.66, 3.0, 9.0)]
    assert np.all(np.diff(speeds) > 0.0)


def test_what_has_no_stiffness_is_refused() -> None:
    """Disks that do not touch, rows without disks and broken bonds are refused in a sentence."""
    x, y = hexagonal(3, 3, 2.1 * RADIUS)
    apart = start(Scene(x, y, np.full(9, RADIUS), SOFT), regime="linear")
    with pytest.raises(ValueError, match="without contacts"):
        shear_modulus(apart, rows_of(3, 3))
    state, (left, right, lower, _) = jumbled(3, bonded=True)
    with pytest.raises(ValueError, match="give disks to each row"):
        shear_modulus(state, (left, right, lower, np.zeros(0, dtype=int)))
    state.assembly.pairs.intact[np.flatnonzero(state.assembly.pairs.cemented)[0]] = 0
    with pytest.raises(ValueError, match="broken bonds"):
        shear_modulus(state, (left, right, lower, lower))
