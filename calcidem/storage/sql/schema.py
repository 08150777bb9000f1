"""Version of the schema in a database: create, add quantities, refuse."""

from typing import Any

from sqlalchemy import Column, Connection, Integer, Table, func, insert, inspect, select, text
from sqlalchemy.schema import CreateColumn

from calcidem.storage.errors import ForeignDatabaseError, NewerSchemaError, OlderSchemaError
from calcidem.storage.records import Quantity
from calcidem.storage.sql.engine import Address
from calcidem.storage.sql.models import (
    CELL,
    EXPRESSIONS,
    RESULT,
    STORED_QUANTITIES,
    Base,
    check_name,
    condition_of,
    join_results,
)

_SCHEMA = 1
"""Version of the tables in `calcidem.storage.sql.models`."""

_VERSION = Table("calcidem_schema", Base.metadata, Column("version", Integer, primary_key=True))
"""Holds the version, and is the mark by which a database is recognised as calcidem's."""

_CREATION_LOCK = 0x63616C63  # "calc": any number that others are unlikely to choose


def prepare_schema(connection: Connection, address: Address, *, read_only: bool) -> tuple[str, ...]:
    """Create the tables of an empty database, or columns that it lacks, within the connection's transaction.

    A reader changes nothing: it refuses an empty database. Returned is what each connection has to execute first.

    Raises
    ------
    ForeignDatabaseError, NewerSchemaError, OlderSchemaError
        As `is_empty`.
    """
    if read_only:
        if is_empty(connection, address):
            raise ForeignDatabaseError(f"{address} is empty.", "Give the database of a campaign that has been started.")
        return _columns_for_reading(connection, address)
    if connection.dialect.name == "postgresql":  # SQLite's transaction already keeps others out
        connection.execute(select(func.pg_advisory_xact_lock(_CREATION_LOCK)))
    if is_empty(connection, address):
        Base.metadata.create_all(connection)
        connection.execute(insert(_VERSION).values(version=_SCHEMA))
        _create_view(connection)
    elif missing := _missing_quantities(connection, address):
        for quantity in missing:
            column = CreateColumn(RESULT.c[quantity.name]).compile(dialect=connection.dialect)
            check = f" CONSTRAINT ck_result_{check_name(quantity)} CHECK ({condition_of(quantity)})"
            rule = check if condition_of(quantity) else ""
            connection.execute(text(f"ALTER TABLE result ADD COLUMN {column}{rule}"))
        connection.execute(text("DROP VIEW cells"))
        _create_view(connection)
    return ()


def _create_view(connection: Connection) -> None:
    """Make the view of whole cells, one row each, for people who ask the database itself.

    Its columns are the campaign's name and all quantities.
    """
    quantities: list[Any] = [expression.label(name) for name, expression in EXPRESSIONS.items()]
    campaign = Base.metadata.tables["campaign"]
    statement = join_results(select(campaign.c.name.label("campaign"), *quantities))
    statement = statement.join(campaign, campaign.c.id == CELL.c.campaign_id)
    connection.execute(text(f"CREATE VIEW cells AS {statement.compile(dialect=connection.dialect)}"))


def _columns_for_reading(connection: Connection, address: Address) -> tuple[str, ...]:
    """What each connection has to execute before it reads: the table of results with the quantities that it lacks.

    Raises
    ------
    OlderSchemaError
        If a server's table lacks some: only a writer can add them there.
    """
    missing = _missing_quantities(connection, address)
    if missing and connection.dialect.name != "sqlite":
        raise OlderSchemaError(
            f"{address} lacks the quantities {', '.join(quantity.name for quantity in missing)}, which an earlier "
            "calcidem did not know.",
            "Open it for writing once, with 'calcidem run' for example; that adds them and keeps all values.",
        )
    nothing = ", ".join(f"NULL AS {quantity.name}" for quantity in missing)
    return (f"CREATE TEMP VIEW result AS SELECT *, {nothing} FROM main.result",) if missing else ()  # noqa: S608 - names of the catalogue


def _missing_quantities(connection: Connection, address: Address) -> list[Quantity]:
    """Quantities that were added to the catalogue after a database was made.

    Raises
    ------
    NewerSchemaError
        If the database has quantities that this calcidem does not know.
    """
    present = {column["name"] for column in inspect(connection).get_columns(RESULT.name)}
    if unknown := present - set(RESULT.columns.keys()):
        raise _newer(address, f"the quantities {', '.join(sorted(unknown))}")
    return [quantity for quantity in STORED_QUANTITIES if quantity.name not in present]


def _newer(address: Address, what: str) -> NewerSchemaError:
    return NewerSchemaError(
        f"{address} has {what}, which this calcidem doesn't know: a later one wrote it.",
        "Use that version (pip install --upgrade calcidem); the database was left as it is.",
    )


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
        raise _newer(address, f"schema {version}")
    return False
