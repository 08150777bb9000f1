"""First version of the schema."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None

CONDITIONS = {
    "positive": "{0} > 0 AND {0} < 1e+300",
    "not_negative": "{0} >= 0 AND {0} < 1e+300",
    "finite": "{0} > -1e+300 AND {0} < 1e+300",
}


def _checks(table: str, kind: str, columns: str) -> list[sa.CheckConstraint]:
    """Constraints that columns (their names between spaces) are numbers of a kind, or NULL."""
    return [
        sa.CheckConstraint(CONDITIONS[kind].format(column), name=op.f(f"ck_{table}_{column}_{kind}"))
        for column in columns.split()
    ]


def upgrade() -> None:
    """Create all tables."""
    op.create_table(
        "campaign",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("hash", sa.Text(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("config", sa.Text(), nullable=False),
        sa.Column("created", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_campaign")),
        sa.UniqueConstraint("hash", name=op.f("uq_campaign_hash")),
        sa.UniqueConstraint("name", name=op.f("uq_campaign_name")),
    )
    op.create_table(
        "cell",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("campaign_id", sa.Integer(), nullable=False),
        sa.Column("seed", sa.BigInteger(), nullable=False),
        sa.Column("content", sa.Double(), nullable=False),
        sa.CheckConstraint("content >= 0 AND content <= 100", name=op.f("ck_cell_content_percent")),
        sa.CheckConstraint("seed >= 0", name=op.f("ck_cell_seed_not_negative")),
        sa.ForeignKeyConstraint(["campaign_id"], ["campaign.id"], name=op.f("fk_cell_campaign_id_campaign")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_cell")),
        sa.UniqueConstraint("campaign_id", "seed", "content", name=op.f("uq_cell_campaign_id_seed_content")),
    )
    op.create_index(
        op.f("ix_cell_campaign_id_cell_content_cell_seed"), "cell", ["campaign_id", "content", "seed"], unique=False
    )
    op.create_table(
        "lease",
        sa.Column("campaign_id", sa.Integer(), nullable=False),
        sa.Column("token", sa.Text(), nullable=False),
        sa.Column("host", sa.Text(), nullable=False),
        sa.Column("pid", sa.Integer(), nullable=False),
        sa.Column("acquired", sa.DateTime(timezone=True), nullable=False),
        sa.Column("heartbeat", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["campaign_id"], ["campaign.id"], name=op.f("fk_lease_campaign_id_campaign")),
        sa.PrimaryKeyConstraint("campaign_id", name=op.f("pk_lease")),
    )
    op.create_table(
        "packing",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("campaign_id", sa.Integer(), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("hash", sa.Text(), nullable=False),
        sa.Column("grains", sa.LargeBinary(), nullable=False),
        sa.Column("width", sa.Double(), nullable=False),
        sa.Column("height", sa.Double(), nullable=False),
        sa.Column("porosity", sa.Double(), nullable=False),
        sa.Column("coordination_number", sa.Double(), nullable=False),
        sa.Column("coordination_number_without_rattlers", sa.Double(), nullable=False),
        sa.Column("wall_stress", sa.JSON(), nullable=False),
        sa.Column("mean_overlap", sa.Double(), nullable=False),
        sa.Column("largest_overlap", sa.Double(), nullable=False),
        sa.Column("unbalanced_ratio", sa.Double(), nullable=False),
        sa.Column("seconds", sa.Double(), nullable=False),
        sa.Column("state", sa.LargeBinary(), nullable=False),
        *_checks("packing", "positive", "height width"),
        *_checks("packing", "not_negative", "coordination_number coordination_number_without_rattlers number porosity"),
        *_checks("packing", "not_negative", "largest_overlap mean_overlap seconds unbalanced_ratio"),
        sa.ForeignKeyConstraint(["campaign_id"], ["campaign.id"], name=op.f("fk_packing_campaign_id_campaign")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_packing")),
        sa.UniqueConstraint("campaign_id", "number", name=op.f("uq_packing_campaign_id_number")),
    )
    op.create_table(
        "run",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("campaign_id", sa.Integer(), nullable=False),
        sa.Column("versions", sa.JSON(), nullable=False),
        sa.Column("host", sa.Text(), nullable=False),
        sa.Column("cpu", sa.Text(), nullable=False),
        sa.Column("ranks", sa.Integer(), nullable=False),
        sa.Column("launch_line", sa.Text(), nullable=False),
        sa.Column("started", sa.DateTime(timezone=True), nullable=False),
        sa.Column("mpi_library", sa.Text(), nullable=True),
        sa.Column("git_commit", sa.Text(), nullable=True),
        sa.Column("git_dirty", sa.Boolean(), nullable=True),
        sa.Column("slurm_job_id", sa.Text(), nullable=True),
        sa.Column("ended", sa.DateTime(timezone=True), nullable=True),
        sa.Column("exit_state", sa.Text(), nullable=True),
        sa.CheckConstraint("ranks >= 1", name=op.f("ck_run_ranks_positive")),
        sa.ForeignKeyConstraint(["campaign_id"], ["campaign.id"], name=op.f("fk_run_campaign_id_campaign")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_run")),
    )
    op.create_index(op.f("ix_run_campaign_id"), "run", ["campaign_id"], unique=False)
    op.create_table(
        "attempt",
        sa.Column("cell_id", sa.Integer(), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("run_id", sa.Integer(), nullable=True),
        sa.Column("outcome", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("rank", sa.Integer(), nullable=True),
        sa.Column("host", sa.Text(), nullable=True),
        sa.Column("seconds", sa.Double(), nullable=True),
        sa.Column("recorded", sa.DateTime(timezone=True), nullable=False),
        sa.Column("forgiven", sa.Boolean(), nullable=False),
        sa.CheckConstraint(
            "outcome IN ('done', 'no_arrival', 'unstable', 'failed', 'timed_out', 'quarantined', 'lost')",
            name=op.f("ck_attempt_outcome_known"),
        ),
        sa.CheckConstraint("number >= 1", name=op.f("ck_attempt_number_positive")),
        *_checks("attempt", "not_negative", "seconds"),
        sa.ForeignKeyConstraint(["cell_id"], ["cell.id"], name=op.f("fk_attempt_cell_id_cell")),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_attempt_run_id_run")),
        sa.PrimaryKeyConstraint("cell_id", "number", name=op.f("pk_attempt")),
    )
    op.create_table(
        "result",
        sa.Column("cell_id", sa.Integer(), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("status", sa.Text(), nullable=False),
        sa.Column("packing_index", sa.Integer(), nullable=False),
        sa.Column("vs", sa.Double(), nullable=True),
        sa.Column("vs_peak", sa.Double(), nullable=True),
        sa.Column("vs_first_arrival", sa.Double(), nullable=True),
        sa.Column("vs_cross_correlation", sa.Double(), nullable=True),
        sa.Column("quality_peak", sa.Double(), nullable=True),
        sa.Column("quality_first_arrival", sa.Double(), nullable=True),
        sa.Column("quality_cross_correlation", sa.Double(), nullable=True),
        sa.Column("frequency", sa.Double(), nullable=True),
        sa.Column("time_step", sa.Double(), nullable=True),
        sa.Column("stability_limit", sa.Double(), nullable=True),
        sa.Column("steps", sa.BigInteger(), nullable=True),
        sa.Column("energy_error", sa.Double(), nullable=True),
        sa.Column("error_estimate", sa.Double(), nullable=True),
        sa.Column("content_reached", sa.Double(), nullable=True),
        sa.Column("p_contacts", sa.Integer(), nullable=True),
        sa.Column("c_contacts", sa.Integer(), nullable=True),
        sa.Column("clusters", sa.Integer(), nullable=True),
        sa.Column("bonded_contacts", sa.Integer(), nullable=True),
        sa.CheckConstraint("(status = 'done') = (vs IS NOT NULL)", name=op.f("ck_result_vs_if_and_only_if_done")),
        sa.CheckConstraint(
            "status <> 'done' OR (vs IS NOT NULL AND frequency IS NOT NULL"
            " AND time_step IS NOT NULL AND stability_limit IS NOT NULL AND steps IS NOT NULL)",
            name=op.f("ck_result_done_has_numerics"),
        ),
        sa.CheckConstraint(
            "status IN ('done', 'no_arrival', 'unstable', 'failed', 'timed_out', 'quarantined')",
            name=op.f("ck_result_status_known"),
        ),
        *_checks(
            "result", "positive", "frequency stability_limit time_step vs vs_cross_correlation vs_first_arrival vs_peak"
        ),
        *_checks("result", "not_negative", "bonded_contacts c_contacts clusters content_reached p_contacts steps"),
        *_checks(
            "result",
            "finite",
            "energy_error error_estimate quality_cross_correlation quality_first_arrival quality_peak",
        ),
        sa.ForeignKeyConstraint(
            ["cell_id", "attempt"],
            ["attempt.cell_id", "attempt.number"],
            name=op.f("fk_result_cell_id_attempt_attempt"),
        ),
        sa.ForeignKeyConstraint(["cell_id"], ["cell.id"], name=op.f("fk_result_cell_id_cell")),
        sa.PrimaryKeyConstraint("cell_id", name=op.f("pk_result")),
    )
    op.create_index(op.f("ix_result_status_result_vs"), "result", ["status", "vs"], unique=False)
    op.create_table(
        "cement_pattern",
        sa.Column("cell_id", sa.Integer(), nullable=False),
        sa.Column("pattern", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["cell_id"], ["result.cell_id"], name=op.f("fk_cement_pattern_cell_id_result"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("cell_id", name=op.f("pk_cement_pattern")),
    )
    op.create_table(
        "path_features",
        sa.Column("cell_id", sa.Integer(), nullable=False),
        sa.Column("contacts", sa.Integer(), nullable=False),
        sa.Column("hertz_contacts", sa.Integer(), nullable=False),
        sa.Column("bonded_contacts", sa.Integer(), nullable=False),
        sa.Column("bonded_fraction", sa.Double(), nullable=False),
        sa.Column("longest_bonded_run_fraction", sa.Double(), nullable=False),
        sa.Column("longest_bonded_run", sa.Integer(), nullable=False),
        sa.Column("connectivity", sa.Double(), nullable=False),
        sa.Column("normalized_connectivity", sa.Double(), nullable=True),
        sa.Column("path", sa.JSON(), nullable=False),
        *_checks(
            "path_features",
            "finite",
            "bonded_fraction connectivity longest_bonded_run_fraction normalized_connectivity",
        ),
        sa.CheckConstraint(
            "hertz_contacts + bonded_contacts = contacts", name=op.f("ck_path_features_contacts_add_up")
        ),
        sa.ForeignKeyConstraint(
            ["cell_id"], ["result.cell_id"], name=op.f("fk_path_features_cell_id_result"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("cell_id", name=op.f("pk_path_features")),
    )
    op.create_table(
        "signal",
        sa.Column("cell_id", sa.Integer(), nullable=False),
        sa.Column("time_step", sa.Double(), nullable=False),
        sa.Column("samples", sa.LargeBinary(), nullable=False),
        *_checks("signal", "positive", "time_step"),
        sa.ForeignKeyConstraint(
            ["cell_id"], ["result.cell_id"], name=op.f("fk_signal_cell_id_result"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("cell_id", name=op.f("pk_signal")),
    )
