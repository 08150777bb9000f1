"""A campaign as an xarray Dataset over (seed, content), with CF attributes and provenance."""

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from calcidem.storage.errors import UnknownCampaignError
from calcidem.storage.records import NOT_PLANNED, STATUS_CODES, CampaignRecord, RunRecord
from calcidem.storage.sql.quantities import QUANTITIES, QUANTITY_BY_NAME, Quantity
from calcidem.storage.store import Store

FORMAT_VERSION = 2
"""Version of the layout of exported files."""

INDEX_NAMES = ("seed", "content")


def vs_array(store: Store) -> xr.DataArray:
    """Return the shear-wave velocities (seed, content) in m/s, NaN where a cell isn't done."""
    matrix = store.vs_matrix()
    coordinates = {"seed": _index("seed", matrix.seeds), "content": _index("content", matrix.contents)}
    return xr.DataArray(matrix.vs, coordinates, INDEX_NAMES, "vs", _attributes(QUANTITY_BY_NAME["vs"]))


def campaign_dataset(store: Store, campaign: CampaignRecord) -> xr.Dataset:
    """Return every scalar quantity of every cell, self-describing.

    Parameters
    ----------
    store : Store
        With that campaign chosen.
    campaign : CampaignRecord

    Returns
    -------
    Dataset
        Dimensions (seed, content). Numbers are float64 with NaN where missing, texts "" where missing;
        ``status`` is a CF flag variable.

    Raises
    ------
    UnknownCampaignError
        If no cell is planned.
    """
    columns = store.table([quantity.name for quantity in QUANTITIES])
    if columns["seed"].size == 0:
        raise UnknownCampaignError(f"Campaign '{campaign.name}' has no cells.", "Plan some seeds and contents first.")
    seeds, row = np.unique(columns["seed"].astype(np.int64), return_inverse=True)
    contents, column = np.unique(columns["content"], return_inverse=True)
    variables: dict[str, tuple[Sequence[str], NDArray[Any], dict[str, Any]]] = {}
    for quantity in QUANTITIES:
        if quantity.name not in INDEX_NAMES:
            matrix = _empty(quantity, (seeds.size, contents.size))
            matrix[row, column] = _plain(quantity, columns[quantity.name])
            variables[quantity.name] = (INDEX_NAMES, matrix, _attributes(quantity))
    coordinates = {"seed": _index("seed", seeds), "content": _index("content", contents)}
    return xr.Dataset(variables, coordinates, _global_attributes(campaign, store.runs()))


def _index(name: str, values: NDArray[Any]) -> xr.Variable:
    return xr.Variable((name,), values, _attributes(QUANTITY_BY_NAME[name]))


def _empty(quantity: Quantity, shape: tuple[int, int]) -> NDArray[Any]:
    if quantity.name == "status":
        return np.full(shape, STATUS_CODES[NOT_PLANNED], dtype=np.int8)
    if quantity.kind == "text":
        return np.full(shape, "", dtype=object)
    return np.full(shape, np.nan)


def _plain(quantity: Quantity, values: NDArray[Any]) -> NDArray[Any]:
    if quantity.name == "status":
        return np.array([STATUS_CODES[status] for status in values], dtype=np.int8)
    if quantity.kind == "text":
        return np.array([text or "" for text in values], dtype=object)
    return values


def _attributes(quantity: Quantity) -> dict[str, Any]:
    attributes: dict[str, Any] = {"long_name": quantity.meaning}
    if quantity.kind != "text":
        attributes["units"] = quantity.unit
    if quantity.name == "vs":
        attributes["ancillary_variables"] = "status error_estimate"
    if quantity.name == "status":
        attributes["standard_name"] = "status_flag"
        attributes["flag_values"] = np.array(list(STATUS_CODES.values()), dtype=np.int8)
        attributes["flag_meanings"] = " ".join(STATUS_CODES)
    return attributes


def _global_attributes(campaign: CampaignRecord, runs: Sequence[tuple[int, RunRecord]]) -> dict[str, Any]:
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {
        "Conventions": "CF-1.11",
        "title": f"Shear-wave velocity against calcite content: campaign {campaign.name}",
        "source": f"discrete-element simulations by calcidem {_own_version()}",
        "history": f"{now} exported by calcidem {_own_version()}",
        "comment": "Groups hold what is not one number for each cell (packings, attempts, signals ...).",
        "calcidem_format": FORMAT_VERSION,
        "calcidem_campaign_name": campaign.name,
        "calcidem_campaign_hash": campaign.hash,
        "calcidem_created": campaign.created.isoformat(),
        "calcidem_config": campaign.config,
        "calcidem_runs": json.dumps([_run_as_json(number, run) for number, run in runs]),
    }


def _run_as_json(number: int, run: RunRecord) -> dict[str, Any]:
    values = {name: getattr(run, name) for name in RunRecord.__slots__}
    plain = {name: value.isoformat() if isinstance(value, datetime) else value for name, value in values.items()}
    return {"number": number, **plain, "versions": dict(run.versions)}


def _own_version() -> str:
    try:
        return version("calcidem")
    except PackageNotFoundError:
        return "(not installed)"
