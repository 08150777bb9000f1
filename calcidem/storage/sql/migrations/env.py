"""Alembic's entry point: run the migrations on the connection that `calcidem.storage.sql.schema` hands over."""

from alembic import context

from calcidem.storage.sql.models import Base
from calcidem.storage.sql.schema import VERSION_TABLE

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=Base.metadata,
    version_table=VERSION_TABLE,
    transactional_ddl=True,  # also on SQLite, where `calcidem.storage.sql.engine` opens real transactions
    render_as_batch=True,  # SQLite can't alter constraints in place
)
with context.begin_transaction():
    context.run_migrations()
