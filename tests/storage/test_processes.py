"""Several processes on one SQLite file: kills, readers during writing, one master."""

import os
import random
import shutil
import signal
import sqlite3
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from forked import ForkedProgram
from sqlalchemy import text

from calcidem.app.campaign.opened import open_campaign
from calcidem.storage.errors import LeaseHeldError
from calcidem.storage.records import CellKey
from calcidem.storage.sql.store import Store

if TYPE_CHECKING:
    from conftest import Records

WRITER = Path(__file__).parent / "programs" / "writer.py"
SEEDS = 1000
"""So many that no writer comes to their end (4 s on a fast machine) before the test kills it."""
ACKNOWLEDGED = 12
"""Cells that are stored before the writer is killed."""

StartWriter = Callable[..., ForkedProgram]


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """Name of a database that the writer creates."""
    return tmp_path / "endurance.db"


@pytest.fixture
def start_writer(database: Path) -> Iterator[StartWriter]:
    """Start a process that writes the database; ended with the test."""
    started: list[ForkedProgram] = []

    def start(seeds: int = SEEDS) -> ForkedProgram:
        started.append(ForkedProgram(WRITER, str(database), str(seeds)))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


def acknowledged(lines: list[str]) -> set[CellKey]:
    """Cells that the writer said it had stored; a line cut off by a kill doesn't count."""
    pairs = [line.split() for line in lines if line.endswith("\n") and not line.startswith("lease")]
    return {CellKey(int(seed), float(content)) for seed, content in pairs}


@pytest.mark.slow
def test_kill_loses_no_acknowledged_row(database: Path, start_writer: StartWriter) -> None:
    """SIGKILL at random moments loses no acknowledged row, and the next writer takes over at once."""
    moments = random.Random(5)
    said: set[CellKey] = set()
    for attempt in range(6):
        process = start_writer()
        lease = process.stdout.readline()
        assert lease.startswith("lease free" if attempt == 0 else "lease ")
        assert attempt == 0 or "last heartbeat" in lease
        lines = [process.stdout.readline() for _ in range(attempt)]  # so that some are, however slow the machine is
        time.sleep(moments.uniform(0.0, 0.15))
        process.send_signal(signal.SIGKILL)
        lines += process.stdout.readlines()
        said |= acknowledged(lines)
        with sqlite3.connect(database) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
            assert connection.execute("PRAGMA foreign_key_check").fetchall() == []
        connection.close()
        with open_campaign(database) as campaign:
            stored = {result.key for result in campaign.select()}
        assert said <= stored
        assert len(stored) <= len(said) + attempt + 1  # one row a kill may be stored and not yet acknowledged
        assert len(said) >= attempt


@pytest.mark.slow
def test_readers_never_block_the_writer(database: Path, start_writer: StartWriter) -> None:
    """Readers in a loop see whole rows, cause no error on either side, and the log stays small."""
    seeds = 150
    process = start_writer(seeds)
    process.stdout.readline()
    log, largest_log, counts = Path(f"{database}-wal"), 0, [0]
    while process.poll() is None:
        with open_campaign(database) as campaign:
            count = int(campaign.vs().count())
            assert all(r.section is not None for r in campaign.select(seed=range(3), with_arrays=True))
        assert count >= counts[-1]
        counts.append(count)
        largest_log = max(largest_log, log.stat().st_size if log.exists() else 0)
    assert process.wait() == 0
    assert len(acknowledged(process.stdout.readlines())) == 2 * seeds
    assert len(counts) > 3
    # SQLite empties the log at 1000 pages of 4 kB; the transactions of the slowest reader's time come on top: on a busy
    # machine 15 MB were seen.
    assert largest_log < 30e6
    with open_campaign(database) as campaign:
        assert int(campaign.vs().count()) == 2 * seeds


@pytest.fixture
def killed(database: Path, start_writer: StartWriter) -> Path:
    """Database whose writer was killed, so that its last transactions are in the write-ahead log."""
    process = start_writer()
    for _ in range(ACKNOWLEDGED + 1):
        process.stdout.readline()
    process.kill()
    process.wait()
    return database


def test_a_reader_leaves_one_file(killed: Path, tmp_path: Path) -> None:
    """Who reads a database leaves no log beside it, also what a kill has left: the file alone is the campaign."""
    assert Path(f"{killed}-wal").stat().st_size > 0
    for _ in range(2):
        with open_campaign(killed) as campaign:
            assert int(campaign.vs().count()) >= ACKNOWLEDGED
        assert {path.name for path in tmp_path.iterdir()} == {killed.name, f"{killed.name}.lock"}


def test_the_file_alone_has_what_a_living_writer_stored(database: Path, tmp_path: Path, records: "Records") -> None:
    """The log is brought into the file at intervals and at the end, while a reader keeps it from being removed."""
    copy = tmp_path / "copy.db"

    def copied() -> int:
        shutil.copy(database, copy)
        with open_campaign(copy) as campaign:
            return int(campaign.vs().count())

    with Store(database) as store:
        store.begin_campaign(records.campaign())
        assert copied() == 0
        with open_campaign(database) as reader:
            assert reader.vs().count() == 0
            store.record_results([records.done(0)])
            store._next_checkpoint = 0.0  # as if the interval were over
            store.record_results([records.done(1)])
            assert copied() == 2
            store.record_results([records.done(2)])
            store.close()
            assert copied() == 3


@pytest.mark.parametrize("part", [0.0, 0.5])
def test_acknowledged_transactions_that_a_damaged_log_loses_are_told(killed: Path, part: float) -> None:
    """SQLite drops a damaged log from the damage on without a word: a note beside the log tells what was in it."""
    with Path(f"{killed}-wal").open("r+b") as log:
        log.seek(32 + int(part * (log.seek(0, os.SEEK_END) - 32)))
        byte = log.read(1)
        log.seek(-1, os.SEEK_CUR)
        log.write(bytes([byte[0] ^ 1]))
    with open_campaign(killed) as campaign:
        assert int(campaign.vs().count()) < ACKNOWLEDGED
        assert any("write-ahead log was damaged" in text for text in campaign.store.damage())
    with Store(killed) as store:
        store.use_campaign()
        assert any("no longer in the database" in sentence for sentence in store.acquire_lease())
    with Store(killed) as store:
        store.use_campaign()
        assert store.damage() == []
        assert not any("no longer in the database" in sentence for sentence in store.acquire_lease())


def test_an_undamaged_log_loses_nothing(killed: Path) -> None:
    """After a kill alone nothing is missing, and nothing is told."""
    with Store(killed) as store:
        store.use_campaign()
        assert store.damage() == []
        assert not any("no longer in the database" in sentence for sentence in store.acquire_lease())


def test_second_master_is_refused_while_the_first_lives(database: Path, start_writer: StartWriter) -> None:
    """A second master is refused by name while the first lives, and reading goes on."""
    first = start_writer()
    first.stdout.readline()
    first.send_signal(signal.SIGSTOP)
    with Store(database) as store:
        store.use_campaign()
        with pytest.raises(LeaseHeldError, match=f"process {first.pid}"):
            store.acquire_lease()
        first.send_signal(signal.SIGKILL)
        first.wait()
        (sentence,) = store.acquire_lease()
        assert f"process {first.pid}" in sentence


def test_lease_of_another_machine_ends_with_its_heartbeat(database: Path, start_writer: StartWriter) -> None:
    """A lease held on another machine is respected until it has been silent for five minutes."""
    process = start_writer(seeds=1)
    process.wait()
    elsewhere = (
        "INSERT INTO lease (campaign_id, token, host, pid, machine, started, lock, acquired, heartbeat) "
        "VALUES (1, 'x', 'elsewhere', 1, 'elsewhere', '1', '', datetime('now'), datetime('now', :age))"
    )
    with Store(database) as store:
        store.use_campaign()
        for age, is_held in (("-4 minutes", True), ("-6 minutes", False)):
            with store._writing() as session:
                session.execute(text("DELETE FROM lease"))
                session.execute(text(elsewhere), {"age": age})
            if is_held:
                with pytest.raises(LeaseHeldError, match="on elsewhere"):
                    store.acquire_lease()
            else:
                assert "elsewhere" in str(store.acquire_lease())


def test_orderly_end_leaves_one_file(database: Path, start_writer: StartWriter) -> None:
    """After an orderly end neither lock nor log is left beside the database."""
    process = start_writer(seeds=1)
    process.wait()
    assert process.wait() == 0
    assert [path.name for path in database.parent.iterdir()] == [database.name]
