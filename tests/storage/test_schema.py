"""The tables are those that are declared, on either backend, and take quantities that are added."""

import re
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from older import leave_out
from sqlalchemy import CheckConstraint, inspect, text

from calcidem.app.campaign.opened import open_campaign
from calcidem.storage.errors import OtherSchemaError
from calcidem.storage.records import QUANTITY_BY_NAME, CellStatus
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
    stored = [name for name, quantity in QUANTITY_BY_NAME.items() if quantity.formula is None]
    assert list(found[0].keys()) == ["campaign", *stored]
    assert (found[1]["path_contacts"], found[1]["host"]) == (3, "node7")


def test_a_quantity_that_is_added_is_missing_in_older_cells(tmp_path: Path, records: "Records") -> None:
    """A reader finds None for it and changes nothing; a writer adds the column with its check; old rows stay intact."""
    path = tmp_path / "older.db"
    with Store(path) as store:
        store.begin_campaign(records.campaign())
        store.record_results([records.with_arrays(1, 5.0)])
    leave_out(path)
    before = path.read_bytes()
    with open_campaign(path) as campaign:
        found = campaign.cell(seed=1, content=5.0)
        assert (found.vs, found.broken_bonds) == (1151.0, None)
        assert found.features is not None
        assert found.features.path_connectivity is None
        assert not campaign.store.integrity()[0]
        assert list(campaign.select(where="broken_bonds > 0")) == []
    assert path.read_bytes() == before
    with Store(path) as store:
        store.use_campaign()
        store.record_results([records.with_arrays(2, 5.0)])
        assert not store.integrity()[0]
        assert [found.broken_bonds for found in store.results()] == [None, 3]
        with store._connections._engine.connect() as connection:
            assert connection.scalar(text("SELECT count(broken_bonds) FROM cells")) == 1
    with sqlite3.connect(path) as connection, pytest.raises(sqlite3.IntegrityError, match="broken_bonds"):
        connection.execute("UPDATE result SET broken_bonds = -1")
    connection.close()


def test_a_server_lets_only_a_writer_add_a_quantity(
    postgresql_socket: Path, address: str, open_here: Callable[..., Store]
) -> None:
    """A reader of a server's older tables says what to do; a database with unknown quantities is one of the future."""
    if "postgresql" not in address:
        pytest.skip("of servers alone")
    assert postgresql_socket
    with open_here()._connections._engine.begin() as connection:
        connection.execute(text("DROP VIEW cells"))
        connection.execute(text("ALTER TABLE result DROP COLUMN broken_bonds"))
        connection.execute(text("CREATE VIEW cells AS SELECT 1 AS one"))
    with pytest.raises(OtherSchemaError, match="lacks the quantities broken_bonds"):
        open_here(read_only=True)
    open_here()
    open_here(read_only=True)
    with open_here()._connections._engine.begin() as connection:
        connection.execute(text("ALTER TABLE result ADD COLUMN later FLOAT"))
    with pytest.raises(OtherSchemaError, match="the quantities later"):
        open_here()
