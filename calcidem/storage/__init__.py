"""Permanent results: records, the `Store` on a SQL database, NetCDF files and reading.

Open a database for writing with `calcidem.storage.sql.store.Store`, for reading with
`calcidem.storage.sql.store.read_campaign`. `calcidem.storage.netcdf.export` writes a campaign to a NetCDF file,
`calcidem.storage.netcdf.import_netcdf` brings it back. Callers give and get `calcidem.storage.records`, never rows.
"""
