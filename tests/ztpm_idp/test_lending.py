"""Issuing and delegating over the wire: what is lent is attested, narrower, named, and verifiable by everybody."""

from __future__ import annotations

import json

from tests.unread import unread
import pytest
from capabilities.statements.revocation import RevocationView
from capabilities.token.verify import token_from_text, verify
from capabilities.values.algebra import narrows
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain
from capabilities.values.errors import FaultCode
from capabilities.values.explanation import explain, explanation_to_json
from capabilities.values.scope import Grant, Limit, OneOf, Range, Restriction, Tier
from capabilities.values.scope_json import restriction_from_json
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.ztpm_idp.world import AUDIENCE, LOWER, MEASUREMENT, MOVE_TO, SLOWER, SPEED, World

from capabilities.keys import keys
from capabilities.statements import attestation
from ztpm_idp.client import Agent, ClientError, Evidence, delegate_request, issue_request
from ztpm_idp.provider import problems

pytestmark = pytest.mark.long

NOTHING_REVOKED = RevocationView(epoch=0, age_ms=0, revoked=frozenset())


def chain_of(world, text) -> Chain:
    found = verify(
        token_from_text(text, DEFAULT),
        at=world.clock(),
        audience=AUDIENCE,
        view=NOTHING_REVOKED,
        lease_ms=1,
        trust=world.trust,
        caps=DEFAULT,
    )
    assert isinstance(found, Chain), found
    return found


def refused(action, *more, **named) -> ClientError:
    with pytest.raises(ClientError) as caught:
        action(*more, **named)
    return caught.value


def tree(world):
    planner, mover = world.agent("planner", role="planner"), world.agent("mover")
    return planner, mover, world.people["alice"].issue(planner, world.scope(), purpose="sweep the table")


def test_issued_and_delegated_tokens_verify_and_say_who_lent_what(world):
    planner, mover, lent = tree(world)
    narrower = planner.delegate(lent.token, mover, SLOWER, purpose="move the arm")
    chain = chain_of(world, narrower.token)
    assert [hop.agent for hop in chain.hops] == ["planner", "mover"]
    assert [hop.hop_id for hop in chain.hops] == [lent.hop_id, narrower.hop_id]
    assert (chain.token_id, chain.sponsor.subject) == (lent.token_id, "alice") == (narrower.token_id, "alice")
    assert chain.leaf.key == keys.public_raw(world.private["mover"])
    assert chain.leaf.attestation.measurement == MEASUREMENT
    assert chain.scope.grants[0].limits[1].bound == Range(0, 500_000)
    assert narrower.expires_at == chain.scope.not_after


@pytest.mark.parametrize(
    "restriction",
    [
        Restriction(ceiling=Tier(4)),
        Restriction(),
        Restriction(depth=1),
        Restriction(ceiling=Tier(2), depth=3),
        Restriction(grants=(Grant("ur3e", "move_joint", (Limit(SPEED, Range(0, 2_000_000)),)),)),
        Restriction(grants=(Grant("ur3e", "move_joint", (Limit(SPEED, OneOf(frozenset({0, 1_000_001}))),)),)),
        Restriction(grants=(Grant("ur3e", "drill"),)),
        Restriction(audiences=frozenset({AUDIENCE, "http://127.0.0.1:9/mcp"})),
        Restriction(ceiling=Tier(2), delegates=frozenset({"mover", "stranger"})),
        Restriction(ceiling=Tier(2), not_after=1_900_000_000),
    ],
)
def test_wider_or_equal_is_refused_and_kept_in_the_ledger(world, restriction):
    planner, mover, lent = tree(world)
    error = refused(planner.delegate, lent.token, mover, restriction, purpose="more")
    assert (error.code, error.status) == ("NOT_NARROWER", 403)
    # The holder is told every place and what could be had, and what is told is accepted.
    scope = chain_of(world, lent.token).scope
    assert error.explanation == explanation_to_json(explain(scope, restriction))
    assert error.detail == error.explanation["sentence"]
    assert error.explanation["places"] or error.explanation["could_narrow"]
    kept = world.people["alice"].export_ledger()
    assert b'"kind":"delegation-refused"' in kept
    assert b'"code":"NOT_NARROWER"' in kept
    (entry,) = (
        line for line in map(json.loads, kept.splitlines()) if b"delegation-refused" in json.dumps(line).encode()
    )
    told = {"dimension", "what", "parent", "child", "nearest"}
    places = [{name: place[name] for name in told} for place in error.explanation["places"]]
    assert json.dumps(places, sort_keys=True) in json.dumps(entry, sort_keys=True)
    if error.explanation["repaired"] is not None:
        planner.delegate(lent.token, mover, restriction_from_json(error.explanation["repaired"]), purpose="less")
    # Nothing half done: the same evidence's nonce is unspent, so a proper request by the same agents works.
    planner.delegate(lent.token, mover, SLOWER, purpose="less")


def test_a_stranger_is_told_nothing_of_the_scope(world):
    _, _, lent = tree(world)
    why = explain(chain_of(world, lent.token).scope, Restriction())
    assert "explanation" in json.loads(problems.answer(FaultCode.NOT_NARROWER, "x", why).body)
    assert "explanation" not in json.loads(problems.answer(FaultCode.CHAIN_BROKEN, "x", why).body)


bounds = st.one_of(
    st.builds(lambda a, b: Range(min(a, b), max(a, b)), *[st.integers(-10, 1_100_000)] * 2),
    st.builds(OneOf, st.frozensets(st.integers(-10, 1_100_000), min_size=1, max_size=4)),
)
moves = st.lists(
    st.builds(Limit, st.sampled_from([SPEED, MOVE_TO]), bounds),
    max_size=2,
    unique_by=lambda limit: limit.parameter.name,
)
restrictions = st.builds(
    Restriction,
    grants=st.none()
    | st.builds(
        lambda limits, stop: (Grant("ur3e", "move_joint", tuple(limits)),) + ((Grant("ur3e", "stop"),) if stop else ()),
        moves,
        st.booleans(),
    ),
    ceiling=st.none() | st.sampled_from(list(Tier)),
    delegates=st.none() | st.frozensets(st.sampled_from(["mover", "helper", "stranger"])),
    depth=st.none() | st.integers(0, 4),
    not_after=st.none() | st.integers(1_800_000_100, 1_800_000_900),
)


def test_delegation_never_returns_more_than_the_parent(tmp_path):
    with World(tmp_path) as world:
        planner, mover, lent = tree(world)
        parent = chain_of(world, lent.token).scope
        outcomes = set()

        @settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
        @given(restrictions)
        def holds(restriction):
            try:
                text = planner.delegate(lent.token, mover, restriction, purpose="any").token
            except ClientError as error:
                assert 400 <= error.status < 500
                outcomes.add("refused")
                return
            found = narrows(chain_of(world, text).scope, parent)
            assert found.widenings == ()
            assert found.strict
            assert chain_of(world, text).scope.depth < parent.depth
            outcomes.add("made")

        holds()
        assert outcomes == {"made", "refused"}


def test_a_delegate_that_was_never_attested_is_refused(world):
    planner, _, lent = tree(world)
    fresh = world.agent("helper", attested=False)
    assert refused(planner.delegate, lent.token, fresh, SLOWER, purpose="x").code == "HOP_NOT_ATTESTED"
    assert refused(world.people["alice"].issue, fresh, world.scope(), purpose="x").code == "HOP_NOT_ATTESTED"


def forged(world, agent: Agent, **changes) -> str:
    stated = dict(
        agent=agent.id,
        key_thumbprint=keys.thumbprint(keys.public_raw(world.private[agent.id])),
        nonce=None,
        delegator="planner",
        request_digest=bytes(32),
        measurement=MEASUREMENT,
        at=int(world.clock()),
        workload="",
    )
    signer = changes.pop("signer", world.private[agent.id])
    stated |= changes
    stated["nonce"] = stated["nonce"] or agent.nonce()
    return unread(attestation, attestation.Evidence(**stated), signer)


def test_each_way_in_which_evidence_can_be_wrong(world):
    import hashlib

    import rfc8785

    planner, mover, lent = tree(world)
    helper = world.agent("helper")
    request = delegate_request("mover", SLOWER, purpose="p")
    digest = hashlib.sha256(rfc8785.dumps(request)).digest()
    cases = {
        "another request": forged(world, mover),
        "another delegator": forged(world, mover, request_digest=digest, delegator="helper"),
        "another software": forged(world, mover, request_digest=digest, measurement=bytes(32)),
        "another signer": forged(world, mover, request_digest=digest, signer=world.private["helper"]),
        "another agent": forged(world, helper, request_digest=digest),
        "another agent's nonce": forged(world, mover, request_digest=digest, nonce=helper.nonce()),
        "invented nonce": forged(world, mover, request_digest=digest, nonce="n" * 32),
        "from the future": forged(world, mover, request_digest=digest, at=int(world.clock()) + 6),
        "older than its nonce": forged(world, mover, request_digest=digest, at=int(world.clock()) - 6),
    }
    for name, evidence in cases.items():
        error = refused(planner.delegate_with, lent.token, "mover", SLOWER, purpose="p", evidence=evidence)
        assert (error.code, error.status) == ("ATTESTATION_INVALID", 403), name
    good = forged(world, mover, request_digest=digest)
    planner.delegate_with(lent.token, "mover", SLOWER, purpose="p", evidence=good)
    assert (
        refused(planner.delegate_with, lent.token, "mover", SLOWER, purpose="p", evidence=good).code
        == "ATTESTATION_INVALID"
    )


@pytest.mark.parametrize(("age_s", "made"), [(60, True), (61, False)])
def test_a_nonce_counts_for_sixty_seconds(world, age_s, made):
    planner, mover, lent = tree(world)
    evidence = mover.evidence("planner", delegate_request("mover", SLOWER, purpose="p"))
    world.clock.at_s += age_s
    if made:
        planner.delegate_with(lent.token, "mover", SLOWER, purpose="p", evidence=evidence)
    else:
        assert (
            refused(planner.delegate_with, lent.token, "mover", SLOWER, purpose="p", evidence=evidence).code
            == "ATTESTATION_INVALID"
        )


def test_evidence_made_elsewhere_for_issue(world):
    planner = world.agent("planner")
    request = issue_request("planner", world.scope(), purpose="p")
    lent = world.people["alice"].issue(
        Evidence("planner", planner.evidence("alice", request)), world.scope(), purpose="p"
    )
    assert chain_of(world, lent.token).leaf.agent == "planner"
    wrong = Evidence("planner", planner.evidence("bob", request))
    assert refused(world.people["alice"].issue, wrong, world.scope(), purpose="p").code == "ATTESTATION_INVALID"


def test_who_may_be_delegated_to(world):
    planner, mover, _ = tree(world)
    alice, scope = world.people["alice"], world.scope(delegates=frozenset({"role:actuator", "foreigner"}))
    lent = alice.issue(planner, scope, purpose="p")
    planner.delegate(lent.token, mover, SLOWER, purpose="by role")
    named, unnamed = world.agent("foreigner", sponsor="bob"), world.agent("outsider", sponsor="bob")
    planner.delegate(lent.token, named, SLOWER, purpose="by name")
    assert refused(planner.delegate, lent.token, unnamed, SLOWER, purpose="p").code == "DELEGATE_NOT_ALLOWED"
    other = world.agent("watcher", role="observer")
    assert refused(planner.delegate, lent.token, other, SLOWER, purpose="p").code == "DELEGATE_NOT_ALLOWED"


def test_no_agent_twice_and_no_hop_beyond_the_depth(world):
    planner, mover, lent = tree(world)
    helper = world.agent("helper")
    second = planner.delegate(lent.token, mover, SLOWER, purpose="p")
    third = mover.delegate(second.token, helper, Restriction(ceiling=Tier(2), depth=0), purpose="p")
    assert refused(mover.delegate, second.token, mover, LOWER, purpose="p").code == "DELEGATE_NOT_ALLOWED"
    last = world.agent("last")
    assert (
        refused(helper.delegate, third.token, last, Restriction(ceiling=Tier(1)), purpose="p").code == "TOO_MANY_HOPS"
    )


def test_only_the_holder_of_the_leaf_delegates(world):
    planner, mover, lent = tree(world)
    assert refused(mover.delegate, lent.token, mover, SLOWER, purpose="stolen").code == "PROOF_WRONG_KEY"
    narrower = planner.delegate(lent.token, mover, SLOWER, purpose="p")
    helper = world.agent("helper")
    error = refused(planner.delegate, narrower.token, helper, LOWER, purpose="not the leaf any more")
    assert (error.code, error.status) == ("PROOF_WRONG_KEY", 401)


def test_a_token_that_is_not_sound_is_refused(world):
    planner, mover, lent = tree(world)
    flipped = lent.token[:-3] + ("A" if lent.token[-3] != "A" else "B") + lent.token[-2:]
    assert refused(planner.delegate, flipped, mover, SLOWER, purpose="p").status == 401
    assert refused(planner.delegate, "A" * 16_385, mover, SLOWER, purpose="p").code == "TOKEN_TOO_LARGE"
    assert refused(planner.delegate, "%%%", mover, SLOWER, purpose="p").code == "TOKEN_MALFORMED"
    body = {"request": delegate_request("mover", SLOWER, purpose="p"), "evidence": mover.evidence("planner", {})}
    assert refused(planner._post, "/tokens/delegate", body).code == "TOKEN_MISSING"
    world.clock.at_s += 601
    assert refused(planner.delegate, lent.token, mover, SLOWER, purpose="p").code == "EXPIRED"


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"ceiling": Tier(4)}, "ABOVE_CEILING"),
        ({"not_after": 1_800_003_601}, "LIFETIME_TOO_LONG"),
        ({"not_before": 1_799_999_000, "not_after": 1_799_999_999}, "EXPIRED"),
    ],
)
def test_what_evidence_of_kind_key_cannot_carry(world, changes, code):
    planner = world.agent("planner")
    assert refused(world.people["alice"].issue, planner, world.scope(**changes), purpose="p").code == code


def test_an_hour_is_carried(world):
    planner = world.agent("planner")
    world.people["alice"].issue(planner, world.scope(not_after=int(world.clock()) + 3_600), purpose="p")


def test_only_sponsors_issue(world):
    planner = world.agent("planner")
    for name in ("carol", "dan"):
        assert refused(world.people[name].issue, planner, world.scope(), purpose="p").code == "NOT_PERMITTED"
    lent = world.people["bob"].issue(planner, world.scope(), purpose="named by bob himself")
    assert chain_of(world, lent.token).leaf.role == ""


def test_the_dead_get_nothing(world):
    planner, mover, lent = tree(world)
    foreigner = world.agent("helper", sponsor="bob")
    world.people["alice"].disable_person("bob", "left")
    # Bob's agents ended with him: this one cannot even ask for a nonce.
    assert refused(planner.delegate, lent.token, foreigner, SLOWER, purpose="p").code == "CALLER_INACTIVE"
    assert refused(world.people["bob"].issue, planner, world.scope(), purpose="p").code == "CALLER_INACTIVE"
    request = delegate_request("mover", SLOWER, purpose="p")
    evidence = mover.evidence("planner", request)
    world.people["alice"].retire_agent("mover", "odd")
    assert (
        refused(planner.delegate_with, lent.token, "mover", SLOWER, purpose="p", evidence=evidence).code
        == "AGENT_INACTIVE"
    )
    assert refused(mover.nonce).code == "CALLER_INACTIVE"
    assert refused(mover.attest).code == "CALLER_INACTIVE"
    world.people["alice"].revoke("token", lent.token_id, "over")
    error = refused(planner.delegate_with, lent.token, "mover", SLOWER, purpose="p", evidence=evidence)
    assert (error.code, error.status) == ("REVOKED", 401)


def test_retiring_before_the_first_attestation_is_for_ever(world):
    helper = world.agent("helper", attested=False)
    world.people["alice"].retire_agent("helper", "odd")
    assert refused(helper.attest).code == "CALLER_INACTIVE"
    assert [row["status"] for row in world.people["alice"].agents()] == ["revoked"]


def test_open_nonces_are_bounded(tmp_path):
    with World(tmp_path, settings_changes={"open_nonces": 3}) as world:
        helper = world.agent("helper", attested=False)
        for _ in range(3):
            helper.nonce()
        assert refused(helper.nonce).code == "TOO_MANY_NONCES"
        world.clock.at_s += 61
        helper.attest()
