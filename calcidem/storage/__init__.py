"""Results kept for good: records, the `Store` contract and its SQL implementation, export and reading.

Open a database for writing with `calcidem.storage.sql.store.open_store`, for reading with
`calcidem.storage.campaign.open_stored_campaign`; `calcidem.storage.netcdf.export` writes and reads NetCDF.
"""
