"""Agents by sponsor and role, among which a young agent's peers are."""

from __future__ import annotations

from alembic import op

revision = "v0024"
down_revision = "v0022"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds an index."""
    op.create_index(op.f("ix_agents_sponsor"), "agents", ["sponsor", "role", "id"], unique=False)
