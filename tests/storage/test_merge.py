"""What a merge keeps: a target loses nothing to a source, whatever this lacks or has forgotten."""

import os
import subprocess
import sys
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from calcidem.app.campaign.merge import merge_databases
from calcidem.ends import CellStatus
from calcidem.storage.errors import StoreUnavailableError
from calcidem.storage.netcdf import export_netcdf, import_netcdf
from calcidem.storage.records import ARRAY_RECORDS, CellKey
from calcidem.storage.sql.store import Store, read_campaign

if TYPE_CHECKING:
    from conftest import Records

KEY = CellKey(0, 5.0)


def made(path: Path, records: "Records") -> Store:
    """Store with the campaign, its packing and a run that has begun."""
    store = Store(path)
    store.begin_campaign(records.campaign())
    store.save_packing(records.packing())
    store.begin_run(records.run())
    return store


def copied(source: Path, target: Path) -> Path:
    """Copy a database that nobody writes."""
    target.write_bytes(source.read_bytes())
    return target


@pytest.mark.parametrize("is_named", [False, True])
def test_a_source_without_arrays_takes_none_from_the_target(is_named: bool, tmp_path: Path, records: "Records") -> None:
    """An export without them, imported elsewhere and merged back, whether or not the target is among the sources."""
    target, slim = tmp_path / "all.db", tmp_path / "slim.db"
    with made(target, records) as store:
        store.record_results([replace(records.done(0), static_speed=500.0)])
        export_netcdf(store, tmp_path / "slim.nc", without=tuple(ARRAY_RECORDS))
    with Store(slim) as store:
        import_netcdf(tmp_path / "slim.nc", store)
    with read_campaign(target) as store:
        before = list(store.results(with_arrays=True))
    merge_databases([str(slim), str(target)] if is_named else [str(slim)], target)
    with read_campaign(target) as store:
        assert list(store.results(with_arrays=True)) == before


def test_an_older_copy_takes_no_later_outcome_away(tmp_path: Path, records: "Records") -> None:
    """A cell that was tried again in the target keeps the outcome of its last attempt."""
    live = tmp_path / "live.db"
    with made(live, records) as store:
        store.record_results([records.failed(0)])
    old = copied(live, tmp_path / "old.db")
    with Store(live) as store:
        store.use_campaign()
        store.retry()
        store.begin_run(records.run(started=records.run().started + timedelta(days=1)))
        store.record_results([replace(records.failed(0, attempt=2), status=CellStatus.QUARANTINED, reason="deadly")])
    merge_databases([str(old)], live)
    with read_campaign(live) as store:
        found = store.cell(seed=0, content=5.0)
        assert (found.status, found.attempt) == (CellStatus.QUARANTINED, 2)


@pytest.mark.parametrize("order", [("a.db", "b.db"), ("b.db", "a.db")])
def test_what_a_retry_forgave_stays_forgiven(order: tuple[str, str], tmp_path: Path, records: "Records") -> None:
    """In whichever copy the retry was, and in whatever order they are given."""
    begun = records.run().started
    with made(tmp_path / "a.db", records) as store:
        store.record_running([KEY])
    with Store(tmp_path / "a.db") as store:
        store.use_campaign()
        store.begin_run(records.run(started=begun + timedelta(hours=1)))  # which finds that the first one has died
        assert store.attempt_counts([KEY])[KEY].losses == 1
    copied(tmp_path / "a.db", tmp_path / "b.db")
    with Store(tmp_path / "b.db") as store:
        store.use_campaign()
        store.begin_run(records.run(started=begun + timedelta(hours=2)))
        store.record_results([records.failed(0, attempt=2)])
        store.retry()
    merge_databases([str(tmp_path / name) for name in order], tmp_path / "all.db")
    with read_campaign(tmp_path / "all.db") as store:
        assert store.attempt_counts([KEY])[KEY].losses == 0


def test_a_disk_that_fills_up_at_the_end_costs_no_log(
    tmp_path: Path, records: "Records", monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a killed writer has left in the log of the target is there after a merge that failed."""
    made(tmp_path / "part.db", records).close()
    made(tmp_path / "all.db", records).close()
    program = f"""
import os, sys
sys.path[:0] = {[str(Path(__file__).parent), *sys.path]!r}
from conftest import Records
from calcidem.storage.sql.store import Store
store = Store({str(tmp_path / "all.db")!r})
store.use_campaign()
store.begin_run(Records().run())
store.record_results([Records().done(0)])
os._exit(0)
"""
    subprocess.run([sys.executable, "-c", program], check=True)
    with read_campaign(tmp_path / "all.db") as reader:  # as long as one reads, the log is not emptied
        assert reader.settled() == 1

        def refuse(_descriptor: int) -> None:
            raise OSError(122, "Disk quota exceeded")

        monkeypatch.setattr(os, "fsync", refuse)
        with pytest.raises(OSError, match="quota"):
            merge_databases([str(tmp_path / "part.db")], tmp_path / "all.db")
        monkeypatch.undo()
    with read_campaign(tmp_path / "all.db") as store:
        assert store.settled() == 1


def test_an_export_beside_a_run_has_the_attempt_of_each_cell(
    tmp_path: Path, records: "Records", monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cells that are stored while it is written come with their attempts, or not at all."""
    with made(tmp_path / "a.db", records) as writer, read_campaign(tmp_path / "a.db") as reader:
        writer.record_results([records.done(1)])
        history = reader.history

        def read_and_go_on(*arguments: object) -> object:
            found = list(history(*arguments))  # type: ignore[arg-type]
            writer.record_results([records.done(0)])
            return iter(found)

        monkeypatch.setattr(reader, "history", read_and_go_on)
        export_netcdf(reader, tmp_path / "a.nc")
    with Store(tmp_path / "b.db") as store:
        import_netcdf(tmp_path / "a.nc", store)
        attempted = {attempt.key for attempt in store.history()}
        assert {result.key for result in store.results()} == attempted == {CellKey(1, 5.0)}


def test_who_reads_a_database_that_a_merge_replaced_is_told(tmp_path: Path, records: "Records") -> None:
    """An open campaign does not show former cells as the present ones."""
    for number, name in enumerate(("a.db", "b.db")):
        with made(tmp_path / name, records) as store:
            store.record_results([records.done(number)])
    with read_campaign(tmp_path / "a.db") as reader:
        assert reader.settled() == 1
        merge_databases([str(tmp_path / "b.db")], tmp_path / "a.db")
        with pytest.raises(StoreUnavailableError, match=r"was replaced by another file.* Open it again"):
            reader.settled()
    with read_campaign(tmp_path / "a.db") as reader:
        assert reader.settled() == 2


def test_runs_are_told_in_the_order_of_their_beginning(tmp_path: Path, records: "Records") -> None:
    """One that came later by an import, but began before, is not the latest."""
    with made(tmp_path / "a.db", records) as store:
        store.begin_run(records.run(host="old", started=records.run().started - timedelta(days=1)))
        assert [run.host for _, run in store.runs()] == ["old", records.run().host]
