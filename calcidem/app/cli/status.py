"""``calcidem status``: how far a campaign is, also while it runs."""

import json
import time
from collections.abc import Iterator
from typing import Annotated

import typer
from rich.console import Console, Group
from rich.live import Live

from calcidem.app.campaign.status import CampaignStatus, campaign_status, is_being_written
from calcidem.app.cli.status_view import as_json, status_view
from calcidem.storage.campaign import open_stored_campaign

PLAIN_WIDTH = 110
"""Columns where no terminal says how many there are."""


def status(
    database: Annotated[str, typer.Argument(metavar="DB", help="SQLite file or database URL.")],
    watch: Annotated[
        bool, typer.Option("--watch", help="Show it anew until all cells are settled, or Ctrl-C.")
    ] = False,
    interval: Annotated[float, typer.Option(min=0.1, help="Seconds between two looks with --watch.")] = 2.0,
    as_data: Annotated[bool, typer.Option("--json", help="Write it as JSON, one object a line with --watch.")] = False,
    campaign: Annotated[str | None, typer.Option("--campaign", help="Which one, if the database has several.")] = None,
) -> None:
    """Show how far a campaign is: every cell, Vs so far, the time left, and what went wrong."""
    looks = watched(database, campaign, interval) if watch else iter([look(database, campaign)])
    try:
        show(looks, as_data=as_data, one_a_line=watch)
    except KeyboardInterrupt:
        typer.echo()


def look(database: str, campaign_name: str | None = None) -> CampaignStatus:
    """How far a campaign is at this moment.

    Raises
    ------
    StoreError
        If the database can't be read or has no such campaign.
    """
    with open_stored_campaign(database, campaign_name) as campaign:
        return campaign_status(campaign, running=is_being_written(database, campaign.record.name))


def watched(database: str, campaign_name: str | None, interval: float) -> Iterator[CampaignStatus]:
    """Looks at a campaign, so many seconds apart, until all its cells are settled."""
    while True:
        found = look(database, campaign_name)
        yield found
        if not found.pending:
            return
        time.sleep(interval)


def show(looks: Iterator[CampaignStatus], *, as_data: bool, one_a_line: bool) -> None:
    """Show looks at a campaign, on a terminal each in the place of the former."""
    if as_data:
        for found in looks:
            typer.echo(json.dumps(as_json(found), indent=None if one_a_line else 1))
        return
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=PLAIN_WIDTH)
        for found in looks:
            console.print(status_view(found, console.width))
        return
    with Live(Group(), console=console, auto_refresh=False, vertical_overflow="visible") as live:
        for found in looks:
            live.update(status_view(found, console.width), refresh=True)
