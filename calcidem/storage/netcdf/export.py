"""Export of a campaign to one NetCDF-4 file.

The annotations of the records define the variables. Columns are appended block by block to save memory. Arrays of
different lengths are concatenated along a dimension, with a count of the elements of each (contiguous ragged arrays, CF
conventions, section 9.3.3). If the rows of an array also differ in length, its rows are concatenated.
"""

import json
import os
import shutil
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from calcidem.input_file import open_input
from calcidem.storage.dataset import INDEX_NAMES, as_matrices, campaign_attributes
from calcidem.storage.errors import DamagedStoreError, DiskError, OutputRefusedError, UnknownCampaignError
from calcidem.storage.files import write_atomically
from calcidem.storage.netcdf.trial import refuse_unreadable
from calcidem.storage.records import (
    ARRAY_RECORDS,
    QUANTITY_BY_NAME,
    AttemptRecord,
    CellKey,
    PackingRecord,
)
from calcidem.storage.sql.reading import chunks
from calcidem.storage.sql.store import Store
from calcidem.storage.store import Selection

if TYPE_CHECKING:
    import xarray as xr  # takes half a second; callers with a dataset have loaded it already

Group = Any
"""A netCDF4.Dataset or netCDF4.Group; the library has no types."""

_Column = tuple[str, str, NDArray[Any]]
"""Unit ("" for texts), long name and values of a variable."""

_COMPRESSED = {"compression": "zlib", "complevel": 1, "shuffle": True, "fletcher32": True}


def export_netcdf(store: Store, path: str | os.PathLike[str], *, without: Collection[str] = ()) -> Path:
    """Write the store's whole campaign into one compressed NetCDF-4 file, as `write_atomically` does; return its path.

    The root group is the Dataset of `calcidem.storage.dataset.campaign_dataset`, the groups ``packings`` and
    ``attempts`` and those of `ARRAY_RECORDS` hold the rest. A cell takes about 50 kB, without any arrays 1 kB;
    ``without`` names groups of arrays to leave out.

    `ValueError` for another group; `UnknownCampaignError` if no cell is planned; `OutputRefusedError` if the file is a
    database, or the NetCDF file of another campaign; `DiskError` if it can't be written.
    """
    unknown = sorted(set(without) - set(ARRAY_RECORDS))
    if unknown:
        raise ValueError(f"without = {unknown[0]!r}: choose among {', '.join(ARRAY_RECORDS)}")
    wanted = [group for group in ARRAY_RECORDS if group not in without]
    with (
        _replace_netcdf(path, store.record.hash) as temporary,
        netCDF4.Dataset(temporary, "w", format="NETCDF4") as file,
    ):
        for index in store.packing_indices():
            _append_packing(file, store.packing(index))
        for attempts in chunks(store.history(), 10_000):
            _append_attempts(file, attempts)
        _write_cells(file, store, wanted)
    return Path(path).absolute()


def write_netcdf(dataset: "xr.Dataset", path: str | os.PathLike[str]) -> None:
    """Write a dataset computed from a campaign to a NetCDF file, as `export_netcdf` does; no export is replaced."""
    with _replace_netcdf(path, None) as temporary:
        dataset.to_netcdf(temporary)


def belongs_to_another(path: str | os.PathLike[str], campaign_hash: str | None) -> bool:
    """Whether the path has a NetCDF file that cannot be read, or of another campaign's hash (None: any, or none)."""
    if not Path(path).is_file():
        return False
    try:
        refuse_unreadable(path, names_only=True)
        with netCDF4.Dataset(path, "r") as file:
            return getattr(file, "calcidem_campaign_hash", None) != campaign_hash
    except (OSError, RuntimeError, DamagedStoreError):
        with open_input(Path(path)) as broken:
            return broken.read(4) == b"\x89HDF"


@contextmanager
def _replace_netcdf(path: str | os.PathLike[str], campaign_hash: str | None) -> Iterator[Path]:
    """Yield a temporary file for `write_atomically`, and explain HDF errors."""
    if belongs_to_another(path, campaign_hash):
        raise OutputRefusedError(
            f"{path} is a NetCDF file of another campaign, or can't be read as one.",
            "Give another file name, or remove that file; nothing was written.",
        )
    with write_atomically(path, replaces_netcdf=True) as temporary:
        try:
            yield temporary
        except (OSError, RuntimeError) as error:
            free = shutil.disk_usage(temporary.parent).free
            problem = f"{path} could not be written ({error}); its disk has {free / 1e6:.3g} MB left."
            if isinstance(error, PermissionError) and temporary.exists():  # netCDF4 was imported before calcidem
                cure = "Its file system has no locks: set HDF5_USE_FILE_LOCKING=FALSE before Python starts"
            elif free < 1e8:  # bytes
                cure = "Free some space or write to another disk"
            else:
                cure = "Check your quota and the permissions of the folder, or write to another disk"
            raise DiskError(problem, f"{cure}; the former file and the database are unchanged.") from error


def _write_cells(file: Group, store: Store, wanted: Collection[str]) -> None:
    """Write the root group and the arrays of cells, a block of seeds in memory at a time."""
    seeds, contents = (np.array(sorted(values)) for values in (store.record.seeds, store.record.contents))
    if not seeds.size or not contents.size:
        raise UnknownCampaignError(
            f"Campaign '{store.record.name}' has no cells.", "Plan some seeds and contents first."
        )
    file.setncatts(campaign_attributes(store))
    rows = max(1, 10_000 // contents.size)  # cells whose numbers are in memory at a time
    _create_variables(file, seeds, contents, min(rows, seeds.size))
    for first in range(0, seeds.size, rows):
        block = seeds[first : first + rows]
        selection = Selection(block.tolist(), contents.tolist())
        names = [name for name in QUANTITY_BY_NAME if name not in INDEX_NAMES]
        matrices = as_matrices(store.table(tuple(QUANTITY_BY_NAME), selection), names, block, contents)
        for found in chunks(store.arrays(selection) if wanted else (), 1000):  # cells with arrays in memory
            _append_arrays(file, found, wanted)
        for name, matrix in matrices.items():
            is_whole = QUANTITY_BY_NAME[name].kind == "whole"  # real with missing values
            file[name][first : first + block.size] = QUANTITY_BY_NAME[name].as_column(matrix) if is_whole else matrix


def _create_variables(file: Group, seeds: NDArray[Any], contents: NDArray[Any], rows: int) -> None:
    """Make the variables of the root group; a chunk is a block of seeds. CF allows coordinates no gaps."""
    for name, values in zip(INDEX_NAMES, (seeds, contents), strict=True):
        file.createDimension(name, values.size)
        kind: type[Any] = np.int64 if name == "seed" else np.float64
        variable = file.createVariable(name, kind, (name,), fletcher32=True, fill_value=False)
        variable.setncatts(QUANTITY_BY_NAME[name].attributes())
        variable[:] = values
    for quantity in QUANTITY_BY_NAME.values():
        if quantity.name in INDEX_NAMES:
            continue
        is_text = quantity.kind == "text" and quantity.name != "status"  # of variable length, which is not compressed
        kind = str if is_text else quantity.as_column(()).dtype.type
        fill = False if quantity.name == "status" else quantity.gap  # each cell has a status
        options = {} if is_text else _COMPRESSED | {"chunksizes": (rows, contents.size), "fill_value": fill}
        variable = file.createVariable(quantity.name, kind, INDEX_NAMES, **options)
        if not is_text:  # each block of seeds is written once, without the library's cache of 16 MB for each variable
            variable.set_var_chunk_cache(size=2 * rows * contents.size * np.dtype(kind).itemsize)
        variable.setncatts(quantity.attributes())


def _append_attempts(file: Group, attempts: Sequence[AttemptRecord]) -> None:
    """Append attempts to the group ``attempts``."""
    recorded = np.array([round(attempt.recorded.timestamp() * 1e6) for attempt in attempts], dtype=np.int64)
    own: dict[str, _Column] = {
        "recorded": ("microseconds since 1970-01-01T00:00:00Z", "time of storing", recorded),
        "forgiven": ("1", "1 if a retry came after it", np.array([a.forgiven for a in attempts], dtype=np.int8)),
    }
    keys = _key_columns([attempt.key for attempt in attempts])
    _append_records(file.createGroup("attempts"), "attempt", AttemptRecord, attempts, keys | own)


def _append_packing(file: Group, packing: PackingRecord) -> None:
    """Append a packing to the group ``packings``."""
    stress = np.array([json.dumps(dict(packing.wall_stress))], dtype=object)
    own = {"wall_stress": ("", "normal stress on each wall in Pa, as JSON", stress)}
    _append_records(file.createGroup("packings"), "packing", PackingRecord, [packing], own)


def _append_arrays(file: Group, cells: Sequence[tuple[CellKey, Mapping[str, Any]]], groups: Collection[str]) -> None:
    """Append the arrays of some cells, records by name, of the requested groups."""
    for name in groups:
        found = [(key, arrays[name]) for key, arrays in cells if name in arrays]
        if found:
            keys, records = zip(*found, strict=True)
            _append_records(file.createGroup(name), "cell", ARRAY_RECORDS[name], records, _key_columns(keys))


def _key_columns(keys: Sequence[CellKey]) -> dict[str, _Column]:
    return {
        "seed": ("1", "seed of the cell", np.array([key.seed for key in keys], dtype=np.int64)),
        "content": ("percent", "calcite content of the cell", np.array([key.content for key in keys])),
    }


def _append_records(
    group: Group, dimension: str, kind: type[Any], records: Sequence[Any], own: Mapping[str, _Column]
) -> None:
    """Append records: quantities and further columns along a dimension, arrays along theirs."""
    columns = dict(own)
    for quantity in kind.quantities():
        values = quantity.as_column([getattr(record, quantity.name) for record in records])
        columns[quantity.name.removesuffix("_id")] = (quantity.unit, quantity.meaning, values)
    of_dimensions: defaultdict[str, dict[str, _Column]] = defaultdict(dict)
    for name, along in kind.arrays().items():
        arrays = [getattr(record, name) for record in records]
        arrays = [np.frombuffer(array, np.uint8) if isinstance(array, bytes) else array for array in arrays]
        if along.columns:
            arrays = [array.ravel() for array in arrays]
        counts = np.array([len(array) for array in arrays], dtype=np.int64)
        columns[f"{along.elements}_count"] = ("1", f"number of elements of {along.elements}", counts)
        of_dimensions[along.elements][name] = (along.unit, along.meaning, np.concatenate(arrays))
    _append_columns(group, dimension, columns)
    for elements, found in of_dimensions.items():
        _append_columns(group, elements, found)


def _append_columns(group: Group, dimension: str, columns: Mapping[str, _Column]) -> None:
    """Append columns of equal length along an unlimited dimension; missing variables are created.

    A column ``<other dimension>_count`` is the number of elements of that dimension for each element of this one.
    """
    if dimension not in group.dimensions:
        group.createDimension(dimension, None)
    start = len(group.dimensions[dimension])
    for name, (unit, long_name, values) in columns.items():
        if name not in group.variables:
            is_text = values.dtype.kind == "O"
            further = []
            for length in values.shape[1:]:  # arrays with several numbers for each element
                further.append(f"of_{length}")
                if further[-1] not in group.dimensions:
                    group.createDimension(further[-1], length)
            # 8192 elements, about two cells' contacts: the small default chunks cost more than their bytes
            chunks = {"chunksizes": (min(max(1, len(values)), 8192), *values.shape[1:])}
            options = {} if is_text else _COMPRESSED | chunks
            variable = group.createVariable(name, str if is_text else values.dtype, (dimension, *further), **options)
            variable.long_name = long_name
            if unit:
                variable.units = unit
            if name.endswith("_count"):
                variable.sample_dimension = name.removesuffix("_count")
        group.variables[name][start : start + len(values)] = values
