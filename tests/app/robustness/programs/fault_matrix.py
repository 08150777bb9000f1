"""Faults on order in a small real campaign, and what becomes of it: used by the tests and by benchmarks/faults."""

import os
import shutil
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from calcidem.app.campaign.launch import find_mpirun
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import _cached_name
from calcidem.app.campaign.run import retry_cells
from calcidem.app.config.reader import load_configuration
from calcidem.ends import CellStatus

CHECKOUT = Path(__file__).parents[4]
sys.path.append(str(CHECKOUT / "tests"))
from marked_processes import MarkedProcesses  # noqa: E402 - a helper of the tests

SMALL_PACKING = CHECKOUT / "tests" / "assets" / "small_packing.npz"
PROGRAM = Path(__file__).with_name("faulty_run.py")

PATIENCE = 400.0
"""Seconds after which a program counts as hung; the longest needs a minute on a free machine."""

CONFIGURATION = """
[campaign]
name = "small"
seeds = {seeds}
contents = [0.45, 0.66]
[packing]
width = 0.03
height = 0.06
unbalanced_force_ratio = 1e-5
[sand]
wave_stiffness_factor = 13.0
[wave]
receiver_half_width = 0.01
listening_depth = 0.006
boundary_thickness = 0.01
step_fraction = {step}
amplitude = 4e-4
[run]
lanes = 2
time_limit = {time_limit}
"""
"""About 280 disks in batches of two cells, all with a velocity."""

SEEDS = 4

NO_LIMIT = 1000.0
"""Seconds; a batch takes a quarter of one."""

TIGHT = 6.0
"""Time limit, s, where a worker is to be given up: the run is cut off 5 s after twice of it."""

WRAPPER = """#!{python}
import os, sys
arguments = sys.argv[1:]
if "-m" in arguments:
    place = arguments.index("-m")
    arguments[place:place + 2] = ["{program}"]
os.environ["MPIRUN_PROCESS"] = str(os.getpid())
os.execv("{mpirun}", ["mpirun", *arguments])
"""
"""The launcher that `calcidem run --ranks` starts: the real mpirun, but each rank is the faulty program."""

Cells = dict[tuple[int, float], tuple[object, ...]]


@dataclass(frozen=True)
class Case:
    """A fault: what happens, to whom, when relative to the commit of a result, and whether the command starts again."""

    fault: str
    victim: str
    moment: str
    restarts: int = 0

    def __str__(self) -> str:
        """Name of the case."""
        return f"{self.victim}: {self.fault} {self.moment} commit{', with a restart' if self.restarts else ''}"

    @property
    def exit_code(self) -> int:
        """Exit code of the run that it disturbs."""
        if self.fault == "SIGSTOP" and self.victim != "worker":
            return 0  # it is let go on
        if self.fault in {"exception", "exit(1)", "time limit"}:
            return 1 if self.victim == "master" else 0
        return 0 if self.restarts else 75

    @property
    def needs_a_limit(self) -> bool:
        """Whether it takes a time limit to notice it."""
        return self.fault in {"endless loop", "time limit"} or (self.fault, self.victim) == ("SIGSTOP", "worker")

    @property
    def marks_a_cell(self) -> bool:
        """Whether the cells of the batch are stored as timed out; after an exception each of them is tried again."""
        return self.fault == "time limit"


def all_cases() -> list[Case]:
    """Every combination that makes sense.

    A worker raises, exits, loops or exceeds its time while it computes, which is before or after a commit, never inside
    one. The master computes nothing that could loop, and has no time limit. To mpirun only signals can happen.
    """
    inner = ("exception", "exit(1)", "_exit(1)", "endless loop", "time limit")
    signals = ("SIGKILL", "segfault", "SIGSTOP")
    worker = [Case(fault, "worker", moment) for fault in inner for moment in ("before", "after")]
    worker += [Case(fault, "worker", moment) for fault in signals for moment in ("before", "while", "after")]
    worker += [Case(fault, "worker", "after", restarts=1) for fault in ("_exit(1)", "SIGKILL", "segfault", "SIGSTOP")]
    others = [
        Case(fault, victim, moment)
        for victim, faults in (("master", ("exception", "exit(1)", "_exit(1)", *signals)), ("mpirun", signals))
        for fault in faults
        for moment in ("before", "while", "after")
    ]
    return worker + others


@dataclass(frozen=True)
class RunEnd:
    """A command that has ended."""

    code: int
    output: str
    seconds: float


class Trial(MarkedProcesses):
    """A small campaign in a folder of its own, run with the real command and the real mpirun.

    Parameters
    ----------
    folder
        Exists and is empty.
    cache
        Keeps the packing from one trial to the next.
    seeds
        How many.
    """

    MARK = "FAULT_FOLDER"
    STEP = 0.1
    """Fraction of the critical step, so small that a batch takes a quarter of a second and is met by a signal."""

    def __init__(self, folder: Path, cache: Path, seeds: int = SEEDS) -> None:
        self.folder = folder
        self.cache = cache
        self._seeds = seeds
        self.configure()
        launcher = folder / "launcher"
        launcher.write_text(WRAPPER.format(python=sys.executable, program=PROGRAM, mpirun=find_mpirun()))
        launcher.chmod(0o755)

    def configure(self, time_limit: float = NO_LIMIT) -> None:
        """Write the configuration, with a time limit for a batch in s; it changes no result."""
        (self.folder / "c.toml").write_text(
            CONFIGURATION.format(step=self.STEP, time_limit=time_limit, seeds=self._seeds)
        )

    @property
    def database(self) -> Path:
        """Database of the campaign."""
        return self.folder / "results" / "small.db"

    def variables(self, case: Case | None = None) -> dict[str, str]:
        """Surroundings of a run in which this fault happens."""
        ordered = {"FAULT": case.fault, "VICTIM": case.victim, "MOMENT": case.moment} if case else {}
        own = {
            "PYTHONPATH": str(CHECKOUT),
            "CALCIDEM_CACHE": str(self.cache),
            "OMPI_MCA_btl": "^ofi",  # without the search for fabrics mpirun starts in 0.2 s instead of 1.2 s
            "MPIRUN": str(self.folder / "launcher"),
            **self.environment(),
        }
        return os.environ | own | ordered

    def start(
        self, *options: str, case: Case | None = None, ranks: int = 3, restarts: int = 0
    ) -> subprocess.Popen[str]:
        """Start the campaign, or go on with it, with these options of the command, and return at once."""
        command = [sys.executable, "-m", "calcidem", "run", "c.toml", "--ranks", str(ranks), *options]
        command += ["--restarts", str(restarts)] if ranks > 1 else []
        with (self.folder / "output").open("w") as output:
            return subprocess.Popen(
                command, cwd=self.folder, env=self.variables(case), stdout=output, stderr=output, text=True
            )

    def wait(self, process: subprocess.Popen[str], patience: float = PATIENCE) -> RunEnd:
        """Wait for a run to end; one that hangs is killed and has the exit code -9."""
        begin = time.monotonic()
        try:
            process.wait(patience)
        except subprocess.TimeoutExpired:
            self.kill_all()
            process.wait()
        return RunEnd(process.returncode, (self.folder / "output").read_text(), time.monotonic() - begin)

    def run(self, *options: str, case: Case | None = None, ranks: int = 3, restarts: int = 0) -> RunEnd:
        """Run the campaign, or go on with it."""
        return self.wait(self.start(*options, case=case, ranks=ranks, restarts=restarts))

    def cells(self) -> Cells:
        """Everything about each cell that physics decides, sections and cement included."""
        if not self.database.exists():
            return {}
        with open_campaign(self.database) as campaign:
            return {
                (cell.key.seed, cell.key.content): (
                    *(cell.status, cell.vs, cell.vs_peak, cell.vs_first_arrival, cell.vs_cross_correlation, cell.steps),
                    *(cell.time_step, cell.content_reached, cell.p_contacts, cell.section, cell.cement),
                )
                for cell in campaign.select(status=("done", "no_arrival"), with_arrays=True)
            }

    def acknowledged(self) -> set[tuple[int, float]]:
        """Cells that the master has stored, as it noted right after."""
        path = self.folder / "acknowledged"
        lines = path.read_text().splitlines() if path.exists() else []
        return {(int(seed), float(content)) for seed, content in (line.split() for line in lines)}

    def settled(self) -> set[tuple[int, float]]:
        """Cells with any outcome."""
        with open_campaign(self.database) as campaign:
            return {(cell.key.seed, cell.key.content) for cell in campaign.select()}

    def attempts(self) -> Counter[str]:
        """Attempts at all cells by their outcome."""
        with open_campaign(self.database) as campaign:
            return Counter(attempt.outcome for attempt in campaign.store.history())

    def integrity(self) -> str:
        """What SQLite says of the database, "ok" if all is well."""
        connection = sqlite3.connect(self.database)
        try:
            return str(connection.execute("PRAGMA integrity_check").fetchone()[0])
        finally:
            connection.close()


def reference(trial: Trial) -> Cells:
    """What an undisturbed run gives; the packing is put into the cache for all trials."""
    packing_hash = load_configuration(trial.folder / "c.toml").packing_hash
    shutil.copy(SMALL_PACKING, trial.cache / _cached_name(packing_hash))
    ended = trial.run(ranks=1)
    if ended.code != 0:
        raise RuntimeError(f"the undisturbed run ended with {ended.code}:\n{ended.output}")
    return trial.cells()


@dataclass(frozen=True)
class Verdict:
    """What became of a campaign that a fault has disturbed.

    Attributes
    ----------
    exit_code, seconds
        Of the disturbed run.
    stored
        Cells done by then.
    attempts
        Attempts at all cells by their outcome, in the end.
    complaints
        What is not as it has to be; empty if all is well.
    """

    case: Case
    exit_code: int
    seconds: float
    stored: int
    attempts: Counter[str]
    complaints: tuple[str, ...]


def judge(case: Case, trial: Trial, expected: Cells, ranks: int = 3, again: int = 3) -> Verdict:
    """Let a fault happen among so many ranks, continue twice, first on ``again`` ranks, and check all on the way."""
    complaints: list[str] = []

    def demand(fact: bool, complaint: str) -> None:
        if not fact:
            complaints.append(complaint)

    def demand_order(moment: str, ended: RunEnd, code: int) -> None:
        demand(ended.code == code, f"exit code {ended.code} {moment}, not {code}:\n{ended.output}")
        demand(trial.leaves_no_process(), f"processes left {moment}")
        trial.kill_all()
        demand(trial.integrity() == "ok", f"database damaged {moment}")
        demand(trial.acknowledged() <= trial.settled(), f"an acknowledged cell is lost {moment}")
        different = [key for key, value in trial.cells().items() if value != expected[key]]
        demand(not different, f"other values {moment}: {different}")

    trial.configure(TIGHT if case.needs_a_limit else NO_LIMIT)
    disturbed = trial.run(case=case, ranks=ranks, restarts=case.restarts)
    trial.configure()
    demand((trial.folder / "happened").exists(), "the fault did not happen")
    demand_order("after the fault", disturbed, case.exit_code)
    demand((f"Start 2 of at most {1 + case.restarts}" in disturbed.output) == bool(case.restarts), "another start")
    stored = len(trial.cells())
    configuration = load_configuration(trial.folder / "c.toml", {"database": str(trial.database)})
    retried = retry_cells(configuration, [CellStatus.FAILED, CellStatus.TIMED_OUT])
    # On a busy machine a batch may exceed a tight limit without any fault.
    as_expected = bool(retried) == case.marks_a_cell or case.needs_a_limit
    demand(as_expected, f"{len(retried)} cells failed or timed out")
    demand_order("of the first continuation", trial.run(ranks=again), 0)
    demand(trial.cells() == expected, "not all cells are there after the first continuation")
    attempts = trial.attempts()
    demand_order("of the second continuation", trial.run(ranks=1), 0)
    demand(trial.cells() == expected, "not all cells are there after the second continuation")
    demand(trial.attempts() == attempts, "the second continuation computed something")
    return Verdict(case, disturbed.code, disturbed.seconds, stored, attempts, tuple(complaints))
