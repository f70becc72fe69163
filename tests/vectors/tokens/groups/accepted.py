"""Whole chains as `mint` and `delegate` write them: each field of the result, at every length."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from capabilities.statements.revocation import RevocationView
from capabilities.token.delegate import delegate
from capabilities.token.mint import mint
from capabilities.token.verify import verify
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Attestation, Chain, EvidenceKind, HopGrant, Sponsor
from capabilities.values.scope import Range, Restriction, Scope, Tier
from tests.vectors.tokens.cases import Accepted, Case, Group, group
from tests.vectors.tokens.groups.chain import child_of, moved
from tests.vectors.tokens.ordinary import (
    AUTHENTICATED_AT,
    CELL,
    ISSUER,
    LESS,
    NOW,
    ROOT_ID,
    SCOPE,
    SLOWER,
    SMALL,
    TOKEN_ID,
    TRUST,
    hop_id_of,
)
from tests.vectors.tokens.sealing import key_of, raw_of


def granted(agent: str, delegator: str, **other: Any) -> HopGrant:
    hop = HopGrant(
        hop_id=hop_id_of(agent).hex(),
        agent=agent,
        key=raw_of(agent),
        delegator=delegator,
        purpose="pick the red part",
        request_digest=b"\1" * 32,
        attestation=Attestation(EvidenceKind.KEY, b"\2" * 32, NOW - 10),
    )
    return replace(hop, **other)


def first(scope: Scope = SCOPE, **other: Any) -> bytes:
    return mint(
        root=key_of("root"),
        root_key_id=ROOT_ID,
        token_id=TOKEN_ID,
        sponsor=Sponsor(ISSUER, "alice", "operator-key", AUTHENTICATED_AT),
        hop=granted("orchestrator", "alice", **other),
        scope=scope,
        caps=DEFAULT,
    )


def added(token: bytes, agent: str, restriction: Restriction, attester: str = "attester", **other: Any) -> bytes:
    trust = TRUST["ordinary"]
    view = RevocationView(0, 0, frozenset())
    chain = verify(token, at=NOW, audience=CELL, view=view, lease_ms=0, trust=trust, caps=DEFAULT)
    assert isinstance(chain, Chain), chain
    return delegate(
        token,
        chain=chain,
        attester=key_of(attester),
        trust=trust,
        hop=granted(agent, chain.leaf.agent, **other),
        restriction=restriction,
        caps=DEFAULT,
    )


AGENTS = tuple(f"agent-{i}" for i in range(1, 9))
DEEP = replace(SMALL, depth=8, delegates=frozenset({*AGENTS, "spare"}))


def deep(hops: int) -> bytes:
    token = first(DEEP)
    for i, agent in enumerate(AGENTS[:hops]):
        token = added(token, agent, Restriction(delegates=frozenset({*AGENTS[i + 1 :], "spare"})))
    return token


def left(hops: int) -> Scope:
    return replace(DEEP, depth=8 - hops, delegates=frozenset({*AGENTS[hops:], "spare"}))


def team() -> bytes:
    token = added(first(), "robotic", SLOWER, role="planner", purpose="fetch \u201cM6\u201d screws")
    token = added(
        token,
        "vision",
        Restriction(audiences=frozenset({CELL}), delegates=frozenset({"gripper"}), not_after=NOW + 900, depth=1),
        attester="attester-2",
        attestation=Attestation(EvidenceKind.JWT, bytes(range(32)), NOW - 1),
    )
    return added(
        token, "gripper", replace(LESS, delegates=frozenset()), request_digest=bytes(range(32, 64)), purpose=""
    )


TEAM = child_of(
    SCOPE,
    grants=(moved(speed=Range(1, 500_000))[0], *SCOPE.grants[2:]),
    ceiling=Tier.NO_EFFECT,
    audiences=frozenset({CELL}),
    delegates=frozenset(),
    depth=0,
    not_after=NOW + 900,
)

ACCEPTED = group(
    "accepted",
    "Tokens as the library mints them, whole: every field of the result is compared.",
    Case("One holder", "TOK-6", first, Accepted(SCOPE)),
    Case(
        "One holder with a role and little", "TOK-6", lambda: first(SMALL, role="planner", purpose=""), Accepted(SMALL)
    ),
    Case("Four holders", "TOK-6", team, Accepted(TEAM)),
    Case("Nine holders", "TOK-2", lambda: deep(8), Accepted(left(8))),
    *(
        Case(f"{name} holders", "TOK-6", lambda hops=hops: deep(hops), Accepted(left(hops)))
        for name, hops in (("Two", 1), ("Eight", 7))
    ),
)

GROUPS: tuple[Group, ...] = (ACCEPTED,)
