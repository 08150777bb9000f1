"""``calcidem show``: a closer look at one cell."""

from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from calcidem.app.cli.arguments import CampaignName, Database, OneContent, OneSeed
from calcidem.app.cli.formats import Format, FormatOption, tell_rows
from calcidem.app.cli.terminal import printable, progress_bar


def show_command(
    database: Database,
    seed: OneSeed,
    content: OneContent,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the figures of the cell.")] = None,
    movie: Annotated[Path | None, typer.Option(metavar="FILE", help="Movie of the wave, .gif or .mp4.")] = None,
    frames: Annotated[int, typer.Option(min=2, help="Most frames of the movie, at 15 a second.")] = 90,
    layout: FormatOption = Format.TABLE,
    campaign: CampaignName = None,
) -> None:
    """Show one cell: its quantities and, with --out, its packing, cement, path and signals as figures."""
    if layout is Format.TABLE:
        from calcidem.app.cli.tables import make_console
        from calcidem.app.report.one_cell import describe_cell

        described = describe_cell(database, seed, content, campaign_name=campaign)
        table = Table(*described.header, title=described.caption, title_justify="left", box=SIMPLE_HEAD)
        for row in described.rows:
            table.add_row(*(Text(printable(entry)) for entry in row))
        make_console().print(table)
    else:
        from calcidem.app.cli.query import quantities_row

        tell_rows([quantities_row(database, seed, content, campaign)], layout)
    if out is not None:
        from calcidem.app.report.cell_figures import draw_cell

        for file in draw_cell(database, seed, content, out, campaign_name=campaign):
            typer.echo(f"Wrote {file}", err=layout is not Format.TABLE)
    if movie is not None:
        from calcidem.app.campaign.opened import open_campaign

        with open_campaign(database, campaign) as opened, progress_bar("Movie") as watch:
            opened.plot.movie(movie, seed=seed, content=content, frames=frames, watch=watch)
        typer.echo(f"Wrote {movie}", err=layout is not Format.TABLE)
