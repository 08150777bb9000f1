"""Queries of a campaign: from a `Selection` to records and columns."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Select, UnaryExpression, and_, case, func, select, tuple_
from sqlalchemy.orm import InstrumentedAttribute, Session

from calcidem.storage.errors import QueryError
from calcidem.storage.records import AttemptCount, AttemptRecord, CampaignRecord, CellKey, CellResult, CellStatus
from calcidem.storage.sql import rows
from calcidem.storage.sql.models import (
    LOST,
    AttemptRow,
    CampaignRow,
    CellRow,
    CementRow,
    GraphRow,
    PathRow,
    ResultRow,
    SignalRow,
)
from calcidem.storage.sql.quantities import QUANTITY_BY_NAME, STATUS
from calcidem.storage.sql.where import parse_where
from calcidem.storage.store import Selection

T = TypeVar("T")

_ROWS_READ_AT_ONCE = 10_000
"""Rows that are in memory as Python objects at a time while columns are read."""

_KINDS = {"real": np.float64, "whole": np.float64, "text": np.object_}

_LARGEST_LIMIT = 2**63 - 1
"""Largest whole number that databases know."""

KEYS_PER_QUERY = 500
"""Rows for one query where keys are listed: far below the number of parameters any database allows."""


def chunks(items: Iterable[T], size: int = KEYS_PER_QUERY) -> Iterator[list[T]]:
    """Cut what may be too much for the memory into pieces of at most `size`."""
    remaining = iter(items)
    while chunk := list(islice(remaining, size)):
        yield chunk


def join_results(statement: Select[*tuple[Any, ...]]) -> Select[*tuple[Any, ...]]:
    """Join a planned cell with its outcome, the attempt it came from, its path and its graph, where there are any."""
    return (
        statement.select_from(CellRow)
        .outerjoin(ResultRow, ResultRow.cell_id == CellRow.id)
        .outerjoin(AttemptRow, and_(AttemptRow.cell_id == CellRow.id, AttemptRow.number == ResultRow.attempt))
        .outerjoin(PathRow, PathRow.cell_id == CellRow.id)
        .outerjoin(GraphRow, GraphRow.cell_id == CellRow.id)
    )


def conditions(campaign_id: int, selection: Selection) -> list[ColumnElement[bool]]:
    """Conditions of a query over `join_results`."""
    found = [CellRow.campaign_id == campaign_id]
    if selection.seeds is not None:
        found.append(_is_one_of(selection.seeds))
    if selection.contents is not None:
        found.append(CellRow.content.in_(selection.contents))
    if selection.statuses is not None:
        # Without pending the plain column will do, which has an index.
        status = STATUS if CellStatus.PENDING in selection.statuses else ResultRow.status
        found.append(status.in_([s.value for s in selection.statuses]))
    if selection.where is not None:
        found.append(parse_where(selection.where))
    return found


def _is_one_of(seeds: Iterable[int]) -> ColumnElement[bool]:
    """Condition on the seed; a range without gaps, the usual case, needs two parameters only."""
    listed = list(seeds)
    if listed and listed[-1] - listed[0] == len(listed) - 1:
        return CellRow.seed.between(listed[0], listed[-1])
    return CellRow.seed.in_(listed)


def select_cells(session: Session, campaign_id: int, selection: Selection) -> list[int]:
    """Ids of the selected cells, by seed, then content."""
    statement = join_results(select(CellRow.id)).where(*conditions(campaign_id, selection))
    return list(session.scalars(statement.order_by(CellRow.seed, CellRow.content)))


def table(
    session: Session,
    campaign_id: int,
    names: Sequence[str],
    selection: Selection,
    sort: Sequence[str] = (),
    limit: int | None = None,
) -> dict[str, NDArray[Any]]:
    """See `Store.table`."""
    _check_names([*names, *(name.removeprefix("-") for name in sort)])
    if not names or (limit is not None and not 0 <= limit <= _LARGEST_LIMIT):
        raise QueryError(
            f"{len(names)} columns and limit {limit} are not a table.", "Give columns, and a limit of 0 or more."
        )
    statement = join_results(select(*(QUANTITY_BY_NAME[name].expression for name in names)))
    statement = statement.where(*conditions(campaign_id, selection))
    statement = statement.order_by(*map(_order_of, sort), CellRow.seed, CellRow.content).limit(limit)
    types = [np.int64 if name == "seed" else _KINDS[QUANTITY_BY_NAME[name].kind] for name in names]
    blocks: list[list[NDArray[Any]]] = [[np.empty(0, dtype=kind) for kind in types]]
    # Rows as Python objects need some fifty times the memory of arrays, so there are never many of them.
    for rows_of_block in session.execute(statement, execution_options={"yield_per": _ROWS_READ_AT_ONCE}).partitions():
        columns = zip(*rows_of_block, strict=True)
        blocks.append([np.array(column, dtype=kind) for column, kind in zip(columns, types, strict=True)])
    return {name: np.concatenate(parts) for name, parts in zip(names, zip(*blocks, strict=True), strict=True)}


def _check_names(names: Iterable[str]) -> None:
    """Refuse names that are not in the catalogue of quantities.

    Raises
    ------
    QueryError
        Naming them.
    """
    unknown = [name for name in names if name not in QUANTITY_BY_NAME]
    if unknown:
        raise QueryError(f"Unknown quantities: {', '.join(unknown)}.", f"Known are: {', '.join(QUANTITY_BY_NAME)}.")


def _order_of(name: str) -> UnaryExpression[Any]:
    expression = QUANTITY_BY_NAME[name.removeprefix("-")].expression
    return (expression.desc() if name.startswith("-") else expression.asc()).nulls_last()


def results_of(session: Session, cell_ids: Sequence[int], *, with_arrays: bool) -> Iterator[CellResult]:
    """Outcomes of the cells (those that have one), by seed, then content."""
    listed = CellRow.id.in_(cell_ids)
    statement = join_results(select(CellRow.id, CellRow.seed, CellRow.content, *rows.RESULT_COLUMNS))
    found = session.execute(
        statement.where(listed, ResultRow.status.is_not(None)).order_by(CellRow.seed, CellRow.content)
    )
    signals: dict[int, SignalRow] = {}
    cements: dict[int, CementRow] = {}
    if with_arrays:
        signals = {
            row.cell_id: row for row in session.scalars(select(SignalRow).where(SignalRow.cell_id.in_(cell_ids)))
        }
        cements = {
            row.cell_id: row for row in session.scalars(select(CementRow).where(CementRow.cell_id.in_(cell_ids)))
        }
    for row in found:
        signal, cement = signals.get(row.id), cements.get(row.id)
        yield rows.result_from_row(
            row,
            rows.signal_from_row(signal) if signal is not None else None,
            rows.cement_from_row(cement) if cement is not None else None,
        )


def attempts_of(session: Session, cell_ids: Sequence[int]) -> Iterator[AttemptRecord]:
    """All attempts at the cells, by seed, content and number."""
    statement = select(CellRow.seed, CellRow.content, *rows.ATTEMPT_COLUMNS).join(
        CellRow, AttemptRow.cell_id == CellRow.id
    )
    statement = statement.where(CellRow.id.in_(cell_ids)).order_by(CellRow.seed, CellRow.content, AttemptRow.number)
    yield from (rows.attempt_from_row(row) for row in session.execute(statement))


def attempt_counts(session: Session, campaign_id: int, keys: Sequence[CellKey] | None) -> dict[CellKey, AttemptCount]:
    """See `Store.attempt_counts`."""
    losses = func.sum(case((and_(AttemptRow.outcome == LOST, AttemptRow.forgiven.is_(False)), 1), else_=0))
    statement = (
        select(CellRow.seed, CellRow.content, func.max(AttemptRow.number), losses)
        .join(AttemptRow, AttemptRow.cell_id == CellRow.id)
        .where(CellRow.campaign_id == campaign_id)
        .group_by(CellRow.id, CellRow.seed, CellRow.content)
    )
    if keys is None:
        return _counts(session, statement)
    counts = dict.fromkeys(keys, AttemptCount())
    for chunk in chunks(keys):
        counts |= _counts(session, statement.where(cell_in(chunk)))
    return counts


def _counts(session: Session, statement: Select[*tuple[Any, ...]]) -> dict[CellKey, AttemptCount]:
    return {
        CellKey(seed, content): AttemptCount(attempts, int(losses))
        for seed, content, attempts, losses in session.execute(statement)
    }


def cell_in(keys: Sequence[CellKey]) -> ColumnElement[bool]:
    """Condition that a cell is one of the keys.

    SQLite doesn't search an index for a list of pairs, but it does for the lists of their parts.
    """
    seeds, contents = {key.seed for key in keys}, {key.content for key in keys}
    listed = tuple_(CellRow.seed, CellRow.content).in_([(key.seed, key.content) for key in keys])
    return and_(CellRow.seed.in_(sorted(seeds)), CellRow.content.in_(sorted(contents)), listed)


def status_counts(session: Session, campaign_id: int) -> dict[tuple[float, CellStatus], int]:
    """See `Store.status_counts`."""
    statement = (
        select(CellRow.content, STATUS, func.count())
        .select_from(CellRow)
        .outerjoin(ResultRow, ResultRow.cell_id == CellRow.id)
        .where(CellRow.campaign_id == campaign_id)
        .group_by(CellRow.content, STATUS)
        .order_by(CellRow.content)
    )
    return {(content, CellStatus(status)): count for content, status, count in session.execute(statement)}


def campaign_record(session: Session, row: CampaignRow) -> CampaignRecord:
    """Build a campaign with the seeds and contents of its planned cells."""

    def planned(column: InstrumentedAttribute[Any]) -> tuple[Any, ...]:
        return tuple(session.scalars(select(column).where(CellRow.campaign_id == row.id).distinct()))

    return CampaignRecord(
        hash=row.hash,
        name=row.name,
        config=row.config,
        contents=planned(CellRow.content),
        seeds=planned(CellRow.seed),
        created=row.created,
    )
