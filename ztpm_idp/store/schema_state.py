"""State of a database's schema, looked at and not changed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.ext.asyncio import create_async_engine

from ztpm_idp.store.errors import StoreUnavailableError

if TYPE_CHECKING:
    from sqlalchemy import Connection


async def revision_of(database_url: str) -> str | None:
    """The revision of the schema; None where the database is empty or its file is missing.

    Raises:
        StoreUnavailableError: it cannot be reached or read.
    """
    url = sa.make_url(database_url)
    if _missing(url):
        return None  # to connect would make the file
    engine = create_async_engine(url, hide_parameters=True)
    try:
        async with engine.connect() as connection:
            return await connection.run_sync(_revision)
    except (SQLAlchemyError, OSError) as error:
        raise StoreUnavailableError from error
    finally:
        await engine.dispose()


def _missing(url: sa.URL) -> bool:
    return url.get_backend_name() == "sqlite" and not Path(url.database or "").is_file()


def _revision(connection: Connection) -> str | None:
    if not sa.inspect(connection).has_table("alembic_version"):
        return None
    table = sa.table("alembic_version", sa.column("version_num", sa.String))
    found: str | None = connection.scalar(sa.select(table.c.version_num))
    return found
