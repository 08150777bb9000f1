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
    movie: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Compute the wave again as moving pictures, .gif or .mp4.")
    ] = None,
    frames: Annotated[int, typer.Option(min=2, help="Most frames of the movie; 15 are shown in a second.")] = 90,
    campaign: CampaignName = None,
) -> None:
    """Show one cell: what was measured and, with --out, its packing, cement, path and signals as figures.

    With --movie its wave goes through the sample: colour is the velocity of the disks, lines are cemented contacts.
    """
    from calcidem.app.cli.tables import make_console
    from calcidem.app.report.one_cell import describe_cell

    described = describe_cell(database, seed, content, campaign_name=campaign)
    table = Table(*described.header, title=described.caption, title_justify="left", box=SIMPLE_HEAD)
    for row in described.rows:
        table.add_row(*(Text(printable(entry)) for entry in row))
    make_console().print(table)
    if out is not None:
        from calcidem.app.report.cell_figures import draw_cell

        for file in draw_cell(database, seed, content, out, campaign_name=campaign):
            typer.echo(f"Wrote {file}")
    if movie is not None:
        _make_movie(database, campaign, seed, content, movie, frames)


def _make_movie(database: str, campaign: str | None, seed: int, content: float, file: Path, frames: int) -> None:
    """Write the movie of a cell, and show on a terminal how far that is."""
    from rich.console import Console
    from rich.progress import Progress

    from calcidem.app.campaign.opened import open_campaign

    with (
        open_campaign(database, campaign) as opened,
        Progress(console=Console(stderr=True), transient=True) as progress,
    ):
        task = progress.add_task("Movie")

        def watch(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        opened.plot.movie(file, seed=seed, content=content, frames=frames, watch=watch)
    typer.echo(f"Wrote {file}")
