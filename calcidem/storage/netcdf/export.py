"""Export of a campaign to one NetCDF-4 file, and the way back."""

import os
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import xarray as xr

from calcidem.storage.files import write_atomically
from calcidem.storage.netcdf.dataset import campaign_dataset
from calcidem.storage.netcdf.groups import SAMPLE_GROUPS, append_attempts, append_packing, append_samples
from calcidem.storage.records import CampaignRecord
from calcidem.storage.sql.quantities import QUANTITIES
from calcidem.storage.sql.reading import chunks
from calcidem.storage.store import Store

_CELLS_COPIED_AT_ONCE = 1000
"""Cells whose arrays are in memory at a time."""

_WHOLE_NUMBER_FILL = -1


def export_netcdf(
    store: Store, campaign: CampaignRecord, path: str | os.PathLike[str], *, without: Collection[str] = ()
) -> Path:
    """Write everything the store has about a campaign into one compressed NetCDF-4 file.

    The root group is the Dataset of `campaign_dataset`, which plain ``xarray.open_dataset`` opens; the
    groups ``packings``, ``attempts``, ``paths``, ``signals`` and ``cement`` hold the rest. An existing file
    is replaced in one step when the new one is complete and on disk; until then, and after any error, it
    stays as it was.

    Parameters
    ----------
    store : Store
        With that campaign chosen.
    campaign : CampaignRecord
    path : str or path
    without : collection of str
        Groups of arrays to leave out, of ``paths``, ``signals`` and ``cement``: with them a cell takes about 50 kB,
        without them 1 kB.

    Returns
    -------
    Path
        Of the file written.

    Raises
    ------
    ValueError
        If a group to leave out is none of these.
    """
    unknown = sorted(set(without) - set(SAMPLE_GROUPS))
    if unknown:
        raise ValueError(f"without = {unknown[0]!r}: choose among {', '.join(SAMPLE_GROUPS)}")
    wanted = [group for group in SAMPLE_GROUPS if group not in without]
    with write_atomically(path) as temporary:
        dataset = campaign_dataset(store, campaign)
        dataset.to_netcdf(temporary, engine="netcdf4", format="NETCDF4", encoding=_encoding(dataset))
        with netCDF4.Dataset(temporary, "a") as file:
            for index in store.packing_indices():
                packing = store.load_packing(index)
                if packing is not None:
                    append_packing(file, packing)
            for attempts in chunks(store.history(), _CELLS_COPIED_AT_ONCE):
                append_attempts(file, attempts)
            for results in chunks(store.results(with_arrays=bool(wanted)), _CELLS_COPIED_AT_ONCE):
                append_samples(file, results, wanted)
    return Path(path).absolute()


def _encoding(dataset: xr.Dataset) -> dict[str, Mapping[str, Any]]:
    """Types and compression; coordinates have no fill value, since CF allows them no gaps."""
    compressed = {"zlib": True, "complevel": 4, "shuffle": True}
    encoding: dict[str, Mapping[str, Any]] = {name: {"_FillValue": None} for name in ("seed", "content")}
    for quantity in QUANTITIES:
        if quantity.name in encoding:
            continue
        if quantity.name == "status":
            encoding[quantity.name] = compressed
        elif quantity.kind == "whole":
            encoding[quantity.name] = compressed | {"dtype": "int64", "_FillValue": _WHOLE_NUMBER_FILL}
        elif quantity.kind == "real":
            encoding[quantity.name] = compressed | {"_FillValue": np.nan}
    return {name: options for name, options in encoding.items() if name in dataset.variables}
