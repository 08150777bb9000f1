"""The tables are those that are declared, on either backend, and take quantities that are added."""

import io
import re
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest
from sqlalchemy import CheckConstraint, inspect, text

from calcidem.ends import CellStatus
from calcidem.storage.errors import OtherSchemaError
from calcidem.storage.records import QUANTITY_BY_NAME
from calcidem.storage.sql.store import Store
from calcidem.storage.sql.tables import _METADATA

if TYPE_CHECKING:
    from conftest import Records


def test_every_constraint_is_in_the_database(open_here: Callable[..., Store]) -> None:
    """All tables, columns and checks of the models are in a database that was made."""
    with open_here()._connections._engine.connect() as connection:
        found = inspect(connection)
        assert set(found.get_table_names()) == set(_METADATA.tables)
        for name, table in _METADATA.tables.items():
            assert {column["name"] for column in found.get_columns(name)} == set(table.columns.keys())
            checks = {str(check.name) for check in table.constraints if isinstance(check, CheckConstraint)}
            # SQLAlchemy 2.0.30 takes what follows a column's constraint in SQLite for a part of its name.
            reflected = " ".join(f"{check['name']} {check['sqltext']}" for check in found.get_check_constraints(name))
            assert set(re.findall(r"\bck_\w+", reflected)) == checks


def test_a_view_has_whole_cells(store: Store, records: "Records") -> None:
    """Whoever asks the database itself finds each planned cell in one row, with its campaign and all quantities."""
    store.record_results([records.with_arrays(1, 5.0), records.failed(2, 5.0)])
    with store._connections._engine.connect() as connection:
        found = connection.execute(text("SELECT * FROM cells WHERE content = 5 ORDER BY seed")).mappings().all()
    assert [(row["campaign"], row["seed"], row["status"], row["vs"]) for row in found] == [
        ("quick", 0, CellStatus.PENDING, None),
        ("quick", 1, CellStatus.DONE, records.done(1).vs),
        ("quick", 2, CellStatus.FAILED, None),
        ("quick", 3, CellStatus.PENDING, None),
    ]
    assert list(found[0].keys()) == ["campaign", *QUANTITY_BY_NAME]
    assert found[1]["vs_error"] == pytest.approx(records.done(1).vs_error)
    assert (found[1]["path_contacts"], found[1]["host"]) == (3, "node7")


def test_the_database_explains_itself(store: Store, records: "Records") -> None:
    """Each column of the view, and each array of a stored blob, has a row with its unit and meaning."""
    store.record_results([records.with_arrays(1, 5.0)])
    with store._connections._engine.connect() as connection:
        told = {row.name: row for row in connection.execute(text("SELECT * FROM quantities"))}
        columns = connection.execute(text("SELECT * FROM cells")).keys()
        blobs = connection.execute(text("SELECT name, content FROM arrays")).all()
    assert set(columns) == {name for name in told if "." not in name}
    assert (told["vs"].unit, told["vs"].meaning) == ("m s-1", "shear-wave velocity")
    assert len(blobs) == 3
    arrays = {f"{name}.{array}" for name, blob in blobs for array in np.load(io.BytesIO(blob)).files}
    assert arrays == {name for name in told if "." in name}
    assert told["section.across"].meaning == "velocity across the path, counts; sample x station"


def test_tables_with_other_quantities_are_refused(
    address: str, open_here: Callable[..., Store], records: "Records"
) -> None:
    """A database that lacks a quantity, or has one that is unknown, is one of another version, and stays as it is."""
    open_here().begin_campaign(records.campaign())
    with open_here()._connections._engine.begin() as connection:
        connection.execute(text("DROP VIEW cells"))
        connection.execute(text("ALTER TABLE result ADD COLUMN later FLOAT"))
    for read_only in (False, True):
        with pytest.raises(OtherSchemaError, match=r"another version of calcidem.*\(later\)"):
            Store(address, read_only=read_only)
