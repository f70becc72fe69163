"""The table of pictures, in the one schema."""

from __future__ import annotations

import sqlalchemy as sa

from ztpm_idp.store.schema import metadata

pictures = sa.Table(
    "pictures",
    metadata,
    sa.Column("digest", sa.String(64), primary_key=True),
    sa.Column("since_ms", sa.BigInteger, nullable=False),
    sa.Column("bytes", sa.Integer, nullable=False),
    sa.Column("packed", sa.LargeBinary, nullable=False),
    sa.Index("ix_pictures_since_ms", "since_ms", "digest", "bytes"),
)
"""Texts of pictures by their SHA-256, deflated; empty, of no bytes, while one is only named by a record.

The index has all that is asked about what is to be forgotten: it reads no text.
"""
