"""How far the kernel is from what one core of this machine can do.

    python benchmarks/limit/run.py [--json FILE] [--core C]

Measures the ceilings of one core, counts the instructions of the kernel's pair loop in its machine code and the bytes
of its arrays, and compares the time of a contact-step with the larger of the two floors that follow:
arithmetic (vector operations at their measured rates) and memory (bytes at the measured bandwidth of the cache level
that the working set falls into).
"""

import argparse
import json
import os
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1]))
sys.path.insert(0, str(HERE.parent / "peers"))

from assembly import assembly_of, fresh_kernel, pair_loop
from ceilings import Ceilings, measure_ceilings
from scenes import Problem, as_scene, packing_problem, seconds_of_a_step, started, touching_pairs

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.scene import Regime
from calcidem.dem.engine.state import choose_features

LANES = 8
ROUNDS = 7
STEPS = 200
GRAIN_OPERATIONS = {"finite": 36, "small": 36, "linear": 33}
"""Vector operations of one disk outside the pair loop, counted in the source of `motion`: taking and loading the force
(3), three times damping, kick and drift (10 each), and the watch of the pair list (3)."""


@dataclass(frozen=True)
class Report:
    """One kernel against its floors; times in ns a contact-step of one lane."""

    case: str
    measured: float
    arithmetic_floor: float
    memory_floor: float
    listed_per_touching: float
    bytes_per_contact_step: float
    working_set: int
    operations: dict[str, int]

    @property
    def distance(self) -> float:
        """Measured time over the larger floor."""
        return self.measured / max(self.arithmetic_floor, self.memory_floor)


def bytes_of_a_step(state: State) -> tuple[int, int]:
    """Bytes a step reads and writes (each array once), and the size of the arrays it touches."""
    pairs, motion, features = state.assembly.pairs, state.motion, state.features
    changed = [motion.displacement, motion.velocity]
    read = [pairs.first, pairs.second, pairs.geometry]
    if features.linear:
        read += [pairs.tangent]
    else:
        changed += [pairs.shear]
        read += [pairs.hertz, pairs.mindlin, pairs.friction]
    if features.rescaling:
        changed += [pairs.root]
    if features.bonds:
        read += [pairs.bond, pairs.intact]
        changed += [] if features.linear else [pairs.bond_force]
    if features.search:
        read += [state.origin]
    size = sum(array.nbytes for array in changed) + sum(array.nbytes for array in read)
    return size + sum(array.nbytes for array in changed), size


def bandwidth(ceilings: Ceilings, size: int) -> float:
    """GB/s of the smallest measured working set that is not smaller than ``size``."""
    return next(
        (rate for limit, rate in sorted(ceilings.streams.items()) if limit >= size), min(ceilings.streams.values())
    )


def examine(case: str, problem: Problem, regime: Regime, ceilings: Ceilings) -> Report:
    """Measure and count one kernel."""
    state = started(problem, replace(choose_features(as_scene(problem), regime, LANES), midpoint=False))
    touching = len(touching_pairs(problem.x, problem.y, problem.radius))
    listed = len(state.assembly.pairs.second)
    kinds = dict(pair_loop(assembly_of(fresh_kernel(state)), "zmm").kinds("zmm"))
    # Divisions and roots share one unit; the other operations have two.
    divider = kinds.get("division", 0) * ceilings.division + kinds.get("square root", 0) * ceilings.square_root
    plain = sum(kinds.get(kind, 0) for kind in ("multiply-add", "other arithmetic", "estimate")) * ceilings.multiply_add
    grains = state.scene.count * GRAIN_OPERATIONS[regime] * ceilings.multiply_add
    arithmetic = max(listed * divider, listed * plain + grains)
    traffic, size = bytes_of_a_step(state)
    contact_steps = touching * LANES
    return Report(
        case=case,
        measured=1e9 * seconds_of_a_step(state, STEPS, ROUNDS) / contact_steps,
        arithmetic_floor=arithmetic / contact_steps,
        memory_floor=traffic / bandwidth(ceilings, size) / contact_steps,
        listed_per_touching=listed / touching,
        bytes_per_contact_step=traffic / contact_steps,
        working_set=size,
        operations=kinds,
    )


def print_report(ceilings: Ceilings, reports: list[Report]) -> None:
    """Ceilings and one line for each kernel."""
    print(f"clock {ceilings.clock:.2f} GHz; one vector of eight doubles: multiply-add {ceilings.multiply_add:.3f} ns,")
    print(f"division {ceilings.division:.2f} ns, square root {ceilings.square_root:.2f} ns")
    for size, rate in ceilings.streams.items():
        print(f"read and write {size / 1024:10.0f} KiB: {rate:6.1f} GB/s")
    heads = f"{'measured':>9s} {'arithmetic':>11s} {'memory':>7s} {'distance':>9s} {'bytes':>6s} {'listed':>7s}"
    print(f"\n{'kernel':16s} {heads}  operations")
    for report in reports:
        operations = ", ".join(f"{count} {kind}" for kind, count in report.operations.items())
        print(
            f"{report.case:16s} {report.measured:9.2f} {report.arithmetic_floor:11.2f} {report.memory_floor:7.2f}"
            f" {report.distance:9.2f} {report.bytes_per_contact_step:6.1f} {report.listed_per_touching:7.2f}  {operations}"
        )
    print("times in ns a contact-step of one lane; distance: measured over the larger floor")
    print("bytes: moved for a contact-step; listed: pairs in the list for each contact")


def main() -> int:
    """Measure, count, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, default=None, help="write everything to this file, too")
    parser.add_argument(
        "--core", type=int, default=max(os.sched_getaffinity(0)), help="core to bind to (default: the last)"
    )
    options = parser.parse_args()
    os.sched_setaffinity(0, {options.core})
    ceilings = measure_ceilings()
    problems = {name: packing_problem(bonded=name == "bonded") for name in ("hertz", "bonded")}
    reports = [
        examine(f"{name} {regime}", problem, regime, ceilings)
        for name, problem in problems.items()
        for regime in ("finite", "small", "linear")
    ]
    print_report(ceilings, reports)
    if options.json:
        content = {
            "ceilings": asdict(ceilings),
            "kernels": [asdict(report) | {"distance": report.distance} for report in reports],
        }
        options.json.write_text(json.dumps(content, indent=2) + "\n")
        print(f"\nwritten: {options.json}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
