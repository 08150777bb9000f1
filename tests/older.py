"""A database that is older than some quantities."""

import re
import sqlite3
from dataclasses import replace
from pathlib import Path

from calcidem.storage.sql.store import Store

NEWEST = ("broken_bonds", "retry", "path_connectivity")


def leave_out(path: Path) -> Path:
    """Take quantities out of a database, as if they had been added after it was made, and give its path."""
    with Store(path) as store:
        store.use_campaign()
        cells = [
            replace(
                cell,
                broken_bonds=None,
                retry=None,
                features=cell.features and replace(cell.features, path_connectivity=None),
            )
            for cell in store.results(with_arrays=True)
        ]
        store.record_results(cells, replace_done=True)  # the checksums of older rows know nothing of them
    with sqlite3.connect(path) as connection:
        connection.execute("DROP VIEW cells")
        (table,) = connection.execute("SELECT sql FROM sqlite_master WHERE name = 'result'").fetchone()
        for name in NEWEST:
            table = re.sub(rf"\n\s*{name} [^\n]*,", "", table)
            table = re.sub(rf"\n\s*CONSTRAINT ck_result_{name}_[^\n]*,", "", table)
        columns = [row[1] for row in connection.execute("PRAGMA table_info(result)") if row[1] not in NEWEST]
        kept = ", ".join(columns)
        connection.execute(f"CREATE TEMP TABLE kept AS SELECT {kept} FROM result")  # noqa: S608 - a test's own
        connection.execute("DROP TABLE result")
        connection.execute(table)
        connection.execute(f"INSERT INTO result SELECT {kept} FROM kept")  # noqa: S608 - as above
        connection.execute("CREATE VIEW cells AS SELECT seed FROM cell")
    connection.close()
    return path
