"""The static stiffness against closed forms, a dense twin made of the naive laws, and stiff patches at the walls."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from naive import Twin, add_pair, make_twin
from scenes import LINEAR, RADIUS, SOFT, SOFT_CEMENT, SPACING, contact_stiffness, hexagonal
from scipy.spatial import Delaunay
from test_distance import lattice_experiment, shear_speed

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.scene import Bonds, Cement, Scene
from calcidem.dem.engine.state import start
from calcidem.dem.kernels.layout import Flags, Floats
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave import static_speed as static
from calcidem.dem.wave.experiment import Experiment, WaveRule
from calcidem.dem.wave.static_speed import sheared_motion, sheared_triangles, static_speed


def rim_of(x: Floats, y: Floats, *, ends: bool = True) -> Flags:
    """Disks of the outermost columns and, if wanted, rows of a lattice."""
    rim = (x < 0.6 * SPACING) | (x > x.max() - 0.6 * SPACING)
    return np.asarray(rim | (ends & ((y < 1e-9) | (y > y.max() - 1e-9))))


def part_of(state: State, rim: Flags, disks: Flags) -> tuple[float, float]:
    """Modulus and density of the part of a sheared sample whose triangles have all corners among some disks."""
    corners = Delaunay(np.column_stack([state.scene.x, state.scene.y])).simplices
    triangles = sheared_triangles(state, sheared_motion(state, rim), corners)
    return triangles.weighted(disks[corners].all(axis=1).astype(float))


def lattice_errors(x: Floats, y: Floats, modulus: float, cell: float) -> Floats:
    """Relative errors of the modulus of a lattice's middle, held all around and at two sides, and of its density."""
    state = start(Scene(x, y, np.full(len(x), RADIUS), SOFT), law="linear")
    middle = np.maximum(np.abs(x - x.mean()) / np.ptp(x), np.abs(y - y.mean()) / np.ptp(y)) < 0.3
    found = [part_of(state, rim_of(x, y, ends=ends), middle) for ends in (True, False)]
    density = found[0][1] * cell / (np.pi * RADIUS**2)
    return np.array([*(part[0] / modulus - 1.0 for part in found), density - 1.0])


@pytest.mark.parametrize("size", [17, 33])
def test_the_middle_of_a_hexagonal_lattice_has_the_modulus_of_its_shear_wave(size: int) -> None:
    """It is rho c_s^2 = sqrt(3) / 4 (k_n + k_s) to what freely turning disks at the rim do, which dies off inwards."""
    normal, shear = contact_stiffness()
    modulus, cell = np.sqrt(3.0) / 4.0 * (normal + shear), SPACING**2 * np.sqrt(0.75)
    held, sides_alone, solid = np.abs(lattice_errors(*hexagonal(size, size, SPACING), modulus, cell))
    assert held < 1e-5
    assert sides_alone < 0.25 / size**2  # a shear that varies also bends a lattice of disks that turn
    assert solid < 1e-12


def test_the_middle_of_a_square_lattice_has_the_modulus_of_its_shear_wave() -> None:
    """It is rho c_s^2 = k_s / 2 to rounding, however the lattice is held, and with any triangles between its disks."""
    x, y = (values.ravel() * SPACING for values in np.meshgrid(np.arange(12.0), np.arange(15.0)))
    assert np.abs(lattice_errors(x, y, contact_stiffness()[1] / 2.0, SPACING**2)).max() < 1e-11


def jumbled(seed: int, *, bonded: bool) -> tuple[State, Flags]:
    """Twenty-five unequal disks with some bonds, and which of them are at the rim."""
    generator = np.random.default_rng(seed)
    x, y = hexagonal(5, 5, 1.97 * RADIUS)
    rim = rim_of(x, y)
    x, y = x + generator.uniform(-5e-3, 5e-3, 25) * RADIUS, y + generator.uniform(-5e-3, 5e-3, 25) * RADIUS
    near = [(i, j) for i in range(25) for j in range(i) if np.hypot(x[i] - x[j], y[i] - y[j]) < 2.0 * RADIUS]
    bonds = Bonds(np.array(near)[generator.random(len(near)) < 0.4], SOFT_CEMENT) if bonded else None
    scene = Scene(x, y, RADIUS * generator.uniform(0.995, 1.005, 25), SOFT, bonds=bonds)
    features = LINEAR if bonded else replace(LINEAR, bonds=False, linear_group=False)
    return start(scene, features=features), rim


def dense_motion(state: State, rim: Flags) -> Floats:
    """(N, 3) motion from forces that the naive laws give for a unit motion of each disk, solved as a dense system."""
    scene, count = state.scene, state.scene.count
    stiffness = _naive_stiffness(make_twin(scene, state.features, 1.0, np.zeros((count, 2)), np.zeros(count)))
    free = np.column_stack([~rim, ~rim, np.ones(count, dtype=bool)]).ravel()
    moved = np.column_stack([np.zeros(count), scene.x, np.zeros(count)]).ravel()
    moved[free] = -np.linalg.solve(stiffness[np.ix_(free, free)], stiffness[np.ix_(free, ~free)] @ moved[~free])
    return moved.reshape(-1, 3)


def _naive_stiffness(twin: Twin) -> Floats:
    """(3 N, 3 N) less the forces and moments of unit motions."""
    count = twin.scene.count
    stiffness = np.empty((3 * count, 3 * count))
    for column in range(3 * count):
        twin.moved[...] = 0.0
        twin.moved.flat[column] = 1.0
        force = np.zeros((count, 3))
        for i in range(count):
            for j in range(i + 1, count):
                add_pair(twin, i, j, 0.0, force)
        stiffness[:, column] = -force.ravel()
    return stiffness


@pytest.mark.parametrize("bonded", [False, True])
def test_a_dense_twin_moves_in_the_same_way(bonded: bool) -> None:
    """A disordered heap that is sheared, with and without cement, comes to rest where the naive laws say."""
    state, rim = jumbled(3, bonded=bonded)
    expected = dense_motion(state, rim)
    # Springs of 1e-9 of a contact's hold the disks of the sparse solution.
    found = sheared_motion(state, rim)
    scale = np.array([1.0, 1.0, RADIUS])
    np.testing.assert_allclose(found * scale, expected * scale, atol=1e-7 * np.ptp(np.asarray(state.scene.x)))


def test_the_mirror_image_and_the_turned_sample_are_as_stiff() -> None:
    """Mirrored at a vertical line, or turned by 180 degrees, a heap has the same modulus."""
    state, rim = jumbled(4, bonded=True)
    scene, everything = state.scene, np.ones(25, dtype=bool)
    found = part_of(state, rim, everything)
    mirrored = start(replace(scene, x=-np.asarray(scene.x)), features=state.features)
    turned = start(replace(scene, x=-np.asarray(scene.x), y=-np.asarray(scene.y)), features=state.features)
    for other in (mirrored, turned):
        assert part_of(other, rim, everything) == pytest.approx(found, rel=1e-9)


def test_static_speeds_grow_with_cement(small_packing: Packing) -> None:
    """From no cement to 9 % the inner part gets many times as fast; a box of 280 disks tells its speed to 20 %."""
    experiment = Experiment(packing=small_packing, wave=WaveRule(boundary_thickness=0.012))
    ordering = experiment.ordering(1)
    found = [static_speed(experiment, ordering.at(content).bonded) for content in (0.0, 0.66, 9.0)]
    assert np.all(np.diff([one.speed for one in found]) > 0.0)
    assert all(0.0 < one.error < 0.2 for one in found)


def test_the_error_of_a_static_speed_has_its_closed_form(
    small_packing: Packing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half the difference of both shears and half the range over three sizes add as squares; zero is refused."""
    experiment = Experiment(small_packing)
    both = iter([(300.0, 330.0, 340.0), (280.0, 270.0, 290.0), (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)])
    density = experiment.stiffen()[1].density

    def triangles(*_: object) -> SimpleNamespace:
        parts = ((density * v * v, 1.0) for v in next(both))
        return SimpleNamespace(middle=np.zeros((1, 2)), weighted=lambda _: next(parts))

    monkeypatch.setattr(static, "_state_at_rest", lambda *_: None)
    monkeypatch.setattr(static, "sheared_motion", lambda *_: None)
    monkeypatch.setattr(static, "sheared_triangles", triangles)
    found = static_speed(experiment, np.zeros(len(small_packing.pairs), dtype=bool))
    assert found.speed == pytest.approx(np.sqrt(330.0 * 270.0))
    assert found.error * found.speed == pytest.approx(np.hypot(30.0, 0.5 * (315.0 - 290.0)))
    with pytest.raises(ValueError, match="the inner part of the sample carries no shear"):
        static_speed(experiment, np.zeros(len(small_packing.pairs), dtype=bool))


def test_a_stiff_patch_at_the_wall_does_not_change_the_static_speed() -> None:
    """Cement that joins two walls at a corner makes a small box stiffer, not its inner part, nor the error."""
    experiment = lattice_experiment(3)
    packing = experiment.packing
    experiment = experiment.with_wave(boundary_thickness=0.2 * packing.height, boundary_damping=1.0)
    none = np.zeros(len(packing.preload.pairs), dtype=bool)
    ends = packing.preload.pairs
    corner = np.maximum(packing.x / packing.width, packing.y / packing.height) < 0.15
    bare, patched = (static_speed(experiment, flags) for flags in (none, corner[ends].all(axis=1)))
    # Free disks at floor and lid turn in another way.
    assert bare.speed == pytest.approx(shear_speed(), rel=1e-3)
    assert bare.error < 1e-3
    assert abs(patched.speed / bare.speed - 1.0) < min(0.03, 2.0 * patched.error)


def test_rows_count_with_the_energy_of_the_wave_in_them() -> None:
    """Contacts of one row that are a fifth stiffer raise the modulus in proportion to cos^2(pi y / h) of that row.

    All rows together raise it by a fifth; those in the damped layers, which the wave cannot enter, by nothing.
    """
    given, one = lattice_experiment(3), np.array([RADIUS])
    packing = given.packing
    normal = 1.5 * float(SOFT.hertz_coefficient(one, one)[0]) * np.sqrt(packing.report.mean_overlap)
    cement = Cement(bond_modulus=1e9, linear_modulus=0.0, bond_stiffness_ratio=1.0 / SOFT.shear_ratio)
    cement = replace(cement, bond_modulus=1.2e9 * normal / float(cement.bond_stiffness(one, one)[0][0]))
    spacing = 2.0 * RADIUS - packing.report.mean_overlap
    layer = float(packing.y.min()) + 3.5 * spacing  # of 21 rows the outer four at either side
    experiment = replace(given, cement=cement).with_wave(boundary_thickness=layer, boundary_damping=1.0)
    row = np.rint((packing.y - packing.y.min()) / spacing).astype(int)
    bare = static_speed(experiment, np.zeros(len(packing.pairs), dtype=bool)).speed

    def rise(*rows: int) -> float:
        """Relative rise of the modulus with cement among these rows."""
        return (static_speed(experiment, np.isin(row, rows)[packing.pairs].all(axis=1)).speed / bare) ** 2 - 1.0

    assert rise(*range(21)) == pytest.approx(0.2, rel=1e-3)
    middle = rise(10)
    for number in (5, 6, 7, 8, 9, 13):
        energy = np.cos(np.pi * (number - 10) * spacing / (packing.height - 2.0 * layer)) ** 2
        assert rise(number) / middle == pytest.approx(energy, abs=0.03)  # a row turns the disks of its neighbours, too
    for number in (0, 1, 3, 20):
        assert abs(rise(number)) < 5e-3 * middle  # at the corners held disks take part


def test_what_has_no_stiffness_is_refused() -> None:
    """Disks that do not touch or are not held, parts without neighbours and broken bonds are refused in a sentence."""
    x, y = hexagonal(3, 3, 2.1 * RADIUS)
    apart = start(Scene(x, y, np.full(9, RADIUS), SOFT), law="linear")
    with pytest.raises(ValueError, match="without contacts"):
        sheared_motion(apart, rim_of(x, y))
    state, rim = jumbled(3, bonded=True)
    with pytest.raises(ValueError, match="give disks that follow the shear"):
        sheared_motion(state, np.zeros(25, dtype=bool))
    with pytest.raises(ValueError, match="at least one triangle"):
        part_of(state, rim, np.arange(25) < 2)
    state.assembly.pairs.intact[np.flatnonzero(state.assembly.pairs.cemented)[0]] = 0
    with pytest.raises(ValueError, match="broken bonds"):
        sheared_motion(state, rim)
