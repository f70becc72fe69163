"""Bringing a database to the newest schema."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from alembic import command
from alembic.config import Config

if TYPE_CHECKING:
    import sqlalchemy as sa

MIGRATIONS: Final = Path(__file__).parent / "migrations"


def upgrade(connection: sa.Connection) -> None:
    """The newest schema holds on this connection's database. Runs in the connection's transaction."""
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    config.attributes["connection"] = connection
    command.upgrade(config, "head")
