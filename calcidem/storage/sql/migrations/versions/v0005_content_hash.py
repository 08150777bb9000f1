"""Packings have a content hash; one stored before gets it when it is next used, by who knows how to compute it."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Add the column."""
    op.add_column("packing", sa.Column("content_hash", sa.Text(), nullable=True))
