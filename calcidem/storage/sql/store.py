"""The store on a SQL database: SQLite by default, PostgreSQL by URL."""

import errno
import os
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import asdict, replace
from datetime import datetime
from itertools import product, starmap
from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from sqlalchemy import select
from sqlalchemy.orm import Session

from calcidem.storage.errors import (
    DamagedStoreError,
    ForeignDatabaseError,
    ReadOnlyStoreError,
    ReplacedStoreError,
    StoreError,
    StoreUnavailableError,
    UnknownCampaignError,
    UnknownCellError,
)
from calcidem.storage.records import (
    ARRAY_RECORDS,
    AttemptCount,
    AttemptRecord,
    CampaignRecord,
    CellKey,
    CellResult,
    CellStatus,
    PackedResult,
    PackingRecord,
    RunRecord,
    WorkerRecord,
)
from calcidem.storage.records.run import as_utc
from calcidem.storage.sql import lease, reading, rows, writing
from calcidem.storage.sql.checksums import checksum_of
from calcidem.storage.sql.engine import (
    Address,
    bring_log_into_file,
    execute_on_connect,
    make_engine,
    parse_address,
    transaction,
)
from calcidem.storage.sql.models import RUN, CampaignRow, LeaseRow, PackingRow, RunRow
from calcidem.storage.sql.schema import is_empty, prepare_schema
from calcidem.storage.store import (
    ALL_CELLS,
    RETRIED_BY_DEFAULT,
    Closable,
    Integrity,
    LeaseGrant,
    LeaseHolder,
    Selection,
    StoreMark,
)

_CHECKPOINT_INTERVAL = 10.0
"""Seconds after which a writer's next transaction brings the write-ahead log into the file, for whoever copies that."""

_NEVER_RETRIED = {CellStatus.PENDING, CellStatus.RUNNING, CellStatus.DONE, CellStatus.DAMAGED}


def open_store(path_or_url: str | os.PathLike[str], *, read_only: bool = False) -> "Store":
    """Open a store, creating its database unless `read_only`.

    Parameters
    ----------
    path_or_url : str or path
        File of a SQLite database, or an URL such as ``postgresql://user@host/database``.
    read_only : bool
        Refuse every write, and create nothing.

    Raises
    ------
    StoreError
        `ForeignDatabaseError`, `NewerSchemaError`, `OlderSchemaError`, `StoreUnavailableError`,
        `ReadOnlyStoreError`, `DamagedStoreError` or `StoreLockedError`; a database that is refused is left
        as it was.
    """
    return Store(parse_address(path_or_url), read_only=read_only)


def read_campaign(path_or_url: str | os.PathLike[str], name: str | None = None) -> "Store":
    """Open a store for reading, with a campaign of that name chosen, or the only one; a run may go on writing it.

    Raises
    ------
    StoreError
        As `open_store`, and if the database has no such campaign.
    """
    store = open_store(path_or_url, read_only=True)
    try:
        store.use_campaign(name)
    except BaseException:
        store.close()
        raise
    return store


class Store(Closable):
    """Campaigns, their cells and their outcomes, kept for good.

    On SQLAlchemy; see `open_store`. Its rules:

    1. A store holds any number of campaigns with different names. `begin_campaign` or `use_campaign`
       chooses the one that all other methods are about.
    2. A campaign's physics never changes: its name goes with one hash. Its plan of seeds and contents only
       grows.
    3. Each writing method is one transaction: when it returns, all of it is on disk; when it raises,
       nothing is. `together` makes one of several.
    4. Writing the same thing again changes nothing. A result is identified by its cell and the number of
       its attempt.
    5. A done cell stays as it is unless `replace_done` is asked for. Any other outcome gives way to one of
       the same or a later attempt, and to a done one.
    6. A cell without an outcome is pending. Every outcome settles its cell; `retry` makes settled cells
       pending again and keeps their history.
    7. Attempts are counted from 1 for each cell over all runs, those whose worker was lost included. The
       caller gives a result the number ``attempts + 1`` of `attempt_counts`.
    8. Callers get frozen records, never rows; errors are `StoreError` with cause and cure.
    9. At most one process holds the lease of a campaign. Once its lease has been taken over, a store
       refuses to write. Writing without ever having asked for the lease is allowed, for imports and single
       commands.
    10. Reading never blocks a writer for longer than one short query, and sees only whole transactions.
    11. A cell whose stored outcome is not what was stored is `CellStatus.DAMAGED` in whatever reads the damaged part;
       nothing of it is given but its key and what is damaged. `retry_damaged` makes it pending.
    12. Before a campaign is chosen, whatever is about one raises `UnknownCampaignError`. Writing may raise
        `ReadOnlyStoreError`, `LeaseLostError` or `DiskFullError`, and any method another `StoreError` of its database.
        A `Selection` whose filter can't be understood raises `QueryError`, one with a content that is not planned
        `UnknownCellError`.

    A store is a context manager that closes itself. It may be used by one thread at a time.

    Attributes
    ----------
    address : Address
    read_only : bool
    """

    def __init__(self, address: Address, *, read_only: bool = False) -> None:
        self.address = address
        self.read_only = read_only
        self._campaign_id: int | None = None
        self._record: CampaignRecord | None = None
        self._run_id: int | None = None
        self._token: str | None = None
        self._session: Session | None = None
        self._closed = False
        self._next_checkpoint = 0.0
        self._lock = lease.FileLock(address.path) if address.path and not read_only else None
        _check_file(address, read_only=read_only)
        if not read_only:
            _look_before_writing(address)
        self._engine = make_engine(address, read_only=read_only)
        try:
            with transaction(self._engine, address, write=not read_only) as session:
                statements = prepare_schema(session.connection(), address, read_only=read_only)
            if statements:
                execute_on_connect(self._engine, statements)
            self._file = None if address.path is None else address.path.stat()
        except BaseException:
            self._engine.dispose()
            raise

    # Transactions

    @contextmanager
    def together(self) -> Iterator[None]:
        """Make one transaction of all that the block does: the whole is stored at its end, or nothing is.

        Other processes that write the same database wait, so none may be at work on a campaign of it.

        Raises
        ------
        LeaseHeldError
            If another living process is the master of a campaign of the database.
        """
        chosen = self._campaign_id, self._record, self._run_id
        try:
            with self._writing() as session:
                lease.refuse_other_masters(session, self._token)
                self._session = session
                yield
        except BaseException:
            self._campaign_id, self._record, self._run_id = chosen
            raise
        finally:
            self._session = None

    def _reading(self) -> AbstractContextManager[Session]:
        self._refuse_closed()
        if self._session is not None:
            return nullcontext(self._session)
        return transaction(self._engine, self.address, write=False)

    @contextmanager
    def _writing(self) -> Iterator[Session]:
        """Open a writing transaction that fails if the lease was lost."""
        self._refuse_closed()
        if self._session is not None:
            yield self._session
            return
        self._refuse_replaced()
        if self.read_only:
            raise ReadOnlyStoreError(f"{self.address} was opened for reading only.", "Open it for writing.")
        with transaction(self._engine, self.address, write=True) as session:
            heartbeat = None if self._token is None else lease.renew_lease(session, self._token)
            yield session
        if self._lock is not None and self._token is not None and heartbeat is not None:
            self._lock.note(self._token, heartbeat)
        if time.monotonic() > self._next_checkpoint:
            self._bring_log_into_file()

    def _refuse_closed(self) -> None:
        if self._closed:
            raise StoreUnavailableError(f"{self.address} was closed.", "Open it again to go on with it.")

    def _bring_log_into_file(self) -> None:
        if self.address.path is not None and not self.read_only:
            bring_log_into_file(self._engine)
            self._next_checkpoint = time.monotonic() + _CHECKPOINT_INTERVAL

    def _acknowledged(self) -> lease.Acknowledged | None:
        """What the last master was told to be stored, unless it has ended in order."""
        return None if self.address.path is None else lease.Acknowledged.noted_beside(self.address.path)

    def _refuse_replaced(self) -> None:
        """Raise `ReplacedStoreError` if what is written would be in no file, or not in that of the name."""
        path = self.address.path
        if path is None or self._file is None:
            return
        try:
            found = path.stat()
        except FileNotFoundError:
            found = None
        except OSError:
            return  # the next transaction has the words for it
        if found is None or not os.path.samestat(found, self._file):
            what = "removed" if found is None else "replaced by another file"
            raise ReplacedStoreError(
                f"{path} was {what} while it was being written.",
                "Put the database back if you can, and run the same command again: it computes what is not in it.",
            )

    @property
    def _campaign(self) -> int:
        if self._campaign_id is None:
            raise UnknownCampaignError("No campaign was chosen.", "Call begin_campaign or use_campaign first.")
        return self._campaign_id

    # Campaigns and runs

    def campaigns(self) -> tuple[CampaignRecord, ...]:
        """All campaigns, oldest first."""
        with self._reading() as session:
            found = session.scalars(select(CampaignRow).order_by(CampaignRow.id))
            return tuple(reading.campaign_record(session, row) for row in found)

    def begin_campaign(self, campaign: CampaignRecord) -> CampaignRecord:
        """Create the campaign, or continue the one with the same hash and extend its plan by what is new.

        Returns
        -------
        CampaignRecord
            As stored: with the seeds and contents of all plans so far.

        Raises
        ------
        CampaignMismatchError
            If the name is taken by a campaign with another hash; the message lists the differences, one
            nested key a line.
        """
        with self._writing() as session:
            row = writing.begin_campaign(session, campaign)
            writing.plan_cells(session, row.id, starmap(CellKey, product(campaign.seeds, campaign.contents)))
            record = reading.campaign_record(session, row)
        self._campaign_id, self._record = row.id, record
        return record

    def use_campaign(self, name: str | None = None) -> CampaignRecord:
        """Choose an existing campaign; without a name the only one there is.

        Raises
        ------
        UnknownCampaignError
            If there is none of that name, or several and no name was given.
        """
        with self._reading() as session:
            found = list(session.scalars(select(CampaignRow).order_by(CampaignRow.id)))
            chosen = [row for row in found if name is None or row.name == name]
            if len(chosen) != 1:
                names = ", ".join(f"'{row.name}'" for row in found) or "none"
                wanted = f"no campaign '{name}'" if name is not None else f"{len(found)} campaigns"
                raise UnknownCampaignError(f"{self.address} has {wanted}.", f"Name one of its campaigns: {names}.")
            self._campaign_id, self._record = chosen[0].id, reading.campaign_record(session, chosen[0])
        return self._record

    @property
    def record(self) -> CampaignRecord:
        """The campaign that was chosen, as it was then."""
        if self._record is None:
            raise UnknownCampaignError("No campaign was chosen.", "Call begin_campaign or use_campaign first.")
        return self._record

    def extend(self, seeds: Iterable[int], contents: Iterable[float]) -> int:
        """Plan all cells of seeds x contents (percent) that are not planned yet; return how many were added."""
        return self.plan(starmap(CellKey, product(seeds, contents)))

    def plan(self, keys: Iterable[CellKey]) -> int:
        """Plan cells that are not planned yet; return how many were added."""
        with self._writing() as session:
            return writing.plan_cells(session, self._campaign, keys)

    def begin_run(self, run: RunRecord) -> int:
        """Store the provenance of a run and return its number.

        Attempts recorded from here on belong to it.
        """
        with self._writing() as session:
            row = rows.row_from_run(self._campaign, run)
            session.add(row)
            session.flush()
        self._run_id = row.id
        return row.id

    def end_run(self, exit_state: str, ended: datetime) -> None:
        """Store how and when the run of `begin_run` ended.

        Raises
        ------
        UnknownCampaignError
            If no run was begun.
        """
        self._change_run(exit_state=exit_state, ended=as_utc(ended))
        self._run_id = None

    def note_workers(self, workers: Iterable[WorkerRecord]) -> None:
        """Store what the processes of the run of `begin_run` are, instead of what was known; errors as `end_run`."""
        self._change_run(workers=list(map(asdict, workers)))

    def _change_run(self, **values: object) -> None:
        with self._writing() as session:
            row = session.get(RunRow, self._run_id)
            if row is None:
                raise UnknownCampaignError("No run was begun.", "Call begin_run first.")
            for name, value in values.items():
                setattr(row, name, value)
            row.checksum = checksum_of(RUN, (), rows.run_columns(row))

    def runs(self) -> tuple[tuple[int, RunRecord], ...]:
        """All runs of the campaign with their numbers, oldest first."""
        with self._reading() as session:
            found = session.scalars(select(RunRow).where(RunRow.campaign_id == self._campaign).order_by(RunRow.id))
            return tuple((row.id, rows.run_from_row(row)) for row in found)

    # Lease

    def acquire_lease(self) -> LeaseGrant:
        """Become the campaign's only master; asked again, it refreshes the lease.

        Raises
        ------
        LeaseHeldError
            If another living process is it; the message says which, and when it would count as dead.
        """
        if self._token is not None:
            self.renew_lease()
            return LeaseGrant(self._token, None)
        if self._lock is not None and not self._lock.acquire():
            raise lease.lease_held_error(self.lease_holder())
        locked = self._lock is not None and self._lock.held
        noted = self._acknowledged() if locked else None
        try:
            with self._writing() as session:
                lost = None if noted is None else noted.describe_loss(session)
                grant, heartbeat = lease.claim_lease(session, self._campaign, former_is_dead=locked)
                if self._lock is not None:
                    self._lock.forget()
        except BaseException:
            if self._lock is not None:
                self._lock.release()
            raise
        self._token = grant.token
        if self._lock is not None:
            self._lock.note(grant.token, heartbeat)
        return replace(grant, lost=lost)

    def lease_holder(self) -> LeaseHolder | None:
        """Return who holds the lease, None if nobody does; it may have died (`LeaseHolder.may_live`)."""
        with self._reading() as session:
            row = session.get(LeaseRow, self._campaign)
            return None if row is None else lease.holder_from_row(row)

    def renew_lease(self) -> None:
        """Say that this master is alive; recording does it too. Call it at least every minute.

        Raises
        ------
        LeaseLostError
            If another process took over.
        """
        with self._writing():
            pass  # every writing transaction refreshes the lease

    def release_lease(self) -> None:
        """Give the lease back; does nothing without one."""
        if self._token is not None:
            token, self._token = self._token, None
            try:
                self._refuse_replaced()
                if self._lock is not None:
                    self._lock.forget()
                with transaction(self._engine, self.address, write=True) as session:
                    lease.drop_lease(session, token)
            finally:
                if self._lock is not None:
                    self._lock.release()

    # Writing

    def save_packing(self, packing: PackingRecord, *, replace_state: bool = False) -> None:
        """Store a packing under its index; the same one is left as it is, but gets a content hash that it lacks.

        Parameters
        ----------
        packing : PackingRecord
        replace_state : bool
            Whether its state takes the place of a stored one, which is damaged.

        Raises
        ------
        CampaignMismatchError
            If the index has another packing; the message names the content hashes of both.
        """
        with self._writing() as session:
            writing.save_packing(session, self._campaign, packing, replace_state=replace_state)

    def record_results(self, results: Iterable[CellResult | PackedResult], *, replace_done: bool = False) -> int:
        """Store outcomes in one transaction (rules 4 and 5).

        Returns
        -------
        int
            How many were stored; the others were kept out by rule 5.

        Raises
        ------
        UnknownCellError
            If a cell is not planned.
        """
        with self._writing() as session:
            return writing.record_results(session, self._campaign, self._run_id, results, replace_done=replace_done)

    def record_lost(self, keys: Iterable[CellKey], reason: str) -> dict[CellKey, AttemptCount]:
        """Count one attempt that ended with the loss of its worker for each cell; return the new counts.

        Unlike the other writes each call counts, since a loss has no result to be recognised by.

        Raises
        ------
        UnknownCellError
            If a cell is not planned.
        """
        with self._writing() as session:
            return writing.record_lost(session, self._campaign, self._run_id, list(keys), reason)

    def retry(
        self, statuses: Collection[CellStatus] = RETRIED_BY_DEFAULT, keys: Iterable[CellKey] | None = None
    ) -> tuple[CellKey, ...]:
        """Make settled cells pending again, and forget the losses counted for them.

        Parameters
        ----------
        statuses : collection of CellStatus
            Which outcomes; done is refused.
        keys : iterable of CellKey, optional
            Only these cells.

        Returns
        -------
        tuple of CellKey
            The cells that are pending again.

        Raises
        ------
        ValueError
            If `statuses` contains done, pending or running.
        """
        wrong = _NEVER_RETRIED & set(statuses)
        if wrong:
            raise ValueError(f"Cells that are {', '.join(sorted(wrong))} can't be retried; give other statuses.")
        with self._writing() as session:
            return writing.make_pending(session, self._campaign, statuses, None if keys is None else list(keys))

    def retry_damaged(self, keys: Collection[CellKey]) -> None:
        """Make damaged cells (of `integrity`) pending again, and drop their attempts that are damaged."""
        with self._writing() as session:
            writing.drop_damaged(session, self._campaign, keys)

    def restore_attempts(self, attempts: Iterable[AttemptRecord]) -> None:
        """Store a history as another store kept it (for imports); attempts that are there already stay.

        Raises
        ------
        UnknownCellError
            If a cell is not planned.
        """
        with self._writing() as session:
            writing.restore_attempts(session, self._campaign, attempts)

    # Reading

    def packing(self, index: int = 0) -> PackingRecord:
        """Return a packing of the campaign.

        Raises
        ------
        UnknownCellError
            If there is none of that index (yet).
        DamagedStoreError
            If it is not what was stored.
        """
        with self._reading() as session:
            statement = select(PackingRow).where(PackingRow.campaign_id == self._campaign, PackingRow.number == index)
            if (row := session.scalar(statement)) is not None:
                return rows.packing_from_row(row)
        raise UnknownCellError(f"Packing {index} is not stored.", f"Stored are: {self.packing_indices()}.")

    def content_hashes(self) -> dict[int, str | None]:
        """Return the content hash of each stored packing by its index, ascending; None where an old one has none."""
        with self._reading() as session:
            statement = select(PackingRow.number, PackingRow.content_hash)
            statement = statement.where(PackingRow.campaign_id == self._campaign).order_by(PackingRow.number)
            return {row.number: row.content_hash for row in session.execute(statement)}

    def packing_indices(self) -> tuple[int, ...]:
        """Return the indices of the stored packings, ascending."""
        return tuple(self.content_hashes())

    def pending(
        self, seeds: Collection[int] | None = None, contents: Collection[float] | None = None
    ) -> tuple[CellKey, ...]:
        """Return the planned cells without an outcome, by seed, then content (percent); by default all."""
        return tuple(self.statuses(Selection(seeds, contents, (CellStatus.PENDING,))))

    def statuses(self, selection: Selection = ALL_CELLS) -> dict[CellKey, CellStatus]:
        """Status of each selected cell, by seed, then content; pending where it has no outcome."""
        columns = self.table(("seed", "content", "status"), selection)
        keys = map(CellKey, columns["seed"].tolist(), columns["content"].tolist())
        return dict(zip(keys, map(CellStatus, columns["status"]), strict=True))

    def status_counts(self) -> dict[tuple[float, CellStatus], int]:
        """Return how many planned cells each content (percent) has of each status; zeros are left out."""
        with self._reading() as session:
            return reading.status_counts(session, self._campaign)

    def mark(self) -> StoreMark:
        """Return what shows whether anything has changed in the database: two equal marks, and no outcome is new."""
        with self._reading() as session:
            return reading.mark(session)

    def settled(self) -> int:
        """Count the planned cells that have an outcome."""
        with self._reading() as session:
            return reading.count_settled(session, self._campaign)

    def velocities(self) -> dict[str, NDArray[Any]]:
        """Return seed, content, status and vs of all planned cells as they stand there, not compared with checksums.

        That takes a tenth of the time of `table`, and is good for a first look that `table` will mend. Status is None
        of pending cells, vs (m/s) is NaN where there is none.
        """
        with self._reading() as session:
            return reading.unchecked_velocities(session, self._campaign)

    def attempt_counts(self, keys: Iterable[CellKey] | None = None) -> dict[CellKey, AttemptCount]:
        """Count the attempts of these cells, or of all that were tried; a cell never tried counts 0."""
        with self._reading() as session:
            return reading.attempt_counts(session, self._campaign, None if keys is None else list(keys))

    def history(self, selection: Selection = ALL_CELLS) -> Iterator[AttemptRecord]:
        """All attempts at the selected cells, by seed, content and number."""
        for chunk in self._chunks(selection):
            with self._reading() as session:
                found = list(reading.attempts_of(session, chunk))
            yield from found

    def cell(self, *, seed: int, content: float) -> CellResult:
        """Return the whole outcome of one cell, with its arrays.

        Raises
        ------
        UnknownCellError
            If the cell has no outcome.
        """
        for found in self.results(Selection(seed, content), with_arrays=True):
            return found
        raise UnknownCellError(
            f"The cell of seed {seed} and content {content} % has no outcome.",
            "See 'pending' in the status, or extend the campaign.",
        )

    def results(
        self, selection: Selection = ALL_CELLS, *, with_arrays: bool | Collection[str] = False
    ) -> Iterator[CellResult]:
        """Outcomes of the selected cells, by seed, then content; fetched as they are consumed.

        Parameters
        ----------
        selection : Selection
        with_arrays : bool or collection of str
            Whether to load paths, sections and cement patterns, some 50 kB a cell, or which of them (`ARRAY_RECORDS`).
            The others are None, and are neither read nor compared with their checksums.
        """
        arrays = (ARRAY_RECORDS if with_arrays else ()) if isinstance(with_arrays, bool) else with_arrays
        chunks = self._chunks(selection)

        def fetch() -> Iterator[CellResult]:
            for chunk in chunks:
                with self._reading() as session:
                    found = list(reading.results_of(session, chunk, arrays))
                for result in found:
                    # A damaged one was chosen by what it is no longer.
                    is_filtered = result.status is CellStatus.DAMAGED and selection.where is not None
                    if not is_filtered and (selection.statuses is None or result.status in selection.statuses):
                        yield result

        return fetch()

    def arrays(self, selection: Selection = ALL_CELLS) -> Iterator[tuple[CellKey, dict[str, Any] | str]]:
        """Arrays beside the outcomes of the selected cells, of those that have some, by seed, then content.

        The numbers of the cells are neither read nor compared with their checksums, unlike by `results`.

        Returns
        -------
        iterator of (CellKey, dict or str)
            Records by name (`ARRAY_RECORDS`), or what of them is no longer what was stored, as a clause.
        """
        with self._reading() as session:
            cells = reading.select_cells_with_arrays(session, self._campaign, selection)
        for chunk in reading.chunks(cells):
            with self._reading() as session:
                found = list(reading.array_records_of(session, chunk))
            yield from found

    def _chunks(self, selection: Selection) -> Iterator[Sequence[int]]:
        """Choose the cells at once, then let the caller fetch them piece by piece.

        No transaction stays open between the pieces: an open one would keep a writer from emptying its log.
        """
        with self._reading() as session:
            reading.refuse_unknown_contents(session, self._campaign, selection)
            return reading.chunks(reading.select_cells(session, self._campaign, selection))

    def integrity(self) -> Integrity:
        """Compare everything that is stored of the campaign with its checksums, and let the database check itself."""
        noted = self._acknowledged()
        outcomes = self.results(with_arrays=True)
        damaged = {result.key: result.reason for result in outcomes if result.status is CellStatus.DAMAGED}
        others = [
            f"Run {number}: {run.exit_state}" for number, run in self.runs() if run.exit_state == rows.DAMAGED_RUN
        ]
        for index in self.packing_indices():
            try:
                self.packing(index)
            except DamagedStoreError as error:
                others.append(f"Packing {index}: {error.problem}")
        with self._reading() as session:
            others += reading.other_damage(session, self._campaign)
            lost = None if noted is None else noted.describe_loss(session)
            others += [] if lost is None else [lost]
        return Integrity(damaged, tuple(others))

    def table(
        self,
        names: Sequence[str],
        selection: Selection = ALL_CELLS,
        *,
        sort: Sequence[str] = (),
        limit: int | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Return columns of the selected planned cells in one query.

        Parameters
        ----------
        names : sequence of str
            From `calcidem.storage.records.QUANTITY_BY_NAME`.
        selection : Selection
        sort : sequence of str
            Quantities to sort by, ``-`` before a name for descending; missing values come last. What is equal is
            in the order of seed, then content.
        limit : int, optional
            Give the first so many cells only.

        Returns
        -------
        dict of str to (cells,) array
            Object arrays for texts (None where missing), int64 for seeds, and float64 for all other numbers (NaN where
            missing), in the units of the quantities.

        Raises
        ------
        QueryError
            For an unknown quantity, a filter that can't be understood, or a negative limit.
        """
        with self._reading() as session:
            reading.refuse_unknown_contents(session, self._campaign, selection)
            return reading.table(session, self._campaign, names, selection, sort, limit)

    # Life

    def close(self) -> None:
        """Release the lease and all connections; a closed store may be closed again."""
        try:
            with suppress(StoreError):  # one that can't be released, of a database that has gone, ends by itself
                self.release_lease()
        finally:
            self._closed = True
            self._bring_log_into_file()
            self._engine.dispose()


def _check_file(address: Address, *, read_only: bool) -> None:
    """Say in plain words what is wrong with a path, where SQLite only says "unable to open database file"."""
    path = address.path
    if path is None:
        return
    if path.is_dir():
        raise StoreUnavailableError(f"{path} is a folder.", "Give a file name.")
    if path.exists() and not _can_be_read_from_its_beginning(path):
        raise ForeignDatabaseError(f"{path} is not a database file.", "Give a file name, not that of a device.")
    if read_only and not path.exists():
        raise StoreUnavailableError(f"{path} does not exist.", "Check the name; 'calcidem run' creates a database.")
    if not path.parent.is_dir():
        raise StoreUnavailableError(f"The folder {path.parent} does not exist.", "Create it, or give another name.")


def _can_be_read_from_its_beginning(path: Path) -> bool:
    """Whether this is a file, and not one of the kernel's that only look like one."""
    if not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            file.read(1)
    except OSError as error:
        return error.errno != errno.EIO  # what else is wrong SQLite says
    return True


def _look_before_writing(address: Address) -> None:
    """Refuse a file of another program before a writing connection changes it by setting the journal mode."""
    if address.path is None or not address.path.exists() or address.path.stat().st_size == 0:
        return
    engine = make_engine(address, read_only=True)
    try:
        with transaction(engine, address, write=False) as session:
            is_empty(session.connection(), address)
    finally:
        engine.dispose()
