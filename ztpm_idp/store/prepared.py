"""Statements of the commands that come most often, built once: building one costs more than the database takes for it.

Their values are given with each execution, under the names of the parameters.
"""

from __future__ import annotations

from typing import Final

import sqlalchemy as sa

from ztpm_idp.domain.conduct import PEERS as PEERS_MOST
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.parties import Standing
from ztpm_idp.store import rows
from ztpm_idp.store import schema as t
from ztpm_idp.store.database.among import among

_SHOWN: Final = sa.union_all(
    sa.select(t.parties.c.key, t.parties.c.id).where(among(t.parties.c.key, "keys")),
    sa.select(t.person_keys.c.key, t.person_keys.c.person).where(among(t.person_keys.c.key, "keys")),
).subquery("shown")
PARTIES_OF_KEYS: Final = (
    rows.PARTY_COLUMNS.add_columns(_SHOWN.c.key.label("shown"))
    .join(_SHOWN, _SHOWN.c.id == t.parties.c.id)
    .order_by(_SHOWN.c.key, t.parties.c.id)
)
"""`keys`: the party whose key each of them is, or was as a person's further one.

Columns are those of `rows.PARTY_COLUMNS`, and the key under `shown`.
"""
_NAMED: Final = sa.union(
    sa.select(t.parties.c.id).where(among(t.parties.c.id, "ids")),
    sa.select(t.agents.c.sponsor).where(among(t.agents.c.id, "ids")),
)
PARTIES: Final = rows.PARTY_COLUMNS.where(t.parties.c.id.in_(_NAMED)).order_by(t.parties.c.id)
"""`ids`: these parties, and the sponsors of the agents among them, with the same columns.

Ids first, rows by their index then: of one condition with an `OR` PostgreSQL makes a walk through all parties.
"""
SUSPENDED: Final = (
    sa.select(t.agents.c.id)
    .join_from(t.agents, t.parties, t.parties.c.id == t.agents.c.id)
    .where(
        among(t.agents.c.id, "ids"),
        t.agents.c.suspended_ms.is_not(None),
        t.parties.c.standing != Standing.REVOKED.value,
    )
)
"""`ids`: those of these agents that are suspended."""
NONCES: Final = sa.select(t.nonces.c.nonce, t.nonces.c.agent, t.nonces.c.given_ms, t.nonces.c.spent_on).where(
    among(t.nonces.c.agent, "ids"), t.nonces.c.given_ms >= sa.bindparam("young_ms")
)
"""`ids`, `young_ms`: nonces of these agents given since then."""
FORGET_NONCES: Final = sa.delete(t.nonces).where(
    t.nonces.c.agent == sa.bindparam("agent_"), t.nonces.c.given_ms < sa.bindparam("old_ms")
)
"""`agent_`, `old_ms`: the agent's nonces given before."""
UNSPENT: Final = (
    sa.select(t.nonces.c.nonce).where(among(t.nonces.c.nonce, "ids"), t.nonces.c.spent_on.is_(None)).with_for_update()
)
"""`ids`: those of these nonces that are not spent, each of which nobody else spends until the transaction ends."""
SPEND: Final = (
    sa.update(t.nonces).where(t.nonces.c.nonce == sa.bindparam("nonce_")).values(spent_on=sa.bindparam("purpose"))
)
"""`nonce_`, `purpose`: the nonce is spent."""
CONDUCT: Final = sa.select(t.conduct.c.agent, t.conduct.c.trust, t.conduct.c.behaviour, t.conduct.c.restored_at).where(
    among(t.conduct.c.agent, "ids")
)
"""`ids`: conduct of these agents."""
STANDING: Final = sa.select(t.conduct.c.agent, t.conduct.c.standing, t.conduct.c.version).where(
    among(t.conduct.c.agent, "ids")
)  # fmt: skip
"""`ids`: what was published of these agents."""
CHANGE_CONDUCT: Final = (
    sa.update(t.conduct)
    .where(t.conduct.c.agent == sa.bindparam("agent_"))
    .values({name: sa.bindparam(name) for name in ("trust", "behaviour", "restored_at", "standing", "version")})
)
"""`agent_` and the columns: its conduct from now on."""
EDGES: Final = sa.select(t.edges.c.delegate, t.edges.c.delegator, t.edges.c.score_permille).where(
    among(t.edges.c.delegate, "ids")
)  # fmt: skip
"""`ids`: edges of these agents."""
_OWN, _OTHER = t.agents.alias("own"), t.agents.alias("other")
PEERS: Final = (
    sa.select(t.conduct.c.agent, t.conduct.c.behaviour)
    .select_from(
        _OWN.join(_OTHER, sa.and_(_OTHER.c.sponsor == _OWN.c.sponsor, _OTHER.c.role == _OWN.c.role))
        .join(t.conduct, t.conduct.c.agent == _OTHER.c.id)
        .join(t.parties, t.parties.c.id == _OTHER.c.id)
    )
    .where(
        _OWN.c.id == sa.bindparam("agent_"),
        _OTHER.c.id != sa.bindparam("agent_"),
        t.parties.c.standing != Standing.REVOKED.value,
    )
    .order_by(_OTHER.c.id)  # as the index over sponsor and role is, so that the first few are found without the rest
    .limit(PEERS_MOST)
)
"""`agent_`: behaviour of some other living agents of the same sponsor and role, by id."""
REFUSALS: Final = sa.select(t.refusals.c.agent, t.refusals.c.since_ms, t.refusals.c.number).where(
    among(t.refusals.c.agent, "ids")
)  # fmt: skip
"""`ids`: refusals of these agents of late."""
HOPS: Final = sa.select(t.hops.c.hop_id, t.hops.c.token_id, t.hops.c.parent, t.hops.c.agent, t.hops.c.sponsor)
FIRST_HOPS: Final = HOPS.where(among(t.hops.c.token_id, "ids"), t.hops.c.parent.is_(None))
"""`ids`: the first hops of these tokens."""
_OF_KIND: Final = sa.or_(
    *(sa.and_(t.revocations.c.kind == kind.value, among(t.revocations.c.id, kind.value)) for kind in RevocationKind)
)
"""Kind by kind, as the index of the table is."""
AMONG: Final = sa.select(t.revocations.c.kind, t.revocations.c.id, t.revocations.c.epoch).where(_OF_KIND)
"""A list of ids under the name of every kind: those that are revoked, with their epochs."""
_MANDATE_REVOKED: Final = (
    sa.select(t.revocations.c.id)
    .where(t.revocations.c.kind == RevocationKind.MANDATE.value, t.revocations.c.id == t.mandates.c.mandate_id)
    .exists()
)
_M: Final = t.mandates.c
MANDATES: Final = sa.select(
    _M.mandate_id, _M.digest, _M.sponsor, _M.agent, _M.key, _M.signed_at, _M.not_after, _M.text, _MANDATE_REVOKED
).order_by(_M.signed_at.desc(), _M.mandate_id)
"""Mandates, the newest first, each with whether it is revoked."""
MANDATES_OF: Final = MANDATES.where(among(_M.agent, "ids"), _M.not_after >= sa.bindparam("since_s"), ~_MANDATE_REVOKED)
"""`ids`, `since_s`: mandates of these agents that end then or later and are not revoked, with the same columns."""
NEW_NONCE, NEW_HOP, NEW_CONDUCT, NEW_REVOCATION, NEW_ENTRY = (
    sa.insert(table) for table in (t.nonces, t.hops, t.conduct, t.revocations, t.ledger)
)
"""New rows, whose columns are the parameters."""
