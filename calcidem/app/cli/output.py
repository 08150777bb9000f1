"""Results on a terminal or in a file: tables for people, or JSON, CSV and Parquet for programs."""

import csv
import io
import json
import sys
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Column, Table
from rich.text import Text

from calcidem.app.cli.options import say
from calcidem.sweep.ranks import launcher
from calcidem.wording import printable

if TYPE_CHECKING:
    from calcidem.app.studies.study import StudyResult


Format = StrEnum("Format", ["TABLE", "JSON", "CSV", "PARQUET"])

FormatOption = Annotated[Format, typer.Option("--format", help="Output: a table for people, or rows for programs.")]

RecordRows = Sequence[Mapping[Any, Any]]
"""Rows with the same names; None or NaN where a value is missing, Python numbers instead of NumPy's."""


def tell_rows(
    rows: RecordRows, layout: Format, out: Path | None = None, *, names: Sequence[str] = (), whole: object = None
) -> None:
    """Write rows as JSON, CSV or Parquet.

    Parameters
    ----------
    rows
        Values to write; only JSON has those that are neither numbers nor texts.
    layout
        Format other than the table.
    out
        File to write; standard output by default.
    names
        Names of the columns if there are no rows.
    whole
        Value for JSON instead of the rows.
    """
    if layout is Format.JSON:
        told: str | bytes = (
            json.dumps(_json_value(rows if whole is None else whole), indent=1, ensure_ascii=False) + "\n"
        )
    elif layout is Format.CSV:
        told = _as_csv(_flat(rows, names), names)
    else:
        if out is None and sys.stdout.isatty():
            raise typer.BadParameter("parquet is binary: write it to a file with > FILE.parquet", param_hint="--format")
        told = _as_parquet(_flat(rows, names), names)
    if out is not None:
        from calcidem.storage.files import write_atomically

        with write_atomically(out) as temporary:
            temporary.write_bytes(told.encode() if isinstance(told, str) else told)
    else:
        typer.echo(printable(told) if isinstance(told, str) else told, nl=False)


def tell_study(result: "StudyResult", layout: Format, table: Path | None) -> None:
    """Show the result of a study, and write its files: the table, and others beside it."""
    if table is not None:
        list(result.write(table))
    if layout is Format.TABLE:
        tell_tables(result.text)
    else:
        tell_rows(result.rows, layout, whole=json.loads(result.json))


def tell_tables(text: str) -> None:
    """Write sentences and Markdown tables, separated by empty lines; on a terminal as tables that fit it."""
    console = make_console()
    if not console.is_terminal:
        typer.echo(text)
        return
    for block in text.strip().split("\n\n"):
        if not block.startswith("| "):
            say(block)
            continue
        head, _, *rows = (line[2:-2].split(" | ") for line in block.split("\n"))
        table = make_table(None, *head)
        for row in rows:
            table.add_row(*(Text(cell.replace("<br>", "\n").replace("**", "")) for cell in row))
        console.print(table)


def _json_value(value: Any) -> Any:  # noqa: ANN401 - whatever is in a row
    """A value with null for numbers that JSON lacks, and without types of NumPy."""
    from pydantic_core import to_jsonable_python

    return to_jsonable_python(value, inf_nan_mode="null", fallback=lambda scalar: scalar.item())


def _flat(rows: RecordRows, names: Sequence[str]) -> list[dict[str, Any]]:
    """Numbers and texts of rows, with the same names in each."""
    left_out = {name for row in rows for name, value in row.items() if isinstance(value, Mapping | list | tuple)}
    wanted = dict.fromkeys([*names, *(str(name) for row in rows for name in row if name not in left_out)])
    return [{name: row.get(name) for name in wanted} for row in rows]


def _as_csv(rows: RecordRows, names: Sequence[str]) -> str:
    """Rows as CSV, with texts that spreadsheets do not evaluate."""
    from calcidem.storage.files import spreadsheet_value

    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(rows[0] if rows else names)
    writer.writerows([spreadsheet_value(value) for value in row.values()] for row in _json_value(rows))
    return stream.getvalue()


def _as_parquet(rows: RecordRows, names: Sequence[str]) -> bytes:
    """Rows as Parquet; whole numbers stay whole even if some are missing."""
    import pandas as pd

    frame = pd.DataFrame(list(rows), columns=list(rows[0]) if rows else list(names))
    for name in frame.columns:
        given = [row[name] for row in rows if row[name] is not None]
        if given and all(type(value) is int for value in given):
            frame[name] = pd.array([row[name] for row in rows], dtype="Int64")
    stream = io.BytesIO()
    try:
        frame.to_parquet(stream, index=False)
    except ImportError as error:
        raise typer.BadParameter(
            "parquet needs a library that isn't installed: pip install 'calcidem[parquet]'", param_hint="--format"
        ) from error
    return stream.getvalue()


PLAIN_WIDTH = 110
"""Number of columns without a terminal."""


def make_console() -> Console:
    """Console for results; launchers give their ranks a pseudo-terminal that nobody sees."""
    if launcher() is None and sys.stdout.isatty():
        return Console(highlight=False)
    return Console(highlight=False, force_terminal=False, width=PLAIN_WIDTH)


class WholeTable(Table):
    """Table that folds into several below each other, each with the first columns, rather than cut a number."""

    kept = 1
    """Number of these columns."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render it, or the tables that it folds into."""
        if self.__rich_measure__(console, options.update(max_width=1000)).maximum <= options.max_width:
            yield from super().__rich_console__(console, options)
            return
        kept, others = self.columns[: self.kept], self.columns[self.kept :]
        groups: list[list[Column]] = [[]]
        for column in others:
            if groups[-1] and 1 + sum(map(_least_width, [*kept, *groups[-1], column])) > options.max_width:
                groups.append([])
            groups[-1].append(column)
        for number, group in enumerate(groups):
            part = Table(box=self.box, title=None if number else self.title, title_justify="left")
            for column in (*kept, *group):
                width = None if _is_text(column) else _least_width(column) - _BORDER
                part.add_column(column.header, justify=column.justify, width=width, overflow="fold")
            for row in zip(*(column.cells for column in (*kept, *group)), strict=True):
                part.add_row(*row)
            yield part
        if self.caption is not None:
            yield self.caption


_BORDER = 3
"""Characters of a column's border and padding."""


def _least_width(column: Column) -> int:
    """Characters that a column needs, with its border: whole numbers, the words of a heading or a text each alone."""
    cells = [cell.plain if isinstance(cell, Text) else str(cell) for cell in column.cells]
    texts = [str(column.header), *(cells if _is_text(column) else ())]
    words = [word for text in texts for word in text.split()]
    return max(map(cell_len, words if _is_text(column) else words + cells), default=0) + _BORDER


def _is_text(column: Column) -> bool:
    """Whether lines of a column may break between words."""
    return column.justify == "left" and not column.no_wrap


def make_table(title: str | None, *names: str, numbers: Sequence[str] = ()) -> WholeTable:
    """Table for people with columns of texts, followed by columns of numbers."""
    table = WholeTable(*names, title=title, title_justify="left", caption_justify="left", box=SIMPLE_HEAD)
    for name in numbers:
        table.add_column(name, justify="right")
    return table
