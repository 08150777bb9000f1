"""``calcidem query``: cells of a database that meet conditions, as a table or a file."""

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from rich.text import Text

from calcidem.app.campaign.notices import printable
from calcidem.app.cli.arguments import CampaignName, Database, OnlyContents, OnlySeeds
from calcidem.app.cli.formats import Format, FormatOption, RecordRows, tell_rows
from calcidem.ends import CellStatus
from calcidem.storage.errors import QueryError
from calcidem.storage.store import Selection
from calcidem.sweep.schedule import pluralize

Columns = Mapping[str, NDArray[Any]]
"""Columns of equal length by name of their quantity, as from `StoreReader.table`."""


def query_command(
    database: Database,
    content: OnlyContents = None,
    seed: OnlySeeds = None,
    status: Annotated[list[CellStatus] | None, typer.Option(help="Only this status; may be repeated.")] = None,
    where: Annotated[str | None, typer.Option(help='Filter such as "vs > 1500 and clusters >= 40".')] = None,
    columns: Annotated[str | None, typer.Option(help='Columns, such as "seed,vs,steps", or "all".')] = None,
    sort: Annotated[str, typer.Option(help='Columns to sort by, such as "-vs,seed"; "-" means descending.')] = "",
    limit: Annotated[int | None, typer.Option(min=0, max=2**63 - 1, help="Most rows to show.")] = None,
    layout: FormatOption = Format.TABLE,
    out: Annotated[Path | None, typer.Option(help="File to write; .csv, .json or .parquet choose the format.")] = None,
    features: Annotated[
        bool,
        typer.Option("--features", help="Show correlations of path features with Vs instead."),
    ] = False,
    campaign: CampaignName = None,
) -> None:
    """Show the cells of a campaign that meet all given conditions.

    --features gives Pearson's correlation within a content, its 95 % interval, p by exchanging seeds at random, and p
    corrected for the number of features.
    """
    from calcidem.storage.records import QUANTITY_BY_NAME
    from calcidem.storage.sql.store import read_campaign

    selection = Selection(seed or None, content or None, status or None, where)
    if features:
        if columns is not None or sort or limit is not None:
            raise typer.BadParameter("goes with neither --columns, --sort nor --limit", param_hint="--features")
        rows, remark = _feature_rows(database, selection, campaign)
        headings = {name: name != "feature" for name in rows[0]}
    else:
        names = tuple(
            dict.fromkeys(_split_list("seed,content,status,vs,vs_error,seconds" if columns is None else columns))
        )
        names = tuple(QUANTITY_BY_NAME) if columns == "all" else names
        with read_campaign(database, campaign) as store:
            rows = as_rows(store.table(names, selection, sort=_split_list(sort), limit=limit))
        headings = _headings(names)
        remark = pluralize(len(rows), "cell")
    if layout is Format.TABLE and out is not None:
        layout = {".json": Format.JSON, ".csv": Format.CSV, ".parquet": Format.PARQUET}.get(out.suffix.lower(), layout)
    if layout is not Format.TABLE:
        tell_rows(rows, layout, out, names=tuple(rows[0]) if features else names)
    elif out is None:
        typer.echo(_as_table(headings, rows, remark), nl=False)
    else:
        from calcidem.storage.files import write_text_atomically

        write_text_atomically(out, _as_table(headings, rows, remark))
    if out is not None:
        typer.echo(f"Wrote {out}: {remark}")


def _feature_rows(database: str, selection: Selection, campaign_name: str | None) -> tuple[RecordRows, str]:
    """Correlation of path features of the selected cells with Vs within one content, and number of cells."""
    from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError, feature_correlations
    from calcidem.app.campaign.patterns import with_patterns
    from calcidem.storage.sql.store import read_campaign

    with read_campaign(database, campaign_name) as store:
        try:
            found = feature_correlations(CampaignAnalysis(store, with_cement=with_patterns), selection)
        except UnavailableError as error:
            raise QueryError(f"Features have nothing to go with: {error}.", "Select cells with a velocity.") from error
    rows = found.to_dataframe().rename_axis("feature").reset_index().to_dict("records")
    return rows, f"{pluralize(found.attrs['samples'], 'cell')} with a velocity and features"


def _split_list(text: str) -> list[str]:
    """Parts of a list separated by commas."""
    return [part.strip() for part in text.split(",") if part.strip()]


def as_rows(columns: Columns) -> RecordRows:
    """Columns as rows of Python objects; missing real numbers are NaN, other missing values None."""
    from calcidem.storage.records import QUANTITY_BY_NAME

    values: list[list[Any]] = []
    for name, column in columns.items():
        kind = QUANTITY_BY_NAME[name].kind
        if kind == "text":
            values.append(list(column))
        elif kind == "whole":
            values.append([None if math.isnan(value) else int(value) for value in column.tolist()])
        else:
            values.append([float(value) for value in column.tolist()])
    return [dict(zip(columns, row, strict=True)) for row in zip(*values, strict=True)]


def _headings(names: Sequence[str]) -> dict[str, bool]:
    """Header of each column of a table, and whether it has numbers."""
    from calcidem.storage.records import QUANTITY_BY_NAME

    headings = {}
    for name in names:
        quantity = QUANTITY_BY_NAME[name]
        bare = quantity.unit == "1" and quantity.kind == "real"  # a fraction or a ratio, not percent
        unit = " [-]" if bare else f" [{quantity.unit}]" if quantity.unit not in {"", "1"} else ""
        headings[f"{name}{unit}"] = quantity.kind != "text"
    return headings


def _as_table(headings: Mapping[str, bool], rows: RecordRows, remark: str) -> str:
    """Rows in aligned columns, no wider than needed."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading, numeric in headings.items():
        table.add_column(Text(heading), justify="right" if numeric else "left", no_wrap=True)
    for row in rows:
        table.add_row(*(Text(_format_value(value)) for value in row.values()))
    stream = io.StringIO()
    # Rich cuts columns to the width of the terminal; a table in a pipe must stay complete.
    Console(file=stream, width=100_000, highlight=False).print(table)
    lines = (line.rstrip() for line in stream.getvalue().splitlines())
    return "\n".join([*lines, remark, ""])


def _format_value(value: object) -> str:
    """Value for people: six digits, the first line of a text, nothing for a missing value."""
    if value is None or value != value:  # noqa: PLR0124 - NaN
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    return printable(value).partition("\n")[0]
