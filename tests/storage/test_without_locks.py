"""File systems without locks, as a library loaded before all others makes them: what works does, the rest says why."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import netCDF4
import pytest
from places import CHECKOUT, TUTORIAL

from calcidem.app.campaign.opened import open_campaign
from calcidem.storage.netcdf import export_netcdf

SOURCE = Path(__file__).parent / "programs" / "without_locks.c"

COMMAND = """
import sys
from calcidem.storage.sql import engine
engine._BUSY_TIMEOUT_SECONDS = 0.1
sys.argv[0] = "calcidem"
from calcidem.app.cli.main import main
main()
"""

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or not shutil.which("cc"), reason="needs Linux and a C compiler"
)

COMPILER = shutil.which("cc") or ""

Run = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the library that takes locks away."""
    library = tmp_path_factory.mktemp("library") / "without_locks.so"
    subprocess.run([COMPILER, "-shared", "-fPIC", "-o", str(library), str(SOURCE), "-ldl"], check=True)
    return library


@pytest.fixture
def run_without(library: Path, tmp_path: Path) -> Run:
    """Give a function that runs a program of Python without some locks."""

    def run(missing: str, program: str, *words: object) -> "subprocess.CompletedProcess[str]":
        environment = os.environ | {"LD_PRELOAD": str(library), "WITHOUT_LOCKS": missing, "PYTHONPATH": str(CHECKOUT)}
        environment.pop("HDF5_USE_FILE_LOCKING", None)
        command = [sys.executable, "-c", program, *map(str, words)]
        return subprocess.run(command, check=False, capture_output=True, text=True, env=environment, cwd=tmp_path)

    return run


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """Give a campaign."""
    return Path(shutil.copy(TUTORIAL, tmp_path / "quick.db"))


def test_a_campaign_is_exported_without_flock(run_without: Run, database: Path) -> None:
    """HDF5 locks files by flock(2), which these files do not need; other libraries keep their default."""
    out = database.with_suffix(".nc")
    for _ in range(2):  # the second looks at the first
        ended = run_without("flock", COMMAND, "export", database, out)
        assert ended.returncode == 0, ended.stderr
    with netCDF4.Dataset(out) as file:
        assert file.dimensions["seed"].size == 8
    told = "import os, calcidem.storage.netcdf; print(os.environ.get('HDF5_USE_FILE_LOCKING'))"
    assert run_without("flock", told).stdout == "None\n"


def test_a_library_that_was_there_before_is_explained(run_without: Run, database: Path) -> None:
    """The remedy is one that works, and nothing is said about space."""
    program = "import netCDF4" + COMMAND
    ended = run_without("flock", program, "export", database, "out.nc")
    assert ended.returncode == 1
    assert "set HDF5_USE_FILE_LOCKING=FALSE before Python starts" in ended.stderr
    assert "space" not in ended.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("status",),
        pytest.param(("export", "out.nc"), marks=pytest.mark.full),
        ("import",),
    ],  # export reads as status does
)
def test_a_database_without_locks_is_refused_in_true_words(
    run_without: Run, database: Path, tmp_path: Path, words: tuple[str, ...]
) -> None:
    """No other process is blamed; on a disk with locks the same command works."""
    if words[0] == "import":
        exported = tmp_path / "campaign.nc"
        with open_campaign(database) as campaign:
            export_netcdf(campaign.store, exported)
        arguments = ("import", exported, "--db", tmp_path / "new.db")
    else:
        arguments = (words[0], database, *words[1:])
    ended = run_without("all", COMMAND, *arguments)
    assert ended.returncode == 2, ended.stderr
    assert "its file system has no locks" in ended.stderr
    assert "--db" in ended.stderr
    assert "process" not in ended.stderr
    assert run_without("flock", COMMAND, *arguments).returncode == 0
