"""`calcidem verify`, and the studies that judge a stored campaign: a small campaign is computed, and computed again."""

import dataclasses
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest
from places import SMALL_PACKING

from calcidem.app.campaign.cells import cell_result
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import _cached_name
from calcidem.app.campaign.run import run
from calcidem.app.cli.exit_codes import EXIT_ROUNDING, _exit_code_of
from calcidem.app.cli.views import _vs_table
from calcidem.app.config import schema
from calcidem.app.config.reader import load_configuration
from calcidem.app.config.schema import PHYSICS_VERSION
from calcidem.app.report.page import _velocity_remarks
from calcidem.app.studies.study import Cells
from calcidem.app.studies.verify import Agreement, _compare_outcomes, random_cells, verify
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.measurement import measure
from calcidem.ends import CellStatus
from calcidem.storage.errors import CampaignMismatchError
from calcidem.storage.records import CellKey, CellResult, Selection
from calcidem.storage.sql.store import Store

pytestmark = pytest.mark.slow

Invoke = Callable[..., str]
Change = Callable[..., Path]

CONFIGURATION = """
[campaign]
name = "small"
seeds = 2
contents = [0.0, 0.66]
[packing]
width = 0.03
height = 0.06
unbalanced_force_ratio = 1e-5
[sand]
wave_stiffness_factor = 13.0
[pattern]
p_share = {p_share}
[wave]
transmitter_half_width = 0.01
receiver_half_width = 0.012
boundary_thickness = 0.012
listening_depth = 0.006
both_sides = true
[wave.frequency]
content = [0.0, 0.66]
frequency = [12e3, 24e3]
"""


@pytest.fixture(scope="module")
def toml(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the configuration of the small campaign."""
    path = tmp_path_factory.mktemp("configuration") / "small.toml"
    path.write_text(CONFIGURATION.format(p_share=0.77), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def small(toml: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compute the campaign of 280 disks and four cells, on the packing that is kept with the tests."""
    folder = tmp_path_factory.mktemp("small")
    configuration = load_configuration(toml)
    shutil.copy(SMALL_PACKING, folder / _cached_name(configuration.packing_hash))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CALCIDEM_CACHE", str(folder))
        run(configuration, db=folder / "small.db").close()
    return folder / "small.db"


@pytest.fixture
def change(small: Path, stored: CellResult, tmp_path: Path) -> Change:
    """Give a copy of the database in which fields of one cell are others, as if they had been computed wrongly."""

    def changed(**fields: object) -> Path:
        path = Path(shutil.copy(small, tmp_path / "changed.db"))
        with closing(sqlite3.connect(path)) as connection, connection:
            connection.execute("PRAGMA foreign_keys = ON")
            (row,) = connection.execute("SELECT id FROM cell WHERE seed = ? AND content = ?", astuple(stored.key))
            connection.execute("DELETE FROM result WHERE cell_id = ?", row)
        with Store(path) as store:
            store.use_campaign()
            store.record_results([replace(stored, **fields)])  # type: ignore[arg-type]  # a test's own
        return path

    return changed


@pytest.fixture
def stored(small: Path) -> CellResult:
    """Give a cell with a velocity."""
    with open_campaign(small) as campaign:
        return next(campaign.select(status="done", content=0.66, with_arrays=True))


@pytest.fixture
def no_packing_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the cache empty and fail whoever makes a packing."""

    def fail(*_: object) -> Packing:
        raise AssertionError

    monkeypatch.setenv("CALCIDEM_CACHE", str(tmp_path / "empty"))
    monkeypatch.setattr("calcidem.dem.sample.compaction.make_packing", fail)


@pytest.mark.usefixtures("no_packing_is_made")
def test_what_was_computed_comes_out_the_same(small: Path, invoke: Invoke) -> None:
    """All cells come out the same to the last bit, sections and cement too, on the packing of the database."""
    with open_campaign(small) as campaign:
        found = list(verify(campaign.store, random_cells(campaign.store, 100), campaign.experiment))
    assert len(found) == 4
    assert all(verification.stored.section is not None for verification in found)
    assert [dict(verification.differences) for verification in found] == [{}] * 4
    output = invoke("verify", small, "--cells", 2, "--choice", 1)
    assert "2 cells: 2 same bits, 0 same to rounding, 0 different." in output


def test_rounding_is_told_with_its_size(change: Change, stored: CellResult, invoke: Invoke) -> None:
    """A velocity that is off by 1e-12 is the same to rounding; the command names it and ends with 3."""
    changed = change(vs_peak=(stored.vs_peak or 0.0) * (1.0 + 1e-12))
    output = invoke("verify", changed, "--cells", 4, exit_code=EXIT_ROUNDING)
    assert "seed 1, 0.66 %: same to rounding (most of all vs_peak, relative difference 1e-12)" in output
    assert "4 cells: 3 same bits, 1 same to rounding, 0 different." in output


def test_a_changed_number_is_found_out(change: Change, stored: CellResult, invoke: Invoke) -> None:
    """A velocity that is off by 1e-3 is different even beside one that is off by rounding; the command ends with 1."""
    changed = change(vs=(stored.vs or 0.0) * 1.001, vs_peak=(stored.vs_peak or 0.0) * (1.0 + 1e-12))
    output = invoke("verify", changed, "--cells", 4, exit_code=1)
    assert "seed 1, 0.66 %: different (most of all vs, relative difference 0.001; 1 other differs)" in output
    assert "4 cells: 3 same bits, 0 same to rounding, 1 different." in output


def test_a_changed_status_is_found_out(change: Change, invoke: Invoke) -> None:
    """A cell that was done and is stored as without an arrival is different, whatever else agrees."""
    changed = change(status=CellStatus.NO_ARRIVAL, vs=None, reason="changed")
    output = invoke("verify", changed, "--cells", 4, exit_code=1)
    assert "different (most of all status: stored no_arrival, computed done; 1 other differs)" in output


def test_another_version_of_the_physics_is_refused(
    small: Path, invoke: Invoke, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What another version of the physics computed is not compared: the message names both versions."""
    monkeypatch.setattr(schema, "PHYSICS_VERSION", 99)
    with pytest.raises(
        CampaignMismatchError, match=f"physics version {PHYSICS_VERSION}, this .* version 99"
    ) as refused:
        invoke("verify", small)
    assert _exit_code_of(refused.value) == 2


def test_sections_and_cement_are_compared(stored: CellResult) -> None:
    """A section off by one count, or by little, is rounding; one cemented contact more is different."""
    section, cement = stored.section, stored.cement
    assert section is not None
    assert cement is not None

    def with_section(**changes: object) -> CellResult:
        return dataclasses.replace(stored, section=dataclasses.replace(section, **changes))

    near = _compare_outcomes(stored, with_section(resolution=section.resolution * (1.0 + 1e-12)))
    assert near.agreement is Agreement.ROUNDING
    assert near.most_different == "section.resolution"
    assert near.differences[near.most_different] == pytest.approx(1e-12, rel=0.1)
    for counts, agreement in ((1, Agreement.ROUNDING), (2, Agreement.DIFFERENT)):
        across = np.array(section.across)
        across[0, -1] += counts
        other = _compare_outcomes(stored, with_section(across=across))
        assert other.agreement is agreement
        assert set(other.differences) == {"section.across"}
    fewer = dataclasses.replace(cement, contacts=cement.contacts[1:], kind=cement.kind[1:])
    other = _compare_outcomes(stored, dataclasses.replace(stored, cement=fewer))
    assert other.agreement is Agreement.DIFFERENT
    assert set(other.differences) == {"cement.contacts", "cement.kind"}
    without = dataclasses.replace(stored, section=None, cement=None)
    assert _compare_outcomes(without, stored).agreement is Agreement.SAME_BITS
    assert _compare_outcomes(stored, without).agreement is Agreement.DIFFERENT


def test_broken_bonds_are_compared(stored: CellResult) -> None:
    """Another number is another sample."""
    assert stored.broken_bonds == 0
    other = _compare_outcomes(stored, dataclasses.replace(stored, broken_bonds=2))
    assert other.agreement is Agreement.DIFFERENT


def test_broken_bonds_are_told_where_there_are_some(change: Change, small: Path, invoke: Invoke) -> None:
    """One cell that lost four of them is named by filters, in its record and in remarks; no cell that lost none is."""
    changed = change(broken_bonds=4)
    where = ("--where", "broken_bonds > 0", "--columns", "seed,broken_bonds", "--format", "csv")
    assert invoke("query", changed, *where).split() == ["seed,broken_bonds", "1,4"]
    cell = ("--seed", 1, "--content", 0.66)
    assert "number of bonds that the pulse broke" in invoke("show", changed, *cell)
    assert "pulse broke" not in invoke("show", small, *cell)
    for path, told in (
        (changed, "Cells in which the pulse broke bonds: 1; a smaller wave.amplitude breaks none."),
        (small, ""),
    ):
        with open_campaign(path) as campaign:
            terminal = str(_vs_table(campaign.store, Selection()).caption).splitlines()
            for remarks in (_velocity_remarks(campaign.analyse()), terminal):
                assert [line for line in remarks if "broke" in line] == [told] * bool(told)


def test_what_the_record_of_a_wave_tells_is_kept(small: Path) -> None:
    """Broken bonds, and the problem for which the wave was sent a second time, go into the outcome."""
    with open_campaign(small) as campaign:
        experiment = campaign.experiment(0)
    (measured,) = measure(experiment, 0.66, [1])
    again = dataclasses.replace(
        measured, section=dataclasses.replace(measured.section, retry="the energy grew", broken_bonds=7)
    )
    assert cell_result(measured, experiment, store_sections=False).retry is None
    kept = cell_result(again, experiment, store_sections=False)
    assert (kept.retry, kept.broken_bonds) == ("the energy grew", 7)


def test_choice_of_cells(small: Path) -> None:
    """The same seed chooses the same cells, and never more than there are."""
    with open_campaign(small) as campaign:
        assert random_cells(campaign.store, 2, 7) == random_cells(campaign.store, 2, 7)
        assert random_cells(campaign.store, 99) == tuple(CellKey(s, c) for s in (1, 2) for c in (0.0, 0.66))


@pytest.mark.usefixtures("no_packing_is_made")
def test_accuracy_judges_the_packing_of_the_database(small: Path, toml: Path, small_packing: Packing) -> None:
    """With --db the cells are those of the stored packing; none is made."""
    cells = Cells.of_campaign(load_configuration(toml), 1, small, lambda _: None)
    assert cells.experiment.packing.content_hash == small_packing.content_hash


@pytest.mark.full
@pytest.mark.usefixtures("no_packing_is_made")
def test_accuracy_measures_on_the_packing_of_the_database(small: Path, toml: Path, invoke: Invoke) -> None:
    """With --db the command measures cells of the stored packing; none is made."""
    limits = ("--content", 0.66, "--seeds", 1, "--only", "precision float32")
    assert "precision float32" in invoke("accuracy", toml, "--db", small, *limits)


def test_a_database_of_another_configuration_is_refused(
    small: Path, toml: Path, tmp_path: Path, invoke: Invoke
) -> None:
    """Before anything is measured; the message names both hashes and what differs."""
    other = tmp_path / "other.toml"
    other.write_text(CONFIGURATION.format(p_share=0.5), encoding="utf-8")
    with pytest.raises(CampaignMismatchError, match=r"pattern\.p_share: 0\.77 -> 0\.5") as refused:
        invoke("accuracy", other, "--db", small)
    assert load_configuration(toml).hash in str(refused.value)
    assert load_configuration(other).hash in str(refused.value)
    assert _exit_code_of(refused.value) == 2
