"""What was changed behind the store's back is an outcome of its cell, and never taken for what was stored."""

import sqlite3
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import xarray as xr

from calcidem.app.campaign.opened import open_campaign
from calcidem.storage.errors import CampaignMismatchError, DamagedStoreError
from calcidem.storage.netcdf.export import export_netcdf
from calcidem.storage.netcdf.import_netcdf import import_netcdf
from calcidem.storage.records import STATUS_CODES, CellKey, CellStatus
from calcidem.storage.sql.store import Store

if TYPE_CHECKING:
    from conftest import Records

BAD, GOOD = CellKey(1, 5.0), CellKey(2, 5.0)
CELL_ID = "(SELECT id FROM cell WHERE seed = 1 AND content = 5.0)"


@pytest.fixture
def database(tmp_path: Path, records: "Records") -> Path:
    """Create a closed database with a packing, and two cells that have everything."""
    path = tmp_path / "one.db"
    with Store(path) as store:
        store.begin_campaign(records.campaign())
        store.save_packing(records.packing(content_hash="it"))
        store.begin_run(records.run())
        store.record_results([records.with_arrays(seed) for seed in (1, 2)])
    return path


def execute(path: Path, statement: str) -> None:
    """Run a statement behind the store's back."""
    with sqlite3.connect(path, isolation_level=None) as connection:
        connection.execute("PRAGMA ignore_check_constraints=ON")
        connection.execute(statement)
    connection.close()


def change(table: str, column: str, value: str, key: str = "cell_id") -> str:
    """Statement that changes one column of the cell's row."""
    return f"UPDATE {table} SET {column} = {value} WHERE {key} = {CELL_ID}"  # noqa: S608 - a test's own


BRIEF = [
    change("result", column, value)
    for column, value in (
        ("vs", "vs * (1 + 1e-15)"),
        ("status", "'unstable'"),
        ("expected_error", "'text'"),
        ("brief_checksum", "NULL"),
    )
]
NUMBERS = [
    change("result", column, value)
    for column, value in (
        ("steps", "steps + 1"),
        ("vs_first_arrival", "1000.0"),
        ("broken_bonds", "NULL"),
        ("packing_index", "1"),
        ("path_connectivity", "2.67"),
        ("graph_components", "5"),
        ("retry", "CAST(x'ff00' AS TEXT)"),
        ("checksum", "NULL"),
        ("checksum", "'unchecked'"),
        ("arrays", "replace(arrays, 'section:', 'section:1')"),
    )
]
SECTION, CEMENT, PATH = (f"{CELL_ID} AND name = '{name}'" for name in ("section", "cement", "path"))
ARRAYS = [
    f"UPDATE arrays SET content = substr(content, 1, 20) || x'00' || substr(content, 22) WHERE cell_id = {SECTION}",  # noqa: S608 - a test's own
    f"UPDATE arrays SET content = x'' WHERE cell_id = {CEMENT}",  # noqa: S608 - as above
    f"UPDATE arrays SET content = 'text' WHERE cell_id = {PATH}",  # noqa: S608 - as above
    f"UPDATE arrays SET cell_id = {CELL_ID} + 1000 WHERE cell_id = {CEMENT}",  # noqa: S608 - as above
    f"DELETE FROM arrays WHERE cell_id = {SECTION}",  # noqa: S608 - as above
]
UNREADABLE_ATTEMPT = change("attempt", "recorded", "'yesterday'")
PARTS = [change("attempt", "host", "'node8'"), UNREADABLE_ATTEMPT]


@pytest.mark.parametrize("statement", BRIEF + NUMBERS + PARTS + ARRAYS)
def test_a_changed_cell_is_damaged_and_others_are_not(database: Path, records: "Records", statement: str) -> None:
    """Whatever is changed of a cell, it is named, and made anew on request."""
    execute(database, statement)
    with open_campaign(database) as campaign:
        damaged = campaign.cell(seed=1, content=5.0)
        assert (damaged.status, damaged.vs, damaged.section) == (CellStatus.DAMAGED, None, None)
        assert campaign.cell(seed=2, content=5.0) == records.with_arrays(2)
        damaged, others = campaign.store.integrity()
        assert set(damaged) == {BAD}
        assert ("An attempt at a cell is not what was stored." in others) == (statement == UNREADABLE_ATTEMPT)
        with pytest.raises(DamagedStoreError, match=r"seed 1 and content 5\.0 .*--retry damaged"):
            campaign.section(seed=1, content=5.0)
        if statement in BRIEF + NUMBERS:
            assert (
                campaign.store.table(("seed", "content", "status", "coherence"))["status"].tolist().count("damaged")
                == 1
            )
            assert [c.key for c in campaign.select(where="vs > 0")] == [GOOD]
            assert [c.key for c in campaign.select(status="damaged")] == [BAD]
        is_seen_at_once = statement in BRIEF
        assert (campaign.store.statuses()[BAD] is CellStatus.DAMAGED) == is_seen_at_once
        if is_seen_at_once:
            assert campaign.status_counts()[5.0, CellStatus.DAMAGED] == 1
            assert campaign.vs().sel(seed=1, content=5.0).isnull()
    with Store(database) as store:
        store.use_campaign()
        store.retry_damaged([BAD])
        assert BAD in store.pending()
        store.record_results([records.with_arrays(1)])
        assert list(store.results(with_arrays=True)) == [records.with_arrays(seed) for seed in (1, 2)]
        assert not store.integrity()[0]


@pytest.mark.parametrize("statement", [BRIEF[0], UNREADABLE_ATTEMPT, ARRAYS[0]])
def test_a_damaged_cell_is_exported_as_missing(
    database: Path, tmp_path: Path, records: "Records", statement: str
) -> None:
    """Its flag and its reason are in the file, all other cells are, and whoever imports it has the cell to compute."""
    execute(database, statement)
    with open_campaign(database) as campaign:
        exported = export_netcdf(campaign.store, tmp_path / "out.nc")
    with Store(tmp_path / "again.db") as again:
        import_netcdf(exported, again)
        assert BAD in again.pending()
        assert list(again.results(with_arrays=True)) == [records.with_arrays(2)]
    with xr.open_dataset(exported) as dataset:
        cell = dataset.sel(seed=1, content=5.0)
        assert int(cell["status"]) == STATUS_CODES[CellStatus.DAMAGED]
        assert np.isnan([float(cell["vs"]), float(cell["steps"])]).all()
        assert str(cell["reason"].values)
        assert float(dataset["vs"].sel(seed=2, content=5.0)) == records.with_arrays(2).vs


def test_provenance_and_configuration_are_checked(database: Path) -> None:
    """A changed run is said to be damaged and blocks nothing; a changed configuration is refused."""
    execute(database, "UPDATE run SET host = 'elsewhere'")
    with open_campaign(database) as campaign:
        (_, run), *_ = campaign.runs()
        assert (run.host, run.exit_state) == ("", "damaged: what was stored of this run was changed")
        assert any("Run 1" in line for line in campaign.store.integrity()[1])
        assert campaign.store.integrity()[0] == {}
    execute(database, "UPDATE campaign SET config = replace(config, '0.2', '0.3')")
    with pytest.raises(DamagedStoreError, match="configuration"):
        open_campaign(database)


@pytest.mark.parametrize("column", ["grains", "state", "width", "wall_stress"])
def test_a_damaged_packing_gives_way_to_the_same_one(database: Path, records: "Records", column: str) -> None:
    """It is refused; one of its content hash takes its place, and no other."""
    execute(database, f"UPDATE packing SET {column} = '0.2'")  # noqa: S608 - a test's own
    with Store(database) as store:
        store.use_campaign()
        with pytest.raises(DamagedStoreError):
            store.packing()
        assert any("Packing 0" in line for line in store.integrity()[1])
        with pytest.raises((CampaignMismatchError, DamagedStoreError)):
            store.save_packing(records.packing(content_hash="another"), replace_state=True)
        store.save_packing(records.packing(content_hash="it"), replace_state=True)
        assert store.packing() == records.packing(content_hash="it")


def test_arrays_that_are_not_asked_for_are_not_judged(database: Path, records: "Records") -> None:
    """A cell whose section is damaged gives its path; whoever asks for the section learns that it is damaged."""
    execute(database, f"UPDATE arrays SET content = x'' WHERE cell_id = {SECTION}")  # noqa: S608 - a test's own
    with Store(database, read_only=True) as store:
        store.use_campaign()
        found = {result.key: result for result in store.results(with_arrays=("path",))}
        assert found[BAD].path == records.with_arrays(1).path
        assert found[BAD].section is None
        damaged = {result.key for result in store.results(with_arrays=("path", "section")) if result.section is None}
        assert damaged == {BAD}
        assert [key for key, arrays in store.arrays() if isinstance(arrays, str)] == [BAD]
