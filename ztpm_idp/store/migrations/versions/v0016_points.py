"""Marks of enforcement points: how far each has followed the feed, and when it said so."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0016"
down_revision = "v0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds an empty table: a point is in it once it has confirmed."""
    op.create_table(
        "feed_points",
        sa.Column("pep", sa.String(length=64), nullable=False),
        sa.Column("line", sa.BigInteger(), nullable=False),
        sa.Column("epoch", sa.BigInteger(), nullable=False),
        sa.Column("confirmed_ms", sa.BigInteger(), nullable=False),
        sa.Column("heard_ms", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["pep"], ["parties.id"], name=op.f("fk_feed_points_pep")),
        sa.PrimaryKeyConstraint("pep", name=op.f("pk_feed_points")),
    )
