"""Tables on terminals of any width."""

import sys
from io import StringIO

import pytest
from rich.console import Console

from calcidem.app.cli.output import make_table, tell_tables


@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_no_number_is_cut_at_any_width(width: int) -> None:
    """Each number of each column stands whole beside its content, in lines that fit."""
    numbers = ("content %", "done", "mean m/s", "sd m/s", "effective m/s", "its sd m/s", "G0 MPa", "L/lambda")
    table = make_table("Shear-wave velocity", numbers=numbers)
    table.add_column("other cells")
    table.caption = "one sentence"
    rows = [[f"{10 * row + column}.{9876 - row}" for column in range(len(numbers))] for row in range(1, 4)]
    for row in rows:
        table.add_row(*row, "2 no arrival")
    console = Console(file=StringIO(), width=width, force_terminal=False)
    console.print(table)
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert max(map(len, lines)) <= width
    for row in rows:
        found = [word for line in lines if line.split()[:1] == row[:1] for word in line.split()]
        assert set(row) <= set(found)
    assert sum("one sentence" in line for line in lines) == sum("Shear-wave" in line for line in lines) == 1
    assert "…" not in "".join(lines)


def test_a_number_that_does_not_fit_goes_on_below() -> None:
    """Where even one number is wider than the terminal, its digits fold and none is lost."""
    table = make_table(None, numbers=("content %", "mean m/s"))
    table.add_row("5", "1234567.8")
    console = Console(file=StringIO(), width=15, force_terminal=False)
    console.print(table)
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    assert "…" not in shown
    assert set("1234678") <= set(shown)


def test_a_terminal_gets_tables_of_a_study_that_fit_and_a_pipe_its_markdown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each row has its cells, empty ones included, and prose is broken between words."""
    row = "| | 1200 ± 30<br>+5 %, **x 1** | 0 |  |".replace("| |", "|  |")
    told = f"Prose {'of words ' * 12}\n\n| {' | '.join(f'a heading {n}' for n in range(4))} |\n|---|---|---|---|\n{row}"
    tell_tables(told)
    assert capsys.readouterr().out == f"{told}\n"
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setenv("TERM", "dumb")
    tell_tables(told)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 60
    assert ["1200", "±", "30", "0"] in [line.split() for line in lines]
    assert "|" not in "".join(lines)
