"""Output files: complete or not there, and never in the place of a database or of another campaign's file."""

import resource
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import netCDF4
import pytest
import xarray as xr

from calcidem.storage.errors import OutputRefusedError
from calcidem.storage.files import write_atomically, write_text_atomically
from calcidem.storage.netcdf import belongs_to_another, export_netcdf, write_netcdf
from calcidem.storage.sql.store import Store, read_campaign

if TYPE_CHECKING:
    from conftest import Records


@pytest.fixture
def database(tmp_path: Path, records: "Records") -> Path:
    """Create a closed database with a done cell."""
    path = tmp_path / "one.db"
    with Store(path) as store:
        store.begin_campaign(records.campaign())
        store.record_results([records.done(0)])
    return path


@pytest.mark.parametrize("ending", ["", "-wal", "-shm", "-journal", ".lock"])
def test_no_output_takes_the_place_of_a_database(database: Path, ending: str) -> None:
    """A file of a database, also by another link, is refused before anything is written."""
    before = database.read_bytes()
    target = database.with_name(database.name + ending)
    with pytest.raises(OutputRefusedError, match="Give another file name"):
        write_text_atomically(target, "a report")
    link = database.with_name("report.html" + ending)
    link.symlink_to(database)
    if not ending:
        with pytest.raises(OutputRefusedError), write_atomically(link):
            pass
    with read_campaign(database) as store, pytest.raises(OutputRefusedError):
        export_netcdf(store, target)
    assert database.read_bytes() == before
    assert {path.name for path in database.parent.iterdir()} <= {database.name, link.name, "one.db-shm", "one.db-wal"}


def test_no_export_takes_the_place_of_another_campaigns(database: Path, tmp_path: Path, records: "Records") -> None:
    """Its own file is replaced, that of another campaign, a foreign and a broken one are not, nor by other outputs."""
    other = tmp_path / "other.nc"
    with Store(database) as store:
        second = store.begin_campaign(records.campaign({"other": 1}, name="other"))
        export_netcdf(store, other)
        export_netcdf(store, other)
        first = store.use_campaign("quick")
        with pytest.raises(OutputRefusedError, match="another campaign"):
            export_netcdf(store, other)
        with netCDF4.Dataset(tmp_path / "foreign.nc", "w") as file:
            file.title = "somebody's ocean"
        (tmp_path / "broken.nc").write_bytes(other.read_bytes()[:300])
        for name in ("foreign.nc", "broken.nc"):
            with pytest.raises(OutputRefusedError):
                export_netcdf(store, tmp_path / name)
    assert belongs_to_another(other, first.hash)
    assert not belongs_to_another(other, second.hash)
    for write in (
        lambda: write_text_atomically(other, "page"),
        lambda: write_netcdf(xr.Dataset({"n": 1}), other),
    ):
        with pytest.raises(OutputRefusedError):
            write()
    assert not belongs_to_another(other, second.hash)
    write_netcdf(xr.Dataset({"n": 1}), tmp_path / "study.nc")
    write_netcdf(xr.Dataset({"n": 2}), tmp_path / "study.nc")
    with xr.open_dataset(tmp_path / "study.nc") as found:
        assert int(found["n"]) == 2


FULL_DISK = """
import resource, sys
from calcidem.storage.errors import DiskError
from calcidem.storage.netcdf import export_netcdf
from calcidem.storage.sql.store import Store

with Store(sys.argv[1], read_only=True) as store:
    store.use_campaign()
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
    try:
        export_netcdf(store, sys.argv[2])
    except DiskError as error:
        print(error)
"""


def test_an_output_by_a_link_is_the_file_of_the_link(database: Path, tmp_path: Path) -> None:
    """As every program writes it that opens the link."""
    (tmp_path / "far").mkdir()
    link = tmp_path / "near.nc"
    link.symlink_to(tmp_path / "far" / "real.nc")
    with read_campaign(database) as store:
        export_netcdf(store, link)
    assert link.is_symlink()
    assert not (tmp_path / "far" / "real.nc").is_symlink()
    link.unlink()
    link.symlink_to(database)
    with pytest.raises(OutputRefusedError, match="is a database"):
        write_text_atomically(link, "text")


def test_netcdf_on_a_full_disk_is_a_sentence(database: Path, tmp_path: Path) -> None:
    """A file that does not fit is told in plain words, and neither it nor a part of it is left."""
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY
    command = [sys.executable, "-c", FULL_DISK, str(database), str(tmp_path / "full.nc")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "full.nc could not be written" in done.stdout
    assert not list(tmp_path.glob("*full.nc*"))
