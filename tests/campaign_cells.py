"""Cells of a campaign, from the velocities that a test writes down."""

import numpy as np
import xarray as xr

from calcidem.storage.records import STATUS_CODES


def campaign_cells(
    vs: xr.DataArray, status: xr.DataArray | None = None, error: xr.DataArray | None = None
) -> xr.Dataset:
    """Give velocities (m/s) along (seed, content) outcomes and a relative standard error.

    By default each velocity is done and each gap pending; an empty outcome is pending, too.
    """
    known = vs.notnull()
    words = xr.where(known, "done", "pending") if status is None else xr.where(status == "", "pending", status)
    codes = words.copy(data=np.vectorize(STATUS_CODES.__getitem__)(words))
    errors = known * np.nan if error is None else error
    zero = errors * 0.0
    parts = {"reading_error": errors, "numerical_error": zero, "pulse_effect": zero, "vs_error": errors}
    return xr.Dataset({"vs": vs, "status": codes} | parts)
