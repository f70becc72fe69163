"""The tables of pushes, in the one schema."""

from __future__ import annotations

import sqlalchemy as sa

from ztpm_idp.store.schema import metadata

pushes = sa.Table(
    "pushes",
    metadata,
    sa.Column("matter", sa.String(8), primary_key=True),
    sa.Column("subject_id", sa.String(32), primary_key=True),
    sa.Column("webhook", sa.String(32), primary_key=True),
    sa.Column("event", sa.String(8), primary_key=True),
    sa.Column("tries", sa.Integer, nullable=False),
    sa.Column("begun_ms", sa.BigInteger, nullable=False),
    sa.Column("due_ms", sa.BigInteger, nullable=False, index=True),
    sa.Column("code", sa.String(32), nullable=False),
    sa.Column("done", sa.Boolean, nullable=False),
)
"""Pushes of asks and latches, each once for its webhook and event; no command reads them."""

push_subscriptions = sa.Table(
    "push_subscriptions",
    metadata,
    sa.Column("subscription_id", sa.String(22), primary_key=True),
    sa.Column("session_id", sa.ForeignKey("sessions.session_id", ondelete="CASCADE"), nullable=False, index=True),
    sa.Column("endpoint", sa.Text, nullable=False),
    sa.Column("key", sa.LargeBinary(65), nullable=False),
    sa.Column("secret", sa.LargeBinary(16), nullable=False),
    sa.Column("made_ms", sa.BigInteger, nullable=False),
)
"""Devices that people have told of asks and latches; each is gone with the session in which it was added."""
