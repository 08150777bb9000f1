"""Add the table of graph summaries; cells stored before have none."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """Create the table."""
    op.create_table(
        "graph_summary",
        sa.Column("cell_id", sa.Integer(), nullable=False),
        sa.Column("contacts", sa.Integer(), nullable=False),
        sa.Column("bonded_contacts", sa.Integer(), nullable=False),
        sa.Column("coordination_number", sa.Double(), nullable=False),
        sa.Column("components", sa.Integer(), nullable=False),
        sa.Column("largest_component", sa.Integer(), nullable=False),
        sa.Column("gap_contacts", sa.Integer(), nullable=True),
        sa.CheckConstraint(
            "bonded_contacts >= 0 AND bonded_contacts <= contacts", name=op.f("ck_graph_summary_bonded_are_contacts")
        ),
        *(
            sa.CheckConstraint(
                f"{column} >= 0 AND {column} < 1e+300", name=op.f(f"ck_graph_summary_{column}_not_negative")
            )
            for column in ("coordination_number", "components", "largest_component", "gap_contacts")
        ),
        sa.ForeignKeyConstraint(
            ["cell_id"], ["result.cell_id"], name=op.f("fk_graph_summary_cell_id_result"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("cell_id", name=op.f("pk_graph_summary")),
    )
