"""Picture of an ask: the text that people are shown with it."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0027"
down_revision = "v0026"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds an empty column: earlier asks name no picture."""
    with op.batch_alter_table("asks") as asks:
        asks.add_column(sa.Column("picture", sa.Text(), server_default="", nullable=False))
