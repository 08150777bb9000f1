"""``calcidem retry``: give cells that went wrong another chance."""

from collections import Counter
from collections.abc import Collection, Sequence
from typing import Annotated

import typer

from calcidem.app.campaign.retry import RETRIABLE, retry_cells
from calcidem.storage.records import CellKey, CellStatus
from calcidem.storage.store import RETRIED_BY_DEFAULT, Selection

MOST_NAMED = 10
"""Cells that are named one by one; more are only counted."""


def retry(
    database: Annotated[str, typer.Argument(metavar="DB", help="SQLite file or database URL.")],
    status: Annotated[
        list[CellStatus] | None,
        typer.Option(help="Cells of this outcome; may be repeated. By default failed and timed_out."),
    ] = None,
    seed: Annotated[list[int] | None, typer.Option(help="Only this seed; may be repeated.")] = None,
    content: Annotated[list[float] | None, typer.Option(help="Only this content, percent; may be repeated.")] = None,
    campaign: Annotated[str | None, typer.Option("--campaign", help="Which one, if the database has several.")] = None,
) -> None:
    """Make cells that went wrong pending again; the next 'calcidem run' computes them.

    Their history is kept. Workers that they took down before no longer count against them.
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
    for line in retry_lines(pending, others, statuses):
        typer.echo(line)


def retry_lines(
    pending: Sequence[CellKey], others: Counter[CellStatus], statuses: Collection[CellStatus]
) -> tuple[str, ...]:
    """What was done, for a person."""
    rest = ", ".join(f"{number} {status}" for status, number in sorted(others.items()))
    if not pending:
        return (f"Nothing to retry: no selected cell is {' or '.join(statuses)} ({rest}).",)
    named = [f"  seed {key.seed}, {key.content:g} %" for key in pending[:MOST_NAMED]]
    if len(pending) > MOST_NAMED:
        named.append(f"  and {len(pending) - MOST_NAMED} more")
    cells = "1 cell is" if len(pending) == 1 else f"{len(pending)} cells are"
    return (f"{cells} pending again:", *named, "Compute them with the same 'calcidem run' as before.")
