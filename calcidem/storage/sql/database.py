"""Open database: its file, its transactions, and the chosen campaign."""

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, closing, nullcontext
from pathlib import Path
from typing import Any

from sqlalchemy import Column, Connection, Row, select

from calcidem.storage.errors import (
    DamagedStoreError,
    ForeignDatabaseError,
    StoreUnavailableError,
    UnknownCampaignError,
)
from calcidem.storage.records import CampaignRecord, canonical_content, checked_seed
from calcidem.storage.sql.engine import Address, Connections
from calcidem.storage.sql.tables import CAMPAIGN, CELL, is_empty, prepare_schema
from calcidem.storage.store import Closable


class OpenDatabase(Closable):
    """Base of a `Store`: opens its database, and reads its campaigns.

    Attributes
    ----------
    address : Address
    read_only : bool
    """

    def __init__(self, address: Address, *, read_only: bool = False) -> None:
        self.address = address
        self.read_only = read_only
        self._campaign_id: int | None = None
        self._record: CampaignRecord | None = None
        self._shared: Connection | None = None
        self._closed = False
        _refuse_wrong_file(address, read_only=read_only)
        if not read_only and address.path is not None and address.path.exists() and address.path.stat().st_size:
            # A file of another program is refused before a writing connection changes its journal mode.
            with (
                closing(Connections(address, read_only=True)) as looking,
                looking.transaction(write=False) as connection,
            ):
                is_empty(connection, address)
        self._connections = Connections(address, read_only=read_only)
        try:
            with self._connections.transaction(write=not read_only) as connection:
                statement = prepare_schema(connection, address, read_only=read_only)
            if statement is not None:
                self._connections.execute_on_connect(statement)
            self._file = None if address.path is None else address.path.stat()
        except BaseException:
            self._connections.close()
            raise

    def _reading(self) -> AbstractContextManager[Connection]:
        self._refuse_closed()
        if self._shared is not None:
            return nullcontext(self._shared)
        return self._connections.transaction(write=False)

    def _refuse_closed(self) -> None:
        if self._closed:
            raise StoreUnavailableError(f"{self.address} was closed.", "Open it again to go on with it.")

    def close(self) -> None:
        """Release all connections; a closed store may be closed again."""
        self._closed = True
        self._connections.close()

    @property
    def _campaign(self) -> int:
        if self._campaign_id is None:
            raise UnknownCampaignError("No campaign was chosen.", "Call begin_campaign or use_campaign first.")
        return self._campaign_id

    @property
    def record(self) -> CampaignRecord:
        """The chosen campaign, as read when it was chosen."""
        if self._record is None:
            raise UnknownCampaignError("No campaign was chosen.", "Call begin_campaign or use_campaign first.")
        return self._record

    def campaigns(self) -> tuple[CampaignRecord, ...]:
        """All campaigns, oldest first."""
        with self._reading() as connection:
            found = connection.execute(select(CAMPAIGN).order_by(CAMPAIGN.c.id)).all()
            return tuple(self._campaign_of(connection, row) for row in found)

    def use_campaign(self, name: str | None = None) -> CampaignRecord:
        """Choose an existing campaign; without a name the only one.

        `UnknownCampaignError` if no campaign has this name, or there are several and no name is given.
        """
        with self._reading() as connection:
            found = connection.execute(select(CAMPAIGN).order_by(CAMPAIGN.c.id)).all()
            chosen = [row for row in found if name is None or row.name == name]
            if len(chosen) != 1:
                names = ", ".join(f"'{row.name}'" for row in found) or "none"
                wanted = f"no campaign '{name}'" if name is not None else f"{len(found)} campaigns"
                raise UnknownCampaignError(f"{self.address} has {wanted}.", f"Name one of its campaigns: {names}.")
            self._campaign_id, self._record = chosen[0].id, self._campaign_of(connection, chosen[0])
        return self._record

    @staticmethod
    def _campaign_of(connection: Connection, row: Row[Any]) -> CampaignRecord:
        """Build a campaign with the seeds and contents of its planned cells.

        `DamagedStoreError` if its configuration or its hash was changed.
        """

        def planned(column: Column[Any], normalize: Callable[[Any], Any]) -> Iterable[Any]:
            """Values of a column of the right type; damaged values are left out."""
            found = connection.scalars(select(column).where(CELL.c.campaign_id == row.id).distinct())
            return (value for value in found if is_possible(normalize, value))

        record = CampaignRecord(
            hash=row.hash,
            name=row.name,
            config=row.config,
            contents=tuple(planned(CELL.c.content, canonical_content)),
            seeds=tuple(planned(CELL.c.seed, checked_seed)),
            created=row.created,
        )
        if record.checksum != row.checksum:
            raise DamagedStoreError(
                f"The configuration of campaign '{row.name}', or its hash {row.hash[:12]}, was changed after it had "
                "been stored.",
                "Import an exported file into a new database: its cells may be those of another campaign.",
            )
        return record


def is_possible(normalize: Callable[[Any], object], value: object) -> bool:
    """Whether a function returns a value unchanged."""
    try:
        return bool(normalize(value) == value)
    except (TypeError, ValueError):
        return False


def _refuse_wrong_file(address: Address, *, read_only: bool) -> None:
    """Explain why SQLite is "unable to open database file" at a path."""
    path = address.path
    if path is None:
        return
    if path.is_dir():
        raise StoreUnavailableError(f"{path} is a folder.", "Give a file name.")
    # Not opened: on closing the kernel would take away all locks of this process on the file, also those of a writer.
    if path.exists() and (not path.is_file() or Path("/proc") in path.parents):
        raise ForeignDatabaseError(f"{path} is not a database file.", "Give a file name, not that of a device.")
    if read_only and not path.exists():
        raise StoreUnavailableError(f"{path} does not exist.", "Check the name; 'calcidem run' creates a database.")
    if not path.parent.is_dir():
        raise StoreUnavailableError(f"The folder {path.parent} does not exist.", "Create it, or give another name.")
