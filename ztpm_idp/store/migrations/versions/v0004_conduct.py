"""Conduct of agents: trust, behaviour, and the published part of both."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0004"
down_revision = "v0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds empty tables of conduct; its first published version is 1."""
    op.create_table(
        "permits",
        sa.Column("pep", sa.String(length=64), nullable=False),
        sa.Column("request_id", sa.String(length=256), nullable=False),
        sa.Column("seq", sa.BigInteger(), nullable=False),
        sa.Column("report", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["pep"], ["parties.id"], name=op.f("fk_permits_pep")),
        sa.PrimaryKeyConstraint("pep", "request_id", name=op.f("pk_permits")),
    )
    op.create_table(
        "conduct",
        sa.Column("agent", sa.String(length=64), nullable=False),
        sa.Column("trust", sa.Text(), nullable=False),
        sa.Column("behaviour", sa.Text(), nullable=False),
        sa.Column("restored_at", sa.BigInteger(), nullable=True),
        sa.Column("standing", sa.Text(), nullable=False),
        sa.Column("version", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["agent"], ["parties.id"], name=op.f("fk_conduct_agent")),
        sa.PrimaryKeyConstraint("agent", name=op.f("pk_conduct")),
    )
    op.create_index(op.f("ix_conduct_version"), "conduct", ["version"], unique=False)
    op.create_table(
        "edges",
        sa.Column("delegator", sa.String(length=64), nullable=False),
        sa.Column("delegate", sa.String(length=64), nullable=False),
        sa.Column("score_permille", sa.Integer(), nullable=False),
        sa.Column("version", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["delegate"], ["parties.id"], name=op.f("fk_edges_delegate")),
        sa.ForeignKeyConstraint(["delegator"], ["parties.id"], name=op.f("fk_edges_delegator")),
        sa.PrimaryKeyConstraint("delegator", "delegate", name=op.f("pk_edges")),
    )
    op.create_index(op.f("ix_edges_delegate"), "edges", ["delegate"], unique=False)
    op.create_index(op.f("ix_edges_version"), "edges", ["version"], unique=False)
    op.add_column(
        "counters", sa.Column("conduct_version", sa.BigInteger(), nullable=False, server_default=sa.text("0"))
    )
