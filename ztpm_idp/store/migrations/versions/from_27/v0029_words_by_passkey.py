"""Changes of people that were proposed with a passkey."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0029"
down_revision = "v0028"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds a column: until now every change was proposed with an operator key."""
    op.add_column("changes", sa.Column("by_passkey", sa.Boolean(), nullable=False, server_default=sa.false()))
