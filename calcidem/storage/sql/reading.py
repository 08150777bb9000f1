"""Queries of a campaign: from a `Selection` to records and columns."""

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import (
    ColumnElement,
    Integer,
    Select,
    SQLColumnExpression,
    and_,
    case,
    cast,
    func,
    select,
    tuple_,
)
from sqlalchemy.orm import InstrumentedAttribute, Session

from calcidem.storage.errors import DamagedStoreError, QueryError, UnknownCellError
from calcidem.storage.records import (
    ARRAY_RECORDS,
    QUANTITY_BY_NAME,
    AttemptCount,
    AttemptRecord,
    CampaignRecord,
    CellKey,
    CellResult,
    CellStatus,
    canonical_content,
    checked_seed,
)
from calcidem.storage.sql import rows
from calcidem.storage.sql.engine import UNREADABLE, may_be_damage
from calcidem.storage.sql.models import (
    ARRAYS,
    CELL,
    LOST,
    RESULT,
    STATUS,
    AttemptRow,
    CampaignRow,
    CellRow,
    expression_of,
    join_results,
)
from calcidem.storage.sql.where import parse_where
from calcidem.storage.store import Selection, StoreMark

T = TypeVar("T")

_ROWS_READ_AT_ONCE = 10_000
"""Rows that are in memory as Python objects at a time while columns are read."""

_KINDS = {"real": np.float64, "whole": np.float64, "text": np.object_}

_TABLES_OF_CELLS = (CellRow, AttemptRow, RESULT)

_LARGEST_LIMIT = 2**63 - 1
"""Largest whole number that databases know."""

_MOST_ATTEMPTS = 2**31 - 1
"""Largest number of an attempt, that of a 32-bit column."""

_BY_KEY = (CellRow.seed, CellRow.content)

KEYS_PER_QUERY = 500
"""Rows for one query where keys are listed: far below the number of parameters any database allows."""


def chunks(items: Iterable[T], size: int = KEYS_PER_QUERY) -> Iterator[list[T]]:
    """Cut what may be too much for the memory into pieces of at most `size`."""
    remaining = iter(items)
    while chunk := list(islice(remaining, size)):
        yield chunk


def _conditions(campaign_id: int, selection: Selection) -> list[ColumnElement[bool]]:
    """Conditions of a query over `join_results`."""
    found = [CellRow.campaign_id == campaign_id]
    if selection.seeds is not None:
        found.append(_is_one_of(selection.seeds))
    if selection.contents is not None:
        found.append(CellRow.content.in_(selection.contents))
    if selection.statuses is not None and CellStatus.DAMAGED not in selection.statuses:
        # Without pending the plain column will do, which has an index.
        status = STATUS if CellStatus.PENDING in selection.statuses else RESULT.c.status
        found.append(status.in_([s.value for s in selection.statuses]))
    if selection.where is not None:
        found.append(parse_where(selection.where))
    if selection.since is not None:
        found.append(CellRow.id.in_(select(AttemptRow.cell_id).where(AttemptRow.recorded >= selection.since)))
    return found


def _is_one_of(seeds: Iterable[int]) -> ColumnElement[bool]:
    """Condition on the seed; a range without gaps, the usual case, needs two parameters only."""
    listed = list(seeds)
    if listed and listed[-1] - listed[0] == len(listed) - 1:
        return CellRow.seed.between(listed[0], listed[-1])
    return CellRow.seed.in_(listed)


def refuse_unknown_contents(session: Session, campaign_id: int, selection: Selection) -> None:
    """Raise an `UnknownCellError` that names the contents of a campaign if one that is selected is none of them."""
    unknown = []
    for content in selection.contents or ():
        statement = select(CellRow.id).where(CellRow.campaign_id == campaign_id, CellRow.content == content)
        if session.scalar(statement.limit(1)) is None:
            unknown.append(f"{content:g} %")
    if unknown:
        contents = session.scalars(select(CellRow.content).where(CellRow.campaign_id == campaign_id).distinct())
        there_are = ", ".join(f"{content:g}" for content in sorted(contents))
        name = session.scalar(select(CampaignRow.name).where(CampaignRow.id == campaign_id))
        raise UnknownCellError(
            f"There is no content {', '.join(unknown)} in campaign '{name}'.", f"There are {there_are} %."
        )


def select_cells(session: Session, campaign_id: int, selection: Selection) -> list[int]:
    """Ids of the selected cells, by seed, then content."""
    statement = join_results(select(CellRow.id)).where(*_conditions(campaign_id, selection))
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
    if unknown := [name for name in (*names, *(n.removeprefix("-") for n in sort)) if name not in QUANTITY_BY_NAME]:
        raise QueryError(f"Unknown quantities: {', '.join(unknown)}.", f"Known are: {', '.join(QUANTITY_BY_NAME)}.")
    if not names or (limit is not None and not 0 <= limit <= _LARGEST_LIMIT):
        raise QueryError(
            f"{len(names)} columns and limit {limit} are not a table.", "Give columns, and a limit of 0 or more."
        )
    fetched = tuple(dict.fromkeys(stored for name in names for stored in QUANTITY_BY_NAME[name].needs or (name,)))
    outcome = rows.OutcomeColumns(fetched)
    statement = join_results(select(*outcome.columns)).where(*_conditions(campaign_id, selection))
    columns = [(expression_of(name.removeprefix("-")), name.startswith("-")) for name in sort]
    order = [(column.desc() if falls else column.asc()).nulls_last() for column, falls in columns]
    ordered = statement.order_by(*order, *_BY_KEY).limit(limit)
    try:
        # Rows as Python objects need some fifty times the memory of arrays, so there are never many of them.
        found = session.execute(ordered, execution_options={"yield_per": _ROWS_READ_AT_ONCE})
        return _with_derived(_listed_columns(found, outcome, fetched, selection), names)
    except UNREADABLE as error:
        if sort or limit is not None or not may_be_damage(error):
            raise  # where a value can't be read there is no order
    cells = session.scalars(select(CellRow.id).where(CellRow.campaign_id == campaign_id).order_by(*_BY_KEY)).all()
    one_by_one = (row for chunk in chunks(cells) for row in _outcome_rows(session, statement, chunk))
    return _with_derived(_listed_columns(one_by_one, outcome, fetched, selection), names)


def _with_derived(columns: Mapping[str, NDArray[Any]], names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Columns of these names, of which some are derived from those that were fetched."""
    table = {}
    for name in names:
        quantity = QUANTITY_BY_NAME[name]
        if quantity.formula is None:
            table[name] = columns[name]
        else:
            table[name] = quantity.formula(np.sqrt, *(columns[needed] for needed in quantity.needs))
    return table


def _listed_columns(
    found: Iterable[Sequence[Any]], outcome: rows.OutcomeColumns, names: Sequence[str], selection: Selection
) -> dict[str, NDArray[Any]]:
    """Columns of rows; a damaged cell meets no filter, has no status but that, and no values."""
    types = [np.int64 if name == "seed" else _KINDS[QUANTITY_BY_NAME[name].kind] for name in names]
    places = [outcome.place[name] for name in names]
    blocks: list[list[NDArray[Any]]] = [[np.empty(0, dtype=kind) for kind in types]]
    for block in chunks(found, _ROWS_READ_AT_ONCE):
        listed: list[Sequence[Any]] = []
        for row in filter(_has_key, block):
            damage = outcome.find_damage(row)
            status = CellStatus.DAMAGED if damage else row[outcome.place["status"]] or CellStatus.PENDING
            if selection.statuses is not None and status not in selection.statuses:
                continue
            if not damage:
                listed.append([row[place] for place in places])
            elif selection.where is None:
                known = {"seed": row[1], "content": row[2], "status": status.value, "reason": damage}
                listed.append([known.get(name) for name in names])
        columns = zip(*listed, strict=True) if listed else blocks[0]
        blocks.append([np.array(column, dtype=kind) for column, kind in zip(columns, types, strict=True)])
    table = {name: np.concatenate(parts) for name, parts in zip(names, zip(*blocks, strict=True), strict=True)}
    if "status" in table:
        table["status"][table["status"] == None] = CellStatus.PENDING.value  # noqa: E711 - of each element
    return table


def _has_key(row: Sequence[Any]) -> bool:
    """Whether it can be told which cell a row belongs to: damage may have made something else of seed and content."""
    return _is_possible(checked_seed, row[1]) and _is_possible(canonical_content, row[2])


def _is_possible(normalize: Callable[[Any], object], value: object) -> bool:
    """Whether a value is one that a function gives back as it is."""
    try:
        return bool(normalize(value) == value)
    except (TypeError, ValueError):
        return False


def _outcome_rows(
    session: Session, statement: Select[*tuple[Any, ...]], cell_ids: Sequence[int]
) -> Iterator[Sequence[Any]]:
    """Give the rows of some cells; of one that can't be read its number, seed and content, unless these can't be."""
    key = select(CellRow.id, CellRow.seed, CellRow.content)
    for cell_id, row in _readable_rows(session, statement, CellRow.id, cell_ids):
        if row is not None:
            yield row
        else:
            yield from (key for _, key in _readable_rows(session, key, CellRow.id, [cell_id]) if key is not None)


def _readable_rows(
    session: Session, statement: Select[*tuple[Any, ...]], number: SQLColumnExpression[Any], cell_ids: Sequence[int]
) -> Iterator[tuple[int, Sequence[Any] | None]]:
    """Give the rows of some cells, which begin with the cell's number, and None for each that can't be read."""
    try:
        found: list[tuple[int, Sequence[Any] | None]] = [
            (row[0], row) for row in session.execute(statement.where(number.in_(cell_ids)))
        ]
    except UNREADABLE as error:
        if not may_be_damage(error):
            raise
        if len(cell_ids) == 1:
            found = [(cell_ids[0], None)]
        else:
            half = len(cell_ids) // 2
            for part in (cell_ids[:half], cell_ids[half:]):
                yield from _readable_rows(session, statement, number, part)
            return
    yield from found


def results_of(session: Session, cell_ids: Sequence[int], arrays_wanted: Collection[str]) -> Iterator[CellResult]:
    """Outcomes of the cells (those that have one) with these of their arrays, by seed, then content."""
    outcome = rows.OutcomeColumns()
    statement = join_results(select(*outcome.columns)).where(RESULT.c.cell_id.is_not(None)).order_by(*_BY_KEY)
    arrays = _arrays_of(session, cell_ids, arrays_wanted) if arrays_wanted else None
    for row in filter(_has_key, _outcome_rows(session, statement, cell_ids)):
        try:
            yield outcome.result(row, None if arrays is None else arrays.get(row[0], {}), arrays_wanted)
        except UNREADABLE as error:
            yield CellResult(CellKey(row[1], row[2]), CellStatus.DAMAGED, _problem_of(error))


def select_cells_with_arrays(session: Session, campaign_id: int, selection: Selection) -> list[int]:
    """Ids of the selected cells beside whose outcomes there are arrays, by seed, then content."""
    statement = join_results(select(CellRow.id)).where(*_conditions(campaign_id, selection))
    named = statement.where(RESULT.c.checksum.contains(" "))  # the checksums of arrays follow that of the row
    try:
        return list(session.scalars(named.order_by(*_BY_KEY)))
    except UNREADABLE as error:
        if not may_be_damage(error):
            raise
    return select_cells(session, campaign_id, selection)


def array_records_of(session: Session, cell_ids: Sequence[int]) -> Iterator[tuple[CellKey, dict[str, Any] | str]]:
    """Arrays beside the outcomes of the cells, or what is damaged of them; see `Store.arrays`."""
    statement = join_results(select(CellRow.id, CellRow.seed, CellRow.content, RESULT.c.checksum))
    statement = statement.where(RESULT.c.cell_id.is_not(None)).order_by(*_BY_KEY)
    arrays = _arrays_of(session, cell_ids, ARRAY_RECORDS)
    for _, row in _readable_rows(session, statement, CellRow.id, cell_ids):
        if row is None or not _has_key(row):
            continue  # its numbers can't be read either
        try:
            yield CellKey(row[1], row[2]), rows.array_records(str(row[3] or ""), arrays.get(row[0], {}))
        except UNREADABLE as error:
            yield CellKey(row[1], row[2]), _problem_of(error)


def _problem_of(error: Exception) -> str:
    """What is damaged of a cell, as a clause."""
    return error.problem if isinstance(error, DamagedStoreError) else f"it can't be read ({error})"


def _arrays_of(session: Session, cell_ids: Sequence[int], wanted: Collection[str]) -> dict[int, dict[str, bytes]]:
    """Arrays of some cells, by cell and name; those of a cell that can't be read are missing, which is noticed."""
    number: SQLColumnExpression[Any] = ARRAYS.c.cell_id
    statement = select(number, ARRAYS.c.name, ARRAYS.c.content).where(ARRAYS.c.name.in_(wanted))
    found: defaultdict[int, dict[str, bytes]] = defaultdict(dict)
    for _, row in _readable_rows(session, statement, number, cell_ids):
        if row is not None and isinstance(row[2], bytes):
            found[row[0]][row[1]] = row[2]
    return found


def attempts_of(session: Session, cell_ids: Sequence[int]) -> Iterator[AttemptRecord]:
    """All attempts at the cells that are as they were stored, by seed, content and number."""
    return (attempt for _, attempt in _attempts_or_damage(session, cell_ids) if attempt is not None)


def _attempts_or_damage(
    session: Session, cell_ids: Sequence[int]
) -> Iterator[tuple[Sequence[Any] | None, AttemptRecord | None]]:
    """Rows of the attempts at some cells, None where one can't be read, and what they stand for, None if damaged."""
    statement = select(CellRow.id, *rows.ATTEMPT_COLUMNS).join(AttemptRow, AttemptRow.cell_id == CellRow.id)
    statement = statement.order_by(*_BY_KEY, AttemptRow.number)
    for _, row in _readable_rows(session, statement, CellRow.id, cell_ids):
        yield row, None if row is None else rows.attempt_from_row(row[1:])


def other_damage(session: Session, campaign_id: int) -> list[str]:
    """Sentences on damaged attempts of a campaign, and on what the database itself finds (PRAGMA integrity_check)."""
    sentences = []
    cells = session.scalars(select(CellRow.id).where(CellRow.campaign_id == campaign_id)).all()
    for chunk in chunks(cells):
        for row, attempt in _attempts_or_damage(session, chunk):
            if attempt is None:
                cell = "a cell" if row is None else f"seed {row[1]}, {row[2]} %"
                sentences.append(f"An attempt at {cell} is not what was stored.")
    if session.connection().dialect.name == "sqlite":
        found = session.connection().exec_driver_sql("PRAGMA integrity_check(20)").scalars().all()
        sentences += [f"The file: {line}." for line in found if line != "ok"]
    return sentences


def attempt_counts(session: Session, campaign_id: int, keys: Sequence[CellKey] | None) -> dict[CellKey, AttemptCount]:
    """See `Store.attempt_counts`."""
    losses = func.sum(case((and_(AttemptRow.outcome == LOST, AttemptRow.forgiven.is_(False)), 1), else_=0))
    # SQLite lets damage put a text, a fraction or a number beyond all attempts there, and the next attempt counts on.
    number = case((AttemptRow.number.between(1, _MOST_ATTEMPTS), cast(AttemptRow.number, Integer)), else_=0)
    statement = (
        select(CellRow.seed, CellRow.content, func.max(number), losses)
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
    columns = table(session, campaign_id, ("content", "status"), Selection())
    counted = Counter(zip(columns["content"].tolist(), map(CellStatus, columns["status"]), strict=True))
    return dict(sorted(counted.items()))


def mark(session: Session) -> StoreMark:
    """See `Store.mark`."""
    cells, attempts, results = (select(func.count()).select_from(table).scalar_subquery() for table in _TABLES_OF_CELLS)
    recorded = select(func.max(AttemptRow.recorded)).scalar_subquery()
    return StoreMark(*session.execute(select(cells, attempts, results, recorded)).one())


def count_settled(session: Session, campaign_id: int) -> int:
    """See `Store.settled`."""
    statement = select(func.count()).select_from(RESULT).join(CELL, RESULT.c.cell_id == CELL.c.id)
    return session.scalar(statement.where(CELL.c.campaign_id == campaign_id)) or 0


def unchecked_velocities(session: Session, campaign_id: int) -> dict[str, NDArray[Any]]:
    """See `Store.velocities`."""
    statement = (
        select(CellRow.seed, CellRow.content, RESULT.c.status, RESULT.c.vs)
        .outerjoin(RESULT, RESULT.c.cell_id == CellRow.id)
        .where(CellRow.campaign_id == campaign_id)
    )
    names, kinds = ("seed", "content", "status", "vs"), (np.int64, np.float64, np.object_, np.float64)
    columns: list[list[NDArray[Any]]] = [[np.empty(0, dtype=kind) for kind in kinds]]
    for block in session.execute(statement, execution_options={"yield_per": _ROWS_READ_AT_ONCE}).partitions():
        found = zip(*block, strict=True)
        columns.append([np.array(values, dtype=kind) for values, kind in zip(found, kinds, strict=True)])
    return {name: np.concatenate(parts) for name, parts in zip(names, zip(*columns, strict=True), strict=True)}


def campaign_record(session: Session, row: CampaignRow) -> CampaignRecord:
    """Build a campaign with the seeds and contents of its planned cells."""

    def planned(column: InstrumentedAttribute[Any], is_one: Callable[[Any], object]) -> tuple[Any, ...]:
        """Values of a column; what damage has made of some others is left out."""
        found = session.scalars(select(column).where(CellRow.campaign_id == row.id).distinct()).all()
        return tuple(value for value in found if _is_possible(is_one, value))

    record = CampaignRecord(
        hash=row.hash,
        name=row.name,
        config=row.config,
        contents=planned(CellRow.content, canonical_content),
        seeds=planned(CellRow.seed, checked_seed),
        created=row.created,
    )
    if record.checksum != row.checksum:
        raise DamagedStoreError(
            f"The configuration of campaign '{row.name}', or its hash {row.hash[:12]}, was changed after it had been "
            "stored.",
            "Its cells can't be told from those of another campaign: import an exported file into a new database.",
        )
    return record
