"""Signals say when their samples were taken, and the overlaps of a packing that they are relative."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"

START_TIME = (
    "COALESCE((SELECT (ROUND(signal.time_step / result.time_step) - 0.5) * result.time_step FROM result"
    " WHERE result.cell_id = signal.cell_id), signal.time_step)"
)
"""Of a former signal, whose `time_step` was the interval between its samples.

A sample is taken at the end of a step, at whose middle its velocity is. To the last bit this is the time that a run
stores now; where the step is not known, its half is left out.
"""

BOUND = "1e+300"
SIGNAL_CHECKS = {
    "sampling_interval_positive": f"sampling_interval > 0 AND sampling_interval < {BOUND}",
    "start_time_finite": f"start_time > -{BOUND} AND start_time < {BOUND}",
}
PACKING_CHECKS = {
    **{f"{name}_positive": f"{name} > 0 AND {name} < {BOUND}" for name in ("width", "height")},
    **{
        f"{name}_not_negative": f"{name} >= 0 AND {name} < {BOUND}"
        for name in (
            *("number", "porosity", "coordination_number", "coordination_number_without_rattlers"),
            *("mean_relative_overlap", "largest_relative_overlap", "unbalanced_ratio", "seconds"),
        )
    },
}


def upgrade() -> None:
    """Rename the columns, and compute when the first sample of each stored signal was taken."""
    op.add_column("signal", sa.Column("start_time", sa.Double(), nullable=True))
    op.execute(f"UPDATE signal SET start_time = {START_TIME}")  # noqa: S608 - a constant
    _rename("signal", {"time_step": "sampling_interval"}, SIGNAL_CHECKS, {"time_step_positive"}, required="start_time")
    overlaps = {f"{which}_overlap": f"{which}_relative_overlap" for which in ("mean", "largest")}
    _rename("packing", overlaps, PACKING_CHECKS, {f"{name}_not_negative" for name in overlaps})


def _rename(
    name: str, columns: dict[str, str], checks: dict[str, str], former: set[str], required: str | None = None
) -> None:
    """Rename columns of a table and make one required.

    SQLite has the table made anew. Which checks of it SQLAlchemy reads depends on its version, so they are said here.
    """
    connection = op.get_bind()
    is_remade = connection.dialect.name == "sqlite"
    table = sa.Table(name, sa.MetaData(), autoload_with=connection)
    table.constraints -= {found for found in table.constraints if isinstance(found, sa.CheckConstraint)}
    with op.batch_alter_table(name, copy_from=table) as batch:
        for check in () if is_remade else sorted(former):
            batch.drop_constraint(op.f(f"ck_{name}_{check}"), type_="check")
        for old, new in columns.items():
            batch.alter_column(old, new_column_name=new)
        if required is not None:
            batch.alter_column(required, existing_type=sa.Double(), nullable=False)
        for check, condition in checks.items():
            if is_remade or any(check.startswith(f"{column}_") for column in (*columns.values(), required)):
                batch.create_check_constraint(op.f(f"ck_{name}_{check}"), condition)
