"""The store on a SQL database: SQLite by default, PostgreSQL by URL."""

import os
import time
import uuid
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, fields, replace
from datetime import UTC, datetime
from itertools import product, starmap
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Table, and_, delete, insert, or_, select, tuple_, update

from calcidem.ends import CellStatus
from calcidem.storage.errors import ReadOnlyStoreError, StoreError, UnknownCampaignError, UnknownCellError
from calcidem.storage.records import (
    AttemptCount,
    AttemptRecord,
    CampaignRecord,
    CellKey,
    CellResult,
    PackingRecord,
    RunRecord,
    as_utc,
    pack_arrays,
)
from calcidem.storage.sql.engine import Address
from calcidem.storage.sql.lease import Lease
from calcidem.storage.sql.reading import StoreReader, chunks
from calcidem.storage.sql.tables import ARRAYS, ATTEMPT, CAMPAIGN, CELL, LEASE, PACKING, RESULT, RUN, exclude_others


def read_campaign(path_or_url: str | os.PathLike[str], name: str | None = None) -> "Store":
    """Open a store for reading and choose the campaign of that name, or the only one; a run may write it meanwhile.

    `StoreError` as for `Store`, and if the database has no such campaign.
    """
    store = Store(path_or_url, read_only=True)
    try:
        store.use_campaign(name)
    except BaseException:
        store.close()
        raise
    return store


class Store(StoreReader):
    """Campaigns, their cells and their outcomes in a SQL database.

    Rules:

    1. A store holds any number of campaigns with different names. `begin_campaign` or `use_campaign`
       chooses the one that all other methods are about.
    2. A campaign's physics never changes: its name goes with one hash. Its plan of seeds and contents only
       grows.
    3. Each writing method is one transaction: when it returns, all of it is on disk; when it raises,
       nothing is. `together` makes one of several.
    4. Writing the same thing again changes nothing. A result is identified by its cell and the number of
       its attempt.
    5. A done cell is kept. Any other outcome is replaced by one of the same or a later attempt, and by a
       done one.
    6. A cell without an outcome is pending. Every outcome settles its cell; `retry` makes settled cells
       pending again and keeps their history.
    7. Attempts are counted from 1 for each cell over all runs, those whose worker was lost included. The
       caller gives a result the number ``attempts + 1`` of `attempt_counts`.
    8. Callers get frozen records, never rows; errors are `StoreError` with cause and cure.
    9. At most one process holds the lease of a campaign. Once its lease has been taken over, a store
       refuses to write. Writing without a lease is allowed, for imports and single
       commands.
    10. Reading never blocks a writer for longer than one short query, and sees only whole transactions.
    11. A file that was not closed properly is checked by SQLite before anything is written to it.
    12. Before a campaign is chosen, whatever is about one raises `UnknownCampaignError`. Writing may raise
        `ReadOnlyStoreError`, `LeaseLostError` or `DiskError`, and any method another `StoreError` of its database.
        A `Selection` whose filter can't be understood raises `QueryError`, one with a content that is not planned
        `UnknownCellError`.

    A store is a context manager that closes itself. It may be used by one thread at a time.
    """

    def __init__(self, path_or_url: str | os.PathLike[str], *, read_only: bool = False) -> None:
        """Open a SQLite file, or a URL such as ``postgresql://user@host/database``; create it if missing.

        With `read_only` every write is refused, and nothing is created. Errors are `ForeignDatabaseError`,
        `OtherSchemaError`, `StoreUnavailableError`, `ReadOnlyStoreError`, `DamagedStoreError` or `StoreLockedError`; a
        refused database is left unchanged.
        """
        self._run_id: int | None = None
        self._next_checkpoint = 0.0
        super().__init__(Address.parse(path_or_url), read_only=read_only)
        self._lease = Lease(None if read_only else self.address.path)

    # Transactions

    @contextmanager
    def together(self) -> Iterator[None]:
        """Make the block one transaction: all of it is stored at its end, or nothing.

        Other writers of the database wait meanwhile, so no run may be writing one of its campaigns. `LeaseHeldError` if
        another living process is the master of a campaign of the database.
        """
        chosen = self._campaign_id, self._record, self._run_id
        lease = Lease(None if self._lease.held else self.address.path)
        if not lease.acquire():
            with self._reading() as connection:  # which names it
                self._lease.refuse_other_masters(connection)
            raise lease.held_error(None)
        try:
            with self._writing() as connection:
                exclude_others(connection)  # first, or a run could begin after it was looked for
                self._lease.refuse_other_masters(connection)
                yield
        except BaseException:
            self._campaign_id, self._record, self._run_id = chosen
            raise
        finally:
            lease.release()

    @contextmanager
    def _writing(self) -> Iterator[Connection]:
        """Open a writing transaction that fails if the lease was lost, or continue the open one."""
        self._refuse_closed()
        if self._shared is not None:
            yield self._shared
            return
        self._refuse_replaced()
        if self.read_only:
            raise ReadOnlyStoreError(f"{self.address} was opened for reading only.", "Open it for writing.")
        with self._connections.transaction(write=True) as connection:
            heartbeat = None if self._lease.token is None else self._lease.renew(connection)
            self._shared = connection
            try:
                yield connection
            finally:
                self._shared = None
        if self._lease.token is not None and heartbeat is not None:
            self._lease.note(self._lease.token, heartbeat)
        if time.monotonic() > self._next_checkpoint:
            self._bring_log_into_file()

    def _bring_log_into_file(self) -> None:
        if self.address.path is not None and not self.read_only:
            self._connections.bring_log_into_file()
            self._next_checkpoint = time.monotonic() + 10.0  # s; for copies of the file

    def close(self) -> None:
        """Release the lease and all connections; a closed store may be closed again."""
        try:
            with suppress(StoreError):  # otherwise it expires by itself
                self.release_lease()
        finally:
            self._bring_log_into_file()
            super().close()

    # Campaigns and runs

    def begin_campaign(self, campaign: CampaignRecord) -> CampaignRecord:
        """Create the campaign, or continue the one with the same hash and extend its plan.

        Return it as stored. `CampaignMismatchError` if a campaign with another hash has this name, or the hash belongs
        to other values; the message lists the differences, one nested key a line.
        """
        with self._writing() as connection:
            exclude_others(connection)
            is_it = or_(CAMPAIGN.c.hash == campaign.hash, CAMPAIGN.c.name == campaign.name)
            found = connection.execute(select(CAMPAIGN).where(is_it)).all()
            for row in sorted(found, key=lambda row: bool(row.hash != campaign.hash)):
                self._campaign_of(connection, row).refuse_other(campaign)
            if not found:
                own = {name: getattr(campaign, name) for name in ("hash", "name", "config", "created")}
                connection.execute(insert(CAMPAIGN).values(own))
            (row,) = connection.execute(select(CAMPAIGN).where(CAMPAIGN.c.hash == campaign.hash))
            _plan_cells(connection, row.id, starmap(CellKey, product(campaign.seeds, campaign.contents)))
            record = self._campaign_of(connection, row)
        self._campaign_id, self._record = row.id, record
        return record

    def extend(self, seeds: Iterable[int], contents: Iterable[float]) -> int:
        """Plan all cells of seeds x contents (percent) that are not planned yet; return the number added."""
        return self.plan(starmap(CellKey, product(seeds, contents)))

    def plan(self, keys: Iterable[CellKey]) -> int:
        """Plan cells that are not planned yet; return the number added."""
        with self._writing() as connection:
            return _plan_cells(connection, self._campaign, keys)

    def begin_run(self, run: RunRecord) -> int:
        """Store the provenance of a run and return its number.

        Later attempts belong to it. Attempts that an earlier run has begun and not ended count as lost.
        """
        with self._writing() as connection:
            of_campaign = select(CELL.c.id).where(CELL.c.campaign_id == self._campaign)
            died = and_(ATTEMPT.c.outcome == CellStatus.RUNNING.value, ATTEMPT.c.cell_id.in_(of_campaign))
            told = {"outcome": "lost", "reason": "the run died while the cell was computed"}
            connection.execute(update(ATTEMPT).where(died).values(told))
            stored = connection.execute(insert(RUN).values(campaign_id=self._campaign, **asdict(run)))
        key: Any = stored.inserted_primary_key
        self._run_id = int(key[0])
        return self._run_id

    def end_run(self, exit_state: str, ended: datetime, *, cut_off: bool = False, number: int | None = None) -> None:
        """Store reason and time of the end of a run, by default that of `begin_run`.

        Attempts without an outcome are withdrawn, unless the run was cut off by a death or hanging of a worker.
        `UnknownCampaignError` if no run was begun.
        """
        with self._writing() as connection:
            run = self._run_id if number is None else number
            ending = update(RUN).where(RUN.c.id == run).values(exit_state=exit_state, ended=as_utc(ended))
            if not connection.execute(ending).rowcount:
                raise UnknownCampaignError("No run was begun.", "Call begin_run first.")
            if not cut_off:
                unended = and_(ATTEMPT.c.run_id == run, ATTEMPT.c.outcome == CellStatus.RUNNING.value)
                connection.execute(delete(ATTEMPT).where(unended))
        self._run_id = None

    # Lease

    def acquire_lease(self) -> tuple[str, ...]:
        """Become the campaign's only master; a repeated call refreshes the lease.

        Return sentences for the user about a dead master: that its lease was taken over, and lost work.
        `LeaseHeldError` if another living process is the master; the message names it, and the time when it would
        count as dead.
        """
        if self._lease.token is not None:
            self.renew_lease()
            return ()
        if not self._lease.acquire():
            raise self._lease.held_error(self.lease_holder())
        noted = self._lease.acknowledged() if self._lease.held else None
        token = uuid.uuid4().hex
        try:
            with self._writing() as connection:
                lost = self._lease.describe_loss(connection, noted)
                heartbeat, former = self._lease.claim(connection, self._campaign, token)
                self._lease.forget()
        except BaseException:
            self._lease.release()
            raise
        self._lease.token = token
        self._lease.note(token, heartbeat)
        sentences = []
        if former is not None:
            sentences.append(
                f"Taken over from {former.host}, process {former.pid}, last heartbeat at "
                f"{former.heartbeat:%Y-%m-%d %H:%M:%S} UTC, which ended without releasing the campaign."
            )
        return (*sentences, *([] if lost is None else [lost]))

    def renew_lease(self) -> None:
        """Report that this master is alive; storing does so, too. Call it at least every minute.

        `LeaseLostError` if another process took over.
        """
        with self._writing():
            pass  # every writing transaction refreshes the lease

    def release_lease(self) -> None:
        """Release the lease; does nothing without one."""
        token, self._lease.token = self._lease.token, None
        if token is not None:
            try:
                self._refuse_replaced()
                self._lease.forget()
                with self._connections.transaction(write=True) as connection:
                    connection.execute(delete(LEASE).where(LEASE.c.token == token))
            finally:
                self._lease.release()

    # Outcomes

    def save_packing(self, packing: PackingRecord) -> None:
        """Store a packing under its index, if it is not stored already.

        `CampaignMismatchError`, naming both content hashes, if the index has another packing.
        """
        if packing.index in self.packing_indices():
            self.packing(packing.index).refuse_other(packing)
            return
        row = {field.name: getattr(packing, field.name) for field in fields(packing) if field.name in PACKING.c}
        grains = pack_arrays({name: getattr(packing, name) for name in ("x", "y", "radius")})
        row |= {"campaign_id": self._campaign, "number": packing.index, "grains": grains}
        with self._writing() as connection:
            connection.execute(insert(PACKING).values(row | {"wall_stress": dict(packing.wall_stress)}))

    def record_results(self, results: Iterable[CellResult]) -> int:
        """Store outcomes in one transaction (rules 4 and 5), and return their number; rule 5 excludes the others.

        `UnknownCellError` if a cell is not planned.
        """
        stored, recorded = 0, datetime.now(UTC)
        with self._writing() as connection:
            for batch in _distinct_batches(result.pack() for result in results):
                known = self._known_cells(connection, [result.key for result in batch])
                accepted = []
                for result in batch:
                    old = known[result.key]
                    replaces = old.status is None or result.status is CellStatus.DONE or result.attempt >= old.attempt
                    if replaces and old.status != CellStatus.DONE:  # rule 5 of the contract
                        accepted.append((old.id, result))
                self._replace(connection, accepted, recorded)
                stored += len(accepted)
        return stored

    def _replace(self, connection: Connection, accepted: Sequence[tuple[int, CellResult]], recorded: datetime) -> None:
        """Store outcomes, replacing earlier ones.

        An existing attempt with the same outcome keeps its row, since an import has restored it.
        """
        ids = [cell_id for cell_id, _ in accepted]
        connection.execute(delete(RESULT).where(RESULT.c.cell_id.in_(ids)))  # with its arrays
        listed = _attempt_in([(cell_id, result.attempt) for cell_id, result in accepted])
        statement = select(ATTEMPT.c.cell_id, ATTEMPT.c.number, ATTEMPT.c.outcome).where(listed)
        existing = {(row.cell_id, row.number): row.outcome for row in connection.execute(statement)}
        new = [(i, result) for i, result in accepted if existing.get((i, result.attempt)) != result.status]
        outdated = [(i, result.attempt) for i, result in new if (i, result.attempt) in existing]
        if outdated:
            connection.execute(delete(ATTEMPT).where(_attempt_in(outdated)))
        attempts = [
            {name: getattr(result, name) for name in ("reason", "seconds", "rank", "host")}
            | {"cell_id": cell_id, "number": result.attempt, "outcome": result.status.value}
            | {"run_id": self._run_id, "recorded": recorded, "forgiven": False}
            for cell_id, result in new
        ]
        _insert(connection, ATTEMPT, attempts)
        names = [column.name for column in RESULT.c]
        rows = [{"cell_id": cell_id} | result.values() for cell_id, result in accepted]
        _insert(connection, RESULT, [{name: row.get(name) for name in names} for row in rows])
        arrays = [(cell_id, *array) for cell_id, result in accepted for array in result.packed]
        _insert(connection, ARRAYS, [dict(zip(("cell_id", "name", "content"), row, strict=True)) for row in arrays])

    def record_running(self, keys: Iterable[CellKey]) -> dict[CellKey, AttemptCount]:
        """Begin an attempt at each cell, which its outcome will replace; return the new counts.

        If the run dies before, the next one counts it as lost. `UnknownCellError` if a cell is not planned.
        """
        begun = {"outcome": CellStatus.RUNNING.value, "reason": "", "recorded": datetime.now(UTC), "forgiven": False}
        with self._writing() as connection:
            counts = {
                key: replace(count, attempts=count.attempts + 1) for key, count in self.attempt_counts(keys).items()
            }
            known = self._known_cells(connection, list(counts))
            rows = [{"cell_id": known[key].id, "number": count.attempts} for key, count in counts.items()]
            _insert(connection, ATTEMPT, [row | begun | {"run_id": self._run_id} for row in rows])
        return counts

    def restore_attempts(self, attempts: Iterable[AttemptRecord]) -> None:
        """Store the attempts of another store (for imports); existing attempts are kept.

        `UnknownCellError` if a cell is not planned.
        """
        with self._writing() as connection:
            for chunk in chunks(attempts):
                known = self._known_cells(connection, [attempt.key for attempt in chunk])
                ids = {attempt.key: known[attempt.key].id for attempt in chunk}
                listed = _attempt_in([(ids[attempt.key], attempt.number) for attempt in chunk])
                statement = select(ATTEMPT.c.cell_id, ATTEMPT.c.number).where(listed)
                existing = {(cell_id, number) for cell_id, number in connection.execute(statement)}
                new = [attempt for attempt in chunk if (ids[attempt.key], attempt.number) not in existing]
                names = [column.name for column in ATTEMPT.c if column.name != "cell_id"]
                rows = [{name: getattr(attempt, name) for name in names} for attempt in new]
                _insert(connection, ATTEMPT, [row | {"cell_id": ids[a.key]} for row, a in zip(rows, new, strict=True)])

    def retry(
        self,
        statuses: Collection[CellStatus] = (CellStatus.FAILED, CellStatus.TIMED_OUT),
        keys: Iterable[CellKey] | None = None,
    ) -> tuple[CellKey, ...]:
        """Make settled cells with these outcomes pending again, by default of all keys; return their keys.

        Their losses no longer count. `ValueError` if `statuses` contains done, pending or running.
        """
        wrong = {CellStatus.PENDING, CellStatus.RUNNING, CellStatus.DONE} & set(statuses)
        if wrong:
            raise ValueError(f"Cells that are {', '.join(sorted(wrong))} can't be retried; give other statuses.")
        wanted = None if keys is None else set(keys)
        is_it = and_(CELL.c.campaign_id == self._campaign, RESULT.c.status.in_([status.value for status in statuses]))
        statement = select(CELL.c.id, CELL.c.seed, CELL.c.content).join(RESULT, RESULT.c.cell_id == CELL.c.id)
        with self._writing() as connection:
            found = connection.execute(statement.where(is_it).order_by(CELL.c.seed, CELL.c.content))
            settled = {CellKey(seed, content): cell_id for cell_id, seed, content in found}
            chosen = {key: cell_id for key, cell_id in settled.items() if wanted is None or key in wanted}
            for ids in chunks(chosen.values()):
                connection.execute(delete(RESULT).where(RESULT.c.cell_id.in_(ids)))  # with their arrays
                connection.execute(update(ATTEMPT).where(ATTEMPT.c.cell_id.in_(ids)).values(forgiven=True))
        return tuple(chosen)

    def _known_cells(self, connection: Connection, keys: Sequence[CellKey]) -> dict[CellKey, Row[*tuple[Any, ...]]]:
        """Identifier of planned cells with status and attempt, if any; `UnknownCellError` if one is not planned."""
        statement = select(CELL.c.seed, CELL.c.content, CELL.c.id, RESULT.c.status, RESULT.c.attempt)
        statement = statement.outerjoin(RESULT, RESULT.c.cell_id == CELL.c.id)
        statement = statement.where(CELL.c.campaign_id == self._campaign, self._cell_in(keys))
        known = {CellKey(row.seed, row.content): row for row in connection.execute(statement)}
        for key in keys:
            if key not in known:
                raise UnknownCellError(
                    f"Seed {key.seed} with content {key.content} % is not part of the campaign's plan.",
                    "Extend the plan (begin_campaign or extend) before storing its outcome.",
                )
        return known


def _plan_cells(connection: Connection, campaign_id: int, keys: Iterable[CellKey]) -> int:
    """Plan the cells that are not planned yet, by seed, then content; return their number."""
    statement = select(CELL.c.seed, CELL.c.content).where(CELL.c.campaign_id == campaign_id)
    planned = {(seed, content) for seed, content in connection.execute(statement)}
    new = [key for key in sorted(set(keys)) if (key.seed, key.content) not in planned]
    _insert(connection, CELL, [{"campaign_id": campaign_id, "seed": key.seed, "content": key.content} for key in new])
    return len(new)


def _distinct_batches(results: Iterable[CellResult]) -> Iterator[list[CellResult]]:
    """Split into batches without repeated cells, so that a later outcome of a cell meets the stored earlier one."""
    for chunk in chunks(results):
        batch: dict[CellKey, CellResult] = {}
        for result in chunk:
            if result.key in batch:
                yield list(batch.values())
                batch = {}
            batch[result.key] = result
        yield list(batch.values())


def _insert(connection: Connection, table: Table, rows: Sequence[dict[str, Any]]) -> None:
    if rows:
        connection.execute(insert(table), rows)


def _attempt_in(numbered: Sequence[tuple[int, int]]) -> ColumnElement[bool]:
    """Condition that an attempt is one of these (cell, number), in a form for which SQLite uses its index."""
    listed = tuple_(ATTEMPT.c.cell_id, ATTEMPT.c.number).in_(numbered)
    return and_(ATTEMPT.c.cell_id.in_([cell_id for cell_id, _ in numbered]), listed)
