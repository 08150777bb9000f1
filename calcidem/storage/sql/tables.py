"""Tables of a database, made from the frozen records, and their version; filters of queries on them.

`CELL` has one row for each planned (campaign, seed, content). Its outcome, if any, is the row of `RESULT` with the same
id, with arrays in `ARRAYS`. A cell without a result is pending. `ATTEMPT` keeps the history. A filter such as
``vs > 1500 and status == 'done'`` becomes an expression with bound parameters.
"""

import ast
import difflib
import io
import math
import operator
import sys
import tokenize
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields
from datetime import UTC, datetime
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

import sqlalchemy as sa
from sqlalchemy import ColumnElement, SQLColumnExpression, and_, literal, not_, or_
from sqlalchemy.types import TypeEngine

from calcidem.ends import CellStatus
from calcidem.storage.errors import DAMAGE_REMEDY, DamagedStoreError, ForeignDatabaseError, OtherSchemaError, QueryError
from calcidem.storage.quantity import Bound, Quantity
from calcidem.storage.records import (
    ARRAY_RECORDS,
    LARGEST_SEED,
    QUANTITY_BY_NAME,
    STORED_STATUSES,
    AttemptRecord,
    CampaignRecord,
    LeaseHolder,
    PackingRecord,
    RunRecord,
)
from calcidem.storage.sql.engine import Address

_SCHEMA = 4
"""Version of these tables."""

_METADATA = sa.MetaData(
    naming_convention={
        "ix": "ix_%(column_0_N_label)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
        "pk": "pk_%(table_name)s",
    }
)


class _UtcDateTime(sa.TypeDecorator[datetime]):
    """A time in UTC; SQLite has no time zones, so the zone is removed on writing and restored on reading."""

    impl = sa.DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        """Store as UTC."""
        if value is None:
            return None
        moment = value.astimezone(UTC)
        return moment.replace(tzinfo=None) if dialect.name == "sqlite" else moment

    def process_result_value(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:  # noqa: ARG002 - the signature is SQLAlchemy's
        """Return with UTC attached."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class _Checked(sa.TypeDecorator[Any]):
    """A value of one kind; SQLite keeps whatever a damaged file has in its place."""

    impl: TypeEngine[Any] | type[TypeEngine[Any]] = sa.Text
    cache_ok = True

    def __init__(self, kind: type, impl: TypeEngine[Any]) -> None:
        super().__init__()
        self.kind, self.impl = kind, impl

    def process_result_value(self, value: object, dialect: sa.Dialect) -> object:  # noqa: ARG002 - as above
        """Return the value; `DamagedStoreError` if it is of another kind."""
        if value is None or isinstance(value, self.kind):
            return value
        raise DamagedStoreError(f"The database has {value!r} in the place of a {self.kind.__name__}.", DAMAGE_REMEDY)


_TYPES: dict[Any, type[TypeEngine[Any]] | TypeEngine[Any]] = {
    str: _Checked(str, sa.Text()),
    int: _Checked(int, sa.BigInteger()),
    float: sa.Double,
    bool: sa.Boolean,
    bytes: sa.LargeBinary,
    datetime: _UtcDateTime,
    # Kinds of quantities, which `CellResult` checks.
    "text": sa.Text,
    "whole": sa.BigInteger,
    "real": sa.Double,
}


def _columns_of(record: type, *left_out: str) -> list[sa.Column[Any]]:
    """Columns for the fields of a record, except for fields stored elsewhere; mappings and tuples are JSON."""
    hints = get_type_hints(record)
    columns = []
    for name in [field.name for field in fields(record) if field.name not in left_out]:
        choices = get_args(hints[name]) if get_origin(hints[name]) is UnionType else (hints[name],)
        kind = next((choice for choice in choices if choice in _TYPES), None)
        columns.append(sa.Column(name, sa.JSON if kind is None else _TYPES[kind], nullable=NoneType in choices))
    return columns


def _checks_of(quantities: Iterable[Quantity]) -> list[sa.CheckConstraint]:
    """Constraints for the bounds of columns that are not NULL.

    No physical number reaches 1e300, but infinity does, and NaN, which PostgreSQL sorts last.
    """
    least = {Bound.POSITIVE: "> 0", Bound.NOT_NEGATIVE: ">= 0", Bound.NONE: "> -1e300"}
    return [
        sa.CheckConstraint(
            f"{quantity.name} {least[quantity.bound]} AND {quantity.name} < 1e300",
            name=f"{quantity.name}_{'finite' if quantity.bound is Bound.NONE else quantity.bound.name.lower()}",
        )
        for quantity in quantities
        if quantity.kind != "text" and (quantity.kind == "real" or quantity.bound is not Bound.NONE)
    ]


def _check_one_of(column: str, values: tuple[str, ...]) -> sa.CheckConstraint:
    """Constraint that a text column is one of the values."""
    return sa.CheckConstraint(f"{column} IN ({', '.join(repr(str(v)) for v in values)})", name=f"{column}_known")


_VERSION = sa.Table("calcidem_schema", _METADATA, sa.Column("version", sa.Integer, primary_key=True))
"""Holds the version, and identifies a database of calcidem."""

CAMPAIGN = sa.Table(
    "campaign",
    _METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    *_columns_of(CampaignRecord, "seeds", "contents"),
    sa.UniqueConstraint("hash"),
    sa.UniqueConstraint("name"),
)
"""A physical configuration and its name (`CampaignRecord`; seeds and contents are those of its cells)."""

LEASE = sa.Table(
    "lease",
    _METADATA,
    sa.Column("campaign_id", sa.ForeignKey("campaign.id"), primary_key=True),
    sa.Column("token", sa.Text, nullable=False),
    *_columns_of(LeaseHolder),
)
"""Process that may write a campaign."""

RUN = sa.Table(
    "run",
    _METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("campaign_id", sa.ForeignKey("campaign.id"), nullable=False),
    *_columns_of(RunRecord),
    sa.CheckConstraint("ranks >= 1", name="ranks_positive"),
    sa.Index(None, "campaign_id"),
)
"""Provenance of one run (`RunRecord`)."""

PACKING = sa.Table(
    "packing",
    _METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("campaign_id", sa.ForeignKey("campaign.id"), nullable=False),
    sa.Column("number", sa.Integer, nullable=False),
    sa.Column("grains", sa.LargeBinary, nullable=False),
    *_columns_of(PackingRecord, "index", "x", "y", "radius"),
    sa.UniqueConstraint("campaign_id", "number"),
    sa.CheckConstraint("number >= 0", name="number_not_negative"),
    *_checks_of(PackingRecord.quantities()),
)
"""A packing with its report (`PackingRecord`); `grains` has x, y and radius."""

CELL = sa.Table(
    "cell",
    _METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("campaign_id", sa.ForeignKey("campaign.id"), nullable=False),
    sa.Column("seed", sa.BigInteger, nullable=False),
    sa.Column("content", sa.Double, nullable=False),
    sa.UniqueConstraint("campaign_id", "seed", "content"),
    sa.Index(None, "campaign_id", "content", "seed"),
    sa.CheckConstraint("seed >= 0", name="seed_not_negative"),
    sa.CheckConstraint("content >= 0 AND content <= 100", name="content_percent"),
)
"""A planned cell."""

ATTEMPT = sa.Table(
    "attempt",
    _METADATA,
    sa.Column("cell_id", sa.ForeignKey("cell.id"), primary_key=True),
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("run_id", sa.ForeignKey("run.id")),
    *_columns_of(AttemptRecord, "key", "number", "run_id"),
    *_checks_of(AttemptRecord.quantities()),
    _check_one_of("outcome", (*STORED_STATUSES, "lost", CellStatus.RUNNING.value)),
)
"""One attempt at a cell (`AttemptRecord`)."""

_TABLES_ELSEWHERE = {"seed": CELL, "content": CELL, **dict.fromkeys(("reason", "seconds", "rank", "host"), ATTEMPT)}
"""Quantities in the rows of the cell and of its attempt."""

_STORED_QUANTITIES = [q for q in QUANTITY_BY_NAME.values() if q.formula is None and q.name not in _TABLES_ELSEWHERE]
"""Quantities that are columns of the table `result`."""

RESULT = sa.Table(
    "result",
    _METADATA,
    sa.Column("cell_id", sa.ForeignKey("cell.id"), primary_key=True),
    *(sa.Column(q.name, _TYPES[q.kind], nullable=q.is_optional) for q in _STORED_QUANTITIES),
    sa.ForeignKeyConstraint(["cell_id", "attempt"], ["attempt.cell_id", "attempt.number"]),
    _check_one_of("status", STORED_STATUSES),
    sa.CheckConstraint("(status = 'done') = (vs IS NOT NULL)", name="vs_if_and_only_if_done"),
    sa.CheckConstraint(
        f"status <> 'done' OR ({' AND '.join(f'{q.name} IS NOT NULL' for q in _STORED_QUANTITIES if q.is_needed)})",
        name="done_has_numerics",
    ),
    sa.CheckConstraint("path_hertz_contacts + path_bonded_contacts = path_contacts", name="path_adds_up"),
    *_checks_of(_STORED_QUANTITIES),
    sa.Index(None, "status", "vs"),
)
"""Outcomes of cells (`CellResult`).

The attempt of an outcome has its reason, rank, host and seconds.
"""

ARRAYS = sa.Table(
    "arrays",
    _METADATA,
    sa.Column("cell_id", sa.ForeignKey("result.cell_id", ondelete="CASCADE"), primary_key=True),
    sa.Column("name", sa.Text, primary_key=True),
    sa.Column("content", sa.LargeBinary, nullable=False),
    _check_one_of("name", tuple(ARRAY_RECORDS)),
)
"""Arrays of an outcome, each a blob by the name of its field in `CellResult` (`ARRAY_RECORDS`)."""

QUANTITIES = sa.Table(
    "quantities",
    _METADATA,
    *(sa.Column(name, sa.Text, primary_key=name == "name", nullable=False) for name in ("name", "unit", "meaning")),
)
"""Columns of the view `cells` and the arrays of the blobs in `arrays`, explained for those who read the database."""

STATUS = sa.func.coalesce(RESULT.c.status, sa.literal_column(repr(CellStatus.PENDING.value)))
"""A planned cell without a result is pending.

The word is part of the SQL text: PostgreSQL treats equal parameters as different and would refuse to group by them.
"""

EXPRESSIONS: dict[str, sa.SQLColumnExpression[Any]] = {
    name: STATUS if name == "status" else _TABLES_ELSEWHERE.get(name, RESULT).c[name]
    for name, quantity in QUANTITY_BY_NAME.items()
    if quantity.formula is None
}
"""Expression of each quantity in a query over `join_results`: first the stored ones, then those that follow."""

EXPRESSIONS |= {
    name: quantity.formula(sa.func.sqrt, *(EXPRESSIONS[needed] for needed in quantity.needs))
    for name, quantity in QUANTITY_BY_NAME.items()
    if quantity.formula is not None
}


def join_results(statement: sa.Select[*tuple[Any, ...]]) -> sa.Select[*tuple[Any, ...]]:
    """Join a planned cell with its outcome and the attempt of this, if any."""
    return (
        statement.select_from(CELL)
        .outerjoin(RESULT, RESULT.c.cell_id == CELL.c.id)
        .outerjoin(ATTEMPT, sa.and_(ATTEMPT.c.cell_id == CELL.c.id, ATTEMPT.c.number == RESULT.c.attempt))
    )


def exclude_others(connection: sa.Connection) -> None:
    """Let others that make tables, campaigns or leases wait for the end of the transaction, as in SQLite anyway."""
    if connection.dialect.name == "postgresql":
        connection.execute(sa.select(sa.func.pg_advisory_xact_lock(0x63616C63)))  # "calc": a number of its own


def prepare_schema(connection: sa.Connection, address: Address, *, read_only: bool) -> None:
    """Create the tables of an empty database, within the connection's transaction; refuse a database of another kind.

    `ForeignDatabaseError` if it has tables but not calcidem's mark, or is empty and only read; `OtherSchemaError` if
    another calcidem wrote it; `DamagedStoreError` if it lacks a table.
    """
    if not read_only:
        exclude_others(connection)
    inspector = sa.inspect(connection)
    tables = inspector.get_table_names()
    if not tables:
        if read_only:
            raise ForeignDatabaseError(f"{address} is empty.", "Give the database of a campaign that has been started.")
        _METADATA.create_all(connection)
        connection.execute(sa.insert(_VERSION).values(version=_SCHEMA))
        quantities: list[Any] = [EXPRESSIONS[name].label(name) for name in QUANTITY_BY_NAME]
        statement = join_results(sa.select(CAMPAIGN.c.name.label("campaign"), *quantities))
        statement = statement.join(CAMPAIGN, CAMPAIGN.c.id == CELL.c.campaign_id)
        # For direct queries: one row for each cell.
        connection.execute(sa.text(f"CREATE VIEW cells AS {statement.compile(dialect=connection.dialect)}"))
        connection.execute(sa.insert(QUANTITIES), list(_described()))
        return
    if _VERSION.name not in tables:
        raise ForeignDatabaseError(
            f"{address} is a database of another program (its tables: {', '.join(sorted(tables)[:5])}).",
            "Choose another name; it was left as it is.",
        )
    is_numbered = "version" in {column["name"] for column in inspector.get_columns(_VERSION.name)}  # not before 1.0
    version = connection.scalar(sa.select(sa.func.max(_VERSION.c.version))) if is_numbered else 0
    if version == _SCHEMA and (lacking := _METADATA.tables.keys() - set(tables)):
        raise DamagedStoreError(f"{address} lacks the table {', '.join(sorted(lacking))}.", DAMAGE_REMEDY)
    own = {column["name"] for column in inspector.get_columns(RESULT.name)} if version == _SCHEMA else set()
    if own != set(RESULT.c.keys()):
        differing = ", ".join(sorted(own ^ set(RESULT.c.keys()))) if own else f"schema {version}, not {_SCHEMA}"
        raise OtherSchemaError(
            f"{address} was written by another version of calcidem, whose tables this one does not read ({differing}).",
            "Export it with that version ('calcidem export'), and import the file into a new database; it was left as "
            "it is.",
        )


def _described() -> Iterator[dict[str, str]]:
    """Rows of `QUANTITIES`."""
    yield {"name": "campaign", "unit": "", "meaning": "name of the campaign"}
    for quantity in QUANTITY_BY_NAME.values():
        yield {"name": quantity.name, "unit": quantity.unit, "meaning": quantity.meaning}
    for record, kind in ARRAY_RECORDS.items():
        for quantity in kind.quantities():
            yield {"name": f"{record}.{quantity.name}", "unit": quantity.unit, "meaning": quantity.meaning}
        for name, along in kind.arrays().items():
            rows = " x ".join(filter(None, (along.dimension, along.columns or str(along.width or ""))))
            yield {"name": f"{record}.{name}", "unit": along.unit, "meaning": f"{along.meaning}; {rows}"}


_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}

_EXAMPLE = 'Write for example "vs > 1500 and status == \'done\'", "content in (4, 5)" or "vs_peak is None".'


def hint_at_quantity(unknown: str) -> str:
    """Sentence with the quantity that a wrong name resembles, else with all."""
    close = difflib.get_close_matches(unknown, list(QUANTITY_BY_NAME), n=1)
    return f"Did you mean '{close[0]}'?" if close else f"Known are: {', '.join(QUANTITY_BY_NAME)}."


def parse_where(text: str) -> ColumnElement[bool]:
    """Convert a filter expression to a condition of a query.

    It compares quantities (``< <= > >= == = !=``, ``in``, ``not in``, ``is None``, ``is not None``) with numbers or
    quoted words, joined by ``and``, ``or``, ``not`` and parentheses. `QueryError` for any other text or an unknown
    quantity.
    """
    if len(text) > 10_000:
        raise QueryError(f"The filter has {len(text)} characters.", "Write it in at most 10,000.")
    try:
        tokens = tokenize.generate_tokens(io.StringIO(text.strip()).readline)  # a single = as in SQL
        tree = ast.parse(
            tokenize.untokenize((t.type, "==" if t.string == "=" else t.string) for t in tokens), mode="eval"
        )
        comparisons = sum(len(node.ops) for node in ast.walk(tree) if isinstance(node, ast.Compare))
        if comparisons > 200 or _depth(tree) > 50:  # SQLite refuses expressions of a thousand levels
            raise QueryError(
                f"The filter has {comparisons} comparisons, nested {_depth(tree)} deep.",
                "Write at most 200, at most 50 deep; many values are 'seed in (1, 2)'.",
            )
        return _condition(tree.body, text)
    # Deep nesting makes Python's parser raise other errors.
    except (SyntaxError, ValueError, tokenize.TokenError, RecursionError, MemoryError) as error:
        raise QueryError(f"The filter {text!r} can't be read.", _EXAMPLE) from error


def _depth(node: ast.AST) -> int:
    """Depth of an expression, including its root."""
    return 1 + max(map(_depth, ast.iter_child_nodes(node)), default=0)


def _condition(node: ast.expr, text: str) -> ColumnElement[bool]:
    if isinstance(node, ast.BoolOp):
        join = and_ if isinstance(node.op, ast.And) else or_
        return join(*(_condition(value, text) for value in node.values))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return not_(_condition(node.operand, text))
    if isinstance(node, ast.Compare):
        sides = [node.left, *node.comparators]
        pairs = zip(sides, node.ops, sides[1:], strict=False)
        return and_(*(_comparison(left, op, right, text) for left, op, right in pairs))
    raise QueryError(f"'{ast.unparse(node)}' in the filter '{text}' is not a comparison.", _EXAMPLE)


def _comparison(left: ast.expr, op: ast.cmpop, right: ast.expr, text: str) -> ColumnElement[bool]:
    first = _operand(left, text)
    if isinstance(op, ast.Is | ast.IsNot):
        if not (isinstance(right, ast.Constant) and right.value is None):
            raise QueryError(f"'is' in the filter '{text}' is allowed with None only.", _EXAMPLE)
        return first.is_(None) if isinstance(op, ast.Is) else first.is_not(None)
    if isinstance(op, ast.In | ast.NotIn):
        if not isinstance(right, ast.Tuple | ast.List):
            raise QueryError(f"'in' in the filter '{text}' needs a list in parentheses.", _EXAMPLE)
        values = [_operand_like(left, item, text) for item in right.elts]
        return first.in_(values) if isinstance(op, ast.In) else first.not_in(values)
    result: ColumnElement[bool] = _COMPARISONS[type(op)](first, _operand_like(left, right, text))
    return result


def _operand_like(other: ast.expr, node: ast.expr, text: str) -> SQLColumnExpression[Any]:
    """Check that operands can be compared, since databases also compare a word with a number."""
    operand = _operand(node, text)
    if _is_text(node) != _is_text(other):
        word, number = (node, other) if _is_text(node) else (other, node)
        raise QueryError(
            f"The filter '{text}' compares '{ast.unparse(word)}', which is text, with the number "
            f"'{ast.unparse(number)}'.",
            _EXAMPLE,
        )
    return operand


def _is_text(node: ast.expr) -> bool:
    """Whether an operand is a word or a text quantity."""
    if isinstance(node, ast.Name):
        return QUANTITY_BY_NAME[node.id].kind == "text"
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _operand(node: ast.expr, text: str) -> SQLColumnExpression[Any]:
    if isinstance(node, ast.Name):
        if node.id in QUANTITY_BY_NAME:
            return EXPRESSIONS[node.id]
        raise QueryError(f"The filter '{text}' names the unknown quantity '{node.id}'.", hint_at_quantity(node.id))
    try:
        value = ast.literal_eval(node)
    except (TypeError, ValueError):  # the first that cannot be in a set
        value = None
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise QueryError(
            f"'{ast.unparse(node)}' in the filter '{text}' is neither quantity, number nor word.", _EXAMPLE
        )
    if isinstance(value, int) and abs(value) > LARGEST_SEED:  # larger whole numbers are compared as real numbers
        value = float(value) if abs(value) < sys.float_info.max else math.inf if value > 0 else -math.inf
    # Databases accept no zero byte and no half of a surrogate pair.
    if isinstance(value, str) and ("\0" in value or any("\ud800" <= character <= "\udfff" for character in value)):
        raise QueryError(f"{value!r} in the filter can't be in a database.", "Write plain characters.")
    return literal(value)
