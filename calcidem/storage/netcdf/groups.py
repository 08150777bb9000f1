"""Groups of an exported file: attempts and packings, and the paths, signals and cement patterns of single cells.

Columns are appended block by block to keep memory small. Arrays of different lengths lie one after the other along a
dimension, and a count for each of them tells how many elements are whose (the contiguous ragged arrays of the CF
conventions, section 9.3.3).
"""

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from calcidem.storage.records import AttemptRecord, CellKey, CellResult, CementPattern, PackingRecord, Signal

T = TypeVar("T")

Group = Any
"""A netCDF4.Dataset or netCDF4.Group; that library has no types."""

_Column = tuple[str, str, NDArray[Any]]
"""Unit ("" for texts), long name and values of a variable."""

_COUNT = "_count"

_COMPRESSED = {"compression": "zlib", "complevel": 1, "shuffle": True, "fletcher32": True}
_CHUNK = 8192  # elements, about two cells' contacts; the library's own are so small that each costs more than its bytes

SAMPLE_GROUPS = ("paths", "signals", "cement")
"""Groups of arrays of single cells, which make up nearly all of a file."""

_CELLS_READ_AT_ONCE = 500
"""Cells whose arrays are in memory at a time."""

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
_NO_NUMBER = -1  # stands for None in whole-number columns, all of whose real values are 0 or more

_PACKING_NUMBERS = {
    "width": ("m", "width of the box"),
    "height": ("m", "height of the lid"),
    "porosity": ("1", "area of the voids over area of the box"),
    "coordination_number": ("1", "mean number of contacts of a grain"),
    "coordination_number_without_rattlers": ("1", "mean number of contacts of a grain that carries load"),
    "mean_relative_overlap": ("1", "mean overlap over mean diameter"),
    "largest_relative_overlap": ("1", "largest overlap over mean diameter"),
    "unbalanced_ratio": ("1", "mean unbalanced force over mean contact force"),
    "seconds": ("s", "computing time"),
}


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
            options = {} if is_text else _COMPRESSED | {"chunksizes": (min(max(1, len(values)), _CHUNK),)}
            variable = group.createVariable(name, str if is_text else values.dtype, (dimension,), **options)
            variable.long_name = long_name
            if unit:
                variable.units = unit
            if name.endswith(_COUNT):
                variable.sample_dimension = name.removesuffix(_COUNT)
        group.variables[name][start : start + len(values)] = values


def _read_columns(group: Group, dimension: str, rows: slice = slice(None)) -> dict[str, NDArray[Any]]:
    """Read all columns along a dimension, or some of their rows."""
    return {
        name: np.asarray(variable[rows])
        for name, variable in group.variables.items()
        if variable.dimensions == (dimension,)
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


def _optional_texts(values: NDArray[Any]) -> list[str | None]:
    """Inverse of `_texts`."""
    return [value or None for value in values.tolist()]


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
    hosts = _optional_texts(columns["host"])
    for i, host in enumerate(hosts):
        run, rank, seconds = int(columns["run"][i]), int(columns["rank"][i]), float(columns["seconds"][i])
        yield AttemptRecord(
            key=CellKey(int(columns["seed"][i]), float(columns["content"][i])),
            number=int(columns["number"][i]),
            outcome=str(columns["outcome"][i]),
            reason=str(columns["reason"][i]),
            rank=None if rank == _NO_NUMBER else rank,
            host=host,
            seconds=None if np.isnan(seconds) else seconds,
            recorded=_EPOCH + int(columns["recorded"][i]) * _MICROSECOND,
            run_id=None if run == _NO_NUMBER else run_numbers[run],
            forgiven=bool(columns["forgiven"][i]),
        )


def append_packing(file: Group, packing: PackingRecord | None) -> None:
    """Append a packing, if there is one, to the group ``packings``."""
    if packing is None:
        return
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
    numbers = {
        name: (unit, meaning, np.array([getattr(packing, name)])) for name, (unit, meaning) in _PACKING_NUMBERS.items()
    }
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
        values: dict[str, Any] = {name: float(columns[name][i]) for name in _PACKING_NUMBERS}
        values |= _read_columns(group, "grain", of_grains)
        yield PackingRecord(
            index=int(columns["index"][i]),
            hash=str(columns["hash"][i]),
            content_hash=str(columns["content_hash"][i]) or None,
            wall_stress=json.loads(columns["wall_stress"][i]),
            state=_read_columns(group, "state_byte", of_state)["state"].tobytes(),
            **values,
        )


def append_samples(file: Group, results: Sequence[CellResult], groups: Collection[str] = SAMPLE_GROUPS) -> None:
    """Append the paths, signals and cement patterns of some cells, those that have them and whose group is wanted."""
    if "paths" in groups:
        _append_paths(file, [(r.key, r.features.path) for r in results if r.features is not None])
    if "signals" in groups:
        _append_signals(file, [(r.key, r.signal) for r in results if r.signal is not None])
    if "cement" in groups:
        _append_cement(file, [(r.key, r.cement) for r in results if r.cement is not None])


def _append_paths(file: Group, paths: Sequence[tuple[CellKey, tuple[int, ...]]]) -> None:
    if not paths:
        return
    group = file.createGroup("paths")
    _append_columns(group, "cell", _key_columns(paths) | _count_column("grain", [len(path) for _, path in paths]))
    grains = np.concatenate([np.array(path, dtype=np.int32) for _, path in paths])
    _append_columns(group, "grain", {"grain": ("1", "index of a grain along the preferential path", grains)})


def _append_signals(file: Group, signals: Sequence[tuple[CellKey, Signal]]) -> None:
    if not signals:
        return
    group = file.createGroup("signals")
    times = {
        "sampling_interval": ("s", "time between two samples"),
        "start_time": ("s", "time of the first sample after the pulse began"),
    }
    columns = _key_columns(signals) | _count_column("sample", [signal.sent_velocity.size for _, signal in signals])
    columns |= {
        name: (unit, meaning, np.array([getattr(signal, name) for _, signal in signals]))
        for name, (unit, meaning) in times.items()
    }
    _append_columns(group, "cell", columns)
    series = {
        "sent_velocity": ("m s-1", "velocity of the transmitter"),
        "received_force": ("N m-1", "shear force on the receiver for a metre of thickness"),
        "received_velocity": ("m s-1", "mean velocity of the grains at the receiver"),
    }
    samples = {
        name: (unit, meaning, np.concatenate([getattr(signal, name) for _, signal in signals]))
        for name, (unit, meaning) in series.items()
    }
    _append_columns(group, "sample", samples)


def _append_cement(file: Group, patterns: Sequence[tuple[CellKey, CementPattern]]) -> None:
    if not patterns:
        return
    group = file.createGroup("cement")
    columns = _key_columns(patterns) | _count_column("contact", [len(pattern.contacts) for _, pattern in patterns])
    _append_columns(
        group, "cell", columns | _count_column("cluster", [len(pattern.cluster_centres) for _, pattern in patterns])
    )
    contacts = np.concatenate([pattern.contacts for _, pattern in patterns])
    kinds = np.concatenate([pattern.kind for _, pattern in patterns])
    of_contacts = {
        "first": ("1", "index of one grain of a bonded contact", contacts[:, 0]),
        "second": ("1", "index of the other grain", contacts[:, 1]),
        "kind": ("1", "1 for a P contact, 2 for one in a C cluster", kinds),
    }
    _append_columns(group, "contact", of_contacts)
    centres = np.concatenate([pattern.cluster_centres for _, pattern in patterns])
    of_clusters = {
        "x": ("m", "horizontal position of the centre of a C cluster", centres[:, 0]),
        "y": ("m", "vertical position of the centre of a C cluster", centres[:, 1]),
    }
    _append_columns(group, "cluster", of_clusters)


def _key_columns(items: Sequence[tuple[CellKey, Any]]) -> dict[str, _Column]:
    return {
        "seed": ("1", "seed of the cell", np.array([key.seed for key, _ in items], dtype=np.int64)),
        "content": ("percent", "calcite content of the cell", np.array([key.content for key, _ in items])),
    }


def _count_column(dimension: str, counts: list[int]) -> dict[str, _Column]:
    return {f"{dimension}_count": ("1", f"number of elements of {dimension}", np.array(counts, dtype=np.int64))}


class CellArrays(Generic[T]):
    """Random access to the arrays of one group by cell.

    Attributes
    ----------
    cells : dict of str to (n,) array
        Columns with one value for each of the cells that have arrays; empty if the file has no such group.
    """

    def __init__(
        self,
        file: Group,
        name: str,
        dimensions: tuple[str, ...],
        build: Callable[[dict[str, Any], dict[str, NDArray[Any]]], T],
    ) -> None:
        """Look up the cells of a group.

        Parameters
        ----------
        file : netCDF4.Dataset
        name : str
            Name of the group; a file without it has no such arrays.
        dimensions : tuple of str
            Its ragged dimensions.
        build : callable
            Makes the record from the cell's own columns and those of each dimension.
        """
        self._group = file.groups.get(name)
        self._build = build
        self._ends: dict[str, NDArray[np.int64]] = {}
        self._row: dict[tuple[int, float], int] = {}
        self._block = range(0)
        self.cells: dict[str, NDArray[Any]] = {}
        self._arrays: dict[str, dict[str, NDArray[Any]]] = {}
        if self._group is not None:
            self.cells = _read_columns(self._group, "cell")
            self._ends = {name: np.concatenate(([0], np.cumsum(self.cells[f"{name}_count"]))) for name in dimensions}
            keys = zip(self.cells["seed"].tolist(), self.cells["content"].tolist(), strict=True)
            self._row = {key: row for row, key in enumerate(keys)}

    def get(self, key: CellKey) -> T | None:
        """Return the record of a cell, None if it has none."""
        row = self._row.get((key.seed, key.content))
        if row is None:
            return None
        if row not in self._block:
            self._read_block(row)
        arrays: dict[str, NDArray[Any]] = {}
        for dimension, ends in self._ends.items():
            first, end = ends[[row, row + 1]] - ends[self._block.start]
            arrays |= {name: values[first:end] for name, values in self._arrays[dimension].items()}
        return self._build({name: column[row] for name, column in self.cells.items()}, arrays)

    def _read_block(self, row: int) -> None:
        """Read a cell together with those after it, since a file is mostly read in its order."""
        self._block = range(row, min(row + _CELLS_READ_AT_ONCE, len(self._row)))
        self._arrays = {
            dimension: _read_columns(self._group, dimension, slice(ends[row], ends[self._block.stop]))
            for dimension, ends in self._ends.items()
        }


def open_paths(file: Group) -> CellArrays[tuple[int, ...]]:
    """Access the paths of a file."""
    return CellArrays(file, "paths", ("grain",), lambda _, arrays: tuple(arrays["grain"].tolist()))


def open_signals(file: Group) -> CellArrays[Signal]:
    """Access the signals of a file."""

    def build(cell: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Signal:
        return Signal(float(cell["sampling_interval"]), float(cell["start_time"]), **arrays)

    return CellArrays(file, "signals", ("sample",), build)


def open_cement(file: Group) -> CellArrays[CementPattern]:
    """Access the cement patterns of a file."""

    def build(_: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> CementPattern:
        contacts = np.column_stack((arrays["first"], arrays["second"]))
        return CementPattern(contacts, arrays["kind"], np.column_stack((arrays["x"], arrays["y"])))

    return CellArrays(file, "cement", ("contact", "cluster"), build)
