"""Two packings of one seed, and two versions of the physics, never meet in one campaign."""

import shutil
from dataclasses import replace
from pathlib import Path

import netCDF4
import numpy as np
import pytest

from calcidem.app.campaign import identity
from calcidem.app.campaign.merge import merge_databases
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.run import run
from calcidem.app.campaign.status import CampaignStatus
from calcidem.app.campaign.stored_packing import identify_packing, packing_record
from calcidem.app.config import schema
from calcidem.app.config.schema import PHYSICS_VERSION, CampaignPlan, Configuration
from calcidem.app.report.page import write_report
from calcidem.app.studies.verify import random_cells, verify
from calcidem.dem.sample.compaction import make_packing
from calcidem.dem.sample.packing import Packing
from calcidem.dem.sample.random_streams import RandomPurpose, random_generator
from calcidem.storage.errors import CampaignMismatchError, DamagedStoreError
from calcidem.storage.netcdf.export import export_netcdf
from calcidem.storage.netcdf.import_netcdf import import_netcdf
from calcidem.storage.sql.store import Store

pytestmark = pytest.mark.slow

FORMER = Path(__file__).parents[1] / "assets" / "physics_1.db"
"""Two cells of the tutorial as the calcidem of physics version 1 computed them."""


@pytest.fixture(scope="module")
def other_packing(small_configuration: Configuration) -> Packing:
    """Give the packing as another machine might make it: the same disks, which come to rest elsewhere."""
    coarse = replace(small_configuration.packing, unbalanced_force_ratio=1e-3)
    return make_packing(coarse, small_configuration.sand, random_generator(0, 6, RandomPurpose.DISKS))


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
    for module in (schema, identity):
        monkeypatch.setattr(module, "PHYSICS_VERSION", stored + 1)
    return stored


def test_import_refuses_another_packing(small_database: Path, other_database: Path, both: str, tmp_path: Path) -> None:
    """A file on one packing is not imported into a database on the other, which stays as it was."""
    with open_campaign(small_database) as campaign:
        file = export_netcdf(campaign.store, tmp_path / "small.nc")
    copy = Path(shutil.copy(other_database, tmp_path / "copy.db"))
    with Store(copy) as store:
        store.use_campaign()
        with pytest.raises(CampaignMismatchError, match=both):
            import_netcdf(file, store, identify_packing)
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
            import_netcdf(file, store, identify_packing)
        assert store.campaigns() == ()


def test_a_content_hash_that_is_missing_is_computed(
    small_database: Path, small_packing: Packing, tmp_path: Path
) -> None:
    """A database of an earlier calcidem has no content hash: readers compute it, an import and a merge store it."""
    with open_campaign(small_database) as campaign, Store(tmp_path / "old.db") as old:
        old.begin_campaign(campaign.record)
        old.save_packing(replace(campaign.packing(), content_hash=None))
        file = export_netcdf(old, tmp_path / "old.nc")
    known = small_packing.content_hash
    with open_campaign(tmp_path / "old.db") as old_campaign:
        assert old_campaign.packing().content_hash is None
        assert old_campaign.content_hash() == known
    assert CampaignStatus.read(tmp_path / "old.db").content_hashes == {0: known}
    merge_databases([str(tmp_path / "old.db")], tmp_path / "merged.db")
    with Store(tmp_path / "new.db") as new, open_campaign(tmp_path / "merged.db") as merged:
        import_netcdf(file, new, identify_packing)
        assert new.content_hashes() == merged.store.content_hashes() == {0: known}


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
        import_netcdf(file, store, identify_packing)
    merge_databases([str(small_database), str(tmp_path / "again.db")], tmp_path / "merged.db")
    with open_campaign(tmp_path / "merged.db") as merged:
        assert list(merged.select(with_arrays=True)) == expected


def test_the_database_of_an_earlier_calcidem_is_read_but_not_continued(tmp_path: Path) -> None:
    """What physics version 1 computed is opened, reported and exported; a run names both versions."""
    former = Path(shutil.copy(FORMER, tmp_path / "former.db"))
    before = former.read_bytes()
    with open_campaign(former) as campaign:
        assert campaign.config["physics_version"] == 1
        assert campaign.vs().notnull().all()
        assert len(campaign.sample(seed=1, content=5.0).packing.radius) == 4663
        expected = list(campaign.select(with_arrays=True))
        file = export_netcdf(campaign.store, tmp_path / "former.nc")
    assert [cell.key.content for cell in expected] == [0.66, 5.0]
    assert write_report(former, tmp_path / "report.html").stat().st_size > 0
    assert former.read_bytes() == before
    with Store(tmp_path / "again.db") as store:
        import_netcdf(file, store, identify_packing)
        assert list(store.results(with_arrays=True)) == expected
    configuration = Configuration(campaign=CampaignPlan(name="quick", seeds=2, contents=(0.66, 5.0)))
    with pytest.raises(CampaignMismatchError, match=rf"physics version 1, .* has version {PHYSICS_VERSION}:"):
        run(configuration, db=former)
    with open_campaign(former) as campaign:
        assert list(campaign.select(with_arrays=True)) == expected
