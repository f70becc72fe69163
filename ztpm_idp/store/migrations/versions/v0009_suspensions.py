"""Suspensions of agents."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0009"
down_revision = "v0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Has nobody suspended: what was called so before is a revocation."""
    op.add_column("agents", sa.Column("suspended_ms", sa.BigInteger(), nullable=True))
