"""A campaign over (seed, content), as matrices and as an xarray Dataset, with CF attributes and provenance."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calcidem.storage.errors import UnknownCampaignError
from calcidem.storage.records import NOT_PLANNED, QUANTITY_BY_NAME, STATUS_CODES
from calcidem.storage.sql.store import Store
from calcidem.version import __version__

if TYPE_CHECKING:
    import xarray as xr  # takes half a second, which the export of a file does not need

LAYOUT = 1
"""Version of the layout of exported files."""

INDEX_NAMES = ("seed", "content")
"""Dimensions of quantities of cells."""


def as_matrices(
    columns: Mapping[str, NDArray[Any]], names: Sequence[str], seeds: NDArray[Any], contents: NDArray[Any]
) -> dict[str, NDArray[Any]]:
    """Arrange columns of `Store.table`, including seed and content, over ascending seeds and contents.

    Each matrix is (seeds, contents). Numbers are float64 with NaN where missing, texts "" where missing; ``status`` is
    int8 (`STATUS_CODES`).
    """
    place = np.searchsorted(seeds, columns["seed"]), np.searchsorted(contents, columns["content"])
    matrices: dict[str, NDArray[Any]] = {}
    for name in names:
        quantity = QUANTITY_BY_NAME[name]
        is_text = quantity.kind == "text"
        values = quantity.as_column(columns[name]) if is_text else columns[name]
        gap = STATUS_CODES[NOT_PLANNED] if name == "status" else quantity.gap if is_text else np.nan
        matrices[name] = np.full((seeds.size, contents.size), gap, dtype=values.dtype)
        matrices[name][place] = values
    return matrices


def campaign_dataset(store: Store, names: Sequence[str] | None = None) -> "xr.Dataset":
    """Arrange quantities (`QUANTITY_BY_NAME`, by default all) of every cell along (seed, content), both ascending.

    The values are those of `as_matrices`, with CF attributes and the provenance of the campaign. ``status`` is a CF
    flag variable. `UnknownCampaignError` if no cell is planned, `QueryError` for an unknown quantity.
    """
    import xarray as xr  # noqa: PLC0415 - see above

    wanted = [name for name in (QUANTITY_BY_NAME if names is None else names) if name not in INDEX_NAMES]
    columns = store.table((*INDEX_NAMES, *wanted))
    if not columns["seed"].size:
        raise UnknownCampaignError(
            f"Campaign '{store.record.name}' has no cells.", "Plan some seeds and contents first."
        )
    attributes = {name: QUANTITY_BY_NAME[name].attributes() for name in (*INDEX_NAMES, *wanted)}
    coordinates = {name: (name, np.unique(columns[name]), attributes[name]) for name in INDEX_NAMES}
    matrices = as_matrices(columns, wanted, *(values for _, values, _ in coordinates.values()))
    variables = {name: (INDEX_NAMES, matrix, attributes[name]) for name, matrix in matrices.items()}
    return xr.Dataset(variables, coordinates, campaign_attributes(store))


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
