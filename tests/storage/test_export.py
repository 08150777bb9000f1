"""NetCDF export and the way back."""

import contextlib
import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import netCDF4
import numpy as np
import pytest
import xarray as xr

from calcidem.app.cli.exchange import _RAISED_BY_DAMAGE
from calcidem.app.cli.exit_codes import _exit_code_of
from calcidem.ends import CellStatus
from calcidem.input_file import InputFileError
from calcidem.storage import netcdf, netcdf_trial
from calcidem.storage.dataset import campaign_dataset
from calcidem.storage.errors import (
    CampaignMismatchError,
    DamagedStoreError,
    DiskError,
    ForeignDatabaseError,
    LeaseHeldError,
    OtherSchemaError,
    StoreError,
    StoreUnavailableError,
    UnknownCampaignError,
)
from calcidem.storage.netcdf import _read, export_netcdf, import_netcdf
from calcidem.storage.records import CellKey, Selection
from calcidem.storage.sql.store import Store

if TYPE_CHECKING:
    from conftest import Records

ASSETS = Path(__file__).parent / "assets"

ENDLESS = ((2121, 2381), (204, 912), (970, 2409))
"""Blocks of 64 bytes of calcidem_0.1.0.nc; with two of them swapped the library loops for ever when it opens it."""


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.full)])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Address of an empty database: what a file says does not depend on the backend, as the round trip shows."""
    on_server = request.param == "postgresql"
    return request.getfixturevalue("postgresql_database") if on_server else str(tmp_path / "campaign.db")


@pytest.fixture
def filled(store: Store, records: "Records") -> Store:
    """Fill a store with something of everything."""
    store.extend((7,), (9.0,))
    store.record_running([CellKey(3, 5.0)])
    store.begin_run(records.run())  # which counts it as lost
    for index in (0, 1):
        store.save_packing(records.packing(index))
    store.record_results(records.with_arrays(seed, content) for seed in (0, 1) for content in (0.0, 0.3, 5.0))
    store.record_results([records.done(2, 0.0), records.failed(2, 5.0, status=CellStatus.UNSTABLE)])
    store.record_results([records.failed(3, 0.3)])
    store.retry()
    store.end_run("stopped", records.run().started + timedelta(hours=1))
    store.begin_run(records.run(mpi_library=None, git_commit=None, git_dirty=None, slurm_job_id=None))
    store.record_results([records.done(7, 9.0, seconds=None, rank=None, host=None)])
    store.use_campaign()
    return store


@pytest.fixture
def exported(filled: Store, tmp_path: Path) -> Path:
    """Export it."""
    return export_netcdf(filled, tmp_path / "campaign.nc")


@pytest.mark.parametrize("address", ["sqlite", "postgresql"], indirect=True)
def test_round_trip_gives_an_equal_database(filled: Store, exported: Path, tmp_path: Path) -> None:
    """Database to NetCDF to database keeps plan, runs, packings, attempts and outcomes, bit for bit."""
    original, campaign = filled, filled.record
    with Store(tmp_path / "copy.db") as copy:
        assert import_netcdf(exported, copy) == campaign
        assert copy.runs() == original.runs()
        assert [copy.packing(i) for i in copy.packing_indices()] == [original.packing(i) for i in (0, 1)]
        assert list(copy.history()) == list(original.history())
        assert copy.statuses() == original.statuses()
        assert list(copy.results(with_arrays=True)) == list(original.results(with_arrays=True))


def test_a_file_that_is_older_than_a_quantity_is_imported(
    filled: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cells lack it, and have all else."""
    newest = ("broken_bonds", "retry", "path_connectivity")
    known = {name: quantity for name, quantity in netcdf.QUANTITY_BY_NAME.items() if name not in newest}
    monkeypatch.setattr(netcdf, "QUANTITY_BY_NAME", known)
    file = export_netcdf(filled, tmp_path / "of_older_program.nc")
    with Store(tmp_path / "again.db") as copy:
        import_netcdf(file, copy)
        for found, given in zip(copy.results(with_arrays=True), filled.results(with_arrays=True), strict=True):
            features = given.features and dataclasses.replace(given.features, path_connectivity=None)
            assert found == dataclasses.replace(given, broken_bonds=None, retry=None, features=features)


def test_import_again_adds_nothing_but_runs(exported: Path, tmp_path: Path) -> None:
    """Importing twice leaves cells and attempts as they are."""
    with Store(tmp_path / "copy.db") as copy:
        import_netcdf(exported, copy)
        before = list(copy.results(with_arrays=True)), list(copy.history())
        import_netcdf(exported, copy)
        assert (list(copy.results(with_arrays=True)), list(copy.history())) == before


def test_an_export_has_the_plan_of_its_beginning_alone(
    store: Store, open_here: Callable[..., Store], records: "Records", tmp_path: Path
) -> None:
    """A reader that was opened before the plan grew exports the grown one; what is planned meanwhile is left out."""
    store.save_packing(records.packing())
    store.record_results([records.done(0)])
    reader = open_here(read_only=True)
    reader.use_campaign()
    store.extend([8], [5.0])
    store.record_results([records.done(8)])
    packings = reader.packing_indices

    def extended() -> tuple[int, ...]:
        store.extend([9], [5.0])
        store.record_results([records.done(9)])
        return packings()

    reader.packing_indices = extended  # type: ignore[method-assign]
    export_netcdf(reader, tmp_path / "grown.nc")
    with Store(tmp_path / "copy.db") as copy:
        assert import_netcdf(tmp_path / "grown.nc", copy).seeds == (*records.campaign().seeds, 8)
        assert [cell.key.seed for cell in copy.results()] == [0, 8]


def test_an_import_keeps_the_attempts_of_the_store(
    exported: Path, open_here: Callable[..., Store], records: "Records", tmp_path: Path
) -> None:
    """Those of the file come after them, with their own time, run and host; a second import adds none."""
    with Store(tmp_path / "copy.db") as copy:
        copy.begin_campaign(records.campaign())
        copy.begin_run(records.run(host="elsewhere"))
        copy.record_results([records.failed(0)])
        copy.record_results([records.failed(0, attempt=2)])
        own = list(copy.history())
        import_netcdf(exported, copy)
        found = list(copy.history(Selection(0, 5.0)))
        assert found[:2] == own
        original = open_here(read_only=True)
        original.use_campaign()
        (given,) = original.history(Selection(0, 5.0))
        theirs = dict(original.runs())[given.run_id]
        new = dataclasses.replace(given, number=3, run_id=None)
        assert [dataclasses.replace(one, run_id=None) for one in found[2:]] == [new]
        assert dict(copy.runs())[found[2].run_id].started == theirs.started
        assert copy.cell(seed=0, content=5.0).attempt == 3
        import_netcdf(exported, copy)
        assert list(copy.history(Selection(0, 5.0))) == found


def test_import_into_another_campaign_is_refused(exported: Path, tmp_path: Path, records: "Records") -> None:
    """A store whose campaign of that name has another configuration refuses the file."""
    with Store(tmp_path / "copy.db") as copy:
        copy.begin_campaign(records.campaign({"packing": {"friction": 0.5}}))
        with pytest.raises(CampaignMismatchError, match="friction"):
            import_netcdf(exported, copy)


def test_import_into_the_campaign_by_another_name(exported: Path, tmp_path: Path, records: "Records") -> None:
    """A store that has the campaign by another name takes the cells, and keeps its name."""
    with Store(tmp_path / "copy.db") as copy:
        copy.begin_campaign(records.campaign(name="mine"))
        assert import_netcdf(exported, copy).name == "mine"
        assert copy.packing_indices() == (0, 1)


def test_an_edited_configuration_is_refused(exported: Path, tmp_path: Path) -> None:
    """A file whose configuration was changed is refused."""
    with netCDF4.Dataset(exported, "a") as file:
        file.calcidem_config = file.calcidem_config.replace("0.2", "0.3")
        named = f"its configuration, or the hash {file.calcidem_campaign_hash} of its cells, is not what was exported"
    with Store(tmp_path / "copy.db") as copy:
        with pytest.raises(DamagedStoreError, match=named):
            import_netcdf(exported, copy)
        assert copy.campaigns() == ()


def test_cells_without_their_packing_are_refused(exported: Path, tmp_path: Path) -> None:
    """A file without the packing that its cells were computed on is refused."""
    with netCDF4.Dataset(exported, "a") as file:
        file["packings/index"][0] = 2
    with Store(tmp_path / "copy.db") as copy:
        with pytest.raises(DamagedStoreError, match="packing 0, on which cells were computed, is missing"):
            import_netcdf(exported, copy)
        assert copy.campaigns() == ()


def test_another_packing_is_refused(filled: Store, exported: Path, tmp_path: Path, records: "Records") -> None:
    """A store that has the campaign on another packing refuses the file, names both hashes and stays as it is."""
    campaign = filled.record
    with Store(tmp_path / "copy.db") as copy:
        copy.begin_campaign(dataclasses.replace(campaign, seeds=(1,), contents=(5.0,)))
        copy.save_packing(records.packing(0, y=records.packing(1).y, content_hash="yours"))
        with pytest.raises(CampaignMismatchError, match="yours in the database and content-0 in what is to be stored"):
            import_netcdf(exported, copy)
        assert (copy.packing_indices(), copy.runs(), len(copy.statuses())) == ((0,), (), 1)


def test_a_failed_import_leaves_the_store_as_it_was(
    exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever stops an import half-way, nothing of it is stored; one beside a run is refused."""

    def fail(*_: object) -> None:
        raise RuntimeError("half-way")

    with Store(tmp_path / "copy.db") as copy, Store(tmp_path / "copy.db") as master:
        monkeypatch.setattr(netcdf, "_results", fail)
        with pytest.raises(RuntimeError, match="half-way"):
            import_netcdf(exported, copy)
        assert copy.campaigns() == ()
        with pytest.raises(UnknownCampaignError):
            copy.runs()
        monkeypatch.undo()
        master.begin_campaign(import_netcdf(exported, copy))
        runs = copy.runs()
        master.acquire_lease()
        with pytest.raises(LeaseHeldError):
            import_netcdf(exported, copy)
        assert copy.runs() == runs


def test_sections_keep_their_own_numbers_of_stations(store: Store, records: "Records", tmp_path: Path) -> None:
    """Cells of packings of different widths have different numbers of stations; all come back as they were."""
    long = records.with_arrays(1)
    section = long.section
    assert section is not None
    places = np.append(section.places, (0.12, 0.15))
    across, along = np.arange(2 * 11 * len(places)).reshape(2, 11, len(places))
    wide = dataclasses.replace(long, section=dataclasses.replace(section, places=places, across=across, along=along))
    store.save_packing(records.packing())
    cells = [records.with_arrays(0), wide, records.with_arrays(2)]
    store.record_results(cells)
    file = export_netcdf(store, tmp_path / "campaign.nc")
    with Store(tmp_path / "copy.db") as copy:
        import_netcdf(file, copy)
        assert list(copy.results(with_arrays=True)) == cells


def test_content_hashes_are_exported(store: Store, records: "Records", tmp_path: Path) -> None:
    """The file names the content hash of each packing, and its import keeps it."""
    for index, content_hash in enumerate(("mine", "yours")):
        store.save_packing(records.packing(index, content_hash=content_hash))
    file = export_netcdf(store, tmp_path / "campaign.nc")
    with xr.open_dataset(file) as found:
        assert found.attrs["calcidem_packing_content_hash"] == "mine yours"
    with Store(tmp_path / "copy.db") as copy:
        import_netcdf(file, copy)
        assert copy.content_hashes() == {0: "mine", 1: "yours"}


def test_plain_xarray_opens_it(filled: Store, exported: Path) -> None:
    """Plain xarray finds the same Dataset in the file as the API gives, with provenance."""
    with xr.open_dataset(exported) as found:
        expected = campaign_dataset(filled)
        for name in expected.variables:
            np.testing.assert_array_equal(found[name].astype(expected[name].dtype), expected[name])
        assert found.attrs["Conventions"] == "CF-1.11"
        assert found.attrs["calcidem_campaign_hash"] == filled.record.hash
        assert json.loads(found.attrs["calcidem_config"])["packing"]["friction"] == 0.2
        assert json.loads(found.attrs["calcidem_runs"])[0]["versions"]["numpy"] == "2.4.6"


def test_flags_and_units_are_in_the_file(exported: Path) -> None:
    """Every number has a unit, the status is a CF flag variable, and data are compressed."""
    with netCDF4.Dataset(exported) as file:
        assert file["status"].dtype == np.int8
        assert len(file["status"].flag_meanings.split()) == len(file["status"].flag_values)
        for variable in file.variables.values():
            assert variable.long_name
            assert variable.dtype is str or hasattr(variable, "units") or variable.name == "status"
        assert file["vs"].filters()["zlib"]
        assert file["section/across"].filters()["zlib"]


@pytest.mark.full  # the checker takes seconds to load
@pytest.mark.filterwarnings("ignore:The ioos_sos checker")
def test_cf_checker(exported: Path) -> None:
    """The IOOS compliance checker finds no error against CF 1.11."""
    pytest.importorskip("compliance_checker", reason="compliance-checker is not installed")
    from compliance_checker.runner import CheckSuite, ComplianceChecker  # noqa: PLC0415 - optional

    CheckSuite.load_all_available_checkers()
    report = exported.with_suffix(".json")
    ComplianceChecker.run_checker(
        str(exported), ["cf:1.11"], verbose=0, criteria="normal", output_filename=str(report), output_format="json"
    )
    found = json.loads(report.read_text())["cf:1.11"]
    assert found["high_count"] == 0, found["high_priorities"]
    assert found["medium_count"] == 0, found["medium_priorities"]


def test_ncdump_opens_it(exported: Path) -> None:
    """Ncdump reads the header."""
    ncdump = shutil.which("ncdump")
    if ncdump is None:
        pytest.skip("ncdump is not installed (Debian: apt-get install netcdf-bin)")
    done = subprocess.run([ncdump, "-h", str(exported)], check=True, capture_output=True, text=True)
    assert "group: section" in done.stdout


def test_failed_export_leaves_the_old_file(filled: Store, exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An export that fails half-way leaves the old file as it was and no other beside it."""
    before = exported.read_bytes()

    def fail(*_: object) -> None:
        raise RuntimeError("power cut")

    monkeypatch.setattr(netcdf, "_write_cells", fail)
    with pytest.raises(DiskError, match="power cut"):
        export_netcdf(filled, exported)
    assert exported.read_bytes() == before
    assert [path.name for path in exported.parent.iterdir() if path.name.startswith(".")] == []


def test_unusable_targets(filled: Store, open_here: Callable[..., Store], records: "Records", tmp_path: Path) -> None:
    """A missing folder and a campaign without cells are refused before anything is written."""
    with pytest.raises(FileNotFoundError, match="folder"):
        export_netcdf(filled, tmp_path / "nowhere" / "campaign.nc")
    empty = open_here()
    empty.begin_campaign(records.campaign({"y": 1}, name="empty", seeds=(), contents=()))
    with pytest.raises(UnknownCampaignError, match="no cells"):
        export_netcdf(empty, tmp_path / "empty.nc")
    assert not (tmp_path / "empty.nc").exists()


def test_a_file_without_arrays_is_smaller_and_has_every_number(filled: Store, exported: Path, tmp_path: Path) -> None:
    """Leaving out sections, cement and paths keeps the numbers of every cell, and such a file can be imported."""
    small = export_netcdf(filled, tmp_path / "small.nc", without=("section", "cement", "path"))
    assert small.stat().st_size < exported.stat().st_size
    with xr.open_dataset(exported) as whole, xr.open_dataset(small) as numbers:
        xr.testing.assert_equal(whole, numbers)
    with netCDF4.Dataset(small) as file:
        assert not {"section", "cement", "path"} & set(file.groups)
    with Store(tmp_path / "imported.db") as other:
        import_netcdf(small, other)
        assert {r.key: r.vs for r in other.results()} == {r.key: r.vs for r in filled.results()}
        assert all(r.section is None for r in other.results(with_arrays=True))
    with pytest.raises(ValueError, match="without = 'pictures'"):
        export_netcdf(filled, tmp_path / "small.nc", without=("pictures",))


def test_foreign_files_are_refused(exported: Path, tmp_path: Path) -> None:
    """Text, other NetCDF files, former and later layouts are refused with the store left empty."""
    (tmp_path / "text.nc").write_text("hello")
    netCDF4.Dataset(tmp_path / "other.nc", "w").close()
    shutil.copy(ASSETS / "calcidem_0.1.0.nc", tmp_path)
    with netCDF4.Dataset(exported, "a") as file:
        file.calcidem_layout = 99
    with Store(tmp_path / "copy.db") as copy:
        for name, error in (
            ("text.nc", StoreUnavailableError),
            ("other.nc", ForeignDatabaseError),
            ("calcidem_0.1.0.nc", OtherSchemaError),
            (exported.name, OtherSchemaError),
        ):
            with pytest.raises(error):
                import_netcdf(tmp_path / name, copy)
        assert copy.campaigns() == ()


def endless_file(folder: Path, blocks: tuple[int, int]) -> Path:
    """Make a file that the library for NetCDF cannot open to its end."""
    content = (ASSETS / "calcidem_0.1.0.nc").read_bytes()
    first, second = (slice(64 * block, 64 * block + 64) for block in blocks)
    changed = bytearray(content)
    changed[first], changed[second] = content[second], content[first]
    path = folder / "endless.nc"
    path.write_bytes(changed)
    return path


@pytest.mark.parametrize("blocks", [ENDLESS[0], *(pytest.param(b, marks=pytest.mark.full) for b in ENDLESS[1:])])
def test_a_file_that_the_library_never_finishes_is_refused(
    blocks: tuple[int, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such a file is named with exit code 2, for reading and for being replaced, instead of being read for ever."""
    monkeypatch.setattr(netcdf_trial, "_TIME_FOR_A_BLOCK", 1.0)
    path = endless_file(tmp_path, blocks)
    with Store(tmp_path / "new.db") as store, pytest.raises(DamagedStoreError, match=r"endless\.nc") as caught:
        import_netcdf(path, store)
    assert _exit_code_of(caught.value) == 2
    assert netcdf.belongs_to_another(path, "the hash of any campaign")


@pytest.mark.slow
def test_an_interrupt_is_heard_while_a_file_is_tried(tmp_path: Path) -> None:
    """Ctrl-C ends the import of a file that the library never finishes, long before the time for it is over."""
    path = endless_file(tmp_path, ENDLESS[0])
    command = [sys.executable, "-m", "calcidem", "import", str(path), "--db", str(tmp_path / "new.db")]
    signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background of a shell ignore it, and so on
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while not (child := children.read_text().strip()):
        time.sleep(0.05)
    status = Path(f"/proc/{child}/stat")
    while int(status.read_text().split()[13]) < os.sysconf("SC_CLK_TCK"):  # it has been in the library for long
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert process.wait(20.0) != 0
    assert not status.exists() or status.read_text().split()[2] == "Z"  # ended, if not yet buried


@pytest.mark.full
def test_swapped_blocks_are_refused_or_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a hundred files with two blocks swapped each is imported or refused; none is read for ever."""
    monkeypatch.setattr(netcdf_trial, "_TIME_FOR_A_BLOCK", 2.0)
    last = (ASSETS / "calcidem_0.1.0.nc").stat().st_size // 64
    random = np.random.default_rng(7)
    for number in range(100):
        path = endless_file(tmp_path, tuple(random.integers(last, size=2).tolist()))
        with Store(tmp_path / f"{number}.db") as store, contextlib.suppress(StoreError, *_RAISED_BY_DAMAGE):
            import_netcdf(path, store)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    """Only a file is opened: a pipe that nobody writes would never be."""
    os.mkfifo(tmp_path / "pipe.nc")
    with Store(tmp_path / "new.db") as store, pytest.raises(InputFileError, match="is a pipe"):
        import_netcdf(tmp_path / "pipe.nc", store)


@pytest.mark.parametrize("count", [10**9, 10**15])
def test_a_variable_of_more_than_is_stored_is_refused(tmp_path: Path, count: int) -> None:
    """A few kilobytes that state a petabyte are refused before their memory is taken, and before it is read."""
    path = tmp_path / "bomb.nc"
    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("seed", count)
        file.createVariable("status", "i1", ("seed",), chunksizes=(1000,), zlib=True)[0] = 1
    with Store(tmp_path / "new.db") as store, pytest.raises(DamagedStoreError, match="more than it stores"):
        import_netcdf(path, store)


def test_what_would_not_fit_into_memory_is_not_read(tmp_path: Path) -> None:
    """At most a gigabyte is read at a time, whatever the file unpacks to."""
    with netCDF4.Dataset(tmp_path / "large.nc", "w") as file:
        file.createDimension("seed", 10**12)
        variable = file.createVariable("status", "f8", ("seed",), chunksizes=(1000,))
        with pytest.raises(ValueError, match=r"status would take 8e\+03 GB"):
            _read(variable)
        assert _read(variable, slice(5, 8)).shape == (3,)
