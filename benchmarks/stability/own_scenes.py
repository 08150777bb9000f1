"""Small user-defined scenes, drawn at random: impacts, disks that just touch, gravity, bonds across gaps.

Each is judged by the energy balance and the closed-form results of its kind.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from step_limits import fastest_mode

from calcidem.app.studies.stability import Judgement, SceneVerdict, draw_latin
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.readout import energies, unbalanced_ratio, wall_reactions
from calcidem.dem.engine.scene import Bonds, Cement, Sand, Scene, Wall
from calcidem.dem.engine.state import UnstableRunError, advance, choose_features, start
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.compaction import box_walls
from calcidem.dem.sample.packing import LID

_GREATEST = 1.0e-3  # radius of the largest disks, m
_LOOK = 25  # steps between two checks of the energy
_STEPS = 1500  # steps of a run; runs that wait for an event last up to `_TIMES_LONGER` times as long
_TIMES_LONGER = 40
_FASTEST_THROWN = 10.0  # m/s: by Hertz's law, disks ten times as fast penetrate a wall by more than their radius
_AT_REST = 1e-4  # unbalanced-force ratio at which a lid must carry its target
_OWN_RANGES = {
    "step_fraction": (0.5, 1.05),
    "factor": (-1.0, 0.5),
    "speed": (-3.0, 2.0),
    "gap": (-16.0, 0.3),
    "size_ratio": (0.0, 1.0),
    "friction": (0.0, 1.0),
    "push": (-1.0, 4.0),
}
"""Range of every quantity of `OwnScene`; powers of ten except for the step fraction and friction."""
_PLAIN = {"step_fraction", "friction"}


@dataclass(frozen=True, slots=True)
class OwnScene:
    """Scene as a user of `calcidem.dem` may write it."""

    kind: str
    """One of `OWN_KINDS`."""
    step_fraction: float = 0.8
    """Argument of `start`; values above 1 must be refused."""
    factor: float = 1.0
    """Step over the limit at the start, if the step is ``fixed``."""
    speed: float = 0.1
    """Speed of disks, m/s."""
    gap: float = 1e-16
    """Gap between disks, in radii; 1e-16 is rounding."""
    size_ratio: float = 1.0
    """Largest over smallest radius."""
    friction: float = 0.5
    """Friction between disks."""
    push: float = 1.0
    """Gravity over 9.81 m/s^2, at most 1000, and the lid's force in N/m."""
    fixed: bool = False
    """Whether the step is given and therefore constant."""
    seed: int = 1
    """Seed of everything else."""

    @classmethod
    def draw(cls, count: int, seed: int) -> tuple[Self, ...]:
        """Latin hypercube over all quantities with alternating kinds; a third of the scenes have a fixed step."""
        kinds = tuple(OWN_KINDS)
        scenes = []
        for number, values in enumerate(draw_latin(_OWN_RANGES, _OWN_RANGES.keys() - _PLAIN, count, seed)):
            turn = number // len(kinds)
            scenes.append(cls(kinds[number % len(kinds)], **values, fixed=not turn % 3, seed=number))
        return tuple(scenes)

    def judge(self) -> Judgement:
        """Run the scene; its error is that of the energy balance or of a closed-form result of its kind."""
        try:
            error = OWN_KINDS[self.kind](self)
        except ValueError as refusal:
            return Judgement(SceneVerdict.REFUSED, str(refusal))
        except UnstableRunError as end:
            return Judgement(SceneVerdict.STOPPED, str(end))
        # At the limit the energy of a leapfrog varies by some percent.
        return Judgement(SceneVerdict.STABLE if error <= 0.02 else SceneVerdict.WRONG, error=error)


def _begin(own: OwnScene, scene: Scene, velocity: Floats | None = None, spin: Floats | None = None) -> State:
    """Start a scene with its settings and an energy account."""
    features = choose_features(scene, "finite", account=True)
    state = start(scene, features=features, step_fraction=own.step_fraction, velocity=velocity, spin=spin)
    if own.fixed:
        step = own.factor * state.critical_time_step
        state = start(scene, features=features, time_step=step, velocity=velocity, spin=spin)
    return state


def _watch_energies(state: State, ended: Callable[[State], bool] | None = None) -> tuple[State, float]:
    """Advance a state; return the final state, and the largest energy error over the largest energy."""
    steps = _STEPS if ended is None else _STEPS * _TIMES_LONGER
    begin, turned, worst = energies(state).imbalance, 0.0, 0.0
    for _ in range(steps // _LOOK):
        state = advance(state, _LOOK)
        now = energies(state)
        turned = max(turned, abs(now.kinetic + now.elastic), abs(now.load_work), abs(now.wall_work))
        worst = max(worst, abs(now.imbalance - begin))
        if ended is not None and ended(state):
            break
    return state, worst / turned if turned > 0.0 else 0.0


def _impact(own: OwnScene) -> float:
    """Central impact of two disks in any direction; afterwards each has the velocity of an elastic impact."""
    angle = np.random.default_rng(own.seed).uniform(0.0, 2.0 * np.pi)
    along = np.array([np.cos(angle), np.sin(angle)])
    radius = _GREATEST * np.array([1.0, 1.0 / own.size_ratio])
    reach = radius.sum() + own.gap * _GREATEST
    x, y = np.outer(along, [0.0, reach])
    scene = Scene(x, y, radius, Sand(friction=own.friction))
    state = _begin(own, scene, velocity=own.speed * np.array([along, -along]))

    def parted(now: State) -> bool:
        place, velocity = now.position(), now.velocity()
        return bool((velocity[1] - velocity[0]) @ along > 0.0 and (place[1] - place[0]) @ along > radius.sum())

    state, energy = _watch_energies(state, parted)
    if not parted(state):
        return energy  # in flight
    first, second = scene.mass
    common = own.speed * (first - second) / (first + second)
    expected = np.array([2.0 * common - own.speed, 2.0 * common + own.speed])
    found = state.velocity() @ along
    return max(energy, float(np.abs(found - expected).max()) / (2.0 * own.speed))


def _collisions(own: OwnScene) -> float:
    """Disks flying in a box; all stay in it and conserve energy."""
    draw = np.random.default_rng(own.seed)
    column, row = np.meshgrid(np.arange(4), np.arange(3))
    apart = _GREATEST * (2.0 + own.gap)
    radius = _GREATEST * own.size_ratio ** -draw.random(column.size)
    x, y = (apart * (index.ravel() + 0.5) for index in (column, row))
    scene = Scene(x, y, radius, Sand(friction=own.friction), box_walls(4.0 * apart, 3.0 * apart))
    speed = min(own.speed, _FASTEST_THROWN)
    velocity = speed * draw.standard_normal((scene.count, 2))
    state, energy = _watch_energies(_begin(own, scene, velocity, speed / _GREATEST * draw.standard_normal(scene.count)))
    place = state.position()
    inside = ((place > 0.0) & (place < apart * np.array([4.0, 3.0]))).all()
    return energy if inside else np.inf


def _column(own: OwnScene) -> float:
    """Column of disks falling on the floor and on each other; they keep their order and energy."""
    draw = np.random.default_rng(own.seed)
    radius = _GREATEST * own.size_ratio ** -draw.random(int(draw.integers(1, 6)))
    height = np.cumsum(2.0 * radius + own.gap * _GREATEST) - radius
    floor = Wall((0.0, 0.0), (0.0, 1.0), friction=own.friction)
    gravity = (0.0, -9.81 * min(own.push, 1e3))
    scene = Scene(np.zeros_like(radius), height, radius, Sand(friction=own.friction), (floor,), gravity=gravity)
    state, energy = _watch_energies(_begin(own, scene))
    above = np.diff(state.position()[:, 1], prepend=0.0) > 0.0
    return energy if above.all() else np.inf


def _lid(own: OwnScene) -> float:
    """Hexagonal lattice of just touching disks pressed by a servo; at rest, lid and floor carry its force."""
    damping = np.random.default_rng(own.seed).uniform(0.3, 0.9)
    apart = _GREATEST * (2.0 + min(own.gap, 1e-2))
    column, row = np.meshgrid(np.arange(3), np.arange(3))
    x = apart * (column + 0.5 * (row % 2)).ravel() + _GREATEST
    y = np.sqrt(0.75) * apart * row.ravel() + _GREATEST
    width = float(x.max()) + _GREATEST
    walls = box_walls(width, float(y.max()) + _GREATEST, own.push / width)
    scene = Scene(x, y, np.full(len(x), _GREATEST), Sand(friction=own.friction), walls, damping=damping)

    def at_rest(now: State) -> bool:
        return wall_reactions(now)[LID, 0] > 0.0 and unbalanced_ratio(now) < _AT_REST

    # The energy is not checked closely, since servo speed and damping jump from step to step.
    state = _watch_energies(_begin(own, scene), at_rest)[0]
    return float(np.abs(wall_reactions(state)[LID - 1 :, 0] / own.push - 1.0).max()) if at_rest(state) else np.inf


def _gap_bonds(own: OwnScene) -> float:
    """Chain cemented across gaps of up to two radii: its energy, and a step limit not above the true one."""
    draw = np.random.default_rng(own.seed)
    radius = _GREATEST * own.size_ratio ** -draw.random(int(draw.integers(2, 8)))
    wide = radius[1:] + radius[:-1] + draw.uniform(0.0, 2.0, len(radius) - 1) * np.minimum(radius[1:], radius[:-1])
    # Turns of at most 40 degrees: a chain of seven does not close on itself.
    angle = np.cumsum(np.radians(draw.uniform(-40.0, 40.0, len(wide))))
    x, y = (np.append(0.0, np.cumsum(wide * way(angle))) for way in (np.cos, np.sin))
    count = np.arange(len(wide))
    ratio, modulus = 10.0 ** draw.uniform(-1.0, 1.0), 10.0 ** draw.uniform(9.0, 12.0)
    # The loss by a breaking bond is known only to first order in the step, so no bond breaks.
    cement = Cement(modulus, ratio, tensile_strength=np.inf, cohesion=np.inf)
    bonds = Bonds(np.column_stack([count, count + 1]), cement, installation="zero")
    scene = Scene(x, y, radius, Sand(friction=own.friction), bonds=bonds)
    even = start(scene, features=choose_features(scene, "linear"))
    if float(even.critical_time_step[0]) * fastest_mode(even) > 2.0 * (1.0 + 1e-9):
        return np.inf
    velocity = own.speed * draw.standard_normal((scene.count, 2))
    return _watch_energies(_begin(own, scene, velocity))[1]


OWN_KINDS: dict[str, Callable[[OwnScene], float]] = {
    "impact": _impact,
    "collisions": _collisions,
    "gravity": _column,
    "just touching": _lid,
    "bonds across gaps": _gap_bonds,
}
"""Function for the error of each kind of scene."""
