"""Line and head of the chain of revocations."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from capabilities.statements.revocation import FIRST_HEAD, next_head

revision = "v0008"
down_revision = "v0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Chains the revocations that there are, in the first line."""
    op.add_column(
        "counters", sa.Column("revocation_line", sa.BigInteger(), nullable=False, server_default=sa.text("0"))
    )
    op.add_column(
        "counters", sa.Column("revocation_head", sa.String(length=64), nullable=False, server_default=FIRST_HEAD)
    )
    revocations = sa.table("revocations", sa.column("epoch"), sa.column("kind"), sa.column("id"))
    counters = sa.table("counters", sa.column("revocation_head"))
    head, connection = FIRST_HEAD, op.get_bind()
    for epoch, kind, id_ in connection.execute(sa.select(revocations).order_by(revocations.c.epoch)).all():
        head = next_head(head, epoch, kind, id_)
    connection.execute(sa.update(counters).values(revocation_head=head))
