"""Database schema: tables, and rules that can be stated as constraints.

One `CellRow` for each planned (campaign, seed, content); its outcome, if it has one, is the row of `RESULT` of the same
id, with its arrays in `ARRAYS`. The columns of `RESULT` are made from the catalogue of quantities. `AttemptRow` keeps
the history. The absence of a result is what "pending" means. `checksum` is explained in
`calcidem.storage.sql.checksums`; a row without one is damaged. Arrays are compressed NumPy ``.npz``
bytes (`calcidem.storage.records.arrays`).
"""

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    CheckConstraint,
    Column,
    DateTime,
    Dialect,
    Double,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    LargeBinary,
    MetaData,
    Select,
    SQLColumnExpression,
    Table,
    Text,
    TypeDecorator,
    UniqueConstraint,
    and_,
    func,
    literal_column,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column
from sqlalchemy.types import TypeEngine

from calcidem.storage.records import (
    ARRAY_RECORDS,
    QUANTITY_BY_NAME,
    STORED_STATUSES,
    CellStatus,
    PackingRecord,
    Quantity,
)
from calcidem.storage.records.quantity import Bound, quantities_of

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


def condition_of(quantity: Quantity) -> str:
    """What its bound demands of a column that is not NULL, in SQL; empty for nothing."""
    least = {Bound.POSITIVE: "> 0", Bound.NOT_NEGATIVE: ">= 0", Bound.NONE: f"> -{_LARGEST}"}[quantity.bound]
    if quantity.kind == "text" or (quantity.kind == "whole" and quantity.bound is Bound.NONE):
        return ""
    return f"{quantity.name} {least} AND {quantity.name} < {_LARGEST}"


def check_name(quantity: Quantity) -> str:
    """Name of the constraint that holds its bound."""
    return f"{quantity.name}_{quantity.bound.name.lower() if quantity.bound is not Bound.NONE else 'finite'}"


_TYPES: dict[str, type[TypeEngine[Any]]] = {"real": Double, "whole": BigInteger, "text": Text}


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
    """A packing with its report (`PackingRecord`), whose numbers are columns, too; `grains` has x, y and radius."""

    __tablename__ = "packing"
    __table_args__ = (
        UniqueConstraint("campaign_id", "number"),
        _check_not_negative("number"),
        *(CheckConstraint(condition_of(q), name=check_name(q)) for q in quantities_of(PackingRecord)),
    )

    id: Mapped[int] = mapped_column(primary_key=True)
    campaign_id: Mapped[int] = mapped_column(ForeignKey("campaign.id"))
    number: Mapped[int]
    hash: Mapped[str]
    grains: Mapped[bytes] = mapped_column(LargeBinary)
    wall_stress: Mapped[dict[str, Any]]
    state: Mapped[bytes] = mapped_column(LargeBinary)
    content_hash: Mapped[str | None]
    checksum: Mapped[str | None]


for _quantity in quantities_of(PackingRecord):
    setattr(PackingRow, _quantity.name, mapped_column(_TYPES[_quantity.kind], nullable=False))


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


CELL, ATTEMPT, PACKING, RUN = (
    Base.metadata.tables[row.__tablename__] for row in (CellRow, AttemptRow, PackingRow, RunRow)
)

_TABLES_ELSEWHERE = {"seed": CELL, "content": CELL, **dict.fromkeys(("reason", "seconds", "rank", "host"), ATTEMPT)}
"""Quantities that are in the rows of the cell and of its attempt."""

STORED_QUANTITIES = tuple(q for q in QUANTITY_BY_NAME.values() if q.formula is None and q.name not in _TABLES_ELSEWHERE)
"""Quantities that are columns of the table `result`."""

RESULT = Table(
    "result",
    Base.metadata,
    Column("cell_id", ForeignKey("cell.id"), primary_key=True),
    *(Column(q.name, _TYPES[q.kind], nullable=q.is_optional) for q in STORED_QUANTITIES),
    Column("checksum", Text),
    ForeignKeyConstraint(["cell_id", "attempt"], ["attempt.cell_id", "attempt.number"]),
    _check_one_of("status", STORED_STATUSES),
    CheckConstraint("(status = 'done') = (vs IS NOT NULL)", name="vs_if_and_only_if_done"),
    CheckConstraint(
        "status <> 'done' OR (" + " AND ".join(f"{q.name} IS NOT NULL" for q in STORED_QUANTITIES if q.is_needed) + ")",
        name="done_has_numerics",
    ),
    CheckConstraint("path_hertz_contacts + path_bonded_contacts = path_contacts", name="path_adds_up"),
    CheckConstraint("graph_bonded_contacts <= graph_contacts", name="graph_bonded_are_contacts"),
    *(CheckConstraint(condition_of(q), name=check_name(q)) for q in STORED_QUANTITIES if condition_of(q)),
    Index(None, "status", "vs"),
)
"""The outcomes of cells (`CellResult`); the attempt that one came from has its reason, rank, host and seconds."""

ARRAYS = Table(
    "arrays",
    Base.metadata,
    Column("cell_id", ForeignKey("result.cell_id", ondelete="CASCADE"), primary_key=True),
    Column("name", Text, primary_key=True),
    Column("content", LargeBinary, nullable=False),
    _check_one_of("name", tuple(ARRAY_RECORDS)),
)
"""Arrays beside an outcome, each a blob by the name of its field in `CellResult` (`ARRAY_RECORDS`)."""

STATUS = func.coalesce(RESULT.c.status, literal_column(repr(CellStatus.PENDING.value)))
"""A planned cell without a result is pending.

The word is part of the SQL text: PostgreSQL takes two parameters for different even when they are equal,
and refuses to group by this.
"""

EXPRESSIONS: dict[str, SQLColumnExpression[Any]] = {
    name: STATUS if name == "status" else _TABLES_ELSEWHERE.get(name, RESULT).c[name]
    for name, quantity in QUANTITY_BY_NAME.items()
    if quantity.formula is None
}
"""What each stored quantity is in a query over `join_results`."""


def expression_of(name: str) -> SQLColumnExpression[Any]:
    """What a quantity, stored or derived, is in a query over `join_results`."""
    quantity = QUANTITY_BY_NAME[name]
    if quantity.formula is None:
        return EXPRESSIONS[name]
    found: SQLColumnExpression[Any] = quantity.formula(func.sqrt, *(EXPRESSIONS[needed] for needed in quantity.needs))
    return found


def join_results(statement: Select[*tuple[Any, ...]]) -> Select[*tuple[Any, ...]]:
    """Join a planned cell with its outcome and the attempt that it came from, where there are any."""
    return (
        statement.select_from(CELL)
        .outerjoin(RESULT, RESULT.c.cell_id == CELL.c.id)
        .outerjoin(ATTEMPT, and_(ATTEMPT.c.cell_id == CELL.c.id, ATTEMPT.c.number == RESULT.c.attempt))
    )
