"""The tables.

An act that may happen once is a primary key or a unique constraint here, so that no race can make it happen twice.
"""

from __future__ import annotations

import sqlalchemy as sa

metadata = sa.MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)

parties = sa.Table(
    "parties",
    metadata,
    sa.Column("id", sa.String(64), primary_key=True),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("key", sa.LargeBinary(32), nullable=False, unique=True),
    sa.Column("thumbprint", sa.String(43), nullable=False, unique=True),
    sa.Column("standing", sa.String(16), nullable=False),
    sa.Column("registered_ms", sa.BigInteger, nullable=False),
    sa.CheckConstraint("kind IN ('person', 'agent', 'pep', 'sensor')", name="kind"),
    sa.CheckConstraint("standing IN ('registered', 'active', 'revoked')", name="standing"),
)

people = sa.Table(
    "people",
    metadata,
    sa.Column("id", sa.ForeignKey("parties.id"), primary_key=True),
    sa.Column("name", sa.String(128), nullable=False),
    sa.Column("roles", sa.JSON, nullable=False),
)

person_keys = sa.Table(
    "person_keys",
    metadata,
    sa.Column("key", sa.LargeBinary(33), primary_key=True),
    sa.Column("thumbprint", sa.String(43), nullable=False, unique=True),
    sa.Column("person", sa.ForeignKey("parties.id"), nullable=False, index=True),
    sa.Column("added_ms", sa.BigInteger, nullable=False),
    sa.Column("credential", sa.String(684), nullable=True, index=True, unique=True),
)
"""Keys that people have beside their first; of a passkey with the id of its credential.

One that is in the revocation index has ended.
"""

changes = sa.Table(
    "changes",
    metadata,
    sa.Column("change_id", sa.String(32), primary_key=True),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("person", sa.String(64), nullable=False),
    sa.Column("proposed_by", sa.String(64), nullable=False),
    sa.Column("proposed_ms", sa.BigInteger, nullable=False, index=True),
    sa.Column("name", sa.String(128), nullable=False),
    sa.Column("roles", sa.JSON, nullable=False),
    sa.Column("key", sa.LargeBinary(33), nullable=True),
    sa.Column("reason", sa.String(512), nullable=False),
    sa.Column("ended", sa.String(16), nullable=True),
    sa.Column("login", sa.String(512), nullable=False, server_default=""),
    sa.Column("credential", sa.String(684), nullable=True),
    sa.Column("by_passkey", sa.Boolean, nullable=False, server_default=sa.false()),
    sa.CheckConstraint("kind IN ('person', 'key', 'end', 'recovery', 'login')", name="kind"),
    sa.CheckConstraint("ended IN ('done', 'declined', 'ended')", name="ended"),
)
"""Changes of people that take two; one of roles is of kind `person` and has no key."""

enrolments = sa.Table(
    "enrolments",
    metadata,
    sa.Column("enrolment_id", sa.String(32), primary_key=True),
    sa.Column("person", sa.ForeignKey("parties.id"), nullable=False, index=True),
    sa.Column("expires_ms", sa.BigInteger, nullable=False, index=True),
    sa.Column("credential", sa.String(684), nullable=True),
    sa.Column("key", sa.LargeBinary(33), nullable=True),
)
"""Passkeys that people are making: with the credential once a browser has made it, until its person proposes it."""

change_words = sa.Table(
    "change_words",
    metadata,
    sa.Column("change_id", sa.ForeignKey("changes.change_id"), primary_key=True),
    sa.Column("person", sa.ForeignKey("parties.id"), primary_key=True),
    sa.Column("word", sa.String(16), nullable=False),
    sa.Column("said_ms", sa.BigInteger, nullable=False),
    sa.CheckConstraint("word IN ('confirmed', 'declined')", name="word"),
)
"""One word of each person on each change."""

agents = sa.Table(
    "agents",
    metadata,
    sa.Column("id", sa.ForeignKey("parties.id"), primary_key=True),
    sa.Column("software_digest", sa.LargeBinary(32), nullable=False),
    sa.Column("model", sa.String(128), nullable=False),
    sa.Column("role", sa.String(64), nullable=False),
    sa.Column("sponsor", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("attested_ms", sa.BigInteger, nullable=True),
    sa.Column("trust_permille", sa.Integer, nullable=True),
    sa.Column("workload", sa.String(256), nullable=True),
    sa.Column("suspended_ms", sa.BigInteger, nullable=True),
    sa.Column("held", sa.Boolean, nullable=False, server_default=sa.false()),
    sa.Index("ix_agents_sponsor", "sponsor", "role", "id"),
)

peps = sa.Table(
    "peps",
    metadata,
    sa.Column("id", sa.ForeignKey("parties.id"), primary_key=True),
    sa.Column("audiences", sa.JSON, nullable=False),
    sa.Column("journal_seq", sa.BigInteger, nullable=False),
    sa.Column("journal_head", sa.String(64), nullable=False),
    sa.Column("heard", sa.Boolean, nullable=False, server_default=sa.true()),
    sa.Column("suspended_ms", sa.BigInteger, nullable=True),
)

sensors = sa.Table(
    "sensors",
    metadata,
    sa.Column("id", sa.ForeignKey("parties.id"), primary_key=True),
    sa.Column("calibration", sa.LargeBinary(32), nullable=False),
    sa.Column("transit_ms", sa.Integer, nullable=False),
    sa.Column("audience", sa.String(256), nullable=False, index=True),
    sa.Column("suspended_ms", sa.BigInteger, nullable=True),
)

former_keys = sa.Table(
    "former_keys",
    metadata,
    sa.Column("key", sa.LargeBinary(33), primary_key=True),
    sa.Column("party", sa.ForeignKey("parties.id"), nullable=False, index=True),
    sa.Column("replaced_ms", sa.BigInteger, nullable=False),
)
"""Keys that parties had before their present one: nobody has them again."""

tools = sa.Table(
    "tools",
    metadata,
    sa.Column("audience", sa.String(256), primary_key=True),
    sa.Column("name", sa.String(64), primary_key=True),
    sa.Column("definition_digest", sa.LargeBinary(32), nullable=False),
    sa.Column("operation", sa.String(64), nullable=False),
    sa.Column("base_tier", sa.Integer, nullable=False),
    sa.Column("suspended_ms", sa.BigInteger, nullable=True),
)

nonces = sa.Table(
    "nonces",
    metadata,
    sa.Column("nonce", sa.String(64), primary_key=True),
    sa.Column("agent", sa.ForeignKey("parties.id"), nullable=False, index=True),
    sa.Column("given_ms", sa.BigInteger, nullable=False),
    sa.Column("spent_on", sa.String(64), nullable=True),
)

spent_credentials = sa.Table(
    "spent_credentials",
    metadata,
    sa.Column("digest", sa.LargeBinary(32), primary_key=True),
    sa.Column("until_ms", sa.BigInteger, nullable=False, index=True),
)

hops = sa.Table(
    "hops",
    metadata,
    sa.Column("hop_id", sa.String(32), primary_key=True),
    sa.Column("token_id", sa.String(22), nullable=False, index=True),
    sa.Column("parent", sa.ForeignKey("hops.hop_id"), nullable=True),
    sa.Column("position", sa.Integer, nullable=False),
    sa.Column("agent", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("sponsor", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("made_ms", sa.BigInteger, nullable=False),
    sa.Column("not_after", sa.BigInteger, nullable=False),
    sa.Column("mandate", sa.String(32), nullable=True, index=True),
)
sa.Index(
    "ix_hops_lent",
    hops.c.sponsor,
    hops.c.not_after,
    hops.c.made_ms,
    sqlite_where=hops.c.parent.is_(None),
    postgresql_where=hops.c.parent.is_(None),
)
"""Hops; a first one names the mandate that its token was drawn from, if any."""

mandates = sa.Table(
    "mandates",
    metadata,
    sa.Column("mandate_id", sa.String(32), primary_key=True),
    sa.Column("digest", sa.String(64), nullable=False),
    sa.Column("sponsor", sa.ForeignKey("parties.id"), nullable=False, index=True),
    sa.Column("agent", sa.ForeignKey("parties.id"), nullable=False, index=True),
    sa.Column("key", sa.String(43), nullable=False, index=True),
    sa.Column("signed_at", sa.BigInteger, nullable=False),
    sa.Column("not_after", sa.BigInteger, nullable=False),
    sa.Column("text", sa.Text, nullable=False),
)

revocations = sa.Table(
    "revocations",
    metadata,
    sa.Column("epoch", sa.BigInteger, primary_key=True, autoincrement=False),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("id", sa.String(256), nullable=False),
    sa.Column("by", sa.String(64), nullable=False),
    sa.Column("reason", sa.String(512), nullable=False),
    sa.Column("at_ms", sa.BigInteger, nullable=False),
    sa.UniqueConstraint("kind", "id"),
)

proofs = sa.Table(
    "proofs",
    metadata,
    sa.Column("key", sa.LargeBinary(32), primary_key=True),
    sa.Column("jti", sa.String(128), primary_key=True),
    sa.Column("forget_ms", sa.BigInteger, nullable=False, index=True),
)

ledger = sa.Table(
    "ledger",
    metadata,
    sa.Column("seq", sa.BigInteger, primary_key=True, autoincrement=False),
    sa.Column("hash", sa.String(64), nullable=False, unique=True),
    sa.Column("line", sa.LargeBinary, nullable=False),
)

records = sa.Table(
    "records",
    metadata,
    sa.Column("pep", sa.ForeignKey("parties.id"), primary_key=True),
    sa.Column("seq", sa.BigInteger, primary_key=True, autoincrement=False),
    sa.Column("hash", sa.String(64), nullable=False),
)

asks = sa.Table(
    "asks",
    metadata,
    sa.Column("ask_id", sa.String(32), primary_key=True),
    sa.Column("nonce", sa.String(32), nullable=False),
    sa.Column("digest", sa.String(64), nullable=False),
    sa.Column("pep", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("audience", sa.String(256), nullable=False),
    sa.Column("agent", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("sponsor", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("approvers", sa.Integer, nullable=False),
    sa.Column("fresh", sa.Boolean, nullable=False),
    sa.Column("asked_at", sa.BigInteger, nullable=False),
    sa.Column("expires_at", sa.BigInteger, nullable=False, index=True),
    sa.Column("taken_ms", sa.BigInteger, nullable=False),
    sa.Column("text", sa.Text, nullable=False),
    sa.Column("trace_id", sa.String(32), nullable=False, server_default=""),
    sa.Column("picture_digest", sa.String(64), nullable=False, server_default=""),
)

votes = sa.Table(
    "votes",
    metadata,
    sa.Column("ask_id", sa.ForeignKey("asks.ask_id"), primary_key=True),
    sa.Column("place", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("approver", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("answer", sa.String(16), nullable=False),
    sa.Column("withdraws", sa.Boolean, nullable=False),
    sa.Column("not_after", sa.BigInteger, nullable=False, index=True),
    sa.Column("cast_ms", sa.BigInteger, nullable=False),
    sa.Column("text", sa.Text, nullable=False),
    sa.UniqueConstraint("ask_id", "approver", "withdraws"),
    sa.CheckConstraint("answer IN ('approve', 'deny', 'withdraw')", name="answer"),
)
"""One answer of each person to each ask, and one withdrawal of it."""

openings = sa.Table(
    "openings",
    metadata,
    sa.Column("opening_id", sa.String(32), primary_key=True),
    sa.Column("digest", sa.String(64), nullable=False),
    sa.Column("opener", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("audience", sa.String(256), nullable=False),
    sa.Column("agent", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("object", sa.String(256), nullable=False),
    sa.Column("operation", sa.String(256), nullable=False),
    sa.Column("not_before", sa.BigInteger, nullable=False),
    sa.Column("not_after", sa.BigInteger, nullable=False, index=True),
    sa.Column("made_ms", sa.BigInteger, nullable=False),
    sa.Column("closed_ms", sa.BigInteger, nullable=True),
    sa.Column("closed_by", sa.ForeignKey("parties.id"), nullable=True),
    sa.Column("closed_reason", sa.String(512), nullable=True),
    sa.Column("text", sa.Text, nullable=False),
)

envelopes = sa.Table(
    "envelopes",
    metadata,
    sa.Column("envelope_id", sa.String(32), primary_key=True),
    sa.Column("digest", sa.String(64), nullable=False),
    sa.Column("approver", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("audience", sa.String(256), nullable=False),
    sa.Column("agent", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("not_before", sa.BigInteger, nullable=False),
    sa.Column("not_after", sa.BigInteger, nullable=False, index=True),
    sa.Column("signed_ms", sa.BigInteger, nullable=False),
    sa.Column("revoked_ms", sa.BigInteger, nullable=True),
    sa.Column("revoked_by", sa.String(64), nullable=True),
    sa.Column("revoked_reason", sa.String(512), nullable=True),
    sa.Column("text", sa.Text, nullable=False),
)

latches = sa.Table(
    "latches",
    metadata,
    sa.Column("latch_id", sa.String(32), primary_key=True),
    sa.Column("digest", sa.String(64), nullable=False),
    sa.Column("pep", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("audience", sa.String(256), nullable=False, index=True),
    sa.Column("robot", sa.String(256), nullable=False),
    sa.Column("cause", sa.String(64), nullable=False),
    sa.Column("approvers", sa.Integer, nullable=False),
    sa.Column("at", sa.BigInteger, nullable=False),
    sa.Column("told_ms", sa.BigInteger, nullable=False),
    sa.Column("released_ms", sa.BigInteger, nullable=True),
    sa.Column("text", sa.Text, nullable=False),
)

latch_clearings = sa.Table(
    "latch_clearings",
    metadata,
    sa.Column("latch_id", sa.ForeignKey("latches.latch_id"), primary_key=True),
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("approver", sa.ForeignKey("parties.id"), nullable=False),
    sa.Column("not_after", sa.BigInteger, nullable=False, index=True),
    sa.Column("latch_digest", sa.String(64), nullable=False),
    sa.Column("signed_ms", sa.BigInteger, nullable=False),
    sa.Column("text", sa.Text, nullable=False),
)

refusals = sa.Table(
    "refusals",
    metadata,
    sa.Column("agent", sa.ForeignKey("parties.id"), primary_key=True),
    sa.Column("since_ms", sa.BigInteger, nullable=False),
    sa.Column("number", sa.Integer, nullable=False),
)
"""Refusals of each agent in its newest window."""

permits = sa.Table(
    "permits",
    metadata,
    sa.Column("pep", sa.ForeignKey("parties.id"), primary_key=True),
    sa.Column("request_id", sa.String(256), primary_key=True),
    sa.Column("seq", sa.BigInteger, nullable=False),
    sa.Column("report", sa.Text, nullable=False),
)
"""PERMITs in enforcement points' journals that have no outcome yet."""

conduct = sa.Table(
    "conduct",
    metadata,
    sa.Column("agent", sa.ForeignKey("parties.id"), primary_key=True),
    sa.Column("trust", sa.Text, nullable=False),
    sa.Column("behaviour", sa.Text, nullable=False),
    sa.Column("restored_at", sa.BigInteger, nullable=True),
    sa.Column("standing", sa.Text, nullable=False),
    sa.Column("version", sa.BigInteger, nullable=False, index=True),
)
"""Conduct of each reported agent: the reducers' states, the published standing, and its version.

The version is the one at which the standing was new; 0 while there is nothing to publish.
"""

edges = sa.Table(
    "edges",
    metadata,
    sa.Column("delegator", sa.ForeignKey("parties.id"), primary_key=True),
    sa.Column("delegate", sa.ForeignKey("parties.id"), primary_key=True, index=True),
    sa.Column("score_permille", sa.Integer, nullable=False),
    sa.Column("version", sa.BigInteger, nullable=False, index=True),
)
"""Trust in each edge that was ever below the prior, and the version at which that was new."""

counters = sa.Table(
    "counters",
    metadata,
    sa.Column("singleton", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("epoch", sa.BigInteger, nullable=False),
    sa.Column("registry_version", sa.BigInteger, nullable=False),
    sa.Column("ledger_size", sa.BigInteger, nullable=False),
    sa.Column("ledger_head", sa.String(64), nullable=False),
    sa.Column("conduct_version", sa.BigInteger, nullable=False, server_default="0"),
    sa.Column("revocation_line", sa.BigInteger, nullable=False, server_default="0"),
    sa.Column("revocation_head", sa.String(64), nullable=False, server_default="0" * 64),
    sa.Column("restoring", sa.Boolean, nullable=False, server_default=sa.false()),
    sa.CheckConstraint("singleton = 1", name="one_row"),
)
"""One row.

A transaction locks it for its last statements, when it appends to the ledger: epochs, versions and entries come in
commit order, and what goes before them runs side by side.
"""

heartbeat = sa.Table(
    "heartbeat",
    metadata,
    sa.Column("singleton", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("beats", sa.BigInteger, nullable=False),
    sa.CheckConstraint("singleton = 1", name="one_row"),
)
"""One row, which is changed to see that the store can commit; it stands in nobody's way."""
ledger_tiles = sa.Table(
    "ledger_tiles",
    metadata,
    sa.Column("level", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("place", sa.BigInteger, primary_key=True, autoincrement=False),
    sa.Column("hashes", sa.LargeBinary, nullable=False),
)
"""Hashes of the tree over the ledger, at most 256 side by side in a row.

Level 0 has those of entries, level 1 those of 256 entries each, and so on. The last row of a level may be shorter.
"""

ledger_index = sa.Table(
    "ledger_index",
    metadata,
    sa.Column("seq", sa.BigInteger, primary_key=True, autoincrement=False),
    sa.Column("at_ms", sa.BigInteger, nullable=False),
    sa.Column("kind", sa.String(32), nullable=False),
    sa.Column("actor", sa.String(256), nullable=False),
    sa.Column("agent", sa.String(256), nullable=True),
    sa.Column("token", sa.String(256), nullable=True),
    sa.Column("object", sa.String(256), nullable=True),
    sa.Column("request", sa.String(256), nullable=True),
    sa.Column("trace", sa.String(256), nullable=True),
    sa.Column("effect", sa.String(256), nullable=True),
)
"""The ledger by what its entries are about; made of the entries alone, and never signed."""
for _column in ("at_ms", "kind", "actor", "agent", "token", "object", "request", "trace"):
    sa.Index(f"ix_ledger_index_{_column}_seq", ledger_index.c[_column], ledger_index.c.seq)

ledger_followed = sa.Table(
    "ledger_followed",
    metadata,
    sa.Column("singleton", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("size", sa.BigInteger, nullable=False),
    sa.CheckConstraint("singleton = 1", name="one_row"),
)
"""One row: number of entries that are in the tree and in the index. No command reads or locks it."""

feed_points = sa.Table(
    "feed_points",
    metadata,
    sa.Column("pep", sa.ForeignKey("parties.id"), primary_key=True),
    sa.Column("line", sa.BigInteger, nullable=False),
    sa.Column("epoch", sa.BigInteger, nullable=False),
    sa.Column("confirmed_ms", sa.BigInteger, nullable=False),
    sa.Column("heard_ms", sa.BigInteger, nullable=False),
)
"""The highest mark of each enforcement point, when it came, and when the point was heard last."""
