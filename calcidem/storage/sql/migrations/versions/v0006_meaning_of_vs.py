"""Cells say what their velocity means: on which distance, on how many wavelengths, how exact, in how much calcite.

The estimated error of a velocity was a bound of it, and is called so. Of cells stored before, the rest is not known.

Rows have checksums; those of rows stored before are computed after all migrations (`calcidem.storage.sql.checksums`).
"""

import sqlalchemy as sa
from alembic import op

from calcidem.storage.sql.migrations.new_columns import NEW_COLUMNS

revision = "0006"
down_revision = "0005"

_CHECKS_OF = {"positive": "{0} > 0 AND {0} < 1e+300", "not_negative": "{0} >= 0 AND {0} < 1e+300"}


def upgrade() -> None:
    """Rename the column, and add the others, each with its check: SQLite adds none to a table that is there."""
    # Not by making the table anew: dropping the old one would drop the signals and patterns that hang on it. The check
    # of the column keeps its name, which no database can change.
    op.execute("ALTER TABLE result RENAME COLUMN error_estimate TO error_bound")
    for name, kind in NEW_COLUMNS.items():
        check = sa.CheckConstraint(_CHECKS_OF[kind].format(name), name=op.f(f"ck_result_{name}_{kind}"))
        op.add_column("result", sa.Column(name, sa.Double(), check, nullable=True))
    for table in ("result", "attempt", "packing", "run"):
        op.add_column(table, sa.Column("checksum", sa.Text(), nullable=True))
