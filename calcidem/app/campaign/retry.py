"""Giving cells that went wrong another chance."""

from collections.abc import Collection

from calcidem.app.campaign.identity import choose_campaign
from calcidem.app.config.schema import Configuration
from calcidem.storage.errors import StoreUnavailableError
from calcidem.storage.records import CellKey, CellStatus
from calcidem.storage.sql.engine import Address
from calcidem.storage.sql.store import Store
from calcidem.storage.store import Selection

_RETRIABLE = (CellStatus.FAILED, CellStatus.TIMED_OUT, CellStatus.QUARANTINED, CellStatus.DAMAGED)
"""Outcomes that another attempt may change; cells that are unstable or have no arrival give the same again."""


def retry_cells(configuration: Configuration, outcomes: Collection[CellStatus]) -> tuple[CellKey, ...]:
    """Make the cells of a configuration that have these outcomes (`_RETRIABLE`) pending again, and give them.

    Their history is kept, but workers that were lost to them no longer count against them. `LeaseHeldError` while a run
    writes the campaign, since it would not notice; `StoreUnavailableError` if the database or the campaign does not
    exist; `CampaignMismatchError` if it is another one; `DamagedStoreError` if nothing can be changed in the file.
    """
    path = Address.parse(configuration.database).path
    if path is not None and not path.exists():
        raise StoreUnavailableError(f"{path} does not exist.", "There is nothing to retry; leave --retry out.")
    with Store(configuration.database) as store:
        if not choose_campaign(store, configuration):
            raise StoreUnavailableError(
                f"{configuration.database} has no campaign '{configuration.campaign.name}'.",
                "There is nothing to retry; leave --retry out.",
            )
        store.acquire_lease()
        plan = configuration.campaign
        found = store.statuses(Selection(plan.seed_numbers))
        planned = [key for key in found if key.content in plan.contents]
        settled = [outcome for outcome in outcomes if outcome is not CellStatus.DAMAGED]
        pending = list(store.retry(settled, planned)) if settled else []
        if CellStatus.DAMAGED in outcomes:
            found_damaged, _ = store.integrity()
            damaged = [key for key in found_damaged if key in set(planned)]
            store.retry_damaged(damaged)
            pending += damaged
    return tuple(pending)
