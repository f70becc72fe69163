"""Bringing a database to the newest schema."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import sqlalchemy as sa

from ztpm_idp.store.errors import NewerDatabaseError

MIGRATIONS: Final = Path(__file__).parent / "migrations"
NEWEST: Final = max(path.stem for path in (MIGRATIONS / "versions").glob("v*.py")).partition("_")[0]
"""Newest revision; its file begins with it."""


def upgrade(connection: sa.Connection) -> str | None:
    """The newest schema holds on this connection's database; the revision before, None of a new one.

    Runs in the connection's transaction.

    Raises:
        NewerDatabaseError: a newer release wrote the database.
    """
    revision = sa.select(sa.column("version_num", sa.String)).select_from(sa.table("alembic_version"))
    before: str | None = None
    if sa.inspect(connection).has_table("alembic_version"):
        before = connection.scalar(revision)
    if before == NEWEST:
        return before
    # A sixth of the provider's start, for a database that is rarely an old one.
    from alembic import command
    from alembic.config import Config
    from alembic.util import CommandError

    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    config.attributes["connection"] = connection
    try:
        command.upgrade(config, "head")
    except CommandError as error:
        raise NewerDatabaseError(str(error)) from error
    return before
