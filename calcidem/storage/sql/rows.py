"""Translation between database rows and frozen records, both ways."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, fields
from datetime import UTC, datetime
from typing import Any, TypeVar

from calcidem.storage.errors import DamagedStoreError
from calcidem.storage.records import (
    AttemptRecord,
    CellKey,
    CellResult,
    CementPattern,
    GraphSummary,
    PackedResult,
    PackingRecord,
    PathFeatures,
    RunRecord,
    Signal,
    WorkerRecord,
)
from calcidem.storage.records.arrays import pack_arrays, unpack_arrays
from calcidem.storage.sql.checksums import (
    PARTS,
    checksum_of,
    covered_columns,
    is_intact,
    is_intact_part,
    parts_text,
    result_checksum,
)
from calcidem.storage.sql.models import (
    AttemptRow,
    Base,
    CellRow,
    CementRow,
    GraphRow,
    PackingRow,
    PathRow,
    ResultRow,
    RunRow,
    SignalRow,
)
from calcidem.storage.sql.quantities import GRAPH_PREFIX, PATH_PREFIX

_RESULT_FIELDS = covered_columns(ResultRow)
_ATTEMPT_FIELDS = ("reason", "seconds", "rank", "host")
DAMAGED_RUN = "damaged: what was stored of this run was changed"
_RUN_FIELDS = tuple(f.name for f in fields(RunRecord))
_PACKING_ARRAYS = ("x", "y", "radius")
_PACKING_FIELDS = tuple(f.name for f in fields(PackingRecord) if f.name not in (*_PACKING_ARRAYS, "index"))
_SIGNAL_ARRAYS = ("sent_velocity", "received_force", "received_velocity")
_CEMENT_ARRAYS = ("contacts", "kind", "cluster_centres")
_NAMES_OF_PARTS = {PathRow: "path", GraphRow: "graph summary", SignalRow: "signal", CementRow: "cement pattern"}
_P = TypeVar("_P", PathFeatures, GraphSummary)

_TABLES_OF_OUTCOMES: tuple[tuple[type[Base], Any, dict[str, str]], ...] = (
    (ResultRow, ResultRow.checksum, {name: name for name in _RESULT_FIELDS}),
    (AttemptRow, AttemptRow.checksum, {name: name for name in _ATTEMPT_FIELDS}),
    (PathRow, PathRow.cell_id, {PATH_PREFIX + name: name for name in covered_columns(PathRow)}),
    (GraphRow, GraphRow.cell_id, {GRAPH_PREFIX + name: name for name in covered_columns(GraphRow)}),
)
"""Tables with the head of their rows, and their quantities with the columns that these are in."""


class OutcomeColumns:
    """What a query over outcomes fetches for each cell, where in its rows which quantity is, and what is damaged.

    A row begins with number, seed and content of the cell, and the number again if it has an outcome. For each table
    there follow a head, which is missing where there is no row (its checksum, or the cell that it belongs to), and the
    columns that its checksum is of.

    Attributes
    ----------
    columns : tuple of column
        To select.
    place : dict of str to int
        Place of each quantity in a row.
    """

    def __init__(self, names: Collection[str] | None = None) -> None:
        """Fetch whole rows of the tables that the quantities are in, None for all tables."""
        columns: list[Any] = [CellRow.id, CellRow.seed, CellRow.content, ResultRow.cell_id]
        self.place = {"seed": 1, "content": 2}
        self._blocks: dict[type[Base], slice] = {}
        for model, head, quantities in _TABLES_OF_OUTCOMES:
            if model is ResultRow or names is None or not quantities.keys().isdisjoint(names):
                covered, start = covered_columns(model), len(columns) + 1
                columns += [head, *(getattr(model, name) for name in covered)]
                self._blocks[model] = slice(start, start + len(covered))
                self.place |= {name: start + covered.index(column) for name, column in quantities.items()}
        self.columns = tuple(columns)

    def find_damage(self, row: Sequence[Any]) -> str:
        """Return what of a row is not what was stored, as a clause; empty if all is, or there is no outcome."""
        if len(row) < len(self.columns):
            return "the database can't read it"
        if row[3] is None:
            return ""
        owner, (checksum, *values) = row[1:3], self._row(row, ResultRow)
        if not is_intact(ResultRow, owner, values, checksum):
            return "its numbers were changed after they had been stored"
        for model in self._blocks.keys() - {ResultRow}:
            head, *values = self._row(row, model)
            if model is AttemptRow and not is_intact(model, owner, values, head):
                return "its attempt was changed after it had been stored"
            if model in PARTS and (damage := _damage_of_part(model, owner, None if head is None else values, checksum)):
                return damage
        return ""

    def result(self, row: Sequence[Any], arrays: Mapping[Any, Mapping[int, Sequence[Any]]] | None = None) -> CellResult:
        """Build the outcome of a cell; all tables must have been fetched.

        Parameters
        ----------
        row : sequence
        arrays : mapping, optional
            Columns of the rows with the arrays of cells, by table and cell.

        Raises
        ------
        DamagedStoreError
            If something is not what was stored.
        """
        damage, found = self.find_damage(row), {}
        for model, of_cells in {} if damage or arrays is None else arrays.items():
            found[model] = of_cells.get(row[0])
            damage = damage or _damage_of_part(model, row[1:3], found[model], self._row(row, ResultRow)[0])
        if damage:
            raise DamagedStoreError(damage, "")
        signal, cement = found.get(SignalRow), found.get(CementRow)
        return CellResult(
            key=CellKey(row[1], row[2]),
            features=self._part(row, PathRow, PathFeatures),
            graph=self._part(row, GraphRow, GraphSummary),
            signal=None if signal is None else Signal(*signal[:2], *_arrays_in_order(signal[2], _SIGNAL_ARRAYS)),
            cement=None if cement is None else CementPattern(*_arrays_in_order(cement[0], _CEMENT_ARRAYS)),
            **{name: row[self.place[name]] for name in (*_RESULT_FIELDS, *_ATTEMPT_FIELDS)},
        )

    def _row(self, row: Sequence[Any], model: type[Base]) -> Sequence[Any]:
        """Head and columns of a table."""
        block = self._blocks[model]
        return row[block.start - 1 : block.stop]

    def _part(self, row: Sequence[Any], model: type[Base], kind: type[_P]) -> _P | None:
        head, *values = self._row(row, model)
        return None if head is None else kind(**dict(zip(covered_columns(model), values, strict=True)))


def _damage_of_part(model: type[Base], owner: Sequence[object], values: Sequence[object] | None, checksum: str) -> str:
    """Return what is wrong with a row beside an outcome, as a clause; empty if nothing is (see `is_intact_part`)."""
    if is_intact_part(model, owner, values, checksum):
        return ""
    return f"its {_NAMES_OF_PARTS[model]} was changed after it had been stored, or is missing"


def _arrays_in_order(blob: bytes, names: Sequence[str]) -> list[Any]:
    arrays = unpack_arrays(blob)
    return [arrays[name] for name in names]


def pack_result(result: CellResult | PackedResult) -> PackedResult:
    """Turn an outcome into the columns of its rows, with its arrays compressed; a packed one is returned as it is."""
    if isinstance(result, PackedResult):
        return result
    columns: dict[str, dict[str, Any]] = {
        AttemptRow.__tablename__: {"outcome": result.status.value, "reason": result.reason, "seconds": result.seconds},
        ResultRow.__tablename__: {name: getattr(result, name) for name in _RESULT_FIELDS if name != "attempt"},
    }
    if result.features is not None:
        path = {name: getattr(result.features, name) for name in covered_columns(PathRow)}
        columns[PathRow.__tablename__] = path | {"path": list(result.features.path)}
    if result.graph is not None:
        columns[GraphRow.__tablename__] = {name: getattr(result.graph, name) for name in covered_columns(GraphRow)}
    if (signal := result.signal) is not None:
        samples = pack_arrays({name: getattr(signal, name) for name in _SIGNAL_ARRAYS})
        times = {"sampling_interval": signal.sampling_interval, "start_time": signal.start_time}
        columns[SignalRow.__tablename__] = times | {"samples": samples}
    if result.cement is not None:
        pattern = pack_arrays({name: getattr(result.cement, name) for name in _CEMENT_ARRAYS})
        columns[CementRow.__tablename__] = {"pattern": pattern}
    columns[ResultRow.__tablename__]["checksum"] = parts_text((result.key.seed, result.key.content), columns)
    return PackedResult(result.key, result.status, result.attempt, result.rank, result.host, columns)


def result_row(cell_id: int, result: PackedResult) -> dict[str, Any]:
    """Columns of the row of an outcome, with its checksum."""
    columns = {"cell_id": cell_id, "attempt": result.attempt} | result.columns[ResultRow.__tablename__]
    owner = (result.key.seed, result.key.content)
    return columns | {"checksum": result_checksum(owner, columns, columns["checksum"])}


def attempt_row(cell_id: int, result: PackedResult, shared: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of the row of the attempt that ended with an outcome, and what all attempts of a batch share."""
    own = {"cell_id": cell_id, "number": result.attempt, "rank": result.rank, "host": result.host}
    return seal_attempt(result.key, own | result.columns[AttemptRow.__tablename__] | dict(shared))


def seal_attempt(key: CellKey, columns: dict[str, Any]) -> dict[str, Any]:
    """Give the columns of an attempt their checksum."""
    return columns | {"checksum": checksum_of(AttemptRow, (key.seed, key.content), columns)}


ATTEMPT_COLUMNS = (
    *(CellRow.seed, CellRow.content, AttemptRow.checksum, AttemptRow.forgiven),
    *(getattr(AttemptRow, name) for name in covered_columns(AttemptRow)),
)
"""Columns that `attempt_from_row` needs."""


def attempt_from_row(row: Sequence[Any]) -> AttemptRecord | None:
    """Build an attempt from a row of `ATTEMPT_COLUMNS`; None if it was changed after it had been stored."""
    seed, content, checksum, forgiven, *values = row
    if not is_intact(AttemptRow, (seed, content), values, checksum):
        return None
    named = dict(zip(covered_columns(AttemptRow), values, strict=True))
    return AttemptRecord(CellKey(seed, content), forgiven=bool(forgiven), **named)


def row_from_packing(campaign_id: int, packing: PackingRecord) -> PackingRow:
    """Row of a packing."""
    values = {name: getattr(packing, name) for name in _PACKING_FIELDS}
    values |= {"number": packing.index, "wall_stress": dict(packing.wall_stress)}
    values["grains"] = pack_arrays({name: getattr(packing, name) for name in _PACKING_ARRAYS})
    return PackingRow(campaign_id=campaign_id, **values, checksum=checksum_of(PackingRow, (), values))


def packing_from_row(row: PackingRow) -> PackingRecord:
    """Inverse of `row_from_packing`.

    Raises
    ------
    DamagedStoreError
        If the row was changed after it had been stored.
    """
    if not is_intact(PackingRow, (), [getattr(row, name) for name in covered_columns(PackingRow)], row.checksum):
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
    return RunRow(campaign_id=campaign_id, **values, checksum=checksum_of(RunRow, (), values))


def run_columns(row: RunRow) -> dict[str, Any]:
    """Columns of a run that its checksum is of."""
    return {name: getattr(row, name) for name in covered_columns(RunRow)}


def run_from_row(row: RunRow) -> RunRecord:
    """Inverse of `row_from_run`; of a row that was changed after it had been stored nothing is taken but that it is."""
    values = run_columns(row)
    if not is_intact(RunRow, (), values.values(), row.checksum):
        return RunRecord({}, "", "", 1, "", datetime.fromtimestamp(0, UTC), exit_state=DAMAGED_RUN)
    return RunRecord(**(values | {"workers": tuple(WorkerRecord(**worker) for worker in row.workers or ())}))
