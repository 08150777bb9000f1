"""Impacts of two disks."""

from dataclasses import replace
from functools import cache

import numpy as np
from common import GRAIN, features_of, history, sand_of
from reference import HERTZ_TIME, Floats, Oblique, largest_overlap, oblique_impact
from table import check

from calcidem.dem import Scene, Wall, advance, start

_JOHNSON = "Hertz; Johnson, Contact Mechanics (1985), 4.2 and 11.4, doi:10.1017/CBO9781139171731"
_LEAPFROG = "leapfrog: 0.5 / n^2 at n = 60 steps a contact, where a sine would have 0.41 / n^2"
_SMALL, _LARGE, _SPEED, _ANGLE = 0.7e-3, 3.3e-3, 3.7, 0.83
_STEPS = 60


@cache
def _head_on(steps: int, *, wall: bool) -> Floats:
    """Relative errors of duration, largest overlap and restitution of an impact in an odd direction."""
    n = np.array([np.cos(_ANGLE), np.sin(_ANGLE)])
    radius = np.array([_SMALL] if wall else [_SMALL, _LARGE])
    mass = GRAIN.mass(radius)
    reduced = float(mass[0] if wall else mass.prod() / mass.sum())
    coefficient = float(GRAIN.hertz(_SMALL) if wall else GRAIN.hertz(*radius))
    deepest = largest_overlap(reduced, coefficient, _SPEED)
    duration = HERTZ_TIME * deepest / _SPEED
    place = np.outer([0.0] if wall else [0.0, radius.sum()], n)
    walls = (Wall((float(_SMALL * n[0]), float(_SMALL * n[1])), (-float(n[0]), -float(n[1]))),) if wall else ()
    scene = Scene(place[:, 0], place[:, 1], radius, sand_of(GRAIN), walls)
    velocity = np.zeros_like(place)
    velocity[0] = _SPEED * n
    state = start(scene, features=features_of(scene), velocity=velocity, time_step=duration / steps)
    path, _ = history(state, 2 * steps)
    far = path[:, 0, :2] @ n if wall else _SMALL + _LARGE - np.hypot(*(path[:, 1, :2] - path[:, 0, :2]).T)
    top = int(np.argmax(far))
    before, at, after = far[top - 1 : top + 2]
    peak = at + (after - before) ** 2 / (16.0 * at - 8.0 * (before + after))
    gaps = -far[1:][far[1:] <= 0.0]
    leaving = (gaps[-1] - gaps[0]) / (len(gaps) - 1) / state.time_step[0]
    ended = 2.0 * duration - gaps[-1] / leaving
    return np.abs(np.array([ended / duration, peak / deepest, leaving / _SPEED]) - 1.0)


@check(
    "Hertz impact, unequal disks, odd direction: duration", source=_JOHNSON, tolerance=2e-4, reason=_LEAPFROG,
    quick=True,
)  # fmt: skip
def _duration() -> float:
    return float(_head_on(_STEPS, wall=False)[0])


@check("Hertz impact: largest overlap", source=_JOHNSON, tolerance=2e-4, reason=_LEAPFROG, quick=True)
def _overlap() -> float:
    return float(_head_on(_STEPS, wall=False)[1])


@check(
    "Hertz impact: restitution 1", source=_JOHNSON, tolerance=2e-5,
    reason="symmetric in time: of higher order than the impact itself", quick=True,
)  # fmt: skip
def _restitution() -> float:
    return float(_head_on(_STEPS, wall=False)[2])


@check(
    "Hertz impact: order 2 in the step", source="leapfrog", tolerance=0.1,
    reason="terms of higher order between 60 and 120 steps a contact", quick=True,
)  # fmt: skip
def _order() -> float:
    coarse, fine = _head_on(_STEPS, wall=False)[:2], _head_on(2 * _STEPS, wall=False)[:2]
    return float(np.abs(np.log2(coarse / fine) - 2.0).max())


@check(
    "Hertz impact on a slanting wall: duration, overlap, restitution", source=_JOHNSON, tolerance=2e-4,
    reason=_LEAPFROG, quick=True,
)  # fmt: skip
def _wall() -> float:
    return float(_head_on(_STEPS, wall=True).max())


@check(
    # Restitution 1 at the default step, disks 0.1 mm apart, 1 mm/s to 100 m/s.
    "Restitution 1 at the default step, 1 mm/s to 100 m/s", source=_JOHNSON, tolerance=1e-3,
    reason="promised by the default step of scenes with impacts",
)  # fmt: skip
def _default_step() -> float:
    worst, radius = 0.0, np.full(2, 1.0e-3)
    for speed in 10.0 ** np.arange(-3.0, 2.5):
        scene = Scene(np.array([0.0, 2.1e-3]), np.zeros(2), radius, sand_of(GRAIN))
        state = start(scene, features=features_of(scene), velocity=np.array([[speed, 0.0], [0.0, 0.0]]))
        deepest = largest_overlap(float(GRAIN.mass(1.0e-3)) / 2.0, float(GRAIN.hertz(*radius)), speed)
        while state.time[0] < (2.0e-4 + 2.0 * HERTZ_TIME * deepest) / speed:  # twice flight and contact
            state = advance(state, 200)
        first, second = state.velocity()[:, 0]
        worst = max(worst, abs(float(second - first) / speed - 1.0))
    return worst


@cache
def _oblique_errors(steps: int) -> Floats:
    """(34, 2, 3) errors of velocities and rim speeds over the speed, for 17 angles without and with spin."""
    radius = np.array([_SMALL, 1.9e-3])
    mass = GRAIN.mass(radius)
    errors = []
    for angle in np.radians(np.arange(5.0, 89.0, 5.0)):
        for rim in (0.0, 1.3):
            velocity = 0.6 * np.array([[np.cos(angle), np.sin(angle)], [0.0, 0.0]])
            impact = Oblique(radius, velocity, rim * 0.6 / radius * np.array([1.0, -0.4]))
            closing = float(velocity[0, 0])
            deepest = largest_overlap(float(mass.prod() / mass.sum()), float(GRAIN.hertz(*radius)), closing)
            step = HERTZ_TIME * deepest / closing / steps
            scene = Scene(np.array([0.0, radius.sum()]), np.zeros(2), radius, sand_of(GRAIN))
            state = start(scene, features=features_of(scene), velocity=velocity, spin=impact.spin, time_step=step)
            state = advance(state, round(1.2 * steps))
            found = np.column_stack([state.velocity(), radius * state.spin()])
            errors.append(found - oblique_impact(GRAIN, impact) * np.column_stack([np.ones((2, 2)), radius]))
    return np.array(errors) / 0.6


_MINDLIN = "Hertz, Mindlin and Deresiewicz (1953), doi:10.1115/1.4010702, Coulomb; adaptive integration with events of stick and slip"


@check(
    "Oblique impact, 5 to 85 degrees, without and with spin: velocities and spins", source=_MINDLIN, tolerance=2e-4,
    reason="at 400 steps a contact; slip turns into stick anywhere within a step",
)  # fmt: skip
def _oblique() -> float:
    return float(np.abs(_oblique_errors(400)).max())


@check(
    "Oblique impact at the default step, unequal radii: velocities, rim speeds",
    source=_MINDLIN, tolerance=5e-3, reason="promised by the default step of scenes with impacts; 160 drawn at random: at most as much",
    quick=True,
)  # fmt: skip
def _oblique_default_step() -> float:
    worst, speed = 0.0, 0.6
    for ratio, friction, angle, rim in (
        (0.16, 0.97, 0.55, 0.0), (1.0, 0.97, 0.55, 0.0), (0.33, 1.42, 0.93, 0.25), (0.4, 1.25, 0.3, 1.15),
        (0.7, 0.2, 0.8, -1.0), (0.16, 0.5, 1.3, 0.0),
    ):  # fmt: skip
        grain, radius = replace(GRAIN, friction=friction), np.array([1.0e-3, ratio * 1.0e-3])
        velocity = speed * np.array([[np.cos(angle), np.sin(angle)], [0.0, 0.0]])
        impact = Oblique(radius, velocity, rim * speed / radius * np.array([1.0, -0.4]))
        mass, closing = grain.mass(radius), float(velocity[0, 0])
        deepest = largest_overlap(float(mass.prod() / mass.sum()), float(grain.hertz(*radius)), closing)
        scene = Scene(np.array([0.0, radius.sum()]), np.zeros(2), radius, sand_of(grain))
        state = start(scene, features=features_of(scene), velocity=velocity, spin=impact.spin)
        while state.time[0] < 1.2 * HERTZ_TIME * deepest / closing:
            state = advance(state, 1)
        found = np.column_stack([state.velocity(), radius * state.spin()])
        wanted = oblique_impact(grain, impact) * np.column_stack([np.ones((2, 2)), radius])
        worst = max(worst, float(np.abs(found - wanted).max()) / speed)
    return worst


@check(
    # Impact of spinning disks that slip all the time: spins changed by 2 mu m* v R / I.
    "Impact of spinning disks that slip: change of spins",
    source="Coulomb's impulse; Walton (1993), in Roco (ed.), Particulate Two-Phase Flow", tolerance=1e-3,
    reason="lever arms are shorter by half an overlap, which at 1 cm/s is 3e-4 of a radius", quick=True,
)  # fmt: skip
def _slipping() -> float:
    radius, speed = np.array([_SMALL, 1.9e-3]), 0.01
    mass = GRAIN.mass(radius)
    reduced = float(mass.prod() / mass.sum())
    deepest = largest_overlap(reduced, float(GRAIN.hertz(*radius)), speed)
    scene = Scene(np.array([0.0, radius.sum()]), np.zeros(2), radius, sand_of(GRAIN))
    begun = 6.0 * speed / radius
    state = start(
        scene, features=features_of(scene), velocity=np.array([[speed, 0.0], [0.0, 0.0]]), spin=begun,
        time_step=HERTZ_TIME * deepest / speed / 200,
    )  # fmt: skip
    change = -2.0 * GRAIN.friction * reduced * speed * radius / (mass * radius**2 / 2.0)
    return float(np.abs((advance(state, 240).spin() - begun) / change - 1.0).max())
