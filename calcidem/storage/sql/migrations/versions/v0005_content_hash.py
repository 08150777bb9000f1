"""Packings have a content hash, and runs say what their workers were.

A packing stored before gets its hash when it is next used, by who knows how to compute it; of runs that is not known.
"""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Add the columns."""
    op.add_column("packing", sa.Column("content_hash", sa.Text(), nullable=True))
    op.add_column("run", sa.Column("workers", sa.JSON(), nullable=True))
