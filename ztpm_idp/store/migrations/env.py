"""Alembic's entry point: brings the connection in `config.attributes["connection"]` to the wanted revision."""

from __future__ import annotations

from alembic import context

from ztpm_idp.store.schema import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    render_as_batch=True,  # SQLite cannot alter most things in place
)
with context.begin_transaction():
    context.run_migrations()
