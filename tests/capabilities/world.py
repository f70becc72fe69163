"""World of the tests of `capabilities`: keys, one sponsor, four agents, one scope, and blocks built to be wrong."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace

from capabilities.keys import keys
from capabilities.keys.trust import TrustBundle
from capabilities.statements.revocation import RevocationView
from capabilities.token import biscuit, block
from capabilities.token.delegate import delegate
from capabilities.token.mint import mint
from capabilities.token.verify import Verifier, verify
from capabilities.values import strict_json
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Attestation, Chain, EvidenceKind, HopGrant, Sponsor
from capabilities.values.errors import Fault
from capabilities.values.scope import Grant, Limit, OneOf, Range, Restriction, Scope, Tier
from capabilities.values.units import Parameter, Quantity, Unit
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

NOW = 1_800_000_000
ISSUER = "http://127.0.0.1:8000/ztpm"
CELL = "http://127.0.0.1:9000/mcp"
OTHER_CELL = "http://127.0.0.1:9001/mcp"
LEASE_MS = 2_000
ROOT_ID = 7


def key_of(name: str) -> Ed25519PrivateKey:
    return Ed25519PrivateKey.from_private_bytes(hashlib.sha256(repr(name).encode()).digest())


def raw_of(name: str) -> bytes:
    return keys.public_raw(key_of(name))


TRUST = TrustBundle(
    issuer=ISSUER,
    version=1,
    roots={ROOT_ID: raw_of("root")},
    attesters=frozenset({raw_of("attester"), raw_of("attester-2")}),
    feed=frozenset({raw_of("feed")}),
    registry=frozenset({raw_of("registry")}),
    ledger=frozenset({raw_of("ledger")}),
)
SPONSOR = Sponsor(ISSUER, "alice", "operator-key", NOW - 10)
TOKEN_ID = keys.b64u(b"token-id-16bytes")
VIEW = RevocationView(epoch=3, age_ms=100, revoked=frozenset())

SPEED = Parameter("speed", Unit.MICRORADIAN_PER_SECOND)
FORCE = Parameter("force", Unit.MILLINEWTON)
WIDTH = Parameter("width", Unit.MICROMETRE)
JOINTS = tuple(Parameter(f"q{i}", Unit.MICRORADIAN) for i in range(2))

GRIPPER = Grant("ur3e", "gripper_move", (Limit(WIDTH, Range(0, 85_000)), Limit(FORCE, OneOf(frozenset({10, 20, 40})))))
MOVE = Grant(
    "ur3e",
    "move_joint",
    (*(Limit(joint, Range(-3_000_000, 3_000_000)) for joint in JOINTS), Limit(SPEED, Range(1, 1_000_000))),
)
READ = Grant("ur3e", "read_state")
STOP = Grant("ur3e", "stop")
SCOPE = Scope(
    grants=(GRIPPER, MOVE, READ, STOP),
    ceiling=Tier.HIGH_CONSEQUENCE,
    audiences=frozenset({CELL, OTHER_CELL}),
    delegates=frozenset({"robotic", "vision", "gripper", "role:planner"}),
    depth=4,
    not_before=NOW - 60,
    not_after=NOW + 3_000,
)
SLOWER = Restriction(
    grants=(Grant("ur3e", "move_joint", (Limit(SPEED, Range(1, 500_000)),)), READ, STOP),
    delegates=frozenset({"vision", "gripper"}),
    not_after=NOW + 2_000,
)
QUIETER = Restriction(
    grants=(
        Grant(
            "ur3e", "move_joint", (Limit(JOINTS[0], Range(-1_000, 2_000)), Limit(SPEED, OneOf(frozenset({5, 500_000}))))
        ),
        READ,
    ),
    delegates=frozenset({"gripper"}),
    ceiling=Tier.CONSEQUENTIAL,
)
LAST = Restriction(audiences=frozenset({CELL}), delegates=frozenset())


def grant_to(agent: str, delegator: str, **other: object) -> HopGrant:
    hop = HopGrant(
        hop_id=hashlib.sha256(repr(agent).encode()).hexdigest()[:32],
        agent=agent,
        key=raw_of(agent),
        delegator=delegator,
        purpose="pick the red part",
        request_digest=b"\1" * 32,
        attestation=Attestation(EvidenceKind.KEY, b"\2" * 32, NOW - 10),
    )
    return replace(hop, **other)


def mint_root(scope: Scope = SCOPE, **other: object) -> bytes:
    arguments = {
        "root": key_of("root"),
        "root_key_id": ROOT_ID,
        "token_id": TOKEN_ID,
        "sponsor": SPONSOR,
        "hop": grant_to("orchestrator", "alice"),
        "scope": scope,
        "caps": DEFAULT,
    }
    return mint(**{**arguments, **other})


def check(token: bytes, **other: object) -> Chain | Fault:
    arguments = {"at": NOW, "audience": CELL, "view": VIEW, "lease_ms": LEASE_MS, "trust": TRUST, "caps": DEFAULT}
    return verify(token, **{**arguments, **other})


def chain_of(token: bytes, **other: object) -> Chain:
    chain = check(token, **other)
    assert isinstance(chain, Chain), chain
    return chain


def add_hop(token: bytes, agent: str, restriction: Restriction, **other: object) -> bytes:
    chain = chain_of(token)
    hop_fields = {name: other.pop(name) for name in list(other) if name in HopGrant.__dataclass_fields__}
    arguments = {
        "chain": chain,
        "attester": key_of("attester"),
        "trust": TRUST,
        "hop": replace(grant_to(agent, chain.leaf.agent), **hop_fields),
        "restriction": restriction,
        "caps": DEFAULT,
    }
    return delegate(token, **{**arguments, **other})


def chain_of_four() -> bytes:
    """alice -> orchestrator -> robotic -> vision -> gripper."""
    token = add_hop(mint_root(), "robotic", SLOWER)
    token = add_hop(token, "vision", QUIETER, attester=key_of("attester-2"))
    return add_hop(token, "gripper", LAST)


def verifier() -> Verifier:
    return Verifier(TRUST, DEFAULT)


def move(speed: int, q0: int = 0, q1: int = 0) -> tuple[Quantity, ...]:
    return (
        Quantity("q0", Unit.MICRORADIAN, q0),
        Quantity("q1", Unit.MICRORADIAN, q1),
        Quantity("speed", Unit.MICRORADIAN_PER_SECOND, speed),
    )


# --- blocks built to be wrong ----------------------------------------------------------------------------------------------


def _same(found):
    return found


@dataclass
class Forge:
    """Builds blocks past the rules of `mint` and `delegate`, with the real keys."""

    @staticmethod
    def authority(
        scope: Scope = SCOPE,
        *,
        fact=_same,
        checks=_same,
        signer: str = "root",
        root_key_id: int = ROOT_ID,
        token_id: str = TOKEN_ID,
        sponsor: Sponsor = SPONSOR,
        index: int = 0,
        **hop: object,
    ) -> bytes:
        made = block.AuthorityBlock(token_id, sponsor, index, replace(grant_to("orchestrator", "alice"), **hop), scope)
        return biscuit.seal_authority(
            fact(block.fact(made)), checks(block.checks(made, None)), root=key_of(signer), root_key_id=root_key_id
        )

    @staticmethod
    def hop(
        token: bytes,
        restriction: Restriction = SLOWER,
        *,
        fact=_same,
        checks=_same,
        signer: str = "attester",
        index: int = 1,
        agent: str = "robotic",
        delegator: str = "orchestrator",
        parent: Scope = SCOPE,
        **hop: object,
    ) -> bytes:
        made = block.HopBlock(index, grant_to(agent, delegator, **hop), restriction)
        opened = biscuit.open_token(token, raw_of("root"))
        return biscuit.append_hop(
            opened, fact(block.fact(made)), checks(block.checks(made, parent)), attester=key_of(signer)
        )


def saying(change):
    """A fact whose JSON object `change` has changed, in place or by giving another."""

    def changed(found):
        predicate, (*terms, statement) = found
        stated = json.loads(statement)
        other = change(stated)
        members = stated if other is None else other
        raw = members if isinstance(members, bytes) else strict_json.canonical(members)
        return predicate, (*terms, raw)

    return changed


def with_term(position, value):
    """A fact with another term at this position."""

    def changed(found):
        predicate, terms = found
        return predicate, (*terms[:position], value, *terms[position + 1 :])

    return changed
