"""Connections to a store: address, pragmas of SQLite, transactions, checks of a file, and translation of errors."""

import math
import os
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, NoSuchModuleError, SQLAlchemyError

from calcidem.storage.errors import (
    DAMAGE_REMEDY,
    DamagedStoreError,
    DiskError,
    ForeignDatabaseError,
    InvalidRecordError,
    ReadOnlyStoreError,
    StoreError,
    StoreInterruptedError,
    StoreLockedError,
    StoreUnavailableError,
    hide_passwords,
    with_passwords,
)
from calcidem.storage.files import beginning, can_lock, is_network_filesystem

_BUSY_TIMEOUT_SECONDS = 30.0
_WRITES = "calcidem_writes"
"""Execution option of a connection whose next transaction will write."""

_ERRORS: tuple[tuple[tuple[int, ...], tuple[str, ...], type[StoreError], str], ...] = (
    # SQLITE_BUSY, LOCKED; serialization failure or deadlock, lock not available
    ((5, 6), ("40", "55P03"), StoreLockedError, "Try again when the other process has finished; it was not stored."),
    # SQLITE_READONLY; read-only transaction, insufficient privilege
    (
        (8,),
        ("25006", "42501"),
        ReadOnlyStoreError,
        "Check the permissions of the file, of its -wal and -shm and of the folder, or use a copy.",
    ),
    # SQLITE_IOERR
    ((10,), (), DiskError, "Check the disk, your quota and the file system's network; nothing of this was stored."),
    # SQLITE_CORRUPT; internal errors
    ((11,), ("XX",), DamagedStoreError, DAMAGE_REMEDY),
    # SQLITE_FULL; disk full
    ((13,), ("53100",), DiskError, "Free some space and continue; nothing of this was stored, all before is safe."),
    # SQLITE_CANTOPEN; connection, authorization, no such database, shutdown
    (
        (14,),
        ("08", "28", "3D", "57P"),
        StoreUnavailableError,
        "Check the name, the permissions, and that a server runs.",
    ),
    # SQLITE_CONSTRAINT; value out of range, constraint
    ((19,), ("22", "23"), InvalidRecordError, "Nothing of this was stored; the values, or their program, are wrong."),
    # SQLITE_NOTADB
    ((26,), (), ForeignDatabaseError, "Choose another file name; this file was left as it is."),
)
"""Primary codes of SQLite, beginnings of the states of PostgreSQL, error and remedy."""


@dataclass(frozen=True, slots=True)
class Address:
    """Address of a store."""

    url: URL
    """SQLAlchemy's form."""
    path: Path | None
    """File of a SQLite store without symbolic links, None for a server."""

    @classmethod
    def parse(cls, path_or_url: str | os.PathLike[str]) -> Self:
        """Parse a path (SQLite) or a URL such as ``postgresql+psycopg://user@host/database``.

        `StoreUnavailableError` for an invalid URL or one without a file name.
        """
        text = os.fspath(path_or_url)
        if "://" not in text:
            try:
                path = Path(text).resolve()
            except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a zero byte
                raise StoreUnavailableError(f"{text!r} can't be a file ({error}).", "Give another name.") from error
            return cls(URL.create("sqlite", database=str(path)), path)
        try:
            url = make_url(with_passwords(text))
        except (ArgumentError, ValueError) as error:
            raise StoreUnavailableError(
                f"'{hide_passwords(text)}' is not a database URL.",
                "Give a file name or dialect+driver://user@host/database.",
            ) from error
        if url.drivername == "postgresql":
            url = url.set(drivername="postgresql+psycopg")
        if url.get_backend_name() != "sqlite":
            return cls(url, None)
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
        self._unlocked: tuple[int, ...] | None = None  # `_written_last` if this process makes no log
        if address.path is not None:
            if read_only and not _may_make_a_log(address.path):
                self._unlocked = _written_last(address.path)
            self._engine = _sqlite_engine(address.path, read_only=read_only, unlocked=self._unlocked is not None)
            return
        try:
            engine = create_engine(address.url, pool_pre_ping=True)
        except (NoSuchModuleError, ImportError) as error:
            raise StoreUnavailableError(
                f"The driver for {address} is missing ({error}).", "Install it: pip install 'psycopg[binary]'."
            ) from error
        # A reader whose transaction has several queries sees one state, as in SQLite.
        options = {"postgresql_readonly": True, "isolation_level": "REPEATABLE READ"}
        self._engine = engine.execution_options(**options) if read_only else engine

    @contextmanager
    def transaction(self, *, write: bool) -> Iterator[Connection]:
        """Open a connection with one transaction: committed at the end, rolled back on any error.

        A writer waits for SQLite's lock at the beginning. An error of the database becomes a `StoreError` with the
        address, and so does a stored value that can't be converted.
        """
        if self._unlocked is not None and self.address.path is not None:
            now = _written_last(self.address.path)
            if now != self._unlocked:  # by a process that may write the file
                self._engine.dispose()
                self._engine = _sqlite_engine(self.address.path, read_only=True, unlocked=True)
                self._unlocked = now
        bound = self._engine.execution_options(**{_WRITES: True}) if write else self._engine
        try:
            with bound.begin() as connection:
                yield connection
            self._refuse_changed()
        except SQLAlchemyError as error:
            self._refuse_changed()
            raise _translate_error(error, self.address) from error
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            if write:
                raise  # the values to be written may be wrong
            problem = f"{self.address} is damaged: a stored value can't be read ({type(error).__name__}: {error})."
            raise DamagedStoreError(problem, DAMAGE_REMEDY) from error

    def _refuse_changed(self) -> None:
        """Raise `StoreLockedError` if the file changed under a reader without locks, which may have read a mixture."""
        if self._unlocked is None or self.address.path is None or self._engine.url.query.get("immutable") != "1":
            return
        if _written_last(self.address.path)[:3] != self._unlocked[:3]:
            raise StoreLockedError(
                f"{self.address} was written while it was read without locks.",
                "Run the same command again.",
            )

    def bring_log_into_file(self) -> None:
        """Copy the write-ahead log, if any, into the database file, as far as readers allow.

        An error is ignored, since the contents of the log are stored and the next attempt may succeed.
        """
        with suppress(SQLAlchemyError, sqlite3.Error), closing(self._engine.raw_connection()) as connection:
            connection.cursor().execute("PRAGMA wal_checkpoint(PASSIVE)")

    def close(self) -> None:
        """Close the connections."""
        self._engine.dispose()


def _sqlite_engine(path: Path, *, read_only: bool, unlocked: bool) -> Engine:
    # A reader creates no file, but opens it as a writer would: the last connection to close copies the log of a killed
    # writer into the database.
    query: dict[str, str] = {"uri": "true", "mode": "rw" if read_only else "rwc"}
    if unlocked and _needs_a_log(path):
        query["immutable"] = "1"  # without a log no process writes at present
    url = URL.create("sqlite", database=path.as_uri(), query=query)
    engine = create_engine(url, connect_args={"timeout": _BUSY_TIMEOUT_SECONDS})
    journal = None if read_only else ("DELETE" if is_network_filesystem(path) else "WAL")

    @event.listens_for(engine, "connect")
    def set_pragmas(connection: Any, _record: object) -> None:  # noqa: ANN401 - the driver's own connection
        connection.isolation_level = None  # the listener below begins and commits, not the driver
        # Not every SQLite has this function; databases return NULL for anything but a number of 0 or more.
        connection.create_function(
            "sqrt", 1, lambda x: math.sqrt(x) if isinstance(x, int | float) and x >= 0.0 else None, deterministic=True
        )
        connection.execute("PRAGMA foreign_keys=ON")
        if journal is not None:
            connection.execute(f"PRAGMA journal_mode={journal}")
            connection.execute("PRAGMA synchronous=FULL")
            connection.execute("PRAGMA journal_size_limit=67108864")  # bytes that a log keeps after a large transaction
        else:
            connection.execute("PRAGMA query_only=ON")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        # A writer locks at once, since upgrading a read lock later can fail without waiting.
        writes = connection.get_execution_options().get(_WRITES, False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


def _written_last(path: Path) -> tuple[int, ...]:
    """What changes if a process writes a database: identity, size and time of the file, and whether it has a log."""
    with suppress(OSError):
        status = path.stat()
        return status.st_ino, status.st_size, status.st_mtime_ns, Path(f"{path}-wal").exists()
    return ()


def _may_make_a_log(path: Path) -> bool:
    """Whether a reader may let SQLite make the log of a database, and has room for it.

    The log belongs to the user who makes it. If this user may not write the database, its writers are locked out.
    """
    is_own = all(
        os.access(place, os.W_OK, effective_ids=os.access in os.supports_effective_ids) for place in (path, path.parent)
    )
    return is_own and shutil.disk_usage(path.parent).free > 1_000_000


def _needs_a_log(path: Path) -> bool:
    """Whether a database is written through a log, and has none at present."""
    if any(Path(f"{path}{end}").exists() for end in ("-wal", "-journal")):
        return False
    return beginning(path)[18:] == b"\2\2"  # versions of the format to write and to read: 2 with a log


def find_damage(path: Path, pragma: str = "quick_check") -> list[str]:
    """Let SQLite check a file and return what it finds, at most 20 lines; an intact file gives none.

    The file is not changed, except that SQLite undoes an unfinished transaction of a rollback journal.
    ``integrity_check`` also compares indices with tables, which takes longer. `StoreError` if the file cannot be read.
    """
    mode = "rw" if Path(f"{path}-journal").exists() else "ro"
    if not _may_make_a_log(path) and _needs_a_log(path):
        mode = "ro&immutable=1"
    try:
        with closing(
            sqlite3.connect(f"{path.as_uri()}?mode={mode}", timeout=_BUSY_TIMEOUT_SECONDS, uri=True)
        ) as connection:
            lines = [str(line) for (line,) in connection.execute(f"PRAGMA {pragma}(20)")]
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_CORRUPT:
            raise _translate_error(error, Address.parse(path)) from error
        lines = [str(error)]
    return [] if lines == ["ok"] else lines


def refuse_damaged(path: Path) -> None:
    """Raise `DamagedStoreError` if SQLite finds the file damaged (`find_damage`)."""
    if lines := find_damage(path):
        raise DamagedStoreError(f"{path} is damaged: {'; '.join(lines[:3])}.", DAMAGE_REMEDY)


def _translate_error(error: SQLAlchemyError | sqlite3.Error, address: Address) -> StoreError:
    """Return the error of the store for an error of the database."""
    original = error.orig if isinstance(error, DBAPIError) else error
    problem = f"{address}: {str(original).strip().rstrip('.')}."
    if isinstance(error, DBAPIError) and error.connection_invalidated:  # it was known before
        return StoreInterruptedError(
            problem, "Run the same command again once the server can be reached; what was stored is safe."
        )
    if isinstance(original, sqlite3.Error):  # Python's driver itself refuses damaged texts, and gives them no code
        code, state = getattr(original, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF, ""  # the primary code
    else:  # psycopg gives no state if no connection was made
        unreachable = "08" if type(original).__name__ == "OperationalError" else ""
        code, state = -1, getattr(original, "sqlstate", None) or unreachable
    # SQLITE_PERM, BUSY, LOCKED, IOERR, PROTOCOL are what SQLite makes of a lock that the system refuses.
    if code in {3, 5, 6, 10, 15} and address.path is not None and not can_lock(address.path.parent):
        return StoreUnavailableError(
            f"{address}: its file system has no locks, so programs could damage it for one another.",
            "Keep it on a disk of this machine (--db), or have the file system mounted with locks.",
        )
    for codes, states, kind, remedy in _ERRORS:
        if code in codes or state.startswith(states):
            return kind(problem, remedy)
    return StoreError(problem, "This is not expected; please report it with this message.")
