from dataclasses import replace

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import SOFT_CEMENT, jumble, throw

from calcidem.dem.engine.scene import Cement, Installation, Law, Preload, Scene
from calcidem.dem.engine.state import advance, choose_features, start

pytestmark = pytest.mark.slow

# The kernel takes the change of a distance to second order in a step, the twin exactly: steps of 1e-4 of a disk leave
# 1e-8 of the largest value, and branches (contact, slip) taken a rounding apart far less.
TOLERANCE = 1e-7
STEPS = 40
LANES = 8  # of which two are compared
WEAK = replace(SOFT_CEMENT, tensile_strength=4.0e5, cohesion=3.0e5, friction_angle=20.0)
KINDS: list[tuple[str, Law, bool, Cement | None]] = [
    ("hertz", "finite", True, None),
    ("hertz, old rescaling", "finite", False, None),
    ("bonds", "finite", False, replace(WEAK, linear_modulus=0.0)),
    ("bonds and linear group", "finite", True, WEAK),
    ("linear", "linear", True, SOFT_CEMENT),
]
FOR_FULL_RUNS = ("hertz", "hertz, old rescaling", "bonds", "linear")


def random_scene(
    seed: int, count: int, cement: Cement | None, rescaling: bool, installation: Installation
) -> tuple[Scene, Preload]:
    """Heap with everything in it: a held disk that moves, loads, walls, damping that varies."""
    generator = np.random.default_rng([seed, 2])
    held = np.zeros(count, dtype=bool)
    held[generator.integers(count)] = True
    options = {} if cement is None else {"share_bonded": 0.6, "cement": cement, "installation": installation}
    scene = jumble(
        seed,
        count,
        held=held,
        rescaling=rescaling,
        damping=generator.uniform(0.0, 0.9, count),
        load=generator.normal(size=(count, 3)) * [5.0, 5.0, 5e-3],
        **options,
    )
    pairs = np.array([(i, j) for i in range(count) for j in range(i) if naive.reference_overlap(scene, i, j) > 0.0])
    return scene, Preload(pairs.reshape(-1, 2), 0.3 * generator.standard_normal(len(pairs)))


@pytest.mark.parametrize(
    ("law", "rescaling", "cement"),
    # Each is a kernel of its own; "bonds and linear group" has the most in it.
    [pytest.param(*k[1:], marks=pytest.mark.full if k[0] in FOR_FULL_RUNS else ()) for k in KINDS],
    ids=[kind[0] for kind in KINDS],
)
@settings(max_examples=8, deadline=None)
@given(
    seed=st.integers(0, 2**20),
    count=st.integers(4, 9),
    installation=st.sampled_from(["preserve", "zero", "pfc_absolute"]),
)
def test_the_kernel_moves_a_random_heap_as_its_slow_twin_does(
    law: Law, rescaling: bool, cement: Cement | None, seed: int, count: int, installation: Installation
) -> None:
    """Displacements, velocities and broken bonds are those of a plain loop over all pairs."""
    if cement is not None and cement.linear_modulus == 0.0 and installation == "pfc_absolute":
        installation = "zero"
    scene, preload = random_scene(seed, count, cement, rescaling, installation)
    features = replace(choose_features(scene, law, LANES), search=law == "finite")
    velocity, spin = throw(scene, seed)
    state = start(scene, features=features, preload=preload, velocity=velocity, spin=spin, step_fraction=0.1)
    twins = [
        naive.make_twin(scene, features, float(state.time_step[lane]), velocity, spin, lane, preload)
        for lane in (0, LANES - 1)
    ]
    state = advance(state, STEPS)
    for lane, twin in zip((0, LANES - 1), twins, strict=True):
        naive.first_step(twin)
        for _ in range(STEPS - 1):
            naive.step(twin)
        moved = state.to_scene_order(state.motion.displacement[:, :, lane])
        speeds = state.to_scene_order(state.motion.velocity[:, :, lane])
        for component in range(3):
            for found, expected in ((moved, twin.moved), (speeds, twin.velocity)):
                scale = np.abs(expected[:, component]).max()
                np.testing.assert_allclose(
                    found[:, component],
                    expected[:, component],
                    rtol=0.0,
                    atol=TOLERANCE * scale,
                    err_msg=f"lane {lane}",
                )
        intact = sum(int(bits) >> lane & 1 for bits in state.assembly.pairs.intact)
        assert intact == len(twin.intact)
