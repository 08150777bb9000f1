"""``calcidem query``: the cells of a database that meet some conditions, as a table or a file."""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
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
    features: Annotated[
        bool,
        typer.Option("--features", help="Not the cells but how their path features go with Vs, with corrected p."),
    ] = False,
    campaign: CampaignName = None,
) -> None:
    """Show the cells of a campaign that meet all given conditions.

    With --features: Pearson's correlation of each path feature with Vs within one content, its 95 % interval, p by
    exchanging seeds at random, and p corrected for the number of features.
    """
    from calcidem.storage.records import QUANTITY_BY_NAME

    selection = Selection(seed or None, content or None, status or None, where)
    if features:
        if columns is not None or sort or limit is not None or layout is Format.PARQUET:
            raise typer.BadParameter(
                "goes with neither --columns, --sort, --limit nor parquet", param_hint="--features"
            )
        _show(_features_text(database, selection, layout, campaign), out)
        return
    names = _DEFAULT_COLUMNS if columns is None else tuple(dict.fromkeys(_split_list(columns)))
    names = tuple(QUANTITY_BY_NAME) if columns == "all" else names
    found = find(database, selection, names, _split_list(sort), limit, campaign)
    if layout is Format.PARQUET:
        if out is None:
            raise QueryError("Parquet is a binary format.", "Give a file with --out.")
        _write_parquet(found, out)
    else:
        _show(_as_text(found, layout), out)


def _show(text: str, out: Path | None) -> None:
    """Write a text to a file, or show it."""
    from calcidem.storage.files import write_text_atomically

    if out is not None:
        write_text_atomically(out, text)
    else:
        typer.echo(printable(text), nl=False)


def _features_text(database: str, selection: Selection, layout: Format, campaign_name: str | None) -> str:
    """How path features of the selected cells go with Vs within one content."""
    from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError, feature_correlations
    from calcidem.app.campaign.patterns import with_patterns
    from calcidem.storage.sql.store import read_campaign

    with read_campaign(database, campaign_name) as store:
        try:
            found = feature_correlations(CampaignAnalysis(store, with_cement=with_patterns), selection)
        except UnavailableError as error:
            raise QueryError(f"Features have nothing to go with: {error}.", "Select cells with a velocity.") from error
    rows = [
        (name, *(None if math.isnan(value) else value for value in values))
        for name, *values in found.to_dataframe().itertuples(name=None)
    ]
    headings = {"feature": False} | {str(name): True for name in found.data_vars}
    remark = f"{pluralize(found.attrs['samples'], 'cell')} with a velocity and features"
    return _rows_as_text(headings, rows, layout, remark)


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
    from calcidem.storage.records import QUANTITY_BY_NAME

    rows = list(zip(*(_plain_values(name, values) for name, values in columns.items()), strict=True))
    if layout is not Format.TABLE:
        return _rows_as_text(dict.fromkeys(columns, True), rows, layout)
    headings = {}
    for name in columns:
        quantity = QUANTITY_BY_NAME[name]
        bare = quantity.unit == "1" and quantity.kind == "real"  # a fraction or a ratio, and no percent
        unit = " [-]" if bare else f" [{quantity.unit}]" if quantity.unit not in {"", "1"} else ""
        headings[f"{name}{unit}"] = quantity.kind != "text"
    return _rows_as_text(headings, rows, layout, pluralize(len(rows), "cell"))


def _rows_as_text(headings: Mapping[str, bool], rows: Sequence[Sequence[Any]], layout: Format, remark: str = "") -> str:
    """Rows in a layout; `headings` say what stands above them, and whether it is of numbers."""
    if layout is Format.JSON:
        return json.dumps([dict(zip(headings, row, strict=True)) for row in rows], indent=1, ensure_ascii=False) + "\n"
    if layout is Format.CSV:
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(headings)
        writer.writerows([spreadsheet_value(value) for value in row] for row in rows)
        return stream.getvalue()
    return _as_table(headings, rows, remark)


def _plain_values(name: str, values: NDArray[Any]) -> list[Any]:
    """Values of a column as Python's own, None where missing."""
    from calcidem.storage.records import QUANTITY_BY_NAME

    kind = QUANTITY_BY_NAME[name].kind
    if kind == "text":
        return list(values)
    number = int if kind == "whole" else float
    return [None if math.isnan(value) else number(value) for value in values.tolist()]


def _as_table(headings: Mapping[str, bool], rows: Sequence[Sequence[Any]], remark: str) -> str:
    """Rows in aligned columns; no wider than the numbers need."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading, numeric in headings.items():
        table.add_column(Text(heading), justify="right" if numeric else "left", no_wrap=True)
    for row in rows:
        table.add_row(*(Text(_format_value(value)) for value in row))
    stream = io.StringIO()
    # Rich cuts columns to the width of the terminal; a table that is piped on must stay whole.
    Console(file=stream, width=100_000, highlight=False).print(table)
    lines = (line.rstrip() for line in stream.getvalue().splitlines())
    return "\n".join([*lines, remark, ""])


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
