"""The tables of logging in, in the one schema."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa

from ztpm_idp.store.schema import metadata


def _how() -> list[sa.Column[Any]]:
    """Columns that say how a person was authenticated, and the most roles that follow."""
    return [
        sa.Column("method", sa.String(16), nullable=False),
        sa.Column("at_ms", sa.BigInteger, nullable=False),
        sa.Column("acr", sa.String(256), nullable=False),
        sa.Column("amr", sa.JSON, nullable=False),
        sa.Column("key_shown", sa.String(43), nullable=False),
        sa.Column("login", sa.String(512), nullable=False),
        sa.Column("roles", sa.JSON, nullable=False),
    ]


sessions = sa.Table(
    "sessions",
    metadata,
    sa.Column("session_id", sa.String(64), primary_key=True),
    sa.Column("person", sa.ForeignKey("parties.id"), nullable=False, index=True),
    *_how(),
    sa.Column("made_ms", sa.BigInteger, nullable=False),
    sa.Column("seen_ms", sa.BigInteger, nullable=False),
    sa.Column("ends_ms", sa.BigInteger, nullable=False),
    sa.Column("wrong", sa.Integer, nullable=False, server_default="0"),
)
"""Sessions in browsers, by the digest of what the cookie holds."""

login_offers = sa.Table(
    "login_offers",
    metadata,
    sa.Column("digest", sa.LargeBinary(32), primary_key=True),
    sa.Column("person", sa.ForeignKey("parties.id"), nullable=False, index=True),
    sa.Column("key_shown", sa.String(43), nullable=False),
    sa.Column("made_ms", sa.BigInteger, nullable=False),
)
"""Login links that were not opened yet."""

person_logins = sa.Table(
    "person_logins",
    metadata,
    sa.Column("login", sa.String(512), primary_key=True),
    sa.Column("person", sa.ForeignKey("parties.id"), nullable=False, index=True),
    sa.Column("added_ms", sa.BigInteger, nullable=False),
)
"""Logins of people at other providers: issuer and subject, with a space between."""

device_logins = sa.Table(
    "device_logins",
    metadata,
    sa.Column("digest", sa.LargeBinary(32), primary_key=True),
    sa.Column("user_code", sa.String(16), nullable=False, unique=True),
    sa.Column("key", sa.LargeBinary(33), nullable=False),
    sa.Column("name", sa.String(128), nullable=False),
    sa.Column("address", sa.String(64), nullable=False),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("person", sa.ForeignKey("parties.id"), nullable=True),
    sa.Column("made_ms", sa.BigInteger, nullable=False, index=True),
    sa.Column("polled_ms", sa.BigInteger, nullable=False),
    sa.Column("interval_s", sa.Integer, nullable=False),
    sa.CheckConstraint("state IN ('waiting', 'confirmed', 'declined')", name="state"),
)
"""Devices that wait for a person to confirm their key."""

session_keys = sa.Table(
    "session_keys",
    metadata,
    sa.Column("key", sa.LargeBinary(33), primary_key=True),
    sa.Column("thumbprint", sa.String(43), nullable=False, unique=True),
    sa.Column("person", sa.ForeignKey("parties.id"), nullable=False, index=True),
    sa.Column("name", sa.String(128), nullable=False),
    *_how(),
    sa.Column("made_ms", sa.BigInteger, nullable=False),
    sa.Column("ends_ms", sa.BigInteger, nullable=False),
)
"""Keys of command lines that a person confirmed, each for some hours."""

login_secret = sa.Table(
    "login_secret",
    metadata,
    sa.Column("singleton", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("secret", sa.LargeBinary(32), nullable=False),
    sa.CheckConstraint("singleton = 1", name="one_row"),
)
"""Secret that all workers share, under which a browser keeps what a login began with."""
