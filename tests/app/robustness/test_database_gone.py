"""Whatever happens to the database during a run, the run never says that it is complete, and shows no traceback."""

import os
import shutil
import sqlite3
import subprocess
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from calcidem.app.campaign.opened import open_campaign
from calcidem.storage.errors import StoreError

if TYPE_CHECKING:
    from conftest import Cells, Workshop

pytestmark = [pytest.mark.mpi, pytest.mark.full]

LONGER_THAN_A_WAIT = 33.0
"""Seconds; SQLite waits for 30."""


@pytest.mark.parametrize("ranks", [1, 3])
@pytest.mark.parametrize("what", ["database", "folder"])
def test_a_removed_database_ends_the_run_with_2(workshop: "Workshop", ranks: int, what: str) -> None:
    """A sentence says that it was removed, nothing is called complete, and no other file is made."""
    workshop.configure()
    process = workshop.start("run", "c.toml", *(["--ranks", str(ranks)] if ranks > 1 else []))
    workshop.wait_for_cells(2)
    if what == "folder":
        shutil.rmtree(workshop.database.parent)
    else:
        workshop.database.unlink()
    ended = workshop.wait(process)
    assert (ended.code, "small.db was removed while it was being written" in ended.errors) == (2, True)
    assert "Traceback" not in ended.errors
    assert "NetCDF:" not in ended.output
    assert not workshop.database.exists()
    assert workshop.leaves_no_process()


def test_a_long_lock_drops_nothing(workshop: "Workshop", expected: "Cells") -> None:
    """Another process locks the database for longer than SQLite waits: the run says so, waits, and is complete."""
    workshop.configure()
    process = workshop.start("run", "c.toml", "--ranks", "3")
    workshop.wait_for_cells(2)
    with sqlite3.connect(workshop.database, isolation_level=None, timeout=30.0) as connection:
        connection.execute("BEGIN IMMEDIATE")
        time.sleep(LONGER_THAN_A_WAIT)
        connection.execute("ROLLBACK")
    connection.close()
    ended = workshop.wait(process)
    assert ended.code == 0, ended.errors
    assert "Waiting for another process that has locked the database" in ended.output + ended.errors
    assert workshop.cells() == expected


def test_a_server_database_needs_no_folder_and_may_die(workshop: "Workshop", postgresql_socket: Path) -> None:
    """A campaign on PostgreSQL makes the folder for its results; a server killed under it gives 75 and one sentence."""
    server = f"postgresql://postgres@/postgres?host={postgresql_socket}"
    workshop.configure()
    process = workshop.start("run", "c.toml", "--db", server, "--ranks", "3")
    end = time.monotonic() + 60.0
    while time.monotonic() < end and not _cells_on(server):
        time.sleep(0.1)
    # The connections of the run are ended as an immediate shutdown ends them, but the server is there for other tests.
    kill = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid()"
    psql = shutil.which("psql") or next(str(path) for path in Path("/usr/lib/postgresql").glob("*/bin/psql"))
    ask = [psql, "-h", str(postgresql_socket), "-U", "postgres", "-c"]
    subprocess.run([*ask, kill], check=True, capture_output=True)
    ended = workshop.wait(process)
    assert "Traceback" not in ended.errors
    assert ended.code in {0, 75}, ended.errors  # an idle connection is made anew
    again = workshop.run("run", "c.toml", "--db", server, "--ranks", "3")
    assert again.code == 0, again.errors
    assert (workshop.folder / "results" / "small.nc").exists()


def test_a_server_that_goes_down_ends_ranks_with_75(workshop: "Workshop", postgresql_socket: Path) -> None:
    """Neither refused input nor a run that did not begin: when the server is back the same command goes on."""
    (programs,) = {path.parent for path in Path("/usr/lib/postgresql").glob("*/bin/pg_ctl")}
    ask = [programs / "psql", "-h", postgresql_socket, "-U", "postgres", "-c", "CREATE DATABASE lost"]
    subprocess.run(ask, check=True, capture_output=True)
    server = f"postgresql://postgres@/lost?host={postgresql_socket}"
    owner = {"user": "postgres"} if os.geteuid() == 0 else {}

    def control(*command: str) -> None:
        place = ["-D", str(postgresql_socket / "data"), "-l", str(postgresql_socket / "log")]
        told = [str(programs / "pg_ctl"), *place, "-w", *command]
        subprocess.run(told, check=True, cwd=postgresql_socket, stdout=subprocess.DEVNULL, **owner)

    workshop.configure()
    process = workshop.start("run", "c.toml", "--db", server, "--ranks", "2", "--restarts", "1")
    end = time.monotonic() + 60.0
    while time.monotonic() < end and not _cells_on(server):
        time.sleep(0.1)
    control("-m", "immediate", "stop")
    try:
        ended = workshop.wait(process)
    finally:
        control("restart")  # as it was started
    assert ended.code == 75, ended.errors
    assert "The run was cut off" in ended.output + ended.errors
    assert "Traceback" not in ended.errors
    again = workshop.run("run", "c.toml", "--db", server, "--ranks", "2")
    assert again.code == 0, again.errors


def _cells_on(server: str) -> int:
    """Settled cells of the campaign on a server."""
    try:
        with open_campaign(server, "small") as campaign:
            return len(list(campaign.select()))
    except StoreError:
        return 0
