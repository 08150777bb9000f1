"""Database schema as SQLAlchemy 2 typed models; rules that can be stated as constraints are.

One `CellRow` for each planned (campaign, seed, content); its outcome, if it has one, is the `ResultRow` of the same id,
with `SignalRow`, `CementRow`, `PathRow` and `GraphRow` beside it. `AttemptRow` keeps the history. The absence of a
`ResultRow` is what "pending" means. `checksum` is explained in `calcidem.storage.sql.checksums`; a row without one is
damaged. Arrays are compressed NumPy ``.npz`` bytes (`calcidem.storage.records.arrays`).
"""

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    CheckConstraint,
    DateTime,
    Dialect,
    Double,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    LargeBinary,
    MetaData,
    Text,
    TypeDecorator,
    UniqueConstraint,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

from calcidem.storage.records.cell import COUNT_COLUMNS, NUMERICS_OF_DONE, POSITIVE_COLUMNS, STORED_STATUSES

LOST = "lost"
_LARGEST = 1e300  # a bound no physical number reaches, but infinity (and NaN, which PostgreSQL sorts last) does


class _UtcDateTime(TypeDecorator[datetime]):
    """A moment in UTC; SQLite has no time zones, so it is taken off on the way in and put back."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Store as UTC."""
        if value is None:
            return None
        moment = value.astimezone(UTC)
        return moment.replace(tzinfo=None) if dialect.name == "sqlite" else moment

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002 - the signature is SQLAlchemy's
        """Return with UTC attached."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Base(DeclarativeBase):
    """Base of all models: names of constraints and types of columns."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(column_0_N_label)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "ck": "ck_%(table_name)s_%(constraint_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map = {  # noqa: RUF012 - the name and the mutable default are SQLAlchemy's
        float: Double,
        str: Text,
        datetime: _UtcDateTime,
        dict[str, Any]: JSON,
        list[int]: JSON,
        list[dict[str, Any]]: JSON,
    }


def _check_finite(column: str, former_name: str | None = None) -> CheckConstraint:
    """Constraint that a column is a finite number or NULL; it keeps the name that the column had when it was made."""
    name = f"{former_name or column}_finite"
    return CheckConstraint(f"{column} > -{_LARGEST} AND {column} < {_LARGEST}", name=name)


def _check_positive(column: str) -> CheckConstraint:
    """Constraint that a column is a positive finite number or NULL."""
    return CheckConstraint(f"{column} > 0 AND {column} < {_LARGEST}", name=f"{column}_positive")


def _check_not_negative(column: str) -> CheckConstraint:
    """Constraint that a column is a finite number of 0 or more, or NULL."""
    return CheckConstraint(f"{column} >= 0 AND {column} < {_LARGEST}", name=f"{column}_not_negative")


def _check_one_of(column: str, values: tuple[str, ...]) -> CheckConstraint:
    """Constraint that a text column is one of the values."""
    return CheckConstraint(f"{column} IN ({', '.join(repr(str(v)) for v in values)})", name=f"{column}_known")


class CampaignRow(Base):
    """A physical configuration and its name (`CampaignRecord`; seeds and contents are those of its cells)."""

    __tablename__ = "campaign"

    id: Mapped[int] = mapped_column(primary_key=True)
    hash: Mapped[str] = mapped_column(unique=True)
    name: Mapped[str] = mapped_column(unique=True)
    config: Mapped[str]
    created: Mapped[datetime]
    checksum: Mapped[str | None]


class LeaseRow(Base):
    """The one process that may write a campaign."""

    __tablename__ = "lease"

    campaign_id: Mapped[int] = mapped_column(ForeignKey("campaign.id"), primary_key=True)
    token: Mapped[str]
    host: Mapped[str]
    pid: Mapped[int]
    acquired: Mapped[datetime]
    heartbeat: Mapped[datetime]


class RunRow(Base):
    """Provenance of one run (`RunRecord`)."""

    __tablename__ = "run"
    __table_args__ = (CheckConstraint("ranks >= 1", name="ranks_positive"), Index(None, "campaign_id"))

    id: Mapped[int] = mapped_column(primary_key=True)
    campaign_id: Mapped[int] = mapped_column(ForeignKey("campaign.id"))
    versions: Mapped[dict[str, Any]]
    host: Mapped[str]
    cpu: Mapped[str]
    ranks: Mapped[int]
    launch_line: Mapped[str]
    started: Mapped[datetime]
    mpi_library: Mapped[str | None]
    git_commit: Mapped[str | None]
    git_dirty: Mapped[bool | None]
    slurm_job_id: Mapped[str | None]
    ended: Mapped[datetime | None]
    exit_state: Mapped[str | None]
    workers: Mapped[list[dict[str, Any]] | None]
    checksum: Mapped[str | None]


class PackingRow(Base):
    """A packing with its report (`PackingRecord`); `grains` holds the arrays x, y and radius."""

    __tablename__ = "packing"
    __table_args__ = (
        UniqueConstraint("campaign_id", "number"),
        _check_not_negative("number"),
        _check_positive("width"),
        _check_positive("height"),
        *(_check_not_negative(c) for c in ("porosity", "coordination_number", "coordination_number_without_rattlers")),
        *(
            _check_not_negative(c)
            for c in ("mean_relative_overlap", "largest_relative_overlap", "unbalanced_ratio", "seconds")
        ),
    )

    id: Mapped[int] = mapped_column(primary_key=True)
    campaign_id: Mapped[int] = mapped_column(ForeignKey("campaign.id"))
    number: Mapped[int]
    hash: Mapped[str]
    grains: Mapped[bytes] = mapped_column(LargeBinary)
    width: Mapped[float]
    height: Mapped[float]
    porosity: Mapped[float]
    coordination_number: Mapped[float]
    coordination_number_without_rattlers: Mapped[float]
    wall_stress: Mapped[dict[str, Any]]
    mean_relative_overlap: Mapped[float]
    largest_relative_overlap: Mapped[float]
    unbalanced_ratio: Mapped[float]
    seconds: Mapped[float]
    state: Mapped[bytes] = mapped_column(LargeBinary)
    content_hash: Mapped[str | None]
    checksum: Mapped[str | None]


class CellRow(Base):
    """A planned cell."""

    __tablename__ = "cell"
    __table_args__ = (
        UniqueConstraint("campaign_id", "seed", "content"),
        Index(None, "campaign_id", "content", "seed"),
        CheckConstraint("seed >= 0", name="seed_not_negative"),
        CheckConstraint("content >= 0 AND content <= 100", name="content_percent"),
    )

    id: Mapped[int] = mapped_column(primary_key=True)
    campaign_id: Mapped[int] = mapped_column(ForeignKey("campaign.id"))
    seed: Mapped[int] = mapped_column(BigInteger)
    content: Mapped[float]


class AttemptRow(Base):
    """One attempt at a cell (`AttemptRecord`)."""

    __tablename__ = "attempt"
    __table_args__ = (
        CheckConstraint("number >= 1", name="number_positive"),
        _check_one_of("outcome", (*STORED_STATUSES, LOST)),
        _check_not_negative("seconds"),
    )

    cell_id: Mapped[int] = mapped_column(ForeignKey("cell.id"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int | None] = mapped_column(ForeignKey("run.id"))
    outcome: Mapped[str]
    reason: Mapped[str]
    rank: Mapped[int | None]
    host: Mapped[str | None]
    seconds: Mapped[float | None]
    recorded: Mapped[datetime]
    forgiven: Mapped[bool]
    checksum: Mapped[str | None]


class ResultRow(Base):
    """The outcome of a cell (`CellResult`); the attempt it came from has reason, rank, host and seconds."""

    __tablename__ = "result"
    __table_args__ = (
        ForeignKeyConstraint(["cell_id", "attempt"], ["attempt.cell_id", "attempt.number"]),
        _check_one_of("status", STORED_STATUSES),
        CheckConstraint("(status = 'done') = (vs IS NOT NULL)", name="vs_if_and_only_if_done"),
        CheckConstraint(
            "status <> 'done' OR (" + " AND ".join(f"{c} IS NOT NULL" for c in NUMERICS_OF_DONE) + ")",
            name="done_has_numerics",
        ),
        *(_check_positive(column) for column in POSITIVE_COLUMNS),
        *(_check_not_negative(column) for column in COUNT_COLUMNS if column not in {"seconds", "rank"}),
        *(_check_finite(c) for c in ("quality_peak", "quality_first_arrival", "quality_cross_correlation")),
        _check_finite("error_bound"),
        Index(None, "status", "vs"),
    )

    cell_id: Mapped[int] = mapped_column(ForeignKey("cell.id"), primary_key=True)
    attempt: Mapped[int]
    status: Mapped[str]
    packing_index: Mapped[int]
    vs: Mapped[float | None]
    vs_peak: Mapped[float | None]
    vs_first_arrival: Mapped[float | None]
    vs_cross_correlation: Mapped[float | None]
    quality_peak: Mapped[float | None]
    quality_first_arrival: Mapped[float | None]
    quality_cross_correlation: Mapped[float | None]
    frequency: Mapped[float | None]
    distance: Mapped[float | None]
    wavelengths_on_path: Mapped[float | None]
    wavelength_over_d50: Mapped[float | None]
    time_step: Mapped[float | None]
    stability_limit: Mapped[float | None]
    steps: Mapped[int | None] = mapped_column(BigInteger)
    expected_error: Mapped[float | None]
    error_bound: Mapped[float | None]
    static_speed: Mapped[float | None]
    content_reached: Mapped[float | None]
    content_of_contacts: Mapped[float | None]
    p_contacts: Mapped[int | None]
    c_contacts: Mapped[int | None]
    clusters: Mapped[int | None]
    bonded_contacts: Mapped[int | None]
    retry: Mapped[str | None]
    broken_bonds: Mapped[int | None]
    checksum: Mapped[str | None]


class SignalRow(Base):
    """Signals of a cell (`Signal`): one blob with the three arrays."""

    __tablename__ = "signal"
    __table_args__ = (_check_positive("sampling_interval"), _check_finite("start_time"))

    cell_id: Mapped[int] = mapped_column(ForeignKey("result.cell_id", ondelete="CASCADE"), primary_key=True)
    sampling_interval: Mapped[float]
    start_time: Mapped[float]
    samples: Mapped[bytes] = mapped_column(LargeBinary)


class CementRow(Base):
    """Cement pattern of a cell (`CementPattern`): one blob with the three arrays."""

    __tablename__ = "cement_pattern"

    cell_id: Mapped[int] = mapped_column(ForeignKey("result.cell_id", ondelete="CASCADE"), primary_key=True)
    pattern: Mapped[bytes] = mapped_column(LargeBinary)


class PathRow(Base):
    """Preferential path of a cell (`PathFeatures`)."""

    __tablename__ = "path_features"
    __table_args__ = (
        CheckConstraint("hertz_contacts + bonded_contacts = contacts", name="contacts_add_up"),
        *(_check_finite(c) for c in ("bonded_fraction", "longest_bonded_run_fraction")),
        *(_check_finite(c) for c in ("connectivity", "normalized_connectivity")),
    )

    cell_id: Mapped[int] = mapped_column(ForeignKey("result.cell_id", ondelete="CASCADE"), primary_key=True)
    contacts: Mapped[int]
    hertz_contacts: Mapped[int]
    bonded_contacts: Mapped[int]
    bonded_fraction: Mapped[float]
    longest_bonded_run_fraction: Mapped[float]
    longest_bonded_run: Mapped[int]
    connectivity: Mapped[float]
    normalized_connectivity: Mapped[float | None]
    path: Mapped[list[int]]


class GraphRow(Base):
    """Contact graph of a cell as a whole (`GraphSummary`)."""

    __tablename__ = "graph_summary"
    __table_args__ = (
        CheckConstraint("bonded_contacts >= 0 AND bonded_contacts <= contacts", name="bonded_are_contacts"),
        *(_check_not_negative(c) for c in ("coordination_number", "components", "largest_component", "gap_contacts")),
    )

    cell_id: Mapped[int] = mapped_column(ForeignKey("result.cell_id", ondelete="CASCADE"), primary_key=True)
    contacts: Mapped[int]
    bonded_contacts: Mapped[int]
    coordination_number: Mapped[float]
    components: Mapped[int]
    largest_component: Mapped[int]
    gap_contacts: Mapped[int | None]
