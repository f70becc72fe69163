"""Suspended enforcement points, sensors and tools, and keys that were replaced."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0012"
down_revision = "v0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds empty columns and an empty table: nothing was suspended or replaced before."""
    for table in ("peps", "sensors", "tools"):
        op.add_column(table, sa.Column("suspended_ms", sa.BigInteger(), nullable=True))
    op.create_table(
        "former_keys",
        sa.Column("key", sa.LargeBinary(length=33), nullable=False),
        sa.Column("party", sa.String(length=64), nullable=False),
        sa.Column("replaced_ms", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["party"], ["parties.id"], name=op.f("fk_former_keys_party")),
        sa.PrimaryKeyConstraint("key", name=op.f("pk_former_keys")),
    )
    op.create_index(op.f("ix_former_keys_party"), "former_keys", ["party"], unique=False)
