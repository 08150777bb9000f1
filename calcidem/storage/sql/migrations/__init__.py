"""Alembic migrations of the schema, shipped with the package; `calcidem.storage.sql.schema` runs them."""
