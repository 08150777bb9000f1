"""A campaign as one NetCDF-4 file, and the campaign that such a file rebuilds in a store.

The annotations of the records define the variables. Columns are appended block by block to save memory. Arrays of
different lengths are concatenated along a dimension, with a count of the elements of each (contiguous ragged arrays, CF
conventions, section 9.3.3). If the rows of an array also differ in length, its rows are concatenated.
"""

import json
import math
import os
import shutil
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calcidem.ends import CellStatus
from calcidem.input_file import MOST_BYTES
from calcidem.storage.dataset import INDEX_NAMES, LAYOUT, as_matrices, campaign_attributes
from calcidem.storage.errors import (
    DamagedStoreError,
    DiskError,
    ForeignDatabaseError,
    OtherSchemaError,
    OutputRefusedError,
    StoreUnavailableError,
    UnknownCampaignError,
)
from calcidem.storage.files import beginning, write_atomically
from calcidem.storage.netcdf_trial import refuse_unreadable
from calcidem.storage.records import (
    ARRAY_RECORDS,
    NOT_PLANNED,
    QUANTITY_BY_NAME,
    STATUS_CODES,
    AttemptRecord,
    CampaignRecord,
    CellKey,
    CellResult,
    PackingRecord,
    RunRecord,
    Selection,
)
from calcidem.storage.sql.reading import chunks
from calcidem.storage.sql.store import Store

# HDF5 asks at its start, which is this import, whether it has to lock files. Some cluster file systems have no locks,
# and these files need none: they are complete before they get their name.
_asked = os.environ.get("HDF5_USE_FILE_LOCKING")
os.environ.setdefault("HDF5_USE_FILE_LOCKING", "FALSE")
import netCDF4  # noqa: E402

if _asked is None:
    del os.environ["HDF5_USE_FILE_LOCKING"]  # for other libraries

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
    ``attempts`` and those of `ARRAY_RECORDS` hold the rest. A cell takes about 30 kB, without any arrays 1 kB;
    ``without`` names groups of arrays to leave out.

    `ValueError` for another group; `UnknownCampaignError` if no cell is planned; `OutputRefusedError` if the file is a
    database, or the NetCDF file of another campaign; `DiskError` if it can't be written.
    """
    unknown = sorted(set(without) - set(ARRAY_RECORDS))
    if unknown:
        raise ValueError(f"without = {unknown[0]!r}: choose among {', '.join(ARRAY_RECORDS)}")
    wanted = [group for group in ARRAY_RECORDS if group not in without]
    record = store.use_campaign(store.record.name)  # with the present plan
    with (
        _replace_netcdf(path, store.record.hash) as temporary,
        netCDF4.Dataset(temporary, "w", format="NETCDF4") as file,
    ):
        for index in store.packing_indices():
            packing = store.packing(index)
            stress = np.array([json.dumps(dict(packing.wall_stress))], dtype=object)
            own: dict[str, _Column] = {"wall_stress": ("", "normal stress on each wall in Pa, as JSON", stress)}
            _append_records(file.createGroup("packings"), "packing", PackingRecord, [packing], own)
        _write_cells(file, store, wanted)
        # After the cells, since a run may go on meanwhile: each has its attempt then, and each attempt its run.
        for attempts in chunks(store.history(Selection(record.seeds, record.contents)), 10_000):
            recorded = np.array([round(attempt.recorded.timestamp() * 1e6) for attempt in attempts], dtype=np.int64)
            forgiven = np.array([attempt.forgiven for attempt in attempts], dtype=np.int8)
            own = _key_columns([attempt.key for attempt in attempts]) | {
                "recorded": ("microseconds since 1970-01-01T00:00:00Z", "time of storing", recorded),
                "forgiven": ("1", "1 if a retry came after it", forgiven),
            }
            _append_records(file.createGroup("attempts"), "attempt", AttemptRecord, attempts, own)
        file.setncatts(campaign_attributes(store))
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
        return beginning(Path(path)).startswith(b"\x89HDF")


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
            if free < 1e8:  # bytes
                cure = "Free some space or write to another disk"
            elif isinstance(error, PermissionError) and temporary.exists():  # netCDF4 was imported before calcidem
                cure = "Its file system has no locks: set HDF5_USE_FILE_LOCKING=FALSE before Python starts"
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
    rows = max(1, 10_000 // contents.size)  # cells whose numbers are in memory at a time
    _create_variables(file, seeds, contents, min(rows, seeds.size))
    for first in range(0, seeds.size, rows):
        block = seeds[first : first + rows]
        selection = Selection(block.tolist(), contents.tolist())
        names = [name for name in QUANTITY_BY_NAME if name not in INDEX_NAMES]
        matrices = as_matrices(store.table(tuple(QUANTITY_BY_NAME), selection), names, block, contents)
        for found in chunks(store.results(selection, with_arrays=wanted) if wanted else (), 1000):  # cells in memory
            for name in wanted:
                kept = [cell for cell in found if getattr(cell, name) is not None]
                if kept:
                    own = _key_columns([cell.key for cell in kept])
                    records = [getattr(cell, name) for cell in kept]
                    _append_records(file.createGroup(name), "cell", ARRAY_RECORDS[name], records, own)
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


_VALUE_NAMES = tuple(name for name, q in QUANTITY_BY_NAME.items() if q.formula is None and name not in INDEX_NAMES)
_WITHOUT_OUTCOME = tuple(STATUS_CODES[name] for name in (CellStatus.PENDING, NOT_PLANNED))
_CURE_OF_CHANGE = "The file was changed after it was exported: export it again. Nothing was written."


def import_netcdf(
    path: str | os.PathLike[str],
    store: Store,
    check: Callable[[PackingRecord], object] = lambda _: None,
) -> CampaignRecord:
    """Rebuild the campaign of an exported file: plan, runs, packings, attempts, outcomes and their arrays.

    If the store already has the campaign, missing data are added and done cells are kept; runs are added each time, and
    attempts that a cell does not have are counted after its own. Everything is one transaction. ``check`` refuses a
    packing whose state does not fit.

    `InputFileError` if it is no regular file; `StoreUnavailableError` if it is not NetCDF; `ForeignDatabaseError` if
    calcidem did not write it; `OtherSchemaError` if it has another layout; `DamagedStoreError` if its configuration was
    changed, it lacks a packing, or can't be read to its end; `CampaignMismatchError` if the store has another campaign
    of that name, or another packing; `LeaseHeldError` while a run writes the database.
    """
    with _open(Path(path)) as file, store.together():
        campaign = CampaignRecord(
            hash=file.calcidem_campaign_hash,
            name=file.calcidem_campaign_name,
            config=file.calcidem_config,
            contents=(),
            seeds=(),
            created=datetime.fromisoformat(file.calcidem_created),
        )
        if campaign.checksum != file.calcidem_checksum:
            raise DamagedStoreError(
                f"{path}: its configuration, or the hash {campaign.hash} of its cells, is not what was exported.",
                _CURE_OF_CHANGE,
            )
        records = _Records(file, "packings", "packing", PackingRecord)
        packings = []
        for row, stress in enumerate(records.columns.get("wall_stress", ())):
            values = records.values(row)
            state = values["state"].tobytes()
            packings.append(PackingRecord(wall_stress=json.loads(stress), **(values | {"state": state})))
            check(packings[-1])
        status: NDArray[np.int8] = _read(file["status"]).astype(np.int8)
        named = _read(file["packing_index"])[~np.isin(status, _WITHOUT_OUTCOME)].tolist()
        if lacking := set(named) - {packing.index for packing in packings}:
            raise DamagedStoreError(
                f"{path}: packing {min(lacking)}, on which cells were computed, is missing.", _CURE_OF_CHANGE
            )
        name = store.begin_campaign(campaign).name
        for packing in packings:
            store.save_packing(packing)
        seeds, contents = file["seed"][:].tolist(), file["content"][:].tolist()
        planned = np.argwhere(status != STATUS_CODES[NOT_PLANNED]).tolist()
        store.plan(CellKey(seeds[i], contents[j]) for i, j in planned)
        run_numbers = {}
        for run in json.loads(file.calcidem_runs):
            number = run.pop("number")
            moments = {name: run[name] and datetime.fromisoformat(run[name]) for name in ("started", "ended")}
            known = {name: value for name, value in (run | moments).items() if name in RunRecord.__slots__}
            run_numbers[number] = store.begin_run(RunRecord(**known))  # earlier files describe the workers, too
        numbers = _restore_attempts(store, list(_read_attempts(file, run_numbers)))
        results = _results(file, status)
        store.record_results(
            replace(cell, attempt=numbers.get((cell.key, cell.attempt), cell.attempt)) for cell in results
        )
        return store.use_campaign(name)


def _restore_attempts(store: Store, attempts: Sequence[AttemptRecord]) -> dict[tuple[CellKey, int], int]:
    """Store attempts after those that their cells have; return the numbers of attempts at cells that have some."""
    counts = store.attempt_counts({attempt.key for attempt in attempts})
    last = {key: count.attempts for key, count in counts.items() if count.attempts}
    tried = Selection({key.seed for key in last}, {key.content for key in last})
    known = {(own.key, own.identity): own.number for own in (store.history(tried) if last else ())}
    numbers = {}
    for attempt in attempts:
        if attempt.key in last:
            number = known.get((attempt.key, attempt.identity), last[attempt.key] + 1)
            last[attempt.key] = max(last[attempt.key], number)
            numbers[attempt.key, attempt.number] = number
    store.restore_attempts(replace(one, number=numbers.get((one.key, one.number), one.number)) for one in attempts)
    return numbers


def _open(path: Path) -> Group:
    refuse_unreadable(path)
    try:
        file = netCDF4.Dataset(path, "r")
    except OSError as error:
        raise StoreUnavailableError(f"{path} can't be read as NetCDF ({error}).", "Check the name.") from error
    file.set_auto_mask(False)
    layout = getattr(file, "calcidem_layout", None)
    if layout == LAYOUT:
        return file
    is_own = layout is not None or hasattr(file, "calcidem_format")  # the mark before 1.0
    file.close()
    if not is_own:
        raise ForeignDatabaseError(f"{path} was not written by calcidem.", "Give a file made by 'calcidem export'.")
    raise OtherSchemaError(
        f"{path} was exported by another version of calcidem, whose files this one does not read (layout {layout}, not "
        f"{LAYOUT}).",
        "Use that version, or compute the campaign again.",
    )


def _results(file: Group, status: NDArray[np.int8]) -> Iterator[CellResult]:
    """Outcomes of the file, a block of seeds in memory at a time."""
    arrays = {name: _Records(file, name, "cell", kind) for name, kind in ARRAY_RECORDS.items()}
    seeds, contents = file["seed"][:].tolist(), file["content"][:].tolist()
    for start in range(0, len(seeds), 500):  # seeds in memory
        rows = slice(start, start + 500)
        columns = {
            # A file of an earlier version may lack quantities.
            name: QUANTITY_BY_NAME[name].as_values(_read(file[name], rows))
            for name in _VALUE_NAMES
            if name in file.variables
        }
        for i, j in np.argwhere(~np.isin(status[rows], _WITHOUT_OUTCOME)).tolist():
            key = CellKey(seeds[start + i], contents[j])
            values: dict[str, Any] = dict.fromkeys(_VALUE_NAMES)
            values |= {name: column[i, j] for name, column in columns.items()}
            yield CellResult.from_values(key, values | {name: found.of_cell(key) for name, found in arrays.items()})


def _read_attempts(file: Group, run_numbers: dict[int, int]) -> Iterator[AttemptRecord]:
    """Read the group ``attempts``; ``run_numbers`` maps numbers of runs in the file to those in the store."""
    records = _Records(file, "attempts", "attempt", AttemptRecord)
    for row, key in enumerate(records.keys()):
        values = records.values(row)
        if values["outcome"] == CellStatus.RUNNING:
            continue  # in a copy nobody will end it, which would count as the death of a run
        values["run_id"] = None if values["run_id"] is None else run_numbers[values["run_id"]]
        recorded = datetime.fromtimestamp(records.columns["recorded"][row] / 1e6, UTC)
        yield AttemptRecord(key, recorded=recorded, forgiven=bool(records.columns["forgiven"][row]), **values)


class _Records:
    """Random access to the records of a group, whose arrays are read block by block.

    Attributes
    ----------
    columns : dict of str to array
        Columns along the dimension of the records; empty in a file without that group.
    """

    def __init__(self, file: Group, name: str, dimension: str, kind: type[Any]) -> None:
        self._group, self._kind = file.groups.get(name), kind
        self.columns = {} if self._group is None else self._read(dimension, slice(None))
        self._block = range(0)
        self._arrays: dict[str, dict[str, NDArray[Any]]] = {}
        self._ends: dict[str, NDArray[np.int64]] = {}
        self._values: dict[str, NDArray[np.object_]] = {}
        if self.columns:
            elements = {along.elements for along in kind.arrays().values()}
            self._ends = {e: np.concatenate(([0], np.cumsum(self.columns[f"{e}_count"]))) for e in elements}
            columns = ((q, self.columns[q.name.removesuffix("_id")]) for q in kind.quantities())
            self._values = {quantity.name: quantity.as_values(column) for quantity, column in columns}

    @cached_property
    def _row(self) -> dict[CellKey, int]:
        return {key: row for row, key in enumerate(self.keys())}

    def of_cell(self, key: CellKey) -> Any:  # noqa: ANN401 - an object of the group's class
        """Return the record of a cell, None if it has none."""
        row = self._row.get(key)
        return None if row is None else self._kind(**self.values(row))

    def keys(self) -> list[CellKey]:
        """Return the cells of the records."""
        columns = (self.columns[name].tolist() if self.columns else () for name in ("seed", "content"))
        return list(map(CellKey, *columns))

    def values(self, row: int) -> dict[str, Any]:
        """Return quantities and arrays of a record by name."""
        if row not in self._block:  # read together with the following ones, since a file is mostly read in order
            count = len(next(iter(self.columns.values())))
            self._block = range(row, min(row + 500, count))
            blocks = {e: slice(ends[row], ends[self._block.stop]) for e, ends in self._ends.items()}
            self._arrays = {elements: self._read(elements, block) for elements, block in blocks.items()}
        values: dict[str, Any] = {name: column[row] for name, column in self._values.items()}
        for name, along in self._kind.arrays().items():
            first, end = self._ends[along.elements][[row, row + 1]] - self._ends[along.elements][self._block.start]
            values[name] = self._arrays[along.elements][name][first:end]
            if along.columns:
                values[name] = values[name].reshape(-1, self.columns[f"{along.columns}_count"][row])
        return values

    def _read(self, dimension: str, rows: slice) -> dict[str, NDArray[Any]]:
        """Read some rows of all columns along a dimension."""
        variables = self._group.variables.items()
        return {name: _read(variable, rows) for name, variable in variables if variable.dimensions[0] == dimension}


def _read(variable: Any, rows: slice = slice(None)) -> NDArray[Any]:  # noqa: ANN401 - the library has no types
    """Read some rows of a variable; `ValueError` if they take more than `MOST_BYTES`."""
    count, *others = variable.shape
    size = len(range(*rows.indices(count))) * math.prod(others) * getattr(variable.dtype, "itemsize", 8)
    if size > MOST_BYTES:
        raise ValueError(f"{variable.name} would take {size / 1e9:.3g} GB of memory at a time")
    return np.asarray(variable[rows])
