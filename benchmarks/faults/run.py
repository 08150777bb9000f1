"""Whatever goes wrong with a campaign, nothing is lost: the whole fault matrix, and kills at random moments.

    python benchmarks/faults/run.py              # the matrix: about 20 minutes on two free cores
    python benchmarks/faults/run.py --only kill  # the cases whose name contains a word
    python benchmarks/faults/run.py --kills 100  # kills of a random process at random moments, about half an hour

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

SEEDS_TO_KILL = 4000
"""More than 100 interrupted runs can compute."""

EARLY = 0.25
"""Share of the kills that do not wait for a result."""

LATEST_KILL = 3.0
"""Seconds after the first new result, or after the start for the early ones."""

PATIENCE = 60.0
"""Seconds after which a kill waits for no result any more."""

STARTUP = 20.0
"""Seconds that a rank may take to load its libraries; only then can it see that its launcher is gone."""


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
    """Kill a random process of a campaign at random moments; tell whether nothing acknowledged was lost."""
    numbers = random.Random(2026)
    folder = top / "kills"
    folder.mkdir()
    trial = Trial(folder, cache, seeds=SEEDS_TO_KILL)
    victims: Counter[str] = Counter()
    codes: Counter[int] = Counter()
    lost = damaged = left = changed = 0
    known: dict[tuple[int, float], tuple[object, ...]] = {}
    for _ in range(kills):
        process = trial.start()
        wait_for_the_moment(trial, process, numbers)
        victims[kill_one(trial, process.pid, numbers)] += 1
        time.sleep(0.3)
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)  # a lost worker ended nothing; stop in order
        codes[trial.wait(process).code] += 1
        left += not trial.leaves_no_process(STARTUP)
        trial.kill_all()
        if not trial.database.exists():
            continue
        damaged += trial.integrity() != "ok"
        lost += len(trial.acknowledged() - trial.settled())
        cells = trial.cells()
        changed += sum(cells.get(key) != value for key, value in known.items())
        known = cells
    print(f"{kills} kills: " + ", ".join(f"{count} of {victim}" for victim, count in sorted(victims.items())))
    print("exit codes of the command: " + ", ".join(f"{count} x {code}" for code, count in sorted(codes.items())))
    print(
        f"acknowledged cells: {len(trial.acknowledged())}, of which lost {lost}; stored {len(known)}, of which changed "
        f"{changed}; databases damaged {damaged}; runs that left processes {left}"
    )
    return not (lost or damaged or left or changed)


def wait_for_the_moment(trial: Trial, process: subprocess.Popen[Any], numbers: random.Random) -> None:
    """Sleep until a random moment: soon after the start, or soon after the first new result of a run."""
    if numbers.random() >= EARLY:
        known, until = len(trial.acknowledged()), time.monotonic() + PATIENCE
        while process.poll() is None and time.monotonic() < until and len(trial.acknowledged()) == known:
            time.sleep(0.05)
    time.sleep(numbers.uniform(0.0, LATEST_KILL))


def kill_one(trial: Trial, command: int, numbers: random.Random) -> str:
    """Kill a random process of a trial; return what it was."""
    processes = trial.processes()
    if not processes:
        return "nobody"
    victim = numbers.choice(sorted(processes))
    try:
        name = Path(f"/proc/{victim}/cmdline").read_bytes().split(b"\0")[0].decode()
        variables = Path(f"/proc/{victim}/environ").read_bytes().split(b"\0")
        os.kill(victim, signal.SIGKILL)
    except OSError:
        return "nobody"
    if victim == command:
        return "the command"
    ranks = [part.decode().partition("=")[2] for part in variables if part.startswith(b"OMPI_COMM_WORLD_RANK=")]
    if ranks:
        return "master" if ranks[0] == "0" else "a worker"
    return Path(name).name


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--kills", type=int, help="instead of the matrix, this many kills at random moments")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="calcidem-faults-") as name:
        top = Path(name)
        cache = top / "cache"
        cache.mkdir()
        good = run_matrix(top, cache, options.only) if options.kills is None else run_kills(top, cache, options.kills)
    sys.exit(not good)


if __name__ == "__main__":
    main()
