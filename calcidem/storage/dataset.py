"""A campaign as an xarray Dataset over (seed, content), with CF attributes and provenance."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from calcidem.storage.conventions import INDEX_NAMES, as_matrices, campaign_attributes, quantity_attributes
from calcidem.storage.errors import UnknownCampaignError
from calcidem.storage.records import QUANTITY_BY_NAME
from calcidem.storage.sql.store import Store


def cell_matrices(store: Store, names: Sequence[str]) -> dict[str, xr.DataArray]:
    """Arrange quantities of the store's campaign (`QUANTITY_BY_NAME`, neither seed nor content), with CF attributes.

    Each is along (seed, content), both ascending, with the values of `as_matrices`. `QueryError` for an unknown
    quantity.
    """
    columns = store.table((*INDEX_NAMES, *names))
    attributes = {name: quantity_attributes(QUANTITY_BY_NAME[name]) for name in (*INDEX_NAMES, *names)}
    coordinates = {name: xr.Variable((name,), np.unique(columns[name]), attributes[name]) for name in INDEX_NAMES}
    matrices = as_matrices(columns, names, *(coordinate.to_numpy() for coordinate in coordinates.values()))
    return {
        name: xr.DataArray(matrix, coordinates, INDEX_NAMES, name, attributes[name])
        for name, matrix in matrices.items()
    }


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
