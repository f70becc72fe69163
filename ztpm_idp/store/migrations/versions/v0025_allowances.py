"""Allowances: tokens of a sponsor are counted by their end."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0025"
down_revision = "v0024"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds an index over first hops."""
    first = sa.text("parent IS NULL")
    op.create_index(
        "ix_hops_lent", "hops", ["sponsor", "not_after", "made_ms"], sqlite_where=first, postgresql_where=first
    )
