"""Translation between database rows and frozen records, both ways."""

from dataclasses import asdict, fields
from datetime import datetime
from typing import Any

from sqlalchemy import Row

from calcidem.storage.records import (
    AttemptRecord,
    CellKey,
    CellResult,
    CementPattern,
    GraphSummary,
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


def result_values(cell_id: int, result: CellResult) -> dict[str, Any]:
    """Columns of a `ResultRow`."""
    return {"cell_id": cell_id} | {name: getattr(result, name) for name in RESULT_FIELDS}


def attempt_values(cell_id: int, result: CellResult, run_id: int | None, recorded: datetime) -> dict[str, Any]:
    """Columns of the `AttemptRow` that ended with a result."""
    return {
        "cell_id": cell_id,
        "number": result.attempt,
        "run_id": run_id,
        "outcome": result.status.value,
        "recorded": recorded,
        "forgiven": False,
    } | {name: getattr(result, name) for name in ATTEMPT_FIELDS}


def path_values(cell_id: int, features: PathFeatures) -> dict[str, Any]:
    """Columns of a `PathRow`."""
    values = {name: getattr(features, name) for name in PATH_FIELDS}
    return values | {"cell_id": cell_id, "path": list(features.path)}


def graph_values(cell_id: int, graph: GraphSummary) -> dict[str, Any]:
    """Columns of a `GraphRow`."""
    return {"cell_id": cell_id} | {name: getattr(graph, name) for name in GRAPH_FIELDS}


def signal_values(cell_id: int, signal: Signal) -> dict[str, Any]:
    """Columns of a `SignalRow`."""
    samples = pack_arrays({name: getattr(signal, name) for name in _SIGNAL_ARRAYS})
    times = {"sampling_interval": signal.sampling_interval, "start_time": signal.start_time}
    return {"cell_id": cell_id, **times, "samples": samples}


def signal_from_row(row: SignalRow) -> Signal:
    """Inverse of `signal_values`."""
    return Signal(row.sampling_interval, row.start_time, **unpack_arrays(row.samples))


def cement_values(cell_id: int, cement: CementPattern) -> dict[str, Any]:
    """Columns of a `CementRow`."""
    return {"cell_id": cell_id, "pattern": pack_arrays({name: getattr(cement, name) for name in _CEMENT_ARRAYS})}


def cement_from_row(row: CementRow) -> CementPattern:
    """Inverse of `cement_values`."""
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
