"""``calcidem query``: the cells of a database that meet some conditions, as a table or a file."""

import csv
import io
import json
import math
from collections.abc import Collection, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from rich.text import Text

from calcidem.app.cli.arguments import CampaignName, Database, OnlyContents, OnlySeeds
from calcidem.app.cli.terminal import printable
from calcidem.storage.errors import QueryError
from calcidem.storage.files import spreadsheet_value
from calcidem.storage.records import CellStatus
from calcidem.storage.store import Selection
from calcidem.sweep.progress import pluralize

_DEFAULT_COLUMNS = ("seed", "content", "status", "vs", "vs_error", "seconds")

Columns = Mapping[str, NDArray[Any]]
"""Columns of equal length by the name of their quantity, as `calcidem.storage.store.Store.table` gives them."""


Format = StrEnum("Format", ["TABLE", "CSV", "JSON", "PARQUET"])


def query_command(
    database: Database,
    content: OnlyContents = None,
    seed: OnlySeeds = None,
    status: Annotated[list[CellStatus] | None, typer.Option(help="Only this status; may be repeated.")] = None,
    where: Annotated[str | None, typer.Option(help='Filter such as "vs > 1500 and clusters >= 40".')] = None,
    columns: Annotated[str | None, typer.Option(help='Columns, such as "seed,vs,steps", or "all".')] = None,
    sort: Annotated[str, typer.Option(help='Columns to sort by, such as "-vs,seed"; "-" means descending.')] = "",
    limit: Annotated[int | None, typer.Option(min=0, max=2**63 - 1, help="Show at most this many rows.")] = None,
    layout: Annotated[Format, typer.Option("--format", help="Output format.")] = Format.TABLE,
    out: Annotated[Path | None, typer.Option(help="File to write instead of showing the rows.")] = None,
    campaign: CampaignName = None,
) -> None:
    """Show the cells of a campaign that meet all given conditions."""
    from calcidem.storage.files import write_text_atomically
    from calcidem.storage.records import QUANTITY_BY_NAME

    selection = Selection(seed or None, content or None, status or None, where)
    names = _DEFAULT_COLUMNS if columns is None else tuple(dict.fromkeys(_split_list(columns)))
    names = tuple(QUANTITY_BY_NAME) if columns == "all" else names
    found = find(database, selection, names, _split_list(sort), limit, campaign)
    if layout is Format.PARQUET:
        if out is None:
            raise QueryError("Parquet is a binary format.", "Give a file with --out.")
        _write_parquet(found, out)
    elif out is not None:
        write_text_atomically(out, _as_text(found, layout))
    else:
        typer.echo(printable(_as_text(found, layout)), nl=False)


def find(
    database: str,
    selection: Selection,
    columns: Sequence[str] = _DEFAULT_COLUMNS,
    sort: Sequence[str] = (),
    limit: int | None = None,
    campaign_name: str | None = None,
) -> Columns:
    """Columns of the selected cells, and what is refused: see `calcidem.storage.store.Store.table`."""
    from calcidem.storage.sql.store import read_campaign

    with read_campaign(database, campaign_name) as store:
        return store.table(columns, selection, sort=sort, limit=limit)


def _split_list(text: str) -> list[str]:
    """Parts of a list with commas."""
    return [part.strip() for part in text.split(",") if part.strip()]


def _as_text(columns: Columns, layout: Format) -> str:
    """Columns as a table, CSV or JSON."""
    rows = list(zip(*(_plain_values(name, values) for name, values in columns.items()), strict=True))
    if layout is Format.JSON:
        return json.dumps([dict(zip(columns, row, strict=True)) for row in rows], indent=1, ensure_ascii=False) + "\n"
    if layout is Format.CSV:
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([spreadsheet_value(value) for value in row] for row in rows)
        return stream.getvalue()
    return _as_table(tuple(columns), rows)


def _plain_values(name: str, values: NDArray[Any]) -> list[Any]:
    """Values of a column as Python's own, None where missing."""
    from calcidem.storage.records import QUANTITY_BY_NAME

    kind = QUANTITY_BY_NAME[name].kind
    if kind == "text":
        return list(values)
    number = int if kind == "whole" else float
    return [None if math.isnan(value) else number(value) for value in values.tolist()]


def _as_table(names: Collection[str], rows: Sequence[Sequence[Any]]) -> str:
    """Rows in aligned columns with the units in the head; no wider than the numbers need."""
    from calcidem.storage.records import QUANTITY_BY_NAME

    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in names:
        quantity = QUANTITY_BY_NAME[name]
        bare = quantity.unit == "1" and quantity.kind == "real"  # a fraction or a ratio, and no percent
        unit = " [-]" if bare else f" [{quantity.unit}]" if quantity.unit not in {"", "1"} else ""
        table.add_column(Text(f"{name}{unit}"), justify="left" if quantity.kind == "text" else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(Text(_format_value(value)) for value in row))
    stream = io.StringIO()
    # Rich cuts columns to the width of the terminal; a table that is piped on must stay whole.
    Console(file=stream, width=100_000, highlight=False).print(table)
    lines = (line.rstrip() for line in stream.getvalue().splitlines())
    return "\n".join([*lines, pluralize(len(rows), "cell"), ""])


def _format_value(value: object) -> str:
    """Value as people read it: six digits, the first line of a text, nothing where it is missing."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    return printable(value).partition("\n")[0]


def _write_parquet(columns: Columns, out: Path) -> None:
    """Write columns into a Parquet file, replaced in one step."""
    import pandas as pd

    from calcidem.storage.files import write_atomically
    from calcidem.storage.records import QUANTITY_BY_NAME

    frame = pd.DataFrame({name: np.asarray(values) for name, values in columns.items()})
    frame = frame.astype({name: "Int64" for name in columns if QUANTITY_BY_NAME[name].kind == "whole"})
    try:
        with write_atomically(out) as temporary:
            frame.to_parquet(temporary, index=False)
    except ImportError as error:
        raise QueryError(
            "Writing Parquet needs a library that isn't installed.", "Install it: pip install 'calcidem[parquet]'."
        ) from error
