"""Seeds of 63 bits, exactly, through every path; and filters that compare like with like."""

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import xarray as xr

from calcidem.app.campaign.merge import merge_databases
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.cli.output import Format, tell_rows
from calcidem.app.cli.results import as_rows
from calcidem.ends import CellStatus
from calcidem.storage.errors import QueryError
from calcidem.storage.netcdf import export_netcdf, import_netcdf
from calcidem.storage.records import LARGEST_SEED, CellKey, Selection
from calcidem.storage.sql.store import Store, read_campaign

if TYPE_CHECKING:
    from conftest import Records

SEEDS = (2**53 - 1, 2**53, 2**53 + 1, LARGEST_SEED - 1, LARGEST_SEED)
"""As floats the middle ones are one number, and so are the last ones."""


def check_seeds(path: Path, records: "Records") -> None:
    """Look at the seeds of a database in every way of reading it."""
    done = [CellKey(seed, 5.0) for seed in SEEDS[:-1]]
    with open_campaign(path) as campaign:
        assert campaign.record.seeds == SEEDS
        assert campaign.store.pending() == (CellKey(LARGEST_SEED, 5.0),)
        assert [key for key, status in campaign.store.statuses().items() if status is CellStatus.DONE] == done
        assert [cell.key for cell in campaign.select(status="done")] == done
        assert campaign.cell(seed=2**53 + 1, content=5.0) == records.done(2**53 + 1)
        assert [cell.key.seed for cell in campaign.select(where=f"seed == {2**53 + 1}")] == [2**53 + 1]
        assert campaign.to_xarray()["seed"].values.tolist() == list(SEEDS)
        assert campaign.vs()["seed"].values.tolist() == list(SEEDS)
        assert campaign.to_dataframe(["seed", "steps"])["seed"].tolist() == list(SEEDS)
        assert [attempt.key for attempt in campaign.store.history()] == done


def test_seeds_are_exact_on_every_path(tmp_path: Path, records: "Records") -> None:
    """Seeds next to 2^53 and 2^63 survive store, tables, NetCDF, import, merge and the text of a query."""
    database = tmp_path / "large.db"
    with Store(database) as store:
        store.begin_campaign(records.campaign(seeds=SEEDS, contents=(5.0,)))
        store.save_packing(records.packing())
        store.record_results([records.done(seed) for seed in SEEDS[:-1]])
        export_netcdf(store, tmp_path / "large.nc")
    check_seeds(database, records)
    with xr.open_dataset(tmp_path / "large.nc") as dataset:
        assert dataset["seed"].values.tolist() == list(SEEDS)
    with Store(tmp_path / "imported.db") as store:
        import_netcdf(tmp_path / "large.nc", store)
    check_seeds(tmp_path / "imported.db", records)
    merge_databases([str(database), str(tmp_path / "imported.db")], tmp_path / "merged.db")
    check_seeds(tmp_path / "merged.db", records)
    with read_campaign(database) as store:
        columns = store.table(("seed", "status"), Selection(seeds=(LARGEST_SEED,)))
    tell_rows(as_rows(columns), Format.JSON, tmp_path / "large.json")
    assert json.loads((tmp_path / "large.json").read_text()) == [{"seed": LARGEST_SEED, "status": "pending"}]


@pytest.mark.parametrize("seed", [-1, 2**63, 10**400, 1.5])
def test_seeds_beyond_the_range_are_refused(seed: int, records: "Records") -> None:
    """No key, selection or plan takes what the database could not keep; the message has the range."""
    for refuse in (
        lambda: CellKey(seed, 5.0),
        lambda: Selection(seeds=(seed,)),
        lambda: records.campaign(seeds=(seed,)),
    ):
        with pytest.raises(ValueError, match="0 to 2\\^63 - 1"):
            refuse()


def test_largest_seed_is_stored_on_every_backend(store: Store, records: "Records") -> None:
    """The largest seed comes back from each backend."""
    store.extend((LARGEST_SEED,), (5.0,))
    store.record_results([records.done(LARGEST_SEED)])
    assert list(store.results()) == [records.done(LARGEST_SEED)]
    assert CellKey(LARGEST_SEED, 5.0) in store.statuses()


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("status > 3", "which is text"),
        ("3 < status", "which is text"),
        ("vs == 'fast'", "which is text"),
        ("status in ('done', 4)", "which is text"),
        ("reason == vs", "which is text"),
        (" or ".join(["vs > 1"] * 300), "at most 200"),
        ("not " * 200 + "vs > 1", "at most 50 deep"),
        ("vs > " + "9" * 5000, "can't be read"),
    ],
)
def test_filters_that_mean_nothing_are_refused(store: Store, where: str, message: str) -> None:
    """A word is not compared with a number, on any backend, and filters are of a size that databases take."""
    with pytest.raises(QueryError, match=message):
        store.table(("seed",), Selection(where=where))


@pytest.mark.parametrize(("where", "cells"), [("seed < 1" + "0" * 400, 3), ("vs > -1" + "0" * 400, 1), ("1 < 2", 3)])
def test_huge_numbers_compare_as_infinite(store: Store, records: "Records", where: str, cells: int) -> None:
    """Whole numbers beyond all that can be stored are larger, or smaller, than everything."""
    store.record_results([dataclasses.replace(records.done(0), rank=None)])
    assert store.table(("seed",), Selection(seeds=(0,), where=where))["seed"].size == cells
