"""Tokens of platforms that were shown already: each counts once."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0018"
down_revision = "v0017"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds an empty table: what was shown before is over within minutes."""
    op.create_table(
        "spent_credentials",
        sa.Column("digest", sa.LargeBinary(length=32), nullable=False),
        sa.Column("until_ms", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("digest", name=op.f("pk_spent_credentials")),
    )
    op.create_index(op.f("ix_spent_credentials_until_ms"), "spent_credentials", ["until_ms"], unique=False)
