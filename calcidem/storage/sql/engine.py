"""Connections to a store: address, pragmas of SQLite, transactions, and translation of database errors."""

import math
import os
import sqlite3
import zlib
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self
from zipfile import BadZipFile

from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, NoSuchModuleError, SQLAlchemyError

from calcidem.storage.errors import (
    DamagedStoreError,
    DiskError,
    DiskFullError,
    ForeignDatabaseError,
    InvalidRecordError,
    ReadOnlyStoreError,
    StoreError,
    StoreInterruptedError,
    StoreLockedError,
    StoreUnavailableError,
)
from calcidem.storage.passwords import hide_passwords, password_of
from calcidem.storage.sql.filesystem import is_network_filesystem

_BUSY_TIMEOUT_SECONDS = 30.0
_WAL_SIZE_LIMIT_BYTES = 64 * 2**20

_WRITES = "calcidem_writes"
"""Execution option of a connection whose next transaction will write."""

_PRIMARY_CODE = 0xFF  # extended SQLite error codes keep the primary one in their low byte

_SQLITE_DAMAGE = {1, 11, 20, 26}  # SQLITE_ERROR, SQLITE_CORRUPT, SQLITE_MISMATCH, SQLITE_NOTADB

_SQLITE_ERRORS: dict[int, type[StoreError]] = {
    5: StoreLockedError,  # SQLITE_BUSY
    6: StoreLockedError,  # SQLITE_LOCKED
    8: ReadOnlyStoreError,  # SQLITE_READONLY
    10: DiskError,  # SQLITE_IOERR
    11: DamagedStoreError,  # SQLITE_CORRUPT
    13: DiskFullError,  # SQLITE_FULL
    14: StoreUnavailableError,  # SQLITE_CANTOPEN
    19: InvalidRecordError,  # SQLITE_CONSTRAINT
    26: ForeignDatabaseError,  # SQLITE_NOTADB
}

_POSTGRESQL_ERRORS: tuple[tuple[str, type[StoreError]], ...] = (
    ("40", StoreLockedError),  # serialization failure, deadlock
    ("55P03", StoreLockedError),  # lock not available
    ("53100", DiskFullError),
    ("25006", ReadOnlyStoreError),
    ("42501", ReadOnlyStoreError),  # insufficient privilege
    ("22", InvalidRecordError),  # value out of range
    ("23", InvalidRecordError),  # constraint
    ("XX", DamagedStoreError),
    ("08", StoreUnavailableError),
    ("28", StoreUnavailableError),  # authorization
    ("3D", StoreUnavailableError),  # no such database
    ("57P", StoreUnavailableError),  # shutdown
)

UNREADABLE = (
    *(SQLAlchemyError, DamagedStoreError),
    *(ArithmeticError, AttributeError, LookupError, TypeError, ValueError, EOFError, BadZipFile, zlib.error),
)
"""Exceptions of reading a damaged row, by the database or by the conversion of its values."""

_CURE_OF_ERROR: dict[type[StoreError], str] = {
    StoreLockedError: "Try again when the other process has finished; it was not stored.",
    DiskError: "Check the disk, your quota and the file system's network; nothing of this was stored.",
    DiskFullError: "Free some space and continue; nothing of this was stored, all before it is safe.",
    ReadOnlyStoreError: "Check the permissions of the file and of its folder, or work on a copy.",
    StoreUnavailableError: "Check the name, the permissions and, for a server, that it runs.",
    StoreInterruptedError: "Run the same command again once the server can be reached; what was stored is safe.",
    ForeignDatabaseError: "Choose another file name; this file was left as it is.",
    InvalidRecordError: "Nothing of this was stored; the values, or the program that made them, are wrong.",
    DamagedStoreError: "Check the disk; 'sqlite3 FILE .recover' saves what can be read, and an exported "
    ".nc file can be imported again.",
}


@dataclass(frozen=True, slots=True)
class Address:
    """Address of a store."""

    url: URL
    """SQLAlchemy's form."""
    path: Path | None
    """File of a SQLite store, None for a server."""

    @classmethod
    def parse(cls, path_or_url: str | os.PathLike[str]) -> Self:
        """Parse a path (SQLite) or a URL such as ``postgresql+psycopg://user@host/database``.

        `StoreUnavailableError` for an invalid URL or one without a file name.
        """
        text = os.fspath(path_or_url)
        if "://" not in text:
            path = Path(text).absolute()
            return cls(URL.create("sqlite", database=str(path)), path)
        try:
            url = make_url(text)
        except (ArgumentError, ValueError) as error:
            raise StoreUnavailableError(
                f"'{hide_passwords(text)}' is not a database URL.",
                "Give a file name or dialect+driver://user@host/database.",
            ) from error
        if url.get_backend_name() == "postgresql" and url.drivername == "postgresql":
            url = url.set(drivername="postgresql+psycopg")
        if url.get_backend_name() != "sqlite":
            password = password_of(text)
            return cls(url if password is None else url.set(password=password), None)
        if not url.database or url.database == ":memory:":
            raise StoreUnavailableError(
                f"'{text}' names no file.", "Give a file name; a store in memory would be lost."
            )
        return cls.parse(url.database)

    def __str__(self) -> str:
        """Return the path, or the URL without its password."""
        return str(self.path) if self.path else hide_passwords(self.url.render_as_string(hide_password=True))


class Connections:
    """Connections to a database, with the same transactions on every backend.

    Attributes
    ----------
    address : Address
    """

    def __init__(self, address: Address, *, read_only: bool) -> None:
        """Prepare connections, which are opened on use.

        A writer of SQLite chooses the journal: a write-ahead log on a local disk, a rollback journal (DELETE) on a
        network file system, where the log does not work. `StoreUnavailableError` if the database's driver is not
        installed.
        """
        self.address = address
        if address.path is not None:
            self._engine = _sqlite_engine(address.path, read_only=read_only)
            return
        try:
            engine = create_engine(address.url, pool_pre_ping=True)
        except (NoSuchModuleError, ImportError) as error:
            raise StoreUnavailableError(
                f"The driver for {address} is missing ({error}).", "Install it: pip install 'psycopg[binary]'."
            ) from error
        self._engine = engine.execution_options(postgresql_readonly=True) if read_only else engine

    @contextmanager
    def transaction(self, *, write: bool) -> Iterator[Connection]:
        """Open a connection with one transaction: committed at the end, rolled back on any error.

        A writer waits for SQLite's lock at the beginning. An error of the database becomes a `StoreError` with the
        address.
        """
        bound = self._engine.execution_options(**{_WRITES: True}) if write else self._engine
        try:
            with bound.begin() as connection:
                yield connection
        except SQLAlchemyError as error:
            raise _translate_error(error, self.address) from error
        except UNREADABLE as error:
            if write or isinstance(error, DamagedStoreError):
                raise  # the values to be written may be wrong
            problem = f"{self.address}: something that is stored can't be read ({type(error).__name__}: {error})."
            raise DamagedStoreError(problem, _CURE_OF_ERROR[DamagedStoreError]) from error

    def execute_on_connect(self, statement: str) -> None:
        """Let each reading connection of SQLite execute a statement first; open ones are closed."""

        @event.listens_for(self._engine, "connect")
        def execute(connection: Any, _record: object) -> None:  # noqa: ANN401 - the driver's own connection
            connection.execute("PRAGMA temp_store=MEMORY")  # a mere reader may have no writable folder
            connection.execute("PRAGMA query_only=OFF")  # temporary views also count as changes
            connection.execute(statement)
            connection.execute("PRAGMA query_only=ON")

        self.close()

    def bring_log_into_file(self) -> None:
        """Copy the write-ahead log, if any, into the database file, as far as readers allow.

        An error is ignored, since the contents of the log are stored and the next attempt may succeed.
        """
        with suppress(SQLAlchemyError, sqlite3.Error), closing(self._engine.raw_connection()) as connection:
            connection.cursor().execute("PRAGMA wal_checkpoint(PASSIVE)")

    def close(self) -> None:
        """Close the connections."""
        self._engine.dispose()


def _sqlite_engine(path: Path, *, read_only: bool) -> Engine:
    # A reader creates no file, but opens it as a writer would: the last connection to close copies the log of a killed
    # writer into the database.
    query: dict[str, str] = {"uri": "true", "mode": "rw" if read_only else "rwc"}
    if read_only and not os.access(path.parent, os.W_OK, effective_ids=True) and not Path(f"{path}-wal").exists():
        # A log needs a writable folder. Without one no process writes, so the file can be read directly.
        query["immutable"] = "1"
    url = URL.create("sqlite", database=path.as_uri(), query=query)
    engine = create_engine(url, connect_args={"timeout": _BUSY_TIMEOUT_SECONDS})
    journal = None if read_only else ("DELETE" if is_network_filesystem(path) else "WAL")

    @event.listens_for(engine, "connect")
    def set_pragmas(connection: Any, _record: object) -> None:  # noqa: ANN401 - the driver's own connection
        connection.isolation_level = None  # the listener below begins and commits, not the driver
        connection.text_factory = partial(str, encoding="utf-8", errors="replace")  # a checksum finds the damage
        # Not every SQLite has this function; databases return NULL for anything but a number of 0 or more.
        connection.create_function(
            "sqrt", 1, lambda x: math.sqrt(x) if isinstance(x, int | float) and x >= 0.0 else None, deterministic=True
        )
        connection.execute("PRAGMA foreign_keys=ON")
        if journal is not None:
            connection.execute(f"PRAGMA journal_mode={journal}")
            connection.execute("PRAGMA synchronous=FULL")
            connection.execute(f"PRAGMA journal_size_limit={_WAL_SIZE_LIMIT_BYTES}")
        else:
            connection.execute("PRAGMA query_only=ON")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        # A writer locks at once, since upgrading a read lock later can fail without waiting.
        writes = connection.get_execution_options().get(_WRITES, False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


def may_be_damage(error: BaseException) -> bool:
    """Whether a reading error concerns only the rows read, so that other rows may be intact."""
    if not isinstance(error, DBAPIError):
        return True
    return getattr(error.orig, "sqlite_errorcode", 0) & _PRIMARY_CODE in _SQLITE_DAMAGE


def _translate_error(error: SQLAlchemyError, address: Address) -> StoreError:
    """Return the error of the store for an error of the database."""
    original = error.orig if isinstance(error, DBAPIError) else error
    broken = isinstance(error, DBAPIError) and error.connection_invalidated  # it was known before
    kind = StoreInterruptedError if broken else _kind(original)
    problem = f"{address}: {str(original).strip().rstrip('.')}."
    if kind is None:
        return StoreError(problem, "This is not expected; please report it with this message.")
    return kind(problem, _CURE_OF_ERROR[kind])


def _kind(original: BaseException | None) -> type[StoreError] | None:
    sqlite_code = getattr(original, "sqlite_errorcode", None)
    if sqlite_code is not None:
        return _SQLITE_ERRORS.get(sqlite_code & _PRIMARY_CODE)
    # psycopg gives no state if no connection was made.
    state = getattr(original, "sqlstate", None)
    if state is None:
        return StoreUnavailableError if type(original).__name__ == "OperationalError" else None
    return next((kind for prefix, kind in _POSTGRESQL_ERRORS if state.startswith(prefix)), None)
