from dataclasses import replace

import numpy as np
import pytest
from scenes import ACCOUNT, RADIUS, SOFT, SOFT_CEMENT, jumble, pair_scene, throw

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.readout import contact_forces, energies
from calcidem.dem.engine.scene import Bonds, Cement, Preload, Sand, Scene, Wall
from calcidem.dem.engine.state import advance, choose_features, start
from calcidem.dem.kernels.layout import Features
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import WaveRule, wave_scene


def imbalances(scene: Scene, features: Features, step: float, duration: float) -> tuple[float, float]:
    """Change of the energy balance over a run, and the largest energy turned over."""
    velocity, spin = throw(scene, 7)
    state = start(scene, features=features, velocity=velocity, spin=spin, time_step=step)
    state = advance(state, 1)
    first = energies(state)
    last = energies(advance(state, round(duration / step)))
    turned = max(first.kinetic, last.contact_loss, last.damping_loss, abs(last.wall_work - first.wall_work))
    return last.imbalance - first.imbalance, turned


def worst_balance(scene: Scene, features: Features) -> float:
    """Imbalance over 300 steps of 0.4 of the limit, or eight times as many that are finer, over what is turned over."""
    step = 0.4 * float(start(scene, features=features).critical_time_step[0])
    runs = [imbalances(scene, features, part * step, 300.0 * step) for part in (1.0, 0.125)]
    return max(abs(change) / turned for change, turned in runs)


def test_energy_balances_in_a_heap_with_friction_damping_and_moving_walls() -> None:
    """Work of walls, held disks and loads is what is stored and lost, where the step resolves impacts."""
    scene = jumble(3, 16, damping=0.2, load=np.tile([0.3, -0.5, 1e-4], (16, 1)), held=np.arange(16) == 5)
    assert worst_balance(scene, ACCOUNT) < 1e-4


def test_energy_balances_with_bonds_the_better_the_smaller_the_step() -> None:
    """In a bonded heap without sliding contacts only the turning of bonds within a step is lost, of first order."""
    scene = jumble(4, 16, share_bonded=1.0, walls=False, cement=replace(SOFT_CEMENT, linear_modulus=0.0))
    step = 0.4 * float(start(scene, features=ACCOUNT).critical_time_step[0])
    coarse, fine = (
        abs(change) / turned
        for change, turned in (imbalances(scene, ACCOUNT, part * step, 300.0 * step) for part in (1.0, 0.125))
    )
    assert coarse < 1e-5
    assert fine < coarse / 8.0


def test_energy_balances_where_bonds_break() -> None:
    """What a breaking bond loses is what it had stored and the work of its last step, also if that step is long."""
    weak = replace(SOFT_CEMENT, linear_modulus=0.0, tensile_strength=3e4, cohesion=3e4)
    scene = jumble(4, 16, share_bonded=1.0, cement=weak)
    broken = advance(start(scene, features=ACCOUNT, velocity=throw(scene, 7)[0]), 300)
    assert np.count_nonzero(contact_forces(broken).bonded) < 0.1 * len(scene.bonds.pairs)
    assert worst_balance(scene, ACCOUNT) < 1e-4


def pressed_pair(rescaling: bool) -> State:
    """Two held disks about to be pressed together, slid, taken apart and slid back by whoever holds them."""
    scene = pair_scene(
        gap=-1e-6, sand=Sand(SOFT.shear_modulus, friction=20.0), held=np.ones(2, dtype=bool), rescaling=rescaling
    )
    return start(scene, features=replace(ACCOUNT, rescaling=rescaling), time_step=1e-7)


def cycle(rescaling: bool) -> tuple[State, float]:
    """State after pressing, sliding, unloading and sliding back, and (k_deep - k_shallow) s^2 / 2."""
    state = pressed_pair(rescaling)
    depth, slid, steps = 3e-6, 1e-6, 10_000
    for x, y in ((-depth, 0.0), (0.0, slid), (depth, 0.0), (0.0, -slid)):
        state.motion.velocity[1, :2, 0] = np.array([x, y]) / (steps * 1e-7)
        state = advance(replace(state, steps=max(1, state.steps)), steps)  # held disks need no half kick
    state.motion.velocity[...] = 0.0
    radius = np.array([RADIUS])
    stiffness = (
        SOFT.shear_ratio * 1.5 * float(SOFT.hertz_coefficient(radius, radius)[0]) * np.sqrt([depth + 1e-6, 1e-6])
    )
    return state, 0.5 * float(stiffness[0] - stiffness[1]) * slid**2


def test_shear_is_rescaled_where_the_scene_says_so_and_stiffness_changes() -> None:
    """The linear law has constant stiffness, and so nothing to rescale."""
    found = {
        (rescaling, law): choose_features(pair_scene(rescaling=rescaling), law).rescaling
        for rescaling in (False, True)
        for law in ("finite", "linear")
    }
    assert [key for key, rescaled in found.items() if rescaled] == [(True, "finite")]


@pytest.mark.full
def test_shear_rescaling_keeps_a_cycle_of_loading_and_sliding_from_creating_energy() -> None:
    """Mode 1 loses (k_deep - k_shallow) s^2 / 2 in the cycle; mode 0 creates just as much."""
    state, expected = cycle(rescaling=True)
    # At the turn of a stroke one of its 10,000 steps counts for the wrong one, at ten times the forces of sliding.
    assert energies(state).wall_work == pytest.approx(expected, rel=1e-2)
    state, _ = cycle(rescaling=False)
    assert energies(state).wall_work == pytest.approx(-expected, rel=1e-2)


@pytest.mark.full
def test_the_account_knows_the_energy_that_mode_0_creates() -> None:
    """Contact losses are positive in mode 1 and negative in mode 0; the balance closes in both.

    Mode 0 creates k_deep / k_shallow = 2 times what mode 1 loses: half of it is left in the shear spring.
    """
    for rescaling, sign in ((True, 1.0), (False, -2.0)):
        begin = energies(pressed_pair(rescaling))
        state, expected = cycle(rescaling)
        end = energies(state)
        assert end.contact_loss == pytest.approx(sign * expected, rel=5e-3)  # sliding turns the normal by 5e-4
        assert end.imbalance - begin.imbalance == pytest.approx(0.0, abs=1e-2 * expected)  # turns, as above


def test_a_rattling_disk_on_a_rough_floor_never_gains_energy() -> None:
    """A disk that bounces and rolls on a rough floor under its weight only loses energy, mode 1."""
    wall = Wall((0.0, 0.0), (0.0, 1.0), friction=0.5)
    scene = Scene(
        np.zeros(1), np.array([RADIUS]), np.array([RADIUS]), SOFT, walls=(wall,), load=np.array([[0.0, -0.5, 0.0]])
    )
    state = start(scene, features=ACCOUNT, velocity=np.array([[0.2, -0.1]]), spin=np.array([300.0]), time_step=2e-7)
    total = []
    for _ in range(40):
        state = advance(state, 250)
        now = energies(state)
        total.append(now.kinetic + now.elastic - now.load_work)
    # Steps of a 200th of an impact leave 1e-5 of the energy of each impact.
    assert np.all(np.diff(total) <= 1e-5 * total[0])
    assert total[-1] < 0.999 * total[0]


def squeezed(scene: Scene, generator: np.random.Generator) -> Preload:
    """Shear forces of up to 1.5 times the normal force on the contacts of a scene."""
    at_rest = contact_forces(start(replace(scene, bonds=None), features=ACCOUNT))
    part = generator.uniform(-1.5, 1.5, len(at_rest.pairs))
    return Preload(at_rest.pairs, part * at_rest.normal)


def change_from_the_start(scene: Scene, features: Features, preload: Preload) -> float:
    """Largest change of the energy balance since time zero over the energy at time zero, loads and losses included."""
    state = start(scene, features=features, preload=preload, step_fraction=0.1)
    first = energies(state)
    assert first.kinetic == 0.0
    found = 0.0
    for _ in range(4):
        state = advance(state, 100)
        found = max(found, abs(energies(state).imbalance - first.imbalance))
    return found / (first.elastic + first.contact_loss)


@pytest.mark.parametrize("midpoint", [False, pytest.param(True, marks=pytest.mark.full)])
@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_energy_balances_from_time_zero_where_friction_cuts_the_forces_at_the_start(
    friction: float, midpoint: bool
) -> None:
    """What friction takes of the shear forces that contacts begin with is lost at once, and counted."""
    scene = jumble(5, 16, walls=False, sand=replace(SOFT, friction=friction))
    preload, features = squeezed(scene, np.random.default_rng(1)), replace(ACCOUNT, midpoint=midpoint)
    begun = energies(start(scene, features=features, preload=preload))
    assert begun.contact_loss > 0.05 * begun.elastic
    # At a tenth of the limit the balance of this heap is good to 2e-5 with forces that friction allows.
    assert change_from_the_start(scene, features, preload) < 1e-3


@pytest.mark.full
@pytest.mark.parametrize("friction", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("share_bonded", [0.0, 0.3])
def test_energy_balances_in_a_packing_whose_friction_or_cement_is_too_weak(
    small_packing: Packing, friction: float, share_bonded: float
) -> None:
    """At the default step, in a packing made with more friction, and with bonds that break under what they carry."""
    drawn = np.random.default_rng(1).random(len(small_packing.pairs)) < share_bonded
    weak = Cement(tensile_strength=1e3, cohesion=1e3)
    bonds = Bonds(small_packing.pairs[drawn], weak) if share_bonded else None
    rule = WaveRule(damping=0.0, boundary_thickness=0.012)
    scene = wave_scene(small_packing, replace(Sand(), friction=friction), rule, bonds)
    state = start(scene, features=choose_features(scene, "finite", account=True), preload=small_packing.preload)
    first = energies(state)
    for _ in range(4):
        state = advance(state, 125)
        now = energies(state)
        # 2e-4 where friction is missing everywhere and all grains move, 1e-5 and less elsewhere.
        assert abs(now.imbalance - first.imbalance) < 1e-3 * (first.elastic + abs(first.contact_loss))
    if friction < 0.2 or share_bonded:
        assert abs(first.contact_loss) > 3e-3 * first.elastic
        assert now.kinetic > 1e-4 * first.elastic
