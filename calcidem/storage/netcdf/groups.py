"""Groups of an exported file: attempts and packings, and the arrays of single cells.

Columns are appended block by block to keep memory small. Arrays of different lengths lie one after the other along a
dimension, and a count for each of them tells how many elements are whose (the contiguous ragged arrays of the CF
conventions, section 9.3.3). An array whose rows differ in length from cell to cell lies there row after row.
"""

import json
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calcidem.storage.records import ARRAY_RECORDS, AttemptRecord, CellKey, PackingRecord
from calcidem.storage.records.quantity import array_fields, quantities_of

Group = Any
"""A netCDF4.Dataset or netCDF4.Group; that library has no types."""

_Column = tuple[str, str, NDArray[Any]]
"""Unit ("" for texts), long name and values of a variable."""

_COUNT = "_count"

COMPRESSED = {"compression": "zlib", "complevel": 1, "shuffle": True, "fletcher32": True}
_CHUNK = 8192  # elements, about two cells' contacts; the library's own are so small that each costs more than its bytes

_CELLS_READ_AT_ONCE = 500
"""Cells whose arrays are in memory at a time."""

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
_NO_NUMBER = -1  # stands for None in whole-number columns, all of whose real values are 0 or more


def _append_columns(group: Group, dimension: str, columns: Mapping[str, _Column]) -> None:
    """Append columns of equal length along an unlimited dimension, creating what isn't there yet.

    A column named ``<other dimension>_count`` tells how many elements of that dimension belong to each
    element of this one.
    """
    if dimension not in group.dimensions:
        group.createDimension(dimension, None)
    start = len(group.dimensions[dimension])
    for name, (unit, long_name, values) in columns.items():
        if name not in group.variables:
            is_text = values.dtype.kind == "O"
            options = (
                {} if is_text else COMPRESSED | {"chunksizes": (min(max(1, len(values)), _CHUNK), *values.shape[1:])}
            )
            further = [_fixed_dimension(group, length) for length in values.shape[1:]]
            variable = group.createVariable(name, str if is_text else values.dtype, (dimension, *further), **options)
            variable.long_name = long_name
            if unit:
                variable.units = unit
            if name.endswith(_COUNT):
                variable.sample_dimension = name.removesuffix(_COUNT)
        group.variables[name][start : start + len(values)] = values


def _fixed_dimension(group: Group, length: int) -> str:
    """Name of a dimension of this length, for arrays with several numbers for each element."""
    name = f"of_{length}"
    if name not in group.dimensions:
        group.createDimension(name, length)
    return name


def _read_columns(group: Group, dimension: str, rows: slice = slice(None)) -> dict[str, NDArray[Any]]:
    """Read all columns along a dimension, or some of their rows."""
    return {
        name: np.asarray(variable[rows])
        for name, variable in group.variables.items()
        if variable.dimensions[0] == dimension
    }


def _slice_by_counts(counts: NDArray[np.integer[Any]]) -> list[slice]:
    """Return where the elements of each owner are.

    Examples
    --------
    >>> _slice_by_counts(np.array([2, 0, 3]))
    [slice(0, 2, None), slice(2, 2, None), slice(2, 5, None)]
    """
    ends = np.cumsum(counts).tolist()
    return [slice(end - count, end) for end, count in zip(ends, counts.tolist(), strict=True)]


def _texts(values: list[str | None]) -> NDArray[np.object_]:
    """Texts as a column; a missing one is empty."""
    return np.array([value or "" for value in values], dtype=object)


def append_attempts(file: Group, attempts: Sequence[AttemptRecord]) -> None:
    """Append attempts to the group ``attempts``."""
    recorded = [(attempt.recorded - _EPOCH) // _MICROSECOND for attempt in attempts]
    seconds = [np.nan if attempt.seconds is None else attempt.seconds for attempt in attempts]
    columns = {
        "seed": ("1", "seed of the cell", np.array([a.key.seed for a in attempts], dtype=np.int64)),
        "content": ("percent", "calcite content of the cell", np.array([a.key.content for a in attempts])),
        "number": ("1", "number of the attempt", np.array([a.number for a in attempts], dtype=np.int32)),
        "run": ("1", "number of the run", _whole([a.run_id for a in attempts])),
        "outcome": ("", "outcome", _texts([a.outcome for a in attempts])),
        "reason": ("", "why", _texts([a.reason for a in attempts])),
        "rank": ("1", "MPI rank", _whole([a.rank for a in attempts])),
        "host": ("", "host", _texts([a.host for a in attempts])),
        "seconds": ("s", "computing time", np.array(seconds)),
        "recorded": ("microseconds since 1970-01-01T00:00:00Z", "time of storing", np.array(recorded, dtype=np.int64)),
        "forgiven": ("1", "1 if a retry came after it", np.array([a.forgiven for a in attempts], dtype=np.int8)),
    }
    _append_columns(file.createGroup("attempts"), "attempt", columns)


def _whole(values: Iterable[int | None]) -> "np.ndarray[tuple[int], np.dtype[np.int32]]":
    return np.array([_NO_NUMBER if value is None else value for value in values], dtype=np.int32)


def read_attempts(file: Group, run_numbers: dict[int, int]) -> Iterator[AttemptRecord]:
    """Read the group ``attempts``.

    Parameters
    ----------
    file : netCDF4.Dataset
    run_numbers : dict of int to int
        From the numbers of runs in the file to those in the store.
    """
    if "attempts" not in file.groups:
        return
    columns = _read_columns(file.groups["attempts"], "attempt")
    for i in range(len(columns["host"])):
        run, rank, seconds = int(columns["run"][i]), int(columns["rank"][i]), float(columns["seconds"][i])
        yield AttemptRecord(
            key=CellKey(int(columns["seed"][i]), float(columns["content"][i])),
            number=int(columns["number"][i]),
            outcome=str(columns["outcome"][i]),
            reason=str(columns["reason"][i]),
            rank=None if rank == _NO_NUMBER else rank,
            host=str(columns["host"][i]) or None,
            seconds=None if np.isnan(seconds) else seconds,
            recorded=_EPOCH + int(columns["recorded"][i]) * _MICROSECOND,
            run_id=None if run == _NO_NUMBER else run_numbers[run],
            forgiven=bool(columns["forgiven"][i]),
        )


def append_packing(file: Group, packing: PackingRecord) -> None:
    """Append a packing to the group ``packings``."""
    group = file.createGroup("packings")
    state = np.frombuffer(packing.state, dtype=np.uint8)
    columns = {
        "index": ("1", "index of the packing", np.array([packing.index], dtype=np.int32)),
        "hash": ("", "hash of what it was made from", _texts([packing.hash])),
        "content_hash": ("", "hash of its own bits: disks, walls and forces", _texts([packing.content_hash])),
        "wall_stress": (
            "",
            "normal stress on each wall in Pa, as JSON",
            _texts([json.dumps(dict(packing.wall_stress))]),
        ),
        "grain_count": ("1", "number of grains", np.array([packing.radius.size], dtype=np.int64)),
        "state_byte_count": ("1", "bytes of the complete state", np.array([state.size], dtype=np.int64)),
    }
    numbers = {q.name: (q.unit, q.meaning, np.array([getattr(packing, q.name)])) for q in quantities_of(PackingRecord)}
    _append_columns(group, "packing", columns | numbers)
    grains = {
        "x": ("m", "horizontal position of the centre", packing.x),
        "y": ("m", "vertical position of the centre", packing.y),
        "radius": ("m", "radius", packing.radius),
    }
    _append_columns(group, "grain", grains)
    _append_columns(group, "state_byte", {"state": ("1", "complete state, a NumPy .npz file", state)})


def read_packings(file: Group) -> Iterator[PackingRecord]:
    """Read the group ``packings``."""
    if "packings" not in file.groups:
        return
    group = file.groups["packings"]
    columns = _read_columns(group, "packing")
    grains, states = _slice_by_counts(columns["grain_count"]), _slice_by_counts(columns["state_byte_count"])
    for i, (of_grains, of_state) in enumerate(zip(grains, states, strict=True)):
        values: dict[str, Any] = {q.name: float(columns[q.name][i]) for q in quantities_of(PackingRecord)}
        values |= _read_columns(group, "grain", of_grains)
        yield PackingRecord(
            index=int(columns["index"][i]),
            hash=str(columns["hash"][i]),
            content_hash=str(columns["content_hash"][i]) or None,
            wall_stress=json.loads(columns["wall_stress"][i]),
            state=_read_columns(group, "state_byte", of_state)["state"].tobytes(),
            **values,
        )


def append_arrays(file: Group, cells: Sequence[tuple[CellKey, Mapping[str, Any]]], groups: Collection[str]) -> None:
    """Append the arrays of some cells, records by name, those whose group is wanted."""
    for name in groups:
        found = [(key, arrays[name]) for key, arrays in cells if name in arrays]
        if found:
            _append_records(file.createGroup(name), ARRAY_RECORDS[name], found)


def _append_records(group: Group, kind: type[Any], records: Sequence[tuple[CellKey, Any]]) -> None:
    """Append records with arrays: their numbers along ``cell``, their arrays along the dimensions of these."""
    columns: dict[str, _Column] = {
        "seed": ("1", "seed of the cell", np.array([key.seed for key, _ in records], dtype=np.int64)),
        "content": ("percent", "calcite content of the cell", np.array([key.content for key, _ in records])),
    }
    columns |= {
        quantity.name: (quantity.unit, quantity.meaning, np.array([getattr(r, quantity.name) for _, r in records]))
        for quantity in quantities_of(kind)
    }
    of_dimensions: defaultdict[str, dict[str, _Column]] = defaultdict(dict)
    for name, along in array_fields(kind).items():
        arrays = [getattr(record, name) for _, record in records]
        if along.columns:
            arrays = [array.ravel() for array in arrays]
        counts = np.array([len(array) for array in arrays], dtype=np.int64)
        columns[f"{along.elements}{_COUNT}"] = ("1", f"number of elements of {along.elements}", counts)
        of_dimensions[along.elements][name] = (along.unit, along.meaning, np.concatenate(arrays))
    _append_columns(group, "cell", columns)
    for dimension, of_elements in of_dimensions.items():
        _append_columns(group, dimension, of_elements)


class CellArrays:
    """Random access to the arrays of one group of a file by cell."""

    def __init__(self, file: Group, name: str) -> None:
        """Look up the cells of a group.

        Parameters
        ----------
        file : netCDF4.Dataset
        name : str
            Of `ARRAY_RECORDS`; a file without that group has no such arrays.
        """
        self._group = file.groups.get(name)
        self._kind = ARRAY_RECORDS[name]
        self._ends: dict[str, NDArray[np.int64]] = {}
        self._row: dict[tuple[int, float], int] = {}
        self._block = range(0)
        self._cells: dict[str, NDArray[Any]] = {}
        self._arrays: dict[str, dict[str, NDArray[Any]]] = {}
        if self._group is not None:
            self._cells = _read_columns(self._group, "cell")
            dimensions = {along.elements for along in array_fields(self._kind).values()}
            self._ends = {d: np.concatenate(([0], np.cumsum(self._cells[f"{d}{_COUNT}"]))) for d in dimensions}
            keys = zip(self._cells["seed"].tolist(), self._cells["content"].tolist(), strict=True)
            self._row = {key: row for row, key in enumerate(keys)}

    def get(self, key: CellKey) -> Any:  # noqa: ANN401 - an object of the group's class
        """Return the record of a cell, None if it has none."""
        row = self._row.get((key.seed, key.content))
        if row is None:
            return None
        if row not in self._block:
            self._read_block(row)
        values: dict[str, Any] = {q.name: self._cells[q.name][row].item() for q in quantities_of(self._kind)}
        for dimension, ends in self._ends.items():
            first, end = ends[[row, row + 1]] - ends[self._block.start]
            values |= {name: array[first:end] for name, array in self._arrays[dimension].items()}
        for name, along in array_fields(self._kind).items():
            if along.columns:
                values[name] = values[name].reshape(-1, self._cells[f"{along.columns}{_COUNT}"][row])
        return self._kind(**values)

    def _read_block(self, row: int) -> None:
        """Read a cell together with those after it, since a file is mostly read in its order."""
        self._block = range(row, min(row + _CELLS_READ_AT_ONCE, len(self._row)))
        self._arrays = {
            dimension: _read_columns(self._group, dimension, slice(ends[row], ends[self._block.stop]))
            for dimension, ends in self._ends.items()
        }
