"""Export of a campaign to one NetCDF-4 file."""

import os
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from calcidem.storage.conventions import INDEX_NAMES, campaign_attributes, quantity_attributes, values_and_gap
from calcidem.storage.errors import DamagedStoreError, DiskError, OutputRefusedError, UnknownCampaignError
from calcidem.storage.files import write_atomically
from calcidem.storage.netcdf.groups import COMPRESSED, Group, append_arrays, append_attempts, append_packing
from calcidem.storage.netcdf.trial import refuse_unreadable
from calcidem.storage.records import ARRAY_RECORDS, QUANTITY_BY_NAME, STATUS_CODES, CellStatus, Quantity
from calcidem.storage.sql.reading import chunks
from calcidem.storage.sql.store import Store
from calcidem.storage.store import Selection

if TYPE_CHECKING:
    import xarray as xr  # half a second; whoever has a dataset to write has loaded it

_CELLS_COPIED_AT_ONCE = 10_000
"""Cells whose numbers are in memory at a time."""

_ARRAYS_COPIED_AT_ONCE = 1000
"""Cells whose arrays are in memory at a time."""

_WHOLE_NUMBER_FILL = -1


def export_netcdf(store: Store, path: str | os.PathLike[str], *, without: Collection[str] = ()) -> Path:
    """Write everything the store has about its campaign into one compressed NetCDF-4 file.

    Plain ``xarray.open_dataset`` finds in it the Dataset of `calcidem.storage.dataset.campaign_dataset`; the
    groups ``packings`` and ``attempts`` and those of `ARRAY_RECORDS` hold the rest. An existing file
    is replaced in one step when the new one is complete and on disk; until then, and after any error, it
    stays as it was.

    Parameters
    ----------
    store : Store
        With a campaign chosen.
    path : str or path
    without : collection of str
        Groups of arrays to leave out, of `ARRAY_RECORDS`: with them a cell takes about 50 kB,
        without them 1 kB.

    Returns
    -------
    Path
        Of the file written.

    Raises
    ------
    ValueError
        If a group to leave out is none of these.
    UnknownCampaignError
        If no cell is planned.
    OutputRefusedError
        If a database has that name, or a NetCDF file that is not this campaign's.
    DiskError
        If the file can't be written.
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
            with suppress(DamagedStoreError):  # cells without a packing tell that it is missing
                append_packing(file, store.packing(index))
        for attempts in chunks(store.history(), _CELLS_COPIED_AT_ONCE):
            append_attempts(file, attempts)
        _write_cells(file, store, wanted)
    return Path(path).absolute()


def write_netcdf(dataset: "xr.Dataset", path: str | os.PathLike[str]) -> None:
    """Write what was computed from a campaign into a NetCDF file, as `export_netcdf` does; no export is replaced."""
    with _replace_netcdf(path, None) as temporary:
        dataset.to_netcdf(temporary)


def belongs_to_another(path: str | os.PathLike[str], campaign_hash: str | None) -> bool:
    """Whether there is a NetCDF file that can't be read, or has another campaign's hash (None: any, or none)."""
    if not Path(path).is_file():
        return False
    try:
        refuse_unreadable(path, names_only=True)
        with netCDF4.Dataset(path, "r") as file:
            return getattr(file, "calcidem_campaign_hash", None) != campaign_hash
    except (OSError, RuntimeError, DamagedStoreError):
        with Path(path).open("rb") as broken:
            return broken.read(4) == b"\x89HDF"


@contextmanager
def _replace_netcdf(path: str | os.PathLike[str], campaign_hash: str | None) -> Iterator[Path]:
    """Give a temporary file for `write_atomically`, and say in plain words what the library calls an HDF error."""
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
            cure = "Free some space or write to another disk; what was there is as it was, and so is the database."
            raise DiskError(problem, cure) from error


def _write_cells(file: Group, store: Store, wanted: Collection[str]) -> None:
    """Write the root group and the arrays of cells, a block of seeds in memory at a time."""
    seeds, contents = (np.array(sorted(values)) for values in (store.record.seeds, store.record.contents))
    if not seeds.size or not contents.size:
        raise UnknownCampaignError(
            f"Campaign '{store.record.name}' has no cells.", "Plan some seeds and contents first."
        )
    file.setncatts(campaign_attributes(store))
    rows = max(1, _CELLS_COPIED_AT_ONCE // contents.size)
    _create_variables(file, seeds, contents, min(rows, seeds.size))
    for first in range(0, seeds.size, rows):
        block = seeds[first : first + rows]
        selection = Selection(block.tolist(), contents.tolist())
        columns = store.table(tuple(QUANTITY_BY_NAME), selection)
        place = np.searchsorted(block, columns["seed"]), np.searchsorted(contents, columns["content"])
        matrices = {
            name: _matrix(name, columns[name], place, (block.size, contents.size))
            for name in QUANTITY_BY_NAME
            if name not in INDEX_NAMES
        }
        for found in chunks(store.arrays(selection) if wanted else (), _ARRAYS_COPIED_AT_ONCE):
            whole = []
            for key, arrays in found:
                cell = int(np.searchsorted(block, key.seed)), int(np.searchsorted(contents, key.content))
                if isinstance(arrays, str):  # the numbers beside damaged arrays are missing, too
                    _mark_damaged(matrices, cell, arrays)
                elif matrices["status"][cell] != STATUS_CODES[CellStatus.DAMAGED]:
                    whole.append((key, arrays))
            append_arrays(file, whole, wanted)
        for name, matrix in matrices.items():
            file[name][first : first + block.size] = matrix


def _create_variables(file: Group, seeds: NDArray[Any], contents: NDArray[Any], rows: int) -> None:
    """Make the variables of the root group; a chunk is a block of seeds. CF allows coordinates no gaps."""
    for name, values in zip(INDEX_NAMES, (seeds, contents), strict=True):
        file.createDimension(name, values.size)
        kind = np.int64 if name == "seed" else np.float64
        variable = file.createVariable(name, kind, (name,), fletcher32=True, fill_value=False)
        variable.setncatts(quantity_attributes(QUANTITY_BY_NAME[name]))
        variable[:] = values
    for quantity in QUANTITY_BY_NAME.values():
        if quantity.name in INDEX_NAMES:
            continue
        kind, fill = _type_of(quantity)
        is_text = kind is str  # of variable length, which is not compressed
        options = {} if is_text else COMPRESSED | {"chunksizes": (rows, contents.size), "fill_value": fill}
        variable = file.createVariable(quantity.name, kind, INDEX_NAMES, **options)
        if not is_text:  # a block of seeds is written once; the library would keep 16 MB of each variable
            variable.set_var_chunk_cache(size=2 * rows * contents.size * np.dtype(kind).itemsize)
        variable.setncatts(quantity_attributes(quantity))


def _type_of(quantity: Quantity) -> tuple[type[Any], Any]:
    """Type of a quantity in a file, and what stands there for a missing value."""
    if quantity.name == "status":
        return np.int8, False  # each cell has one
    if quantity.kind == "text":
        return str, ""
    return (np.int64, _WHOLE_NUMBER_FILL) if quantity.kind == "whole" else (np.float64, np.nan)


def _matrix(
    name: str, values: NDArray[Any], place: tuple[NDArray[Any], NDArray[Any]], shape: tuple[int, int]
) -> NDArray[Any]:
    """Values of cells as a matrix of seeds and contents, as its variable has them."""
    quantity = QUANTITY_BY_NAME[name]
    values, gap = values_and_gap(quantity, values)
    if quantity.kind == "whole" and name != "status":
        values, gap = np.where(np.isnan(values), _WHOLE_NUMBER_FILL, values).astype(np.int64), _WHOLE_NUMBER_FILL
    matrix = np.full(shape, gap, dtype=values.dtype)
    matrix[place] = values
    return matrix


def _mark_damaged(matrices: dict[str, NDArray[Any]], cell: tuple[int, int], reason: str) -> None:
    """Leave nothing of a cell but that it is damaged, and why."""
    for name, matrix in matrices.items():
        matrix[cell] = _type_of(QUANTITY_BY_NAME[name])[1]
    matrices["status"][cell] = STATUS_CODES[CellStatus.DAMAGED]
    matrices["reason"][cell] = reason
