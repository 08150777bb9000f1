"""Export of a campaign to one NetCDF-4 file."""

import os
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import xarray as xr

from calcidem.storage.dataset import campaign_dataset
from calcidem.storage.errors import DamagedStoreError, DiskError, OutputRefusedError
from calcidem.storage.files import write_atomically
from calcidem.storage.netcdf.groups import append_arrays, append_attempts, append_packing
from calcidem.storage.netcdf.trial import refuse_unreadable
from calcidem.storage.records import ARRAY_RECORDS, QUANTITY_BY_NAME, CellKey, CellStatus
from calcidem.storage.sql.reading import chunks
from calcidem.storage.sql.store import Store

_CELLS_COPIED_AT_ONCE = 1000
"""Cells whose arrays are in memory at a time."""

_WHOLE_NUMBER_FILL = -1


def export_netcdf(store: Store, path: str | os.PathLike[str], *, without: Collection[str] = ()) -> Path:
    """Write everything the store has about its campaign into one compressed NetCDF-4 file.

    The root group is the Dataset of `campaign_dataset`, which plain ``xarray.open_dataset`` opens; the
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
    OutputRefusedError
        If a database has that name, or a NetCDF file that is not this campaign's.
    DiskError
        If the file can't be written.
    """
    unknown = sorted(set(without) - set(ARRAY_RECORDS))
    if unknown:
        raise ValueError(f"without = {unknown[0]!r}: choose among {', '.join(ARRAY_RECORDS)}")
    wanted = [group for group in ARRAY_RECORDS if group not in without]
    with _replace_netcdf(path, store.record.hash) as temporary:
        damaged: dict[CellKey, str] = {}
        with netCDF4.Dataset(temporary, "w") as file:
            for index in store.packing_indices():
                with suppress(DamagedStoreError):  # cells without a packing tell that it is missing
                    append_packing(file, store.packing(index))
            for attempts in chunks(store.history(), _CELLS_COPIED_AT_ONCE):
                append_attempts(file, attempts)
            for results in chunks(store.results(with_arrays=bool(wanted)), _CELLS_COPIED_AT_ONCE):
                append_arrays(file, results, wanted)
                damaged |= {found.key: found.reason for found in results if found.status is CellStatus.DAMAGED}
        # Once everything is read, so that the root has the flag of a cell whose arrays alone are damaged.
        dataset = campaign_dataset(store, damaged=damaged)
        dataset.to_netcdf(temporary, mode="a", engine="netcdf4", format="NETCDF4", encoding=_encoding(dataset))
    return Path(path).absolute()


def write_netcdf(dataset: xr.Dataset, path: str | os.PathLike[str]) -> None:
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


def _encoding(dataset: xr.Dataset) -> dict[str, Mapping[str, Any]]:
    """Types and compression; coordinates have no fill value, since CF allows them no gaps."""
    compressed = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}
    checked = {"_FillValue": None, "fletcher32": True}
    encoding: dict[str, Mapping[str, Any]] = dict.fromkeys(("seed", "content"), checked)
    for quantity in QUANTITY_BY_NAME.values():
        if quantity.name in encoding:
            continue
        if quantity.name == "status":
            encoding[quantity.name] = compressed
        elif quantity.kind == "whole":
            encoding[quantity.name] = compressed | {"dtype": "int64", "_FillValue": _WHOLE_NUMBER_FILL}
        elif quantity.kind == "real":
            encoding[quantity.name] = compressed | {"_FillValue": np.nan}
    return {name: options for name, options in encoding.items() if name in dataset.variables}
