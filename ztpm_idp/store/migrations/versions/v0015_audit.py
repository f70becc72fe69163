"""The tree over the ledger and its index, made of the entries, of old ones too."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0015"
down_revision = "v0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds empty tables, which the first question for a proof fills, or the service itself."""
    op.create_table(
        "ledger_tiles",
        sa.Column("level", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("place", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("hashes", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("level", "place", name=op.f("pk_ledger_tiles")),
    )
    op.create_table(
        "ledger_index",
        sa.Column("seq", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("at_ms", sa.BigInteger(), nullable=False),
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("actor", sa.String(length=256), nullable=False),
        sa.Column("agent", sa.String(length=256), nullable=True),
        sa.Column("token", sa.String(length=256), nullable=True),
        sa.Column("object", sa.String(length=256), nullable=True),
        sa.Column("request", sa.String(length=256), nullable=True),
        sa.Column("trace", sa.String(length=256), nullable=True),
        sa.Column("effect", sa.String(length=256), nullable=True),
        sa.PrimaryKeyConstraint("seq", name=op.f("pk_ledger_index")),
    )
    for column in ("at_ms", "kind", "actor", "agent", "token", "object", "request", "trace"):
        op.create_index(op.f(f"ix_ledger_index_{column}_seq"), "ledger_index", [column, "seq"], unique=False)
    op.create_table(
        "ledger_followed",
        sa.Column("singleton", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("size", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("singleton = 1", name=op.f("ck_ledger_followed_one_row")),
        sa.PrimaryKeyConstraint("singleton", name=op.f("pk_ledger_followed")),
    )
    followed = sa.table("ledger_followed", sa.column("singleton", sa.Integer), sa.column("size", sa.BigInteger))
    op.execute(sa.insert(followed).values(singleton=1, size=0))
