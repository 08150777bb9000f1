"""A slow twin of the kernel: one sample, one pair at a time, plain Python floats, the formulas of the textbooks.

It shares the switches with `calcidem.dem.kernels`, and no other code with it, `assembly` or `stability`. Pairs are
found by looking at all.
Where the kernel rearranges a formula (change of distance, curvature of a step), the twin takes the plain one.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from calcidem.dem.engine.scene import Preload, Scene
from calcidem.dem.kernels.layout import Features, Floats

Pair = tuple[int, int]


@dataclass
class Twin:
    """A scene in motion, one lane."""

    scene: Scene
    features: Features
    dt: float
    moved: Floats
    velocity: Floats
    wall_moved: Floats
    wall_velocity: Floats
    shear: dict[Pair, float] = field(default_factory=dict)
    overlap_before: dict[Pair, float] = field(default_factory=dict)
    bond: dict[Pair, list[float]] = field(default_factory=dict)
    cemented: set[Pair] = field(default_factory=set)
    intact: set[Pair] = field(default_factory=set)
    linear_reference: dict[Pair, float] = field(default_factory=dict)


def make_twin(
    scene: Scene,
    features: Features,
    dt: float,
    velocity: Floats,
    spin: Floats,
    lane: int = 0,
    preload: Preload | None = None,
) -> Twin:
    """Twin at time zero, with cement installed."""
    count = len(scene.radius)
    walls = np.array([wall.velocity for wall in scene.walls]).reshape(-1, 2)
    twin = Twin(
        scene, features, dt, np.zeros((count, 3)), np.column_stack([velocity, spin]), np.zeros_like(walls), walls.copy()
    )
    if preload is not None:
        for (i, j), force in zip(preload.pairs.tolist(), preload.shear.tolist(), strict=True):
            twin.shear[min(i, j), max(i, j)] = force
    for i in range(count):
        for j in range(i + 1, count):
            twin.overlap_before[i, j] = reference_overlap(scene, i, j)
    for disk in range(count):
        for index in range(len(scene.walls)):
            twin.overlap_before[disk, -1 - index] = wall_overlap(twin, disk, index)
    if scene.bonds is not None:
        for (i, j), bits in zip(scene.bonds.pairs.tolist(), scene.bonds.bits.tolist(), strict=True):
            if bits >> lane & 1:
                install(twin, (min(i, j), max(i, j)))
    return twin


def reference_overlap(scene: Scene, i: int, j: int) -> float:
    """Overlap of two disks at their reference positions."""
    distance = math.hypot(scene.x[j] - scene.x[i], scene.y[j] - scene.y[i])
    return float(scene.radius[i] + scene.radius[j] - distance)


def install(twin: Twin, pair: Pair) -> None:
    """Cement a contact."""
    scene, bonds = twin.scene, twin.scene.bonds
    assert bonds is not None
    twin.cemented.add(pair)
    twin.intact.add(pair)
    twin.bond[pair] = [0.0, 0.0, 0.0]
    overlap = reference_overlap(scene, *pair)
    carried = hertz_coefficient(scene, *pair) * max(overlap, 0.0) ** 1.5
    if bonds.installation == "preserve":
        if twin.features.linear_group:
            twin.linear_reference[pair] = overlap - carried / linear_stiffness(scene, *pair)[0]
            return
        twin.bond[pair] = [carried, twin.shear.get(pair, 0.0), 0.0]
    else:
        twin.linear_reference[pair] = overlap if bonds.installation == "zero" else 0.0
    twin.shear[pair] = 0.0


def hertz_coefficient(scene: Scene, i: int, j: int | None = None) -> float:
    """h_n of two disks, or of a disk and a wall."""
    sand = scene.sand
    effective = 2.0 * scene.radius[i] if j is None else 2.0 / (1.0 / scene.radius[i] + 1.0 / scene.radius[j])
    return float(2.0 / 3.0 * sand.shear_modulus / (1.0 - sand.poisson_ratio) * math.sqrt(2.0 * effective))


def shear_ratio(scene: Scene) -> float:
    """Mindlin's k_s / k_n."""
    nu = scene.sand.poisson_ratio
    return 2.0 * (1.0 - nu) / (2.0 - nu)


def bond_stiffness(scene: Scene, i: int, j: int) -> tuple[float, float, float]:
    """Normal, shear and rotational stiffness of a parallel bond."""
    assert scene.bonds is not None
    cement = scene.bonds.cement
    smallest = min(scene.radius[i], scene.radius[j])
    per_area = cement.bond_modulus / (scene.radius[i] + scene.radius[j])
    area, second_moment = 2.0 * smallest, 2.0 * smallest**3 / 3.0
    return per_area * area, per_area * area / cement.bond_stiffness_ratio, per_area * second_moment


def linear_stiffness(scene: Scene, i: int, j: int) -> tuple[float, float]:
    """Normal and shear stiffness of the linear group."""
    assert scene.bonds is not None
    cement = scene.bonds.cement
    smallest = min(scene.radius[i], scene.radius[j])
    normal = 2.0 * cement.linear_modulus * smallest / (scene.radius[i] + scene.radius[j])
    return normal, normal / cement.linear_stiffness_ratio


def step(twin: Twin, driven: dict[int, float] | None = None) -> None:
    """One leapfrog step; ``driven`` gives some disks their velocity along y."""
    kick_and_drift(twin, all_forces(twin, twin.dt), twin.dt, driven or {})


def first_step(twin: Twin) -> None:
    """Half a kick, in which no contact slides yet, and a drift."""
    kick_and_drift(twin, all_forces(twin, 0.0), twin.dt / 2.0, {})


def kick_and_drift(twin: Twin, force: Floats, kick: float, driven: dict[int, float]) -> None:
    """Local damping, velocities, displacements."""
    scene = twin.scene
    alpha = np.broadcast_to(scene.damping, (len(scene.radius),))
    for disk, radius in enumerate(scene.radius):
        mass = scene.sand.density * math.pi * radius**2
        for component in range(3 if scene.rotation else 2):
            inertia = mass if component < 2 else mass * radius**2 / 2.0
            speed = twin.velocity[disk, component]
            damped = force[disk, component] - alpha[disk] * abs(force[disk, component]) * np.sign(speed)
            if scene.held is None or not scene.held[disk]:
                twin.velocity[disk, component] += kick * damped / inertia
            if component == 1 and disk in driven:
                twin.velocity[disk, component] = driven[disk]
            twin.moved[disk, component] += twin.dt * twin.velocity[disk, component]
    twin.wall_moved += twin.dt * twin.wall_velocity


def all_forces(twin: Twin, dt: float) -> Floats:
    """Force and moment on every disk; histories grow by the increments of the last step of length ``dt``."""
    scene = twin.scene
    count = len(scene.radius)
    force = np.zeros((count, 3)) if scene.load is None else np.array(scene.load, dtype=float)
    for i in range(count):
        for j in range(i + 1, count):
            add_pair(twin, i, j, dt, force)
        for index in range(len(scene.walls)):
            add_wall(twin, i, index, dt, force)
    return force


def place(twin: Twin, disk: int, moved: Floats) -> Floats:
    """Centre of a disk."""
    return np.array([twin.scene.x[disk], twin.scene.y[disk]]) + moved[disk, :2]


def add_pair(twin: Twin, i: int, j: int, dt: float, force: Floats) -> None:
    """Contact of two disks."""
    scene, features, pair = twin.scene, twin.features, (i, j)
    rest = np.zeros_like(twin.moved)
    reference = place(twin, j, rest) - place(twin, i, rest)
    overlap0 = reference_overlap(scene, i, j)
    if features.linear and overlap0 <= 0.0 and pair not in twin.cemented:
        return  # the linear law knows only contacts of the reference geometry
    apart = place(twin, j, twin.moved) - place(twin, i, twin.moved)
    n = reference / np.hypot(*reference) if features.linear else apart / np.hypot(*apart)
    t = np.array([-n[1], n[0]])
    overlap = scene.radius[i] + scene.radius[j] - np.hypot(*apart)
    before = apart - dt * (twin.velocity[j, :2] - twin.velocity[i, :2])
    approach = np.hypot(*before) - np.hypot(*apart)
    arms = [scene.radius[k] - 0.5 * (overlap0 if features.linear else overlap) for k in pair]
    field_ = twin.moved if features.linear else dt * twin.velocity
    turn = [field_[k, 2] if scene.rotation else 0.0 for k in pair]
    slide = t @ (field_[j, :2] - field_[i, :2]) - arms[0] * turn[0] - arms[1] * turn[1]
    twist = turn[1] - turn[0]
    if features.linear:
        closer = -n @ (twin.moved[j, :2] - twin.moved[i, :2])
        normal, shear, moment = tangent_law(twin, pair, closer, slide, twist)
    else:
        normal, shear, moment = pair_law(twin, pair, overlap, approach, slide, twist)
    push = normal * n + shear * t
    force[j, :2] += push
    force[i, :2] -= push
    force[j, 2] += moment - shear * arms[1]
    force[i, 2] -= moment + shear * arms[0]


def tangent_law(twin: Twin, pair: Pair, closer: float, slide: float, twist: float) -> tuple[float, float, float]:
    """Constant stiffnesses."""
    scene = twin.scene
    if pair in twin.cemented:
        bond = bond_stiffness(scene, *pair)
        linear = linear_stiffness(scene, *pair)
        return (bond[0] + linear[0]) * closer, -(bond[1] + linear[1]) * slide, -bond[2] * twist
    stiffness = 1.5 * hertz_coefficient(scene, *pair) * math.sqrt(reference_overlap(scene, *pair))
    return stiffness * closer, -shear_ratio(scene) * stiffness * slide, 0.0


def pair_law(
    twin: Twin, pair: Pair, overlap: float, approach: float, slide: float, twist: float
) -> tuple[float, float, float]:
    """Bond, and Hertz-Mindlin contact or linear group."""
    scene, features = twin.scene, twin.features
    bond = [0.0, 0.0, 0.0]
    if pair in twin.intact:
        stiffness = bond_stiffness(scene, *pair)
        bond = twin.bond[pair]
        bond[0] += stiffness[0] * approach
        bond[1] -= stiffness[1] * slide
        bond[2] -= stiffness[2] * twist
        if features.breakage and too_weak(scene, pair, bond):
            twin.intact.discard(pair)
            bond = [0.0, 0.0, 0.0]
    if pair in twin.cemented and features.linear_group:
        stiffness_n, stiffness_s = linear_stiffness(scene, *pair)
        normal = stiffness_n * max(0.0, overlap - twin.linear_reference[pair])
        shear = twin.shear.get(pair, 0.0) - stiffness_s * slide if normal > 0.0 else 0.0
        twin.shear[pair] = limited(shear, scene.sand.friction * normal)
    elif pair in twin.intact:
        normal, twin.shear[pair] = 0.0, 0.0
    else:
        normal = mindlin(twin, pair, hertz_coefficient(scene, *pair), overlap, slide, scene.sand.friction)
    twin.overlap_before[pair] = overlap
    return normal + bond[0], twin.shear[pair] + bond[1], bond[2]


def mindlin(twin: Twin, key: Pair, coefficient: float, overlap: float, slide: float, friction: float) -> float:
    """Hertz force; the shear force is left in ``twin.shear``."""
    if overlap <= 0.0 or coefficient == 0.0:
        twin.shear[key] = 0.0
        return 0.0
    normal = coefficient * overlap**1.5
    stiffness = shear_ratio(twin.scene) * 1.5 * coefficient * math.sqrt(overlap)
    old = twin.shear.get(key, 0.0)
    before = twin.overlap_before[key]
    if twin.features.rescaling and overlap < before:
        old *= math.sqrt(overlap / before)
    if twin.features.midpoint and not (twin.features.rescaling and overlap < before):
        stiffness *= 0.5 * (1.0 + math.sqrt(max(before, 0.0) / overlap))
    twin.shear[key] = limited(old - stiffness * slide, friction * normal)
    return normal


def limited(shear: float, limit: float) -> float:
    """Coulomb friction."""
    return max(-limit, min(limit, shear))


def too_weak(scene: Scene, pair: Pair, bond: list[float]) -> bool:
    """Whether a bond breaks."""
    assert scene.bonds is not None
    cement = scene.bonds.cement
    radius = min(scene.radius[pair[0]], scene.radius[pair[1]])
    area, second_moment = 2.0 * radius, 2.0 * radius**3 / 3.0
    tension = -bond[0] / area + abs(bond[2]) * radius / second_moment
    strength = cement.cohesion + bond[0] / area * math.tan(math.radians(cement.friction_angle))
    return bool(tension >= cement.tensile_strength or abs(bond[1]) / area >= strength)


def wall_overlap(twin: Twin, disk: int, index: int) -> float:
    """How deep a disk is in a wall."""
    wall = twin.scene.walls[index]
    n = np.array(wall.normal)
    point = np.array(wall.point) + twin.wall_moved[index, 0] * n
    return float(twin.scene.radius[disk] - (place(twin, disk, twin.moved) - point) @ n)


def add_wall(twin: Twin, disk: int, index: int, dt: float, force: Floats) -> None:
    """Contact of a disk and a wall."""
    scene, features, wall, key = twin.scene, twin.features, twin.scene.walls[index], (disk, -1 - index)
    n = np.array(wall.normal)
    t = np.array([-n[1], n[0]])
    overlap0 = scene.radius[disk] - (place(twin, disk, np.zeros_like(twin.moved)) - wall.point) @ n
    if features.linear and overlap0 <= 0.0:
        return
    overlap = wall_overlap(twin, disk, index)
    arm = scene.radius[disk] - 0.5 * (overlap0 if features.linear else overlap)
    field_, wall_field = (
        (twin.moved, twin.wall_moved) if features.linear else (dt * twin.velocity, dt * twin.wall_velocity)
    )
    slide = t @ field_[disk, :2] - wall_field[index, 1] - (arm * field_[disk, 2] if scene.rotation else 0.0)
    coefficient = hertz_coefficient(scene, disk)
    friction = min(wall.friction, scene.sand.friction)
    if features.linear:
        stiffness = 1.5 * coefficient * math.sqrt(overlap0)
        normal = stiffness * (overlap - overlap0)
        twin.shear[key] = -shear_ratio(scene) * stiffness * slide if friction > 0.0 else 0.0
    else:
        normal = mindlin(twin, key, coefficient, overlap, slide, friction)
        twin.overlap_before[key] = overlap
    push = normal * n + twin.shear[key] * t
    force[disk, :2] += push
    force[disk, 2] -= twin.shear[key] * arm
