"""Evidence of kind `jwt`: the part that a platform adds to an agent's own, and everything refused as one."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace

import pytest
import rfc8785
from capabilities.statements.revocation import RevocationView
from capabilities.token.verify import token_from_text, verify
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain, EvidenceKind
from capabilities.values.scope import Tier
from tests.ztpm_idp.world import AUDIENCE, ISSUER, LOWER, MEASUREMENT, SLOWER, TRUST_DOMAIN

from capabilities.keys import keys
from capabilities.statements import attestation
from ztpm_idp import ledger_file
from ztpm_idp.client import ClientError, delegate_request, issue_request

pytestmark = pytest.mark.long

TOP = Tier.SAFETY_CRITICAL


def refused(ask, *args, **more) -> ClientError:
    with pytest.raises(ClientError) as caught:
        ask(*args, **more)
    return caught.value


def chain_of(world, text) -> Chain:
    view = RevocationView(epoch=0, age_ms=0, revoked=frozenset())
    chain = verify(
        token_from_text(text, DEFAULT), at=world.clock(), audience=AUDIENCE, view=view, lease_ms=0, trust=world.trust,
        caps=DEFAULT,
    )  # fmt: skip
    assert isinstance(chain, Chain), chain
    return chain


def ledger(world, kind):
    lines = map(json.loads, world.people["alice"].export_ledger().splitlines())
    return [line["body"] for line in lines if line.get("kind") == kind]


def test_a_platforms_word_carries_tier_4_down_to_where_it_ends(world):
    planner = world.agent("planner", role="planner", vouched=True)
    mover, helper = world.agent("mover", vouched=True), world.agent("helper")
    scope = world.scope(ceiling=TOP)
    lent = world.people["alice"].issue(planner, scope, purpose="p")
    below = planner.delegate(lent.token, mover, SLOWER, purpose="p")
    chain = chain_of(world, below.token)
    assert [hop.attestation.kind for hop in chain.hops] == [EvidenceKind.JWT, EvidenceKind.JWT]
    assert chain.scope.ceiling is TOP
    # The helper has only its own word: tier 4 is not lent to it, tier 3 is.
    error = refused(planner.delegate, lent.token, helper, SLOWER, purpose="p")
    assert (error.code, error.status) == ("HOP_NOT_ATTESTED", 403)
    less = planner.delegate(lent.token, helper, replace(SLOWER, ceiling=Tier(3)), purpose="p")
    assert chain_of(world, less.token).leaf.attestation.kind is EvidenceKind.KEY
    error = refused(world.people["alice"].issue, helper, scope, purpose="p")
    assert (error.code, error.status) == ("ABOVE_CEILING", 403)
    assert [body["code"] for body in ledger(world, "delegation-refused")] == ["HOP_NOT_ATTESTED"]
    assert {b["agent"]: b["evidence_kind"] for b in ledger(world, "agent-attested")} == {
        "planner": "jwt", "mover": "jwt", "helper": "key"
    }  # fmt: skip
    assert {b["agent"]: b["evidence_kind"] for b in ledger(world, "token-delegated")} == {
        "mover": "jwt",
        "helper": "key",
    }
    lines = world.people["alice"].export_ledger().splitlines()
    assert isinstance(ledger_file.verify(lines, world.trust), ledger_file.Verified)


def test_an_agent_may_have_a_workload_and_still_speak_for_itself_alone(world):
    planner = world.agent("planner", vouched=True)
    planner._workload = None
    lent = world.people["alice"].issue(planner, world.scope(), purpose="p")
    assert chain_of(world, lent.token).leaf.attestation.kind is EvidenceKind.KEY
    assert refused(world.people["alice"].issue, planner, world.scope(ceiling=TOP), purpose="p").code == "ABOVE_CEILING"


def wrong_tokens(world):
    """Everything that is not the platform's word on this very agent, now, to us."""
    now, mallory = int(world.clock()), keys.generate()
    helper = keys.thumbprint(keys.public_raw(world.private["helper"]))
    return {
        "another agent's workload": world.workload_token("planner", id=f"spiffe://{TRUST_DOMAIN}/helper"),
        "bound to another key": world.workload_token("planner", key_thumbprint=helper),
        "the helper's own": world.workload_token("helper"),
        "other software": world.workload_token("planner", measurement=bytes(32)),
        "another audience": world.workload_token("planner", audience=ISSUER + "/x"),
        "over": world.workload_token("planner", issued_at=now - 300, expires_at=now),
        "too long": world.workload_token("planner", expires_at=now + 301),
        "from the future": world.workload_token("planner", issued_at=now + 6, expires_at=now + 100),
        "another signer": world.workload_token("planner", signer=mallory),
        "the agent itself": world.workload_token("planner", signer=world.private["planner"]),
        "the attester": world.workload_token("planner", signer=world.idp_keys.attester),
        "another trust domain": world.workload_token("planner", id="spiffe://other.example/planner"),
        "no token": "a.b.c",
    }


@pytest.mark.clause("WLD-5")
def test_what_is_not_the_platforms_word_on_this_agent_is_no_evidence_of_any_kind(world):
    planner = world.agent("planner", vouched=True)
    world.agent("helper", vouched=True)
    for name, token in wrong_tokens(world).items():
        planner._workload = lambda token=token: token
        # Neither for tier 4 nor for what its own word alone would carry, nor to become active.
        for ask in (
            lambda: world.people["alice"].issue(planner, world.scope(ceiling=TOP), purpose="p"),
            lambda: world.people["alice"].issue(planner, world.scope(), purpose="p"),
            planner.attest,
        ):
            error = refused(ask)
            assert (error.code, error.status) == ("ATTESTATION_INVALID", 403), name
    planner._workload = lambda: world.workload_token("planner")
    world.people["alice"].issue(planner, world.scope(ceiling=TOP), purpose="p")


def test_an_agent_without_a_workload_id_has_no_platform(world):
    helper = world.agent("helper")
    helper._workload = lambda: world.workload_token("helper")
    assert refused(helper.attest).code == "ATTESTATION_INVALID"


def test_a_provider_without_a_platform_takes_nobodys_word(world):
    planner = world.agent("planner", vouched=True)
    world.stop()
    world.platform = None
    world.start()
    world.people = {name: world.caller(type(p), name) for name, p in world.people.items()}
    planner = world.caller(type(planner), "planner", MEASUREMENT)
    planner.attest()
    planner._workload = lambda: world.workload_token("planner")
    assert refused(planner.attest).code == "ATTESTATION_INVALID"


def test_the_same_evidence_never_counts_twice(world):
    """Neither the agent's statement nor the platform's token in it, in a new statement either."""
    planner, mover = world.agent("planner", role="planner", vouched=True), world.agent("mover", vouched=True)
    token = world.workload_token("mover")
    mover._workload = lambda: token
    lent = world.people["alice"].issue(planner, world.scope(ceiling=TOP), purpose="p")
    evidence = mover.evidence("planner", delegate_request("mover", SLOWER, purpose="p"))
    planner.delegate_with(lent.token, "mover", SLOWER, purpose="p", evidence=evidence)
    error = refused(planner.delegate_with, lent.token, "mover", SLOWER, purpose="p", evidence=evidence)
    assert error.code == "ATTESTATION_INVALID"
    # Nor does a thief of the token have a statement to put it in.
    request = delegate_request("mover", SLOWER, purpose="p")
    digest = hashlib.sha256(rfc8785.dumps(request)).digest()
    raw = keys.public_raw(world.private["planner"])
    stolen = attestation.Evidence(
        "mover", keys.thumbprint(raw), mover.nonce(), "planner", digest, MEASUREMENT, int(world.clock()), token
    )
    forged = attestation.sign(stolen, world.private["planner"])
    error = refused(planner.delegate_with, lent.token, "mover", SLOWER, purpose="p", evidence=forged)
    assert error.code == "ATTESTATION_INVALID"
    error = refused(planner.delegate, lent.token, mover, SLOWER, purpose="p")
    assert error.code == "ATTESTATION_INVALID"
    mover._workload = lambda: world.workload_token("mover")
    again = planner.delegate(lent.token, mover, SLOWER, purpose="p")
    assert chain_of(world, again.token).leaf.attestation.kind is EvidenceKind.JWT


def test_the_platforms_word_is_as_old_as_it_is_when_it_is_used(world):
    planner = world.agent("planner", vouched=True)
    token = world.workload_token("planner")
    world.clock.at_s += 299
    planner._workload = lambda: token
    planner.attest()
    world.clock.at_s += 1
    assert refused(planner.attest).code == "ATTESTATION_INVALID"


def test_the_lifetime_is_bounded_by_the_hops_own_kind(world):
    planner = world.agent("planner", vouched=True)
    now = int(world.clock())
    longest = world.scope(ceiling=TOP, not_after=now + DEFAULT.jwt_evidence_lifetime_s)
    world.people["alice"].issue(planner, longest, purpose="p")
    over = world.scope(ceiling=TOP, not_after=now + DEFAULT.jwt_evidence_lifetime_s + 1)
    assert refused(world.people["alice"].issue, planner, over, purpose="p").code == "LIFETIME_TOO_LONG"


@pytest.mark.parametrize(
    ("name", "code", "status"),
    [
        ("spiffe://other.example/a", "WORKLOAD_UNKNOWN", 400),
        (f"spiffe://{TRUST_DOMAIN}.evil/a", "WORKLOAD_UNKNOWN", 400),
        (f"spiffe://{TRUST_DOMAIN}/../a", "BODY_MALFORMED", 400),
        (f"spiffe://{TRUST_DOMAIN}", "BODY_MALFORMED", 400),
        ("http://a/b", "BODY_MALFORMED", 400),
        ("spiffe://" + "a" * 300, "BODY_MALFORMED", 400),
    ],
)
def test_a_workload_id_is_checked_when_it_is_registered(world, name, code, status):
    error = refused(
        world.people["alice"].register_agent, "new", keys.public_raw(keys.generate()), software_digest="0" * 64,
        model="m", role="r", workload=name,
    )  # fmt: skip
    assert (error.code, error.status) == (code, status)
    assert [row["id"] for row in world.people["alice"].agents()] == []


def test_nobody_registers_with_the_platforms_key(world):
    error = refused(
        world.people["alice"].register_agent, "new", keys.public_raw(world.platform_key), software_digest="0" * 64,
        model="m", role="r",
    )  # fmt: skip
    assert error.code == "KEY_IN_USE"


def test_agents_are_listed_with_their_workload(world):
    world.agent("planner", vouched=True)
    world.agent("helper")
    found = {row["id"]: row["workload"] for row in world.people["alice"].agents()}
    assert found == {"planner": f"spiffe://{TRUST_DOMAIN}/planner", "helper": ""}


def test_evidence_made_elsewhere_carries_the_platforms_word(world):
    from ztpm_idp.client import Evidence

    planner = world.agent("planner", vouched=True)
    scope = world.scope(ceiling=TOP)
    made = Evidence("planner", planner.evidence("alice", issue_request("planner", scope, purpose="p")))
    lent = world.people["alice"].issue(made, scope, purpose="p")
    assert chain_of(world, lent.token).scope.ceiling is TOP
    assert LOWER.ceiling < TOP
