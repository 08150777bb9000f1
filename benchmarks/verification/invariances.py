"""What must not change, or change in a known way: balances, symmetries, reciprocity."""

from dataclasses import replace
from functools import cache

import numpy as np
from common import GRAIN, features_of, sand_of, stability_limit
from modes import QUARTZ, boxed_packing
from reference import Floats
from table import check

from calcidem.dem import Bonds, Scene, State, Wall, advance, energies, start, wall_reactions

_SPEED = 0.5
_NOETHER = "symmetry of the laws of mechanics"


def _throw(scene: Scene) -> tuple[Floats, Floats]:
    """Random velocities and spins, fast enough that contacts part, meet and slide."""
    generator = np.random.default_rng(9)
    velocity = _SPEED * generator.standard_normal((scene.count, 2))
    return velocity, _SPEED / 1e-3 * generator.standard_normal(scene.count)


@cache
def _scene(share_bonded: float = 0.3) -> Scene:
    """Packing in its box with some bonds, no damping (which knows the axes)."""
    return boxed_packing(share_bonded=share_bonded)


def _flown(scene: Scene, velocity: Floats, spin: Floats, steps: int = 1000) -> State:
    """Scene some steps later: grains slide, part, meet again, and bonds carry them."""
    step = 0.1 * stability_limit(_scene())
    features = replace(features_of(scene), bundles=False)  # the same bits with a kernel that other rows have, too
    return advance(start(scene, features=features, velocity=velocity, spin=spin, time_step=step), steps)


@cache
def _plain() -> State:
    """Scene as it stands."""
    return _flown(_scene(), *_throw(_scene()))


def _difference(found: State, velocity: Floats, spin: Floats) -> float:
    """Largest difference of velocities and rim speeds, over the largest speed."""
    radius = np.asarray(found.scene.radius)
    worst = max(np.abs(found.velocity() - velocity).max(), np.abs((found.spin() - spin) * radius).max())
    return float(worst / np.abs(velocity).max())


_STRETCHED = "rounding of positions, stretched by 1,000 steps of friction and impacts"


@check(
    "Objectivity: packing and walls turned by 0.7 rad", source=_NOETHER, tolerance=1e-8,
    reason=_STRETCHED, quick=True,
)  # fmt: skip
def _turned() -> float:
    scene, (velocity, spin) = _scene(), _throw(_scene())
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    place = np.column_stack([scene.x, scene.y]) @ turn.T
    walls = tuple(
        replace(wall, point=tuple((turn @ wall.point).tolist()), normal=tuple((turn @ wall.normal).tolist()))
        for wall in scene.walls
    )
    other = replace(scene, x=place[:, 0], y=place[:, 1], walls=walls)
    return _difference(_flown(other, velocity @ turn.T, spin), _plain().velocity() @ turn.T, _plain().spin())


@check(
    # Galilei: packing and walls carried along at (1.1, -0.6) m/s move as before, carried.
    "Galilean invariance: packing and walls at constant velocity", source=_NOETHER,
    tolerance=1e-8, reason=_STRETCHED, quick=True,
)  # fmt: skip
def _carried() -> float:
    scene, (velocity, spin) = _scene(), _throw(_scene())
    shift = np.array([1.1, -0.6])
    walls = tuple(
        replace(wall, velocity=(float(shift @ wall.normal), float(shift @ [-wall.normal[1], wall.normal[0]])))
        for wall in scene.walls
    )
    found = _flown(replace(scene, walls=walls), velocity + shift, spin)
    return _difference(found, _plain().velocity() + shift, _plain().spin())


@check(
    "Mirror image of the packing", source=_NOETHER, tolerance=1e-8,
    reason=_STRETCHED, quick=True,
)  # fmt: skip
def _mirrored() -> float:
    scene, (velocity, spin) = _scene(), _throw(_scene())
    mirror = np.array([1.0, -1.0])
    walls = tuple(
        Wall((wall.point[0], -wall.point[1]), (wall.normal[0], -wall.normal[1]), friction=wall.friction)
        for wall in scene.walls
    )
    other = replace(scene, y=-np.asarray(scene.y), walls=walls)
    return _difference(_flown(other, velocity * mirror, -spin), _plain().velocity() * mirror, -_plain().spin())


@check(
    "Disks listed in another order: not a bit changes", source="sums of forces do not depend on the order of the list", tolerance=0.0,
    reason="the sums of forces have one order, whatever the list", quick=True,
)  # fmt: skip
def _shuffled() -> float:
    scene, (velocity, spin) = _scene(), _throw(_scene())
    order = np.random.default_rng(2).permutation(scene.count)
    bonds = Bonds(np.argsort(order)[np.asarray(scene.bonds.pairs)][::-1], scene.bonds.cement)  # type: ignore[union-attr]
    other = replace(scene, x=scene.x[order], y=scene.y[order], radius=scene.radius[order], bonds=bonds)
    found = _flown(other, velocity[order], spin[order])
    return float(np.abs(found.velocity() - _plain().velocity()[order]).max())


@check(
    "Run cut into single steps: not a bit changes",
    source="a state determines all later ones", tolerance=0.0, reason="states are values",
)  # fmt: skip
def _cut() -> float:
    generator = np.random.default_rng(21)
    column, row = np.meshgrid(np.arange(6), np.arange(5))
    place = 2.6e-3 * np.column_stack([column.ravel(), row.ravel()]) + 1.5e-3
    sides = ((0.0, 0.0, 1.0, 0.0), (1.66e-2, 0.0, -1.0, 0.0), (0.0, 0.0, 0.0, 1.0), (0.0, 1.4e-2, 0.0, -1.0))
    walls = tuple(Wall((x, y), (across, up), friction=0.3) for x, y, across, up in sides)
    scene = Scene(place[:, 0], place[:, 1], 1e-3 * generator.uniform(0.7, 1.1, 30), sand_of(GRAIN), walls)
    velocity, spin = 2.0 * generator.standard_normal((30, 2)), 500.0 * generator.standard_normal(30)
    state = start(scene, features=features_of(scene), velocity=velocity, spin=spin)
    whole = advance(state, 1500)
    for _ in range(1500):
        state = advance(state, 1)
    return float(np.abs(np.column_stack([state.velocity() - whole.velocity(), state.spin() - whole.spin()])).max())


def _momenta(state: State) -> Floats:
    """Momentum x, y and angular momentum of every disk (N, 3)."""
    mass, velocity, place = QUARTZ.mass(state.scene.radius), state.velocity(), state.position()
    orbital = mass * (place[:, 0] * velocity[:, 1] - place[:, 1] * velocity[:, 0])
    turning = orbital + 0.5 * mass * np.asarray(state.scene.radius) ** 2 * state.spin()
    return np.column_stack([mass[:, None] * velocity, turning])


@check(
    "Momentum and angular momentum of the packing without walls",
    source="Newton's third law, with arms that add up to the distance", tolerance=1e-12,
    reason="rounding, over the sum of all magnitudes", quick=True,
)  # fmt: skip
def _free() -> float:
    scene = replace(_scene(), walls=())
    before, after = (_momenta(_flown(scene, *_throw(scene), steps=steps)) for steps in (1, 1000))
    return float((np.abs((after - before).sum(axis=0)) / np.abs(after).sum(axis=0)).max())


@check(
    "Momentum of the falling packing: weight and wall forces",
    source="Newton's second law", tolerance=1e-12, reason="rounding, over the sum of all magnitudes", quick=True,
)  # fmt: skip
def _boxed() -> float:
    weight = 9.81 * QUARTZ.mass(_scene().radius)[:, None] * [1.0, -2.0, 0.0]
    scene = replace(_scene(), load=weight)
    state, worst = _flown(scene, *_throw(scene), steps=200), 0.0
    for _ in range(60):
        pushed = weight[:, :2].sum(axis=0)
        for wall, (normal, shear) in zip(scene.walls, wall_reactions(state), strict=True):
            n = np.array(wall.normal)
            pushed = pushed + normal * n - shear * np.array([-n[1], n[0]])
        after = advance(state, 1)
        change = (_momenta(after) - _momenta(state))[:, :2].sum(axis=0) / state.time_step[0]
        size = np.abs(_momenta(after)[:, :2]).sum(axis=0) / state.time_step[0]
        worst = max(worst, float((np.abs(change - pushed) / size).max()))
        state = after
    return worst


@cache
def _imbalance(fraction: float) -> float:
    """Energy that is missing after a fixed time, over the energy turned over: friction, damping, moving walls, loads."""
    scene = boxed_packing(damping=0.15, load=np.tile([0.2, -0.4, 1e-4], (280, 1)))
    walls = (replace(scene.walls[0], velocity=(0.01, 0.02)), *scene.walls[1:])
    scene = replace(scene, walls=walls)
    velocity, spin = _throw(scene)
    state = start(
        scene,
        features=features_of(scene, account=True),
        velocity=velocity,
        spin=spin,
        time_step=fraction * stability_limit(scene),
    )
    state = advance(state, 1)
    before = energies(state)
    after = energies(advance(state, round(100.0 / fraction)))
    turned = max(before.kinetic, after.contact_loss, after.damping_loss)
    return (after.imbalance - before.imbalance) / turned


@check(
    # Energy of the packing: work of walls and loads = kinetic + elastic + friction + damping, at 1/50 of the critical step.
    "Energy balance of the packing, 1/50 of the critical step",
    source="first law; Hertz 2/5 F d, springs F^2 / (2 k)", tolerance=1e-4,
    reason="second order in the step, 1e-5 here; contacts that part and meet add a little",
)  # fmt: skip
def _energy() -> float:
    return abs(_imbalance(0.02))


@check(
    "Energy of the packing: order 2 in the step, from 1/25 to 1/50", source="leapfrog", tolerance=0.3,
    reason="where contacts begin to touch and to slide within a step the order is lower",
)  # fmt: skip
def _energy_order() -> float:
    return abs(float(np.log2(_imbalance(0.04) / _imbalance(0.02))) - 2.0)


@check(
    "Reciprocity of 10 random pairs of disks and components",
    source="Maxwell and Betti; K and M are symmetric", tolerance=1e-10, reason="rounding over 400 steps",
)  # fmt: skip
def _reciprocal() -> float:
    scene = _scene(0.5)
    generator, worst = np.random.default_rng(4), 0.0
    radius = np.asarray(scene.radius)
    inertia = np.column_stack([QUARTZ.mass(radius)] * 2 + [0.5 * QUARTZ.mass(radius) * radius**2])
    for _ in range(10):
        (i, j), (a, b) = generator.choice(scene.count, 2, replace=False), generator.integers(0, 3, 2)
        answers = []
        for source, component, listener, heard in ((i, a, j, b), (j, b, i, a)):
            motion = np.zeros((scene.count, 3))
            motion[source, component] = 1e-3 / inertia[source, component]  # a kick of 1e-3 N s
            state = start(
                scene, features=features_of(scene, "linear"), velocity=motion[:, :2].copy(), spin=motion[:, 2].copy()
            )
            state = advance(state, 400)
            moved = np.column_stack([state.position() - np.column_stack([scene.x, scene.y]), state.rotation()])
            answers.append((moved[listener, heard], np.abs(moved[:, heard]).max()))
        worst = max(worst, abs(answers[0][0] - answers[1][0]) / max(answers[0][1], answers[1][1]))
    return float(worst)
