"""Statements of the commands that come most often, built once: building one costs more than the database takes for it.

Their values are given with each execution, under the names of the parameters.
"""

from __future__ import annotations

from typing import Final

import sqlalchemy as sa

from ztpm_idp.domain.conduct import PEERS as PEERS_MOST
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.parties import Standing
from ztpm_idp.store import counters, rows
from ztpm_idp.store import schema as t
from ztpm_idp.store.database.among import among
from ztpm_idp.store.joined import Joined, Portion

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
    sa.select(t.parties.c.id).where(among(t.parties.c.id, "parties")),
    sa.select(t.agents.c.sponsor).where(among(t.agents.c.id, "parties")),
)
PARTIES: Final = rows.PARTY_COLUMNS.where(t.parties.c.id.in_(_NAMED)).order_by(t.parties.c.id)
"""`parties`: these parties, and the sponsors of the agents among them, with the same columns.

Ids first, rows by their index then: of one condition with an `OR` PostgreSQL makes a walk through all parties.
"""
SUSPENDED: Final = (
    sa.select(t.agents.c.id)
    .join_from(t.agents, t.parties, t.parties.c.id == t.agents.c.id)
    .where(
        among(t.agents.c.id, "agents"),
        t.agents.c.suspended_ms.is_not(None),
        t.parties.c.standing != Standing.REVOKED.value,
    )
)
"""`agents`: those of these agents that are suspended."""
NONCES: Final = sa.select(t.nonces.c.nonce, t.nonces.c.agent, t.nonces.c.given_ms, t.nonces.c.spent_on).where(
    among(t.nonces.c.agent, "nonces_of"), t.nonces.c.given_ms >= sa.bindparam("young_ms")
)
"""`nonces_of`, `young_ms`: nonces of these agents given since then."""
FORGET_NONCES: Final = sa.delete(t.nonces).where(
    t.nonces.c.agent == sa.bindparam("agent_"), t.nonces.c.given_ms < sa.bindparam("old_ms")
)
"""`agent_`, `old_ms`: the agent's nonces given before."""
UNSPENT: Final = sa.select(t.nonces.c.nonce).where(among(t.nonces.c.nonce, "ids"), t.nonces.c.spent_on.is_(None))
"""`ids`: those of these nonces that are not spent. On a database with one writer nobody else spends them now."""
SPEND: Final = (
    sa.update(t.nonces).where(t.nonces.c.nonce == sa.bindparam("nonce_")).values(spent_on=sa.bindparam("purpose"))
)
"""`nonce_`, `purpose`: the nonce is spent."""
CONDUCT: Final = sa.select(t.conduct.c.agent, t.conduct.c.trust, t.conduct.c.behaviour, t.conduct.c.restored_at).where(
    among(t.conduct.c.agent, "conduct_of")
)
"""`conduct_of`: conduct of these agents."""
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
_BESIDE: Final = (
    sa.select(t.conduct.c.agent, t.conduct.c.behaviour)
    .select_from(
        _OTHER.join(t.conduct, t.conduct.c.agent == _OTHER.c.id).join(t.parties, t.parties.c.id == _OTHER.c.id)
    )
    .where(
        _OTHER.c.sponsor == _OWN.c.sponsor,
        _OTHER.c.role == _OWN.c.role,
        _OTHER.c.id != _OWN.c.id,
        t.parties.c.standing != Standing.REVOKED.value,
    )
    .order_by(_OTHER.c.id)  # as the index over sponsor and role is, so that the first few are found without the rest
    .limit(PEERS_MOST)
)
PEERS: Final = _BESIDE.where(_OWN.c.id == sa.bindparam("agent_")).add_columns(_OWN.c.id)
"""`agent_`: behaviour of some other living agents of the same sponsor and role, by id; and the agent itself."""
_SOME: Final = _BESIDE.correlate(_OWN).lateral("some")
PEERS_OF_EACH: Final = (
    sa.select(_SOME.c.agent, _SOME.c.behaviour, _OWN.c.id)
    .select_from(_OWN.join(_SOME, sa.true()))
    .where(among(_OWN.c.id, "ids"))
    .order_by(_OWN.c.id, _SOME.c.agent)
)
"""`ids`: the same of each of these agents, where the database knows `LATERAL`."""
REFUSALS: Final = sa.select(t.refusals.c.agent, t.refusals.c.since_ms, t.refusals.c.number).where(
    among(t.refusals.c.agent, "refusals_of")
)  # fmt: skip
"""`refusals_of`: refusals of these agents of late."""
HOPS: Final = sa.select(t.hops.c.hop_id, t.hops.c.token_id, t.hops.c.parent, t.hops.c.agent, t.hops.c.sponsor)
FIRST_HOPS: Final = HOPS.where(among(t.hops.c.token_id, "tokens"), t.hops.c.position == 0)
"""`tokens`: the first hops of these tokens.

Not those without a parent: a small table would be read by the index of all of these, and go on to be when it has grown.
"""
_TREES: Final = (
    sa.select(t.hops.c.token_id, sa.func.count()).where(among(t.hops.c.token_id, "trees")).group_by(t.hops.c.token_id)
)
"""`trees`: number of hops of each of these tokens, where it has any."""
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
MANDATES_OF: Final = MANDATES.where(
    among(_M.agent, "conduct_of"), _M.not_after >= sa.bindparam("since_s"), ~_MANDATE_REVOKED
)
"""`conduct_of`, `since_s`: their mandates that end then or later and are not revoked, with the same columns."""
JOINT: Final = Joined(
    Portion(PARTIES, ("parties",)),
    Portion(NONCES, ("nonces_of",)),
    Portion(REFUSALS, ("refusals_of",)),
    Portion(FIRST_HOPS, ("tokens",)),
    Portion(CONDUCT, ("conduct_of",)),
    Portion(MANDATES_OF, ("conduct_of",)),
    Portion(AMONG, tuple(kind.value for kind in RevocationKind)),
    Portion(SUSPENDED, ("agents",)),
    Portion(counters.READ, ()),
    Portion(_TREES, ("trees",)),
)
"""All that commands of `domain.joint` are decided on, with the parameters of each."""
NEW_NONCE, NEW_HOP, NEW_CONDUCT, NEW_REVOCATION, NEW_ENTRY = (
    sa.insert(table) for table in (t.nonces, t.hops, t.conduct, t.revocations, t.ledger)
)
"""New rows, whose columns are the parameters."""
