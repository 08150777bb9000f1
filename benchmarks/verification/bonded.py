"""Beams of bonds, and where bonds break."""

from functools import cache

import numpy as np
from common import GRAIN, features_of, sand_of
from reference import Floats
from table import check

from calcidem.dem import Bonds, Cement, Scene, State, advance, contact_forces, start

_BEAM = Cement(bond_modulus=5.0e9, bond_stiffness_ratio=3.3)
# w = n P / k_s + P a^2 / k_t n (4 n^2 - 1) / 12, rotation P a n^2 / (2 k_t).
_STATICS = "statics of a chain of springs"


@cache
def _bent(law: str) -> tuple[float, float]:
    """Relative errors of deflection and rotation of the tip of a slanting beam of eight bonds."""
    bonds, radius, force, slope = 8, 1.7e-3, 0.3, 0.6
    along = np.array([np.cos(slope), np.sin(slope)])
    across = np.array([-along[1], along[0]])
    count = bonds + 1
    place = 2.0 * radius * np.arange(count)[:, None] * along
    load = np.zeros((count, 3))
    load[-1, :2] = force * across
    scene = Scene(
        place[:, 0], place[:, 1], np.full(count, radius), sand_of(GRAIN), held=np.arange(count) == 0, damping=0.6,
        bonds=Bonds(np.column_stack([np.arange(bonds), np.arange(1, count)]), _BEAM), load=load,
    )  # fmt: skip
    state = advance(start(scene, features=features_of(scene, law)), 30_000)
    shear = _BEAM.bond_modulus / _BEAM.bond_stiffness_ratio
    twist = _BEAM.bond_modulus * (2.0 * radius) ** 2 / 12.0
    length = 2.0 * radius
    deflection = bonds * force / shear + force * length**2 / twist * bonds * (4 * bonds**2 - 1) / 12.0
    rotation = force * length * bonds**2 / (2.0 * twist)
    return (
        abs(float((state.position()[-1] - place[-1]) @ across) / deflection - 1.0),
        abs(float(state.rotation()[-1]) / rotation - 1.0),
    )


@check(
    "Cantilever of 8 bonds, slanting: deflection of the tip, linear", source=_STATICS, tolerance=1e-9,
    reason="what is left of the damped motion, and rounding", quick=True,
)  # fmt: skip
def _deflection() -> float:
    return _bent("linear")[0]


@check(
    "Cantilever of 8 bonds: rotation of the tip, linear", source=_STATICS, tolerance=1e-9, reason="as above", quick=True
)
def _rotation() -> float:
    return _bent("linear")[1]


@check(
    "Cantilever of 8 bonds, finite displacement: deflection and rotation", source=_STATICS, tolerance=1e-5,
    reason="the beam turns by 1e-6, which counts squared; forces are sums of 30,000 increments",
)  # fmt: skip
def _finite_beam() -> float:
    return max(_bent("finite"))


_RADII = np.array([1.1e-3, 1.7e-3])
_WEAK = Cement(3.1e8, 1.7, tensile_strength=2.0e3, cohesion=2.1e3, friction_angle=35.0)
_STEPS = 8000
# sigma = -F / A + M R_b / I, and the size of F_s / A against c + tan(phi) F / A.
_STRENGTH = "beam of unit thickness: Potyondy and Cundall (2004), doi:10.1016/j.ijrmms.2004.09.011"


def _strained(apart: float, slide: float, twist: float) -> State:
    """Pair whose held ends move apart, slide and twist at rates that are reached once in `_STEPS` steps."""
    n = np.array([0.6, 0.8])
    place = np.outer([0.0, _RADII.sum()], n)
    scene = Scene(
        place[:, 0], place[:, 1], _RADII, sand_of(GRAIN), bonds=Bonds(np.array([[0, 1]]), _WEAK),
        held=np.ones(2, dtype=bool),
    )  # fmt: skip
    state = start(scene, features=features_of(scene))
    time = _STEPS * float(state.time_step[0])
    # Slide by turning both alike: the rims move by R_1 + R_2 times the angle.
    spin = np.full(2, -slide / _RADII.sum() / time)
    spin[1] += twist / time
    velocity = np.array([[0.0, 0.0], apart / time * n])
    velocity[1] += twist / time * _RADII[1] * np.array([-n[1], n[0]])  # takes out the slide of the twist
    return start(scene, features=features_of(scene), velocity=velocity, spin=spin, time_step=state.time_step)


def _breaking_share(apart: float, slide: float, twist: float) -> float:
    """Part of the given strain at which the bond breaks, by bisection over the steps."""
    state = _strained(apart, slide, twist)
    low, high = 0, _STEPS * 5 // 4
    while high - low > 1:
        middle = (low + high) // 2
        ahead = advance(state, middle - low)
        if contact_forces(ahead).bonded.any():
            state, low = ahead, middle
        else:
            high = middle
    return high / _STEPS


def _limits() -> Floats:
    """Elongation, slide and twist at which tension, shear and bending alone break the bond."""
    length, bond_radius = float(_RADII.sum()), float(_RADII.min())
    stress = _WEAK.bond_modulus / length  # of a unit elongation
    return np.array(
        [
            _WEAK.tensile_strength / stress,
            _WEAK.cohesion * _WEAK.bond_stiffness_ratio / stress,
            _WEAK.tensile_strength / (stress * bond_radius),
        ]
    )


_CASES = {
    "tension": (1.0, 0.0, 0.0),
    "shear by rolling": (0.0, 1.0, 0.0),
    "bending, one sense": (0.0, 0.0, 1.0),
    "bending, the other sense": (0.0, 0.0, -1.0),
    "tension and bending, half of each": (0.5, 0.0, 0.5),
}
_ONE_STEP = "one of 8,000 steps, and rounding of the increments"


def _break_error(case: str) -> float:
    """Relative error of the strain at which a bond breaks, unequal disks."""
    return abs(_breaking_share(*(np.array(_CASES[case]) * _limits())) - 1.0)


for _case in _CASES:
    check(
        f"Unequal bond breaks at its strength: {_case}", source=_STRENGTH, tolerance=2e-4,
        reason=_ONE_STEP, quick=True,
    )(lambda case=_case: _break_error(case))  # type: ignore[misc]  # fmt: skip


@check(
    "Unequal bond breaks at its strength: shear, friction angle 35 degrees",
    source=_STRENGTH, tolerance=2e-4, reason=_ONE_STEP, quick=True,
)  # fmt: skip
def _frictional_strength() -> float:
    worst = 0.0
    elongation, slide, _ = _limits()
    pull = 0.2 * elongation  # grows with the slide; negative: pressure
    for sign in (1.0, -1.0):
        stress = _WEAK.bond_modulus / float(_RADII.sum())
        slope = np.tan(np.radians(_WEAK.friction_angle))
        share = _WEAK.cohesion / (stress / _WEAK.bond_stiffness_ratio * slide + slope * stress * sign * pull)
        worst = max(worst, abs(_breaking_share(sign * pull * share, slide * share, 0.0) - 1.0))
    return worst
