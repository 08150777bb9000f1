"""What a run would do, told without doing any of it."""

from collections.abc import Iterator
from contextlib import nullcontext

from calcidem.app.campaign.identity import choose_campaign
from calcidem.app.campaign.packing import kept_packing
from calcidem.app.campaign.parts import planned_batches
from calcidem.app.campaign.stored_packing import readable_packing
from calcidem.app.config.calibrated import calibration_note
from calcidem.app.config.checks import check_against_packing, packing_warnings
from calcidem.app.config.schema import Configuration
from calcidem.storage.records import CellKey, CellStatus
from calcidem.storage.sql.engine import parse_address
from calcidem.storage.sql.store import open_store
from calcidem.storage.store import Selection


def preview_lines(configuration: Configuration) -> Iterator[str]:
    """Check a configuration against its database and packing, if there are any, and say what a run would compute.

    Raises
    ------
    ConfigurationError
        If the packing can't hold what is planned.
    StoreError
        If the database can't be read, or has another campaign of that name, or this one under another.
    """
    plan, address = configuration.campaign, parse_address(configuration.database)
    is_new = address.path is not None and not address.path.exists()
    own = [CellKey(*cell) for batch in planned_batches(configuration) for cell in batch.cells]
    part = "" if configuration.run.part is None else f", {len(own)} of them in part {configuration.run.part}"
    packing, settled = None, 0
    with nullcontext() if is_new else open_store(configuration.database, read_only=True) as store:
        if store is not None and choose_campaign(store, configuration):
            statuses = store.statuses(Selection(plan.seed_numbers))  # a content may be new
            settled = sum(statuses.get(key, CellStatus.PENDING) is not CellStatus.PENDING for key in own)
            if store.packing_indices():
                packing = readable_packing(store, 0)
    packing = packing or kept_packing(configuration.packing_hash, lambda _: None)
    cells = len(plan.seed_numbers) * len(plan.contents)
    yield (
        f"Campaign {plan.name}: {len(plan.seed_numbers)} seeds x {len(plan.contents)} contents = {cells} cells{part}, "
        f"{settled} of them settled; {len(own) - settled} would be computed, {configuration.run.lanes} side by side."
    )
    yield f"Database: {address}{', new' if is_new else ''}"
    if note := calibration_note(configuration):
        yield note
    if packing is None:
        yield "Packing: not made yet, so whether it holds these contents and this wave is checked when the run begins."
        return
    check_against_packing(configuration, packing)
    for warning in packing_warnings(configuration, packing):
        yield f"Warning: {warning}."
    yield f"Packing: {len(packing.radius)} disks, which hold these contents and this wave."
