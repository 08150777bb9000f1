"""Files that can't be used as they are: foreign, newer, older, damaged, locked, full, read-only."""

import os
import shutil
import sqlite3
import stat
import subprocess
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path
from threading import Barrier
from typing import TYPE_CHECKING

import pytest
from sqlalchemy import create_engine, text

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.cli.exit_codes import _exit_code_of
from calcidem.ends import CellStatus
from calcidem.storage.errors import (
    DamagedStoreError,
    DiskError,
    ForeignDatabaseError,
    LeaseHeldError,
    OtherSchemaError,
    OutputRefusedError,
    StoreError,
    StoreInterruptedError,
    StoreLockedError,
    StoreUnavailableError,
)
from calcidem.storage.records import CellKey, CellResult, RunRecord
from calcidem.storage.sql import engine
from calcidem.storage.sql.engine import find_damage
from calcidem.storage.sql.lease import replace_database
from calcidem.storage.sql.store import Store
from calcidem.sweep.schedule import EXIT_RESUMABLE

if TYPE_CHECKING:
    from conftest import Records

NOBODY = 65534  # the user without rights on Linux


@pytest.fixture
def database(tmp_path: Path, records: "Records") -> Path:
    """Create a closed database with two done cells."""
    path = tmp_path / "one.db"
    with Store(path) as store:
        store.begin_campaign(records.campaign())
        store.record_results([records.done(0), records.done(1)])
    return path


def execute(path: Path, statement: str) -> None:
    """Run a statement behind the store's back."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute(statement)
    connection.close()


@pytest.mark.parametrize("read_only", [True, False])
@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda path: execute(path, "CREATE TABLE recipe (name TEXT)"), ForeignDatabaseError),
        (lambda path: path.write_text("not a database, but long enough to look at\n" * 50), ForeignDatabaseError),
        (lambda path: path.mkdir(), StoreUnavailableError),
    ],
)
def test_foreign_files_are_refused_untouched(
    tmp_path: Path, make: Callable[[Path], object], error: type, read_only: bool
) -> None:
    """Something else under that name is refused, for reading and for writing, and left as it was."""
    path = tmp_path / "recipes.db"
    make(path)
    before = path.read_bytes() if path.is_file() else b""
    with pytest.raises(error, match=r"recipes\.db"):
        Store(path, read_only=read_only)
    assert (path.read_bytes() if path.is_file() else b"") == before


def test_missing_files(tmp_path: Path) -> None:
    """Reading what is missing creates nothing; writing into a missing folder names the folder."""
    with pytest.raises(StoreUnavailableError, match="does not exist"):
        open_campaign(tmp_path / "none.db")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(StoreUnavailableError, match="folder"):
        Store(tmp_path / "nowhere" / "one.db")


@pytest.mark.parametrize(
    "url", ["nosuch://host/database", "sqlite://", "postgresql://nobody@127.0.0.1:1/none", "http://["]
)
def test_unusable_urls(url: str) -> None:
    """An URL that leads nowhere is refused with a message of the store."""
    with pytest.raises(StoreUnavailableError):
        Store(url)


def test_newer_schema_is_refused(database: Path) -> None:
    """Tables of the future are refused, for reading and writing; the remedy is the other version and a file."""
    execute(database, "UPDATE calcidem_schema SET version = 9999")
    for read_only in (True, False):
        with pytest.raises(OtherSchemaError, match=r"another version of calcidem.*schema 9999.*'calcidem export'"):
            Store(database, read_only=read_only)


@pytest.mark.parametrize("read_only", [True, False])
def test_the_former_tables_are_refused(tmp_path: Path, read_only: bool) -> None:
    """A database of calcidem 0.1.0 is refused in one sentence, for reading and for writing, and left as it was."""
    asset = Path(__file__).parent / "assets" / "calcidem_0.1.0.db"
    path = Path(shutil.copy(asset, tmp_path))
    with pytest.raises(OtherSchemaError, match=r"written by another version of calcidem"):
        Store(path, read_only=read_only)
    assert path.read_bytes() == asset.read_bytes()
    assert [found.name for found in tmp_path.iterdir()] == [path.name]


def test_damage_is_recognised(database: Path) -> None:
    """Overwritten pages are reported as damage, not as some driver's error."""
    content = bytearray(database.read_bytes())
    content[4096:] = b"\x5a" * (len(content) - 4096)
    database.write_bytes(content)
    with pytest.raises(DamagedStoreError, match="recover"):
        open_campaign(database)


def test_full_disk_keeps_what_was_there(database: Path, records: "Records") -> None:
    """A transaction that does not fit is refused as a whole, and the store goes on once there is room."""
    with Store(database) as store:
        store.use_campaign()
        with store._connections._engine.connect() as connection:
            pages = connection.exec_driver_sql("PRAGMA page_count").scalar_one()
            connection.exec_driver_sql(f"PRAGMA max_page_count={pages}")
        big = [records.with_arrays(seed, content) for seed in (2, 3) for content in (0.0, 0.3, 5.0)]
        with pytest.raises(DiskError, match="Free some space"):
            store.record_results(big)
        assert store.attempt_counts([big[0].key])[big[0].key].attempts == 0
        with store._connections._engine.connect() as connection:
            connection.exec_driver_sql("PRAGMA max_page_count=1000000")
        store.record_results(big)
        assert len(list(store.results())) == 2 + len(big)


def test_lock_of_another_process(database: Path, records: "Records", monkeypatch: pytest.MonkeyPatch) -> None:
    """A database locked by somebody else gives an error after the waiting time, and nothing is stored."""
    monkeypatch.setattr(engine, "_BUSY_TIMEOUT_SECONDS", 0.1)
    with Store(database) as store:
        store.use_campaign()
        other = sqlite3.connect(database, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(StoreLockedError, match="Try again"):
            store.record_results([records.done(2)])
        assert len(list(store.results())) == 2
        other.rollback()
        other.close()
        assert store.record_results([records.done(2)]) == 1


@pytest.mark.parametrize("what", ["removed", "replaced", "without its folder"])
def test_a_database_that_is_gone_is_not_written_any_more(tmp_path: Path, records: "Records", what: str) -> None:
    """Whoever writes a file that has no name any more, or not that one, is told before anything is stored."""
    path = tmp_path / "results" / "one.db"
    path.parent.mkdir()
    with Store(path) as store:
        store.begin_campaign(records.campaign())
        store.acquire_lease()
        if what == "without its folder":
            shutil.rmtree(path.parent)
        else:
            path.unlink()
        if what == "replaced":
            path.touch()
        word = "replaced" if what == "replaced" else "removed"
        for write in (store.renew_lease, lambda: store.record_results([records.done(0)])):
            with pytest.raises(OutputRefusedError, match=rf"one\.db was {word}"):
                write()


@pytest.mark.parametrize(("on_network", "journal"), [(False, "wal"), (True, "delete")])
def test_pragmas(database: Path, on_network: bool, journal: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Writers use a write-ahead log locally and a rollback journal on a network, always fully synchronous."""
    monkeypatch.setattr(engine, "is_network_filesystem", lambda _path: on_network)
    with Store(database) as store, store._reading() as session:
        pragmas = {
            name: session.execute(text(f"PRAGMA {name}")).scalar_one()
            for name in ("journal_mode", "synchronous", "foreign_keys", "journal_size_limit")
        }
    assert pragmas == {
        "journal_mode": journal,
        "synchronous": 2,
        "foreign_keys": 1,
        "journal_size_limit": 64 * 2**20,
    }


@pytest.mark.parametrize("name", ["with space.db", "100%.db", "what?.db", "a#b.db", "größe.db"])
def test_awkward_names(tmp_path: Path, name: str, records: "Records") -> None:
    """Characters that mean something in URLs are only characters in file names."""
    with Store(tmp_path / name) as store:
        store.begin_campaign(records.campaign())
    assert (tmp_path / name).exists()
    with open_campaign(tmp_path / name) as campaign:
        assert campaign.record.name == "quick"


@pytest.mark.parametrize("folder", [0o555, 0o777])
def test_read_only_file(database: Path, records: "Records", folder: int) -> None:
    """One who may not write it can read and check it, and leaves no log that its owner could not use."""
    with tempfile.TemporaryDirectory() as name:
        copy = Path(shutil.copy(database, name))
        with open_campaign(copy) as campaign:  # imports all modules while they may be read
            assert list(campaign.select(seed=0)) == [records.done(0)]
            assert campaign.store.damage() == []
        copy.chmod(0o444)
        copy.parent.chmod(folder)
        if os.geteuid() == 0:
            os.seteuid(NOBODY)  # permissions don't stop root
        try:
            with open_campaign(copy) as campaign:
                found = list(campaign.select(seed=0))
                assert campaign.store.damage() == []
                os.seteuid(os.getuid())
                with copy.open("r+b") as file:
                    file.seek(-4096, os.SEEK_END)
                    file.write(os.urandom(4096))
                if os.geteuid() == 0:
                    os.seteuid(NOBODY)
                assert find_damage(copy, "integrity_check")
        finally:
            os.seteuid(os.getuid())
            copy.parent.chmod(0o755)
        assert list(copy.parent.iterdir()) == [copy]
    assert found == [records.done(0)]


def test_a_file_that_cannot_be_checked_is_not_called_sound(tmp_path: Path) -> None:
    """What keeps SQLite from reading it is told."""
    with pytest.raises(StoreUnavailableError, match="unable to open"):
        find_damage(tmp_path / "none.db")
    (tmp_path / "text.db").write_text("no database")
    with pytest.raises(ForeignDatabaseError, match="not a database"):
        find_damage(tmp_path / "text.db")


@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small disk needs root")
def test_a_database_on_a_full_disk_can_be_read(database: Path, records: "Records", tmp_path: Path) -> None:
    """As one has to, to bring it to another disk."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", disk], check=False).returncode:  # noqa: S607
        pytest.skip("no disk can be mounted here")
    try:
        copy = Path(shutil.copy(database, disk))
        with suppress(OSError), (disk / "rest").open("wb", buffering=0) as file:
            while file.write(b"x" * 4096):
                pass
        with open_campaign(copy) as campaign:
            assert list(campaign.select(seed=0)) == [records.done(0)]
            assert campaign.store.damage() == []
    finally:
        subprocess.run(["umount", disk], check=True)  # noqa: S607


@pytest.mark.parametrize("table", ["attempt", "lease", "result"])
def test_a_database_without_a_table_is_damaged(database: Path, table: str) -> None:
    """As after the recovery of a damaged file."""
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("DROP VIEW cells")
        connection.execute(f"DROP TABLE {table}")
    with pytest.raises(DamagedStoreError, match=f"lacks the table {table}"):
        open_campaign(database)


def test_a_server_that_hangs_up_while_the_database_is_opened_is_no_bad_input(
    postgresql_template: str, postgresql_socket: Path
) -> None:
    """A connection that breaks may come back, other than a name that is wrong: the same command continues."""
    url = f"postgresql+psycopg://postgres@/{postgresql_template}?host={postgresql_socket}"
    wait = "SELECT pid FROM pg_locks WHERE locktype = 'advisory' AND NOT granted"
    with create_engine(url).connect() as holder, ThreadPoolExecutor(1) as thread:
        holder.execute(text("SELECT pg_advisory_lock(1667329123)"))
        opening = thread.submit(Store, url)
        while not (waiting := holder.scalar(text(wait))):
            holder.rollback()
        holder.execute(text(f"SELECT pg_terminate_backend({waiting})"))
        with pytest.raises(StoreInterruptedError) as caught:
            opening.result()
    assert _exit_code_of(caught.value) == EXIT_RESUMABLE


def test_errors_can_travel(database: Path) -> None:
    """Errors of the store survive pickling, with problem and cure."""
    import pickle  # noqa: PLC0415 - only this test needs it, on its own data

    error = pickle.loads(pickle.dumps(StoreError("No.", "Do this.")))  # noqa: S301 - own data
    assert (error.problem, error.cure, str(error)) == ("No.", "Do this.", "No. Do this.")
    assert database.exists()


def test_a_disk_that_fills_up_replaces_no_database(database: Path) -> None:
    """SQLite closes a database without a word if its log did not fit into the file; the log would be lost."""
    before = database.read_bytes()

    def fill() -> None:
        with replace_database(database) as temporary:
            shutil.copy(database, temporary)
            Path(f"{temporary}-wal").write_bytes(b"the last transactions")

    with pytest.raises(DiskError, match="Free some space"):
        fill()
    assert database.read_bytes() == before
    assert [path.name for path in database.parent.iterdir()] == [database.name]


@pytest.mark.parametrize("mode", [0o600, 0o664])
def test_a_replaced_file_keeps_its_permissions(database: Path, mode: int) -> None:
    """A group can go on writing, and a private database stays private."""
    content = database.read_bytes()
    database.chmod(mode)
    with replace_database(database) as temporary:
        temporary.write_bytes(content)
    assert stat.S_IMODE(database.stat().st_mode) == mode


def test_only_a_database_with_a_log_is_read_without_locks(database: Path) -> None:
    """Where a reader cannot write: one with a journal, as on network file systems, is read under locks."""
    assert engine._needs_a_log(database)
    Path(f"{database}-wal").touch()
    assert not engine._needs_a_log(database)
    Path(f"{database}-wal").unlink()
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("PRAGMA journal_mode=DELETE")
    assert not engine._needs_a_log(database)


def test_texts_that_are_no_unicode_are_stored(database: Path) -> None:
    """Names of files on the command line and in reasons may have any bytes."""
    strange = os.fsdecode(b"caf\xe9\0.toml")
    with Store(database) as store:
        store.use_campaign()
        key = CellKey(2, 5.0)
        store.record_results([CellResult(key, CellStatus.FAILED, strange)])
        number = store.begin_run(RunRecord({}, "here", "some CPU", 1, strange, datetime.now(UTC)))
        assert dict(store.runs())[number].launch_line == r"caf\udce9\0.toml"
        (found,) = (one for one in store.results() if one.key == key)
    assert found.reason == r"caf\udce9\0.toml"


def test_two_first_runs_at_once_on_a_server_share_a_campaign(postgresql_database: str, records: "Records") -> None:
    """The second waits for the first, and then continues what that has begun; one of them gets the lease."""
    begins = Barrier(2, timeout=20.0)

    def begin(_: int) -> bool:
        with Store(postgresql_database) as store:
            begins.wait()
            store.begin_campaign(records.campaign())
            begins.wait()
            with suppress(LeaseHeldError):
                store.acquire_lease()
            begins.wait()
            return store._lease.token is not None

    with ThreadPoolExecutor(2) as threads:
        assert sorted(threads.map(begin, range(2))) == [False, True]


def test_a_reader_without_locks_notices_a_writer(
    database: Path, records: "Records", monkeypatch: pytest.MonkeyPatch
) -> None:
    """One who may not write the folder reads a closed database without locks, until its owner goes on."""
    monkeypatch.setattr(engine.os, "access", lambda *_, **__: False)
    with Store(database, read_only=True) as reader:
        reader.use_campaign()
        assert len(list(reader.results())) == 2
        with Store(database) as writer:
            writer.use_campaign()
            for count, seed in enumerate((2, 3), start=3):
                writer.record_results([records.done(seed)])
                assert len(list(reader.results())) == count
        assert len(list(reader.results())) == 4
        with pytest.raises(StoreLockedError, match="was written while it was read"):
            read_while_written(reader, database, records)


def read_while_written(reader: Store, database: Path, records: "Records") -> None:
    """Store a cell within a transaction of a reader."""
    with reader._reading() as connection, Store(database) as writer:
        connection.scalar(text("SELECT count(*) FROM cell"))
        writer.use_campaign()
        writer.record_results([records.done(1, 0.3)])
