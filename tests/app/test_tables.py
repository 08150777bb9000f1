"""Tables on terminals of any width."""

from io import StringIO

import pytest
from rich.console import Console

from calcidem.app.cli.output import make_table


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
