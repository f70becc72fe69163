"""Pushes of latches, too: a push has a subject of either kind."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0031"
down_revision = "v0030"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Makes the table anew with the pushes of questions that are in it."""
    kept = [dict(row) for row in op.get_bind().execute(sa.text("SELECT * FROM pushes")).mappings()]
    op.drop_index(op.f("ix_pushes_due_ms"), table_name="pushes")
    op.drop_table("pushes")
    pushes = op.create_table(
        "pushes",
        sa.Column("matter", sa.String(length=8), nullable=False),
        sa.Column("subject_id", sa.String(length=32), nullable=False),
        sa.Column("webhook", sa.String(length=32), nullable=False),
        sa.Column("event", sa.String(length=8), nullable=False),
        sa.Column("tries", sa.Integer(), nullable=False),
        sa.Column("begun_ms", sa.BigInteger(), nullable=False),
        sa.Column("due_ms", sa.BigInteger(), nullable=False),
        sa.Column("code", sa.String(length=32), nullable=False),
        sa.Column("done", sa.Boolean(), nullable=False),
        sa.PrimaryKeyConstraint("matter", "subject_id", "webhook", "event", name=op.f("pk_pushes")),
    )
    op.create_index(op.f("ix_pushes_due_ms"), "pushes", ["due_ms"], unique=False)
    op.bulk_insert(
        pushes,
        [{"matter": "ask", "subject_id": row.pop("ask_id"), **row, "done": bool(row["done"])} for row in kept],
    )
