"""The one place that owns transactions and turns errors of databases into errors of the store."""

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy import Engine
from sqlalchemy.exc import DBAPIError, SQLAlchemyError
from sqlalchemy.orm import Session

from calcidem.storage.errors import (
    DamagedStoreError,
    DiskError,
    DiskFullError,
    ForeignDatabaseError,
    InvalidRecordError,
    ReadOnlyStoreError,
    StoreError,
    StoreLockedError,
    StoreUnavailableError,
)
from calcidem.storage.sql.engine import WRITES, Address

PRIMARY_CODE = 0xFF  # extended SQLite error codes keep the primary one in their low byte

SQLITE_ERRORS: dict[int, type[StoreError]] = {
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

POSTGRESQL_ERRORS: tuple[tuple[str, type[StoreError]], ...] = (
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

CURES: dict[type[StoreError], str] = {
    StoreLockedError: "Try again when the other process has finished; it was not stored.",
    DiskError: "Check the disk, your quota and the file system's network; nothing of this was stored.",
    DiskFullError: "Free some space and continue; nothing of this was stored, all before it is safe.",
    ReadOnlyStoreError: "Check the permissions of the file and of its folder, or work on a copy.",
    StoreUnavailableError: "Check the name, the permissions and, for a server, that it runs.",
    ForeignDatabaseError: "Choose another file name; this file was left as it is.",
    InvalidRecordError: "Nothing of this was stored; the values, or the program that made them, are wrong.",
    DamagedStoreError: "Check the disk; 'sqlite3 FILE .recover' saves what can be read, and an exported "
    ".nc file can be imported again.",
}


@contextmanager
def transaction(engine: Engine, address: Address, *, write: bool) -> Iterator[Session]:
    """Open a session in one transaction: committed at the end, rolled back on any error.

    Parameters
    ----------
    engine : Engine
    address : Address
        For error messages.
    write : bool
        Whether it is going to write; SQLite then waits for the lock at the beginning.

    Raises
    ------
    StoreError
        The translation of whatever the database reported.
    """
    bound = engine.execution_options(**{WRITES: True}) if write else engine
    try:
        with Session(bound, expire_on_commit=False) as session, session.begin():
            yield session
    except SQLAlchemyError as error:
        raise translate(error, address) from error


def translate(error: SQLAlchemyError, address: Address) -> StoreError:
    """Return the error of the store that an error of the database means."""
    original = error.orig if isinstance(error, DBAPIError) else error
    kind = _kind(original)
    problem = f"{address}: {str(original).strip()}."
    if kind is None:
        return StoreError(problem, "This is not expected; please report it with this message.")
    return kind(problem, CURES[kind])


def _kind(original: BaseException | None) -> type[StoreError] | None:
    sqlite_code = getattr(original, "sqlite_errorcode", None)
    if sqlite_code is not None:
        return SQLITE_ERRORS.get(sqlite_code & PRIMARY_CODE)
    # psycopg gives no state when no connection was made at all.
    state = getattr(original, "sqlstate", None)
    if state is None:
        return StoreUnavailableError if type(original).__name__ == "OperationalError" else None
    return next((kind for prefix, kind in POSTGRESQL_ERRORS if state.startswith(prefix)), None)
