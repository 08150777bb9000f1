"""Campaigns as NetCDF files and xarray datasets."""

import os

# HDF5 asks at its start, which is this import, whether it has to lock files. Some cluster file systems have no locks,
# and these files need none: they are complete before they get their name.
_VARIABLE = "HDF5_USE_FILE_LOCKING"
_asked = os.environ.get(_VARIABLE)
os.environ.setdefault(_VARIABLE, "FALSE")
import netCDF4  # noqa: E402, F401

if _asked is None:
    del os.environ[_VARIABLE]  # for other libraries
