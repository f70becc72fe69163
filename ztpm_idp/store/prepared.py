"""Statements of the commands that come most often, built once: building one costs more than the database takes for it.

Their values are given with each execution, under the names of the parameters.
"""

from __future__ import annotations

from typing import Any, Final

import sqlalchemy as sa

from ztpm_idp.domain.parties import Standing
from ztpm_idp.store import rows
from ztpm_idp.store import schema as t

_KEY: Final[sa.BindParameter[Any]] = sa.bindparam("key_", type_=t.parties.c.key.type)
_IDS: Final[sa.BindParameter[Any]] = sa.bindparam("ids", expanding=True)

PARTY_OF_KEY: Final = rows.PARTY_COLUMNS.where(
    sa.or_(
        t.parties.c.key == _KEY,
        t.parties.c.id.in_(sa.select(t.person_keys.c.person).where(t.person_keys.c.key == _KEY)),
    )
).order_by(t.parties.c.id)
"""`key_`: the party whose key it is, with the columns of `rows.PARTY_COLUMNS`."""
PARTIES: Final = rows.PARTY_COLUMNS.where(
    sa.or_(t.parties.c.id.in_(_IDS), t.parties.c.id.in_(sa.select(t.agents.c.sponsor).where(t.agents.c.id.in_(_IDS))))
).order_by(t.parties.c.id)
"""`ids`: these parties, and the sponsors of the agents among them, with the same columns."""
SUSPENDED: Final = (
    sa.select(t.agents.c.id)
    .join_from(t.agents, t.parties, t.parties.c.id == t.agents.c.id)
    .where(
        t.agents.c.id.in_(_IDS), t.agents.c.suspended_ms.is_not(None), t.parties.c.standing != Standing.REVOKED.value
    )
)
"""`ids`: those of these agents that are suspended."""
NONCES: Final = sa.select(t.nonces.c.nonce, t.nonces.c.agent, t.nonces.c.given_ms, t.nonces.c.spent_on).where(
    t.nonces.c.agent == sa.bindparam("agent_"), t.nonces.c.given_ms >= sa.bindparam("young_ms")
)
"""`agent_`, `young_ms`: the agent's nonces given since then."""
FORGET_NONCES: Final = sa.delete(t.nonces).where(
    t.nonces.c.agent == sa.bindparam("agent_"), t.nonces.c.given_ms < sa.bindparam("old_ms")
)
"""`agent_`, `old_ms`: the agent's nonces given before."""
SPEND: Final = (
    sa.update(t.nonces)
    .where(t.nonces.c.nonce == sa.bindparam("nonce_"), t.nonces.c.spent_on.is_(None))
    .values(spent_on=sa.bindparam("purpose"))
)
"""`nonce_`, `purpose`: the nonce is spent, where it was not."""
CONDUCT: Final = sa.select(t.conduct.c.agent, t.conduct.c.trust, t.conduct.c.behaviour, t.conduct.c.restored_at).where(
    t.conduct.c.agent.in_(_IDS)
)
"""`ids`: conduct of these agents."""
STANDING: Final = sa.select(t.conduct.c.standing, t.conduct.c.version).where(
    t.conduct.c.agent == sa.bindparam("agent_")
)  # fmt: skip
"""`agent_`: what was published of it."""
EDGES: Final = sa.select(t.edges.c.delegator, t.edges.c.score_permille).where(
    t.edges.c.delegate == sa.bindparam("agent_")
)  # fmt: skip
"""`agent_`: its edges."""
REFUSALS: Final = sa.select(t.refusals.c.since_ms, t.refusals.c.number).where(
    t.refusals.c.agent == sa.bindparam("agent_")
)  # fmt: skip
"""`agent_`: its refusals of late."""
FIRST_HOP: Final = sa.select(
    t.hops.c.hop_id, t.hops.c.token_id, t.hops.c.parent, t.hops.c.agent, t.hops.c.sponsor
).where(t.hops.c.token_id == sa.bindparam("token"), t.hops.c.parent.is_(None))
"""`token`: the first hop of a token."""
REVOKED_AT: Final = sa.select(t.revocations.c.epoch).where(
    t.revocations.c.kind == sa.bindparam("kind_"), t.revocations.c.id == sa.bindparam("id_")
)  # fmt: skip
"""`kind_`, `id_`: the epoch at which it was revoked."""
NEW_NONCE, NEW_HOP, NEW_CONDUCT, NEW_REVOCATION, NEW_ENTRY = (
    sa.insert(table) for table in (t.nonces, t.hops, t.conduct, t.revocations, t.ledger)
)
"""New rows, whose columns are the parameters."""
