"""The tables have the constraints that are declared, on either backend."""

import re
from collections.abc import Callable

from sqlalchemy import CheckConstraint, inspect

from calcidem.storage.sql.models import Base
from calcidem.storage.sql.store import SqlStore


def test_every_constraint_is_in_the_database(open_here: Callable[..., SqlStore]) -> None:
    """All tables, columns and checks of the models are in a database that was made."""
    with open_here()._engine.connect() as connection:
        found = inspect(connection)
        assert set(found.get_table_names()) == set(Base.metadata.tables)
        for name, table in Base.metadata.tables.items():
            assert {column["name"] for column in found.get_columns(name)} == set(table.columns.keys())
            checks = {str(check.name) for check in table.constraints if isinstance(check, CheckConstraint)}
            # SQLAlchemy 2.0.30 takes what follows a column's constraint in SQLite for a part of its name.
            reflected = " ".join(f"{check['name']} {check['sqltext']}" for check in found.get_check_constraints(name))
            assert set(re.findall(r"\bck_\w+", reflected)) == checks
