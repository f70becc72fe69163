"""Budget of refusals of each agent."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0007"
down_revision = "v0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds an empty table: nothing was counted before."""
    op.create_table(
        "refusals",
        sa.Column("agent", sa.String(length=64), nullable=False),
        sa.Column("since_ms", sa.BigInteger(), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["agent"], ["parties.id"], name=op.f("fk_refusals_agent")),
        sa.PrimaryKeyConstraint("agent", name=op.f("pk_refusals")),
    )
