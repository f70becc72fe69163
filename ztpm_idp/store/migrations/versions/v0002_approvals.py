"""Asks, votes and openings."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0002"
down_revision = "v0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Upgrades from the first schema, whose rows stay as they are."""
    op.create_table(
        "asks",
        sa.Column("ask_id", sa.String(length=32), nullable=False),
        sa.Column("nonce", sa.String(length=32), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("pep", sa.String(length=64), nullable=False),
        sa.Column("audience", sa.String(length=256), nullable=False),
        sa.Column("agent", sa.String(length=64), nullable=False),
        sa.Column("sponsor", sa.String(length=64), nullable=False),
        sa.Column("approvers", sa.Integer(), nullable=False),
        sa.Column("fresh", sa.Boolean(), nullable=False),
        sa.Column("asked_at", sa.BigInteger(), nullable=False),
        sa.Column("expires_at", sa.BigInteger(), nullable=False),
        sa.Column("taken_ms", sa.BigInteger(), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["agent"], ["parties.id"], name=op.f("fk_asks_agent")),
        sa.ForeignKeyConstraint(["pep"], ["parties.id"], name=op.f("fk_asks_pep")),
        sa.ForeignKeyConstraint(["sponsor"], ["parties.id"], name=op.f("fk_asks_sponsor")),
        sa.PrimaryKeyConstraint("ask_id", name=op.f("pk_asks")),
    )
    op.create_index(op.f("ix_asks_expires_at"), "asks", ["expires_at"], unique=False)
    op.create_table(
        "openings",
        sa.Column("opening_id", sa.String(length=32), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("opener", sa.String(length=64), nullable=False),
        sa.Column("audience", sa.String(length=256), nullable=False),
        sa.Column("agent", sa.String(length=64), nullable=False),
        sa.Column("object", sa.String(length=256), nullable=False),
        sa.Column("operation", sa.String(length=256), nullable=False),
        sa.Column("not_before", sa.BigInteger(), nullable=False),
        sa.Column("not_after", sa.BigInteger(), nullable=False),
        sa.Column("made_ms", sa.BigInteger(), nullable=False),
        sa.Column("closed_ms", sa.BigInteger(), nullable=True),
        sa.Column("closed_by", sa.String(length=64), nullable=True),
        sa.Column("closed_reason", sa.String(length=512), nullable=True),
        sa.Column("text", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["agent"], ["parties.id"], name=op.f("fk_openings_agent")),
        sa.ForeignKeyConstraint(["closed_by"], ["parties.id"], name=op.f("fk_openings_closed_by")),
        sa.ForeignKeyConstraint(["opener"], ["parties.id"], name=op.f("fk_openings_opener")),
        sa.PrimaryKeyConstraint("opening_id", name=op.f("pk_openings")),
    )
    op.create_index(op.f("ix_openings_not_after"), "openings", ["not_after"], unique=False)
    op.create_table(
        "votes",
        sa.Column("ask_id", sa.String(length=32), nullable=False),
        sa.Column("place", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("approver", sa.String(length=64), nullable=False),
        sa.Column("answer", sa.String(length=16), nullable=False),
        sa.Column("withdraws", sa.Boolean(), nullable=False),
        sa.Column("not_after", sa.BigInteger(), nullable=False),
        sa.Column("cast_ms", sa.BigInteger(), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.CheckConstraint("answer IN ('approve', 'deny', 'withdraw')", name=op.f("ck_votes_answer")),
        sa.ForeignKeyConstraint(["approver"], ["parties.id"], name=op.f("fk_votes_approver")),
        sa.ForeignKeyConstraint(["ask_id"], ["asks.ask_id"], name=op.f("fk_votes_ask_id")),
        sa.PrimaryKeyConstraint("ask_id", "place", name=op.f("pk_votes")),
        sa.UniqueConstraint("ask_id", "approver", "withdraws", name=op.f("uq_votes_ask_id_approver_withdraws")),
    )
    op.create_index(op.f("ix_votes_not_after"), "votes", ["not_after"], unique=False)
