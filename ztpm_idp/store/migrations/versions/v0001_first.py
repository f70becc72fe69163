"""The first schema."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "v0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Creates the first schema."""
    op.create_table(
        "counters",
        sa.Column("singleton", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("epoch", sa.BigInteger(), nullable=False),
        sa.Column("registry_version", sa.BigInteger(), nullable=False),
        sa.Column("ledger_size", sa.BigInteger(), nullable=False),
        sa.Column("ledger_head", sa.String(length=64), nullable=False),
        sa.Column("beats", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("singleton = 1", name=op.f("ck_counters_one_row")),
        sa.PrimaryKeyConstraint("singleton", name=op.f("pk_counters")),
    )
    op.create_table(
        "ledger",
        sa.Column("seq", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.Column("line", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("seq", name=op.f("pk_ledger")),
        sa.UniqueConstraint("hash", name=op.f("uq_ledger_hash")),
    )
    op.create_table(
        "parties",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("key", sa.LargeBinary(length=32), nullable=False),
        sa.Column("thumbprint", sa.String(length=43), nullable=False),
        sa.Column("standing", sa.String(length=16), nullable=False),
        sa.Column("registered_ms", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("kind IN ('person', 'agent', 'pep', 'sensor')", name=op.f("ck_parties_kind")),
        sa.CheckConstraint("standing IN ('registered', 'active', 'revoked')", name=op.f("ck_parties_standing")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_parties")),
        sa.UniqueConstraint("key", name=op.f("uq_parties_key")),
        sa.UniqueConstraint("thumbprint", name=op.f("uq_parties_thumbprint")),
    )
    op.create_table(
        "proofs",
        sa.Column("key", sa.LargeBinary(length=32), nullable=False),
        sa.Column("jti", sa.String(length=128), nullable=False),
        sa.Column("forget_ms", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("key", "jti", name=op.f("pk_proofs")),
    )
    op.create_index(op.f("ix_proofs_forget_ms"), "proofs", ["forget_ms"], unique=False)
    op.create_table(
        "revocations",
        sa.Column("epoch", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("id", sa.String(length=256), nullable=False),
        sa.Column("by", sa.String(length=64), nullable=False),
        sa.Column("reason", sa.String(length=512), nullable=False),
        sa.Column("at_ms", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("epoch", name=op.f("pk_revocations")),
        sa.UniqueConstraint("kind", "id", name=op.f("uq_revocations_kind_id")),
    )
    op.create_table(
        "tools",
        sa.Column("audience", sa.String(length=256), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("definition_digest", sa.LargeBinary(length=32), nullable=False),
        sa.Column("operation", sa.String(length=64), nullable=False),
        sa.Column("base_tier", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("audience", "name", name=op.f("pk_tools")),
    )
    op.create_table(
        "agents",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("software_digest", sa.LargeBinary(length=32), nullable=False),
        sa.Column("model", sa.String(length=128), nullable=False),
        sa.Column("role", sa.String(length=64), nullable=False),
        sa.Column("sponsor", sa.String(length=64), nullable=False),
        sa.Column("attested_ms", sa.BigInteger(), nullable=True),
        sa.Column("trust_permille", sa.Integer(), nullable=True),
        sa.ForeignKeyConstraint(["id"], ["parties.id"], name=op.f("fk_agents_id")),
        sa.ForeignKeyConstraint(["sponsor"], ["parties.id"], name=op.f("fk_agents_sponsor")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_agents")),
    )
    op.create_table(
        "hops",
        sa.Column("hop_id", sa.String(length=32), nullable=False),
        sa.Column("token_id", sa.String(length=22), nullable=False),
        sa.Column("parent", sa.String(length=32), nullable=True),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("agent", sa.String(length=64), nullable=False),
        sa.Column("sponsor", sa.String(length=64), nullable=False),
        sa.Column("made_ms", sa.BigInteger(), nullable=False),
        sa.Column("not_after", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["agent"], ["parties.id"], name=op.f("fk_hops_agent")),
        sa.ForeignKeyConstraint(["parent"], ["hops.hop_id"], name=op.f("fk_hops_parent")),
        sa.ForeignKeyConstraint(["sponsor"], ["parties.id"], name=op.f("fk_hops_sponsor")),
        sa.PrimaryKeyConstraint("hop_id", name=op.f("pk_hops")),
    )
    op.create_index(op.f("ix_hops_token_id"), "hops", ["token_id"], unique=False)
    op.create_table(
        "nonces",
        sa.Column("nonce", sa.String(length=64), nullable=False),
        sa.Column("agent", sa.String(length=64), nullable=False),
        sa.Column("given_ms", sa.BigInteger(), nullable=False),
        sa.Column("spent_on", sa.String(length=64), nullable=True),
        sa.ForeignKeyConstraint(["agent"], ["parties.id"], name=op.f("fk_nonces_agent")),
        sa.PrimaryKeyConstraint("nonce", name=op.f("pk_nonces")),
    )
    op.create_index(op.f("ix_nonces_agent"), "nonces", ["agent"], unique=False)
    op.create_table(
        "people",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("roles", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(["id"], ["parties.id"], name=op.f("fk_people_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_people")),
    )
    op.create_table(
        "peps",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("audiences", sa.JSON(), nullable=False),
        sa.Column("journal_seq", sa.BigInteger(), nullable=False),
        sa.Column("journal_head", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(["id"], ["parties.id"], name=op.f("fk_peps_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_peps")),
    )
    op.create_table(
        "records",
        sa.Column("pep", sa.String(length=64), nullable=False),
        sa.Column("seq", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(["pep"], ["parties.id"], name=op.f("fk_records_pep")),
        sa.PrimaryKeyConstraint("pep", "seq", name=op.f("pk_records")),
    )
    op.create_table(
        "sensors",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("calibration", sa.LargeBinary(length=32), nullable=False),
        sa.Column("transit_ms", sa.Integer(), nullable=False),
        sa.Column("audience", sa.String(length=256), nullable=False),
        sa.ForeignKeyConstraint(["id"], ["parties.id"], name=op.f("fk_sensors_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_sensors")),
    )
    op.create_index(op.f("ix_sensors_audience"), "sensors", ["audience"], unique=False)
    op.execute(
        sa.text(
            "INSERT INTO counters (singleton, epoch, registry_version, ledger_size, ledger_head, beats) "
            "VALUES (1, 0, 0, 0, '" + "0" * 64 + "', 0)"
        )
    )
