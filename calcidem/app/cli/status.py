"""``calcidem status``: progress of a campaign, also during its run."""

import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console, Group
from rich.live import Live

from calcidem.app.cli.arguments import CampaignName, Database, number_parser
from calcidem.app.cli.formats import Format, FormatOption, tell_rows

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.app.campaign.status import CampaignStatus


def status_command(
    database: Database,
    watch: Annotated[bool, typer.Option("--watch", help="Refresh until every cell has finished.")] = False,
    interval: Annotated[
        float,
        typer.Option(
            parser=number_parser(0.1, 86400.0, "is not a number of seconds from 0.1 to 86400"),
            help="Seconds between two refreshes with --watch.",
        ),
    ] = 2.0,
    half_width: Annotated[
        float | None,
        typer.Option(
            "--halfwidth",
            parser=number_parser(1e-6, 1e6, "is not a number above 0, from 1e-6 to 1e6"),
            metavar="M/S",
            help="Also estimate the seeds and the time for 95 % intervals of the means with this half-width.",
        ),
    ] = None,
    layout: FormatOption = Format.TABLE,
    campaign: CampaignName = None,
) -> None:
    """Show the progress of a campaign, also while it runs: cells, Vs so far, time left, failures."""
    from calcidem.app.campaign.status import CampaignStatus

    read = partial(CampaignStatus.read, database, campaign)
    found = _until_finished(read, interval) if watch else iter([read()])
    try:
        _show_status(found, half_width, layout, one_per_line=watch)
    except KeyboardInterrupt:
        typer.echo()


def _until_finished(read: "Callable[[], CampaignStatus]", interval: float) -> "Iterator[CampaignStatus]":
    """Status of a campaign at intervals of some seconds, until all its cells have finished."""
    while True:
        found = read()
        yield found
        if not found.pending:
            return
        time.sleep(interval)


def _show_status(
    statuses: "Iterator[CampaignStatus]", half_width: float | None, layout: Format, *, one_per_line: bool
) -> None:
    """Show each status of a campaign, on a terminal replacing the former one."""
    from calcidem.app.cli.status_view import status_as_json, status_view
    from calcidem.app.cli.tables import PLAIN_WIDTH

    if layout is not Format.TABLE:
        for found in statuses:
            whole = status_as_json(found, half_width)
            if one_per_line and layout is Format.JSON:
                typer.echo(json.dumps(whole))
            else:
                tell_rows([row | row["cells"] for row in whole["contents"]], layout, whole=whole)
        return
    console = Console(highlight=False)
    if not console.is_terminal:
        for found in statuses:
            Console(highlight=False, width=PLAIN_WIDTH).print(status_view(found, PLAIN_WIDTH, half_width))
        return
    with Live(Group(), console=console, auto_refresh=False, vertical_overflow="visible") as live:
        for found in statuses:
            live.update(status_view(found, console.width, half_width), refresh=True)
