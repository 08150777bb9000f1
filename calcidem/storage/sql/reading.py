"""Reading of a campaign: a `Selection` gives records and columns; damaged rows become damaged cells."""

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from functools import partial
from itertools import islice
from typing import Any, TypeVar

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from calcidem.storage.errors import DamagedStoreError, QueryError, UnknownCellError
from calcidem.storage.records import (
    ARRAY_RECORDS,
    QUANTITY_BY_NAME,
    AttemptCount,
    AttemptRecord,
    CellKey,
    CellResult,
    CellStatus,
    PackingRecord,
    RunRecord,
    canonical_content,
    checked_seed,
)
from calcidem.storage.records.arrays import unpack_arrays
from calcidem.storage.sql.checksums import arrays_text, covered_columns, is_intact, row_checksums
from calcidem.storage.sql.database import OpenDatabase, is_possible
from calcidem.storage.sql.engine import UNREADABLE, may_be_damage
from calcidem.storage.sql.lease import Lease
from calcidem.storage.sql.tables import (
    ARRAYS,
    ATTEMPT,
    BRIEF_QUANTITIES,
    CELL,
    EXPRESSIONS,
    PACKING,
    RESULT,
    RUN,
    STATUS,
    join_results,
)
from calcidem.storage.sql.where import parse_where
from calcidem.storage.store import ALL_CELLS, LeaseHolder, Selection, StoreMark

T = TypeVar("T")

_ROWS_READ_AT_ONCE = 500
"""Number of rows converted to Python objects at a time; so few fit into the processor's cache."""

_KEYS_PER_QUERY = 500
"""Number of keys listed in one query, far below the number of parameters that any database allows."""

_LARGEST_LIMIT = 2**63 - 1  # largest whole number of databases
_MOST_ATTEMPTS = 2**31 - 1  # largest number of an attempt, in a 32-bit column

_BY_KEY = (CELL.c.seed, CELL.c.content)
_OF_CELL = {name for name, column in EXPRESSIONS.items() if getattr(column, "table", None) is CELL}
_OF_ATTEMPT = {name for name, column in EXPRESSIONS.items() if getattr(column, "table", None) is ATTEMPT}
_KINDS = {"real": np.float64, "whole": np.float64, "text": np.object_}
_DAMAGED_RUN = "damaged: what was stored of this run was changed"


def chunks(items: Iterable[T], size: int = _KEYS_PER_QUERY) -> Iterator[list[T]]:
    """Split a long sequence into pieces of at most `size`."""
    remaining = iter(items)
    while chunk := list(islice(remaining, size)):
        yield chunk


class StoreReader(OpenDatabase):
    """Queries of a `Store`; none changes it."""

    # Provenance

    def runs(self) -> tuple[tuple[int, RunRecord], ...]:
        """All runs of the campaign with their numbers, oldest first; a damaged run has only its number."""
        with self._reading() as connection:
            statement = sa.select(RUN).where(RUN.c.campaign_id == self._campaign).order_by(RUN.c.id)
            return tuple((row["id"], _run_of(dict(row))) for row in connection.execute(statement).mappings())

    def lease_holder(self) -> LeaseHolder | None:
        """Return the holder of the lease, None without one; it may have died (`LeaseHolder.may_live`)."""
        with self._reading() as connection:
            return Lease.holder(connection, self._campaign)

    def packing(self, index: int = 0) -> PackingRecord:
        """Return a packing of the campaign.

        `UnknownCellError` if none is stored under that index; `DamagedStoreError` if it was changed.
        """
        with self._reading() as connection:
            statement = sa.select(PACKING).where(PACKING.c.campaign_id == self._campaign, PACKING.c.number == index)
            if (row := connection.execute(statement).mappings().first()) is not None:
                return self._packing_of(dict(row))
        raise UnknownCellError(f"Packing {index} is not stored.", f"Stored are: {self.packing_indices()}.")

    def content_hashes(self) -> dict[int, str | None]:
        """Return the content hash of each stored packing by index, ascending; None for an old packing without one."""
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
        # In SQLite a damaged column may hold a text, a fraction or a huge number; the next attempt continues the count.
        number = sa.case((ATTEMPT.c.number.between(1, _MOST_ATTEMPTS), sa.cast(ATTEMPT.c.number, sa.Integer)), else_=0)
        statement = (
            sa.select(CELL.c.seed, CELL.c.content, sa.func.max(number), losses)
            .join(ATTEMPT, ATTEMPT.c.cell_id == CELL.c.id)
            .where(CELL.c.campaign_id == self._campaign)
            .group_by(CELL.c.id, CELL.c.seed, CELL.c.content)
        )
        listed = None if keys is None else list(keys)
        counts = dict.fromkeys(listed or (), AttemptCount())
        with self._reading() as connection:
            # In a large campaign few are, and finding these first takes a tenth of the time.
            may_be = sa.select(ATTEMPT.c.cell_id).where(sa.or_(ATTEMPT.c.number > 1, ATTEMPT.c.outcome == "lost"))
            repeated = statement.where(CELL.c.id.in_(may_be)).having(sa.or_(sa.func.max(number) > 1, losses > 0))
            for part in [repeated] if listed is None else [statement.where(self._cell_in(c)) for c in chunks(listed)]:
                for seed, content, attempts, lost in connection.execute(part):
                    counts[CellKey(seed, content)] = AttemptCount(attempts, int(lost))
        return counts

    def history(self, selection: Selection = ALL_CELLS) -> Iterator[AttemptRecord]:
        """All undamaged attempts at the selected cells, by seed, content and number."""
        found = self._piecewise(self._chosen(selection), self._attempts_or_damage)
        return (attempt for _, attempt in found if attempt is not None)

    # Outcomes

    def cell(self, *, seed: int, content: float) -> CellResult:
        """Return the outcome of one cell with its arrays; `UnknownCellError` if it has none."""
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

        ``with_arrays`` loads paths, sections and cement patterns, some 50 kB a cell, or those of `ARRAY_RECORDS` that
        it names. Others are None; they are neither read nor checked.
        """
        wanted = (ARRAY_RECORDS if with_arrays else ()) if isinstance(with_arrays, bool) else with_arrays
        found = self._piecewise(self._chosen(selection), partial(_results_of, wanted=wanted))
        return (result for result in found if _is_selected(result.status, selection))

    def arrays(self, selection: Selection = ALL_CELLS) -> Iterator[tuple[CellKey, dict[str, Any] | str]]:
        """Array records (`ARRAY_RECORDS`) by name, of the selected cells with arrays, by seed, then content.

        Unlike in `results`, the numbers of the cells are neither read nor checked. For damaged arrays there is a clause
        about the damage.
        """
        return self._piecewise(self._chosen(selection), _all_arrays_of)

    def _chosen(self, selection: Selection) -> Sequence[int]:
        """Row numbers of the selected cells, by seed, then content."""
        statement = join_results(sa.select(CELL.c.id)).where(*_conditions(self._campaign, selection)).order_by(*_BY_KEY)
        with self._reading() as connection:
            _refuse_unknown_contents(connection, self.record.name, self._campaign, selection)
            return connection.scalars(statement).all()

    def _piecewise(
        self, cells: Sequence[int], fetch: Callable[[sa.Connection, Sequence[int]], Iterable[T]]
    ) -> Iterator[T]:
        """Fetch data of cells piece by piece.

        No transaction stays open between the pieces, since it would prevent a writer from emptying its log.
        """
        for chunk in chunks(cells):
            with self._reading() as connection:
                found = list(fetch(connection, chunk))
            yield from found

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
        float64 for other numbers (NaN where missing). If all quantities are brief, only the brief checksum is compared.
        `QueryError` for an unknown quantity, an invalid filter, or a negative limit.
        """
        if unknown := [name for name in (*names, *(n.removeprefix("-") for n in sort)) if name not in QUANTITY_BY_NAME]:
            raise QueryError(f"Unknown quantities: {', '.join(unknown)}.", f"Known are: {', '.join(QUANTITY_BY_NAME)}.")
        if not names or (limit is not None and not 0 <= limit <= _LARGEST_LIMIT):
            raise QueryError(
                f"{len(names)} columns and limit {limit} are not a table.", "Give columns, and a limit of 0 or more."
            )
        fetched = tuple(dict.fromkeys(stored for name in names for stored in QUANTITY_BY_NAME[name].needs or (name,)))
        seeks_damage = CellStatus.DAMAGED in (selection.statuses or ())
        outcomes = _Outcomes(None if seeks_damage else fetched)
        statement = join_results(sa.select(*outcomes.columns)).where(*_conditions(self._campaign, selection))
        columns = [(EXPRESSIONS[name.removeprefix("-")], name.startswith("-")) for name in sort]
        order = [(column.desc() if falls else column.asc()).nulls_last() for column, falls in columns]
        with self._reading() as connection:
            _refuse_unknown_contents(connection, self.record.name, self._campaign, selection)
            try:
                ordered = statement.order_by(*order, *_BY_KEY).limit(limit)
                rows = connection.execute(ordered, execution_options={"yield_per": _ROWS_READ_AT_ONCE})
                return _with_derived(_listed(rows.partitions(), outcomes, fetched, selection), names)
            except UNREADABLE as error:
                if sort or limit is not None or not may_be_damage(error):
                    raise  # unreadable values have no order
            cells = sa.select(CELL.c.id).where(CELL.c.campaign_id == self._campaign).order_by(*_BY_KEY)
            found = (
                row
                for chunk in chunks(connection.scalars(cells).all())
                for row in _rows_or_keys(connection, statement, chunk)
            )
            return _with_derived(_listed(chunks(found, _ROWS_READ_AT_ONCE), outcomes, fetched, selection), names)

    def integrity(self) -> tuple[dict[CellKey, str], list[str]]:
        """Compare all stored data of the campaign with their checksums, and let the database check itself.

        Return the damaged cells, each with a clause about its damaged parts, and sentences about damage of packings,
        runs, attempts or the file.
        """
        noted = Lease(self.address.path).acknowledged()
        outcomes = self.results(with_arrays=True)
        damaged = {result.key: result.reason for result in outcomes if result.status is CellStatus.DAMAGED}
        others = [f"Run {number}: {_DAMAGED_RUN}" for number, run in self.runs() if run.exit_state == _DAMAGED_RUN]
        for index in self.packing_indices():
            try:
                self.packing(index)
            except DamagedStoreError as error:
                others.append(f"Packing {index}: {error.problem}")
        for row, attempt in self._piecewise(self._chosen(ALL_CELLS), self._attempts_or_damage):
            if attempt is None:
                cell = "a cell" if row is None else f"seed {row[1]}, {row[2]} %"
                others.append(f"An attempt at {cell} is not what was stored.")
        with self._reading() as connection:
            if connection.dialect.name == "sqlite":
                lines = connection.exec_driver_sql("PRAGMA integrity_check(20)").scalars().all()
                others += [f"The file: {line}." for line in lines if line != "ok"]
            if (lost := Lease.describe_loss(connection, noted)) is not None:
                others.append(lost)
        return damaged, others

    @staticmethod
    def _cell_in(keys: Sequence[CellKey]) -> sa.ColumnElement[bool]:
        """Condition that a cell is one of the keys.

        SQLite does not use an index for a list of pairs, but does for the lists of their parts.
        """
        seeds, contents = {key.seed for key in keys}, {key.content for key in keys}
        listed = sa.tuple_(CELL.c.seed, CELL.c.content).in_([(key.seed, key.content) for key in keys])
        return sa.and_(CELL.c.seed.in_(sorted(seeds)), CELL.c.content.in_(sorted(contents)), listed)

    @staticmethod
    def _attempts_or_damage(
        connection: sa.Connection, cells: Sequence[int]
    ) -> Iterator[tuple[Sequence[Any] | None, AttemptRecord | None]]:
        """Rows of the attempts at cells (None if unreadable), and their records (None if damaged)."""
        names = covered_columns(ATTEMPT)
        statement = sa.select(
            CELL.c.id, *_BY_KEY, ATTEMPT.c.checksum, ATTEMPT.c.forgiven, *(ATTEMPT.c[n] for n in names)
        )
        statement = statement.join(ATTEMPT, ATTEMPT.c.cell_id == CELL.c.id).order_by(*_BY_KEY, ATTEMPT.c.number)
        rows = [row for _, row in _readable_rows(connection, statement, CELL.c.id, cells)]
        readable = [row for row in rows if row is not None]
        columns = list(zip(*readable, strict=True))
        named = (
            {"seed": columns[1], "content": columns[2]} | dict(zip(names, columns[5:], strict=True)) if readable else {}
        )
        checksums = iter(row_checksums(ATTEMPT, named) if readable else ())
        for row in rows:
            if row is None or row[3] != next(checksums):
                yield row, None
            else:
                values = dict(zip(names, row[5:], strict=True))
                yield row, AttemptRecord(CellKey(row[1], row[2]), forgiven=bool(row[4]), **values)

    @staticmethod
    def _packing_of(row: Mapping[str, Any]) -> PackingRecord:
        """Build a packing from its row; `DamagedStoreError` if the row was changed."""
        if not is_intact(PACKING, row):
            raise DamagedStoreError(
                f"The stored packing {row['number']} was changed after it had been stored.",
                "The results of its cells can be read as before; 'calcidem run' replaces it by the same one of the "
                "cache.",
            )
        values = {field.name: row[field.name] for field in fields(PackingRecord) if field.name in row}
        return PackingRecord(index=row["number"], **(values | unpack_arrays(row["grains"])))


# Conditions


def _conditions(campaign_id: int, selection: Selection) -> list[sa.ColumnElement[bool]]:
    """Conditions of a query over `join_results`."""
    found = [CELL.c.campaign_id == campaign_id]
    if selection.seeds:
        first, last = selection.seeds[0], selection.seeds[-1]  # a range without gaps, the usual case, needs only two
        is_range = last - first == len(selection.seeds) - 1
        found.append(CELL.c.seed.between(first, last) if is_range else CELL.c.seed.in_(selection.seeds))
    elif selection.seeds is not None:
        found.append(CELL.c.seed.in_(()))
    if selection.contents is not None:
        found.append(CELL.c.content.in_(selection.contents))
    if selection.statuses is not None and CellStatus.DAMAGED not in selection.statuses:
        # Without pending the plain column suffices, which has an index.
        status = STATUS if CellStatus.PENDING in selection.statuses else RESULT.c.status
        found.append(status.in_([s.value for s in selection.statuses]))
    if selection.where is not None:
        found.append(parse_where(selection.where))
    if selection.since is not None:
        found.append(CELL.c.id.in_(sa.select(ATTEMPT.c.cell_id).where(ATTEMPT.c.recorded >= selection.since)))
    return found


def _is_selected(status: str, selection: Selection) -> bool:
    """Whether a row is returned; a damaged one meets no filter, since its values are unknown."""
    if status == CellStatus.DAMAGED and selection.where is not None:
        return False
    return selection.statuses is None or status in selection.statuses


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


# Rows that may be damaged


def _readable_rows(
    connection: sa.Connection,
    statement: sa.Select[*tuple[Any, ...]],
    number: sa.SQLColumnExpression[Any],
    cells: Sequence[int],
) -> Iterator[tuple[int, Sequence[Any] | None]]:
    """Return the rows of some cells, beginning with the cell's number; None for unreadable ones."""
    first, last = min(cells, default=0), max(cells, default=0)  # a range without gaps, the usual case, needs only two
    is_range = last - first == len(cells) - 1
    chosen = number.between(first, last) if is_range else number.in_(cells)
    try:
        found: list[tuple[int, Sequence[Any] | None]] = [
            (row[0], row) for row in connection.execute(statement.where(chosen)).all()
        ]
    except UNREADABLE as error:
        if not may_be_damage(error):
            raise
        if len(cells) == 1:
            found = [(cells[0], None)]
        else:
            half = len(cells) // 2
            for part in (cells[:half], cells[half:]):
                yield from _readable_rows(connection, statement, number, part)
            return
    yield from found


def _rows_or_keys(
    connection: sa.Connection, statement: sa.Select[*tuple[Any, ...]], cells: Sequence[int]
) -> Iterator[Sequence[Any]]:
    """Return the rows of some cells; for an unreadable one number, seed and content, if these are readable."""
    key = sa.select(CELL.c.id, *_BY_KEY)
    for cell_id, row in _readable_rows(connection, statement, CELL.c.id, cells):
        if row is not None:
            yield row
        else:
            yield from (key for _, key in _readable_rows(connection, key, CELL.c.id, [cell_id]) if key is not None)


def _problem_of(error: Exception) -> str:
    """Damage of a cell, as a clause."""
    return error.problem if isinstance(error, DamagedStoreError) else f"it can't be read ({error})"


def _with_possible_keys(rows: Iterable[Sequence[Any]]) -> list[Sequence[Any]]:
    """Leave out rows with an impossible seed or content, whose cell is unknown."""
    return [row for row in rows if is_possible(canonical_content, row[2]) and is_possible(checked_seed, row[1])]


def _are_possible(seeds: Sequence[Any], contents: Sequence[Any]) -> bool:
    """Whether cells can have all of these seeds and contents."""
    are_seeds = set(map(type, seeds)) == {int} and min(seeds) >= 0
    return are_seeds and all(is_possible(canonical_content, content) for content in set(contents))


class _Outcomes:
    """Columns of a query over outcomes, and detection of damaged rows.

    A row begins with number, seed and content of the cell, and the number again if it has an outcome. Then follow
    checksum and columns of the outcome, and of its attempt if requested.

    Attributes
    ----------
    columns : tuple of column
        Columns to select.
    place : dict of str to int
        Place of each quantity in a row.
    """

    def __init__(self, names: Collection[str] | None = None) -> None:
        """Fetch the columns covered by the checksums of these quantities; None for all."""
        is_brief = names is not None and {*BRIEF_QUANTITIES, *_OF_CELL, *_OF_ATTEMPT}.issuperset(names)
        parts: list[tuple[sa.Table, str, tuple[str, ...]]] = [
            (RESULT, "brief_checksum", BRIEF_QUANTITIES) if is_brief else (RESULT, "checksum", covered_columns(RESULT))
        ]
        if names is None or not _OF_ATTEMPT.isdisjoint(names):
            parts.append((ATTEMPT, "checksum", covered_columns(ATTEMPT)))
        columns: list[Any] = [CELL.c.id, *_BY_KEY, RESULT.c.cell_id]
        self._parts = []
        for table, checksum, covered in parts:
            self._parts.append((table, len(columns), covered))
            columns += [table.c[checksum], *(table.c[name] for name in covered)]
        self.columns = tuple(columns)
        places = {column: place for place, column in enumerate(columns)}
        self.arrays = places.get(RESULT.c.arrays, 0)
        self.place = {"status": places[RESULT.c.status]} | {
            name: places[column] for name, column in EXPRESSIONS.items() if column in places
        }

    def _changed(self, columns: Sequence[Sequence[Any]]) -> Iterator[tuple[int, str]]:
        """Places of rows with wrong checksums, each with a clause about the damage."""
        for table, first, names in self._parts:
            covered = dict(zip(names, columns[first + 1 : first + 1 + len(names)], strict=True))
            checksums: list[int | None] = [*row_checksums(table, covered | {"seed": columns[1], "content": columns[2]})]
            if None in columns[3]:  # cells without an outcome have no checksum
                checksums = [None if cell is None else own for cell, own in zip(columns[3], checksums, strict=True)]
            if columns[first] == tuple(checksums):
                continue
            what = "its numbers were changed after they" if table is RESULT else "its attempt was changed after it"
            for place, (stored, now) in enumerate(zip(columns[first], checksums, strict=True)):
                if stored != now:
                    yield place, f"{what} had been stored"

    def judge(self, rows: Iterable[Sequence[Any]]) -> list[Sequence[Any]]:
        """Columns of the rows; a damaged row keeps only its key, with the damage as its reason."""
        found, damage = list(rows), {}
        columns: list[Any] = list(zip(*found, strict=False))  # the length of the shortest row
        if columns and not _are_possible(columns[1], columns[2]):
            found = _with_possible_keys(found)
            columns = list(zip(*found, strict=False))
        if len(columns) < len(self.columns):
            unread = [place for place, row in enumerate(found) if len(row) < len(self.columns)]
            damage = dict.fromkeys(unread, "the database can't read it")
            found = [(*row, *[None] * (len(self.columns) - len(row))) for row in found]
            columns = list(zip(*found, strict=True))
        for place, clause in self._changed(columns) if columns else ():
            damage.setdefault(place, clause)
        if damage:
            columns = [list(column) for column in columns]
            for place, clause in damage.items():
                for column in columns[3:]:
                    column[place] = None
                columns[self.place["status"]][place] = CellStatus.DAMAGED.value
                if "reason" in self.place:
                    columns[self.place["reason"]][place] = clause
        return columns


def _listed(
    parts: Iterable[Sequence[Sequence[Any]]], outcomes: _Outcomes, names: Sequence[str], selection: Selection
) -> dict[str, NDArray[Any]]:
    """Columns of the selected rows, from parts of all rows."""
    types = [np.int64 if name == "seed" else _KINDS[QUANTITY_BY_NAME[name].kind] for name in names]
    blocks: list[list[NDArray[Any]]] = [[np.empty(0, dtype=kind) for kind in types]]
    for block in parts:
        if not (columns := outcomes.judge(block)):
            continue
        listed = [columns[outcomes.place[name]] for name in names]
        arrays: list[NDArray[Any]] = [np.array(column, dtype=kind) for column, kind in zip(listed, types, strict=True)]
        statuses = columns[outcomes.place["status"]]
        if CellStatus.DAMAGED in (*statuses, *(selection.statuses or ())):  # else all rows are selected
            chosen = [_is_selected(status or CellStatus.PENDING, selection) for status in statuses]
            arrays = [array[chosen] for array in arrays]
        blocks.append(arrays)
    table = {name: np.concatenate(parts) for name, parts in zip(names, zip(*blocks, strict=True), strict=True)}
    if "status" in table:
        table["status"][table["status"] == None] = CellStatus.PENDING.value  # noqa: E711 - of each element
    return table


def _with_derived(columns: Mapping[str, NDArray[Any]], names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Columns of these names, some derived from fetched ones."""
    return {
        name: columns[name]
        if (formula := QUANTITY_BY_NAME[name].formula) is None
        else formula(np.sqrt, *(columns[needed] for needed in QUANTITY_BY_NAME[name].needs))
        for name in names
    }


# Records


def _results_of(connection: sa.Connection, cells: Sequence[int], wanted: Collection[str]) -> Iterator[CellResult]:
    """Outcomes of the cells that have one, with these arrays, by seed, then content."""
    outcomes = _Outcomes()
    statement = join_results(sa.select(*outcomes.columns)).where(RESULT.c.cell_id.is_not(None)).order_by(*_BY_KEY)
    arrays = _arrays_of(connection, cells, wanted) if wanted else {}
    for row in zip(*outcomes.judge(_rows_or_keys(connection, statement, cells)), strict=True):
        key = CellKey(row[1], row[2])
        values = {name: row[place] for name, place in outcomes.place.items()}
        try:
            if values["status"] == CellStatus.DAMAGED:
                raise DamagedStoreError(values["reason"], "")
            records = _array_records(row[outcomes.arrays], arrays.get(row[0], {}), wanted) if wanted else {}
            yield CellResult.from_values(key, values | records)
        except UNREADABLE as error:
            yield CellResult(key, CellStatus.DAMAGED, _problem_of(error))


def _all_arrays_of(connection: sa.Connection, cells: Sequence[int]) -> Iterator[tuple[CellKey, dict[str, Any] | str]]:
    """Arrays of the cells that have any, see `StoreReader.arrays`."""
    statement = join_results(sa.select(CELL.c.id, *_BY_KEY, RESULT.c.arrays)).where(RESULT.c.arrays != "")
    arrays = _arrays_of(connection, cells, ARRAY_RECORDS)
    rows = [row for _, row in _readable_rows(connection, statement.order_by(*_BY_KEY), CELL.c.id, cells)]
    for row in _with_possible_keys(filter(None, rows)):
        try:
            yield CellKey(row[1], row[2]), _array_records(row[3], arrays.get(row[0], {}), ARRAY_RECORDS)
        except UNREADABLE as error:
            yield CellKey(row[1], row[2]), _problem_of(error)


def _arrays_of(connection: sa.Connection, cells: Sequence[int], wanted: Collection[str]) -> dict[int, dict[str, bytes]]:
    """Arrays of some cells, by cell and name; unreadable ones are missing, which is detected later."""
    number: sa.SQLColumnExpression[Any] = ARRAYS.c.cell_id
    statement = sa.select(number, ARRAYS.c.name, ARRAYS.c.content).where(ARRAYS.c.name.in_(wanted))
    found: defaultdict[int, dict[str, bytes]] = defaultdict(dict)
    for _, row in _readable_rows(connection, statement, number, cells):
        if row is not None and isinstance(row[2], bytes):
            found[row[0]][row[1]] = row[2]
    return found


def _array_records(text: str | None, arrays: Mapping[str, bytes], wanted: Collection[str]) -> dict[str, Any]:
    """Build records of the arrays of a cell, by name, from their bytes and from the names and checksums of all of them.

    `DamagedStoreError` if one was changed or is missing.
    """
    stored = {word for word in (text or "").split() if word.partition(":")[0] in wanted}
    if changed := stored ^ set(arrays_text(arrays).split()):
        names = ", ".join(sorted({word.partition(":")[0] for word in changed}))
        raise DamagedStoreError(f"its {names} was changed after it had been stored, or is missing", "")
    records: dict[str, Any] = {}
    for name, content in arrays.items():
        kind: type[Any] = ARRAY_RECORDS[name]
        unpacked = unpack_arrays(content).items()
        records[name] = kind(**{field: array if array.ndim else array.item() for field, array in unpacked})
    return records


def _run_of(row: Mapping[str, Any]) -> RunRecord:
    if not is_intact(RUN, row):
        return RunRecord({}, "", "", 1, "", datetime.fromtimestamp(0, UTC), exit_state=_DAMAGED_RUN)
    return RunRecord(**{field.name: row[field.name] for field in fields(RunRecord)})
