"""Open database, its campaigns, and reading of the chosen one: a `Selection` gives records and columns."""

import os
import stat
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields
from itertools import islice
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from calcidem.ends import CellStatus
from calcidem.storage.errors import (
    ForeignDatabaseError,
    OutputRefusedError,
    QueryError,
    StoreUnavailableError,
    UnknownCampaignError,
    UnknownCellError,
)
from calcidem.storage.records import (
    ALL_CELLS,
    ARRAY_RECORDS,
    QUANTITY_BY_NAME,
    AttemptCount,
    AttemptRecord,
    CampaignRecord,
    CellKey,
    CellResult,
    LeaseHolder,
    PackingRecord,
    RunRecord,
    Selection,
    StoreMark,
    unpack_arrays,
)
from calcidem.storage.sql.engine import Address, Connections, find_damage, refuse_damaged
from calcidem.storage.sql.lease import Lease, refuse_hard_links, replace_database
from calcidem.storage.sql.tables import (
    ARRAYS,
    ATTEMPT,
    CAMPAIGN,
    CELL,
    EXPRESSIONS,
    PACKING,
    RESULT,
    RUN,
    STATUS,
    hint_at_quantity,
    join_results,
    parse_where,
    prepare_schema,
)

T = TypeVar("T")

_BY_KEY = (CELL.c.seed, CELL.c.content)


def chunks(items: Iterable[T], size: int = 500) -> Iterator[list[T]]:
    """Split a long sequence into pieces of at most `size`.

    500 keys in a query are far below the number of parameters that any database allows, and 500 rows as Python objects
    fit into the processor's cache.
    """
    remaining = iter(items)
    while chunk := list(islice(remaining, size)):
        yield chunk


class StoreReader:
    """Base of a `Store`: opens its database, chooses a campaign, and reads it; nothing here changes it.

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
        self._shared: sa.Connection | None = None
        self._closed = False
        if address.path is not None:
            _refuse_wrong_file(address.path, read_only=read_only)
            if not read_only:
                _prepare_file(address, address.path)
        self._connections = Connections(address, read_only=read_only)
        try:
            with self._connections.transaction(write=not read_only) as connection:
                prepare_schema(connection, address, read_only=read_only)
            self._file = None if address.path is None else address.path.stat()
        except BaseException:
            self._connections.close()
            raise

    def _reading(self) -> AbstractContextManager[sa.Connection]:
        self._refuse_closed()
        if self._shared is not None:
            return nullcontext(self._shared)
        if self.read_only and self._fate() == "replaced by another file":  # whose cells would stay unseen
            raise StoreUnavailableError(
                f"{self.address} was {self._fate()}, as 'merge' does it.", "Open it again to read the new one."
            )
        return self._connections.transaction(write=False)

    def _refuse_closed(self) -> None:
        if self._closed:
            raise StoreUnavailableError(f"{self.address} was closed.", "Open it again to go on with it.")

    def _fate(self) -> str:
        """What has become of the database file since it was opened; empty if it is there, or cannot be looked at."""
        if self.address.path is None or self._file is None:
            return ""
        try:
            found = self.address.path.stat()
        except FileNotFoundError:
            return "removed"
        except OSError:
            return ""  # the next transaction explains it
        return "" if os.path.samestat(found, self._file) else "replaced by another file"

    def _refuse_replaced(self) -> None:
        """Raise `OutputRefusedError` if the database file was removed or replaced."""
        if fate := self._fate():
            raise OutputRefusedError(
                f"{self.address.path} was {fate} while it was being written.",
                "Put the database back if you can, and run the same command again: it computes what is not in it.",
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Release all connections; a closed store may be closed again."""
        self._closed = True
        self._connections.close()

    def refuse_damaged(self) -> None:
        """Let SQLite check the file; `DamagedStoreError` if it finds damage (about 1 s for 100,000 cells)."""
        if self.address.path is not None:
            self._refuse_replaced()
            refuse_damaged(self.address.path)

    def damage(self) -> list[str]:
        """Let SQLite check the whole file; return sentences about its damage and about lost transactions, if any.

        `StoreUnavailableError` for a server's database.
        """
        if self.address.path is None:
            raise StoreUnavailableError(
                f"{self.address} is the database of a server, which calcidem cannot check.", "Use the server's tools."
            )
        noted = Lease(self.address.path).acknowledged()
        lines = [f"{self.address}: {line}." for line in find_damage(self.address.path, "integrity_check")]
        with self._reading() as connection:
            lost = None if lines else Lease.describe_loss(connection, noted)
        return lines if lost is None else [lost]

    # Campaigns

    @property
    def _campaign(self) -> int:
        if self._campaign_id is None:
            raise UnknownCampaignError("No campaign was chosen.", "Call begin_campaign or use_campaign first.")
        return self._campaign_id

    @property
    def record(self) -> CampaignRecord:
        """The chosen campaign, as read when it was chosen."""
        if self._record is None:
            raise UnknownCampaignError("No campaign was chosen.", "Call begin_campaign or use_campaign first.")
        return self._record

    def campaigns(self) -> tuple[CampaignRecord, ...]:
        """All campaigns, oldest first."""
        with self._reading() as connection:
            found = connection.execute(sa.select(CAMPAIGN).order_by(CAMPAIGN.c.id)).all()
            return tuple(self._campaign_of(connection, row) for row in found)

    def use_campaign(self, name: str | None = None) -> CampaignRecord:
        """Choose an existing campaign; without a name the only one.

        `UnknownCampaignError` if no campaign has this name, or there are several and no name is given.
        """
        with self._reading() as connection:
            found = connection.execute(sa.select(CAMPAIGN).order_by(CAMPAIGN.c.id)).all()
            chosen = [row for row in found if name is None or row.name == name]
            if len(chosen) != 1:
                names = ", ".join(f"'{row.name}'" for row in found) or "none"
                wanted = f"no campaign '{name}'" if name is not None else f"{len(found)} campaigns"
                raise UnknownCampaignError(f"{self.address} has {wanted}.", f"Name one of its campaigns: {names}.")
            self._campaign_id, self._record = chosen[0].id, self._campaign_of(connection, chosen[0])
        return self._record

    @staticmethod
    def _campaign_of(connection: sa.Connection, row: sa.Row[Any]) -> CampaignRecord:
        """Build a campaign with the seeds and contents of its planned cells."""
        planned = {
            f"{column.name}s": tuple(
                connection.scalars(sa.select(column).where(CELL.c.campaign_id == row.id).distinct())
            )
            for column in _BY_KEY
        }
        return CampaignRecord(row.hash, row.name, row.config, created=row.created, **planned)

    # Provenance

    def runs(self) -> tuple[tuple[int, RunRecord], ...]:
        """All runs of the campaign with their numbers, oldest first."""
        statement = sa.select(RUN.c.id, *(RUN.c[field.name] for field in fields(RunRecord)))
        statement = statement.where(RUN.c.campaign_id == self._campaign).order_by(RUN.c.started, RUN.c.id)
        with self._reading() as connection:
            return tuple((number, RunRecord(*values)) for number, *values in connection.execute(statement))

    def lease_holder(self) -> LeaseHolder | None:
        """Return the holder of the lease, None without one; it may have died (`LeaseHolder.may_live`)."""
        with self._reading() as connection:
            return Lease.holder(connection, self._campaign)

    def packing(self, index: int = 0) -> PackingRecord:
        """Return a packing of the campaign; `UnknownCellError` if none is stored under that index."""
        with self._reading() as connection:
            statement = sa.select(PACKING).where(PACKING.c.campaign_id == self._campaign, PACKING.c.number == index)
            if (row := connection.execute(statement).mappings().first()) is not None:
                values = {field.name: row[field.name] for field in fields(PackingRecord) if field.name in row}
                return PackingRecord(index=index, **(values | unpack_arrays(row["grains"])))
        raise UnknownCellError(f"Packing {index} is not stored.", f"Stored are: {self.packing_indices()}.")

    def content_hashes(self) -> dict[int, str]:
        """Return the content hash of each stored packing by index, ascending."""
        with self._reading() as connection:
            statement = sa.select(PACKING.c.number, PACKING.c.content_hash)
            statement = statement.where(PACKING.c.campaign_id == self._campaign).order_by(PACKING.c.number)
            return {row.number: row.content_hash for row in connection.execute(statement)}

    def packing_indices(self) -> tuple[int, ...]:
        """Return the indices of the stored packings, ascending."""
        return tuple(self.content_hashes())

    # Status

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
        """Return the number of planned cells of each content (percent) and status; zeros are left out."""
        columns = self.table(("content", "status"))
        counted = Counter(zip(columns["content"].tolist(), columns["status"].tolist(), strict=True))
        return {(content, CellStatus(status)): count for (content, status), count in sorted(counted.items())}

    def mark(self) -> StoreMark:
        """Return a mark of the database's state; with two equal marks no outcome is new."""
        counts = [sa.select(sa.func.count()).select_from(table).scalar_subquery() for table in (CELL, ATTEMPT, RESULT)]
        with self._reading() as connection:
            recorded = sa.select(sa.func.max(ATTEMPT.c.recorded)).scalar_subquery()
            found: list[Any] = list(connection.execute(sa.select(*counts, recorded)).one())
        return StoreMark(*found)

    def settled(self) -> int:
        """Count the planned cells that have an outcome."""
        statement = sa.select(sa.func.count()).select_from(RESULT).join(CELL, RESULT.c.cell_id == CELL.c.id)
        with self._reading() as connection:
            return connection.scalar(statement.where(CELL.c.campaign_id == self._campaign)) or 0

    def attempt_counts(self, keys: Iterable[CellKey] | None = None) -> dict[CellKey, AttemptCount]:
        """Count the attempts of these cells (0 if never tried), or of all cells tried again or with a lost worker."""
        losses = sa.func.sum(sa.case((sa.and_(ATTEMPT.c.outcome == "lost", ATTEMPT.c.forgiven.is_(False)), 1), else_=0))
        number = sa.func.max(ATTEMPT.c.number)
        statement = (
            sa.select(CELL.c.seed, CELL.c.content, number, losses)
            .join(ATTEMPT, ATTEMPT.c.cell_id == CELL.c.id)
            .where(CELL.c.campaign_id == self._campaign)
            .group_by(CELL.c.id, CELL.c.seed, CELL.c.content)
        )
        listed = None if keys is None else list(keys)
        counts = dict.fromkeys(listed or (), AttemptCount())
        with self._reading() as connection:
            # In a large campaign few are, and finding these first takes a tenth of the time.
            may_be = sa.select(ATTEMPT.c.cell_id).where(sa.or_(ATTEMPT.c.number > 1, ATTEMPT.c.outcome == "lost"))
            repeated = statement.where(CELL.c.id.in_(may_be)).having(sa.or_(number > 1, losses > 0))
            for part in [repeated] if listed is None else [statement.where(self._cell_in(c)) for c in chunks(listed)]:
                for seed, content, attempts, lost in connection.execute(part):
                    counts[CellKey(seed, content)] = AttemptCount(attempts, int(lost))
        return counts

    def history(self, selection: Selection = ALL_CELLS) -> Iterator[AttemptRecord]:
        """All attempts at the selected cells, by seed, content and number."""
        names = [field.name for field in fields(AttemptRecord) if field.name != "key"]
        statement = sa.select(*_BY_KEY, *(ATTEMPT.c[name] for name in names))
        statement = statement.join(ATTEMPT, ATTEMPT.c.cell_id == CELL.c.id).order_by(*_BY_KEY, ATTEMPT.c.number)

        def fetch(connection: sa.Connection, chosen: sa.ColumnElement[bool]) -> Iterator[AttemptRecord]:
            for seed, content, *values in connection.execute(statement.where(chosen)):
                yield AttemptRecord(CellKey(seed, content), *values)

        return self._piecewise(selection, fetch)

    # Outcomes

    def cell(self, *, seed: int, content: float) -> CellResult:
        """Return the outcome of one cell with its arrays; `UnknownCellError` if it has none."""
        for found in self.results(Selection(seed, content), with_arrays=True):
            return found
        raise UnknownCellError(
            f"The campaign has no outcome of seed {seed} at {content:g} %.",
            "'calcidem status DB' has its seeds and contents, and how many cells are pending.",
        )

    def results(
        self, selection: Selection = ALL_CELLS, *, with_arrays: bool | Collection[str] = False
    ) -> Iterator[CellResult]:
        """Outcomes of the selected cells, by seed, then content; fetched as they are consumed.

        ``with_arrays`` loads paths, sections and cement patterns, some 30 kB a cell, or those of `ARRAY_RECORDS` that
        it names. Others are None.
        """
        wanted = (ARRAY_RECORDS if with_arrays else ()) if isinstance(with_arrays, bool) else with_arrays
        names = [name for name, quantity in QUANTITY_BY_NAME.items() if quantity.formula is None]
        columns: list[Any] = [EXPRESSIONS[name].label(name) for name in names]
        statement = join_results(sa.select(CELL.c.id, *columns)).where(RESULT.c.cell_id.is_not(None)).order_by(*_BY_KEY)
        with_names = sa.select(ARRAYS).join(CELL, CELL.c.id == ARRAYS.c.cell_id).where(ARRAYS.c.name.in_(wanted))

        def fetch(connection: sa.Connection, chosen: sa.ColumnElement[bool]) -> Iterator[CellResult]:
            arrays: defaultdict[int, dict[str, Any]] = defaultdict(dict)
            for cell_id, name, content in connection.execute(with_names.where(chosen)) if wanted else ():
                kind: type[Any] = ARRAY_RECORDS[name]
                unpacked = unpack_arrays(content).items()
                arrays[cell_id][name] = kind(
                    **{field: array if array.ndim else array.item() for field, array in unpacked}
                )
            for cell_id, *row in connection.execute(statement.where(chosen)):
                values = dict(zip(names, row, strict=True))
                key = CellKey(values["seed"], values["content"])
                yield CellResult.from_values(key, values | arrays.get(cell_id, {}))

        return self._piecewise(selection, fetch)

    def _piecewise(
        self, selection: Selection, fetch: Callable[[sa.Connection, sa.ColumnElement[bool]], Iterable[T]]
    ) -> Iterator[T]:
        """Fetch data of the selected cells, by seed, then content, piece by piece.

        No transaction stays open between the pieces, since it would prevent a writer from emptying its log.
        """
        statement = join_results(sa.select(CELL.c.id)).where(*_conditions(self._campaign, selection)).order_by(*_BY_KEY)
        with self._reading() as connection:
            _refuse_unknown_contents(connection, self.record.name, self._campaign, selection)
            cells = connection.scalars(statement).all()

        def fetched(chunk: Sequence[int]) -> list[T]:
            with self._reading() as connection:
                return list(fetch(connection, _is_one_of(CELL.c.id, chunk)))

        return (item for chunk in chunks(cells) for item in fetched(chunk))

    def table(
        self,
        names: Sequence[str],
        selection: Selection = ALL_CELLS,
        *,
        sort: Sequence[str] = (),
        limit: int | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Return columns (`QUANTITY_BY_NAME`) of the selected planned cells in one query.

        ``sort`` names quantities, descending with ``-`` before the name. Missing values are last, equal ones in the
        order of seed, then content. Each column is (cells,): objects for texts (None where missing), int64 for seeds,
        float64 for other numbers (NaN where missing). `QueryError` for an unknown quantity, an invalid filter, or a
        negative limit.
        """
        if unknown := [name for name in (*names, *(n.removeprefix("-") for n in sort)) if name not in QUANTITY_BY_NAME]:
            raise QueryError(f"Unknown quantities: {', '.join(unknown)}.", hint_at_quantity(unknown[0]))
        if not names or (limit is not None and not 0 <= limit < 2**63):  # the largest whole number of databases
            raise QueryError(
                f"{len(names)} columns and limit {limit} are not a table.", "Give columns, and a limit of 0 or more."
            )
        columns = [(EXPRESSIONS[name.removeprefix("-")], name.startswith("-")) for name in sort]
        order = [(column.desc() if falls else column.asc()).nulls_last() for column, falls in columns]
        statement = join_results(sa.select(*(EXPRESSIONS[name].label(name) for name in names)))
        statement = statement.where(*_conditions(self._campaign, selection)).order_by(*order, *_BY_KEY).limit(limit)
        kinds = {"real": np.float64, "whole": np.float64, "text": np.object_}
        types = [np.int64 if name == "seed" else kinds[QUANTITY_BY_NAME[name].kind] for name in names]
        blocks: list[list[NDArray[Any]]] = [[np.empty(0, dtype=kind) for kind in types]]
        with self._reading() as connection:
            _refuse_unknown_contents(connection, self.record.name, self._campaign, selection)
            rows = connection.execute(statement, execution_options={"yield_per": 500})  # see `chunks`
            blocks += (
                [np.array(column, dtype=kind) for column, kind in zip(zip(*block, strict=True), types, strict=True)]
                for block in rows.partitions()
            )
            table = {name: np.concatenate(parts) for name, parts in zip(names, zip(*blocks, strict=True), strict=True)}
            if "status" in table and (unknown := sorted(set(table["status"]) - set(CellStatus))):
                raise ValueError(f"{unknown[0]} is no status")
        return table

    @staticmethod
    def _cell_in(keys: Sequence[CellKey]) -> sa.ColumnElement[bool]:
        """Condition that a cell is one of the keys.

        SQLite does not use an index for a list of pairs, but does for the lists of their parts.
        """
        seeds, contents = {key.seed for key in keys}, {key.content for key in keys}
        listed = sa.tuple_(CELL.c.seed, CELL.c.content).in_([(key.seed, key.content) for key in keys])
        return sa.and_(CELL.c.seed.in_(sorted(seeds)), CELL.c.content.in_(sorted(contents)), listed)


def _refuse_wrong_file(path: Path, *, read_only: bool) -> None:
    """Explain why SQLite is "unable to open database file" at a path, or must not."""
    if not path.parent.is_dir():
        raise StoreUnavailableError(f"The folder {path.parent} does not exist.", "Create it, or give another name.")
    try:
        status = path.stat()
    except FileNotFoundError:
        if read_only:
            cure = "Check the name; 'calcidem run' creates a database."
            raise StoreUnavailableError(f"{path} does not exist.", cure) from None
        return
    if stat.S_ISDIR(status.st_mode):
        raise StoreUnavailableError(f"{path} is a folder.", "Give a file name.")
    if not stat.S_ISREG(status.st_mode) or Path("/proc") in path.parents:  # whose files are no real ones
        raise ForeignDatabaseError(f"{path} is not a database file.", "Give a file name, not that of a device.")
    if not read_only:
        refuse_hard_links(path)


def _prepare_file(address: Address, path: Path) -> None:
    """Make a database where there is none; check one that exists before anything is written into it."""
    if not path.exists() or not path.stat().st_size:
        with replace_database(path) as temporary:
            new = Connections(Address.parse(temporary), read_only=False)
            try:
                with new.transaction(write=True) as connection:
                    prepare_schema(connection, address, read_only=False)
            finally:
                new.close()
        return
    logs = [Path(f"{path}{end}") for end in ("-wal", "-journal")]
    if Path(f"{path}.lock").exists() or any(log.is_file() and log.stat().st_size for log in logs):
        refuse_damaged(path)  # it was not closed properly, or is open
    # A file of another program is refused before a writing connection changes its journal mode.
    looking = Connections(address, read_only=True)
    try:
        with looking.transaction(write=False) as connection:
            prepare_schema(connection, address, read_only=True)
    finally:
        looking.close()


def _is_one_of(number: sa.SQLColumnExpression[Any], cells: Sequence[int]) -> sa.ColumnElement[bool]:
    """Condition that a whole number is listed; a range without gaps, the usual case, is short."""
    first, last = min(cells), max(cells)
    if last - first == len(cells) - 1:
        return number.between(first, last)
    # Written into the statement, since a database accepts only so many parameters (SQLite 32,766).
    return number.in_(
        sa.bindparam("listed", list(cells), sa.Integer, expanding=True, literal_execute=True, unique=True)
    )


def _conditions(campaign_id: int, selection: Selection) -> list[sa.ColumnElement[bool]]:
    """Conditions of a query over `join_results`."""
    found = [CELL.c.campaign_id == campaign_id]
    if selection.seeds is not None:
        found.append(_is_one_of(CELL.c.seed, selection.seeds) if selection.seeds else CELL.c.seed.in_(()))
    if selection.contents is not None:
        found.append(CELL.c.content.in_(selection.contents))
    if selection.statuses is not None:
        # Without pending the plain column suffices, which has an index.
        status = STATUS if CellStatus.PENDING in selection.statuses else RESULT.c.status
        found.append(status.in_([s.value for s in selection.statuses]))
    if selection.where is not None:
        found.append(parse_where(selection.where))
    if selection.since is not None:
        found.append(CELL.c.id.in_(sa.select(ATTEMPT.c.cell_id).where(ATTEMPT.c.recorded >= selection.since)))
    return found


def _refuse_unknown_contents(connection: sa.Connection, name: str, campaign_id: int, selection: Selection) -> None:
    """Raise an `UnknownCellError` that names the contents of a campaign if a selected one is not among them."""
    of_campaign = sa.select(CELL.c.content).where(CELL.c.campaign_id == campaign_id)
    unknown = [
        f"{content:g} %"
        for content in selection.contents or ()
        if connection.scalar(of_campaign.where(CELL.c.content == content).limit(1)) is None
    ]
    if unknown:
        there_are = ", ".join(f"{content:g}" for content in sorted(connection.scalars(of_campaign.distinct())))
        raise UnknownCellError(
            f"There is no content {', '.join(unknown)} in campaign '{name}'.", f"There are {there_are} %."
        )
