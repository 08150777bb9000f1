"""A campaign as an xarray Dataset over (seed, content), with CF attributes and provenance."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from calcidem.storage.errors import UnknownCampaignError
from calcidem.storage.records import (
    NOT_PLANNED,
    QUANTITY_BY_NAME,
    STATUS_CODES,
    CellKey,
    CellStatus,
    Quantity,
)
from calcidem.storage.sql.store import Store

LAYOUT = 1
"""Version of the layout of exported files."""

_INDEX_NAMES = ("seed", "content")


def cell_matrices(store: Store, names: Sequence[str]) -> dict[str, xr.DataArray]:
    """Arrange quantities of the store's campaign by seed and content, with CF attributes.

    Parameters
    ----------
    store : Store
        With a campaign chosen.
    names : sequence of str
        From `calcidem.storage.records.QUANTITY_BY_NAME`, neither seed nor content.

    Returns
    -------
    dict of str to DataArray
        Dimensions (seed, content), both ascending. Numbers are float64 with NaN where missing, texts "" where missing;
        ``status`` is int8 (`STATUS_CODES`).

    Raises
    ------
    QueryError
        For an unknown quantity.
    """
    columns = store.table((*_INDEX_NAMES, *names))
    seeds, row = np.unique(columns["seed"].astype(np.int64), return_inverse=True)
    contents, column = np.unique(columns["content"], return_inverse=True)
    coordinates = {
        name: xr.Variable((name,), values, _attributes(QUANTITY_BY_NAME[name]))
        for name, values in zip(_INDEX_NAMES, (seeds, contents), strict=True)
    }
    matrices: dict[str, xr.DataArray] = {}
    for name in names:
        values, gap = _values_and_gap(QUANTITY_BY_NAME[name], columns.pop(name))
        matrix = np.full((seeds.size, contents.size), gap, dtype=values.dtype)
        matrix[row, column] = values
        matrices[name] = xr.DataArray(matrix, coordinates, _INDEX_NAMES, name, _attributes(QUANTITY_BY_NAME[name]))
    return matrices


def campaign_dataset(
    store: Store,
    names: Sequence[str] | None = None,
    damaged: Mapping[CellKey, str] | None = None,
) -> xr.Dataset:
    """Return scalar quantities of every cell, self-describing and with the provenance of the campaign.

    Parameters
    ----------
    store : Store
        With a campaign chosen.
    names : sequence of str, optional
        Quantities, by default all.
    damaged : mapping of CellKey to str, optional
        Cells that are damaged though their numbers are not, and why: they are missing, with that flag.

    Returns
    -------
    Dataset
        Of `cell_matrices`; ``status`` is a CF flag variable.

    Raises
    ------
    UnknownCampaignError
        If no cell is planned.
    QueryError
        For an unknown quantity.
    """
    wanted = QUANTITY_BY_NAME if names is None else names
    matrices = cell_matrices(store, [name for name in wanted if name not in _INDEX_NAMES])
    known: dict[str, Any] = {"status": STATUS_CODES[CellStatus.DAMAGED]}
    for key, reason in (damaged or {}).items():
        for name, matrix in matrices.items():
            missing = "" if matrix.dtype == object else np.nan
            value = (known | {"reason": reason}).get(name, missing)
            matrix.loc[{"seed": key.seed, "content": key.content}] = value
    if not any(matrix.size for matrix in matrices.values()):
        raise UnknownCampaignError(
            f"Campaign '{store.record.name}' has no cells.", "Plan some seeds and contents first."
        )
    return xr.Dataset(matrices, attrs=_global_attributes(store))


def _values_and_gap(quantity: Quantity, values: NDArray[Any]) -> tuple[NDArray[Any], Any]:
    """Values as a matrix of a Dataset has them, and what stands for a cell that isn't planned."""
    if quantity.name == "status":
        return np.array([STATUS_CODES[status] for status in values], dtype=np.int8), STATUS_CODES[NOT_PLANNED]
    if quantity.kind == "text":
        return np.array([text or "" for text in values], dtype=object), ""
    return values, np.nan


def _attributes(quantity: Quantity) -> dict[str, Any]:
    attributes: dict[str, Any] = {"long_name": quantity.meaning}
    if quantity.kind != "text":
        attributes["units"] = quantity.unit
    if quantity.name == "vs":
        attributes["ancillary_variables"] = "status vs_error"
    if quantity.name == "status":
        attributes["standard_name"] = "status_flag"
        attributes["flag_values"] = np.array(list(STATUS_CODES.values()), dtype=np.int8)
        attributes["flag_meanings"] = " ".join(STATUS_CODES)
    return attributes


def _global_attributes(store: Store) -> dict[str, Any]:
    campaign = store.record
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {
        "Conventions": "CF-1.11",
        "title": f"Shear-wave velocity against calcite content: campaign {campaign.name}",
        "source": f"discrete-element simulations by calcidem {_own_version()}",
        "history": f"{now} exported by calcidem {_own_version()}",
        "comment": "Groups hold what is not one number for each cell (packings, attempts, signals ...).",
        "calcidem_layout": LAYOUT,
        "calcidem_campaign_name": campaign.name,
        "calcidem_campaign_hash": campaign.hash,
        "calcidem_created": campaign.created.isoformat(),
        "calcidem_config": campaign.config,
        "calcidem_checksum": campaign.checksum,
        "calcidem_packing_content_hash": " ".join(found or "unknown" for found in store.content_hashes().values()),
        "calcidem_runs": json.dumps(
            [{"number": number} | asdict(run) for number, run in store.runs()], default=datetime.isoformat
        ),
    }


def _own_version() -> str:
    try:
        return version("calcidem")
    except PackageNotFoundError:
        return "(not installed)"
