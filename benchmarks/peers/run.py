"""Contact-steps per CPU second of calcidem, LAMMPS and YADE on one packing, one core, in turns.

    python benchmarks/peers/run.py [--rounds N] [--core C] [--seconds S] [--lammps FOLDER]
        [--jaxdem PYTHON]

Start-up, set-up and compilation are not counted. A contact is a pair of disks that overlap, whatever a program has in
its lists; a contact-step is one contact of one sample advanced by one step. benchmarks/verification shows that the
programs compute the same thing.
"""

import argparse
import os
import sys
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from programs import HOW_TO, Programs, Worker, find_programs
from scenes import Floats, packing_problem, touching_pairs

WARM_UP_STEPS = 20


@dataclass
class Case:
    """One program in one mode on one scene, and what was measured."""

    name: str
    program: str
    scene: str
    arguments: tuple[str, ...] = ()
    lanes: int = 1
    nanoseconds: list[float] = field(default_factory=list)
    contacts: int = 0
    steps: int = 0

    @property
    def typical(self) -> float:
        """Median nanoseconds of a contact-step."""
        return median(self.nanoseconds)


def calcidem_case(name: str, scene: str, law: str, lanes: int, precision: str = "float64") -> Case:
    """Case of calcidem with the shear rescaling of its campaigns."""
    return Case(name, "calcidem", scene, (law, str(lanes), precision, "1", "centred"), lanes)


def all_cases(programs: Programs) -> list[Case]:
    """Cases of all installed programs."""
    cases = []
    for scene in ("hertz", "bonded"):
        cases += [
            calcidem_case(f"{scene} finite", scene, "finite", 8),
            calcidem_case(f"{scene} linear", scene, "linear", 8),
            calcidem_case(f"{scene} finite, 1 lane", scene, "finite", 1),
            calcidem_case(f"{scene} finite, 16 lanes float32", scene, "finite", 16, "float32"),
            calcidem_case(f"{scene} linear, 16 lanes float32", scene, "linear", 16, "float32"),
        ]
    for program, label in (("native", "native LAMMPS"), ("lammps", "LAMMPS")):
        if getattr(programs, program):
            cases.append(Case(f"hertz {label}", program, "hertz"))
            cases.append(Case(f"hertz {label}, OPENMP package", program, "hertz", ("omp",)))
            cases.append(Case(f"bonded {label}", program, "bonded"))
    if programs.yade:
        cases.append(Case("hertz YADE", "yade", "hertz"))
        cases.append(Case("bonded YADE", "yade", "bonded"))
    if programs.jaxdem:
        cases.append(Case("linear springs JaxDEM", "jaxdem", "hertz", ("1",)))
        cases.append(Case("linear springs JaxDEM, batch of 8", "jaxdem", "hertz", ("8",), 8))
    return cases


def measure(cases: list[Case], programs: Programs, rounds: int, seconds: float) -> None:
    """Let the programs run in turns; every round starts from the same scene."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        problems = {name: packing_problem(bonded=name == "bonded") for name in ("hertz", "bonded")}
        scenes = {name: problem.save(folder / f"{name}.npz") for name, problem in problems.items()}
        workers = []
        for case in cases:
            worker = stack.enter_context(Worker(programs, case.program, scenes[case.scene], case.arguments))
            worker.run(WARM_UP_STEPS)
            case.steps = max(20, round(WARM_UP_STEPS * seconds / worker.run(WARM_UP_STEPS)))
            workers.append(worker)
        for turn in range(rounds):
            order = range(len(cases)) if turn % 2 == 0 else range(len(cases) - 1, -1, -1)
            for index in order:
                measure_once(cases[index], workers[index], problems[cases[index].scene].radius)
            print(f"  round {turn + 1} of {rounds} done", flush=True)


def measure_once(case: Case, worker: Worker, radius: Floats) -> None:
    """One timed run of one case."""
    worker.reset()
    before = contact_count(worker, radius)
    worker.run(WARM_UP_STEPS)
    spent = worker.run(case.steps)
    case.contacts = round((before + contact_count(worker, radius)) / 2)
    case.nanoseconds.append(1e9 * spent / (case.steps * case.lanes * case.contacts))


def contact_count(worker: Worker, radius: Floats) -> int:
    """Pairs of disks that overlap, counted from positions for every program alike."""
    state = worker.state()
    return len(touching_pairs(state[:, 0], state[:, 1], radius))


def print_table(cases: list[Case]) -> None:
    """Medians with their range, and how many times faster calcidem is: finite, double precision, 8 lanes."""
    print(f"\n{'case':40s} {'contacts':>8s} {'ns a contact-step':>18s} {'range':>15s} {'over calcidem':>14s}")
    own = {case.scene: case for case in cases if case.name == f"{case.scene} finite"}
    for case in cases:
        low, high = min(case.nanoseconds), max(case.nanoseconds)
        ratio = median(s / f for s, f in zip(case.nanoseconds, own[case.scene].nanoseconds, strict=True))
        print(f"{case.name:40s} {case.contacts:8d} {case.typical:18.2f} {low:7.2f}-{high:7.2f} {ratio:14.1f}")


def parse_arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5, help="turns of each program (default 5)")
    parser.add_argument("--seconds", type=float, default=0.5, help="CPU seconds of one turn (default 0.5)")
    parser.add_argument(
        "--core", type=int, default=max(os.sched_getaffinity(0)), help="core to bind to (default: the last)"
    )
    parser.add_argument("--lammps", type=Path, help="folder with the module of a LAMMPS built for this processor")
    parser.add_argument("--jaxdem", type=Path, help="interpreter that can import JaxDEM (pip install ./JaxDEM)")
    return parser.parse_args()


def main() -> None:
    """Run the comparison."""
    options = parse_arguments()
    programs = find_programs(options.core, options.lammps, options.jaxdem)
    for name in programs.missing:
        print(HOW_TO[name] + "\nGoing on without it.\n")
    cases = all_cases(programs)
    print(f"\n{len(cases)} cases on core {options.core}")
    measure(cases, programs, options.rounds, options.seconds)
    print_table(cases)


if __name__ == "__main__":
    main()
