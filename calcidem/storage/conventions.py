"""Form of quantities and provenance in datasets and NetCDF files: CF attributes, flags and gaps."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calcidem.storage.records import NOT_PLANNED, QUANTITY_BY_NAME, STATUS_CODES, Quantity
from calcidem.storage.sql.store import Store
from calcidem.version import __version__

Group = Any
"""A netCDF4.Dataset or netCDF4.Group; that library has no types."""

LAYOUT = 1
"""Version of the layout of exported files."""

INDEX_NAMES = ("seed", "content")
"""Dimensions of what each cell has."""

_NO_NUMBER = -1  # stands for None among whole numbers, all of whose real values are 0 or more


def fill_value(quantity: Quantity) -> Any:  # noqa: ANN401 - text or number
    """The value of missing entries in a file."""
    if quantity.name == "status":
        return STATUS_CODES[NOT_PLANNED]
    return {"text": "", "whole": _NO_NUMBER, "real": np.nan}[quantity.kind]


def as_column(quantity: Quantity, values: Sequence[Any] | NDArray[Any]) -> NDArray[Any]:
    """Values of a quantity, None or NaN where missing, as a file has them: statuses are the flags of CF."""
    if quantity.name == "status":
        return np.array([STATUS_CODES[status] for status in values], dtype=np.int8)
    if quantity.kind == "text":
        return np.array([text or "" for text in values], dtype=object)
    numbers = np.array(values, dtype=np.float64)
    if quantity.kind == "real":
        return numbers
    return np.where(np.isnan(numbers), _NO_NUMBER, numbers).astype(np.int64)


def as_values(quantity: Quantity, column: NDArray[Any]) -> NDArray[np.object_]:
    """Inverse of `as_column`: Python's own int, float or str, None where missing."""
    if quantity.name == "status":
        names: NDArray[np.object_] = np.array(list(STATUS_CODES), dtype=object)
        return np.take(names, column)
    plain = column.astype(object)
    missing = {"text": plain == "", "whole": column == _NO_NUMBER, "real": column != column}[quantity.kind]  # noqa: PLR0124 - NaN
    if quantity.is_optional:
        plain[missing] = None
    return plain


def as_matrices(
    columns: Mapping[str, NDArray[Any]], names: Sequence[str], seeds: NDArray[Any], contents: NDArray[Any]
) -> dict[str, NDArray[Any]]:
    """Arrange columns of `Store.table`, seed and content among them, over ascending seeds and contents.

    Each matrix is (seeds, contents). Numbers are float64 with NaN where missing, texts "" where missing; ``status`` is
    int8 (`STATUS_CODES`).
    """
    place = np.searchsorted(seeds, columns["seed"]), np.searchsorted(contents, columns["content"])
    matrices: dict[str, NDArray[Any]] = {}
    for name in names:
        quantity = QUANTITY_BY_NAME[name]
        is_text = quantity.kind == "text"
        values = as_column(quantity, columns[name]) if is_text else columns[name]
        gap = fill_value(quantity) if is_text else np.nan
        matrices[name] = np.full((seeds.size, contents.size), gap, dtype=values.dtype)
        matrices[name][place] = values
    return matrices


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
