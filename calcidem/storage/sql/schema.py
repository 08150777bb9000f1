"""Version of the schema in a database: create, upgrade, refuse."""

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, func, inspect, select

from calcidem.storage.errors import ForeignDatabaseError, NewerSchemaError, OlderSchemaError
from calcidem.storage.sql.checksums import UNCHECKED, seal_former_rows
from calcidem.storage.sql.engine import Address
from calcidem.storage.sql.migrations.new_columns import BROKEN_BONDS, NEW_COLUMNS
from calcidem.storage.sql.migrations.versions.v0004_sample_times import START_TIME

VERSION_TABLE = "calcidem_schema"
"""Table that holds the revision, and the mark by which a database is recognised as calcidem's."""

_SIGNALS_OF_0003 = f"""
CREATE TEMP VIEW signal AS
SELECT cell_id, time_step AS sampling_interval, {START_TIME} AS start_time, samples FROM main.signal AS signal
"""  # noqa: S608 - constants


def _read_with(table: str, more: str) -> str:
    """View of a former table, with more columns, as one of the current schema."""
    return f"CREATE TEMP VIEW {table} AS SELECT *, {more} FROM main.{table}"  # noqa: S608 - constants


def _read_without_checksums(table: str, more: str = "") -> str:
    """View of a table of the time before checksums as one of the current schema."""
    return _read_with(table, f"'{UNCHECKED}' AS checksum{more}")


_SINCE_0005 = ", ".join(f"NULL AS {name}" for name in (*NEW_COLUMNS, BROKEN_BONDS))
_OF_0005 = (
    _read_without_checksums("attempt"),
    _read_without_checksums("result", f", error_estimate AS error_bound, {_SINCE_0005}"),
)
_OF_0004 = (*_OF_0005, _read_without_checksums("run", ", NULL AS workers"))
_OVERLAPS = ", mean_overlap AS mean_relative_overlap, largest_overlap AS largest_relative_overlap"

_READ_AS_CURRENT = {
    "0003": (*_OF_0004, _SIGNALS_OF_0003, _read_without_checksums("packing", f"{_OVERLAPS}, NULL AS content_hash")),
    "0004": (*_OF_0004, _read_without_checksums("packing", ", NULL AS content_hash")),
    "0005": (*_OF_0005, _read_without_checksums("run"), _read_without_checksums("packing")),
    "0006": (_read_with("result", f"NULL AS {BROKEN_BONDS}"),),
}
"""Views by which a SQLite database of a former schema is read as one of the current schema, its file left as it is."""

_FIRST_WITH_CHECKSUMS = "0006"

UPGRADE_LOCK = 0x63616C63  # "calc": any number that others are unlikely to choose


def _configuration(connection: Connection | None = None) -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations").replace("%", "%%"))
    config.attributes["connection"] = connection
    return config


def prepare_schema(connection: Connection, address: Address) -> None:
    """Bring an empty or older database to the current schema, within the connection's transaction.

    Raises
    ------
    ForeignDatabaseError, NewerSchemaError
        As `read_revision`.
    """
    if connection.dialect.name == "postgresql":  # SQLite's transaction already keeps others out
        connection.execute(select(func.pg_advisory_xact_lock(UPGRADE_LOCK)))
    revision = read_revision(connection, address)
    if revision != head_revision():
        command.upgrade(_configuration(connection), "head")
        if revision is not None and revision < _FIRST_WITH_CHECKSUMS:
            seal_former_rows(connection)


def prepare_reading(connection: Connection, address: Address) -> tuple[str, ...]:
    """Refuse a database that can't be read as it is; return what each connection has to execute before it reads.

    Raises
    ------
    ForeignDatabaseError, NewerSchemaError
        As `read_revision`; a database without tables is foreign too.
    OlderSchemaError
        If it has to be upgraded first.
    """
    revision = read_revision(connection, address)
    if revision is None:
        raise ForeignDatabaseError(f"{address} is empty.", "Give the database of a campaign that has been started.")
    if revision in _READ_AS_CURRENT and connection.dialect.name == "sqlite":
        return _READ_AS_CURRENT[revision]
    if revision != head_revision():
        raise OlderSchemaError(
            f"{address} was written by an earlier calcidem (schema {revision}, this one reads {head_revision()}).",
            "Continue its campaign, or run 'calcidem retry' on it: opening it for writing upgrades it "
            "and keeps its values.",
        )
    return ()


def head_revision() -> str:
    """Newest version of the schema."""
    head = ScriptDirectory.from_config(_configuration()).get_current_head()
    if head is None:
        raise RuntimeError("calcidem was installed without its migrations; install it again.")
    return head


def read_revision(connection: Connection, address: Address) -> str | None:
    """Return the revision of a database, None if it has no tables.

    Raises
    ------
    ForeignDatabaseError
        If it has tables but not calcidem's mark.
    NewerSchemaError
        If its revision is unknown here.
    """
    tables = inspect(connection).get_table_names()
    if not tables:
        return None
    if VERSION_TABLE not in tables:
        raise ForeignDatabaseError(
            f"{address} is a database of another program (its tables: {', '.join(sorted(tables)[:5])}).",
            "Choose another name; it was left as it is.",
        )
    revision = MigrationContext.configure(connection, opts={"version_table": VERSION_TABLE}).get_current_revision()
    known = {script.revision for script in ScriptDirectory.from_config(_configuration()).walk_revisions()}
    if revision not in known:
        raise NewerSchemaError(
            f"{address} has schema {revision}, which this calcidem doesn't know: a later one wrote it.",
            "Use that version (pip install --upgrade calcidem); the database was left as it is.",
        )
    return revision
