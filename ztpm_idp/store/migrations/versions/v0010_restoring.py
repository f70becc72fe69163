"""State of a store that is being restored."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0010"
down_revision = "v0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Nothing is being restored: every enforcement point was heard, and no agent is held."""
    for table, column, default in (
        ("counters", "restoring", sa.false()),
        ("peps", "heard", sa.true()),
        ("agents", "held", sa.false()),
    ):
        op.add_column(table, sa.Column(column, sa.Boolean(), nullable=False, server_default=default))
