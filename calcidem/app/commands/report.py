"""``calcidem report``, ``analyse`` and ``show``: what a campaign says, as a page, as files, and cell by cell."""

from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from calcidem.app.report import analyse, show_cell, write_report
from calcidem.app.run_command import make_console

Database = Annotated[str, typer.Argument(metavar="DB", help="SQLite file or database URL.")]
CampaignName = Annotated[str | None, typer.Option("--campaign", help="Which one, if the database has several.")]


def report(
    database: Database,
    out: Annotated[Path, typer.Option(metavar="FILE.html", help="Page to write or replace.")] = Path("report.html"),
    campaign: CampaignName = None,
) -> None:
    """Write one self-contained page: what was run, tables, figures, what failed, errors and run time."""
    typer.echo(f"Wrote {write_report(database, out, campaign_name=campaign)}")


def analyse_campaign(
    database: Database,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files; made if it is missing.")] = Path(
        "analysis"
    ),
    campaign: CampaignName = None,
) -> None:
    """Write all figures (PNG, SVG, PDF), tables (CSV) and numbers (NetCDF) of a campaign into a folder."""
    missing = analyse(database, out, campaign_name=campaign)
    for name, reason in missing.items():
        typer.echo(f"left out {name}: {reason}")
    typer.echo(f"Wrote {len(list(out.iterdir()))} files into {out}")


def show(
    database: Database,
    seed: Annotated[int, typer.Option(help="Seed of the cell.")],
    content: Annotated[float, typer.Option(help="Content of the cell, percent.")],
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for its figures.")] = None,
    campaign: CampaignName = None,
) -> None:
    """Show one cell: what was measured, and with --out its packing, cement, path and signals as figures."""
    described, files = show_cell(database, seed, content, out, campaign_name=campaign)
    table = Table(*described.header, title=described.caption, title_justify="left", box=SIMPLE_HEAD)
    for row in described.rows:
        table.add_row(*row)
    make_console().print(table)
    for file in files:
        typer.echo(f"Wrote {file}")
