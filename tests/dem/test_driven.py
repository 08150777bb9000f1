"""Disks that are driven: which they are, the wave they send, the work they do."""

from dataclasses import replace

import naive
import numpy as np
import pytest
from scenes import BONDED, HERTZ, RADIUS, SOFT, SOFT_CEMENT, SPACING, contact_stiffness, jumble, throw

from calcidem.dem.engine.leapfrog import State, run_in_place
from calcidem.dem.engine.readout import energies, overlaps, wall_overlaps
from calcidem.dem.engine.scene import Law, Precision, Scene, Wall
from calcidem.dem.engine.stability import critical_time_step
from calcidem.dem.engine.state import advance, choose_features, start
from calcidem.dem.kernels.layout import Features, Floats, Recording
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import WaveRule, driven_disks
from calcidem.dem.wave.propagation import broken_bonds, cheap_limit, problems_of

COUNT, STEPS = 40, 300
FULL_KINDS: list[tuple[Law, Precision]] = [("linear", "float32"), ("finite", "float64"), ("finite", "float32")]


def features_for(scene: Scene, law: Law, lanes: int = 1, *, account: bool = False) -> Features:
    """Features of a scene with driven disks."""
    return replace(choose_features(scene, law, lanes, account=account), recording=True, driven=True)


def send(state: State, drive: Floats, driven: list[int], heard: int) -> tuple[State, Floats]:
    """State after disks of the scene were driven (S, L), and the velocity (S, L) of one of them along y."""
    place = np.argsort(state.assembly.order)
    dtype = state.motion.velocity.dtype
    recording = Recording(
        drive=np.ascontiguousarray(drive, dtype),
        driven=-1,
        driven_disks=np.sort(place[driven]),
        offset=0,
        stride=1,
        listeners=place[[heard]],
        groups=np.array([0, 1]),
        axes=np.array([1]),
        samples=np.zeros((len(drive), 1, state.features.lanes), dtype),
    )
    return run_in_place(state, len(drive), recording), recording.samples[:, 0]


def pulses(lanes: int) -> Floats:
    """Pulse of each lane (`STEPS`, L), each of another height and duration, m/s."""
    lane = np.arange(lanes)
    cycle = np.minimum((np.arange(STEPS)[:, None] + 0.5) / (60.0 + 5.0 * lane), 1.0)
    return np.asarray(1e-6 * (1.0 + lane) * (1.0 - np.cos(2.0 * np.pi * cycle)))


def row_of_disks(along_y: bool, *, rotation: bool) -> Scene:
    """Disks in a row that touch, the first of them held; a wall far away stands for the receiver."""
    places, flat = SPACING * np.arange(float(COUNT)), np.zeros(COUNT)
    x, y = (flat, places) if along_y else (places, flat)
    wall = Wall((-1.0, 0.0), (1.0, 0.0))
    return Scene(x, y, np.full(COUNT, RADIUS), SOFT, (wall,), held=np.arange(COUNT) == 0, rotation=rotation)


@pytest.mark.full
@pytest.mark.parametrize("heard", [0, 1, 20])
def test_a_driven_end_of_a_chain_sends_its_pulse_one_disk_further_each_step(heard: int) -> None:
    """At dt = sqrt(m / k) leapfrog solves the wave equation of a chain exactly: disk n is n steps late."""
    scene = row_of_disks(along_y=True, rotation=False)
    state = start(scene, features=features_for(scene, "linear", 8), step_fraction=1.0)
    assert state.time_step[0] * np.sqrt(contact_stiffness()[0] / scene.mass[0]) == pytest.approx(1.0, rel=1e-11)
    drive = pulses(8)
    _, found = send(state, drive, [0], heard)
    expected = np.concatenate([np.zeros((heard, 8)), drive[: STEPS - heard]])
    # The step is a rounding below sqrt(m / k); beyond two ways through the row the echo of its free end is there.
    early = 2 * COUNT - heard - 2
    np.testing.assert_allclose(found[:early], expected[:early], rtol=0.0, atol=1e-9 * drive.max())


def rolling_row(drive: Floats, courant: float, heard: int) -> Floats:
    """Velocity (S,) of a disk of an endless row that rolls as its first disk is moved across it: an exact solution.

    With ``s_n`` the slide of contact n, ``m u_n'' = k_s (s_n - s_(n - 1))`` and, since an arm is half a spacing a and
    ``q = m a^2 / (4 I)``, ``s_n'' = (k_s / m) [(1 - q) (s_(n + 1) + s_(n - 1)) - 2 (1 + q) s_n]``; the first disk does
    not turn. On the leapfrog grid ``''`` is ``(z - 2 + 1 / z) / dt^2``, and ``s_n = s_0 p^n`` with ``|p| < 1``. The
    circle on which z lies is a little wider than 1, which damps what would come round again.
    """
    count = 8 * len(drive)
    growth = np.exp(20.0 / count)
    z = growth * np.exp(2.0j * np.pi * np.fft.fftfreq(count))
    sent = np.zeros(count)
    sent[: len(drive)] = drive
    moved = np.fft.fft(sent * growth ** -np.arange(count)) / (1.0 - 1.0 / z)  # displacement over dt
    second = (z - 2.0 + 1.0 / z) / courant**2
    q = 0.5 * (SPACING / (2.0 * RADIUS)) ** 2 * 4.0
    middle = (second + 2.0 * (1.0 + q)) / (1.0 - q)
    root = np.sqrt(middle**2 / 4.0 - 1.0)
    p = np.where(np.abs(middle / 2.0 - root) < 1.0, middle / 2.0 - root, middle / 2.0 + root)
    # s_0'' = (k_s / m) [(1 - q) s_1 - (1 + q) s_0] - u_0''
    slide = -second * moved / (second + (1.0 + q) - (1.0 - q) * p)
    heard_moved = slide * p ** (heard - 1) * (p - 1.0) / second
    velocity = np.fft.ifft(heard_moved * (1.0 - 1.0 / z)).real[: len(drive)]
    return np.asarray(velocity * growth ** np.arange(len(drive)))


@pytest.mark.full
@pytest.mark.parametrize("heard", [1, 4, 15])
def test_a_driven_end_of_a_row_sends_the_shear_wave_of_rolling_disks(heard: int) -> None:
    """A disk held in x and in rotation and driven across its row makes the others roll as theory says."""
    scene = row_of_disks(along_y=False, rotation=True)
    state = start(scene, features=features_for(scene, "linear", 8), step_fraction=0.5)
    drive = pulses(8)
    courant = float(state.time_step[0] * np.sqrt(contact_stiffness()[1] / scene.mass[0]))
    end, found = send(state, drive, [0], heard)
    assert end.rotation()[0] == 0.0
    assert np.abs(end.rotation()[1:]).min() > 0.0
    for lane in range(8):
        expected = rolling_row(drive[:, lane], courant, heard)
        np.testing.assert_allclose(found[:90, lane], expected[:90], rtol=0.0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.full
@pytest.mark.parametrize(
    ("law", "precision"),
    [("linear", "float64"), *FULL_KINDS],
)
def test_a_driven_sample_gives_the_same_bits_alone_and_beside_others(law: Law, precision: Precision) -> None:
    """One lane alone and the same lane of eight give the same bits."""
    scene = row_of_disks(along_y=False, rotation=True)
    drive = 100.0 * pulses(8)
    eight, one = (start(scene, features=features_for(scene, law, lanes), precision=precision) for lanes in (8, 1))
    together, heard_together = send(eight, drive, [0], 9)
    alone, heard_alone = send(one, drive[:, [5]], [0], 9)
    assert heard_alone.any()
    np.testing.assert_array_equal(heard_alone[:, 0], heard_together[:, 5])
    np.testing.assert_array_equal(alone.position(), together.position(5))


def supplied_and_gained(step: float, duration: float) -> tuple[float, float]:
    """Work of driven disks on a heap with friction and damping, and what of it is missing or too much in the end.

    The drive ends at rest: driven disks are no heavier to the account than what they push.
    """
    scene = jumble(5, 16, damping=0.2, held=np.isin(np.arange(16), (0, 4, 8)))
    features = features_for(scene, "finite", account=True)
    time = (np.arange(round(duration / step)) + 0.5) / round(duration / step)
    drive = 0.5 * (1.0 - np.cos(2.0 * np.pi * time))[:, None]
    state, _ = send(start(scene, features=features, time_step=step), drive, [0, 4, 8], 15)
    first = energies(start(scene, features=features, time_step=step))
    last = energies(state)
    return last.wall_work - first.wall_work, last.imbalance - first.imbalance


@pytest.mark.full
def test_the_power_put_in_by_driven_disks_is_the_energy_gained_and_lost() -> None:
    """Work of the drive is what becomes kinetic, elastic, friction and damping, the better the smaller the step."""
    step, duration = 4e-7, 2e-4
    _, coarse = supplied_and_gained(step, duration)
    work, fine = supplied_and_gained(step / 8.0, duration)
    assert work > 0.0
    assert abs(fine) < 1e-5 * work
    assert np.log(abs(coarse / fine)) / np.log(8.0) > 0.9  # first order: first touches, and slopes of slip


@pytest.mark.full
@pytest.mark.parametrize("law", ["finite", "linear"])
def test_driven_disks_move_a_heap_as_in_its_slow_twin(law: Law) -> None:
    """Disks that follow a drive beside one another, in a bonded heap with friction, are those of a plain loop."""
    driven = [2, 7]
    scene = jumble(8, 12, held=np.isin(np.arange(12), driven), share_bonded=0.4, cement=SOFT_CEMENT, damping=0.3)
    features = features_for(scene, law, 2)
    state = start(scene, features=features, step_fraction=0.1)
    drive = 0.05 * np.sin(0.1 * np.arange(1.0, 41.0))[:, None] * [1.0, -2.0]
    end, _ = send(state, drive, driven, 0)
    at_rest = np.zeros((12, 2)), np.zeros(12)
    for lane in range(2):
        twin = naive.make_twin(scene, features, float(state.time_step[lane]), *at_rest, lane)
        for speed in drive[:, lane]:
            naive.step(twin, dict.fromkeys(driven, speed))
        moved = end.to_scene_order(end.motion.displacement[:, :, lane])
        for component in range(3):
            scale = np.abs(twin.moved[:, component]).max()
            np.testing.assert_allclose(moved[:, component], twin.moved[:, component], rtol=0.0, atol=1e-7 * scale)
        np.testing.assert_allclose(moved[driven, 1], drive[:, lane].sum() * state.time_step[lane], rtol=1e-12)


def test_driven_disks_are_those_that_overlap_the_left_wall_in_the_band(small_packing: Packing) -> None:
    """However little they overlap it; none where the wall is the transmitter, and a band without one is refused."""
    rule = WaveRule(transmitter="driven", transmitter_half_width=0.01)
    found = driven_disks(small_packing, rule)
    assert 2 <= len(found) <= 8  # 20 mm of disks of 2.12 mm or more, some of which a neighbour keeps from the wall
    left = small_packing.x - small_packing.radius
    aside = np.abs(small_packing.y - small_packing.height / 2.0)
    assert left[found].max() < 0.0
    assert aside[found].max() < 0.01
    others = np.setdiff1d(np.arange(len(left)), found)
    assert np.all((left[others] >= 0.0) | (aside[others] >= 0.01))
    assert len(driven_disks(small_packing, replace(rule, transmitter="wall"))) == 0
    moved = replace(small_packing, x=small_packing.x + 1e-4)
    with pytest.raises(ValueError, match=r"transmitter_half_width = 0\.01: no disk touches the transmitter"):
        driven_disks(moved, rule)


def test_a_drive_needs_a_recording() -> None:
    """A kernel without a recording has nothing that could drive disks."""
    with pytest.raises(ValueError, match="driven = True needs recording = True"):
        Features(driven=True)


def test_a_sample_may_lose_as_many_bonds_as_it_is_told() -> None:
    """Bonds that broke are counted; they make a sample another one if they are more than the part that is allowed."""
    weak = replace(SOFT_CEMENT, tensile_strength=5.0e4, cohesion=5.0e4, linear_modulus=0.0)
    scene = jumble(8, 20, share_bonded=1.0, cement=weak)
    assert scene.bonds is not None
    velocity, spin = throw(scene, 8)
    state = advance(start(scene, features=BONDED, velocity=velocity, spin=spin), 100)
    lost = len(scene.bonds.pairs) - int(np.count_nonzero(state.assembly.pairs.intact))
    assert 0 < lost < len(scene.bonds.pairs)
    assert broken_bonds(state).tolist() == [lost]
    share = lost / len(scene.bonds.pairs)
    assert problems_of(state, 1e3, 1.0, breakable=1.01 * share) == [""]
    for part in (0.0, 0.99 * share):
        assert problems_of(state, 1e3, 1.0, breakable=part)[0].startswith(f"{lost} bonds broke within 100 steps")


@pytest.mark.parametrize("part", [-0.1, 1.1])
def test_a_share_of_broken_bonds_is_a_part(part: float) -> None:
    """Neither less than none nor more than all bonds can break."""
    with pytest.raises(ValueError, match="most_broken_bonds"):
        WaveRule(most_broken_bonds=part)


def test_the_cheap_limit_of_the_step_is_below_the_dear_one_however_hard_contacts_are_pressed() -> None:
    """It is a bound from below at rest, and with overlaps tens of times as large."""
    for scene in (jumble(8, 20), jumble(8, 20, share_bonded=1.0, cement=replace(SOFT_CEMENT, linear_modulus=0.0))):
        state = start(scene, features=BONDED if scene.bonds is not None else HERTZ)
        for squeezed in (0.0, 1e-3, 0.05):
            centres = np.column_stack([scene.x, scene.y])
            state.motion.displacement[:, :2, 0] = squeezed * (centres.mean(axis=0) - centres)[state.assembly.order]
            limit = critical_time_step(scene, state.assembly, state.features, overlaps(state), wall_overlaps(state))
            assert cheap_limit(state)[0] < limit[0]
