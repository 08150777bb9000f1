"""Migrations lead to the schema of the models, and old databases keep their values."""

import dataclasses
import re
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import CheckConstraint, create_engine, inspect

from calcidem.storage.campaign import open_stored_campaign
from calcidem.storage.errors import ReadOnlyStoreError
from calcidem.storage.netcdf.export import export_netcdf
from calcidem.storage.netcdf.import_netcdf import import_netcdf
from calcidem.storage.records import CellKey, CellStatus
from calcidem.storage.sql.migrations.new_columns import BROKEN_BONDS, NEW_COLUMNS
from calcidem.storage.sql.models import Base
from calcidem.storage.sql.schema import VERSION_TABLE, head_revision
from calcidem.storage.sql.store import SqlStore, open_store

if TYPE_CHECKING:
    from conftest import Records

# Made once by the calcidem of that schema with the factories of conftest.py. A new schema adds a file.
ASSETS = Path(__file__).parent / "assets"

OUTER_COMMA = r",(?![^()]*\))"
"""A comma that is not within the innermost parentheses."""


def statements(path: Path) -> dict[str, list[str]]:
    """Return the SQL of all tables and indices, the parts of each sorted: order, space and quotes are free."""
    with sqlite3.connect(path) as connection:
        found = connection.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall()
    connection.close()
    return {name: sorted(parts(sql)) for name, sql in found if name != VERSION_TABLE}


def parts(sql: str) -> list[str]:
    """Return what is before the outer parentheses of a statement, and what is between its outer commas."""
    head, _, rest = re.sub(r"\s+", " ", sql.replace('"', "")).partition("(")
    return [head.strip(), *(part.strip() for part in re.split(OUTER_COMMA, rest.rpartition(")")[0]))]


def test_migrations_give_the_schema_of_the_models(tmp_path: Path) -> None:
    """Migrating an empty SQLite file gives the same tables, constraints and indices as the models create."""
    open_store(tmp_path / "migrated.db").close()
    engine = create_engine(f"sqlite:///{tmp_path / 'created.db'}")
    Base.metadata.create_all(engine)
    engine.dispose()
    assert statements(tmp_path / "migrated.db") == statements(tmp_path / "created.db")


def test_alembic_sees_no_difference(open_here: Callable[..., SqlStore]) -> None:
    """Alembic's own comparison finds nothing to migrate on either backend."""
    with open_here()._engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"version_table": VERSION_TABLE, "compare_type": True})
        assert compare_metadata(context, Base.metadata) == []
        found = inspect(connection)
        for name, table in Base.metadata.tables.items():  # what alembic does not compare
            constraints = table.constraints.union(*(column.constraints for column in table.columns))
            checks = {str(check.name) for check in constraints if isinstance(check, CheckConstraint)}
            # SQLAlchemy 2.0.30 takes what follows a column's constraint in SQLite for a part of its name.
            reflected = " ".join(f"{check['name']} {check['sqltext']}" for check in found.get_check_constraints(name))
            assert set(re.findall(r"\bck_\w+", reflected)) == checks


@pytest.mark.parametrize("schema", ["0001", "0002", "0003", "0004", "0005", "0006"])
def test_old_database_upgrades_and_keeps_its_values(tmp_path: Path, records: "Records", schema: str) -> None:
    """The kept databases of all schemas are upgraded, have the values they were made with, and take new ones."""
    path = tmp_path / "old.db"
    shutil.copy(ASSETS / f"schema_{schema}.db", path)
    with open_store(path) as store:
        store.use_campaign()
        store.record_results([records.with_arrays(3, 5.0)])
    with open_stored_campaign(path) as campaign:
        assert campaign.record == records.campaign()
        assert campaign.cell(seed=3, content=5.0) == records.with_arrays(3, 5.0)
        stored = records.with_arrays(1, 5.0)
        # The first schema had no graph summaries, the second no retry, those before 0006 no meaning of vs, none the
        # broken bonds; the rest is as it was.
        unknown = {"0001": ("graph", "retry"), "0002": ("retry",)}.get(schema, ())
        meaning = NEW_COLUMNS if schema < "0006" else ()
        expected = dataclasses.replace(stored, **dict.fromkeys((*unknown, *meaning, BROKEN_BONDS)))  # type: ignore[arg-type]  # all may be None
        assert campaign.cell(seed=1, content=5.0) == expected
        assert campaign.packing() == records.packing()
        assert [run for _, run in campaign.runs()] == [records.run()]
        assert [a.outcome for a in campaign.history(seed=2, content=5.0)] == ["lost", "no_arrival"]
        assert campaign.status_counts()[5.0, CellStatus.NO_ARRIVAL] == 1
    with sqlite3.connect(path) as connection:
        assert connection.execute(f"SELECT version_num FROM {VERSION_TABLE}").fetchone() == (head_revision(),)  # noqa: S608 - a constant
    connection.close()


@pytest.mark.parametrize("schema", ["0003", "0004", "0005", "0006"])
def test_former_database_is_read_as_it_is(tmp_path: Path, schema: str) -> None:
    """A reader finds in a database of a former schema what it finds once that is upgraded, and leaves it as it is."""
    former, upgraded = tmp_path / "former.db", tmp_path / "upgraded.db"
    for path in (former, upgraded):
        shutil.copy(ASSETS / f"schema_{schema}.db", path)
    before = former.read_bytes()
    open_store(upgraded).close()
    with open_stored_campaign(former) as one, open_stored_campaign(upgraded) as other:
        assert list(one.select(with_arrays=True)) == list(other.select(with_arrays=True))
        assert one.signal(seed=1, content=5.0) == other.signal(seed=1, content=5.0)
        assert one.packing() == other.packing()
        assert one.runs() == other.runs()
        assert one.to_xarray().equals(other.to_xarray())
        export_netcdf(one.store, one.record, tmp_path / "former.nc")
        with pytest.raises(ReadOnlyStoreError):
            one.store.record_lost([CellKey(1, 5.0)], "killed")
    assert former.read_bytes() == before
    with open_store(tmp_path / "imported.db") as imported, open_stored_campaign(upgraded) as other:
        import_netcdf(tmp_path / "former.nc", imported)
        assert list(imported.results(with_arrays=True)) == list(other.select(with_arrays=True))
