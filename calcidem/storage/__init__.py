"""Permanent results: records, the `Store` on a SQL database, and NetCDF files.

Open a database for writing with `calcidem.storage.sql.store.Store`, for reading with
`calcidem.storage.sql.store.read_campaign`. `calcidem.storage.netcdf` writes a campaign to a NetCDF file
and reads it into a store. Callers give and get `calcidem.storage.records`, never rows.
"""
