"""Kill one process of a campaign, from its first moment to its last: nothing hangs, nothing is lost, no bit changes.

    python benchmarks/faults/kills.py --count 300 --record kills.csv

The campaign is a small one whose disks are in a file, under the real mpirun with three ranks. A phase of its life is
awaited as seen from outside (a process appears, a library is in its memory, a line in the output), then a random moment
in it, and a process gets SIGKILL: a worker, rank 0, mpirun or the command. A campaign that did not complete is continued by the next kill's run, until it does. A run that may restart has to complete. What the record
holds already is not done again, so the same command continues. Exit code 1 if anything is not as it should be.
"""

import argparse
import csv
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from contextlib import suppress
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "app" / "robustness" / "programs"))

from fault_matrix import CONFIGURATION, NO_LIMIT, SMALL_PACKING, Cells, RunEnd, Trial

from calcidem.app.campaign.packing import packing_from_bytes
from calcidem.storage.errors import StoreError

SEEDS = 6
"""12 cells in 6 batches: a campaign that a run completes soon, so that kills strike its end as often as its start."""

STARTUP = 15.0
"""Seconds after the end of the command in which the last process has to end: a rank that loads its libraries sees only
then that its launcher is gone."""

PHASES: dict[str, tuple[str, float, int]] = {
    "command": ("", 0.7, 30),
    "packing": ("Packing: the disks in", 1.0, 25),
    "import": ("a rank", 1.5, 60),
    "joining": ("libmpi", 0.5, 40),
    "sweep": (" cells in ", 3.0, 50),
    "export": ("complete after", 0.7, 28),
}
"""What a run does when it is struck, in order: what shows from outside that this has begun, the latest moment after that,
in s, and its share of the kills. The command makes the packing; its ranks import and find one another under MPI."""

FEWEST = 20
"""Kills of each phase that come first, before the shares are looked at."""

NOT_BEGUN = {"command", "packing", "import"}
"""Phases in which no cell can have been stored."""

COLUMNS = ("phase", "victim", "restarts", "code", "seconds", "complaints")


class KillTrial(Trial):
    """A campaign with a file of disks."""

    def configure(self, time_limit: float = NO_LIMIT) -> None:
        """Write disks and configuration."""
        archive = SMALL_PACKING.read_bytes()
        packing = packing_from_bytes(archive, archive.split(maxsplit=4)[3].decode())
        rows = zip(packing.x.tolist(), packing.y.tolist(), packing.radius.tolist(), strict=True)
        (self.folder / "disks.csv").write_text("x,y,radius\n" + "".join(f"{x!r},{y!r},{r!r}\n" for x, y, r in rows))
        text = CONFIGURATION.format(time_limit=time_limit, seeds=self._seeds)
        text = text.replace("height = 0.06\n", 'file = "disks.csv"\n')
        (self.folder / "c.toml").write_text(text)

    def cells(self) -> Cells:
        """Everything about each cell, nothing if the database was killed before it had a campaign."""
        with suppress(StoreError):
            return super().cells()
        return {}


class Killing:
    """Campaigns that are killed, and what they have to come to.

    Parameters
    ----------
    top
        Folder for all of them; the kernels are compiled into it.
    patience
        Seconds in which a run must have ended or gone on to its end, whatever was killed; in proportion more while
        more processes are ready to run than there are cores.
    """

    def __init__(self, top: Path, patience: float) -> None:
        self._top, self._patience = top, patience
        self._begun: list[KillTrial] = []
        self._count = 0
        os.environ["NUMBA_CACHE_DIR"] = str(top / "kernels")
        trial = self._new_trial("cache")
        ended = self._finish(trial)
        self._expected = trial.cells()
        if ended.code != 0 or len(self._expected) != 2 * SEEDS:
            raise RuntimeError(f"the undisturbed run ended with {ended.code}:\n{ended.output}")

    def kill_in(self, phase: str, numbers: random.Random) -> dict[str, Any] | None:
        """Kill a process of a campaign about this phase and judge what comes of it; None if it ended before that."""
        anew = phase == "packing" or not self._begun  # a later run has it stored
        trial = (
            self._new_trial(f"cache-{self._count}" if phase == "packing" else "cache") if anew else self._begun.pop(0)
        )
        restarts = numbers.choice((0, 0, 1))
        process = trial.start("--start-timeout", str(self._patience / 2.0), restarts=restarts)
        self._wait_for(phase, trial, process, numbers)
        struck = phase_of(trial)
        victim = kill_one(trial, process.pid, numbers)
        ended = trial.wait(process, self._patience * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1)))
        complaints = self._judge(trial, ended, struck, victim, restarts)
        if not trial.database.exists() or trial.cells() != self._expected:
            self._begun.append(trial)
        if complaints:
            sys.stderr.write(ended.output)
        row = (struck, victim, restarts, ended.code, round(ended.seconds, 1), "; ".join(complaints))
        return dict(zip(COLUMNS, row, strict=True)) if complaints or victim != "nobody" else None

    def complete(self) -> bool:
        """Continue what did not complete; tell whether all campaigns now have all cells, with the bits expected."""
        return all(self._finish(trial).code == 0 and trial.cells() == self._expected for trial in self._begun)

    def _new_trial(self, cache: str) -> KillTrial:
        """Give a campaign; its packing has to be made if this cache is not that of the undisturbed one."""
        folder = self._top / f"campaign-{self._count}"
        self._count += 1
        folder.mkdir()
        return KillTrial(folder, self._top / cache, SEEDS)

    def _finish(self, trial: KillTrial) -> RunEnd:
        return trial.wait(trial.start("--start-timeout", "600"), 10.0 * self._patience)  # the first run compiles

    def _judge(self, trial: KillTrial, ended: RunEnd, struck: str, victim: str, restarts: int) -> list[str]:
        """What is not as it has to be after a kill."""
        own_end = victim != "the command"
        codes = {0} if restarts else {0, 1} if struck in NOT_BEGUN else {0, 1, 75} if struck == "joining" else {0, 75}
        found = {
            "hung": own_end and ended.code == -signal.SIGKILL,
            "said nothing": own_end and not ended.output.strip(),
            "traceback": "Traceback (most recent" in ended.output,
            f"exit code {ended.code}": own_end and ended.code not in codes,
            "processes left": not trial.leaves_no_process(STARTUP),
        }
        trial.kill_all()
        if trial.database.exists():
            cells: Cells = trial.cells()
            found |= {
                "database damaged": trial.integrity() != "ok",
                "cells lost": not trial.acknowledged() <= set(cells),  # a damaged one counts as lost
                "other bits": any(value != self._expected[key] for key, value in cells.items()),
                "complete without all cells": ended.code == 0 and cells != self._expected,
            }
        else:
            found |= {"database lost": bool(trial.acknowledged()), "complete without a database": ended.code == 0}
        return [name for name, happened in found.items() if happened]

    def _wait_for(self, phase: str, trial: KillTrial, process: "subprocess.Popen[str]", numbers: random.Random) -> None:
        """Sleep until a random moment of a phase of the run, or until the run has ended before it."""
        sign, latest, _ = PHASES[phase]
        until = time.monotonic() + self._patience
        while process.poll() is None and time.monotonic() < until and not is_there(sign, trial):
            time.sleep(0.01)  # to look takes a while itself
        time.sleep(numbers.uniform(0.0, latest))


def phase_of(trial: Trial) -> str:
    """What a run is doing, from the last sign that is there."""
    return next(phase for phase in reversed(PHASES) if is_there(PHASES[phase][0], trial))


def is_there(sign: str, trial: Trial) -> bool:
    """Whether a sign of a phase is there."""
    if sign not in {"a rank", "libmpi"}:
        return sign in (trial.folder / "output").read_text()
    return any(sign == "a rank" or sign in read(rank, "maps") for rank in trial.processes() if rank_of(rank))


def read(process: int, name: str) -> str:
    """What the system tells of a process, nothing if that has ended."""
    try:
        return Path(f"/proc/{process}/{name}").read_text(errors="replace")
    except OSError:
        return ""


def rank_of(process: int) -> str:
    """Number of the rank that a process is, empty if none."""
    variables = read(process, "environ").split("\0")
    return next((part.partition("=")[2] for part in variables if part.startswith("OMPI_COMM_WORLD_RANK=")), "")


def kill_one(trial: Trial, command: int, numbers: random.Random) -> str:
    """Kill a process of a trial, each kind as often; return what it was."""
    kinds: dict[str, list[int]] = defaultdict(list)
    for process in sorted(trial.processes()):
        rank, line = rank_of(process), read(process, "cmdline")
        if "--version" in line:
            continue  # asked by the command before it starts anything
        kind = "rank 0" if rank == "0" else "a worker" if rank else "the command" if process == command else "mpirun"
        if kind in {"the command", "mpirun"} or "faulty_run.py" in line:  # or a helper of its own
            kinds[kind].append(process)
    if not kinds:
        return "nobody"
    kind = numbers.choice(sorted(kinds))
    try:
        os.kill(numbers.choice(kinds[kind]), signal.SIGKILL)
    except OSError:
        return "nobody"
    return kind


def print_table(rows: list[dict[str, Any]]) -> None:
    """Print what the docs have."""
    print("| killed in | kills | of a worker | rank 0 | mpirun | the command | exit codes | longest, s | wrong |")
    print("|---|---:|---:|---:|---:|---:|---|---:|---:|")
    for phase in [*PHASES, "all"]:
        own = [row for row in rows if phase in {row["phase"], "all"}]
        victims = Counter(row["victim"] for row in own)
        codes = Counter(int(row["code"]) for row in own if row["victim"] != "the command")
        told = ", ".join(f"{count} x {code}" for code, count in sorted(codes.items()))
        counts = [victims[kind] for kind in ("a worker", "rank 0", "mpirun", "the command")]
        longest = max((float(row["seconds"]) for row in own), default=0.0)
        wrong = sum(bool(row["complaints"]) for row in own)
        print(f"| {phase} | {len(own)} | {' | '.join(map(str, counts))} | {told} | {longest:.0f} | {wrong} |")


def main() -> None:
    """Kill until there are as many kills as asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=300, help="how many kills, with those of the record")
    parser.add_argument("--record", type=Path, default=Path("kills.csv"), help="table of the kills, which is continued")
    parser.add_argument("--patience", type=float, default=180.0, help="seconds that a run may take; more if it is busy")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if options.record.exists():
        with options.record.open(newline="") as file:
            rows = list(csv.DictReader(file))
    good = True
    with tempfile.TemporaryDirectory(prefix="calcidem-kills-") as name:
        killing = Killing(Path(name), options.patience) if len(rows) < options.count else None
        while killing is not None and len(rows) < options.count:
            struck = Counter(row["phase"] for row in rows)
            phase = min(PHASES, key=lambda phase: (struck[phase] >= FEWEST, struck[phase] / PHASES[phase][2]))
            row = killing.kill_in(phase, random.Random(f"{len(rows)} {time.time_ns()}"))
            if row is None:
                print(f"{phase}: ended before", flush=True)
                continue
            rows.append(row)
            print(f"{len(rows):4d}", *row.values(), flush=True)
            with options.record.open("a", newline="") as file:
                writer = csv.DictWriter(file, COLUMNS)
                if file.tell() == 0:
                    writer.writeheader()
                writer.writerow(row)
        if killing is not None and not killing.complete():
            print("WRONG: a campaign that was continued does not have all cells and the bits expected")
            good = False
    print_table(rows)
    sys.exit(not good or any(row["complaints"] for row in rows))


if __name__ == "__main__":
    main()
