"""Scenes that every program computes: arrays in one .npz file, the same for all."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from tempfile import gettempdir
from time import process_time
from typing import Any

import numpy as np
import numpy.typing as npt

from calcidem.dem.engine.assembly import near_pairs
from calcidem.dem.engine.leapfrog import State, no_recording, run_kernel
from calcidem.dem.engine.scene import Bonds, Cement, Precision, Sand, Scene
from calcidem.dem.engine.state import choose_features, start
from calcidem.dem.kernels.layout import Features
from calcidem.dem.sample.compaction import make_packing
from calcidem.dem.sample.packing import PackingRule

Floats = npt.NDArray[np.float64]
CACHE = Path(gettempdir()) / "calcidem-benchmarks"
HERTZ_STEP = 0.3  # part of the stability limit: contacts stiffen when disks collide
BOND_STEP = 0.5


@dataclass(frozen=True)
class Problem:
    """What to compute, without any word on how.

    Attributes
    ----------
    x, y, radius
        (N,) m.
    held
        (N,) True for disks that stay where they are.
    velocity, spin
        (N, 2) m/s and (N,) rad/s at the start.
    bonds
        (B, 2) indices of cemented disks; empty for sand alone.
    shear_modulus, poisson_ratio, density, friction
        Of the grains: Pa, -, kg/m^3, -.
    bond_stiffness
        (3,) normal and shear (N/m) and rotation (N m) of every bond.
    damping
        Local damping factor.
    time_step
        s.
    skin
        Pairs are listed up to this part of the mean radius apart, by every program.
    """

    x: Floats
    y: Floats
    radius: Floats
    held: npt.NDArray[np.bool_]
    velocity: Floats
    spin: Floats
    bonds: npt.NDArray[np.int64]
    bond_stiffness: Floats
    damping: float
    friction: float
    time_step: float = 0.0
    shear_modulus: float = 6.5e11
    poisson_ratio: float = 0.25
    density: float = 2650.0
    skin: float = 0.2

    def save(self, path: Path) -> Path:
        """Write it where the other programs read it."""
        np.savez(path, **asdict(self))
        return path

    @property
    def mass(self) -> Floats:
        """(N,) kg per metre of thickness."""
        return self.density * np.pi * self.radius**2


def load_problem(path: str) -> Problem:
    """Problem in a file."""
    with np.load(path) as stored:
        values: dict[str, Any] = {name: stored[name] for name in stored.files}
    return Problem(**{name: value.item() if value.shape == () else value for name, value in values.items()})


def as_scene(problem: Problem, *, rescaling: bool = True) -> Scene:
    """Problem as a scene of calcidem."""
    bonds = None
    if len(problem.bonds):
        bonds = Bonds(problem.bonds, cement=cement_of(problem), installation="zero")
    return Scene(
        problem.x,
        problem.y,
        problem.radius,
        Sand(problem.shear_modulus, problem.poisson_ratio, problem.density, problem.friction),
        bonds=bonds,
        damping=problem.damping,
        held=problem.held,
        rescaling=rescaling,
    )


def started(problem: Problem, features: Features, precision: Precision = "float64", *, rescaling: bool = True) -> State:
    """State of a problem at its beginning, the same in every lane."""
    return start(
        as_scene(problem, rescaling=rescaling),
        features=features,
        precision=precision,
        time_step=problem.time_step,
        velocity=problem.velocity,
        spin=problem.spin,
        skin_fraction=problem.skin,
    )


def seconds_of_a_step(state: State, steps: int, rounds: int) -> float:
    """CPU seconds of one step of all lanes, compiled: median of some rounds of so many steps."""
    run_kernel(state, 20, no_recording(state))
    spent = []
    for _ in range(rounds):
        before = process_time()
        done = run_kernel(state, steps, no_recording(state))
        spent.append((process_time() - before) / done)
    return median(spent)


def cement_of(problem: Problem) -> Cement:
    """Cement whose bonds between disks of equal size have the stiffnesses of the problem."""
    normal, shear, _ = problem.bond_stiffness
    return Cement(bond_modulus=float(normal), bond_stiffness_ratio=float(normal / shear))


def with_time_step(problem: Problem, part: float) -> Problem:
    """Same problem with a step that is a part of calcidem's stability limit."""
    scene = as_scene(problem)
    limit = start(scene, features=choose_features(scene, "finite")).critical_time_step
    return replace(problem, time_step=part * float(limit[0]))


def cached_packing(seed: int = 1) -> dict[str, Floats]:
    """Packing of the paper (4,670 disks in 0.1 m x 0.3 m, 5 kPa): made once (25 s), then read from a file."""
    path = CACHE / f"packing-{seed}.npz"
    if not path.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        packing = make_packing(PackingRule(), Sand(), np.random.default_rng(seed))
        size = np.array([packing.width, packing.height])
        np.savez(path, x=packing.x, y=packing.y, radius=packing.radius, size=size)
    with np.load(path) as stored:
        return {name: stored[name] for name in stored.files}


def moving(problem: Problem, speed: float, seed: int = 0) -> Problem:
    """Same problem with random velocities (and rim speeds) of the free disks."""
    generator = np.random.default_rng(seed)
    free = ~problem.held
    velocity = speed * generator.normal(size=(len(free), 2)) * free[:, None]
    spin = speed * generator.normal(size=len(free)) * free / problem.radius
    return replace(problem, velocity=velocity, spin=spin)


def at_rest(x: Floats, y: Floats, radius: Floats, held: npt.NDArray[np.bool_], **others: object) -> Problem:
    """Problem without velocities and bonds."""
    count = len(x)
    values: dict[str, Any] = {"damping": 0.0, "friction": 0.5, "bond_stiffness": np.array([8.0e10, 8.0e10, 3.0e4])}
    return Problem(
        x, y, radius, held, np.zeros((count, 2)), np.zeros(count), np.zeros((0, 2), dtype=np.int64), **(values | others)
    )


def touching_pairs(x: Floats, y: Floats, radius: Floats) -> npt.NDArray[np.int64]:
    """(C, 2) pairs of disks that overlap: what 'contact' means for every program."""
    return near_pairs(np.column_stack([x, y]), radius, 0.0).astype(np.int64)


def packing_problem(*, bonded: bool) -> Problem:
    """Whole packing in slight motion, damping 0.3; the disks at the walls are held, so no program needs walls."""
    stored = cached_packing()
    x, y, radius = stored["x"], stored["y"], stored["radius"]
    rim = np.minimum.reduce([x, stored["size"][0] - x, y, stored["size"][1] - y]) - radius
    # The rim: disks that touch a wall, with margin. The skin: many times what the disks move in a benchmark.
    problem = at_rest(x, y, radius, rim < 0.02 * radius, damping=0.3, skin=0.01)
    if not bonded:
        return with_time_step(moving(problem, 1.0e-4), HERTZ_STEP)
    return with_time_step(moving(with_bonds(problem, float(radius.mean())), 1.0e-4), BOND_STEP)


def with_bonds(problem: Problem, radius: float) -> Problem:
    """Same problem with all contacts bonded as if between disks of this radius."""
    stiffness = Cement().bond_stiffness(np.array([radius]), np.array([radius]))[0]
    return replace(problem, bonds=touching_pairs(problem.x, problem.y, problem.radius), bond_stiffness=stiffness)


def impact_problem(friction: float, *, oblique: bool) -> Problem:
    """Two unequal disks that fly into each other."""
    radius = np.array([1.2e-3, 0.9e-3])
    apart = radius.sum() * (1.0 + 1.0e-5)
    problem = at_rest(np.array([0.0, apart]), np.zeros(2), radius, np.zeros(2, dtype=bool), friction=friction)
    across = 0.3 if oblique else 0.0
    return replace(
        problem,
        velocity=np.array([[0.5, across], [-0.5, 0.0]]),
        spin=np.array([50.0, -20.0]) * oblique,
        time_step=1.0e-7,
    )


def lattice_problem(friction: float, speed: float, damping: float, *, bonded: bool) -> Problem:
    """Patch of a compressed triangular lattice of equal disks with a held rim, in slight random motion."""
    radius, columns, rows = 1.25e-3, 16, 18
    spacing = 2.0 * radius * (1.0 - 2.0e-4)
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    x = ((column + 0.5 * (row % 2)) * spacing).ravel()
    y = (row * spacing * np.sqrt(0.75)).ravel()
    held = ((column == 0) | (column == columns - 1) | (row == 0) | (row == rows - 1)).ravel()
    problem = at_rest(x, y, np.full(x.size, radius), held, friction=friction, damping=damping)
    return with_time_step(moving(with_bonds(problem, radius) if bonded else problem, speed), 0.2)
