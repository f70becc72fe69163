"""Order of verification: the first failing step is told, and none is skipped for want of input."""

from __future__ import annotations

from dataclasses import replace

import pytest
from capabilities.proof.proof import check_proof, prove
from capabilities.statements.revocation import RevocationView, Revoked
from capabilities.token.token_text import token_to_text
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Attestation, Chain, EvidenceKind
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Restriction, Tier
from tests.capabilities.token.test_token_defects import fields, joined, other_alternative
from tests.capabilities.world import (
    CELL,
    LEASE_MS,
    NOW,
    OTHER_CELL,
    SCOPE,
    SLOWER,
    TRUST,
    VIEW,
    Forge,
    add_hop,
    chain_of,
    chain_of_four,
    check,
    grant_to,
    key_of,
    mint_root,
    raw_of,
    saying,
    verifier,
)

from capabilities.token import biscuit, block, wire

STALE = RevocationView(epoch=9, age_ms=10**9, revoked=frozenset())
DEAD = replace(STALE, revoked=frozenset({(str(Revoked.AGENT), "orchestrator")}))


def clause(token, **other):
    found = check(token, **other)
    return found.clause if isinstance(found, Fault) else ""


@pytest.mark.clause("VFY-1")
def test_the_first_fault_is_told():
    """One token with a fault in every step; the told fault moves on as the faults are mended."""
    everything = {"at": NOW + 10**6, "audience": "", "view": STALE}
    stranger = Forge.hop(Forge.authority(), Restriction(), signer="stranger")
    idle = Forge.hop(Forge.authority(), Restriction())  # narrows nothing
    head, *rest = fields(stranger)
    proof = rest[-1][1]
    assert clause(b"", **everything) == "TOK-1"
    assert clause(stranger[:-1], caps=replace(DEFAULT, token_bytes=9), **everything) == "TOK-1"
    assert clause(stranger[:-1], **everything) == "TOK-2"
    assert clause(joined([head, *rest[:-1], (4, proof[:-1] + bytes([proof[-1] ^ 1]))]), **everything) == "TOK-3"
    assert clause(b"\x08\x87\x00" + stranger[2:], **everything) == "TOK-4"
    assert clause(b"\x08\x87\x00" + idle[2:], **everything) == "TOK-5"
    assert clause(idle, **everything) == "TOK-6"
    assert clause(mint_root(), **everything) == "TOK-7"
    assert clause(mint_root(), **{**everything, "at": NOW}) == "TOK-8"
    assert clause(mint_root(), **{**everything, "at": NOW, "audience": CELL}) == "TOK-9"
    assert clause(mint_root()) == ""


@pytest.mark.clause("VFY-1", "TOK-9")
def test_nothing_is_skipped_because_it_is_empty():
    token = mint_root()
    assert clause(token, audience="") == "TOK-8"
    assert clause(token, view=RevocationView.never()) == "TOK-9"
    assert clause(token, view=replace(VIEW, revoked=frozenset(), age_ms=LEASE_MS + 1)) == "TOK-9"
    assert clause(token, lease_ms=0) == "TOK-9"
    assert clause(token, at=float("nan")) == "TOK-7"
    assert check(token, view=DEAD).code is FaultCode.REVOKED


@pytest.mark.clause("VFY-2")
def test_a_refusal_is_never_remembered(monkeypatch):
    read = []
    real = wire.read
    monkeypatch.setattr(wire, "read", lambda token: read.append(token) or real(token))
    good, bad = mint_root(), Forge.hop(mint_root(), Restriction())
    checker = verifier()
    now = {"at": NOW, "audience": CELL, "view": VIEW, "lease_ms": LEASE_MS}
    for _ in range(3):
        assert isinstance(checker.verify(good, **now), Chain)
        assert isinstance(checker.verify(bad, **now), Fault)
    assert (read.count(good), read.count(bad)) == (1, 3)


@pytest.mark.clause("VFY-2")
def test_what_is_remembered_is_of_one_epoch(monkeypatch):
    read = []
    real = wire.read
    monkeypatch.setattr(wire, "read", lambda token: read.append(token) or real(token))
    checker, token = verifier(), mint_root()
    for epoch in (3, 3, 4, 4, 3):
        view = replace(VIEW, epoch=epoch)
        assert isinstance(checker.verify(token, at=NOW, audience=CELL, view=view, lease_ms=LEASE_MS), Chain)
    assert len(read) == 2


@pytest.mark.clause("TOK-2", "BLK-11")
def test_eight_hops_and_no_more():
    token = mint_root()
    parts = block.HopBlock(1, grant_to("robotic", "orchestrator"), SLOWER)
    for count in range(1, 10):
        opened = biscuit.open_token(token, raw_of("root"))
        token = biscuit.append_hop(opened, block.fact(parts), block.checks(parts, SCOPE), attester=key_of("attester"))
        found = check(token)
        if 1 < count <= 8:
            assert (found.code, found.clause) == (FaultCode.CHAIN_BROKEN, "TOK-6")  # it says to be the first one
    assert (found.code, found.clause) == (FaultCode.TOO_MANY_HOPS, "TOK-2")


@pytest.mark.clause("TOK-6.5")
def test_an_operation_keeps_its_parameters():
    for change in (lambda a: replace(a, bounds=a.bounds[:-1]), lambda a: replace(a, bounds=(*a.bounds, None))):
        found = check(Forge.hop(mint_root(), checks=other_alternative(change)))
        assert (found.code, found.clause) == (FaultCode.NOT_NARROWER, "TOK-6")


@pytest.mark.clause("TOK-6.9", "BLK-12")
def test_the_ceiling_of_a_hop_is_that_of_its_evidence():
    jwt = Attestation(EvidenceKind.JWT, bytes(32), NOW - 10)
    top = replace(SCOPE, ceiling=Tier.SAFETY_CRITICAL)
    assert check(Forge.authority(top)).code is FaultCode.HOP_NOT_ATTESTED
    assert isinstance(check(Forge.authority(top, attestation=jwt)), Chain)


@pytest.mark.clause("TOK-7")
def test_the_clocks_of_the_issuer_may_be_5_s_ahead():
    for ahead, good in ((5, True), (6, False)):
        at = grant_to("orchestrator", "alice").attestation
        token = mint_root(hop=grant_to("orchestrator", "alice", attestation=replace(at, at=NOW + ahead)))
        assert isinstance(check(token), Chain) is good


@pytest.mark.clause("TOK-10")
def test_the_proof_is_by_the_leaf_and_by_nobody_above_it():
    token = chain_of_four()
    leaf = chain_of(token).leaf
    request = {"method": "POST", "url": CELL, "body": b"{}", "token": token_to_text(token), "at": NOW}
    for agent in ("gripper", "vision", "robotic", "orchestrator", "alice"):
        proof = prove(key_of(agent), jti="j" * 16, **request)
        found = check_proof(proof, key=leaf.key, caps=DEFAULT, **request)
        assert isinstance(found, Fault) is (agent != "gripper"), agent
    assert chain_of(add_hop(mint_root(), "robotic", SLOWER)).leaf.key == raw_of("robotic")


@pytest.mark.clause("BLK-6")
def test_what_a_hop_does_not_state_is_kept():
    parent = chain_of(mint_root()).scope
    child = chain_of(add_hop(mint_root(), "robotic", Restriction(ceiling=Tier(1)))).scope
    assert child == replace(parent, ceiling=Tier(1), depth=parent.depth - 1)
    assert OTHER_CELL in child.audiences


@pytest.mark.clause("BLK-5")
def test_a_hop_cannot_bring_another_trust():
    """Members of the first block have no place in a further one, with any value."""
    for member in ("profile", "token", "sponsor", "parameters"):
        token = Forge.hop(mint_root(), fact=saying(lambda m, name=member: m.update({name: "x"})))
        assert check(token).code is FaultCode.CHAIN_BROKEN
    assert check(mint_root(), trust=replace(TRUST, version=2)).leaf.agent == "orchestrator"
