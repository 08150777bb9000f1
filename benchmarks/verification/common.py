"""Scenes and readings that several checks share; only what `calcidem.dem` offers to everybody."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from reference import Floats, Grain, Integers, Springs

from calcidem.app.campaign.packing import packing_from_bytes
from calcidem.dem import Sand, Scene, State, advance, choose_features, start
from calcidem.dem.kernels.layout import Features
from calcidem.dem.sample.packing import Packing

ROOT = Path(__file__).resolve().parents[2]
GRAIN = Grain(modulus=2.9e10, ratio=0.19, density=2203.0, friction=0.37)


def sand_of(grain: Grain) -> Sand:
    """Material as calcidem takes it."""
    return Sand(grain.modulus, grain.ratio, grain.density, grain.friction)


def features_of(scene: Scene, law: str = "finite", **others: bool) -> Features:
    """Features of a scene and a few more that it does not need, so that checks (and tests) share compiled kernels."""
    found = choose_features(scene, law)  # type: ignore[arg-type]
    more = {"bonds": True, "linear_group": True} if law == "linear" else {}
    return replace(found, damping=True, loads=True, **(more | others))


def stability_limit(scene: Scene) -> float:
    """Reported stability limit at the contacts of the scene, whatever flies about, s."""
    return float(start(scene, law="linear").critical_time_step[0])


def history(state: State, steps: int, every: int = 1) -> tuple[Floats, Floats]:
    """Positions with rotations (T, N, 3) and velocities with spins (T, N, 3), at the start and every so many steps."""
    place, speed = [], []
    for done in range(0, steps + 1, every):
        state = advance(state, every) if done else state
        place.append(np.column_stack([state.position(), state.rotation()]))
        speed.append(np.column_stack([state.velocity(), state.spin()]))
    return np.array(place), np.array(speed)


def small_packing() -> Packing:
    """Packing of 280 disks under 5 kPa with its shear forces, from a file."""
    archive = (ROOT / "tests" / "assets" / "small_packing.npz").read_bytes()
    return packing_from_bytes(archive, archive.split(maxsplit=4)[3].decode())


def contacts_of(scene: Scene, grain: Grain, *, tilting: bool = False) -> Springs:
    """Springs of all overlapping pairs and of disks at walls: Hertz's and Mindlin's tangents at the overlap."""
    place, radius = np.column_stack([scene.x, scene.y]), np.asarray(scene.radius)
    distance = np.hypot(*(place[:, None] - place[None]).transpose(2, 0, 1))
    overlap = radius[:, None] + radius[None] - distance
    first, second = np.nonzero(np.triu(overlap > 0.0, 1))
    depth, apart = overlap[first, second], distance[first, second]
    normal = (place[second] - place[first]) / apart[:, None]
    coefficient = grain.hertz(radius[first], radius[second])
    share = np.full(len(first), grain.shear_share * (grain.friction > 0.0))
    arms = np.stack([radius[first], radius[second]]) - depth / 2.0
    tilt = coefficient * depth**1.5 / apart * tilting
    for wall in scene.walls:
        away = (place - wall.point) @ np.array(wall.normal)
        near = np.flatnonzero((away < radius) & _in_span(wall.span, place - wall.point, wall.normal))
        first, second = np.append(first, np.full(len(near), -1)), np.append(second, near)
        depth = np.append(depth, (radius - away)[near])
        normal = np.vstack([normal, np.tile(wall.normal, (len(near), 1))])
        coefficient = np.append(coefficient, grain.hertz(radius[near]))
        share = np.append(share, np.full(len(near), grain.shear_share * (min(grain.friction, wall.friction) > 0.0)))
        arms = np.hstack([arms, np.tile(radius[near] - (radius - away)[near] / 2.0, (2, 1))])
        tilt = np.append(tilt, np.zeros(len(near)))
    tangent = 1.5 * coefficient * np.sqrt(depth)
    return Springs(first, second, normal, arms, np.stack([tangent, share * tangent, 0.0 * tangent]), tilt)


def _in_span(span: tuple[float, float], apart: Floats, normal: tuple[float, float]) -> "np.ndarray":
    """Which disks belong to a wall by their coordinate along its tangent."""
    along = apart @ np.array([-normal[1], normal[0]])
    return (along >= span[0]) & (along <= span[1])


def inertias(scene: Scene, grain: Grain) -> Floats:
    """(3N,) mass, mass and moment of inertia of the disks."""
    mass, radius = grain.mass(scene.radius), np.asarray(scene.radius)
    return np.column_stack([mass, mass, mass * radius**2 / 2.0]).ravel()


def cemented(springs: Springs, pairs: Integers, stiffness: Floats) -> Springs:
    """Springs of which some are bonds: ``stiffness`` (3, B) of the disks ``pairs`` (B, 2) stands in their place."""
    place = {(min(pair), max(pair)): index for index, pair in enumerate(pairs.tolist())}
    changed = springs.stiffness.copy()
    for index, pair in enumerate(zip(springs.first.tolist(), springs.second.tolist(), strict=True)):
        if (min(pair), max(pair)) in place:
            changed[:, index] = stiffness[:, place[min(pair), max(pair)]]
    return replace(springs, stiffness=changed)
