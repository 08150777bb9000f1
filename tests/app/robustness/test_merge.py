"""`calcidem merge`: the union of databases of one campaign, and no silent choice between different values."""

import json
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from calcidem.app.campaign.merge import merge_databases
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import packing_record, stored_packing
from calcidem.ends import CellStatus
from calcidem.storage.errors import CampaignMismatchError, ForeignDatabaseError, StoreUnavailableError
from calcidem.storage.records import CellKey, CellResult, canonical_hash, canonical_json
from calcidem.storage.sql.store import Store


def results(database: Path) -> dict[CellKey, CellResult]:
    """Every outcome of a database with its arrays, whatever the number of the attempt."""
    with open_campaign(database) as campaign:
        return {cell.key: replace(cell, attempt=1) for cell in campaign.select(with_arrays=True)}


def test_seed_ranges_join_to_the_whole(
    complete: Path, part: Callable[..., Path], invoke: Callable[..., str], tmp_path: Path
) -> None:
    """Eight parts of a campaign merge into all of its outcomes, signals and cement included, bit for bit."""
    seeds, out = [{1, 2}, *({seed} for seed in range(2, 9))], tmp_path / "all.db"
    parts = [part(f"{number}.db", own) for number, own in enumerate(seeds)]
    output = invoke("merge", *parts, "--out", out)
    assert results(out) == results(complete)
    assert "5 cells were in several databases with the same values" in output
    with open_campaign(out) as campaign:
        assert campaign.record.seeds == (1, 2, 3, 4, 5, 6, 7, 8)
        assert len(campaign.runs()) == 1  # both parts have it of the same database


def test_what_no_part_has_is_named(part: Callable[..., Path], invoke: Callable[..., str], tmp_path: Path) -> None:
    """Planned cells without an outcome are listed by content, with their seeds as ranges."""
    first, second = part("a.db", {1, 2}), part("b.db", {6})
    with Store(first) as store:
        contents = store.use_campaign().contents
        store.extend(range(1, 9), contents)
    output = invoke("merge", first, second, "--out", tmp_path / "out.db")
    assert "Missing:" in output
    assert all(f"  {content:g} %: 5 cells, seeds 3-5, 7-8\n" in output for content in contents)


def test_merging_a_copy_changes_nothing(troubled: Path, tmp_path: Path) -> None:
    """A database merged with its copy has the same cells, attempts and runs as before."""
    copy, out = shutil.copy(troubled, tmp_path / "copy.db"), tmp_path / "out.db"
    merge_databases([str(troubled), str(copy)], out)
    with open_campaign(troubled) as before, open_campaign(out) as after:
        assert list(after.select(with_arrays=True)) == list(before.select(with_arrays=True))
        assert after.status_counts() == before.status_counts()
        assert len(after.runs()) == len(before.runs())
        histories = [
            [replace(attempt, run_id=None) for attempt in campaign.store.history()] for campaign in (before, after)
        ]
    assert histories[0] == histories[1]


@pytest.mark.parametrize("older_first", [True, False])
def test_the_end_of_a_run_is_kept_whichever_copy_has_it(troubled: Path, tmp_path: Path, older_first: bool) -> None:
    """A copy that was made while it ran does not know it."""
    copy, out = shutil.copy(troubled, tmp_path / "copy.db"), tmp_path / "out.db"
    with closing(sqlite3.connect(copy)) as connection, connection:
        connection.execute("UPDATE run SET ended = NULL, exit_state = NULL")
    merge_databases([str(copy), str(troubled)] if older_first else [str(troubled), str(copy)], out)
    with open_campaign(troubled) as before, open_campaign(out) as after:
        ends = [[(run.started, run.ended, run.exit_state) for _, run in one.runs()] for one in (before, after)]
    assert ends[0] == ends[1]
    assert any(ended for _, ended, _ in ends[1])


def test_a_second_name_of_the_merged_file_is_refused(part: Callable[..., Path], tmp_path: Path) -> None:
    """It would go on with the former cells, without notice."""
    out = part("out.db", {1})
    (tmp_path / "other.db").hardlink_to(out)
    before = out.read_bytes()
    with pytest.raises(StoreUnavailableError, match="2 names"):
        merge_databases([str(part("b.db", {2}))], out)
    assert out.read_bytes() == before


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_done_wins(troubled: Path, part: Callable[..., Path], tmp_path: Path, order: tuple[int, int]) -> None:
    """A cell that failed in one database and is done in the other is done, in whichever order they are given."""
    other = part("other.db", {1})
    with Store(other) as store:
        store.use_campaign()
        done = next(store.results())
        store.extend((9,), (0.0,))
        store.record_results([replace(done, key=CellKey(9, 0.0), attempt=1)])
    sources = [str(troubled), str(other)]
    merged = merge_databases([sources[i] for i in order], tmp_path / "out.db")
    assert merged.overruled == 1
    found = results(tmp_path / "out.db")
    assert found[CellKey(9, 0.0)].status is CellStatus.DONE
    assert found[CellKey(9, 0.66)].status is CellStatus.TIMED_OUT
    with open_campaign(tmp_path / "out.db") as campaign:
        assert [a.outcome for a in campaign.history(seed=9, content=0.0)] == ["failed", "done"]


def test_different_values_are_refused_unless_one_is_preferred(
    part: Callable[..., Path], invoke: Callable[..., str], tmp_path: Path
) -> None:
    """Two different Vs of a done cell are listed and nothing is written; --prefer takes those of one database."""
    first, second, out = part("a.db", {1, 2}), part("b.db", {2, 3}, vs=1234.5), tmp_path / "out.db"
    with pytest.raises(CampaignMismatchError, match=r"5 done cells.*\n.*seed 2, 0 %: Vs .*1234\.5 m/s in"):
        merge_databases([str(first), str(second)], out)
    assert not list(tmp_path.glob("*out.db*"))
    output = invoke("merge", first, second, "--out", out, "--prefer", second)
    assert "5 done cells had different values" in output
    found = results(out)
    assert {key.seed: found[key].vs == 1234.5 for key in found} == {1: False, 2: True, 3: True}


def test_another_number_of_broken_bonds_is_a_conflict(part: Callable[..., Path], tmp_path: Path) -> None:
    """Counts contradict each other as velocities do."""
    first, other = (part(f"{count}.db", {1, 2}, broken_bonds=count) for count in (0, 2))
    with pytest.raises(CampaignMismatchError, match="different: broken_bonds"):
        merge_databases([str(first), str(other)], tmp_path / "none.db")


def test_another_configuration_is_refused(part: Callable[..., Path], tmp_path: Path) -> None:
    """Campaigns of different physics are refused with the difference, and nothing is written."""
    first, other = part("a.db", {1}), tmp_path / "other.db"
    with Store(first, read_only=True) as store:
        record = store.use_campaign()
    with Store(other) as store:
        changed = record.config.replace('"damping":0.3', '"damping":0.2')
        assert changed != record.config
        store.begin_campaign(replace(record, hash=canonical_hash(json.loads(changed)), config=changed))
    with pytest.raises(CampaignMismatchError, match=r"wave\.damping: 0\.3 -> 0\.2"):
        merge_databases([str(first), str(other)], tmp_path / "out.db")


def test_another_packing_is_refused(part: Callable[..., Path], complete: Path, tmp_path: Path) -> None:
    """Campaigns whose disks lie elsewhere are refused although their configurations are equal; both are named."""
    first, other = part("a.db", {1}), tmp_path / "other.db"
    with Store(complete, read_only=True) as whole, Store(other) as store:
        store.begin_campaign(whole.use_campaign())
        record = whole.packing()
        assert record is not None
        packing = stored_packing(record)
        moved = replace(packing, x=packing.x * (1 + 1e-15))
        store.save_packing(packing_record(moved, index=0, packing_hash=record.hash))
    hashes = f"{packing.content_hash} in database 1 and {moved.content_hash} in database 2"
    with pytest.raises(CampaignMismatchError, match=rf"{hashes}.*\n?.*CALCIDEM_CACHE"):
        merge_databases([str(first), str(other)], tmp_path / "out.db")
    assert not (tmp_path / "out.db").exists()


def test_a_record_that_was_edited_is_another_packing(part: Callable[..., Path], tmp_path: Path) -> None:
    """Disks that no longer are those of the packing's state are not taken for the packing."""
    first, other = part("a.db", {1}), part("b.db", {2})
    with open_campaign(other) as campaign:
        record, packing = campaign.record, campaign.packing()
    with Store(tmp_path / "edited.db") as store:
        store.begin_campaign(record)
        store.save_packing(replace(packing, x=packing.x * (1 + 1e-15)))
    with pytest.raises(CampaignMismatchError, match="CALCIDEM_CACHE"):
        merge_databases([str(first), str(tmp_path / "edited.db")], tmp_path / "out.db")


def test_cells_on_an_unknown_packing_are_refused(part: Callable[..., Path], tmp_path: Path) -> None:
    """A database that has lost its packing cannot be merged: nobody knows what its cells were computed on."""
    first, other = part("a.db", {1}), part("b.db", {2})
    with sqlite3.connect(other) as connection:
        connection.execute("DELETE FROM packing")
    connection.close()
    with pytest.raises(CampaignMismatchError, match=r"Packing 0, on which .* missing in database 2"):
        merge_databases([str(first), str(other)], tmp_path / "out.db")


def test_another_physics_version_is_refused(part: Callable[..., Path], tmp_path: Path) -> None:
    """Campaigns of two physics versions are refused in a sentence that names both."""
    first, other = part("a.db", {1}), tmp_path / "other.db"
    with Store(first, read_only=True) as store:
        record = store.use_campaign()
    config = json.loads(record.config)
    stored = config["physics_version"]
    config["physics_version"] = stored + 1
    with Store(other) as store:
        store.begin_campaign(replace(record, hash=canonical_hash(config), config=canonical_json(config)))
    with pytest.raises(CampaignMismatchError, match=f"version {stored} in database 1 and {stored + 1} in database 2"):
        merge_databases([str(first), str(other)], tmp_path / "out.db")


def test_a_file_that_is_there_is_not_replaced(part: Callable[..., Path], tmp_path: Path) -> None:
    """The merged database never takes the place of another file."""
    (tmp_path / "out.db").write_text("precious")
    with pytest.raises(ForeignDatabaseError, match=r"out\.db"):
        merge_databases([str(part("a.db", {1}))], tmp_path / "out.db")
    assert (tmp_path / "out.db").read_text() == "precious"
