"""Trace of an ask: that of the request that brought it."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0022"
down_revision = "v0020"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds an empty column: of earlier asks no trace is known."""
    with op.batch_alter_table("asks") as asks:
        asks.add_column(sa.Column("trace_id", sa.String(length=32), server_default="", nullable=False))
