"""Bringing a database to the newest schema."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Final

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.ext.asyncio import create_async_engine

from ztpm_idp.store.database import postgres
from ztpm_idp.store.errors import NewerDatabaseError, StoreUnavailableError

MIGRATIONS: Final = Path(__file__).parents[1] / "migrations"
NEWEST: Final = max(path.stem for path in (MIGRATIONS / "versions").rglob("v*.py")).partition("_")[0]
"""Newest revision; its file begins with it."""
_UPGRADING: Final = threading.RLock()
"""Held by the thread that upgrades: Alembic keeps what it is doing in a module."""


def upgrade(connection: sa.Connection) -> str | None:
    """The newest schema holds on this connection's database; the revision before, None of a new one.

    Runs in the connection's transaction.

    Raises:
        NewerDatabaseError: a newer release wrote the database.
    """
    before = _revision(connection)
    if before == NEWEST:
        return before
    # A sixth of the provider's start, for a database that is rarely an old one.
    from alembic import command
    from alembic.config import Config
    from alembic.util import CommandError

    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    config.set_main_option("recursive_version_locations", "true")
    config.attributes["connection"] = connection
    try:
        with _UPGRADING:
            command.upgrade(config, "head")
    except CommandError as error:
        raise NewerDatabaseError(str(error)) from error
    return before


async def revision_of(database_url: str) -> str | None:
    """The revision of the schema; None where the database is empty or its file is missing.

    Raises:
        StoreUnavailableError: it cannot be reached or read.
    """
    url = sa.make_url(database_url)
    if _missing(url):
        return None  # to connect would make the file
    engine = postgres.engine_of(url) if url.get_backend_name() == "postgresql" else create_async_engine(url)
    try:
        async with engine.connect() as connection:
            return await connection.run_sync(_revision)
    except (SQLAlchemyError, OSError) as error:
        raise StoreUnavailableError from error
    finally:
        await engine.dispose()


def _missing(url: sa.URL) -> bool:
    return url.get_backend_name() == "sqlite" and not Path(url.database or "").is_file()


def _revision(connection: sa.Connection) -> str | None:
    if not sa.inspect(connection).has_table("alembic_version"):
        return None
    table = sa.table("alembic_version", sa.column("version_num", sa.String))
    found: str | None = connection.scalar(sa.select(table.c.version_num))
    return found
