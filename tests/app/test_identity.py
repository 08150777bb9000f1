"""Two packings of one seed, and two versions of the physics, never meet in one campaign."""

import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import netCDF4
import numpy as np
import pytest

from calcidem.app.campaign.merge import merge_databases
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import packing_record, stored_packing
from calcidem.app.campaign.run import run
from calcidem.app.config import schema
from calcidem.app.config.schema import PHYSICS_VERSION, CampaignPlan, Configuration
from calcidem.app.report.page import write_report
from calcidem.app.report.sections import PAGE_SECTIONS
from calcidem.app.studies.verify import random_cells, verify
from calcidem.dem.sample.packing import Packing
from calcidem.storage.errors import CampaignMismatchError, DamagedStoreError
from calcidem.storage.netcdf import export_netcdf, import_netcdf
from calcidem.storage.sql.store import Store

pytestmark = pytest.mark.slow

TUTORIAL = Path(__file__).parents[2] / "docs" / "tutorial" / "quick.db"


@pytest.fixture(scope="module")
def other_packing(small_packing: Packing) -> Packing:
    """Give the packing as another machine might make it: the same disks, which come to rest a rounding elsewhere."""
    return replace(small_packing, x=small_packing.x * (1.0 + 1e-15))


@pytest.fixture(scope="module")
def other_database(
    tmp_path_factory: pytest.TempPathFactory,
    small_database: Path,
    small_configuration: Configuration,
    other_packing: Packing,
) -> Path:
    """Give a database of the small campaign on that packing, with a seed that the first lacks."""
    path = tmp_path_factory.mktemp("other") / "other.db"
    with open_campaign(small_database) as campaign, Store(path) as store:
        cell = campaign.cell(seed=1, content=5.0)
        store.begin_campaign(replace(campaign.record, seeds=(7,), contents=(5.0,)))
        store.save_packing(packing_record(other_packing, index=0, packing_hash=small_configuration.packing_hash))
        store.record_results([replace(cell, key=replace(cell.key, seed=7))])
    return path


@pytest.fixture
def both(small_packing: Packing, other_packing: Packing) -> str:
    """Give a pattern of both content hashes."""
    return rf"(?s)(?=.*{small_packing.content_hash})(?=.*{other_packing.content_hash})"


@pytest.fixture
def stored_version(small_database: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """Make this the calcidem of the next physics version, and give the one that the database was made with."""
    with open_campaign(small_database) as campaign:
        stored = int(campaign.config["physics_version"])
    monkeypatch.setattr(schema, "PHYSICS_VERSION", stored + 1)
    return stored


def test_import_refuses_another_packing(small_database: Path, other_database: Path, both: str, tmp_path: Path) -> None:
    """A file on one packing is not imported into a database on the other, which stays as it was."""
    with open_campaign(small_database) as campaign:
        file = export_netcdf(campaign.store, tmp_path / "small.nc")
    copy = Path(shutil.copy(other_database, tmp_path / "copy.db"))
    with Store(copy) as store:
        store.use_campaign()
        with pytest.raises(CampaignMismatchError, match=both):
            import_netcdf(file, store, stored_packing)
        assert [cell.key.seed for cell in store.results()] == [7]
        assert store.runs() == ()


def test_merge_refuses_another_packing(small_database: Path, other_database: Path, both: str, tmp_path: Path) -> None:
    """Databases on two packings are not merged, though no cell is in both."""
    with pytest.raises(CampaignMismatchError, match=both):
        merge_databases([str(small_database), str(other_database)], tmp_path / "out.db")


@pytest.mark.parametrize(("name", "change"), [("state", 1), ("x", 1e-12), ("content_hash", "f" * 64)])
def test_import_refuses_a_packing_that_was_changed(
    small_database: Path, tmp_path: Path, name: str, change: float | str
) -> None:
    """A state that is damaged or contradicts the file's disks or content hash is refused before anything is written."""
    with open_campaign(small_database) as campaign:
        file = export_netcdf(campaign.store, tmp_path / "small.nc")
    with netCDF4.Dataset(file, "a") as opened:
        values = opened[f"packings/{name}"]
        values[-1] = change if isinstance(change, str) else np.asarray(values[-1] + change, dtype=values.dtype)
    with Store(tmp_path / "new.db") as store:
        with pytest.raises(DamagedStoreError, match="stored state of packing 0 can't be used"):
            import_netcdf(file, store, stored_packing)
        assert store.campaigns() == ()


def test_run_refuses_another_physics_version(
    small_database: Path, small_configuration: Configuration, stored_version: int, tmp_path: Path
) -> None:
    """A campaign of an earlier physics version is not continued; one sentence names both versions."""
    copy = shutil.copy(small_database, tmp_path / "copy.db")
    configuration = replace(small_configuration)  # a new one: hashes are kept where they were computed
    with pytest.raises(CampaignMismatchError, match=rf"version {stored_version}, .* has version {stored_version + 1}:"):
        run(configuration, db=copy)


def test_verify_refuses_another_physics_version(small_database: Path, stored_version: int) -> None:
    """Cells of an earlier physics version are not compared with what this one gives."""
    both = rf"version {stored_version}, .* has version {stored_version + 1}:"
    with open_campaign(small_database) as campaign, pytest.raises(CampaignMismatchError, match=both):
        list(verify(campaign.store, random_cells(campaign.store, 1), campaign.experiment))


@pytest.mark.usefixtures("stored_version")
def test_an_earlier_physics_version_is_still_read(small_database: Path, tmp_path: Path) -> None:
    """A campaign of an earlier physics version opens, is exported, imported and merged as before."""
    with open_campaign(small_database) as campaign:
        assert campaign.sample(seed=1, content=5.0).packing.radius.size == 280
        file = export_netcdf(campaign.store, tmp_path / "small.nc")
        expected = list(campaign.select(with_arrays=True))
    with Store(tmp_path / "again.db") as store:
        import_netcdf(file, store, stored_packing)
    merge_databases([str(small_database), str(tmp_path / "again.db")], tmp_path / "merged.db")
    with open_campaign(tmp_path / "merged.db") as merged:
        assert list(merged.select(with_arrays=True)) == expected


def test_the_database_of_an_earlier_calcidem_is_read_but_not_continued(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What physics version 1 computed is opened, reported and exported; a run names both versions."""
    monkeypatch.setattr("calcidem.app.report.page.PAGE_SECTIONS", PAGE_SECTIONS[:1])  # figures take seconds
    former = Path(shutil.copy(TUTORIAL, tmp_path / "former.db"))
    with sqlite3.connect(former) as connection:
        connection.execute("UPDATE campaign SET config = json_set(config, '$.physics_version', 1)")
    connection.close()
    before = former.read_bytes()
    with open_campaign(former) as campaign:
        assert campaign.config["physics_version"] == 1
        assert len(campaign.sample(seed=1, content=5.0).packing.radius) == 4663
        expected = list(campaign.select(with_arrays=True))
        file = export_netcdf(campaign.store, tmp_path / "former.nc")
    assert write_report(former, tmp_path / "report.html").stat().st_size > 0
    assert former.read_bytes() == before
    with Store(tmp_path / "again.db") as store:
        import_netcdf(file, store, stored_packing)
        assert [replace(cell, cement=None) for cell in store.results(with_arrays=True)] == [
            replace(cell, cement=None) for cell in expected
        ]
    configuration = Configuration(campaign=CampaignPlan(name="quick", seeds=2, contents=(0.66, 5.0)))
    with pytest.raises(CampaignMismatchError, match=rf"physics version 1, .* has version {PHYSICS_VERSION}:"):
        run(configuration, db=former)
    assert former.read_bytes() == before
