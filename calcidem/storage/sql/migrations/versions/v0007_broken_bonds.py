"""Cells say how many of their bonds the pulse broke. Of cells stored before, that is not known."""

import sqlalchemy as sa
from alembic import op

from calcidem.storage.sql.migrations.new_columns import BROKEN_BONDS

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    """Add the column; rows that lack a number keep their checksums (`calcidem.storage.sql.checksums`)."""
    name = op.f("ck_result_broken_bonds_not_negative")
    check = sa.CheckConstraint("broken_bonds >= 0 AND broken_bonds < 1e+300", name=name)
    op.add_column("result", sa.Column(BROKEN_BONDS, sa.Integer(), check, nullable=True))
