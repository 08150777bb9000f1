"""Giving cells that went wrong another chance."""

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager

from calcidem.storage.errors import StoreUnavailableError, UnknownCellError
from calcidem.storage.records import STORED_STATUSES, CellKey, CellStatus
from calcidem.storage.sql.engine import parse_address
from calcidem.storage.sql.store import Store, open_store
from calcidem.storage.store import RETRIED_BY_DEFAULT, Selection

RETRIABLE = tuple(status for status in STORED_STATUSES if status is not CellStatus.DONE)
"""Outcomes that can be given up for another attempt."""


def retry_cells(
    database: str,
    statuses: Collection[CellStatus] = RETRIED_BY_DEFAULT,
    selection: Selection | None = None,
    campaign_name: str | None = None,
) -> tuple[tuple[CellKey, ...], Counter[CellStatus]]:
    """Make the selected cells of these outcomes pending again.

    Parameters
    ----------
    database, campaign_name
        SQLite file or database URL; which campaign, if there are several.
    statuses
        Of `RETRIABLE`.
    selection
        Seeds and contents; all by default.

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
    with _open_for_retry(database, campaign_name) as store:
        found = store.statuses(selection or Selection())
        if not found:
            raise UnknownCellError(
                "No planned cell has such a seed and content.", "'calcidem status DB' shows which there are."
            )
        store.acquire_lease()
        pending = store.retry(statuses, list(found))
    others = Counter(status for key, status in found.items() if key not in set(pending))
    return pending, others


def retry_damaged_cells(database: str, campaign_name: str | None = None) -> dict[CellKey, str]:
    """Make all cells pending again whose stored outcome is not what was stored.

    Returns
    -------
    dict of CellKey to str
        These cells, and what was damaged of each.

    Raises
    ------
    StoreError
        As `retry_cells`; `DamagedStoreError` if the file is so damaged that nothing can be changed in it.
    """
    with _open_for_retry(database, campaign_name) as store:
        store.acquire_lease()
        damaged = store.integrity().cells
        store.retry_damaged(list(damaged))
    return damaged


@contextmanager
def _open_for_retry(database: str, campaign_name: str | None) -> Iterator[Store]:
    """Open a campaign that is there for writing."""
    path = parse_address(database).path
    if path is not None and not path.exists():
        raise StoreUnavailableError(f"{path} does not exist.", "Check the name; 'calcidem run' creates a database.")
    with open_store(database) as store:
        store.use_campaign(campaign_name)
        yield store
