"""A row of its own for the heartbeat, so that it waits for no transaction that appends to the ledger."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0014"
down_revision = "v0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Begins to count anew: the number says nothing."""
    heartbeat = op.create_table(
        "heartbeat",
        sa.Column("singleton", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("beats", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("singleton = 1", name=op.f("ck_heartbeat_one_row")),
        sa.PrimaryKeyConstraint("singleton", name=op.f("pk_heartbeat")),
    )
    op.bulk_insert(heartbeat, [{"singleton": 1, "beats": 0}])
    op.drop_column("counters", "beats")
