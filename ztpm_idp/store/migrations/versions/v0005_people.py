"""Further keys of people, and changes of people that take two."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0005"
down_revision = "v0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds empty tables: everybody has one key, and no change waits."""
    op.create_table(
        "person_keys",
        sa.Column("key", sa.LargeBinary(length=33), nullable=False),
        sa.Column("thumbprint", sa.String(length=43), nullable=False),
        sa.Column("person", sa.String(length=64), nullable=False),
        sa.Column("added_ms", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["person"], ["parties.id"], name=op.f("fk_person_keys_person")),
        sa.PrimaryKeyConstraint("key", name=op.f("pk_person_keys")),
        sa.UniqueConstraint("thumbprint", name=op.f("uq_person_keys_thumbprint")),
    )
    op.create_index(op.f("ix_person_keys_person"), "person_keys", ["person"], unique=False)
    op.create_table(
        "changes",
        sa.Column("change_id", sa.String(length=32), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("person", sa.String(length=64), nullable=False),
        sa.Column("proposed_by", sa.String(length=64), nullable=False),
        sa.Column("proposed_ms", sa.BigInteger(), nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("roles", sa.JSON(), nullable=False),
        sa.Column("key", sa.LargeBinary(length=33), nullable=True),
        sa.Column("reason", sa.String(length=512), nullable=False),
        sa.Column("ended", sa.String(length=16), nullable=True),
        sa.CheckConstraint("kind IN ('person', 'key', 'end', 'recovery')", name=op.f("ck_changes_kind")),
        sa.CheckConstraint("ended IN ('done', 'declined', 'ended')", name=op.f("ck_changes_ended")),
        sa.PrimaryKeyConstraint("change_id", name=op.f("pk_changes")),
    )
    op.create_index(op.f("ix_changes_proposed_ms"), "changes", ["proposed_ms"], unique=False)
    op.create_table(
        "change_words",
        sa.Column("change_id", sa.String(length=32), nullable=False),
        sa.Column("person", sa.String(length=64), nullable=False),
        sa.Column("word", sa.String(length=16), nullable=False),
        sa.Column("said_ms", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("word IN ('confirmed', 'declined')", name=op.f("ck_change_words_word")),
        sa.ForeignKeyConstraint(["change_id"], ["changes.change_id"], name=op.f("fk_change_words_change_id")),
        sa.ForeignKeyConstraint(["person"], ["parties.id"], name=op.f("fk_change_words_person")),
        sa.PrimaryKeyConstraint("change_id", "person", name=op.f("pk_change_words")),
    )
