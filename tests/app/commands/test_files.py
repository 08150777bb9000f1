"""`calcidem export` and `calcidem import`: databases and samples as files, and back."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import pytest
from places import TUTORIAL

from calcidem.app.campaign.opened import Campaign, open_campaign
from calcidem.dem.sample.compaction import _read_disks
from calcidem.storage.errors import ForeignDatabaseError, OutputRefusedError
from calcidem.storage.netcdf import export_netcdf

Invoke = Callable[..., str]


def test_database_to_netcdf_to_database(campaign: Campaign, invoke: Invoke, tmp_path: Path) -> None:
    """A real database that went through NetCDF is equal in every record, packing, run and attempt."""
    file, copy = tmp_path / "quick.nc", tmp_path / "copy.db"
    export_netcdf(campaign.store, file)
    assert "8 seeds, 5 contents" in invoke("import", file, "--db", copy)
    with open_campaign(copy) as other:
        assert other.record == campaign.record
        assert list(other.select(with_arrays=True)) == list(campaign.select(with_arrays=True))
        assert other.packing() == campaign.packing()
        assert [run for _, run in other.runs()] == [run for _, run in campaign.runs()]
        assert list(other.store.history()) == list(campaign.store.history())
        first, second = (opened.sample(seed=3, content=5.0) for opened in (other, campaign))
        np.testing.assert_array_equal(first.packing.preload.shear, second.packing.preload.shear)


def test_import_refuses_other_files(invoke: Invoke, tmp_path: Path) -> None:
    """A NetCDF file of somebody else is refused."""
    import netCDF4  # noqa: PLC0415 - this test alone needs it

    netCDF4.Dataset(tmp_path / "other.nc", "w").close()
    with pytest.raises(ForeignDatabaseError, match="not written by calcidem"):
        invoke("import", tmp_path / "other.nc", "--db", tmp_path / "new.db")


def test_sample_for_paraview(database: Path, invoke: Invoke, campaign: Campaign, tmp_path: Path) -> None:
    """The file holds all disks with their radii and all contacts with their cement."""
    file = tmp_path / "sample.vtu"
    invoke("export", database, file, "--seed", 1, "--content", 5)
    mesh, sample = meshio.read(file), campaign.sample(seed=1, content=5.0)
    np.testing.assert_array_equal(mesh.points[:, 0], sample.packing.x)
    np.testing.assert_array_equal(mesh.point_data["radius"].ravel(), sample.packing.radius)
    np.testing.assert_array_equal(mesh.cells_dict["line"], sample.packing.pairs)
    np.testing.assert_array_equal(mesh.cell_data_dict["kind"]["line"].ravel(), sample.kind)


def test_packing_as_csv(database: Path, invoke: Invoke, campaign: Campaign, tmp_path: Path) -> None:
    """The disks in the CSV file are those of the packing, to the last bit."""
    file = tmp_path / "packing.csv"
    invoke("export", database, file, "--seed", 1, "--content", 5)
    x, y, radius, *_ = _read_disks(file)
    packing = campaign.packing()
    for written, stored in ((x, packing.x), (y, packing.y), (radius, packing.radius)):
        np.testing.assert_array_equal(written, stored)


def test_unknown_endings_are_refused(database: Path, invoke: Invoke, tmp_path: Path) -> None:
    """An ending that stands for no format is refused before anything is written."""
    for ending in ("stl", "vtk"):  # VTK 9 cannot read what meshio writes as .vtk
        output = invoke("export", database, tmp_path / f"a.{ending}", "--seed", 1, "--content", 5, exit_code=2)
        assert ".vtu" in output
    assert "--content" in invoke("export", database, tmp_path / "a.csv", exit_code=2)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "quick.toml").write_text("[run]", encoding="utf-8")
    with pytest.raises(OutputRefusedError, match="is no NetCDF file"):
        invoke("export", database, tmp_path / "quick.toml")
    assert (tmp_path / "quick.toml").read_text(encoding="utf-8") == "[run]"
    refused = invoke("import", tmp_path / "a.nc", "--db", tmp_path / "b.db", "--plane", "xy", exit_code=2)
    assert "--plane" in refused


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_no_temporary_files(number: signal.Signals, tmp_path: Path) -> None:
    """A scheduler that ends `merge` finds the folder as it was."""
    target = tmp_path / "whole.db"
    command = [sys.executable, "-m", "calcidem", "merge", TUTORIAL, "--out", target]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        while process.poll() is None and not list(tmp_path.glob(".*.tmp")):
            time.sleep(0.002)
        process.send_signal(number)
        assert process.wait(15.0) == 128 + number
    assert not list(tmp_path.iterdir())
