"""Sessions of people, login links, logins at other providers, device logins and the keys that they bind."""

from __future__ import annotations

import secrets
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "v0013"
down_revision = "v0012"
branch_labels = None
depends_on = None

_PERSON = "parties.id"


def _how() -> list[sa.Column[Any]]:
    """Columns that say how a person was authenticated."""
    return [
        sa.Column("method", sa.String(length=16), nullable=False),
        sa.Column("at_ms", sa.BigInteger(), nullable=False),
        sa.Column("acr", sa.String(length=256), nullable=False),
        sa.Column("amr", sa.JSON(), nullable=False),
        sa.Column("key_shown", sa.String(length=43), nullable=False),
        sa.Column("login", sa.String(length=512), nullable=False),
        sa.Column("roles", sa.JSON(), nullable=False),
    ]


def _person(table: str) -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(["person"], [_PERSON], name=op.f(f"fk_{table}_person"))


def upgrade() -> None:
    """Nobody is logged in, and nobody has a login elsewhere."""
    op.create_table(
        "sessions",
        sa.Column("session_id", sa.String(length=64), nullable=False),
        sa.Column("person", sa.String(length=64), nullable=False),
        *_how(),
        sa.Column("made_ms", sa.BigInteger(), nullable=False),
        sa.Column("seen_ms", sa.BigInteger(), nullable=False),
        sa.Column("ends_ms", sa.BigInteger(), nullable=False),
        sa.Column("wrong", sa.Integer(), nullable=False, server_default="0"),
        _person("sessions"),
        sa.PrimaryKeyConstraint("session_id", name=op.f("pk_sessions")),
    )
    op.create_table(
        "login_offers",
        sa.Column("digest", sa.LargeBinary(length=32), nullable=False),
        sa.Column("person", sa.String(length=64), nullable=False),
        sa.Column("key_shown", sa.String(length=43), nullable=False),
        sa.Column("made_ms", sa.BigInteger(), nullable=False),
        _person("login_offers"),
        sa.PrimaryKeyConstraint("digest", name=op.f("pk_login_offers")),
    )
    op.create_table(
        "person_logins",
        sa.Column("login", sa.String(length=512), nullable=False),
        sa.Column("person", sa.String(length=64), nullable=False),
        sa.Column("added_ms", sa.BigInteger(), nullable=False),
        _person("person_logins"),
        sa.PrimaryKeyConstraint("login", name=op.f("pk_person_logins")),
    )
    op.create_table(
        "device_logins",
        sa.Column("digest", sa.LargeBinary(length=32), nullable=False),
        sa.Column("user_code", sa.String(length=16), nullable=False),
        sa.Column("key", sa.LargeBinary(length=33), nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("address", sa.String(length=64), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("person", sa.String(length=64), nullable=True),
        sa.Column("made_ms", sa.BigInteger(), nullable=False),
        sa.Column("polled_ms", sa.BigInteger(), nullable=False),
        sa.Column("interval_s", sa.Integer(), nullable=False),
        sa.CheckConstraint("state IN ('waiting', 'confirmed', 'declined')", name=op.f("ck_device_logins_state")),
        _person("device_logins"),
        sa.PrimaryKeyConstraint("digest", name=op.f("pk_device_logins")),
        sa.UniqueConstraint("user_code", name=op.f("uq_device_logins_user_code")),
    )
    op.create_table(
        "session_keys",
        sa.Column("key", sa.LargeBinary(length=33), nullable=False),
        sa.Column("thumbprint", sa.String(length=43), nullable=False),
        sa.Column("person", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        *_how(),
        sa.Column("made_ms", sa.BigInteger(), nullable=False),
        sa.Column("ends_ms", sa.BigInteger(), nullable=False),
        _person("session_keys"),
        sa.PrimaryKeyConstraint("key", name=op.f("pk_session_keys")),
        sa.UniqueConstraint("thumbprint", name=op.f("uq_session_keys_thumbprint")),
    )
    for table in ("sessions", "login_offers", "person_logins", "session_keys"):
        op.create_index(op.f(f"ix_{table}_person"), table, ["person"], unique=False)
    op.create_index(op.f("ix_device_logins_made_ms"), "device_logins", ["made_ms"], unique=False)
    secret = op.create_table(
        "login_secret",
        sa.Column("singleton", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("secret", sa.LargeBinary(length=32), nullable=False),
        sa.CheckConstraint("singleton = 1", name=op.f("ck_login_secret_one_row")),
        sa.PrimaryKeyConstraint("singleton", name=op.f("pk_login_secret")),
    )
    op.bulk_insert(secret, [{"singleton": 1, "secret": secrets.token_bytes(32)}])
    _widen_changes()


def _widen_changes() -> None:
    """Lets a change of people be about a login.

    SQLite makes a new table for it, and the rows that point at the old one wait outside.
    """
    connection = op.get_bind()
    words = sa.table("change_words", *map(sa.column, ("change_id", "person", "word", "said_ms")))
    kept = [dict(row._mapping) for row in connection.execute(sa.select(words))]  # noqa: SLF001  SQLAlchemy's name
    connection.execute(sa.delete(words))
    with op.batch_alter_table("changes") as batch:
        batch.drop_constraint(op.f("ck_changes_kind"), type_="check")
        batch.create_check_constraint(op.f("ck_changes_kind"), "kind IN ('person', 'key', 'end', 'recovery', 'login')")
        batch.add_column(sa.Column("login", sa.String(length=512), nullable=False, server_default=""))
    if kept:
        connection.execute(sa.insert(words), kept)
