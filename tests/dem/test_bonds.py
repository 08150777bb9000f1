from dataclasses import replace

import numpy as np
import pytest
from scenes import BONDED, GROUPED, RADIUS, SOFT, SOFT_CEMENT, pair_scene

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.readout import contact_forces, overlaps, stored_energy, wall_overlaps
from calcidem.dem.engine.scene import Bonds, Cement, Installation, Preload
from calcidem.dem.engine.state import advance, start
from calcidem.dem.kernels.layout import NORMAL, SHEAR

PAIRS = np.array([[0, 1]])
BARE = replace(SOFT_CEMENT, linear_modulus=0.0)
OVERLAP = 2e-6
CARRIED = float(SOFT.hertz_coefficient(np.array([RADIUS]), np.array([RADIUS]))[0]) * OVERLAP**1.5
PRELOAD = Preload(PAIRS, np.array([0.3 * CARRIED]))
HELD = np.ones(2, dtype=bool)
STEP = 1e-7
AREA = 2.0 * RADIUS
BENDING = 2.0 * RADIUS**2 / 3.0  # I_b / R_b


def cemented(cement: Cement, installation: Installation = "preserve", **options: object) -> State:
    """Overlapping pair whose contact carried normal and shear force when the cement came."""
    bonds = Bonds(PAIRS, cement, installation=installation)
    scene = pair_scene(gap=-OVERLAP, sand=SOFT, bonds=bonds, held=HELD)
    features = GROUPED if cement.linear_modulus > 0.0 else BONDED
    return start(scene, features=features, preload=PRELOAD, time_step=STEP, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("cement", "installation", "normal", "shear"),
    [
        (BARE, "preserve", CARRIED, 0.3 * CARRIED),
        (SOFT_CEMENT, "preserve", CARRIED, 0.3 * CARRIED),
        (BARE, "zero", 0.0, 0.0),
        (SOFT_CEMENT, "zero", 0.0, 0.0),
        (SOFT_CEMENT, "pfc_absolute", SOFT_CEMENT.linear_modulus * OVERLAP, 0.0),
    ],
)
def test_cement_takes_over_the_force_as_its_installation_says(
    cement: Cement, installation: Installation, normal: float, shear: float
) -> None:
    """The force of a loaded contact goes on, drops to zero, or jumps to k_n times the overlap."""
    contact = contact_forces(cemented(cement, installation))
    # The preserved overlap of the linear group is a difference of numbers 100 times its size.
    assert contact.normal.sum() == pytest.approx(normal, rel=1e-12)
    assert contact.shear.sum() == pytest.approx(shear, rel=1e-12)
    assert contact.moment.sum() == 0.0


@pytest.mark.parametrize("installation", ["preserve", "zero", "pfc_absolute"])
def test_the_linear_group_stores_the_energy_of_its_force(installation: Installation) -> None:
    """F^2 / (2 k) of both directions, whatever overlap its normal force is counted from."""
    state = cemented(SOFT_CEMENT, installation)
    contact, stiffness = contact_forces(state), SOFT_CEMENT.linear_stiffness(np.array([RADIUS]), np.array([RADIUS]))
    force = np.array([contact.normal.sum(), contact.shear.sum()])
    stored = stored_energy(state.scene, state.assembly, state.features, overlaps(state), wall_overlaps(state))
    assert stored[0] == pytest.approx(float((force**2 / (2.0 * stiffness)).sum()), rel=1e-12, abs=1e-30)


def test_only_a_lane_with_the_bond_gives_it_the_force() -> None:
    """In other lanes the contact keeps its shear force, and there is no bond to bear any."""
    bonds = Bonds(PAIRS, BARE, np.array([0b00000101], dtype=np.uint32))
    scene = pair_scene(gap=-OVERLAP, sand=SOFT, bonds=bonds, held=HELD)
    features = replace(BONDED, lanes=8, midpoint=False, recording=True)  # those of cells
    pairs = start(scene, features=features, preload=PRELOAD, time_step=STEP).assembly.pairs
    bonded = np.array([True, False, True, False, False, False, False, False])
    np.testing.assert_allclose(pairs.bond_force[0, NORMAL], np.where(bonded, CARRIED, 0.0))
    np.testing.assert_allclose(np.abs(pairs.bond_force[0, SHEAR]), np.where(bonded, 0.3 * CARRIED, 0.0))
    np.testing.assert_allclose(np.abs(pairs.shear[0]), np.where(bonded, 0.0, 0.3 * CARRIED))


@pytest.mark.parametrize("cement", [BARE, SOFT_CEMENT])
def test_preserved_forces_grow_from_where_they_were(cement: Cement) -> None:
    """Pressing and sliding a preserved contact changes its force by the stiffnesses of bond and linear group."""
    velocity = np.array([[0.0, 0.0], [-1e-3, 1e-4]])
    state = advance(cemented(cement, velocity=velocity), 100)
    time = 100 * STEP
    radius = np.array([RADIUS])
    bond, linear = cement.bond_stiffness(radius, radius)[0], cement.linear_stiffness(radius, radius)[0]
    contact = contact_forces(state)
    # The normal turns by 1e-5 on the way, which mixes the two motions at that level.
    assert contact.normal[0] == pytest.approx(CARRIED + 1e-3 * time * (bond[0] + linear[0]), rel=1e-4)
    assert contact.shear[0] == pytest.approx(0.3 * CARRIED - 1e-4 * time * (bond[1] + linear[1]), rel=1e-4)


def strained(cement: Cement, velocity: tuple[float, float], spin: float, strain: float) -> State:
    """Bonded pair, the second disk moved and both turned against each other, in 1000 steps."""
    bonds = Bonds(PAIRS, cement)
    scene = pair_scene(sand=SOFT, bonds=bonds, held=HELD)
    speed = np.array([[0.0, 0.0], velocity]) * strain / (1000 * STEP)
    turns = np.array([-spin, spin]) / 2.0 * strain / (1000 * STEP)
    return advance(start(scene, features=BONDED, time_step=STEP, velocity=speed, spin=turns), 1001)


RADII = np.array([RADIUS])
STIFFNESS = BARE.bond_stiffness(RADII, RADII)[0]
# Weak enough to break before the strain turns the normal, which would add its square to the elongation.
WEAK = replace(BARE, tensile_strength=1.0e3, cohesion=0.6e3, friction_angle=30.0)
CASES = [
    ("tension", (1.0, 0.0), 0.0, WEAK.tensile_strength * AREA / STIFFNESS[0]),
    ("shear", (0.0, 1.0), 0.0, WEAK.cohesion * AREA / STIFFNESS[1]),
    ("bending", (0.0, 0.0), 1.0, WEAK.tensile_strength * BENDING / STIFFNESS[2]),
    ("bending back", (0.0, 0.0), -1.0, WEAK.tensile_strength * BENDING / STIFFNESS[2]),
]


@pytest.mark.parametrize(("velocity", "spin", "limit"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_a_bond_breaks_at_its_strength(velocity: tuple[float, float], spin: float, limit: float) -> None:
    """A tenth of a per cent below the strength it holds, a tenth above it is broken and carries nothing."""
    below, above = strained(WEAK, velocity, spin, 0.999 * limit), strained(WEAK, velocity, spin, 1.001 * limit)
    assert below.assembly.pairs.intact[0]
    assert contact_forces(below).bonded.all()
    assert not above.assembly.pairs.intact[0]
    assert not above.assembly.pairs.bond_force.any()


def test_pressure_strengthens_a_bond_in_shear() -> None:
    """With a friction angle the shear strength grows by tan(phi) times the normal stress, and falls in tension."""
    slope = np.tan(np.radians(WEAK.friction_angle))
    strong = replace(WEAK, tensile_strength=1e9)
    for push in (-1.0, 1.0):  # the second disk away from the first, and towards it
        # Both displacements grow together: k_s u = A c + tan(phi) k_n u push at the limit.
        limit = WEAK.cohesion * AREA / (STIFFNESS[1] - slope * 0.3 * push * STIFFNESS[0])
        assert strained(strong, (-0.3 * push, 1.0), 0.0, 0.999 * limit).assembly.pairs.intact[0]
        assert not strained(strong, (-0.3 * push, 1.0), 0.0, 1.001 * limit).assembly.pairs.intact[0]


def test_a_broken_bond_gives_the_contact_back_to_the_sand() -> None:
    """Without a linear group a broken contact follows Hertz and Mindlin again, from zero shear force."""
    fragile = replace(BARE, tensile_strength=1e9, cohesion=1.0)
    state = cemented(fragile, velocity=np.array([[0.0, 0.0], [0.0, 1e-4]]))
    state = advance(state, 50)
    contact = contact_forces(state)
    assert not contact.bonded.any()
    assert contact.normal[0] == pytest.approx(CARRIED, rel=1e-4)  # sliding by 5e-10 m changes the overlap little
    assert abs(contact.shear[0]) < 0.1 * CARRIED


def test_a_broken_bond_leaves_the_linear_group() -> None:
    """With a linear group a broken contact keeps it: it resists pressure, not tension."""
    fragile = replace(SOFT_CEMENT, cohesion=1.0)
    state = advance(cemented(fragile, velocity=np.array([[0.0, 0.0], [-1e-3, 1e-3]])), 100)
    contact = contact_forces(state)
    assert not contact.bonded.any()
    assert contact.normal[0] == pytest.approx(CARRIED + 1e-3 * 100 * STEP * SOFT_CEMENT.linear_modulus, rel=1e-4)
    state.motion.velocity[1, 0] = 1.0
    assert not len(contact_forces(advance(state, 1000)).pairs)


@pytest.mark.full
def test_bonds_break_in_the_lanes_that_are_strained() -> None:
    """Each lane has its own bonds: pulling one lane apart leaves the others whole."""
    scene = pair_scene(sand=SOFT, bonds=Bonds(PAIRS, WEAK), held=HELD)
    state = start(scene, features=replace(BONDED, lanes=8), time_step=STEP)
    parts = np.array([0.5, 1.5, 0.5, 0.5, 0.5, 1.5, 1.5, 0.5])
    state.motion.velocity[1, 0] = parts * CASES[0][3] / (1000 * STEP)
    assert advance(state, 1001).assembly.pairs.intact[0] == 0b10011101


def test_a_spinning_bonded_pair_is_not_strained_by_its_rotation() -> None:
    """One whole turn of two bonded disks as a rigid body leaves only what centrifugal force needs."""
    scene = pair_scene(sand=SOFT, bonds=Bonds(PAIRS, BARE))
    omega, steps = 100.0, 20_000
    velocity = omega * RADIUS * np.array([[0.0, -1.0], [0.0, 1.0]])
    turn = 2.0 * np.pi / omega
    state = start(scene, features=BONDED, velocity=velocity, spin=np.full(2, omega), time_step=turn / steps)
    state = advance(state, steps)
    contact = contact_forces(state)
    tension = scene.mass[0] * omega**2 * RADIUS
    # Let go unstretched, the pair swings between zero and twice the tension that circular motion takes. The error of
    # one step's turn delta is of the order of delta^3 of the distance: 2 pi delta^2 / 6 = 1e-7 of it in all.
    assert -2.05 * tension < contact.normal[0] < 0.05 * tension
    assert abs(contact.shear[0]) < 0.05 * tension
    assert abs(contact.moment[0]) < 1e-3 * tension * RADIUS
    np.testing.assert_allclose(state.rotation(), 2.0 * np.pi, rtol=1e-3)
