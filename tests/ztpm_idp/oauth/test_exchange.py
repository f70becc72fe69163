"""Token exchange: the hop protocol in OAuth's words; never wider, longer-lived or less bound than its subject."""

from __future__ import annotations

import json
from urllib.parse import urlencode

import pytest
from capabilities.keys import keys
from capabilities.values.scope import Restriction, Tier
from capabilities.values.scope_json import restriction_to_json
from tests.ztpm_idp.oauth.speaking import TOKEN, claims_of, looked_at, refusal
from tests.ztpm_idp.test_lending import chain_of
from tests.ztpm_idp.world import AUDIENCE, World
from ztpm_idp.client.callers import delegate_request
from ztpm_idp.oauth.exchanging import ACCESS_TYPE, CAPABILITY_TYPE, JWT_TYPE

from ztpm_idp.client import ProofAuth

EXCHANGE = "urn:ietf:params:oauth:grant-type:token-exchange"
LOW = Restriction(ceiling=Tier(1))


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    with World(tmp_path_factory.mktemp("world")) as world:
        world.pep()
        for name in ("planner", "mover", "helper"):
            world.agent(name)
        yield world


@pytest.fixture
def lent(shared):
    return shared.people["alice"].issue(shared.agents["planner"], shared.scope(), purpose="sweep").token


def exchange(world, token, restriction=LOW, *, holder="planner", delegate="mover", **changes):
    request = delegate_request(delegate, restriction, purpose="move")
    evidence = changes.pop("evidence", None) or world.agents[delegate].evidence(holder, request)
    form = {
        "grant_type": EXCHANGE,
        "subject_token": token,
        "subject_token_type": CAPABILITY_TYPE,
        "actor_token": evidence,
        "actor_token_type": JWT_TYPE,
        "authorization_details": json.dumps([request | {"type": "ztpm_delegation"}]),
        "resource": AUDIENCE,
    } | changes
    content = urlencode({name: value for name, value in form.items() if value is not None}).encode()
    headers = {"Content-Type": "application/x-www-form-urlencoded"}
    auth = ProofAuth(world.private[holder], now=world.clock)
    return world.anonymous().post(TOKEN, content=content, headers=headers, auth=auth)


def test_an_access_token_names_every_actor_and_is_bound_to_the_last(shared, lent):
    given = exchange(shared, lent)
    assert given.status_code == 200, given.text
    body = given.json()
    assert (body["token_type"], body["issued_token_type"]) == ("DPoP", ACCESS_TYPE)
    claims = claims_of(body["access_token"])
    assert (claims["sub"], claims["aud"]) == ("alice", AUDIENCE)
    assert claims["act"] == {"sub": "mover", "act": {"sub": "planner"}}
    assert claims["cnf"] == {"jkt": keys.thumbprint(keys.public_raw(shared.private["mover"]))}
    above = chain_of(shared, lent)
    assert claims["exp"] <= above.scope.not_after
    told = looked_at(shared, body["access_token"])
    chain = chain_of(shared, told["ztpm_capability"])
    assert [hop.agent for hop in chain.hops] == ["planner", "mover"]
    assert (chain.leaf.hop_id, chain.scope.ceiling) == (claims["jti"], Tier(1))
    # The access token may be exchanged in its turn, by its holder alone.
    further = exchange(
        shared, body["access_token"], Restriction(depth=0, ceiling=Tier(0)), holder="mover", delegate="helper",
        subject_token_type=ACCESS_TYPE,
    )  # fmt: skip
    assert claims_of(further.json()["access_token"])["act"]["act"]["act"] == {"sub": "planner"}
    # Revoking the hop ends both, and not what is above.
    shared.people["alice"].revoke("hop", claims["jti"], "enough")
    assert looked_at(shared, body["access_token"]) == looked_at(shared, further.json()["access_token"])
    assert exchange(shared, lent).status_code == 200


def test_the_capability_itself_is_what_the_hop_protocol_makes(shared, lent):
    body = exchange(
        shared, lent, Restriction(ceiling=Tier(2)), requested_token_type=CAPABILITY_TYPE, resource=None
    ).json()
    chain = chain_of(shared, body["access_token"])
    assert (body["issued_token_type"], chain.leaf.agent, chain.scope.ceiling) == (CAPABILITY_TYPE, "mover", Tier(2))


def test_nothing_wider_comes_of_it(shared, lent):
    narrow = shared.people["alice"].issue(shared.agents["planner"], shared.scope(ceiling=Tier(1)), purpose="p").token
    for restriction, error in (
        (Restriction(ceiling=Tier(4)), "invalid_scope"),
        (Restriction(ceiling=Tier(2)), "invalid_scope"),
    ):
        assert refusal(exchange(shared, narrow, restriction)) == (400, error)
    # An access token carries tier 1 at most, whatever the subject carries.
    assert refusal(exchange(shared, lent, Restriction(ceiling=Tier(2)))) == (400, "invalid_scope")
    assert refusal(exchange(shared, lent, resource="http://127.0.0.1:9/mcp")) == (400, "invalid_target")
    assert refusal(exchange(shared, lent, resource=None)) == (400, "invalid_target")


def test_it_takes_the_holders_proof_over_this_body_and_the_delegates_evidence(shared, lent):
    once = shared.agents["mover"].evidence("planner", delegate_request("mover", LOW, purpose="move"))
    assert exchange(shared, lent, evidence=once).status_code == 200
    assert refusal(exchange(shared, lent, evidence=once)) == (400, "invalid_grant")
    other = shared.agents["mover"].evidence("planner", delegate_request("mover", LOW, purpose="other"))
    assert refusal(exchange(shared, lent, evidence=other)) == (400, "invalid_grant")
    assert refusal(exchange(shared, lent, holder="helper")) == (400, "invalid_grant")
    unsigned = shared.anonymous().post(
        TOKEN, content=f"grant_type={EXCHANGE}".encode(), headers={"Content-Type": "application/x-www-form-urlencoded"}
    )
    assert refusal(unsigned) == (400, "invalid_dpop_proof")
    for changes, error in (
        ({"subject_token_type": "urn:x"}, "invalid_request"),
        ({"subject_token_type": ACCESS_TYPE}, "invalid_grant"),
        ({"subject_token": "AAAA"}, "invalid_grant"),
        ({"subject_token": None}, "invalid_request"),
        ({"actor_token": "x"}, "invalid_grant"),
        ({"actor_token_type": "urn:x"}, "invalid_request"),
        ({"requested_token_type": "urn:x"}, "invalid_request"),
        ({"authorization_details": "[]"}, "invalid_request"),
        ({"authorization_details": "{"}, "invalid_request"),
        ({"authorization_details": json.dumps([restriction_to_json(LOW)])}, "invalid_request"),
    ):
        assert refusal(exchange(shared, lent, **changes)) == (400, error), changes
    # A registered party that holds nothing, and a key that nobody registered.
    shared.private["stranger"] = keys.generate()
    assert refusal(exchange(shared, lent, evidence=once, holder="stranger")) == (401, "invalid_client")
