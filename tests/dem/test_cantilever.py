import numpy as np
import pytest
from scenes import BONDED, LINEAR, RADIUS

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.scene import Bonds, Cement, Scene
from calcidem.dem.engine.state import advance, start
from calcidem.dem.kernels.layout import Features

pytestmark = pytest.mark.slow

BONDS = 6
FORCE = 1.0
CEMENT = Cement(bond_stiffness_ratio=2.5)
# Constant stiffness, but forces built up from increments.


def bent_beam(features: Features, force: float) -> State:
    """Row of disks bonded at touching rims, the first held, the last pushed sideways, at rest."""
    count = BONDS + 1
    load = np.zeros((count, 3))
    load[-1, 1] = force
    scene = Scene(
        x=2.0 * RADIUS * np.arange(count),
        y=np.zeros(count),
        radius=np.full(count, RADIUS),
        bonds=Bonds(np.column_stack([np.arange(BONDS), np.arange(1, count)]), CEMENT),
        damping=0.7,
        held=np.arange(count) == 0,
        load=load,
    )
    state = advance(start(scene, features=features), 12_000)
    assert np.abs(state.velocity()).max() * state.time_step[0] * 100.0 < 1e-9 * np.abs(state.position()[-1, 1])
    return state


def theory() -> tuple[float, float]:
    """Deflection and rotation of the loaded end."""
    radius = np.array([RADIUS])
    _, shear, bending = CEMENT.bond_stiffness(radius, radius)[0]
    spacing = 2.0 * RADIUS
    deflection = BONDS * FORCE / shear + FORCE * spacing**2 / bending * BONDS * (4.0 * BONDS**2 - 1.0) / 12.0
    return deflection, FORCE * spacing * BONDS**2 / (2.0 * bending)


@pytest.mark.parametrize(("features", "tolerance"), [(LINEAR, 1e-9), (BONDED, 1e-6)])
def test_a_bonded_cantilever_bends_as_theory_says(features: Features, tolerance: float) -> None:
    """Tip deflection n P / k_s + P a^2 n (4 n^2 - 1) / (12 k_theta) and rotation P a n^2 / (2 k_theta).

    What is left of the motion is below 1e-9 of the deflection; turning normals (finite displacement) matter with the
    square of the rotation, here 1e-9 rad, and by rounding of positions, 1e-16 m of a deflection of 1e-10 m.
    """
    state = bent_beam(features, FORCE)
    deflection, rotation = theory()
    tip = state.to_scene_order(state.motion.displacement[:, :, 0])[-1]
    assert tip[1] == pytest.approx(deflection, rel=tolerance)
    assert tip[2] == pytest.approx(rotation, rel=tolerance)
    assert tip[0] == pytest.approx(0.0, abs=max(1e-5, tolerance) * deflection)
