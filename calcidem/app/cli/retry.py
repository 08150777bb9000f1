"""``calcidem retry``: give cells that went wrong another chance."""

from typing import Annotated

import typer

from calcidem.app.campaign.retry import RETRIABLE, retry_cells
from calcidem.app.cli.arguments import CampaignName, Database, OnlyContents, OnlySeeds
from calcidem.storage.records import CellStatus
from calcidem.storage.store import RETRIED_BY_DEFAULT, Selection

_MOST_LISTED = 10
"""Cells that are listed one by one; more are only counted."""


def retry_command(
    database: Database,
    status: Annotated[
        list[CellStatus] | None,
        typer.Option(help="Only cells with this status; may be repeated. By default failed and timed_out."),
    ] = None,
    seed: OnlySeeds = None,
    content: OnlyContents = None,
    campaign: CampaignName = None,
) -> None:
    """Make cells that went wrong pending again; the next 'calcidem run' computes them.

    Their history is kept, but workers lost to them before no longer count against them.
    """
    statuses = tuple(status or RETRIED_BY_DEFAULT)
    if wrong := ", ".join(chosen for chosen in statuses if chosen not in RETRIABLE):
        problem = f"{wrong} can't be retried; choose among {', '.join(RETRIABLE)}."
        raise typer.BadParameter(problem, param_hint="--status")
    selection = Selection(seed or None, content or None)
    pending, others = retry_cells(database, statuses, selection, campaign)
    if not pending:
        rest = ", ".join(f"{number} {other}" for other, number in sorted(others.items()))
        typer.echo(f"Nothing to retry: no selected cell is {' or '.join(statuses)} ({rest}).")
        return
    typer.echo("1 cell is pending again:" if len(pending) == 1 else f"{len(pending)} cells are pending again:")
    for key in pending[:_MOST_LISTED]:
        typer.echo(f"  seed {key.seed}, {key.content:g} %")
    if len(pending) > _MOST_LISTED:
        typer.echo(f"  and {len(pending) - _MOST_LISTED} more")
    typer.echo("Compute them with the same 'calcidem run' as before.")
