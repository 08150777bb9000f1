"""Groups ``paths``, ``signals`` and ``cement`` of an exported file: arrays of single cells."""

from collections.abc import Callable, Collection, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from calcidem.storage.netcdf.groups import Column, Group, append, read_columns
from calcidem.storage.records import CellKey, CellResult, CementPattern, Signal

T = TypeVar("T")

BLOCK = 500
"""Cells whose arrays are in memory at a time."""


SAMPLE_GROUPS = ("paths", "signals", "cement")
"""Groups of arrays of single cells, which make up nearly all of a file."""


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
    append(group, "cell", _keys(paths) | _count("grain", [len(path) for _, path in paths]))
    grains = np.concatenate([np.array(path, dtype=np.int32) for _, path in paths])
    append(group, "grain", {"grain": ("1", "index of a grain along the preferential path", grains)})


def _append_signals(file: Group, signals: Sequence[tuple[CellKey, Signal]]) -> None:
    if not signals:
        return
    group = file.createGroup("signals")
    steps = np.array([signal.time_step for _, signal in signals])
    columns = _keys(signals) | _count("sample", [signal.sent_velocity.size for _, signal in signals])
    append(group, "cell", columns | {"time_step": ("s", "interval between samples", steps)})
    series = {
        "sent_velocity": ("m s-1", "velocity of the transmitter"),
        "received_force": ("N m-1", "shear force on the receiver for a metre of thickness"),
        "received_velocity": ("m s-1", "mean velocity of the grains at the receiver"),
    }
    samples = {
        name: (unit, meaning, np.concatenate([getattr(signal, name) for _, signal in signals]))
        for name, (unit, meaning) in series.items()
    }
    append(group, "sample", samples)


def _append_cement(file: Group, patterns: Sequence[tuple[CellKey, CementPattern]]) -> None:
    if not patterns:
        return
    group = file.createGroup("cement")
    columns = _keys(patterns) | _count("contact", [len(pattern.contacts) for _, pattern in patterns])
    append(group, "cell", columns | _count("cluster", [len(pattern.cluster_centres) for _, pattern in patterns]))
    contacts = np.concatenate([pattern.contacts for _, pattern in patterns])
    kinds = np.concatenate([pattern.kind for _, pattern in patterns])
    of_contacts = {
        "first": ("1", "index of one grain of a bonded contact", contacts[:, 0]),
        "second": ("1", "index of the other grain", contacts[:, 1]),
        "kind": ("1", "1 for a P contact, 2 for one in a C cluster", kinds),
    }
    append(group, "contact", of_contacts)
    centres = np.concatenate([pattern.cluster_centres for _, pattern in patterns])
    of_clusters = {
        "x": ("m", "horizontal position of the centre of a C cluster", centres[:, 0]),
        "y": ("m", "vertical position of the centre of a C cluster", centres[:, 1]),
    }
    append(group, "cluster", of_clusters)


def _keys(items: Sequence[tuple[CellKey, Any]]) -> dict[str, Column]:
    return {
        "seed": ("1", "seed of the cell", np.array([key.seed for key, _ in items], dtype=np.int64)),
        "content": ("percent", "calcite content of the cell", np.array([key.content for key, _ in items])),
    }


def _count(dimension: str, counts: list[int]) -> dict[str, Column]:
    return {f"{dimension}_count": ("1", f"number of elements of {dimension}", np.array(counts, dtype=np.int64))}


class CellArrays(Generic[T]):
    """Random access to the arrays of one group by cell.

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

    def __init__(
        self,
        file: Group,
        name: str,
        dimensions: tuple[str, ...],
        build: Callable[[dict[str, Any], dict[str, NDArray[Any]]], T],
    ) -> None:
        self._group = file.groups.get(name)
        self._build = build
        self._ends: dict[str, NDArray[np.int64]] = {}
        self._row: dict[tuple[int, float], int] = {}
        self._block = range(0)
        self._arrays: dict[str, dict[str, NDArray[Any]]] = {}
        if self._group is not None:
            self._cells = read_columns(self._group, "cell")
            self._ends = {name: np.concatenate(([0], np.cumsum(self._cells[f"{name}_count"]))) for name in dimensions}
            keys = zip(self._cells["seed"].tolist(), self._cells["content"].tolist(), strict=True)
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
        return self._build({name: column[row] for name, column in self._cells.items()}, arrays)

    def _read_block(self, row: int) -> None:
        """Read a cell together with those after it, since a file is mostly read in its order."""
        self._block = range(row, min(row + BLOCK, len(self._row)))
        self._arrays = {
            dimension: read_columns(self._group, dimension, slice(ends[row], ends[self._block.stop]))
            for dimension, ends in self._ends.items()
        }


def path_reader(file: Group) -> CellArrays[tuple[int, ...]]:
    """Access the paths of a file."""
    return CellArrays(file, "paths", ("grain",), lambda _, arrays: tuple(arrays["grain"].tolist()))


def signal_reader(file: Group) -> CellArrays[Signal]:
    """Access the signals of a file."""
    return CellArrays(file, "signals", ("sample",), lambda cell, arrays: Signal(float(cell["time_step"]), **arrays))


def cement_reader(file: Group) -> CellArrays[CementPattern]:
    """Access the cement patterns of a file."""

    def build(_: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> CementPattern:
        contacts = np.column_stack((arrays["first"], arrays["second"]))
        return CementPattern(contacts, arrays["kind"], np.column_stack((arrays["x"], arrays["y"])))

    return CellArrays(file, "cement", ("contact", "cluster"), build)
