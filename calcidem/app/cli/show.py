"""``calcidem show``: a closer look at one cell."""

from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from calcidem.app.cli.arguments import CampaignName, Database, OneContent, OneSeed
from calcidem.app.cli.terminal import printable


def show_command(
    database: Database,
    seed: OneSeed,
    content: OneContent,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the figures of the cell.")] = None,
    campaign: CampaignName = None,
) -> None:
    """Show one cell: what was measured and, with --out, its packing, cement, path and signals as figures."""
    from calcidem.app.cli.tables import make_console
    from calcidem.app.report import show_cell

    described, figures = show_cell(database, seed, content, out, campaign_name=campaign)
    table = Table(*described.header, title=described.caption, title_justify="left", box=SIMPLE_HEAD)
    for row in described.rows:
        table.add_row(*(Text(printable(entry)) for entry in row))
    make_console().print(table)
    for file in figures:
        typer.echo(f"Wrote {file}")
