"""Translation between database rows and frozen records, both ways."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, fields
from datetime import UTC, datetime
from functools import cache
from typing import Any, TypeVar

import numpy as np
from sqlalchemy import Table

from calcidem.storage.errors import DamagedStoreError
from calcidem.storage.records import (
    ARRAY_RECORDS,
    AttemptRecord,
    CellKey,
    CellResult,
    GraphSummary,
    PackedResult,
    PackingRecord,
    PathFeatures,
    RunRecord,
    WorkerRecord,
)
from calcidem.storage.records.arrays import pack_arrays, unpack_arrays
from calcidem.storage.records.quantity import quantities_of
from calcidem.storage.sql.checksums import arrays_text, checksum_of, covered_columns, is_intact
from calcidem.storage.sql.models import (
    ATTEMPT,
    CELL,
    EXPRESSIONS,
    PACKING,
    RESULT,
    RUN,
    AttemptRow,
    CellRow,
    PackingRow,
    RunRow,
)

DAMAGED_RUN = "damaged: what was stored of this run was changed"
_RUN_FIELDS = tuple(f.name for f in fields(RunRecord))
_PACKING_ARRAYS = ("x", "y", "radius")
_PACKING_FIELDS = tuple(f.name for f in fields(PackingRecord) if f.name not in (*_PACKING_ARRAYS, "index"))
_RESULT_FIELDS = tuple(quantity.name for quantity in quantities_of(CellResult))
_P = TypeVar("_P", PathFeatures, GraphSummary)


class OutcomeColumns:
    """What a query over outcomes fetches for each cell, where in its rows which quantity is, and what is damaged.

    A row begins with number, seed and content of the cell, and the number again if it has an outcome. For the outcome,
    and for its attempt if that is wanted, there follow the checksum and the columns that it is of.

    Attributes
    ----------
    columns : tuple of column
        To select.
    place : dict of str to int
        Place of each quantity in a row.
    """

    def __init__(self, names: Collection[str] | None = None) -> None:
        """Fetch whole rows of the tables that the quantities are in, None for all tables."""
        columns: list[Any] = [CELL.c.id, CELL.c.seed, CELL.c.content, RESULT.c.cell_id]
        self._blocks = {}
        for table in (RESULT, ATTEMPT):
            if table is RESULT or names is None or not _quantities_in(table).isdisjoint(names):
                self._blocks[table.name] = slice(len(columns), len(columns) + 1 + len(covered_columns(table)))
                columns += [table.c.checksum, *(table.c[name] for name in covered_columns(table))]
        self.columns = tuple(columns)
        places = {column: place for place, column in enumerate(columns)}
        self.place = {"status": places[RESULT.c.status]} | {
            name: places[column] for name, column in EXPRESSIONS.items() if column in places
        }

    def find_damage(self, row: Sequence[Any]) -> str:
        """Return what of a row is not what was stored, as a clause; empty if all is, or there is no outcome."""
        if len(row) < len(self.columns):
            return "the database can't read it"
        if row[3] is None:
            return ""
        checksum, *values = row[self._blocks[RESULT.name]]
        own, _, arrays = checksum.partition(" ") if isinstance(checksum, str) else ("", "", "")
        if not is_intact(RESULT, (row[1], row[2], arrays), values, own):
            return "its numbers were changed after they had been stored"
        if ATTEMPT.name in self._blocks:
            checksum, *values = row[self._blocks[ATTEMPT.name]]
            if not is_intact(ATTEMPT, row[1:3], values, checksum):
                return "its attempt was changed after it had been stored"
        return ""

    def result(
        self,
        row: Sequence[Any],
        arrays: Mapping[str, bytes] | None = None,
        wanted: Collection[str] = tuple(ARRAY_RECORDS),
    ) -> CellResult:
        """Build the outcome of a cell; all tables must have been fetched.

        Parameters
        ----------
        row : sequence
        arrays : mapping, optional
            Arrays of the cell by name.
        wanted : collection of str
            Which of the arrays were asked for.

        Raises
        ------
        DamagedStoreError
            If something is not what was stored.
        """
        if damage := self.find_damage(row):
            raise DamagedStoreError(damage, "")
        records = {} if arrays is None else array_records(row[self._blocks[RESULT.name]][0], arrays, wanted)
        return CellResult(
            key=CellKey(row[1], row[2]),
            features=self._part(row, PathFeatures),
            graph=self._part(row, GraphSummary),
            **records,
            **{name: row[self.place[name]] for name in _RESULT_FIELDS},
        )

    def _part(self, row: Sequence[Any], kind: type[_P]) -> _P | None:
        """Quantities that a cell has or lacks as a whole; the first of them is never missing alone."""
        names = [quantity.name for quantity in quantities_of(kind)]
        values = {name: row[self.place[name]] for name in names}
        return None if values[names[0]] is None else kind(**values)


def array_records(
    checksum: str, arrays: Mapping[str, bytes], wanted: Collection[str] = tuple(ARRAY_RECORDS)
) -> dict[str, Any]:
    """Build records of the arrays of a cell, by name, from the stored bytes of these and the checksum of its outcome.

    Raises
    ------
    DamagedStoreError
        If one is not what was stored, or is missing.
    """
    stored = {word for word in checksum.split(" ")[1:] if word.partition(":")[0] in wanted}
    if changed := stored ^ set(arrays_text(arrays).split()):
        names = ", ".join(sorted({word.partition(":")[0] for word in changed}))
        raise DamagedStoreError(f"its {names} was changed after it had been stored, or is missing", "")
    records: dict[str, Any] = {}
    for name, content in arrays.items():
        values = {field: array if array.ndim else array.item() for field, array in unpack_arrays(content).items()}
        kind: type[Any] = ARRAY_RECORDS[name]
        records[name] = kind(**values)
    return records


@cache
def _quantities_in(table: Table) -> frozenset[str]:
    """Names of the quantities that are columns of a table."""
    columns = set(table.columns)  # by hash: comparing columns makes an SQL expression of each pair
    return frozenset(name for name, column in EXPRESSIONS.items() if column in columns)


def pack_result(result: CellResult | PackedResult) -> PackedResult:
    """Turn an outcome into the columns of its rows, with its arrays compressed; a packed one is returned as it is."""
    if isinstance(result, PackedResult):
        return result
    columns: dict[str, Any] = {}
    for part in (result, result.features, result.graph):
        if part is not None:
            columns |= {quantity.name: getattr(part, quantity.name) for quantity in quantities_of(type(part))}
    arrays: dict[str, bytes] = {}
    for name in ARRAY_RECORDS:
        if (record := getattr(result, name)) is not None:
            arrays[name] = pack_arrays(
                {field.name: np.asarray(getattr(record, field.name)) for field in fields(record)}
            )
    return PackedResult(result.key, result.status, result.attempt, result.rank, result.host, columns, arrays)


def result_row(cell_id: int, result: PackedResult) -> dict[str, Any]:
    """Columns of the row of an outcome, with its checksum."""
    own = {"cell_id": cell_id, "attempt": result.attempt}
    columns = {name: result.columns.get(name) for name in covered_columns(RESULT)} | own
    arrays = arrays_text(result.arrays)
    checksum = checksum_of(RESULT, (result.key.seed, result.key.content, arrays), columns)
    return columns | {"checksum": f"{checksum} {arrays}".rstrip()}


def attempt_row(cell_id: int, result: PackedResult, shared: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of the row of the attempt that ended with an outcome, and what all attempts of a batch share."""
    own = {"cell_id": cell_id, "number": result.attempt, "outcome": result.status.value}
    own |= {"reason": result.columns["reason"], "seconds": result.columns["seconds"]}
    return seal_attempt(result.key, own | {"rank": result.rank, "host": result.host} | dict(shared))


def seal_attempt(key: CellKey, columns: dict[str, Any]) -> dict[str, Any]:
    """Give the columns of an attempt their checksum."""
    return columns | {"checksum": checksum_of(ATTEMPT, (key.seed, key.content), columns)}


ATTEMPT_COLUMNS = (
    *(CellRow.seed, CellRow.content, AttemptRow.checksum, AttemptRow.forgiven),
    *(getattr(AttemptRow, name) for name in covered_columns(ATTEMPT)),
)
"""Columns that `attempt_from_row` needs."""


def attempt_from_row(row: Sequence[Any]) -> AttemptRecord | None:
    """Build an attempt from a row of `ATTEMPT_COLUMNS`; None if it was changed after it had been stored."""
    seed, content, checksum, forgiven, *values = row
    if not is_intact(ATTEMPT, (seed, content), values, checksum):
        return None
    named = dict(zip(covered_columns(ATTEMPT), values, strict=True))
    return AttemptRecord(CellKey(seed, content), forgiven=bool(forgiven), **named)


def row_from_packing(campaign_id: int, packing: PackingRecord) -> PackingRow:
    """Row of a packing."""
    values = {name: getattr(packing, name) for name in _PACKING_FIELDS}
    values |= {"number": packing.index, "wall_stress": dict(packing.wall_stress)}
    values["grains"] = pack_arrays({name: getattr(packing, name) for name in _PACKING_ARRAYS})
    return PackingRow(campaign_id=campaign_id, **values, checksum=checksum_of(PACKING, (), values))


def packing_from_row(row: PackingRow) -> PackingRecord:
    """Inverse of `row_from_packing`.

    Raises
    ------
    DamagedStoreError
        If the row was changed after it had been stored.
    """
    if not is_intact(PACKING, (), [getattr(row, name) for name in covered_columns(PACKING)], row.checksum):
        raise DamagedStoreError(
            f"The stored packing {row.number} was changed after it had been stored.",
            "The results of its cells can be read as before; 'calcidem run' replaces it by the same one of the cache.",
        )
    values: dict[str, Any] = {name: getattr(row, name) for name in _PACKING_FIELDS}
    return PackingRecord(index=row.number, **(values | unpack_arrays(row.grains)))


def row_from_run(campaign_id: int, run: RunRecord) -> RunRow:
    """Row of a run."""
    values = {name: getattr(run, name) for name in _RUN_FIELDS}
    values |= {"versions": dict(run.versions), "workers": [asdict(worker) for worker in run.workers]}
    return RunRow(campaign_id=campaign_id, **values, checksum=checksum_of(RUN, (), values))


def run_columns(row: RunRow) -> dict[str, Any]:
    """Columns of a run that its checksum is of."""
    return {name: getattr(row, name) for name in covered_columns(RUN)}


def run_from_row(row: RunRow) -> RunRecord:
    """Inverse of `row_from_run`; of a row that was changed after it had been stored nothing is taken but that it is."""
    values = run_columns(row)
    if not is_intact(RUN, (), values.values(), row.checksum):
        return RunRecord({}, "", "", 1, "", datetime.fromtimestamp(0, UTC), exit_state=DAMAGED_RUN)
    return RunRecord(**(values | {"workers": tuple(WorkerRecord(**worker) for worker in row.workers or ())}))
