"""A campaign as an xarray Dataset over (seed, content), with CF attributes and provenance."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from calcidem.storage.conventions import INDEX_NAMES, as_column, campaign_attributes, quantity_attributes, status_codes
from calcidem.storage.errors import UnknownCampaignError
from calcidem.storage.records import NOT_PLANNED, QUANTITY_BY_NAME, STATUS_CODES
from calcidem.storage.sql.store import Store


def cell_matrices(store: Store, names: Sequence[str]) -> dict[str, xr.DataArray]:
    """Arrange quantities of the store's campaign (`QUANTITY_BY_NAME`, neither seed nor content), with CF attributes.

    Each is along (seed, content), both ascending. Numbers are float64 with NaN where missing, texts "" where missing;
    ``status`` is int8 (`STATUS_CODES`). `QueryError` for an unknown quantity.
    """
    columns = store.table((*INDEX_NAMES, *names))
    seeds, row = np.unique(columns["seed"].astype(np.int64), return_inverse=True)
    contents, column = np.unique(columns["content"], return_inverse=True)
    coordinates = {
        name: xr.Variable((name,), values, quantity_attributes(QUANTITY_BY_NAME[name]))
        for name, values in zip(INDEX_NAMES, (seeds, contents), strict=True)
    }
    matrices: dict[str, xr.DataArray] = {}
    for name in names:
        quantity, values = QUANTITY_BY_NAME[name], columns.pop(name)
        gap: float | str = np.nan
        if name == "status":
            values, gap = status_codes(values), STATUS_CODES[NOT_PLANNED]
        elif quantity.kind == "text":
            values, gap = as_column(quantity, values), ""
        matrix = np.full((seeds.size, contents.size), gap, dtype=values.dtype)
        matrix[row, column] = values
        matrices[name] = xr.DataArray(matrix, coordinates, INDEX_NAMES, name, quantity_attributes(quantity))
    return matrices


def campaign_dataset(store: Store, names: Sequence[str] | None = None) -> xr.Dataset:
    """Return `cell_matrices` of every cell, by default all, self-describing and with the provenance of the campaign.

    ``status`` is a CF flag variable. `UnknownCampaignError` if no cell is planned, `QueryError` for an unknown
    quantity.
    """
    wanted = QUANTITY_BY_NAME if names is None else names
    matrices = cell_matrices(store, [name for name in wanted if name not in INDEX_NAMES])
    if not any(matrix.size for matrix in matrices.values()):
        raise UnknownCampaignError(
            f"Campaign '{store.record.name}' has no cells.", "Plan some seeds and contents first."
        )
    return xr.Dataset(matrices, attrs=campaign_attributes(store))
