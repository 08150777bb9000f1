"""A database is one file, whatever it is called, and one process writes it; what a dead one left is not replayed."""

import os
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from unittest import mock

import pytest
from forked import ForkedProgram

from calcidem.app.campaign.merge import merge_databases
from calcidem.app.cli.exchange import _import_campaign
from calcidem.storage.errors import (
    DamagedStoreError,
    LeaseHeldError,
    OutputRefusedError,
    StoreError,
    StoreUnavailableError,
)
from calcidem.storage.netcdf import export_netcdf
from calcidem.storage.records import LeaseHolder, start_of, this_machine
from calcidem.storage.sql import reading
from calcidem.storage.sql.engine import find_damage
from calcidem.storage.sql.lease import Lease, replace_database
from calcidem.storage.sql.store import Store

if TYPE_CHECKING:
    from conftest import Records

WRITER = Path(__file__).parent / "programs" / "writer.py"


@pytest.fixture
def source(tmp_path: Path, records: "Records") -> Path:
    """Create a database of three cells in a folder of its own."""
    path = tmp_path / "source" / "a.db"
    path.parent.mkdir()
    with Store(path) as store:
        store.begin_campaign(records.campaign())
        store.save_packing(records.packing())
        store.record_results([records.done(seed) for seed in range(3)])
    return path


@pytest.fixture
def target(tmp_path: Path) -> Path:
    """Name of a database in an empty folder."""
    (tmp_path / "target").mkdir()
    return tmp_path / "target" / "r.db"


@pytest.fixture
def start_writer(target: Path) -> Iterator[Callable[[], ForkedProgram]]:
    """Start a process that writes the target, and return once it has stored cells; ended with the test."""
    started: list[ForkedProgram] = []

    def start() -> ForkedProgram:
        process = ForkedProgram(WRITER, str(target), "5000")
        started.append(process)
        for _ in range(4):
            assert process.stdout.readline()
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()


def import_of(source: Path, target: Path) -> None:
    """Export a database and import the file; the state of its packing is none."""
    with Store(source, read_only=True) as store:
        store.use_campaign()
        file = export_netcdf(store, source.with_suffix(".nc"))
    with mock.patch("calcidem.app.campaign.packing.stored_packing"):
        _import_campaign(file, str(target))


def merge_of(source: Path, target: Path) -> None:
    """Merge one database into the target."""
    merge_databases([str(source)], target)


@pytest.mark.parametrize("make", [import_of, merge_of])
def test_a_dead_runs_log_is_not_replayed_into_another_database(
    source: Path,
    target: Path,
    start_writer: Callable[[], ForkedProgram],
    make: Callable[[Path, Path], None],
) -> None:
    """Kill a run, remove its database, and make another one in its place: it is intact, and nothing else is there."""
    process = start_writer()
    process.kill()
    process.wait()
    target.unlink()
    assert Path(f"{target}-wal").stat().st_size > 0
    make(source, target)
    assert find_damage(target, "integrity_check") == []
    with Store(target, read_only=True) as store:
        store.use_campaign()
        assert len(list(store.results())) == 3
    assert [path.name for path in target.parent.iterdir()] == [target.name]


@pytest.mark.parametrize("make", [import_of, merge_of])
def test_a_database_that_a_run_makes_meanwhile_is_kept(
    source: Path,
    target: Path,
    records: "Records",
    monkeypatch: pytest.MonkeyPatch,
    make: Callable[[Path, Path], None],
) -> None:
    """While a database is made, a run cannot begin one of that name; a file that appears there is never replaced."""
    original = Store.record_results

    def store_and_look(store: Store, *arguments: object, **options: object) -> int:
        with pytest.raises(LeaseHeldError):
            Store(target)
        assert not target.exists()
        shutil.copy(source, target)  # by another program
        return original(store, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(Store, "record_results", store_and_look)
    monkeypatch.setattr(time, "sleep", lambda _: monkeypatch.setattr(time, "monotonic", lambda: 1e18))
    with pytest.raises(OutputRefusedError, match="meanwhile"):
        make(source, target)
    monkeypatch.undo()
    assert target.read_bytes() == source.read_bytes()
    with Store(target) as store:
        store.use_campaign()
        assert store.record_results([records.done(3)]) == 1


def test_a_database_in_use_is_not_merged_into(
    source: Path, target: Path, start_writer: Callable[[], ForkedProgram]
) -> None:
    """A living run's database is not replaced."""
    start_writer()
    with pytest.raises(LeaseHeldError):
        merge_of(source, target)


def test_a_second_name_of_a_file_is_refused(source: Path) -> None:
    """A hard link would have a log and a lock of its own: nobody may write under either name, and all may read."""
    other = source.with_name("other.db")
    other.hardlink_to(source)
    before = source.read_bytes()
    for name in (source, other):
        with pytest.raises(StoreUnavailableError, match="2 names"):
            Store(name)
        Store(name, read_only=True).close()
    assert source.read_bytes() == before


def test_a_link_to_a_database_in_use_is_that_database(source: Path, tmp_path: Path) -> None:
    """Under a symbolic link the lock is the same, and the living master stays."""
    link = tmp_path / "link.db"
    link.symlink_to(source)
    with Store(source) as first, Store(link) as second:
        first.use_campaign()
        second.use_campaign()
        assert second.address.path == source
        first.acquire_lease()
        with pytest.raises(LeaseHeldError):
            second.acquire_lease()
        first.renew_lease()
    assert not Path(f"{link}.lock").exists()


def test_a_loop_of_links_is_no_database(tmp_path: Path) -> None:
    """It is refused with a remedy."""
    (tmp_path / "a.db").symlink_to(tmp_path / "b.db")
    (tmp_path / "b.db").symlink_to(tmp_path / "a.db")
    with pytest.raises(StoreError):
        Store(tmp_path / "a.db")


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({"machine": "another container"}, id="container of that host name"),
        pytest.param({"machine": this_machine().partition(" ")[0] + " pid:[1]", "lock": "1:1"}, id="same kernel"),
    ],
)
def test_a_master_that_cannot_be_seen_lives_until_it_is_silent(
    open_here: Callable[..., Store], records: "Records", changes: dict[str, str]
) -> None:
    """One host name is not one machine: the number of a process says nothing in another container, on any backend."""
    store = open_here()
    store.begin_campaign(records.campaign())
    store.acquire_lease()
    holder = store.lease_holder()
    assert holder is not None
    elsewhere = replace(holder, pid=2**22 + 1, started="1", **changes)
    assert elsewhere.host == socket.gethostname()
    assert elsewhere.may_live()
    with store._writing() as connection:
        columns = ", ".join(f"{name} = '{getattr(elsewhere, name)}'" for name in ("pid", "machine", "started", "lock"))
        connection.exec_driver_sql(f"UPDATE lease SET token = 'other', {columns}")  # noqa: S608 - a test's own
    store._lease.token = None
    store._lease.forget()
    store._lease.release()
    other = open_here()
    other.use_campaign()
    with pytest.raises(LeaseHeldError, match=f"process {2**22 + 1}"):
        other.acquire_lease()


def test_a_process_is_known_by_its_start() -> None:
    """A number that is used again is another process; a zombie has ended."""
    holder = LeaseHolder.of_this_process("")
    assert holder.is_here()
    assert holder.may_live()
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    assert int(start_of(child.pid)) >= int(start_of(os.getpid()))
    child.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 10.0
    while start_of(child.pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert start_of(child.pid) == ""  # dead, though nobody has waited for it
    child.wait()


@pytest.mark.parametrize("kind", ["symlink", "pipe", "folder", "hard link", "foreign"])
def test_a_lock_file_of_somebody_else_is_left_alone(source: Path, tmp_path: Path, kind: str) -> None:
    """What is not a lock file of calcidem is neither followed, waited for, emptied nor removed."""
    lock, precious = Path(f"{source}.lock"), tmp_path / "precious"
    precious.write_text("calcidem is nice")
    if kind == "symlink":
        lock.symlink_to(precious)
    elif kind == "pipe":
        os.mkfifo(lock)
    elif kind == "folder":
        lock.mkdir()
    elif kind == "hard link":
        lock.hardlink_to(precious)
    else:
        lock.write_text("not a lock")
    with Store(source) as store:
        store.use_campaign()
        with pytest.raises(StoreUnavailableError, match=r"a\.db\.lock"):
            store.acquire_lease()
        assert store.damage() == []
    assert precious.read_text() == "calcidem is nice"
    assert lock.exists()
    assert Lease(source).acknowledged() is None


@pytest.mark.parametrize("length", [248, 252, 255])
def test_a_name_too_long_leaves_nothing(tmp_path: Path, length: int) -> None:
    """A name without room for the endings of SQLite's files is refused before anything is made."""
    path = tmp_path / ("x" * (length - 3) + ".db")
    with pytest.raises(StoreUnavailableError, match="at most 247 bytes"):
        Store(path)
    assert list(tmp_path.iterdir()) == []
    with Store(tmp_path / ("x" * 247)) as store:
        assert store.campaigns() == ()


def test_a_log_that_is_cut_off_during_a_run_is_found_at_its_end(target: Path, records: "Records") -> None:
    """The check at the end of a run does not take a malformed file for a good one."""
    with Store(target) as store:
        store.begin_campaign(records.campaign(seeds=tuple(range(200))))
        store._next_checkpoint = float("inf")
        for seed in range(100):
            store.record_results([records.with_arrays(seed)])
        store.refuse_damaged()
        os.truncate(f"{target}-wal", 0)
        with pytest.raises(StoreError):
            store_and_check(store, records)


def store_and_check(store: Store, records: "Records") -> None:
    """End a run as the command does."""
    for seed in range(100, 200):
        store.record_results([records.with_arrays(seed)])
    store._bring_log_into_file()
    store.refuse_damaged()


def test_a_failed_creation_leaves_nothing(target: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither database, lock, log nor temporary file stays."""

    def fail(*_: object, **__: object) -> None:
        raise OSError("no space")

    monkeypatch.setattr(reading, "prepare_schema", fail)
    with pytest.raises(OSError, match="no space"):
        Store(target)
    assert list(target.parent.iterdir()) == []


def test_a_replaced_database_was_not_in_use(source: Path, target: Path) -> None:
    """Only what was there at the beginning is replaced."""
    shutil.copy(source, target)
    making = replace_database(target)
    shutil.copy(source, making.__enter__())
    target.unlink()
    with pytest.raises(OutputRefusedError, match="meanwhile"):
        making.__exit__(None, None, None)
    assert list(target.parent.iterdir()) == []


def test_a_merge_into_its_own_result_goes_on(source: Path, target: Path, records: "Records") -> None:
    """Given again, the same command adds what is new, and keeps what is there; another campaign is refused."""
    merge_of(source, target)
    with Store(source) as store:
        store.use_campaign()
        store.record_results([records.done(3)])
    merged = merge_databases([str(source)], target)
    assert (merged.settled, merged.sources) == (4, (str(target), str(source)))
    with Store(target) as store:
        store.use_campaign()
        assert len(list(store.results())) == 4
        assert len(list(store.history())) == 4
        store.begin_campaign(records.campaign({"other": 1}, name="other"))
    before = target.read_bytes()
    with pytest.raises(FileExistsError, match="several campaigns"):
        merge_databases([str(source)], target, campaign_name="quick")
    assert target.read_bytes() == before
    assert [path.name for path in target.parent.iterdir()] == [target.name]


def test_who_waited_while_a_database_was_made_does_not_replace_it(
    tmp_path: Path, source: Path, records: "Records"
) -> None:
    """Two runs that begin at the same time: the second is refused, or sees what the first one stored."""
    path = tmp_path / "both.db"
    lease = Lease(path)
    assert lease.acquire()  # the first one makes it
    with ThreadPoolExecutor(1) as other:
        opened = other.submit(Store, path)
        time.sleep(0.3)  # so that the second waits; if it is not there yet, it only opens what it finds
        path.write_bytes(source.read_bytes())
        lease.release()
        if opened.exception(10.0) is None:
            opened.result().close()
        else:
            assert isinstance(opened.exception(), OutputRefusedError)
    with Store(path, read_only=True) as store:
        assert [campaign.name for campaign in store.campaigns()] == [records.campaign().name]


def test_a_database_without_a_campaign_is_merged_into(source: Path, target: Path) -> None:
    """A run that was killed at its start leaves one; a run and an import go on with it, too."""
    Store(target).close()
    assert merge_databases([str(source)], target).sources == (str(source),)
    with Store(target) as store:
        assert [campaign.name for campaign in store.campaigns()] == ["quick"]


def test_a_damaged_target_is_not_merged(source: Path, target: Path) -> None:
    """The target's own cells are read first; if they cannot be, it stays as it is."""
    merge_of(source, target)
    with sqlite3.connect(target) as connection:
        ((page,),) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'result'").fetchall()
    connection.close()
    with target.open("r+b") as file:
        file.seek((page - 1) * 4096)
        file.write(os.urandom(4096))
    before = target.read_bytes()
    with pytest.raises(DamagedStoreError, match=str(target)):
        merge_of(source, target)
    assert target.read_bytes() == before
