"""Connections to a store: address, pragmas of SQLite, real transactions."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, NoSuchModuleError

from calcidem.storage.errors import StoreUnavailableError
from calcidem.storage.sql.filesystem import is_network_filesystem

BUSY_TIMEOUT_SECONDS = 30.0
WAL_SIZE_LIMIT_BYTES = 64 * 2**20

WRITES = "calcidem_writes"
"""Execution option of a connection whose next transaction is going to write."""


@dataclass(frozen=True, slots=True)
class Address:
    """Where a store is.

    Attributes
    ----------
    url : URL
        SQLAlchemy's form.
    path : Path or None
        The file of a SQLite store, None for a server.
    """

    url: URL
    path: Path | None

    def __str__(self) -> str:
        """Return the path, or the URL without its password."""
        return str(self.path) if self.path else self.url.render_as_string(hide_password=True)


def parse_address(path_or_url: str | os.PathLike[str]) -> Address:
    """Understand a path (SQLite) or an URL such as ``postgresql+psycopg://user@host/database``.

    Raises
    ------
    StoreUnavailableError
        For an URL that can't be read or whose file name is missing.
    """
    text = os.fspath(path_or_url)
    if "://" not in text:
        path = Path(text).absolute()
        return Address(URL.create("sqlite", database=str(path)), path)
    try:
        url = make_url(text)
    except (ArgumentError, ValueError) as error:
        raise StoreUnavailableError(
            f"'{text}' is not a database URL.", "Give a file name or dialect+driver://user@host/database."
        ) from error
    if url.get_backend_name() == "postgresql" and url.drivername == "postgresql":
        url = url.set(drivername="postgresql+psycopg")
    if url.get_backend_name() != "sqlite":
        return Address(url, None)
    if not url.database or url.database == ":memory:":
        raise StoreUnavailableError(f"'{text}' names no file.", "Give a file name; a store in memory would be lost.")
    return parse_address(url.database)


def make_engine(address: Address, *, read_only: bool) -> Engine:
    """Create an engine whose transactions are real on every backend.

    SQLite is opened with foreign keys on, a waiting time for locks and synchronous=FULL; a writer also
    chooses the journal: a write-ahead log on a local disk, a rollback journal (DELETE) on a network file
    system, where the log doesn't work.

    Raises
    ------
    StoreUnavailableError
        If the driver of the URL's database isn't installed.
    """
    if address.path is not None:
        return _sqlite_engine(address.path, read_only=read_only)
    try:
        engine = create_engine(address.url, pool_pre_ping=True)
    except (NoSuchModuleError, ImportError) as error:
        raise StoreUnavailableError(
            f"The driver for {address} is missing ({error}).", "Install it: pip install 'psycopg[binary]'."
        ) from error
    if read_only:
        return engine.execution_options(postgresql_readonly=True)
    return engine


def _sqlite_engine(path: Path, *, read_only: bool) -> Engine:
    query: dict[str, str] = {"uri": "true", "mode": "ro" if read_only else "rwc"}
    if read_only and not os.access(path.parent, os.W_OK, effective_ids=True) and not Path(f"{path}-wal").exists():
        # A log needs a writable folder. Without one nobody writes, so the file can be read as it is.
        query["immutable"] = "1"
    url = URL.create("sqlite", database=path.as_uri(), query=query)
    engine = create_engine(url, connect_args={"timeout": BUSY_TIMEOUT_SECONDS})
    journal = None if read_only else ("DELETE" if is_network_filesystem(path) else "WAL")

    @event.listens_for(engine, "connect")
    def set_pragmas(connection: Any, _record: object) -> None:  # noqa: ANN401 - the driver's own connection
        connection.isolation_level = None  # the driver must not begin or commit: the listener below does
        connection.execute("PRAGMA foreign_keys=ON")
        if journal is not None:
            connection.execute(f"PRAGMA journal_mode={journal}")
            connection.execute("PRAGMA synchronous=FULL")
            connection.execute(f"PRAGMA journal_size_limit={WAL_SIZE_LIMIT_BYTES}")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        # A writer takes its lock at once: upgrading a read lock later can fail without waiting.
        writes = connection.get_execution_options().get(WRITES, False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine
