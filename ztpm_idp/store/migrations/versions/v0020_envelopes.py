"""Envelopes: approvals beforehand."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0020"
down_revision = "v0019"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds an empty table: nobody approved beforehand."""
    op.create_table(
        "envelopes",
        sa.Column("envelope_id", sa.String(length=32), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("approver", sa.String(length=64), nullable=False),
        sa.Column("audience", sa.String(length=256), nullable=False),
        sa.Column("agent", sa.String(length=64), nullable=False),
        sa.Column("not_before", sa.BigInteger(), nullable=False),
        sa.Column("not_after", sa.BigInteger(), nullable=False),
        sa.Column("signed_ms", sa.BigInteger(), nullable=False),
        sa.Column("revoked_ms", sa.BigInteger(), nullable=True),
        sa.Column("revoked_by", sa.String(length=64), nullable=True),
        sa.Column("revoked_reason", sa.String(length=512), nullable=True),
        sa.Column("text", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["agent"], ["parties.id"], name=op.f("fk_envelopes_agent")),
        sa.ForeignKeyConstraint(["approver"], ["parties.id"], name=op.f("fk_envelopes_approver")),
        sa.PrimaryKeyConstraint("envelope_id", name=op.f("pk_envelopes")),
    )
    op.create_index(op.f("ix_envelopes_not_after"), "envelopes", ["not_after"], unique=False)
