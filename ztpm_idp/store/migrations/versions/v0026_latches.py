"""Latches of robots, and people's clearings of them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0026"
down_revision = "v0025"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds two empty tables: no robot is latched."""
    op.create_table(
        "latches",
        sa.Column("latch_id", sa.String(length=32), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("pep", sa.String(length=64), nullable=False),
        sa.Column("audience", sa.String(length=256), nullable=False),
        sa.Column("robot", sa.String(length=256), nullable=False),
        sa.Column("cause", sa.String(length=64), nullable=False),
        sa.Column("approvers", sa.Integer(), nullable=False),
        sa.Column("at", sa.BigInteger(), nullable=False),
        sa.Column("told_ms", sa.BigInteger(), nullable=False),
        sa.Column("released_ms", sa.BigInteger(), nullable=True),
        sa.Column("text", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["pep"], ["parties.id"], name=op.f("fk_latches_pep")),
        sa.PrimaryKeyConstraint("latch_id", name=op.f("pk_latches")),
    )
    op.create_index(op.f("ix_latches_audience"), "latches", ["audience"], unique=False)
    op.create_table(
        "latch_clearings",
        sa.Column("latch_id", sa.String(length=32), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("approver", sa.String(length=64), nullable=False),
        sa.Column("not_after", sa.BigInteger(), nullable=False),
        sa.Column("latch_digest", sa.String(length=64), nullable=False),
        sa.Column("signed_ms", sa.BigInteger(), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["approver"], ["parties.id"], name=op.f("fk_latch_clearings_approver")),
        sa.ForeignKeyConstraint(["latch_id"], ["latches.latch_id"], name=op.f("fk_latch_clearings_latch_id")),
        sa.PrimaryKeyConstraint("latch_id", "number", name=op.f("pk_latch_clearings")),
    )
    op.create_index(op.f("ix_latch_clearings_not_after"), "latch_clearings", ["not_after"], unique=False)
