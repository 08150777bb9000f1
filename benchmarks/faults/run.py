"""Whatever goes wrong with a campaign, nothing is lost: the whole fault matrix, and kills from a rank's first moment on.

    python benchmarks/faults/run.py              # the matrix: about 20 minutes on two free cores
    python benchmarks/faults/run.py --only kill  # the cases whose name contains a word
    python benchmarks/faults/run.py --kills 300  # kills of a random process in each phase of a run, about two hours

Every case is a small real campaign under the real mpirun. Exit code 1 if anything is not as it should be.
"""

import argparse
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "app" / "robustness" / "programs"))

import subprocess

from fault_matrix import Trial, all_cases, judge, reference

SEEDS_TO_KILL = 8
"""16 cells in 8 batches: a campaign that a run completes soon, so that kills strike its end as often as its start."""

PATIENCE = 180.0
"""Seconds in which a run must have ended or gone on to its end, whatever was killed."""

STARTUP = 20.0
"""Seconds that a rank may take to load its libraries; only then can it see that its launcher is gone."""

PHASES: dict[str, tuple[str, float]] = {
    "spawn": ("", 0.05),
    "import": ("", 1.5),
    "broadcast": ("libmpi", 0.3),
    "packing": ("Packing:", 0.05),
    "compile": ("content hash", 1.0),
    "sweep": (" cells in ", 3.0),
    "export": ("complete after", 0.7),
}
"""What a run does when it is struck: what shows that this begins, in its output or in a rank's memory map (nothing: that
there is a rank), and the latest moment after that, in s."""


def run_matrix(top: Path, cache: Path, word: str) -> bool:
    """Print a line for each case; tell whether all are as they should be."""
    (top / "reference").mkdir()
    expected = reference(top / "reference", cache)
    cases = [case for case in all_cases() if word.lower() in str(case).lower()]
    print(f"{'case':48} exit  seconds  stored  attempts at {len(expected)} cells in the end")
    bad = 0
    for number, case in enumerate(cases):
        folder = top / f"case-{number}"
        folder.mkdir()
        verdict = judge(case, Trial(folder, cache), expected)
        attempts = ", ".join(f"{count} {outcome}" for outcome, count in sorted(verdict.attempts.items()))
        print(f"{case!s:48} {verdict.exit_code:4d} {verdict.seconds:8.1f} {verdict.stored:7d}  {attempts}", flush=True)
        for complaint in verdict.complaints:
            print(f"    WRONG: {complaint}", flush=True)
        bad += bool(verdict.complaints)
    print(f"{len(cases)} cases, {bad} not as they should be; each continued twice, all values equal to the last bit")
    return not bad


def run_kills(top: Path, cache: Path, kills: int) -> bool:
    """Kill a random process of a campaign in each phase of its life; tell whether nothing was lost and nothing hung."""
    numbers = random.Random(2026)
    (top / "reference").mkdir()
    expected = reference(top / "reference", cache, SEEDS_TO_KILL)
    struck: Counter[str] = Counter()
    victims: Counter[str] = Counter()
    codes: Counter[int] = Counter()
    wrong: Counter[str] = Counter()
    slowest = 0.0
    trial: Trial | None = None
    for number in range(kills):
        phase = list(PHASES)[number % len(PHASES)]
        if trial is None or (trial.database.exists() and trial.cells() == expected):
            folder = top / f"kill-{number}"
            folder.mkdir()
            trial = Trial(folder, cache, SEEDS_TO_KILL)
        process = trial.start(restarts=1)
        wait_for(phase, trial, process, numbers)
        victim = kill_one(trial, process.pid, numbers, ranks_only=phase == "spawn")
        struck[phase if victim != "nobody" else "none"] += 1
        victims[victim] += 1
        ended = trial.wait(process, PATIENCE)
        codes[ended.code] += 1
        slowest = max(slowest, ended.seconds)
        found = {
            "hung": ended.code == -signal.SIGKILL and victim != "the command",
            "said nothing": not ended.output.strip() and victim != "the command",
            "processes left": not trial.leaves_no_process(STARTUP),
        }
        trial.kill_all()
        if trial.database.exists():
            cells = trial.cells()
            found |= {
                "database damaged": trial.integrity() != "ok",
                "cells lost": not trial.acknowledged() <= trial.settled(),
                "other bits": any(value != expected[key] for key, value in cells.items()),
                "complete without all cells": ended.code == 0 and cells != expected,
            }
        complaints = [name for name, happened in found.items() if happened]
        wrong.update(complaints)
        said = ended.output.strip().splitlines()[-1:]
        well = ", ".join(complaints) or "well"
        print(f"{phase:10} {victim:16} {ended.code:4d} {ended.seconds:6.1f} s  {well}; {said}", flush=True)
    print(f"{kills} kills: " + ", ".join(f"{phase} {count}" for phase, count in struck.items()))
    print("victims: " + ", ".join(f"{count} of {victim}" for victim, count in sorted(victims.items())))
    print("exit codes of the command: " + ", ".join(f"{count} x {code}" for code, count in sorted(codes.items())))
    print(f"longest {slowest:.0f} s after the kill; wrong: {dict(wrong) or 'nothing'}")
    return not wrong


def wait_for(phase: str, trial: Trial, process: subprocess.Popen[Any], numbers: random.Random) -> None:
    """Sleep until a random moment of a phase of the run, or until the run has ended before it."""
    sign, latest = PHASES[phase]
    until = time.monotonic() + PATIENCE
    while process.poll() is None and time.monotonic() < until and not has_begun(sign, trial):
        time.sleep(0.002)
    time.sleep(numbers.uniform(0.0, latest))


def has_begun(sign: str, trial: Trial) -> bool:
    """Whether a sign of a phase is there."""
    if sign in {"", "libmpi"}:
        return any(rank_of(process) and sign in read(process, "maps") for process in trial.processes())
    return sign in (trial.folder / "output").read_text()


def read(process: int, name: str) -> str:
    """What the system tells of a process, nothing if that has ended."""
    try:
        return Path(f"/proc/{process}/{name}").read_text(errors="replace")
    except OSError:
        return ""


def rank_of(process: int) -> str:
    """Number of the rank that a process is or watches, empty if none."""
    variables = read(process, "environ").split("\0")
    return next((part.partition("=")[2] for part in variables if part.startswith("OMPI_COMM_WORLD_RANK=")), "")


def kill_one(trial: Trial, command: int, numbers: random.Random, *, ranks_only: bool) -> str:
    """Kill a random process of a trial; return what it was."""
    processes = sorted(process for process in trial.processes() if rank_of(process) or not ranks_only)
    if not processes:
        return "nobody"
    victim = numbers.choice(processes)
    rank, line = rank_of(victim), read(victim, "cmdline")
    try:
        os.kill(victim, signal.SIGKILL)
    except OSError:
        return "nobody"
    if victim == command:
        return "the command"
    watches = "'s starter" if "starter.py" in line else ""
    return f"{'master' if rank == '0' else 'worker'}{watches}" if rank else Path(line.split("\0")[0]).name


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--kills", type=int, help="instead of the matrix, this many kills")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="calcidem-faults-") as name:
        top = Path(name)
        cache = top / "cache"
        cache.mkdir()
        good = run_matrix(top, cache, options.only) if options.kills is None else run_kills(top, cache, options.kills)
    sys.exit(not good)


if __name__ == "__main__":
    main()
