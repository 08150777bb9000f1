import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from places import CHECKOUT
from scenes import ACCOUNT, BONDED, HERTZ, LINEAR, RADIUS, SERVO, SOFT, jumble, pair_scene, throw

from calcidem.dem.engine.leapfrog import State, change_step, look_ahead
from calcidem.dem.engine.portable import root
from calcidem.dem.engine.readout import Energies, contact_forces, energies, net_forces, wall_contacts, wall_reactions
from calcidem.dem.engine.scene import Bonds, Cement, Sand, Scene, Wall
from calcidem.dem.engine.stability import critical_time_step, critical_time_step_of_disks
from calcidem.dem.engine.state import UnstableRunError, _contact_durations, _instant, advance, start

sys.path.append(str(CHECKOUT / "benchmarks" / "stability"))

from step_limits import fastest_mode

FLOOR = Wall((0.0, 0.0), (0.0, 1.0))
GRAVITY = 9.81


def collide(speed: float, **options: float) -> tuple[State, float]:
    """Two disks that just touch run at each other: the state after it, and the largest energy over the first."""
    state = start(pair_scene(sand=Sand()), features=HERTZ, velocity=np.array([[speed, 0.0], [-speed, 0.0]]), **options)
    first = energies(state).kinetic
    largest = 0.0
    while state.velocity()[1, 0] < 0.0 or len(contact_forces(state).pairs):
        state = advance(state, 1)
        now = energies(state)
        largest = max(largest, (now.kinetic + now.elastic) / first)
    return state, largest


@pytest.mark.parametrize("speed", [1e-3, 0.1, 1.0, 10.0, 100.0])
@pytest.mark.parametrize("fraction", [0.8, 1.0])
def test_an_impact_at_any_speed_gives_its_energy_back(speed: float, fraction: float) -> None:
    """At the default step and at the limit restitution is 1 and energy never grows, both to 1e-3."""
    state, largest = collide(speed, step_fraction=fraction)
    assert largest < 1.001
    assert state.velocity()[1, 0] / speed == pytest.approx(1.0, abs=1e-3)


def test_the_default_step_resolves_an_impact() -> None:
    """Between 35 and 45 steps a contact with friction, whatever the speed, up to where disks cross part of a radius."""
    scene, radius = pair_scene(sand=Sand()), np.array([RADIUS])
    coefficient = float(Sand().hertz_coefficient(radius, radius)[0])
    for speed in (1e-4, 1e-2, 1.0):
        state = start(scene, features=HERTZ, velocity=np.array([[speed, 0.0], [-speed, 0.0]]))
        deepest = (5.0 * scene.mass[0] / 2.0 * (2.0 * speed) ** 2 / (4.0 * coefficient)) ** 0.4
        assert 35.0 < 2.943275 * deepest / (2.0 * speed) / state.time_step[0] < 45.0


def column(**options: object) -> Scene:
    """Three disks one above the other that just touch each other and the floor."""
    height = RADIUS * np.array([1.0, 3.0, 5.0])
    settings = {"walls": (FLOOR,), "sand": Sand(), **options}
    return Scene(np.zeros(3), height, np.full(3, RADIUS), **settings)  # type: ignore[arg-type]


def followed(scene: Scene, steps: int) -> Iterator[tuple[Energies, float]]:
    """Give the energies 40 times, each time some steps later, and the most that was in one form so far."""
    state = start(scene, features=ACCOUNT)
    turned = 0.0
    for _ in range(40):
        state = advance(state, steps)
        now = energies(state)
        turned = max(turned, now.kinetic, now.elastic)
        yield now, turned


def test_a_column_that_just_touches_bounces_under_its_weight_without_gaining_energy() -> None:
    """Released at rest, its energy is what gravity supplies, to a thousandth of what is turned over."""
    for now, turned in followed(column(gravity=(0.0, -GRAVITY)), 50):
        assert abs(now.imbalance) < 2e-3 * turned


def test_a_servo_lid_comes_to_rest_on_disks_that_just_touch() -> None:
    """Lid and floor bear the target, though the first contacts had no stiffness to choose a step by."""
    lid = Wall((0.0, 6.0 * RADIUS), (0.0, -1.0), servo_force=100.0)
    state = advance(start(column(walls=(FLOOR, lid), damping=0.5), features=SERVO), 4000)
    np.testing.assert_allclose(wall_reactions(state)[:, 0], 100.0, rtol=1e-3)


def test_the_step_shrinks_before_a_falling_disk_arrives() -> None:
    """A disk is dropped on another: the step gets smaller in flight, and the fall is that of Galilei."""
    gap = 2.0 * RADIUS
    scene = Scene(
        np.zeros(2),
        np.array([RADIUS, 3.0 * RADIUS + gap]),
        np.full(2, RADIUS),
        gravity=(0.0, -GRAVITY),
        held=np.array([True, False]),
    )
    state = first = start(scene, features=HERTZ)
    for sign in (-1.0, 1.0):
        # Down, then up again; the first look at the velocity is before gravity has acted.
        state = advance(state, 100)
        while sign * state.velocity()[1, 1] > 0.0:
            state = advance(state, 100)
    assert state.time_step[0] < first.time_step[0]
    assert state.position()[1, 1] - 3.0 * RADIUS == pytest.approx(gap, rel=1e-3)
    assert state.time[0] == pytest.approx(2.0 * np.sqrt(2.0 * gap / GRAVITY), rel=1e-2)


def test_a_disk_that_starts_at_rest_far_above_the_floor_is_looked_at_before_it_arrives() -> None:
    """Released where nothing is listed yet, under 170 g, it gives its energy back: the fall is foreseen at rest."""
    scene = column(gravity=(0.0, -170.0 * GRAVITY))
    scene = replace(scene, y=scene.y + 0.3 * RADIUS * np.arange(1.0, 4.0))
    *_, (now, turned) = followed(scene, 25)
    assert abs(now.imbalance) < 2e-3 * turned


def test_the_limit_follows_contacts_that_stiffen_where_that_matters() -> None:
    """A disk that a load presses three times as deep: a step near its limit follows, one far below it need not."""
    depth = 1e-3 * RADIUS
    scene = Scene(np.zeros(1), np.array([RADIUS - depth]), np.array([RADIUS]), walls=(FLOOR,), sand=Sand(), damping=0.7)
    push = net_forces(start(scene, features=HERTZ))[0, 1]
    # Without the bound by impacts, whose step is below half of the limit.
    for part, follows in ((0.3, False), (0.75, True)):
        loaded = replace(scene, load=np.array([[0.0, -5.0 * push, 0.0]]))
        first = advance(start(loaded, features=HERTZ, step_fraction=part, steps_per_contact=1e-9), 1)
        state = advance(first, 2000)
        assert RADIUS - state.position()[0, 1] == pytest.approx(5.0 ** (2.0 / 3.0) * depth, rel=1e-3)
        fallen = state.control.stability[0] / first.control.stability[0]
        # The limit is that of a stiffness as the root of the overlap, known to 30 % of the latter.
        assert fallen == pytest.approx(1.0) if not follows else fallen < 1.05 * 5.0 ** (-1.0 / 6.0)


def squeezed(elsewhere: str = "") -> State:
    """Three disks below a wall that comes down, and held disks or a loaded one far away."""
    x, y, radius = [0.0, 0.0, 0.0], [RADIUS, 3.0 * RADIUS, 5.0 * RADIUS], [RADIUS] * 3
    load, held = np.zeros((5, 3)), np.zeros(5, dtype=bool)
    if elsewhere == "held disks":
        x, y, radius = [*x, 100.0 * RADIUS, 101.7 * RADIUS], [*y, RADIUS, RADIUS], [*radius, RADIUS, RADIUS]
        held[3:] = True
    elif elsewhere == "a loaded disk":
        own = 20.0 * RADIUS
        depth = (1e6 / float(Sand().hertz_coefficient(np.array([own]), np.array([np.inf]))[0])) ** (2.0 / 3.0)
        x, y, radius = [*x, 1000.0 * RADIUS], [*y, own - depth], [*radius, own]
        load[3, 1] = -1e6
    scene = Scene(
        np.array(x),
        np.array(y),
        np.array(radius),
        sand=Sand(friction=0.0),
        walls=(FLOOR, Wall((0.0, 6.0 * RADIUS - 1e-9), (0.0, -1.0), velocity=(0.01, 0.0), span=(-0.05, 0.05))),
        load=load[: len(x)],
        held=held[: len(x)],
    )
    return advance(start(scene, features=HERTZ), 600)


@pytest.mark.parametrize("elsewhere", ["held disks", "a loaded disk"])
def test_a_deep_contact_elsewhere_changes_no_step(elsewhere: str) -> None:
    """The step is that of the contacts that matter, whatever energy others have stored."""
    alone, beside = squeezed(), squeezed(elsewhere)
    assert beside.time_step == alone.time_step
    np.testing.assert_allclose(beside.position()[:3], alone.position(), rtol=1e-9)


def test_a_small_disk_in_free_flight_has_not_blown_up() -> None:
    """The step resolves the motion of the smallest disk, of which the mean radius, and so the skin, say nothing."""
    scene = Scene(np.zeros(2), np.array([0.0, 500.0 * RADIUS]), RADIUS * np.array([1.0, 100.0]), sand=SOFT)
    state = advance(start(scene, features=HERTZ, velocity=np.array([[1e3 * RADIUS * 2.0, 0.0], [0.0, 0.0]])), 50)
    assert state.time_step[0] * 2e3 < 0.1
    assert state.position()[0, 0] == pytest.approx(2e3 * RADIUS * state.time[0])


@pytest.mark.parametrize("steps_before", [1, 10])
def test_a_changed_step_costs_no_energy(steps_before: int) -> None:
    """A step that is halved at the beginning or in the middle of an impact leaves restitution at 1."""
    velocity = np.array([[1.0, 0.0], [-1.0, 0.0]])
    state = advance(start(pair_scene(sand=Sand()), features=HERTZ, velocity=velocity), steps_before)
    halved = change_step(state, look_ahead(state), 0.5 * state.time_step)
    assert (halved.steps, halved.control.began) == (state.steps + 1, (state.steps, state.time))
    state = advance(halved, 100)
    assert state.velocity()[1, 0] == pytest.approx(1.0, abs=1e-3)
    steps = state.control.began[0]
    assert state.time[0] == pytest.approx((2.0 * steps + state.steps - steps) * state.time_step[0], rel=1e-12)


def test_a_run_in_parts_has_the_bits_of_the_whole() -> None:
    """The step is looked at at fixed steps, however a run is divided."""
    scene = jumble(5, 9)
    velocity, spin = throw(scene, 5, 1.0)
    state = start(scene, features=ACCOUNT, velocity=velocity, spin=spin)
    whole, parts = advance(state, 300), state
    for steps in (1, 32, 67, 200):
        parts = advance(parts, steps)
    assert np.array_equal(whole.motion.displacement, parts.motion.displacement)
    assert np.array_equal(whole.time, parts.time)


def test_a_fixed_step_above_what_the_limit_becomes_is_an_error_with_step_and_disk() -> None:
    """A step that suits a slow fall is refused when the disk has become fast."""
    scene = Scene(
        np.zeros(1), np.array([1.005 * RADIUS]), np.array([RADIUS]), walls=(FLOOR,), load=np.array([[0.0, -1e4, 0.0]])
    )
    slow = start(replace(scene, load=scene.load * 1e-6), features=HERTZ)
    state = start(replace(scene, load=scene.load * 1e-6), features=HERTZ, time_step=slow.critical_time_step)
    state = replace(state, scene=scene, assembly=start(scene, features=HERTZ).assembly)
    with pytest.raises(UnstableRunError, match=r"after \d+ steps the limit is .* disk 0, which began at"):
        advance(state, 1000)


def test_a_step_that_stays_is_worth_a_tight_limit() -> None:
    """It is that of the whole scene; a step that follows the disks begins at the lower limit of single disks."""
    scene = jumble(2, walls=False)
    fixed = start(scene, features=HERTZ, steps_per_contact=0.0)
    tight, cheap = (find(scene, fixed.assembly, HERTZ) for find in (critical_time_step, critical_time_step_of_disks))
    assert fixed.critical_time_step == tight > cheap
    assert start(scene, features=HERTZ, steps_per_contact=1e-9).critical_time_step == cheap


@pytest.mark.parametrize("features", [HERTZ, LINEAR])
def test_a_velocity_that_is_no_number_is_an_error_with_step_and_disk(features: object) -> None:
    """NaN is never handed back."""
    state = advance(start(pair_scene(gap=-1e-6), features=features), 3)  # type: ignore[arg-type]
    state.motion.velocity[1, 1] = np.nan
    with pytest.raises(UnstableRunError, match=r"after \d+ steps disk [01]"):
        advance(state, 5)


def test_energy_from_nowhere_is_an_error_with_step_and_disk() -> None:
    """Disks that are pushed by other than loads and walls end the run."""
    state = advance(start(pair_scene(sand=Sand()), features=HERTZ, velocity=np.array([[0.1, 0.0], [0.0, 0.0]])), 40)
    state.motion.velocity[0, 0] = 0.15
    with pytest.raises(UnstableRunError, match=r"after \d+ steps there are .* disk [01]"):
        advance(state, 100)


def test_gravity_is_a_load_of_mass_times_acceleration() -> None:
    """The same bits either way."""
    scene = column()
    load = np.column_stack([0.0 * scene.mass, -GRAVITY * scene.mass, 0.0 * scene.mass])
    one, other = (
        advance(start(replace(scene, **by), features=HERTZ), 100)
        for by in ({"gravity": (0.0, -GRAVITY)}, {"load": load})
    )
    assert np.array_equal(one.motion.velocity, other.motion.velocity)


def test_contact_forces_and_wall_contacts_add_up_to_net_forces() -> None:
    """With the signs and arms that their docstrings give, on disks whose pairs are listed in either order."""
    scene = jumble(2, 12, share_bonded=0.5, installation="zero", cement=Cement(bond_modulus=2e8))
    scene = replace(
        scene,
        x=scene.y.copy(),
        y=-scene.x,
        walls=(Wall((0.0, float(np.min(-scene.x)) - 0.99 * RADIUS), (0.0, 1.0), friction=0.3),),
    )
    velocity, spin = throw(scene, 3)
    state = advance(start(scene, features=BONDED, velocity=velocity, spin=spin), 30)
    place, net = state.position(), np.zeros((scene.count, 3))
    found, walls = contact_forces(state), wall_contacts(state)
    for (i, j), overlap, normal, shear, moment in zip(
        found.pairs, found.overlap, found.normal, found.shear, found.moment, strict=True
    ):
        n = (place[j] - place[i]) / np.hypot(*(place[j] - place[i]))
        force = normal * n + shear * np.array([-n[1], n[0]])
        net[j, :2] += force
        net[i, :2] -= force
        net[j, 2] += moment - shear * (scene.radius[j] - overlap / 2.0)
        net[i, 2] += -moment - shear * (scene.radius[i] - overlap / 2.0)
    for disk, overlap, normal, shear in zip(walls.disks, walls.overlap, walls.normal, walls.shear, strict=True):
        net[disk] += (-shear, normal, -shear * (scene.radius[disk] - overlap / 2.0))
    np.testing.assert_allclose(net, net_forces(state), atol=1e-9 * np.abs(found.normal).max(), rtol=1e-6)
    assert len(walls.disks) > 0
    assert np.abs(found.moment).max() > 0.0
    np.testing.assert_allclose(walls.normal.sum(), wall_reactions(state)[0, 0], rtol=1e-12)
    np.testing.assert_allclose(-walls.shear.sum(), wall_reactions(state)[0, 1], rtol=1e-9)


def bonded_across_gaps(seed: int) -> Scene:
    """A random tree of disks, and some more pairs, bonded across gaps up to two radii."""
    draw = np.random.default_rng(seed)
    radius = RADIUS * draw.uniform(0.5, 1.5, int(draw.integers(2, 8)))
    place, pairs = np.zeros((len(radius), 2)), []
    for new in range(1, len(radius)):
        near = np.ones(1)
        while near.min() <= 0.0 or near.size == 1:
            old, angle = int(draw.integers(new)), draw.uniform(0.0, 2.0 * np.pi)
            reach = radius[old] + radius[new] + draw.uniform(0.0, 2.0) * min(radius[old], radius[new])
            place[new] = place[old] + reach * np.array([np.cos(angle), np.sin(angle)])
            gaps = np.hypot(*(place[:new] - place[new]).T) - radius[:new] - radius[new]
            near = np.append(gaps + 1e-12, 1.0)
        pairs += [
            (other, new) for other in range(new) if other == old or (gaps[other] < RADIUS and draw.random() < 0.5)
        ]
    ratio, linear = 10.0 ** draw.uniform(-1.0, 1.0, 2)
    cement = Cement(bond_stiffness_ratio=ratio, linear_modulus=1e10, linear_stiffness_ratio=linear)
    return Scene(*place.T.copy(), radius, bonds=Bonds(np.array(pairs), cement, installation="zero"))


def test_the_limit_is_a_bound_where_cement_spans_gaps() -> None:
    """Predicted over true limit, from eigenvalues, is at most 1 for gaps up to two radii and kappa from 0.1 to 10."""
    ratios = []
    for seed in range(60):
        state = start(bonded_across_gaps(seed), features=LINEAR)
        ratios.append(float(state.critical_time_step[0]) * fastest_mode(state) / 2.0)
    assert max(ratios) <= 1.0 + 1e-9
    assert min(ratios) > 0.85


@pytest.mark.parametrize("rescaling", [True, pytest.param(False, marks=pytest.mark.full)])
def test_mode_1_forgets_the_shear_force_of_a_contact_that_vibrates(rescaling: bool) -> None:
    """A stuck contact whose overlap falls from d to e in each cycle keeps sqrt(e / d) of it; mode 0 keeps all."""
    depth, swing, cycles, stroke = 1e-6, 0.1, 5, 50
    sand = Sand(SOFT.shear_modulus, friction=20.0)
    scene = pair_scene(gap=-depth, sand=sand, held=np.ones(2, dtype=bool), rescaling=rescaling)
    state = start(scene, features=replace(ACCOUNT, rescaling=rescaling), time_step=1e-7)
    state.assembly.pairs.shear[...] = 0.1
    for direction in (-1.0, 1.0) * cycles:
        state.motion.velocity[1, 0] = direction * swing * depth / (stroke * 1e-7)
        state = advance(replace(state, steps=max(1, state.steps)), stroke)
    kept = float(look_ahead(state).assembly.pairs.shear[0, 0]) / 0.1
    expected = (1.0 + swing) ** (-0.5 * cycles) if rescaling else 1.0
    assert kept == pytest.approx(expected, rel=1e-3)


def test_roots_are_right_to_two_units_in_the_last_place() -> None:
    """Cube and fifth roots over the whole range of numbers, without a power of the C library."""
    values = 10.0 ** np.random.default_rng(0).uniform(-300.0, 300.0, 20_000)
    for degree in (3, 5):
        exact = values.astype(np.longdouble) ** (np.longdouble(1.0) / degree)
        assert float(np.max(np.abs(root(values, degree) - exact) / exact)) < 2.0 * np.finfo(float).eps
    assert root(np.array([0.0, 8.0]), 3).tolist() == [0.0, 2.0]


def test_a_disk_alone_has_the_limit_of_one_in_a_row_pressed_by_a_thousandth() -> None:
    """``omega^2 = 12 k / m`` is that of turning disks in a row with two contacts each, equally stiff in shear."""
    scene = replace(pair_scene(sand=SOFT), x=np.zeros(1), y=np.zeros(1), radius=np.full(1, RADIUS))
    radius = np.full(1, RADIUS)
    stiffness = 1.5 * SOFT.hertz_coefficient(radius, radius) * np.sqrt(1e-3 * RADIUS)
    assert start(scene, features=HERTZ).critical_time_step == pytest.approx(
        2.0 / np.sqrt(12.0 * stiffness / scene.mass)
    )


def test_a_held_disk_makes_no_contact_of_its_own() -> None:
    """The step follows from the contact of the disk that moves, however small the held one is."""
    scene = pair_scene(second_radius=0.1 * RADIUS, held=np.array([False, True]))
    state = start(scene, features=HERTZ, velocity=np.array([[1.0, 0.0], [0.0, 0.0]]))
    now = _instant(state, look_ahead(state))
    durations, _ = _contact_durations(state, now)
    assert np.isfinite(state.to_scene_order(durations)).ravel().tolist() == [True, False]
