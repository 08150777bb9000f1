"""Shared by the tests of the application: small real campaigns, run by the real command."""

import os
import shutil
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from chromium import Chromium, find_chromium, open_chromium
from forked import run_forked
from marked_processes import MarkedProcesses
from places import CHECKOUT, SMALL_PACKING, MakeOnce
from typer.testing import CliRunner
from unchanged import unchanged_if_refused

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import _cached_name
from calcidem.app.cli.main import _build_application
from calcidem.app.config.reader import load_configuration
from calcidem.app.config.schema import Configuration

PATIENCE = 300.0
"""Seconds after which a program counts as hung; the longest needs 30 s, of which it compiles for 25."""

SMALL = """
[campaign]
name = "small"
seeds = {seeds}
contents = {contents}
[packing]
width = 0.03
height = 0.06
unbalanced_force_ratio = 1e-5
[sand]
wave_stiffness_factor = 4.7
[wave]
receiver_half_width = 0.01
listening_depth = 0.006
boundary_thickness = 0.01
step_fraction = {step}
law = "linear"
{wave}
[run]
lanes = 2
"""
"""About 280 disks; with so small a step a batch takes a quarter of a second, so that a run can be interrupted half-way.

One law needs two kernels, where each process would compile or load three.
"""

SEEDS = 4
CONTENTS = (0.0, 0.66, 5.0)

Cells = dict[tuple[int, float], tuple[object, ...]]


@dataclass(frozen=True)
class Finished:
    """A command that has ended."""

    code: int
    output: str
    errors: str


@dataclass
class Workshop(MarkedProcesses):
    """An empty folder in which the real command is used."""

    MARK = "WORKSHOP"

    folder: Path
    cache: Path
    variables: dict[str, str] = field(default_factory=dict)
    python: str = sys.executable

    @property
    def database(self) -> Path:
        """Database of the small campaign."""
        return self.folder / "results" / "small.db"

    def configure(
        self,
        seeds: object = SEEDS,
        contents: object = CONTENTS,
        wave: str = "",
        name: str = "c.toml",
        *,
        step: float = 0.2,
    ) -> None:
        """Write the configuration of a small campaign."""
        text = SMALL.format(seeds=_toml(seeds), contents=_toml(contents), wave=wave, step=step)
        (self.folder / name).write_text(text, encoding="utf-8")

    def start(self, *arguments: str, program: str = "") -> subprocess.Popen[str]:
        """Start the command, or a program in Python that does, and return at once."""
        command = ["-c", program] if program else ["-m", "calcidem"]
        return subprocess.Popen(
            [self.python, *command, *arguments],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self._variables(),
        )

    def _variables(self) -> dict[str, str]:
        return (
            os.environ
            | {
                "PYTHONPATH": str(CHECKOUT),
                "CALCIDEM_CACHE": str(self.cache),
                "OMPI_MCA_btl": "^ofi",  # without the search for fabrics mpirun starts in 0.2 s instead of 1.2 s
            }
            | self.environment()
            | self.variables
        )

    def run(self, *arguments: str) -> Finished:
        """Run the command; if it refuses its input, all files are as they were."""
        with unchanged_if_refused(self.folder, self.cache) as codes:
            if self.python == sys.executable:
                finished = Finished(*run_forked(arguments, self.folder, self._variables(), PATIENCE))
            else:
                finished = self.wait(self.start(*arguments))
            codes.append(finished.code)
        return finished

    def wait(self, process: subprocess.Popen[str]) -> Finished:
        """Wait for a command to end."""
        try:
            output, errors = process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            output, errors = process.communicate()
            pytest.fail(f"still running after {PATIENCE} s:\n{output}\n{errors}")
        return Finished(process.returncode, output, errors)

    def cells(self) -> Cells:
        """Everything about each settled cell that physics decides, sections and cement included."""
        with open_campaign(self.database) as campaign:
            return {
                (cell.key.seed, cell.key.content): (
                    *(cell.status, cell.reason, cell.vs, cell.vs_peak, cell.vs_first_arrival, cell.steps),
                    *(
                        cell.vs_cross_correlation,
                        cell.coherence,
                        cell.reading_error,
                        cell.time_step,
                        cell.stability_limit,
                    ),
                    *(cell.content_reached, cell.p_contacts, cell.c_contacts, cell.numerical_error),
                    *(cell.section, cell.cement),
                )
                for cell in campaign.select(with_arrays=True)
            }

    def attempts(self) -> int:
        """How many cells were ever computed, repetitions counted."""
        with open_campaign(self.database) as campaign:
            return sum(1 for _ in campaign.store.history())

    def wait_for_cells(self, count: int) -> None:
        """Wait until so many cells have an outcome."""
        end = time.monotonic() + PATIENCE
        while self.cells_with_outcome() < count:
            if time.monotonic() > end:
                pytest.fail(f"there are still not {count} cells")
            time.sleep(0.05)

    def cells_with_outcome(self) -> int:
        """Count the cells that have an outcome; cheap, since the ranks that compute them need the cores."""
        if not self.database.exists():
            return 0
        with closing(sqlite3.connect(f"file:{self.database}?mode=ro", uri=True)) as connection:
            try:
                return int(connection.execute("select count(*) from result").fetchone()[0])
            except sqlite3.OperationalError:
                return 0  # it is being made

    def rank(self, number: int) -> int:
        """Process of a rank."""
        (found,) = self.processes(f"OMPI_COMM_WORLD_RANK={number}")
        return found


def _toml(value: object) -> str:
    return str(list(value)) if isinstance(value, tuple) else str(value)


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a cache folder that holds the small packing, so that every run computes on the same disks."""
    folder = tmp_path_factory.mktemp("cache")
    configuration = folder / "c.toml"
    configuration.write_text(SMALL.format(seeds=SEEDS, contents=list(CONTENTS), wave="", step=0.2), encoding="utf-8")
    packing_hash = load_configuration(configuration).packing_hash
    shutil.copy(SMALL_PACKING, folder / _cached_name(packing_hash))
    return folder


@pytest.fixture
def cached_packing(small_configuration: Configuration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a run of `small_configuration` find its packing, and make none."""
    folder = tmp_path / "packing-cache"
    folder.mkdir()
    shutil.copy(SMALL_PACKING, folder / _cached_name(small_configuration.packing_hash))
    monkeypatch.setenv("CALCIDEM_CACHE", str(folder))


@pytest.fixture(scope="session")
def expected(make_once: MakeOnce, cache: Path) -> Cells:
    """Give what one process computes of the small campaign without a break."""

    def fill(path: Path) -> None:
        reference = Workshop(path, cache)
        reference.configure()
        done = reference.run("run", "c.toml")
        assert done.code == 0, done.errors

    cells = Workshop(make_once("reference", fill), cache).cells()
    assert len(cells) == SEEDS * len(CONTENTS)
    return cells


@pytest.fixture
def workshop(tmp_path: Path, cache: Path) -> Iterator[Workshop]:
    """Give an empty folder; whatever still runs there is killed after the test."""
    place = Workshop(tmp_path, cache)
    yield place
    place.kill_all()


@pytest.fixture
def invoke(tmp_path: Path) -> Callable[..., str]:
    """Run a command line that ends with the exit code expected, and give what it prints; 2 leaves all files alone."""

    def run(*arguments: object, exit_code: int = 0) -> str:
        words = [str(argument) for argument in arguments]
        used = {path.parent.resolve() for path in map(Path, words) if path.is_file()}
        scratch = tmp_path.parents[1]  # of all tests, and no device or part of the checkout
        with unchanged_if_refused(tmp_path, *(folder for folder in used if scratch in folder.parents)) as codes:
            result = CliRunner().invoke(_build_application(), words)
            codes.append(result.exit_code)
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        assert result.exit_code == exit_code, result.output
        return result.output

    return run


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    """Give a browser that has shown nothing yet."""
    program = find_chromium()
    if program is None:
        pytest.skip("Chromium is not installed (Debian: apt-get install chromium)")
    with open_chromium(program, tmp_path_factory.mktemp("browser")) as running:
        yield running
