"""The tables of OAuth. Of codes and refresh tokens the digest alone is kept."""

from __future__ import annotations

import sqlalchemy as sa

from ztpm_idp.store.schema import metadata

clients = sa.Table(
    "oauth_clients",
    metadata,
    sa.Column("client_id", sa.ForeignKey("parties.id"), primary_key=True),
    sa.Column("name", sa.String(128), nullable=False),
    sa.Column("key", sa.LargeBinary(33), nullable=True, unique=True),
    sa.Column("redirects", sa.JSON, nullable=False),
    sa.Column("registered_ms", sa.BigInteger, nullable=False),
)
"""Registered clients; the id is that of the agent which stands for the client."""

templates = sa.Table(
    "oauth_templates",
    metadata,
    sa.Column("name", sa.String(64), primary_key=True),
    sa.Column("words", sa.String(512), nullable=False),
    sa.Column("audience", sa.String(256), nullable=False, index=True),
    sa.Column("limits", sa.Text, nullable=False),
    sa.Column("declared_by", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("declared_ms", sa.BigInteger, nullable=False),
)

families = sa.Table(
    "oauth_families",
    metadata,
    sa.Column("family", sa.String(32), primary_key=True),
    sa.Column("client_id", sa.String(256), nullable=False),
    sa.Column("agent", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("sponsor", sa.ForeignKey("parties.id"), nullable=False, index=True),
    sa.Column("method", sa.String(64), nullable=False),
    sa.Column("authenticated_at", sa.BigInteger, nullable=False),
    sa.Column("resource", sa.String(256), nullable=False),
    sa.Column("scope", sa.String(1_040), nullable=False),
    sa.Column("limits", sa.Text, nullable=False),
    sa.Column("jkt", sa.String(43), nullable=True),
    sa.Column("not_after", sa.BigInteger, nullable=False, index=True),
    sa.Column("made_ms", sa.BigInteger, nullable=False),
    sa.Column("ended_ms", sa.BigInteger, nullable=True),
)
"""Assents of people, each with all that came of it."""

codes = sa.Table(
    "oauth_codes",
    metadata,
    sa.Column("digest", sa.String(64), primary_key=True),
    sa.Column("family", sa.ForeignKey("oauth_families.family"), nullable=False, unique=True),
    sa.Column("redirect", sa.String(512), nullable=False),
    sa.Column("challenge", sa.String(43), nullable=False),
    sa.Column("given_ms", sa.BigInteger, nullable=False),
    sa.Column("spent_ms", sa.BigInteger, nullable=True),
)

refresh_tokens = sa.Table(
    "oauth_refresh_tokens",
    metadata,
    sa.Column("digest", sa.String(64), primary_key=True),
    sa.Column("family", sa.ForeignKey("oauth_families.family"), nullable=False, index=True),
    sa.Column("made_ms", sa.BigInteger, nullable=False),
    sa.Column("spent_ms", sa.BigInteger, nullable=True),
)

access_tokens = sa.Table(
    "oauth_access_tokens",
    metadata,
    sa.Column("jti", sa.ForeignKey("hops.hop_id"), primary_key=True),
    sa.Column("token_id", sa.String(22), nullable=False),
    sa.Column("family", sa.ForeignKey("oauth_families.family"), nullable=True, index=True),
    sa.Column("client_id", sa.String(256), nullable=False),
    sa.Column("actors", sa.JSON, nullable=False),
    sa.Column("sponsor", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("authenticated_at", sa.BigInteger, nullable=False),
    sa.Column("audience", sa.String(256), nullable=False),
    sa.Column("scope", sa.String(1_040), nullable=False),
    sa.Column("jkt", sa.String(43), nullable=True),
    sa.Column("issued_at", sa.BigInteger, nullable=False),
    sa.Column("not_after", sa.BigInteger, nullable=False, index=True),
    sa.Column("capability", sa.Text, nullable=False),
)
"""Access tokens until they are over, each with the capability behind it, which never leaves but to its audience."""
