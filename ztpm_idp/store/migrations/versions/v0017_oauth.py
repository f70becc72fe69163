"""Clients, scope templates, codes and tokens of OAuth."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0017"
down_revision = "v0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds empty tables."""
    _clients()
    _families()
    _tokens()


def _clients() -> None:
    op.create_table(
        "oauth_clients",
        sa.Column("client_id", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("key", sa.LargeBinary(length=33), nullable=True),
        sa.Column("redirects", sa.JSON(), nullable=False),
        sa.Column("registered_ms", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["client_id"], ["parties.id"], name=op.f("fk_oauth_clients_client_id")),
        sa.PrimaryKeyConstraint("client_id", name=op.f("pk_oauth_clients")),
        sa.UniqueConstraint("key", name=op.f("uq_oauth_clients_key")),
    )
    op.create_table(
        "oauth_templates",
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("words", sa.String(length=512), nullable=False),
        sa.Column("audience", sa.String(length=256), nullable=False),
        sa.Column("limits", sa.Text(), nullable=False),
        sa.Column("declared_by", sa.String(length=64), nullable=False),
        sa.Column("declared_ms", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["declared_by"], ["parties.id"], name=op.f("fk_oauth_templates_declared_by")),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_oauth_templates")),
    )
    op.create_index(op.f("ix_oauth_templates_audience"), "oauth_templates", ["audience"], unique=False)


def _families() -> None:
    op.create_table(
        "oauth_families",
        sa.Column("family", sa.String(length=32), nullable=False),
        sa.Column("client_id", sa.String(length=256), nullable=False),
        sa.Column("agent", sa.String(length=64), nullable=False),
        sa.Column("sponsor", sa.String(length=64), nullable=False),
        sa.Column("method", sa.String(length=64), nullable=False),
        sa.Column("authenticated_at", sa.BigInteger(), nullable=False),
        sa.Column("resource", sa.String(length=256), nullable=False),
        sa.Column("scope", sa.String(length=1_040), nullable=False),
        sa.Column("limits", sa.Text(), nullable=False),
        sa.Column("jkt", sa.String(length=43), nullable=True),
        sa.Column("not_after", sa.BigInteger(), nullable=False),
        sa.Column("made_ms", sa.BigInteger(), nullable=False),
        sa.Column("ended_ms", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(["agent"], ["parties.id"], name=op.f("fk_oauth_families_agent")),
        sa.ForeignKeyConstraint(["sponsor"], ["parties.id"], name=op.f("fk_oauth_families_sponsor")),
        sa.PrimaryKeyConstraint("family", name=op.f("pk_oauth_families")),
    )
    for column in ("sponsor", "not_after"):
        op.create_index(op.f(f"ix_oauth_families_{column}"), "oauth_families", [column], unique=False)
    op.create_table(
        "oauth_codes",
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("family", sa.String(length=32), nullable=False),
        sa.Column("redirect", sa.String(length=512), nullable=False),
        sa.Column("challenge", sa.String(length=43), nullable=False),
        sa.Column("given_ms", sa.BigInteger(), nullable=False),
        sa.Column("spent_ms", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(["family"], ["oauth_families.family"], name=op.f("fk_oauth_codes_family")),
        sa.PrimaryKeyConstraint("digest", name=op.f("pk_oauth_codes")),
        sa.UniqueConstraint("family", name=op.f("uq_oauth_codes_family")),
    )


def _tokens() -> None:
    op.create_table(
        "oauth_refresh_tokens",
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("family", sa.String(length=32), nullable=False),
        sa.Column("made_ms", sa.BigInteger(), nullable=False),
        sa.Column("spent_ms", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(["family"], ["oauth_families.family"], name=op.f("fk_oauth_refresh_tokens_family")),
        sa.PrimaryKeyConstraint("digest", name=op.f("pk_oauth_refresh_tokens")),
    )
    op.create_index(op.f("ix_oauth_refresh_tokens_family"), "oauth_refresh_tokens", ["family"], unique=False)
    op.create_table(
        "oauth_access_tokens",
        sa.Column("jti", sa.String(length=32), nullable=False),
        sa.Column("token_id", sa.String(length=22), nullable=False),
        sa.Column("family", sa.String(length=32), nullable=True),
        sa.Column("client_id", sa.String(length=256), nullable=False),
        sa.Column("actors", sa.JSON(), nullable=False),
        sa.Column("sponsor", sa.String(length=64), nullable=False),
        sa.Column("authenticated_at", sa.BigInteger(), nullable=False),
        sa.Column("audience", sa.String(length=256), nullable=False),
        sa.Column("scope", sa.String(length=1_040), nullable=False),
        sa.Column("jkt", sa.String(length=43), nullable=True),
        sa.Column("issued_at", sa.BigInteger(), nullable=False),
        sa.Column("not_after", sa.BigInteger(), nullable=False),
        sa.Column("capability", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["jti"], ["hops.hop_id"], name=op.f("fk_oauth_access_tokens_jti")),
        sa.ForeignKeyConstraint(["family"], ["oauth_families.family"], name=op.f("fk_oauth_access_tokens_family")),
        sa.ForeignKeyConstraint(["sponsor"], ["parties.id"], name=op.f("fk_oauth_access_tokens_sponsor")),
        sa.PrimaryKeyConstraint("jti", name=op.f("pk_oauth_access_tokens")),
    )
    for column in ("family", "not_after"):
        op.create_index(op.f(f"ix_oauth_access_tokens_{column}"), "oauth_access_tokens", [column], unique=False)
