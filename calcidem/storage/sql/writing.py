"""Statements that change a campaign, each within a transaction that its caller owns."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from datetime import UTC, datetime
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, Table, and_, delete, insert, or_, select, tuple_, update
from sqlalchemy.orm import Session

from calcidem.storage.errors import UnknownCellError
from calcidem.storage.records import (
    AttemptCount,
    AttemptRecord,
    CampaignRecord,
    CellKey,
    CellResult,
    CellStatus,
    PackedResult,
    PackingRecord,
)
from calcidem.storage.records.campaign import refuse_other_campaign, refuse_other_packing
from calcidem.storage.sql import rows
from calcidem.storage.sql.checksums import checksum_of, covered_columns
from calcidem.storage.sql.models import (
    ARRAYS,
    ATTEMPT,
    LOST,
    PACKING,
    RESULT,
    AttemptRow,
    CampaignRow,
    CellRow,
    PackingRow,
)
from calcidem.storage.sql.reading import KEYS_PER_QUERY, attempt_counts, attempts_of, campaign_record, cell_in, chunks


def begin_campaign(session: Session, campaign: CampaignRecord) -> CampaignRow:
    """Find the campaign by its hash, or create it; its plan is the caller's next step.

    Raises
    ------
    CampaignMismatchError
        If the name belongs to another hash, or the hash to other values.
    """
    is_it = or_(CampaignRow.hash == campaign.hash, CampaignRow.name == campaign.name)
    found = session.scalars(select(CampaignRow).where(is_it)).all()
    for row in sorted(found, key=lambda row: row.hash != campaign.hash):
        refuse_other_campaign(campaign_record(session, row), campaign)
        return row
    row = CampaignRow(
        hash=campaign.hash,
        name=campaign.name,
        config=campaign.config,
        created=campaign.created,
        checksum=campaign.checksum,
    )
    session.add(row)
    session.flush()
    return row


def plan_cells(session: Session, campaign_id: int, keys: Iterable[CellKey]) -> int:
    """Plan the cells that are not planned yet, by seed, then content; return how many."""
    statement = select(CellRow.seed, CellRow.content).where(CellRow.campaign_id == campaign_id)
    planned = {(seed, content) for seed, content in session.execute(statement)}
    new = [
        {"campaign_id": campaign_id, "seed": key.seed, "content": key.content}
        for key in sorted(set(keys))
        if (key.seed, key.content) not in planned
    ]
    if new:
        session.execute(insert(CellRow), new)
    return len(new)


def save_packing(session: Session, campaign_id: int, packing: PackingRecord, *, replace_state: bool) -> None:
    """See `Store.save_packing`."""
    is_it = and_(PackingRow.campaign_id == campaign_id, PackingRow.number == packing.index)
    stored = session.execute(select(PackingRow.content_hash).where(is_it)).first()
    if replace_state and stored is not None and stored.content_hash == packing.content_hash is not None:
        session.execute(delete(PackingRow).where(is_it))  # whatever else of it is damaged, this one is the same
        stored = None
    if stored is None:
        session.add(rows.row_from_packing(campaign_id, packing))
        return
    row = session.scalars(select(PackingRow).where(is_it)).one()
    refuse_other_packing(rows.packing_from_row(row), packing)
    row.content_hash = row.content_hash or packing.content_hash
    if replace_state:
        row.state = packing.state
    row.checksum = checksum_of(PACKING, (), {name: getattr(row, name) for name in covered_columns(PACKING)})


class _Known(NamedTuple):
    """What the database knows of a planned cell."""

    cell_id: int
    status: str | None
    attempt: int | None


def record_results(
    session: Session,
    campaign_id: int,
    run_id: int | None,
    results: Iterable[CellResult | PackedResult],
    *,
    replace_done: bool,
) -> int:
    """See `Store.record_results`."""
    stored = 0
    recorded = datetime.now(UTC)
    for batch in _distinct_batches(map(rows.pack_result, results)):
        known = _known_cells(session, campaign_id, [result.key for result in batch])
        accepted = [
            (known[result.key].cell_id, result)
            for result in batch
            if _gives_way(known[result.key], result, replace_done=replace_done)
        ]
        if accepted:
            _replace(session, accepted, run_id, recorded)
        stored += len(accepted)
    return stored


def _distinct_batches(results: Iterable[PackedResult]) -> Iterator[list[PackedResult]]:
    """Cut into batches in which no cell occurs twice: a later outcome then meets the earlier one stored."""
    batch: dict[CellKey, PackedResult] = {}
    for result in results:
        if result.key in batch or len(batch) == KEYS_PER_QUERY:
            yield list(batch.values())
            batch = {}
        batch[result.key] = result
    if batch:
        yield list(batch.values())


def _known_cells(session: Session, campaign_id: int, keys: Sequence[CellKey]) -> dict[CellKey, _Known]:
    statement = select(CellRow.seed, CellRow.content, CellRow.id, RESULT.c.status, RESULT.c.attempt)
    statement = statement.outerjoin(RESULT, RESULT.c.cell_id == CellRow.id)
    statement = statement.where(CellRow.campaign_id == campaign_id, cell_in(keys))
    known = {CellKey(row.seed, row.content): _Known(*row[2:]) for row in session.execute(statement)}
    for key in keys:
        if key not in known:
            raise UnknownCellError(
                f"Seed {key.seed} with content {key.content} % is not part of the campaign's plan.",
                "Extend the plan (begin_campaign or extend) before storing its outcome.",
            )
    return known


def _gives_way(known: _Known, result: PackedResult, *, replace_done: bool) -> bool:
    """Rule 5 of the contract: whether the stored outcome gives way to the new one."""
    if known.status is None or known.attempt is None:
        return True
    if known.status == CellStatus.DONE:
        return replace_done
    return result.status is CellStatus.DONE or result.attempt >= known.attempt


def _replace(
    session: Session, accepted: Sequence[tuple[int, PackedResult]], run_id: int | None, recorded: datetime
) -> None:
    """Store outcomes in place of what there was.

    An attempt that is there with the same outcome keeps its row: an import has restored it.
    """
    ids = [cell_id for cell_id, _ in accepted]
    for table in (ARRAYS, RESULT):  # arrays without an outcome, which damage leaves, would be in the way
        session.execute(delete(table).where(table.c.cell_id.in_(ids)))
    listed = _attempt_in([(cell_id, result.attempt) for cell_id, result in accepted])
    statement = select(AttemptRow.cell_id, AttemptRow.number, AttemptRow.outcome).where(listed)
    existing = {(row.cell_id, row.number): row.outcome for row in session.execute(statement)}
    new = [(i, result) for i, result in accepted if existing.get((i, result.attempt)) != result.status]
    outdated = [(i, result.attempt) for i, result in new if (i, result.attempt) in existing]
    if outdated:
        session.execute(delete(AttemptRow).where(_attempt_in(outdated)))
    shared: dict[str, Any] = {"run_id": run_id, "recorded": recorded, "forgiven": False}
    _insert(session, ATTEMPT, [rows.attempt_row(i, result, shared) for i, result in new])
    _insert(session, RESULT, [rows.result_row(i, result) for i, result in accepted])
    arrays = [(i, name, content) for i, result in accepted for name, content in result.arrays.items()]
    _insert(session, ARRAYS, [{"cell_id": i, "name": name, "content": content} for i, name, content in arrays])


def _insert(session: Session, table: Table, values: Sequence[dict[str, Any]]) -> None:
    """Insert rows, below the ORM: its bookkeeping of rows that nobody reads again takes longer than the database."""
    if values:
        session.connection().execute(insert(table), values)


def _attempt_in(numbered: Sequence[tuple[int, int]]) -> ColumnElement[bool]:
    """Condition that an attempt is one of these (cell, number); written so that SQLite searches its index."""
    listed = tuple_(AttemptRow.cell_id, AttemptRow.number).in_(numbered)
    return and_(AttemptRow.cell_id.in_([cell_id for cell_id, _ in numbered]), listed)


def record_lost(
    session: Session, campaign_id: int, run_id: int | None, keys: Sequence[CellKey], reason: str
) -> dict[CellKey, AttemptCount]:
    """See `Store.record_lost`."""
    recorded = datetime.now(UTC)
    counts = attempt_counts(session, campaign_id, keys)
    for chunk in chunks(counts):
        known = _known_cells(session, campaign_id, chunk)
        values = [
            {
                "cell_id": known[key].cell_id,
                "number": counts[key].attempts + 1,
                "run_id": run_id,
                "outcome": LOST,
                "reason": reason,
                "recorded": recorded,
                "forgiven": False,
            }
            for key in chunk
        ]
        _insert(session, ATTEMPT, [rows.seal_attempt(key, row) for key, row in zip(chunk, values, strict=True)])
    return {key: AttemptCount(count.attempts + 1, count.losses + 1) for key, count in counts.items()}


def make_pending(
    session: Session, campaign_id: int, statuses: Collection[CellStatus], keys: Sequence[CellKey] | None
) -> tuple[CellKey, ...]:
    """See `Store.retry`."""
    statement = (
        select(CellRow.id, CellRow.seed, CellRow.content)
        .join(RESULT, RESULT.c.cell_id == CellRow.id)
        .where(CellRow.campaign_id == campaign_id, RESULT.c.status.in_([status.value for status in statuses]))
        .order_by(CellRow.seed, CellRow.content)
    )
    wanted = None if keys is None else set(keys)
    found = {CellKey(row.seed, row.content): row.id for row in session.execute(statement)}
    chosen = {key: cell_id for key, cell_id in found.items() if wanted is None or key in wanted}
    _drop_outcomes(session, chosen.values())
    return tuple(chosen)


def drop_damaged(session: Session, campaign_id: int, keys: Collection[CellKey]) -> None:
    """Make damaged cells pending again, and drop attempts of theirs that are damaged."""
    for chunk in chunks(keys):
        known = _known_cells(session, campaign_id, chunk)
        ids = {cell.cell_id: key for key, cell in known.items()}
        _drop_outcomes(session, ids)
        statement = select(AttemptRow.cell_id, AttemptRow.number).where(AttemptRow.cell_id.in_(ids))
        good = {(attempt.key, attempt.number) for attempt in attempts_of(session, list(ids))}
        numbered = [(cell, number) for cell, number in session.execute(statement) if (ids[cell], number) not in good]
        if numbered:
            session.execute(delete(AttemptRow).where(_attempt_in(numbered)))


def _drop_outcomes(session: Session, cell_ids: Collection[int]) -> None:
    """Make cells pending, and forgive the losses counted for them."""
    for chunk in chunks(cell_ids):
        for table in (ARRAYS, RESULT):
            session.execute(delete(table).where(table.c.cell_id.in_(chunk)))
        session.execute(update(AttemptRow).where(AttemptRow.cell_id.in_(chunk)).values(forgiven=True))


def restore_attempts(session: Session, campaign_id: int, attempts: Iterable[AttemptRecord]) -> None:
    """See `Store.restore_attempts`."""
    for chunk in chunks(attempts):
        known = _known_cells(session, campaign_id, [attempt.key for attempt in chunk])
        listed = _attempt_in([(known[attempt.key].cell_id, attempt.number) for attempt in chunk])
        statement = select(AttemptRow.cell_id, AttemptRow.number).where(listed)
        existing = {(cell_id, number) for cell_id, number in session.execute(statement)}
        names = (*covered_columns(ATTEMPT), "forgiven")
        values = [
            {"cell_id": known[attempt.key].cell_id}
            | rows.seal_attempt(attempt.key, {name: getattr(attempt, name) for name in names})
            for attempt in chunk
            if (known[attempt.key].cell_id, attempt.number) not in existing
        ]
        _insert(session, ATTEMPT, values)
