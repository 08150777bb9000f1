"""Check that the programs compute the same thing, on short runs from the same start.

Where two laws are different by their authors' choice the run is made such that the difference vanishes (no friction,
full sliding, steady normal forces, no spin at the start), and the remaining level is stated with its reason.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from programs import Programs, Worker
from scenes import Floats, Problem, impact_problem, lattice_problem

CENTRED, HALF = "centred", "half"


@dataclass(frozen=True)
class Check:
    """One run that two programs make.

    ``level`` is the largest allowed difference of the displacements, root mean square over the disks, relative to the
    displacements themselves; ``mode`` the shear rescaling of calcidem that is nearest to the peer's law.
    """

    name: str
    peer: str
    problem: Callable[[], Problem]
    steps: int
    level: float
    reason: str
    mode: str = "1"


def slow_spin(problem: Problem) -> Problem:
    """Same problem without spin at the start."""
    return replace(problem, spin=np.zeros_like(problem.spin))


def finer(problem: Problem, times: int) -> Problem:
    """Same problem with a smaller step."""
    return replace(problem, time_step=problem.time_step / times)


def head_on() -> Problem:
    """Two unequal disks, head-on."""
    return impact_problem(0.0, oblique=False)


def sliding() -> Problem:
    """Two unequal spinning disks, oblique, that slide all the time."""
    return impact_problem(0.05, oblique=True)


def sticking() -> Problem:
    """Two unequal spinning disks, oblique, that stick and slip."""
    return impact_problem(0.5, oblique=True)


def smooth_patch() -> Problem:
    """Compressed lattice without friction and damping."""
    return lattice_problem(0.0, 1.0e-3, 0.0, bonded=False)


def damped_patch() -> Problem:
    """Compressed lattice with damping, without friction."""
    return lattice_problem(0.0, 1.0e-3, 0.3, bonded=False)


def rough_patch() -> Problem:
    """Compressed lattice with friction, in very slight motion."""
    return lattice_problem(0.5, 1.0e-5, 0.0, bonded=False)


def rough_damped_patch() -> Problem:
    """Compressed lattice with friction and damping, in slight motion, with a sixteenth of the step."""
    return finer(lattice_problem(0.5, 1.0e-4, 0.3, bonded=False), 16)


def bonded_patch() -> Problem:
    """Bonded lattice of equal disks."""
    return slow_spin(lattice_problem(0.5, 1.0, 0.0, bonded=True))


ROUND_OFF = "same formulas; rounding of positions, which the peers keep and calcidem does not (it keeps displacements)"
ARMS = "LAMMPS' lever arms are full radii, calcidem's end in the middle of the overlap, a part 1e-4 (lattice) shorter"
REST = "same formulas; the rest is below overlap over radius, 2e-4, and was not traced"
AMPLIFIED = (
    "chance of the damping's sign: whether a velocity turns within a step or in the next one. calcidem started with "
    "velocities that are off by 1e-3 is as far from itself: 0.17, 0.04 and 0.01 at 1, 1/4 and 1/16 of the step"
)

CHECKS = (
    *(Check("head-on impact", peer, head_on, 400, 1e-10, ROUND_OFF) for peer in ("lammps", "yade")),
    *(Check("oblique impact, full sliding", peer, sliding, 400, 1e-10, ROUND_OFF) for peer in ("lammps", "yade")),
    *(Check("frictionless lattice", peer, smooth_patch, 200, 1e-7, ROUND_OFF) for peer in ("lammps", "yade")),
    Check("frictionless damped lattice", "lammps", damped_patch, 200, 1e-6, ROUND_OFF),
    Check(
        "frictionless damped lattice, step / 16", "yade", lambda: finer(damped_patch(), 16), 1600, 2e-2,
        "YADE damps by the sign of the velocity at the whole step, the others at the half step: first order",
    ),
    Check(
        "lattice with friction", "lammps", rough_patch, 200, 3e-3,
        "LAMMPS scales the whole shear force with the present stiffness: vanishes with the amplitude; and " + ARMS,
    ),
    Check("lattice with friction", "yade", rough_patch, 200, 1e-6, ROUND_OFF, mode="0"),
    *(
        Check("damped lattice with friction, step / 16", peer, rough_damped_patch, 3200, 6e-2, AMPLIFIED, mode=mode)
        for peer, mode in (("lammps", "1"), ("yade", "0"))
    ),
    Check(
        "oblique impact with sticking", "lammps", sticking, 400, 0.1,
        "LAMMPS scales the whole shear force with the present stiffness, calcidem (mode 1) only while unloading",
    ),
    Check("oblique impact with sticking", "yade", sticking, 400, 1e-8, ROUND_OFF, mode="0"),
    *(
        Check("bonded lattice of equal disks", peer, bonded_patch, 200, level, reason)
        for peer, level, reason in (
            ("lammps", 3e-3, ARMS + "; bpm/rotational equals the parallel bond only for equal disks and small motion"),
            ("yade", 3e-4, REST),
        )
    ),
)  # fmt: skip


def difference(check: Check, programs: Programs) -> float:
    """Largest relative difference of a run at ten times."""
    velocities = HALF if check.peer == "yade" else CENTRED
    with tempfile.TemporaryDirectory() as folder:
        scene = check.problem().save(Path(folder) / "scene.npz")
        theirs = displacements(programs, check.peer, scene, (), check.steps)
        own = ("finite", "1", "float64", check.mode, velocities)
        ours = displacements(programs, "calcidem", scene, own, check.steps)
    deviation = np.sqrt(np.mean((theirs - ours) ** 2, axis=(1, 2)))
    return float(np.max(deviation / np.sqrt(np.mean(ours**2, axis=(1, 2)))))


def displacements(programs: Programs, program: str, scene: Path, arguments: tuple[str, ...], steps: int) -> Floats:
    """(10, N, 2) displacements at ten equally spaced times."""
    with Worker(programs, program, scene, arguments) as worker:
        origin = worker.state()[:, :2]
        moved = []
        for _ in range(10):
            worker.run(steps // 10)
            moved.append(worker.state()[:, :2] - origin)
    return np.array(moved)
