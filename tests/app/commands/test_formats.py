"""`--format`: every command that answers in a table also answers in rows for programs."""

import csv
import io
import json
from collections.abc import Callable
from inspect import signature
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from calcidem.app.cli.main import PANELS, _build_application, command_function
from calcidem.app.cli.output import Format, _as_csv, _as_parquet, _flat

Invoke = Callable[..., str]

ANSWERS = {
    "status": ((), 5),
    "query": ((), 40),
    "show": (("--seed", "1", "--content", "5"), 1),
    "predict": ((), 4),
}
"""Options of commands, and rows of their answers on the tutorial's database."""

COMPUTE = {"accuracy", "stability", "verify"}
"""Commands that compute for longer than they write."""


def test_no_command_in_a_table_is_left_out() -> None:
    """A new command with `--format` needs a line above."""
    names = [name for commands in PANELS.values() for name in commands]
    assert {
        name for name in names if "layout" in signature(command_function(name)).parameters
    } == ANSWERS.keys() | COMPUTE


@pytest.mark.parametrize("command", ANSWERS)
def test_all_formats_have_the_same_rows(command: str, database: Path, invoke: Invoke) -> None:
    """CSV, JSON and Parquet have as many rows, of the same cells; numbers are those of JSON to the last bit."""
    options, count = ANSWERS[command]
    words = [command, database, *options, "--format"]
    told = json.loads(invoke(*words, "json"))
    rows = told["contents"] if command == "status" else told
    table = list(csv.DictReader(io.StringIO(invoke(*words, "csv"))))
    binary = CliRunner().invoke(_build_application(), [*map(str, words), "parquet"])
    frame = pd.read_parquet(io.BytesIO(binary.stdout_bytes))
    assert len(rows) == len(table) == len(frame) == count
    assert list(frame.columns) == list(table[0])
    for row, line, content in zip(rows, table, frame["content"], strict=True):
        assert row["content"] == float(line["content"]) == content


def test_a_prediction_is_in_the_rows(database: Path, invoke: Invoke) -> None:
    """Programs get what a person reads: the velocity of the sample with its interval, beside the check."""
    words = ("predict", database, "--content", 5)
    (row,) = json.loads(invoke(*words, "--format", "json"))
    assert row["vs_interval_low"] < row["vs"] < row["vs_interval_high"]
    assert f"5 %: Vs {row['vs']:.0f} m/s" in invoke(*words)
    (row,) = json.loads(invoke("predict", database, "--content", 0, "--format", "json"))  # which has no check
    assert row["vs"] > 0.0


@pytest.mark.full  # of the same figures test_report.py draws one of each kind in every run
def test_show_draws_in_every_format(database: Path, tmp_path: Path, invoke: Invoke) -> None:
    """Figures do not depend on the format of the rows."""
    words = ("show", database, "--seed", 1, "--content", 5, "--out", tmp_path / "figures", "--format", "json")
    (row,) = json.loads(invoke(*words).partition("]")[0] + "]")
    assert row["seed"] == 1
    names = {file.stem for file in (tmp_path / "figures").iterdir()}
    assert names == {f"seed1_content5_{name}" for name in ("cement", "path", "signals", "section")}


def test_rows_of_different_names_have_all_columns() -> None:
    """What a row lacks is empty; what has parts of its own is left out; a formula is no formula for a spreadsheet."""
    rows = _flat([{"a": 1, "list": [1], "text": "=1"}, {"a": None, "b": float("nan")}], ())
    assert _as_csv(rows, ()) == "a,text,b\n1,'=1,\n,,\n"
    frame = pd.read_parquet(io.BytesIO(_as_parquet(rows, ())))
    assert frame["a"].dtype == "Int64"


def test_no_rows_have_columns(database: Path, invoke: Invoke) -> None:
    """A query that finds nothing gives the names of its columns."""
    words = ("query", database, "--where", "vs > 1e6", "--columns", "seed,vs", "--format")
    assert invoke(*words, Format.CSV.value) == "seed,vs\n"
    assert json.loads(invoke(*words, Format.JSON.value)) == []
    assert invoke("verify", database, "--integrity", "--format", Format.CSV.value) == "damage\n"


def test_a_low_terminal_shows_the_head_once(database: Path, invoke: Invoke, monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole status stands at the end, below what of it fits while it is watched."""
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    monkeypatch.setenv("LINES", "6")
    monkeypatch.setenv("COLUMNS", "80")
    whole = invoke("status", database)
    assert whole.count("seeds x") == 1
    first, *_, last = invoke("status", database, "--watch").split("\x1b[1A")
    assert first.count("\n") < 6 < last.count("\n"), "lines above the screen would be written again"
