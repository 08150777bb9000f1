"""A damaged database: it is named, nothing is written to it, and nobody sees a traceback."""

import os
import sqlite3
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from calcidem.app.campaign.run import run
from calcidem.app.config.schema import Configuration
from calcidem.storage.errors import DamagedStoreError

sys.path.append(str(Path(__file__).parent / "programs"))

import damage

Invoke = Callable[..., str]


def damage_table(path: Path, table: str) -> None:
    """Overwrite the first page of a table."""
    with sqlite3.connect(path) as connection:
        ((page,),) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", (table,)).fetchall()
    connection.close()
    with path.open("r+b") as file:
        file.seek((page - 1) * 4096)
        file.write(os.urandom(4096))


def test_a_damaged_file_is_named_and_left_alone(
    complete: Path, invoke: Invoke, as_configured: Callable[[Path], Configuration]
) -> None:
    """Verify --integrity finds the damage; a run on a file that was left open refuses it, and names the remedy."""
    assert invoke("verify", complete, "--integrity") == "No damage was found.\n"
    damage_table(complete, "result")
    found = invoke("verify", complete, "--integrity", exit_code=1)
    assert str(complete) in found
    assert "'calcidem import' an earlier export" in found
    Path(f"{complete}.lock").write_text("calcidem")  # as after a kill
    before = complete.read_bytes()
    with pytest.raises(DamagedStoreError, match=str(complete)):
        run(as_configured(complete))
    assert complete.read_bytes() == before


def test_a_cell_without_its_attempts_is_shown(troubled: Path, invoke: Invoke) -> None:
    """Status shows what went wrong even if the database has lost how often it was tried."""
    with sqlite3.connect(troubled, isolation_level=None) as connection:
        connection.execute("DELETE FROM attempt")
    connection.close()
    assert "computes cells that are quarantined again" in invoke("status", troubled)


@pytest.mark.parametrize("count", [7, pytest.param(500, marks=pytest.mark.full)])
def test_single_damages_give_no_tracebacks(tmp_path: Path, count: int) -> None:
    """Of many single damages (bytes, pages, header, values, truncation) each is read, or told in a sentence."""
    damage.make_database(tmp_path / "good.db")
    found = [damage.damage_and_judge(tmp_path / "good.db", tmp_path, number) for number in range(count)]
    assert [(kind, place, wrong) for kind, place, _, wrong in found if wrong] == []
