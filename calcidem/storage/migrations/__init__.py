"""Alembic migrations of the schema, shipped with the package; `calcidem.storage.schema` runs them."""
