"""Version of the schema in a database: create, refuse."""

from sqlalchemy import Column, Connection, Integer, Table, func, insert, inspect, select

from calcidem.storage.errors import ForeignDatabaseError, NewerSchemaError, OlderSchemaError
from calcidem.storage.sql.engine import Address
from calcidem.storage.sql.models import Base

_SCHEMA = 1
"""Version of the tables in `calcidem.storage.sql.models`."""

_VERSION = Table("calcidem_schema", Base.metadata, Column("version", Integer, primary_key=True))
"""Holds the version, and is the mark by which a database is recognised as calcidem's."""

CREATION_LOCK = 0x63616C63  # "calc": any number that others are unlikely to choose


def prepare_schema(connection: Connection, address: Address, *, read_only: bool) -> None:
    """Create the tables of an empty database, within the connection's transaction; a reader refuses it.

    Raises
    ------
    ForeignDatabaseError, NewerSchemaError, OlderSchemaError
        As `is_empty`.
    """
    if read_only:
        if is_empty(connection, address):
            raise ForeignDatabaseError(f"{address} is empty.", "Give the database of a campaign that has been started.")
        return
    if connection.dialect.name == "postgresql":  # SQLite's transaction already keeps others out
        connection.execute(select(func.pg_advisory_xact_lock(CREATION_LOCK)))
    if is_empty(connection, address):
        Base.metadata.create_all(connection)
        connection.execute(insert(_VERSION).values(version=_SCHEMA))


def is_empty(connection: Connection, address: Address) -> bool:
    """Whether a database has no tables yet; one that is not of this schema is refused.

    Raises
    ------
    ForeignDatabaseError
        If it has tables but not calcidem's mark.
    OlderSchemaError, NewerSchemaError
        If an earlier or a later calcidem wrote it.
    """
    inspector = inspect(connection)
    tables = inspector.get_table_names()
    if not tables:
        return True
    if _VERSION.name not in tables:
        raise ForeignDatabaseError(
            f"{address} is a database of another program (its tables: {', '.join(sorted(tables)[:5])}).",
            "Choose another name; it was left as it is.",
        )
    if "version" not in {column["name"] for column in inspector.get_columns(_VERSION.name)}:
        raise OlderSchemaError(
            f"{address} was written by calcidem 0.1.0 or earlier, whose tables this calcidem does not read.",
            "Use that version, or compute the campaign in a new database; it was left as it is.",
        )
    version = connection.scalar(select(func.max(_VERSION.c.version)))
    if version != _SCHEMA:
        raise NewerSchemaError(
            f"{address} has schema {version}, which this calcidem doesn't know: a later one wrote it.",
            "Use that version (pip install --upgrade calcidem); the database was left as it is.",
        )
    return False
