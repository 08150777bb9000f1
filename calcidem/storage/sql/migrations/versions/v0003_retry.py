"""Add why a sample was sent a second time; for cells stored before, that is not known."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """Add the column."""
    op.add_column("result", sa.Column("retry", sa.Text(), nullable=True))
