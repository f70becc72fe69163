"""Passkeys: further keys of people that an authenticator keeps, and their making."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0019"
down_revision = "v0018"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds empty columns and an empty table: nobody had a passkey before."""
    op.add_column("person_keys", sa.Column("credential", sa.String(length=684), nullable=True))
    op.create_index(op.f("ix_person_keys_credential"), "person_keys", ["credential"], unique=True)
    op.add_column("changes", sa.Column("credential", sa.String(length=684), nullable=True))
    op.create_table(
        "enrolments",
        sa.Column("enrolment_id", sa.String(length=32), nullable=False),
        sa.Column("person", sa.String(length=64), nullable=False),
        sa.Column("expires_ms", sa.BigInteger(), nullable=False),
        sa.Column("credential", sa.String(length=684), nullable=True),
        sa.Column("key", sa.LargeBinary(length=33), nullable=True),
        sa.ForeignKeyConstraint(["person"], ["parties.id"], name=op.f("fk_enrolments_person")),
        sa.PrimaryKeyConstraint("enrolment_id", name=op.f("pk_enrolments")),
    )
    for column in ("person", "expires_ms"):
        op.create_index(op.f(f"ix_enrolments_{column}"), "enrolments", [column], unique=False)
