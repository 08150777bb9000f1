"""``calcidem retry``: give cells that went wrong another chance."""

from collections.abc import Sequence
from typing import Annotated

import typer

from calcidem.app.cli.arguments import CampaignName, Database, OnlyContents, OnlySeeds
from calcidem.storage.records import CellKey, CellStatus
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
    damaged: Annotated[
        bool, typer.Option("--damaged", help="Instead: all cells that are no longer what was stored.")
    ] = False,
    campaign: CampaignName = None,
) -> None:
    """Make cells that went wrong pending again; the next 'calcidem run' computes them.

    Their history is kept, but workers lost to them before no longer count against them.
    """
    from calcidem.app.campaign.retry import RETRIABLE, retry_cells, retry_damaged_cells

    if damaged:
        if status or seed or content:
            raise typer.BadParameter("stands alone: all damaged cells are made anew", param_hint="--damaged")
        found = retry_damaged_cells(database, campaign)
        _tell_pending(list(found), f"Nothing is damaged in {database}.")
        return
    statuses = tuple(status or RETRIED_BY_DEFAULT)
    if wrong := ", ".join(chosen for chosen in statuses if chosen not in RETRIABLE):
        problem = f"{wrong} can't be retried; choose among {', '.join(RETRIABLE)}."
        raise typer.BadParameter(problem, param_hint="--status")
    selection = Selection(seed or None, content or None)
    pending, others = retry_cells(database, statuses, selection, campaign)
    rest = ", ".join(f"{number} {other}" for other, number in sorted(others.items()))
    _tell_pending(pending, f"Nothing to retry: no selected cell is {' or '.join(statuses)} ({rest}).")


def _tell_pending(pending: Sequence[CellKey], nothing: str) -> None:
    """Name the cells that are pending again, or say that there are none."""
    if not pending:
        typer.echo(nothing)
        return
    typer.echo("1 cell is pending again:" if len(pending) == 1 else f"{len(pending)} cells are pending again:")
    for key in pending[:_MOST_LISTED]:
        typer.echo(f"  seed {key.seed}, {key.content:g} %")
    if len(pending) > _MOST_LISTED:
        typer.echo(f"  and {len(pending) - _MOST_LISTED} more")
    typer.echo("Compute them with the same 'calcidem run' as before.")
