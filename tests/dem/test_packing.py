from dataclasses import replace

import numpy as np
import pytest
from scenes import HERTZ

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.readout import (
    contact_forces,
    net_forces,
    overlaps,
    unbalanced_ratio,
    wall_overlaps,
    wall_reactions,
)
from calcidem.dem.engine.scene import Sand, Scene
from calcidem.dem.engine.stability import critical_time_step_of_disks, scaled_densities
from calcidem.dem.engine.state import start
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.compaction import Cost, _draw_radii, _place_apart, box_walls, make_packing, relax
from calcidem.dem.sample.packing import WALL_NAMES, Packing, PackingError, PackingRule, PackingStage
from calcidem.dem.wave.static_speed import _contact_springs

pytestmark = pytest.mark.slow

LEFT, RIGHT, FLOOR, LID = range(len(WALL_NAMES))
SMALL = PackingRule(width=0.02, height=0.03, stress=5.0e3)
SAND = Sand()


def generator() -> np.random.Generator:
    """Source of sizes and positions, the same each time."""
    return np.random.default_rng(20)


@pytest.fixture(scope="module")
def small() -> Packing:
    """A packing of about a hundred disks."""
    return make_packing(SMALL, SAND, generator())


def rebuilt(packing: Packing, rule: PackingRule) -> State:
    """The packing as a scene at time zero, with the friction it was prepared with."""
    sand = replace(SAND, friction=rule.friction_preparation)
    walls = box_walls(packing.width, packing.height)
    scene = Scene(packing.x, packing.y, packing.radius, sand, walls)
    return start(scene, features=HERTZ, preload=packing.preload)


def test_a_packing_is_at_rest(small: Packing) -> None:
    """Unbalanced forces are a millionth of the contact forces, in the report and when the scene is built again."""
    assert small.report.unbalanced_ratio < SMALL.unbalanced_force_ratio
    state = rebuilt(small, SMALL)
    # The lid's position is rounded to the box height, the histories to the step before: both below the limit itself.
    assert unbalanced_ratio(state) < 3.0 * SMALL.unbalanced_force_ratio
    weight = contact_forces(state).normal.mean()
    assert np.abs(net_forces(state)[:, :2]).max() < 1e-3 * weight


def test_the_walls_of_a_packing_carry_the_stress_of_the_lid(small: Packing) -> None:
    """Lid and floor carry the target, the side walls equal stresses: frictionless walls cannot carry anything else."""
    stress = small.report.wall_stress
    assert stress[LID] == pytest.approx(SMALL.stress, rel=1e-3)
    # 1e-6 of the summed contact forces, some hundred times that of one wall.
    assert stress[FLOOR] == pytest.approx(stress[LID], rel=1e-3)
    assert stress[LEFT] == pytest.approx(stress[RIGHT], rel=1e-3)
    assert 0.2 < stress[LEFT] / stress[LID] < 2.0
    reactions = wall_reactions(rebuilt(small, SMALL))
    lengths = np.array([small.height, small.height, small.width, small.width])
    np.testing.assert_allclose(reactions[:, 0] / lengths, stress, rtol=1e-3)
    np.testing.assert_array_equal(reactions[:, 1], 0.0)


@pytest.mark.parametrize("ratio", [1.0, 0.7])
def test_the_sides_carry_their_part_of_the_stress(ratio: float) -> None:
    """On the box at rest, wherever its walls have moved; the fewer stress, the wider, and contacts turn upright."""
    rule = replace(SMALL, lateral_stress_ratio=ratio)
    packing = make_packing(rule, SAND, np.random.default_rng(1))
    left, right, floor, lid = packing.report.wall_stress
    assert (lid, floor) == pytest.approx((rule.stress, rule.stress), rel=2e-3)
    assert (left, right) == pytest.approx((ratio * rule.stress, ratio * rule.stress), rel=2e-3)
    contacts = contact_forces(rebuilt(packing, rule))
    branch = np.column_stack([packing.x, packing.y])
    branch = branch[contacts.pairs[:, 1]] - branch[contacts.pairs[:, 0]]
    normal = branch / np.linalg.norm(branch, axis=1)[:, None]
    assert ratio == 1.0 or np.average(normal[:, 1] ** 2, weights=contacts.normal) > 0.5


def test_a_sample_that_the_sides_cannot_hold_yields_in_words() -> None:
    """With little friction and a tenth of the stress no packing of disks is stable."""
    with pytest.raises(PackingError, match=r"yields.*lateral_stress_ratio"):
        make_packing(replace(SMALL, lateral_stress_ratio=0.1), SAND, np.random.default_rng(1))


def test_the_report_of_a_packing_agrees_with_its_disks(small: Packing) -> None:
    """Porosity, contacts, rattlers and overlaps follow from positions and radii."""
    report = small.report
    area = np.pi * np.sum(small.radius**2)
    assert report.porosity == pytest.approx(1.0 - area / (small.width * small.height), abs=1e-12)
    place = np.column_stack([small.x, small.y])
    first, second = np.triu_indices(len(place), 1)
    overlap = small.radius[first] + small.radius[second] - np.hypot(*(place[first] - place[second]).T)
    touching = overlap > 0.0
    pairs = {tuple(sorted(pair)) for pair in small.pairs.tolist()}
    assert pairs == set(zip(first[touching].tolist(), second[touching].tolist(), strict=True))
    assert report.coordination_number == pytest.approx(2.0 * len(pairs) / len(place))
    # Overlaps of 1e-7 m are differences of positions of 1e-2 m, rounded at 1e-18 m.
    assert report.mean_overlap == pytest.approx(overlap[touching].mean(), rel=1e-9)
    assert report.largest_overlap == pytest.approx(overlap[touching].max(), rel=1e-9)
    assert 0 <= report.rattlers < 0.3 * len(place)
    assert report.coordination_number_without_rattlers > report.coordination_number


def test_disks_of_a_packing_lie_within_the_box_and_the_range_of_sizes(small: Packing) -> None:
    """No disk is outside, and the sizes are drawn between the limits."""
    slack = 2.0 * small.report.largest_overlap
    assert np.all(small.x - small.radius > -slack)
    assert np.all(small.x + small.radius < small.width + slack)
    assert np.all(small.y - small.radius > -slack)
    assert np.all(small.y + small.radius < small.height + slack)
    low, high = SMALL.diameter
    # All sizes are scaled together by the sampling error of the summed area, some per cent for a hundred disks.
    assert np.all((2.0 * small.radius > 0.9 * low) & (2.0 * small.radius < 1.1 * high))


def test_shear_forces_of_a_packing_obey_the_friction_of_its_preparation(small: Packing) -> None:
    """No contact carries more than the preparation friction times its normal force."""
    contacts = contact_forces(rebuilt(small, SMALL))
    assert np.all(np.abs(contacts.shear) <= SMALL.friction_preparation * contacts.normal * (1.0 + 1e-9))


@pytest.mark.parametrize(("seed", "stress"), [(1, 5e3), (2, 5e4)])
def test_rough_disks_that_fly_into_each_other_stay_in_the_box(seed: int, stress: float) -> None:
    """Few disks touch while they fly, so that the step is long: two that meet must not throw each other out."""
    rule = PackingRule(0.025, 0.04, stress=stress, friction_preparation=1.0, most_steps=40_000)
    packing = make_packing(rule, Sand(), np.random.default_rng(seed))
    assert np.all((packing.x > 0.0) & (packing.x < rule.width) & (packing.y > 0.0))
    assert packing.y.max() < packing.height


def test_a_stack_of_disks_under_the_lid_is_pressed_as_hertz_says() -> None:
    """Heavier disks and rings come to rest where plain ones do: each contact carries the lid's force, F = h d^1.5."""
    radius = np.array([1.2e-3, 1.0e-3, 1.1e-3, 1.3e-3])
    rule = PackingRule(width=0.01, height=float(2.0 * radius.sum()) + 1e-7, diameter=(2e-3, 2.2e-3))
    height = np.cumsum(2.0 * radius) - radius
    walls = box_walls(rule.width, rule.height, rule.stress)
    scene = Scene(np.full(4, 0.005), height, radius, SAND, walls, damping=rule.damping)
    state = relax(scene, None, rule, Cost(expansion_step=1), lambda: None)
    expected = (rule.stress * rule.width / SAND.hertz_coefficient(radius[:-1], radius[1:])) ** (2 / 3)
    # The lid's force is good to 1e-3.
    np.testing.assert_allclose(contact_forces(state).overlap, expected, rtol=1e-3)
    np.testing.assert_array_equal(state.position()[:, 0], 0.005)


def test_the_step_of_scaled_densities_is_stable_and_long(small: Packing) -> None:
    """It is 0.5 to 1 of 2 / omega_max with the heavier disks, from eigenvalues, and 1.7 to 2.4 of what disks bear."""
    state = rebuilt(small, SMALL)
    depths = overlaps(state), wall_overlaps(state)
    grains, (limit,) = scaled_densities(state.scene, state.assembly, state.features, *depths, 0.35)
    springs, stiffness = _contact_springs(state)
    inverse = np.column_stack([grains.inverse_mass, grains.inverse_mass, grains.inverse_inertia * grains.radius**2])
    modes = np.sqrt(stiffness)[:, None] * springs.toarray() * np.sqrt(inverse.ravel())
    assert 0.5 < limit * np.linalg.norm(modes, 2) / 2.0 <= 1.0
    alone = critical_time_step_of_disks(state.scene, state.assembly, state.features)
    # sqrt(1 / 0.35), and up to sqrt(2) where turning sets the step.
    assert 0.35**-0.5 <= limit / alone[0] <= (2.0 / 0.35) ** 0.5
    assert np.all(grains.inverse_mass <= state.assembly.grains.inverse_mass)
    heavier = replace(state.assembly, grains=grains)
    bound = critical_time_step_of_disks(state.scene, heavier, state.features, *depths, rings=True)
    assert bound == pytest.approx(limit, rel=1e-9)


def test_the_same_generator_makes_the_same_packing(small: Packing) -> None:
    """Positions, radii and forces are the same bits, also if somebody watches; what is told of it only ever rises."""
    told: list[PackingStage] = []
    again = make_packing(SMALL, SAND, generator(), watch=told.append)
    assert [stage.expansion_step for stage in told] == sorted(stage.expansion_step for stage in told)
    assert {stage.expansion_step for stage in told} == set(range(1, SMALL.expansion_steps + 2))
    assert [stage.fraction for stage in told] == sorted(stage.fraction for stage in told)
    assert (told[0].fraction, told[-1].fraction) == (0.0, 1.0)
    for name in ("x", "y", "radius"):
        np.testing.assert_array_equal(getattr(again, name), getattr(small, name))
    np.testing.assert_array_equal(again.preload.shear, small.preload.shear)
    assert again.height == small.height


def test_radii_fill_the_box_to_its_porosity_exactly() -> None:
    """The summed area of the disks is (1 - porosity) of the box."""
    radius = _draw_radii(SMALL, generator())
    assert np.pi * np.sum(radius**2) == pytest.approx((1.0 - SMALL.porosity) * SMALL.width * SMALL.height, rel=1e-12)


def test_disks_are_placed_apart() -> None:
    """Before the expansion no two disks overlap and all lie within the box."""
    radius = 0.6 * _draw_radii(SMALL, generator())
    x, y = _place_apart(SMALL, radius, generator())
    first, second = np.triu_indices(len(radius), 1)
    assert np.all(np.hypot(x[first] - x[second], y[first] - y[second]) >= radius[first] + radius[second])
    assert np.all((x >= radius) & (x <= SMALL.width - radius) & (y >= radius) & (y <= SMALL.height - radius))


def test_a_box_without_room_is_refused() -> None:
    """Disks too large to be placed at random are an error that says what to change."""
    with pytest.raises(PackingError, match="raise the porosity or enlarge the box"):
        _place_apart(SMALL, _draw_radii(SMALL, generator()), generator())


def test_a_packing_that_does_not_come_to_rest_is_given_up() -> None:
    """Beyond the allowed steps the error says how unbalanced it is and what to raise."""
    with pytest.raises(PackingError, match=r"not at rest after \d+ steps .* raise most_steps"):
        make_packing(replace(SMALL, most_steps=800), SAND, generator())


@pytest.mark.full
def test_the_packing_of_the_paper_comes_out_loose_and_at_rest() -> None:
    """4,670 disks prepared with friction 0.2 at 5 kPa: porosity 0.192, coordination number 3.05, lid within 1 %."""
    rule = PackingRule()
    packing = make_packing(rule, SAND, np.random.default_rng(1))
    report = packing.report
    assert len(packing.x) == pytest.approx(4670, rel=0.02)
    assert report.porosity == pytest.approx(0.192, abs=0.004)
    assert report.coordination_number == pytest.approx(3.05, abs=0.15)
    assert report.wall_stress[LID] == pytest.approx(rule.stress, rel=0.01)
    assert report.wall_stress[FLOOR] == pytest.approx(rule.stress, rel=0.01)
    assert report.unbalanced_ratio <= 1e-4


def test_the_content_hash_is_of_every_bit_of_disks_walls_and_forces(small_packing: Packing) -> None:
    """The last bit of any coordinate, radius, wall or force makes another hash; what was measured does not count."""
    known = small_packing.content_hash
    # Written down: stored hashes are compared with those of later versions.
    assert known == "7f527669120572f3d01f15e6c1576c21f568401c25364ca0c7a025f89d8a61ee"
    hashes = {known}
    preload = small_packing.preload
    for name in ("x", "y", "radius"):
        hashes.add(replace(small_packing, **{name: nudged(getattr(small_packing, name))}).content_hash)
    for name in ("width", "height"):
        hashes.add(replace(small_packing, **{name: float(np.nextafter(getattr(small_packing, name), 1))}).content_hash)
    hashes.add(replace(small_packing, preload=replace(preload, shear=nudged(preload.shear))).content_hash)
    hashes.add(replace(small_packing, preload=replace(preload, pairs=preload.pairs[:, ::-1])).content_hash)
    hashes.add(replace(small_packing, x=small_packing.y, y=small_packing.x).content_hash)
    assert len(hashes) == 9
    other_report = replace(small_packing.report, seconds=1e9)
    assert replace(small_packing, report=other_report).content_hash == known


def nudged(values: Floats) -> Floats:
    """Numbers of which the last is changed by its last bit."""
    changed = values.copy()
    changed[-1] = np.nextafter(changed[-1], np.inf)
    return changed
