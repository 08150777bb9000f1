"""See results: ``calcidem status``, ``report``, ``serve``, ``query`` and ``show``."""

import io
import json
import math
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from calcidem.app.cli.options import (
    HIGHEST_SEED,
    CampaignName,
    Database,
    OnlyContents,
    OnlySeeds,
    number_parser,
    percent_option,
    progress_bar,
    say,
)
from calcidem.app.cli.output import Format, FormatOption, RecordRows, WholeTable, tell_rows
from calcidem.ends import CellStatus, Verdict
from calcidem.storage.records import Selection
from calcidem.wording import ABSENT, EXCEPTIONAL, decimal, pluralize, printable, readable_unit, significant, tell

if TYPE_CHECKING:
    from calcidem.app.campaign.status import CampaignStatus


def status_command(
    database: Database,
    watch: Annotated[bool, typer.Option("--watch", help="Refresh until every cell has finished.")] = False,
    interval: Annotated[
        float,
        typer.Option(
            parser=number_parser(0.1, 86400.0, "is not a number of seconds from 0.1 to 86400"),
            help="Seconds between refreshes with --watch.",
        ),
    ] = 2.0,
    layout: FormatOption = Format.TABLE,
    campaign: CampaignName = None,
) -> None:
    """Show the progress of a campaign, also while it runs: cells, Vs so far, time left, failures."""
    from calcidem.app.campaign.status import CampaignStatus

    def until_finished() -> Iterator[CampaignStatus]:
        while True:
            found = CampaignStatus.read(database, campaign)
            yield found
            if not (watch and found.pending):
                return
            time.sleep(interval)

    try:
        _show_status(until_finished(), layout, watch=watch)
    except KeyboardInterrupt:
        typer.echo()


def _show_status(statuses: "Iterator[CampaignStatus]", layout: Format, *, watch: bool) -> None:
    """Show each status of a campaign, on a terminal replacing the former one."""
    from calcidem.app.cli.output import PLAIN_WIDTH
    from calcidem.app.cli.views import status_as_json, status_view

    if layout is not Format.TABLE:
        for found in statuses:
            whole = status_as_json(found)
            if watch and layout is Format.JSON:
                typer.echo(json.dumps(whole))
            else:
                tell_rows([row | row["cells"] for row in whole["contents"]], layout, whole=whole)
        return
    console = Console(highlight=False)
    if not (watch and console.is_terminal):
        width = console.width if console.is_terminal else PLAIN_WIDTH
        for found in statuses:
            Console(highlight=False, width=width).print(status_view(found, width))
        return
    with Live(Group(), console=console, auto_refresh=False) as live:  # whole at the end, before what the screen holds
        for found in statuses:
            live.update(status_view(found, console.width), refresh=True)


def report_command(
    database: Database,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Page to write or replace; DB.html beside the database if not given."),
    ] = None,
    with_studies: Annotated[
        bool, typer.Option("--with-studies", help="Compute and include studies of frequency and damping.")
    ] = False,
    files: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for figures (PNG, SVG, PDF), tables (CSV) and numbers (NetCDF)."),
    ] = None,
    figure: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Only this figure for --files, such as vs_range (repeatable)."),
    ] = None,
    measured: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Laboratory velocities, a row for each specimen or mean: content, Vs (or G0 and density), and sd, "
            "samples, confining stress.",
        ),
    ] = None,
    campaign: CampaignName = None,
) -> None:
    """Write one self-contained page: configuration, tables, figures, failures, errors and run time."""
    from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES
    from calcidem.app.config.reader import read_targets
    from calcidem.app.report.page import unnamed_page, write_report
    from calcidem.storage.files import refuse_to_replace
    from calcidem.storage.sql.store import read_campaign

    names = [entry.name for entry in CAMPAIGN_FIGURES]
    if figure and (files is None or not set(figure) <= set(names)):
        raise typer.BadParameter(f"give --files, and names of {', '.join(names)}", param_hint="--figure")
    if out is None:
        with read_campaign(database, campaign) as store:
            out = unnamed_page(store)
    refuse_to_replace(out)
    if out.suffix.lower() not in {".html", ".htm"}:
        raise typer.BadParameter(f"{out}: a report is a page; give it the ending .html", param_hint="--out")
    targets = read_targets(measured, tell) if measured else ()
    studies = None
    if with_studies:
        from calcidem.app.studies.sensitivity import run_studies

        studies = run_studies(database, campaign_name=campaign)
    with progress_bar("Report") as watch:
        page = write_report(
            database,
            out,
            campaign_name=campaign,
            studies=studies,
            measured=targets,
            files=files,
            figures=figure or (),
            watch=watch,
        )
    say(f"Wrote {page}")


def serve_command(
    databases: Annotated[list[str], typer.Argument(metavar="DB...", help="SQLite files or database URLs.")],
    campaign: Annotated[
        list[str] | None,
        typer.Option("--campaign", metavar="NAME", help="Campaigns of a database that has several (repeatable)."),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0 for any free one.")] = 0,
    host: Annotated[str, typer.Option(metavar="HOST", help="Address to listen on.")] = "127.0.0.1",
    wait: Annotated[
        bool, typer.Option("--wait", help="Wait for databases and campaigns that do not exist yet.")
    ] = False,
) -> None:
    """Show campaigns side by side in the browser, also while they run.

    The printed address has a secret token. Ctrl-C ends the server. Databases are only read.
    """
    from calcidem.app.serve import PageAddress

    address = PageAddress.take(host, port)
    from calcidem.app.serve.server import LivePage

    if campaign and len(databases) > 1:
        raise typer.BadParameter("give one database with it", param_hint="--campaign")
    names: list[str | None] = list(campaign) if campaign else [None]
    wanted = [(database, name) for database in databases for name in names]

    def tell() -> None:
        say(f"Live page: {address.url}")
        sys.stdout.flush()

    LivePage(wanted, address).serve(tell, wait=wait)
    sys.stdout.flush()
    os._exit(0)  # without waiting for a thread that reads a slow or locked database


def query_command(
    database: Database,
    content: OnlyContents = None,
    seed: OnlySeeds = None,
    status: Annotated[list[CellStatus] | None, typer.Option(help="Only this status (repeatable).")] = None,
    where: Annotated[str | None, typer.Option(help='Filter such as "vs > 1500 and clusters >= 40".')] = None,
    columns: Annotated[str, typer.Option(help='Columns, or "all".')] = "seed,content,status,vs,vs_error,seconds",
    sort: Annotated[str, typer.Option(help='Columns to sort by, such as "-vs,seed"; "-" means descending.')] = "",
    limit: Annotated[int | None, typer.Option(min=0, max=2**63 - 1, help="Most rows to show.")] = None,
    layout: FormatOption = Format.TABLE,
    out: Annotated[Path | None, typer.Option(help="File to write; .csv, .json or .parquet choose the format.")] = None,
    campaign: CampaignName = None,
) -> None:
    """Show the cells that meet all conditions."""
    from calcidem.app.cli.views import pulse_remark
    from calcidem.storage.files import refuse_to_replace, write_text_atomically
    from calcidem.storage.records import QUANTITY_BY_NAME, depends_on_pulse
    from calcidem.storage.sql.store import read_campaign

    if out is not None:
        refuse_to_replace(out)
        if layout is Format.TABLE:  # the ending chooses
            layouts = {".json": Format.JSON, ".csv": Format.CSV, ".parquet": Format.PARQUET, ".txt": Format.TABLE}
            if out.suffix.lower() not in layouts:
                raise typer.BadParameter(f"{out} ends with none of {', '.join(layouts)}", param_hint="--out")
            layout = layouts[out.suffix.lower()]
    selection = Selection(seed or None, content or None, status or None, where)
    names = tuple(QUANTITY_BY_NAME) if columns == "all" else tuple(dict.fromkeys(_split_list(columns)))
    with read_campaign(database, campaign) as store:
        wanted = tuple(dict.fromkeys((*names, "pulse_effect"))) if "vs" in names else names
        found = store.table(wanted, selection, sort=_split_list(sort), limit=limit)
        rows = as_rows({name: found[name] for name in names})
    remark = pluralize(len(rows), "cell") if rows else "0 cells; 'calcidem status DB' has the seeds and contents"
    if "vs" in names and (loud := int(depends_on_pulse(found["pulse_effect"]).sum())):
        remark += f"; {pulse_remark(loud)}"
    if layout is not Format.TABLE:
        tell_rows(rows, layout, out, names=names)
    elif out is None:
        width = Console().width if sys.stdout.isatty() else 100_000
        typer.echo(_as_table(_headings(names), rows, remark, width), nl=False)
    else:
        write_text_atomically(out, _as_table(_headings(names), rows, remark))
    if out is not None:
        say(f"Wrote {out}: {remark}")


def _split_list(text: str) -> list[str]:
    """Parts of a list separated by commas."""
    return [part.strip() for part in text.split(",") if part.strip()]


def as_rows(columns: Mapping[str, NDArray[Any]]) -> RecordRows:
    """Columns by quantity as rows of Python objects; missing real numbers are NaN, other missing values None."""
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


def _as_table(headings: Mapping[str, bool], rows: RecordRows, remark: str, width: int = 100_000) -> str:
    """Rows in aligned columns, no wider than needed; folded if they are wider than a terminal."""
    table = WholeTable(box=None, pad_edge=False, header_style="bold")
    for heading, numeric in headings.items():
        table.add_column(Text(heading), justify="right" if numeric else "left", no_wrap=numeric)
    table.kept = 2 if {*list(headings)[:2]} == {"seed", "content [percent]"} else 1
    for row in rows:
        table.add_row(*(Text(_format_value(value)) for value in row.values()))
    stream = io.StringIO()
    # Rich cuts columns to the width of the terminal; a table in a pipe must stay complete.
    Console(file=stream, width=width, highlight=False).print(table, Text(remark))
    return "".join(f"{line.rstrip()}\n" for line in stream.getvalue().splitlines())


def _format_value(value: object) -> str:
    """Value for people: six digits, the first line of a text, nothing for a missing value."""
    if value is None or value != value:  # noqa: PLR0124 - NaN
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    return printable(value).partition("\n")[0]


def show_command(
    database: Database,
    seed: Annotated[int, typer.Option(min=0, max=HIGHEST_SEED, help="Seed of the cell.")],
    content: Annotated[float, percent_option("Calcite content of the cell.")],
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the figures of the cell.")] = None,
    movie: Annotated[Path | None, typer.Option(metavar="FILE", help="Movie of the wave, .gif or .mp4.")] = None,
    frames: Annotated[int, typer.Option(min=2, help="Most frames of the movie, at 15 a second.")] = 90,
    layout: FormatOption = Format.TABLE,
    campaign: CampaignName = None,
) -> None:
    """Show one cell: its quantities, or why it has no velocity and what may give one.

    With --out also figures: cement, path, signals, section.
    """
    from calcidem.storage.records import QUANTITY_BY_NAME, depends_on_pulse
    from calcidem.storage.sql.store import read_campaign

    with read_campaign(database, campaign) as store:
        store.cell(seed=seed, content=content)  # raises an error if there is none
        (row,) = as_rows(store.table(tuple(QUANTITY_BY_NAME), Selection(seeds=(seed,), contents=(content,))))
    if layout is Format.TABLE:
        from calcidem.app.cli.output import make_console, make_table
        from calcidem.app.cli.views import pulse_remark

        table = make_table(f"Seed {seed} at {content:g} %.", "quantity", "value")
        for meaning, value in _cell_rows(row):
            table.add_row(meaning, Text(printable(value)))
        if depends_on_pulse(row["pulse_effect"]):
            table.add_row("warning", pulse_remark(1))
        if verdict := Verdict.of(row["reason"] or ""):
            table.add_row("remedy", verdict.remedy)
        make_console().print(table)
    else:
        tell_rows([row], layout)
    if out is None and movie is None:
        return
    from calcidem.analysis.campaign_analysis import UnavailableError
    from calcidem.analysis.figures.style import save
    from calcidem.app.campaign.opened import open_campaign

    with open_campaign(database, campaign) as opened:
        plot = opened.plot
        if out is not None:
            figures = {"cement": plot.cement, "path": plot.path, "signals": plot.signal, "section": plot.section}
            for name, draw in figures.items():
                with suppress(UnavailableError):  # the cell lacks what the figure needs
                    for file in save(draw(seed=seed, content=content), out, f"seed{seed}_content{content:g}_{name}"):
                        say(f"Wrote {file}", err=layout is not Format.TABLE)
        if movie is not None:
            with progress_bar("Movie") as watch:
                plot.movie(movie, seed=seed, content=content, frames=frames, watch=watch)
            say(f"Wrote {movie}", err=layout is not Format.TABLE)


def _cell_rows(row: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Meanings and values, with units, of the quantities of a cell that it has."""
    from calcidem.storage.records import QUANTITY_BY_NAME

    for name, value in row.items():
        quantity = QUANTITY_BY_NAME[name]
        if quantity.kind == "text":
            text = str(value or "")
        else:
            is_share = quantity.meaning.startswith("relative")
            text = decimal(value) if quantity.kind == "whole" else significant(100 * value if is_share else value, 4)
            text += " %" if is_share and text != ABSENT else ""
        if text in {"", ABSENT} or (name in EXCEPTIONAL and not value):
            continue
        yield quantity.meaning, text if quantity.kind == "text" else f"{text} {readable_unit(quantity.unit)}".rstrip()
