"""Revocations that no reader takes, which an earlier release acknowledged: told under an id that everybody reads."""

from __future__ import annotations

import hashlib

import sqlalchemy as sa
from alembic import op

from capabilities.statements.revocation import check_id
from capabilities.values.errors import StatementError

revision = "v0006"
down_revision = "v0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Names each non-canonical audience by its digest; no token could name it, and the ledger keeps it."""
    revocations = sa.table(
        "revocations", sa.column("epoch", sa.BigInteger), sa.column("kind", sa.String), sa.column("id", sa.String)
    )
    connection = op.get_bind()
    query = sa.select(revocations.c.epoch, revocations.c.id).where(revocations.c.kind == "audience")
    for epoch, id_ in connection.execute(query).all():
        try:
            check_id("audience", id_)
        except StatementError:
            # `.invalid` is the name of no host (RFC 2606).
            told = f"http://unreadable.invalid/{hashlib.sha256(id_.encode()).hexdigest()}"
            connection.execute(sa.update(revocations).where(revocations.c.epoch == epoch).values(id=told))
