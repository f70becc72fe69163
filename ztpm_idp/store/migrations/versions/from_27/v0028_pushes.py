"""Pushes of questions to webhooks."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0028"
down_revision = "v0027"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds an empty table: nothing was pushed."""
    op.create_table(
        "pushes",
        sa.Column("ask_id", sa.String(length=32), nullable=False),
        sa.Column("webhook", sa.String(length=32), nullable=False),
        sa.Column("event", sa.String(length=8), nullable=False),
        sa.Column("tries", sa.Integer(), nullable=False),
        sa.Column("begun_ms", sa.BigInteger(), nullable=False),
        sa.Column("due_ms", sa.BigInteger(), nullable=False),
        sa.Column("code", sa.String(length=32), nullable=False),
        sa.Column("done", sa.Boolean(), nullable=False),
        sa.ForeignKeyConstraint(["ask_id"], ["asks.ask_id"], name=op.f("fk_pushes_ask_id")),
        sa.PrimaryKeyConstraint("ask_id", "webhook", "event", name=op.f("pk_pushes")),
    )
    op.create_index(op.f("ix_pushes_due_ms"), "pushes", ["due_ms"], unique=False)
