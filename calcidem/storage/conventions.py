"""How quantities and provenance are written down in datasets and NetCDF files: CF attributes, flags and gaps."""

import json
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calcidem.storage.records import NOT_PLANNED, STATUS_CODES, Quantity
from calcidem.storage.sql.store import Store
from calcidem.version import __version__

LAYOUT = 1
"""Version of the layout of exported files."""

INDEX_NAMES = ("seed", "content")
"""Dimensions of what each cell has."""


def values_and_gap(quantity: Quantity, values: NDArray[Any]) -> tuple[NDArray[Any], Any]:
    """Values as a matrix of a Dataset has them, and what stands for a cell that isn't planned."""
    if quantity.name == "status":
        return np.array([STATUS_CODES[status] for status in values], dtype=np.int8), STATUS_CODES[NOT_PLANNED]
    if quantity.kind == "text":
        return np.array([text or "" for text in values], dtype=object), ""
    return values, np.nan


def quantity_attributes(quantity: Quantity) -> dict[str, Any]:
    """CF attributes of a quantity."""
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


def campaign_attributes(store: Store) -> dict[str, Any]:
    """Provenance of the store's campaign, as attributes of a Dataset or a file."""
    campaign = store.record
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {
        "Conventions": "CF-1.11",
        "title": f"Shear-wave velocity against calcite content: campaign {campaign.name}",
        "source": f"discrete-element simulations by calcidem {__version__}",
        "history": f"{now} exported by calcidem {__version__}",
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
