"""`calcidem query`: filters, columns, sorting, formats, and no way to smuggle SQL in."""

import csv
import hashlib
import io
import json
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calcidem.app.campaign.opened import Campaign
from calcidem.app.cli.results import _as_table, as_rows
from calcidem.ends import CellStatus
from calcidem.storage.errors import QueryError
from calcidem.storage.records import QUANTITY_BY_NAME, Selection

Invoke = Callable[..., str]

# Pieces of which attacks and mistakes are made; hypothesis adds any other text.
PIECES = (
    *("vs", "seed", "status", "cell", "result", " > ", "=", "==", " in ", "(", ")", ",", "'", '"', ";", "--", "/*"),
    *("*/", "%", "\\", "\0", "\n", "1", "-1", "1e999", "9" * 30, "NULL", "None", " or ", " and ", "not ", "True"),
    *("DROP TABLE cell", "UNION SELECT", "x' OR '1'='1", "); DELETE FROM result; --", "load_extension('x')"),
    *("__import__('os')", "lambda: 0", "vs.real", "vs[0]", "f'{vs}'", "b'x'", "\ud800", "±", "1j", "..."),
)
hostile = st.one_of(st.text(max_size=40), st.lists(st.sampled_from(PIECES), max_size=9).map("".join))


def test_filters_and_columns(database: Path, invoke: Invoke, campaign: Campaign) -> None:
    """Filters choose the cells that the Python API chooses, and columns come in the order asked for."""
    text = invoke("query", database, "--content", 5, "--where", "vs > 1300", "--columns", "vs,seed", "--format", "csv")
    rows = list(csv.DictReader(io.StringIO(text)))
    expected = list(campaign.select(content=5.0, where="vs > 1300"))
    assert expected
    assert [(row["vs"], row["seed"]) for row in rows] == [(repr(cell.vs), str(cell.key.seed)) for cell in expected]


def test_sorting_and_limit(database: Path, invoke: Invoke, campaign: Campaign) -> None:
    """A descending sort with a limit gives the largest values, and numbers survive JSON to the last bit."""
    cells = json.loads(invoke("query", database, "--sort", "-vs,seed", "--limit", 3, "--format", "json"))
    fastest = sorted((cell.vs for cell in campaign.select(status="done") if cell.vs is not None), reverse=True)[:3]
    assert [cell["vs"] for cell in cells] == fastest


def test_missing_values_come_last(campaign: Campaign) -> None:
    """Cells without a value are last whichever way is up."""
    for sort in ("vs_cross_correlation", "-vs_cross_correlation"):
        found = campaign.store.table(("vs_cross_correlation",), sort=(sort,))["vs_cross_correlation"]
        missing = pd.isna(found)
        assert missing.tolist() == sorted(missing.tolist())


def test_table_shows_units(database: Path, invoke: Invoke) -> None:
    """The table has names, units, one line a cell and their number, and is never cut to the terminal's width."""
    lines = invoke("query", database, "--seed", 1, "--seed", 2, "--columns", "all").splitlines()
    assert "vs [m s-1]" in lines[0]
    assert all(quantity.name in lines[0] for quantity in QUANTITY_BY_NAME.values())
    assert len(lines) == 1 + 10 + 1
    assert lines[-1] == "10 cells"


def test_parquet(database: Path, invoke: Invoke, campaign: Campaign, tmp_path: Path) -> None:
    """Parquet files hold the same table as pandas users get, with the types of its columns."""
    file = tmp_path / "cells.parquet"
    invoke("query", database, "--columns", "all", "--format", "parquet", "--out", file)
    pd.testing.assert_frame_equal(pd.read_parquet(file), campaign.to_dataframe(), check_dtype=False)
    assert pd.read_parquet(file)["steps"].dtype == "Int64"


def test_out_writes_a_file(database: Path, invoke: Invoke, tmp_path: Path) -> None:
    """With --out the answer goes into a file, the same as is shown without; its ending chooses the format."""
    for name, layout in (("cells.csv", "csv"), ("cells.JSON", "json"), ("cells.txt", "table")):
        file = tmp_path / name
        assert invoke("query", database, "--out", file) == f"Wrote {file}: 40 cells\n"
        assert file.read_text() == invoke("query", database, "--format", layout)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--where", "vss > 1"), "Did you mean 'vs'"),
        (("--columns", "vss"), "Did you mean 'vs'"),
        (("--columns", "seed,velocity"), "Unknown quantities: velocity"),
        (("--sort", "-velocity"), "Unknown quantities: velocity"),
        (("--columns", ","), "Give columns"),
    ],
)
def test_mistakes_are_explained(database: Path, invoke: Invoke, arguments: tuple[str, str], message: str) -> None:
    """What can't be understood is refused with its cure."""
    with pytest.raises(QueryError, match=message):
        invoke("query", database, *arguments)


def digest(path: Path) -> str:
    """Return the checksum of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(where=hostile, name=hostile)
def test_no_text_gets_through_as_sql(campaign: Campaign, where: str, name: str) -> None:
    """Any text as filter, column or order selects planned cells or is refused; nothing else ever happens."""
    before = digest(campaign.store.address.path)  # type: ignore[attr-defined]  # a SQLite store
    everything = 40
    for columns, selection, sort in (
        (("seed",), Selection(where=where), ()),
        ((name,), Selection(), ()),
        (("seed",), Selection(), (name,)),
    ):
        try:
            found = campaign.store.table(columns, selection, sort=sort, limit=10**6)
        except QueryError:
            continue
        assert all(len(values) <= everything for values in found.values())
        json.dumps(as_rows(found))
    assert digest(campaign.store.address.path) == before  # type: ignore[attr-defined]  # as above


def test_deep_nesting_is_refused(campaign: Campaign) -> None:
    """A filter nested deeper than Python's parser goes is refused like any other that can't be read."""
    for where in ("(" * 500 + "vs > 1" + ")" * 500, "not " * 2000 + "vs > 1", "vs > 1 or " * 5000 + "vs > 1"):
        with pytest.raises(QueryError):
            list(campaign.select(where=where))


def test_statuses_are_words_of_the_program(database: Path, invoke: Invoke) -> None:
    """The option --status takes the known outcomes only."""
    assert "40 cells" in invoke("query", database, *(f"--status={status}" for status in CellStatus))
    assert "hostile" in invoke("query", database, "--status", "hostile", exit_code=2)


def test_a_table_wider_than_a_terminal_folds() -> None:
    """Every number is whole, and each part has the first column; a pipe has one line for each row."""
    rows = [{"seed": 1, **{f"column_{number}": 1234.5 + number for number in range(8)}}]
    headings = dict.fromkeys(rows[0], True)
    lines = _as_table(headings, rows, "1 cell", 60).splitlines()
    assert max(map(len, lines)) <= 60
    assert {f"{value:g}" for value in rows[0].values()} == {
        word for line in lines[:-1] for word in line.split() if word[0].isdigit()
    }
    assert len(_as_table(headings, rows, "1 cell").splitlines()) == 3


def test_parts_of_a_wide_table_have_seed_and_content_and_break_texts() -> None:
    """Otherwise the rows of a seed could not be told apart, and a long reason would leave no room for the seed."""
    row = {"seed": 32, "content": 5.0, "status": "no_arrival", "reason": "the receiver has no peak " * 6}
    headings = {"seed": True, "content [percent]": True, "status": False, "reason": False}
    lines = _as_table(headings, [row], "1 cell; with a remark that is longer than 40", 40).splitlines()
    assert max(map(len, lines)) <= 40
    parts = [line.split()[:2] for line in lines if line.lstrip().startswith("seed")]
    assert len(parts) == sum(line.split()[:2] == ["32", "5"] for line in lines) == 2
