"""Mandates, and the mandate that a token was drawn from."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0011"
down_revision = "v0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds an empty table: no token was drawn before."""
    op.create_table(
        "mandates",
        sa.Column("mandate_id", sa.String(length=32), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("sponsor", sa.String(length=64), nullable=False),
        sa.Column("agent", sa.String(length=64), nullable=False),
        sa.Column("key", sa.String(length=43), nullable=False),
        sa.Column("signed_at", sa.BigInteger(), nullable=False),
        sa.Column("not_after", sa.BigInteger(), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["sponsor"], ["parties.id"], name=op.f("fk_mandates_sponsor")),
        sa.ForeignKeyConstraint(["agent"], ["parties.id"], name=op.f("fk_mandates_agent")),
        sa.PrimaryKeyConstraint("mandate_id", name=op.f("pk_mandates")),
    )
    for column in ("sponsor", "agent", "key"):
        op.create_index(op.f(f"ix_mandates_{column}"), "mandates", [column], unique=False)
    op.add_column("hops", sa.Column("mandate", sa.String(length=32), nullable=True))
    op.create_index(op.f("ix_hops_mandate"), "hops", ["mandate"], unique=False)
