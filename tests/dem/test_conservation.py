import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import GROUPED, SOFT_CEMENT, jumble, throw

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.scene import Bonds, Scene
from calcidem.dem.engine.state import advance, start
from calcidem.dem.kernels.layout import Floats

STEPS = 200
SEEDS = st.integers(0, 2**20)
FEW = settings(max_examples=10, deadline=None)


def cluster(seed: int) -> tuple[Scene, Floats, Floats]:
    """Heap of 20 disks without walls, partly bonded, with velocities and spins."""
    scene = jumble(seed, 20, walls=False, share_bonded=0.4)
    return scene, *throw(scene, seed)


def flown(scene: Scene, velocity: Floats, spin: Floats, dt: float = 2e-7) -> State:
    """The scene some steps later."""
    return advance(start(scene, features=GROUPED, velocity=velocity, spin=spin, time_step=dt), STEPS)


def momenta(state: State) -> Floats:
    """Linear momentum x and y, angular momentum, and the sums of the magnitudes of their terms."""
    mass, place, velocity = state.scene.mass[:, None], state.position(), state.velocity()
    orbital = place[:, 0] * velocity[:, 1] - place[:, 1] * velocity[:, 0]
    turning = state.scene.mass * orbital + state.scene.inertia * state.spin()
    terms = np.column_stack([mass * velocity, turning])
    return np.stack([terms.sum(axis=0), np.abs(terms).sum(axis=0)])


@given(SEEDS)
@FEW
def test_a_heap_without_walls_keeps_its_momentum_and_angular_momentum(seed: int) -> None:
    """Sums over the disks stay to round-off, whatever contacts, bonds and friction do."""
    scene, velocity, spin = cluster(seed)
    before, size = momenta(flown(scene, velocity, spin, dt=1e-12))
    after, later_size = momenta(flown(scene, velocity, spin))
    # 200 steps x 20 disks x 3 contacts, each a rounding of 1e-16 of terms up to the forces times the step.
    assert np.all(np.abs(after - before) <= 1e-12 * np.maximum(size, later_size))


@given(SEEDS, st.floats(0.0, 6.3))
@FEW
def test_a_turned_scene_moves_as_the_scene_does(seed: int, angle: float) -> None:
    """Turning the scene turns its trajectories and leaves the spins."""
    scene, velocity, spin = cluster(seed)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    place = turn @ np.stack([scene.x, scene.y])
    turned = Scene(place[0], place[1], scene.radius, scene.sand, bonds=scene.bonds)
    first, second = flown(scene, velocity, spin), flown(turned, velocity @ turn.T, spin)
    # Rounding of positions of 1e-2 m by 1e-18 m, of overlaps of 1e-6 m, stretched a hundredfold by collisions.
    speed = np.abs(velocity).max()
    np.testing.assert_allclose(second.velocity(), first.velocity() @ turn.T, atol=1e-9 * speed)
    np.testing.assert_allclose(second.spin(), first.spin(), atol=1e-9 * np.abs(spin).max())


@given(SEEDS)
@FEW
def test_a_mirrored_scene_moves_as_the_mirror_image(seed: int) -> None:
    """Mirroring y mirrors the trajectories and turns the spins round."""
    scene, velocity, spin = cluster(seed)
    mirror = np.array([1.0, -1.0])
    mirrored = Scene(scene.x, -np.asarray(scene.y), scene.radius, scene.sand, bonds=scene.bonds)
    first, second = flown(scene, velocity, spin), flown(mirrored, velocity * mirror, -spin)
    speed = np.abs(velocity).max()
    np.testing.assert_allclose(second.velocity(), first.velocity() * mirror, atol=1e-9 * speed)
    np.testing.assert_allclose(second.spin(), -first.spin(), atol=1e-9 * np.abs(spin).max())


@given(SEEDS)
@FEW
def test_the_order_of_the_disks_changes_no_bit(seed: int) -> None:
    """The same disks, listed in another order, follow the same trajectories to the last bit."""
    scene, velocity, spin = cluster(seed)
    assert scene.bonds is not None
    shuffled = np.random.default_rng(seed).permutation(scene.count)
    place = np.argsort(shuffled)
    bonds = Bonds(place[scene.bonds.pairs][::-1], SOFT_CEMENT, scene.bonds.bits[::-1])
    other = Scene(scene.x[shuffled], scene.y[shuffled], scene.radius[shuffled], scene.sand, bonds=bonds)
    first, second = flown(scene, velocity, spin), flown(other, velocity[shuffled], spin[shuffled])
    np.testing.assert_array_equal(second.position(), first.position()[shuffled])
    np.testing.assert_array_equal(second.spin(), first.spin()[shuffled])
