"""``calcidem retry``: give cells that went wrong another chance."""

from collections import Counter
from collections.abc import Collection, Sequence
from typing import Annotated

import typer

from calcidem.storage.errors import StoreUnavailableError, UnknownCellError
from calcidem.storage.records import STORED_STATUSES, CellKey, CellStatus
from calcidem.storage.sql.engine import parse_address
from calcidem.storage.sql.store import open_store
from calcidem.storage.store import RETRIED_BY_DEFAULT, Selection, Store

RETRIABLE = tuple(status for status in STORED_STATUSES if status is not CellStatus.DONE)
"""Outcomes that can be given up for another attempt."""

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


def retry_cells(
    database: str,
    statuses: Collection[CellStatus] = RETRIED_BY_DEFAULT,
    selection: Selection | None = None,
    campaign_name: str | None = None,
) -> tuple[tuple[CellKey, ...], Counter[CellStatus]]:
    """Make the selected cells of these outcomes pending again.

    Parameters
    ----------
    database
        SQLite file or database URL.
    statuses
        Of `RETRIABLE`.
    selection
        Seeds and contents; all by default.
    campaign_name
        Which one, if there are several.

    Returns
    -------
    tuple of CellKey
        The cells that are pending again.
    Counter of CellStatus
        What the other selected cells are.

    Raises
    ------
    StoreError
        `LeaseHeldError` while a run writes the campaign, since it would not notice; `StoreUnavailableError` if there
        is no such file; `UnknownCellError` if no planned cell has the seed and content.
    """
    path = parse_address(database).path
    if path is not None and not path.exists():
        raise StoreUnavailableError(f"{path} does not exist.", "Check the name; 'calcidem run' creates a database.")
    with open_store(database) as store:
        store.use_campaign(campaign_name)
        found = selected_statuses(store, selection or Selection())
        store.acquire_lease()
        pending = store.retry(statuses, list(found))
    others = Counter(status for key, status in found.items() if key not in set(pending))
    return pending, others


def selected_statuses(store: Store, selection: Selection) -> dict[CellKey, CellStatus]:
    """Status of each planned cell that is selected.

    Raises
    ------
    UnknownCellError
        If there is none.
    """
    found = store.statuses(selection)
    if not found:
        raise UnknownCellError(
            "No planned cell has such a seed and content.", "'calcidem status DB' shows which there are."
        )
    return found


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
