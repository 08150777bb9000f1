"""The kernel against its slow twin, tests/dem/naive.py, which has no line in common with it."""

import sys

import numpy as np
from common import ROOT, features_of, sand_of, small_packing
from modes import QUARTZ
from table import check

from calcidem.dem import Bonds, Cement, Preload, Scene, Wall, advance, start

sys.path.append(str(ROOT / "tests" / "dem"))

import naive

_WEAK = Cement(
    2.0e10,
    1.4,
    linear_modulus=1.0e10,
    linear_stiffness_ratio=2.2,
    tensile_strength=3.0e6,
    cohesion=2.0e6,
    friction_angle=20.0,
)


def _corner(*, bonded: bool) -> tuple[Scene, Preload]:
    """Corner of the packing with 30 disks, a moving rough wall, loads, damping, a held disk and half of its bonds."""
    packing = small_packing()
    chosen = np.sort(np.argsort(packing.x + packing.y)[:30])
    inside = np.isin(packing.pairs, chosen).all(axis=1)
    pairs = np.searchsorted(chosen, packing.pairs[inside])
    generator = np.random.default_rng(8)
    some = generator.integers(0, 2, len(pairs)) == 1
    walls = (Wall((0.0, 0.0), (1.0, 0.0), 0.3, (0.02, 0.05)), Wall((0.0, 0.0), (0.0, 1.0)))
    scene = Scene(
        packing.x[chosen], packing.y[chosen], packing.radius[chosen], sand_of(QUARTZ), walls,
        Bonds(pairs[some], _WEAK) if bonded else None, damping=0.3, held=chosen == chosen[17],
        load=generator.normal(size=(30, 3)) * [50.0, 50.0, 5e-2],
    )  # fmt: skip
    return scene, Preload(pairs, packing.preload.shear[inside])


def _worst(*, bonded: bool, law: str) -> float:
    """Largest difference of displacements and velocities after 60 steps, over the largest of each component."""
    scene, preload = _corner(bonded=bonded)
    generator = np.random.default_rng(12)
    velocity, spin = 0.05 * generator.standard_normal((30, 2)), 40.0 * generator.standard_normal(30)
    features = features_of(scene, law)
    state = start(scene, features=features, preload=preload, velocity=velocity, spin=spin, step_fraction=0.1)
    plain = naive.make_twin(scene, features, float(state.time_step[0]), velocity, spin, 0, preload)
    naive.first_step(plain)
    for _ in range(59):
        naive.step(plain)
    state = advance(state, 60)
    moved = np.column_stack([state.position() - np.column_stack([scene.x, scene.y]), state.rotation()])
    speed = np.column_stack([state.velocity(), state.spin()])
    return max(
        float((np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)).max())
        for found, expected in ((moved, plain.moved), (speed, plain.velocity))
    )


_TWIN = "tests/dem/naive.py: one pair at a time, plain floats"


@check(
    # Corner of the packing (30 disks, damping, loads, moving wall): kernel against its slow twin, sand.
    "Corner of the packing (30 disks), sand", source=_TWIN,
    tolerance=1e-7, reason="rounding of overlaps, stretched by impacts; order of sums",
)  # fmt: skip
def _sand() -> float:
    return _worst(bonded=False, law="finite")


@check(
    "Corner of the packing, half cemented, bonds that break",
    source=_TWIN, tolerance=1e-7, reason="as above; the approach in a step is taken to second order in its turn",
)  # fmt: skip
def _cemented() -> float:
    return _worst(bonded=True, law="finite")


@check(
    "Corner of the packing, cemented, linear", source=_TWIN, tolerance=1e-10,
    reason="order of sums",
)  # fmt: skip
def _linear() -> float:
    return _worst(bonded=True, law="linear")
