"""A damaged database: what is good is read, what is not is named and made anew, and nobody sees a traceback."""

import sqlite3
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from calcidem.app.campaign.run import retry_cells
from calcidem.app.config.schema import Configuration
from calcidem.storage.records import STATUS_CODES, CellKey, CellStatus
from calcidem.storage.sql.store import Store

sys.path.append(str(Path(__file__).parent / "programs"))

import damage

Invoke = Callable[..., str]


def change(path: Path, *statements: str) -> None:
    """Change the cell of seed 1 and 5 % behind the store's back."""
    with sqlite3.connect(path, isolation_level=None) as connection:
        for statement in statements:
            connection.execute(f"{statement} WHERE cell_id = (SELECT id FROM cell WHERE seed = 1 AND content = 5.0)")  # noqa: S608 - a test's own
    connection.close()


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE result SET vs = vs * (1 + 1e-15)",
        "UPDATE arrays SET content = substr(content, 1, 30) || x'00' || substr(content, 32)",
    ],
)
def test_one_damaged_cell_is_named_exported_as_missing_and_made_anew(
    complete: Path, tmp_path: Path, invoke: Invoke, as_configured: Callable[[Path], Configuration], statement: str
) -> None:
    """Verify --integrity names it, export flags it and has all others, run --retry damaged makes it pending."""
    assert "40 cells: 0 damaged, 0 other damages." in invoke("verify", complete, "--integrity")
    with Store(complete, read_only=True) as store:
        store.use_campaign()
        read = sum(result.vs is not None for result in store.results())
    change(complete, statement)
    found = invoke("verify", complete, "--integrity", exit_code=1)
    assert "seed 1, 5 %: its " in found
    assert "40 cells: 1 damaged, 0 other damages." in found
    invoke("export", complete, tmp_path / "out.nc")
    with xr.open_dataset(tmp_path / "out.nc") as dataset:
        assert int((dataset["status"] == STATUS_CODES[CellStatus.DAMAGED]).sum()) == 1
        assert np.isnan(dataset["vs"].sel(seed=1, content=5.0))
        assert int(dataset["vs"].count()) == read - 1 > 0
    assert retry_cells(as_configured(complete), [CellStatus.DAMAGED]) == (CellKey(1, 5.0),)
    assert retry_cells(as_configured(complete), [CellStatus.DAMAGED]) == ()
    with Store(complete, read_only=True) as store:
        store.use_campaign()
        assert [(key.seed, key.content) for key in store.pending()] == [(1, 5.0)]


def test_damaged_cells_are_shown_and_can_be_selected(complete: Path, invoke: Invoke) -> None:
    """Status counts those without a true velocity, and a query by status lists all of them without any number."""
    change(complete, "UPDATE result SET vs = 1.0")
    assert "1 damaged" in invoke("status", complete)
    change(complete, "UPDATE result SET vs = 1.0, vs_peak = 1.0")
    found = invoke("query", complete, "--status", "damaged", "--columns", "seed,content,vs,reason", "--format", "csv")
    assert found.splitlines()[1:] == ["1,5.0,,its numbers were changed after they had been stored"]


def test_a_cell_without_its_attempts_is_shown(troubled: Path, invoke: Invoke) -> None:
    """Status shows what went wrong even if the database has lost how often it was tried."""
    with sqlite3.connect(troubled, isolation_level=None) as connection:
        connection.execute("DELETE FROM attempt")
    connection.close()
    assert "computes cells that are quarantined again" in invoke("status", troubled)


@pytest.mark.parametrize("number", ["'text'", "1.0000000001", "4611686018427387904", "x'ff'"])
def test_a_damaged_number_of_an_attempt_is_not_counted_on(troubled: Path, invoke: Invoke, number: str) -> None:
    """Status and the next attempt do not count on what no attempt has as its number; verify names it."""
    with sqlite3.connect(troubled, isolation_level=None) as connection:
        connection.execute("PRAGMA ignore_check_constraints=ON")
        connection.execute(f"UPDATE attempt SET number = {number} WHERE number = 1")  # noqa: S608 - a test's own
    connection.close()
    assert "computes cells that are quarantined again" in invoke("status", troubled)
    with Store(troubled, read_only=True) as store:
        store.use_campaign()
        assert {count.attempts for count in store.attempt_counts().values()} <= {0, 1, 2, 3}
    assert "An attempt at seed" in invoke("verify", troubled, "--integrity", exit_code=1)


@pytest.mark.parametrize("count", [7, pytest.param(500, marks=pytest.mark.full)])
def test_single_damages_give_neither_tracebacks_nor_wrong_values(tmp_path: Path, count: int) -> None:
    """Of many single damages (bytes, pages, header, values, truncation) none is taken for what was stored."""
    damage.make_database(tmp_path / "good.db")
    values = damage.original_values(tmp_path / "good.db")
    found = [damage.damage_and_judge(tmp_path / "good.db", values, tmp_path, number) for number in range(count)]
    assert [(kind, place, wrong) for kind, place, _, wrong in found if wrong] == []
