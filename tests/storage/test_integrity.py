"""SQLite itself finds a damaged file; it is named, read as far as possible, and never written to."""

import os
import sqlite3
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from calcidem.app.campaign.opened import open_campaign
from calcidem.storage.errors import DamagedStoreError
from calcidem.storage.sql.store import Store

if TYPE_CHECKING:
    from conftest import Records


@pytest.fixture
def database(tmp_path: Path, records: "Records") -> Path:
    """Create a closed database with a packing, and twelve cells that have everything."""
    path = tmp_path / "one.db"
    with Store(path) as store:
        store.begin_campaign(records.campaign())
        store.save_packing(records.packing())
        store.begin_run(records.run())
        store.record_results([records.with_arrays(key.seed, key.content) for key in store.pending()])
    return path


def damage(path: Path, table: str = "result") -> None:
    """Overwrite a table's first page."""
    with sqlite3.connect(path) as connection:
        ((page,),) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", (table,)).fetchall()
        ((size,),) = connection.execute("PRAGMA page_size").fetchall()
    connection.close()
    with path.open("r+b") as file:
        file.seek((page - 1) * size)
        file.write(os.urandom(size))


@pytest.mark.parametrize("left", ["-wal", "-journal", ".lock"])
def test_a_file_that_was_left_open_is_checked_before_it_is_written(database: Path, left: str) -> None:
    """What a killed process leaves beside it leads to a check; a damaged file is named and stays as it is."""
    damage(database)
    Path(f"{database}{left}").write_bytes(b"calcidem rest of a killed process")
    before = database.read_bytes()
    with pytest.raises(DamagedStoreError, match=rf"{database} is damaged: .*'calcidem import' an earlier export"):
        Store(database)
    assert database.read_bytes() == before


def test_an_intact_file_that_was_left_open_is_taken(database: Path, records: "Records") -> None:
    """The check lets an intact file pass."""
    Path(f"{database}.lock").write_text("calcidem")
    with Store(database) as store:
        assert store.use_campaign() == records.campaign()
        assert store.damage() == []
        store.refuse_damaged()


def test_reading_a_damaged_file_names_it(database: Path) -> None:
    """A reader learns which file is damaged and what helps, and a check tells what SQLite found."""
    damage(database)
    with open_campaign(database) as campaign:
        with pytest.raises(DamagedStoreError, match=rf"{database}: .*malformed.*'calcidem import' an earlier export"):
            campaign.vs()
        assert any(str(database) in line for line in campaign.store.damage())
        with pytest.raises(DamagedStoreError, match=str(database)):
            campaign.store.refuse_damaged()


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE arrays SET content = substr(content, 1, 60) || x'00' || substr(content, 62)",
        "UPDATE arrays SET content = x''",
        "UPDATE result SET retry = CAST(x'ff00' AS TEXT)",
        "UPDATE attempt SET recorded = 'yesterday'",
    ],
)
def test_a_stored_value_that_cannot_be_converted_is_damage(database: Path, statement: str) -> None:
    """Arrays have checks of their own, and texts and times a form: a changed one is refused, not taken for another."""
    with sqlite3.connect(database) as connection:
        connection.execute(statement)
    connection.close()
    with Store(database, read_only=True) as store:
        store.use_campaign()
        with pytest.raises(DamagedStoreError, match=str(database)):
            _ = [*store.results(with_arrays=True), *store.history()]
