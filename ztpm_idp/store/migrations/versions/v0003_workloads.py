"""Name that the platform gives an agent."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0003"
down_revision = "v0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Agents may have a workload id; those registered before have none."""
    op.add_column("agents", sa.Column("workload", sa.String(length=256), nullable=True))
