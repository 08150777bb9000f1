"""Translation between database rows and frozen records, both ways."""

from dataclasses import asdict, fields
from typing import Any

from sqlalchemy import Row

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
from calcidem.storage.sql.models import (
    AttemptRow,
    CementRow,
    GraphRow,
    PackingRow,
    PathRow,
    ResultRow,
    RunRow,
    SignalRow,
)
from calcidem.storage.sql.quantities import GRAPH_PREFIX, PATH_PREFIX

RESULT_FIELDS = tuple(f.name for f in fields(CellResult) if f.name in ResultRow.__table__.columns)
ATTEMPT_FIELDS = ("reason", "seconds", "rank", "host")
PATH_FIELDS = tuple(f.name for f in fields(PathFeatures))
GRAPH_FIELDS = tuple(f.name for f in fields(GraphSummary))
_RUN_FIELDS = tuple(f.name for f in fields(RunRecord))
_PACKING_ARRAYS = ("x", "y", "radius")
_PACKING_FIELDS = tuple(f.name for f in fields(PackingRecord) if f.name not in (*_PACKING_ARRAYS, "index"))
_SIGNAL_ARRAYS = ("sent_velocity", "received_force", "received_velocity")
_CEMENT_ARRAYS = ("contacts", "kind", "cluster_centres")

RESULT_COLUMNS = (
    *(getattr(ResultRow, name) for name in RESULT_FIELDS),
    *(getattr(AttemptRow, name) for name in ATTEMPT_FIELDS),
    *(getattr(PathRow, name).label(PATH_PREFIX + name) for name in PATH_FIELDS),
    *(getattr(GraphRow, name).label(GRAPH_PREFIX + name) for name in GRAPH_FIELDS),
)
"""Columns that `result_from_row` needs besides seed and content."""

ATTEMPT_COLUMNS = tuple(getattr(AttemptRow, f.name) for f in fields(AttemptRecord) if f.name != "key")
"""Columns that `attempt_from_row` needs behind seed and content, in the order of the record's fields."""


def result_from_row(
    row: Row[*tuple[Any, ...]], signal: Signal | None = None, cement: CementPattern | None = None
) -> CellResult:
    """Build the outcome of a cell from a row with its seed, content and `RESULT_COLUMNS`."""
    values = row._mapping  # noqa: SLF001 - SQLAlchemy's public name for it
    features = None
    if values[PATH_PREFIX + "contacts"] is not None:
        features = PathFeatures(**{name: values[PATH_PREFIX + name] for name in PATH_FIELDS})
    graph = None
    if values[GRAPH_PREFIX + "contacts"] is not None:
        graph = GraphSummary(**{name: values[GRAPH_PREFIX + name] for name in GRAPH_FIELDS})
    return CellResult(
        key=CellKey(row.seed, row.content),
        features=features,
        graph=graph,
        signal=signal,
        cement=cement,
        **{name: values[name] for name in (*RESULT_FIELDS, *ATTEMPT_FIELDS)},
    )


def pack_result(result: CellResult | PackedResult) -> PackedResult:
    """Turn an outcome into the columns of its rows, with its arrays compressed; a packed one is returned as it is."""
    if isinstance(result, PackedResult):
        return result
    columns: dict[str, dict[str, Any]] = {
        AttemptRow.__tablename__: {"outcome": result.status.value, "reason": result.reason, "seconds": result.seconds},
        ResultRow.__tablename__: {name: getattr(result, name) for name in RESULT_FIELDS if name != "attempt"},
    }
    if result.features is not None:
        path = {name: getattr(result.features, name) for name in PATH_FIELDS}
        columns[PathRow.__tablename__] = path | {"path": list(result.features.path)}
    if result.graph is not None:
        columns[GraphRow.__tablename__] = {name: getattr(result.graph, name) for name in GRAPH_FIELDS}
    if (signal := result.signal) is not None:
        samples = pack_arrays({name: getattr(signal, name) for name in _SIGNAL_ARRAYS})
        times = {"sampling_interval": signal.sampling_interval, "start_time": signal.start_time}
        columns[SignalRow.__tablename__] = times | {"samples": samples}
    if result.cement is not None:
        pattern = pack_arrays({name: getattr(result.cement, name) for name in _CEMENT_ARRAYS})
        columns[CementRow.__tablename__] = {"pattern": pattern}
    return PackedResult(result.key, result.status, result.attempt, result.rank, result.host, columns)


def signal_from_row(row: SignalRow) -> Signal:
    """Build signals from their row; see `pack_result`."""
    return Signal(row.sampling_interval, row.start_time, **unpack_arrays(row.samples))


def cement_from_row(row: CementRow) -> CementPattern:
    """Build a cement pattern from its row; see `pack_result`."""
    return CementPattern(**unpack_arrays(row.pattern))


def attempt_from_row(row: Row[*tuple[Any, ...]]) -> AttemptRecord:
    """Build an attempt from a row of seed, content and `ATTEMPT_COLUMNS`."""
    seed, content, *values = row
    return AttemptRecord(CellKey(seed, content), *values)


def row_from_packing(campaign_id: int, packing: PackingRecord) -> PackingRow:
    """Row of a packing."""
    values = {name: getattr(packing, name) for name in _PACKING_FIELDS}
    values["wall_stress"] = dict(packing.wall_stress)
    grains = pack_arrays({name: getattr(packing, name) for name in _PACKING_ARRAYS})
    return PackingRow(campaign_id=campaign_id, number=packing.index, grains=grains, **values)


def packing_from_row(row: PackingRow) -> PackingRecord:
    """Inverse of `row_from_packing`."""
    values: dict[str, Any] = {name: getattr(row, name) for name in _PACKING_FIELDS}
    return PackingRecord(index=row.number, **(values | unpack_arrays(row.grains)))


def row_from_run(campaign_id: int, run: RunRecord) -> RunRow:
    """Row of a run."""
    values = {name: getattr(run, name) for name in _RUN_FIELDS}
    values |= {"versions": dict(run.versions), "workers": [asdict(worker) for worker in run.workers]}
    return RunRow(campaign_id=campaign_id, **values)


def run_from_row(row: RunRow) -> RunRecord:
    """Inverse of `row_from_run`."""
    values = {name: getattr(row, name) for name in _RUN_FIELDS}
    return RunRecord(**(values | {"workers": tuple(WorkerRecord(**worker) for worker in row.workers or ())}))
