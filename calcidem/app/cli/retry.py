"""``calcidem retry``: give cells that went wrong another chance."""

from collections import Counter
from collections.abc import Collection, Sequence
from typing import Annotated

import typer

from calcidem.app.campaign.retry import RETRIABLE, retry_cells
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
    campaign: CampaignName = None,
) -> None:
    """Make cells that went wrong pending again; the next 'calcidem run' computes them.

    Their history is kept, but workers lost to them before no longer count against them.
    """
    statuses = tuple(status or RETRIED_BY_DEFAULT)
    wrong = [chosen.value for chosen in statuses if chosen not in RETRIABLE]
    if wrong:
        possible = ", ".join(RETRIABLE)
        raise typer.BadParameter(
            f"{', '.join(wrong)} can't be retried; choose among {possible}.", param_hint="--status"
        )
    try:
        selection = Selection(seed or None, content or None)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--content") from error
    pending, others = retry_cells(database, statuses, selection, campaign)
    for line in _retry_lines(pending, others, statuses):
        typer.echo(line)


def _retry_lines(
    pending: Sequence[CellKey], others: Counter[CellStatus], statuses: Collection[CellStatus]
) -> tuple[str, ...]:
    """What was done, for a person."""
    rest = ", ".join(f"{number} {status}" for status, number in sorted(others.items()))
    if not pending:
        return (f"Nothing to retry: no selected cell is {' or '.join(statuses)} ({rest}).",)
    named = [f"  seed {key.seed}, {key.content:g} %" for key in pending[:_MOST_LISTED]]
    if len(pending) > _MOST_LISTED:
        named.append(f"  and {len(pending) - _MOST_LISTED} more")
    cells = "1 cell is" if len(pending) == 1 else f"{len(pending)} cells are"
    return (f"{cells} pending again:", *named, "Compute them with the same 'calcidem run' as before.")
