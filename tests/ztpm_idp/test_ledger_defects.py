"""A ledger that no token holder can fill: one spelling of what is kept, a budget of refusals."""

from __future__ import annotations

import hashlib
import json
import secrets

import pytest
import rfc8785
from capabilities.proof.proof import prove
from capabilities.values.scope import Grant, Restriction, Tier
from tests.ztpm_idp.world import ISSUER, SLOWER
from ztpm_idp.client import delegate_request, issue_request
from ztpm_idp.domain.refusals import BUDGET, WIDENINGS, WINDOW_MS

from capabilities.keys.keys import b64u, unb64u
from ztpm_idp import ledger_file
from ztpm_idp.client import ClientError

WIDER = Restriction(ceiling=Tier(4))


@pytest.fixture
def lent(world):
    world.planner, world.mover = world.agent("planner", role="planner"), world.agent("mover")
    world.token = world.people["alice"].issue(world.planner, world.scope(), purpose="p").token
    return world


def post(world, body: bytes, *, who="planner", path="/tokens/delegate", token=...):
    token = world.token if token is ... else token
    url = ISSUER + path
    proof = prove(
        world.private[who], method="POST", url=url, body=body, token=token, at=int(world.clock()),
        jti=secrets.token_urlsafe(18),
    )  # fmt: skip
    headers = {"DPoP": proof} | ({} if token is None else {"Authorization": f"DPoP {token}"})
    with world.anonymous() as http:
        return http.post(url, content=body, headers=headers)


def attempt(world, restriction=WIDER, delegate="mover"):
    """The code with which a delegation is refused; its evidence is good."""
    request = delegate_request(delegate, restriction, purpose="p")
    evidence = world.mover.evidence("planner", request)
    return post(world, rfc8785.dumps({"request": request, "evidence": evidence})).json()["code"]


def entries(world):
    lines = world.people["alice"].export_ledger().splitlines()
    assert isinstance(ledger_file.verify(lines, world.trust), ledger_file.Verified)
    return [json.loads(line) for line in lines[:-1]]


def kinds(world, kind):
    return [entry["body"] for entry in entries(world) if entry["kind"] == kind]


def test_a_padded_request_is_kept_in_its_canonical_form(lent):
    request = delegate_request("mover", WIDER, purpose="p")
    body = {"request": request, "evidence": lent.mover.evidence("planner", request)}
    canonical, before = rfc8785.dumps(body), sum(len(json.dumps(entry)) for entry in entries(lent))
    spelled = [
        canonical,
        canonical[:-1] + b"\n" * 30_000 + b"}",
        json.dumps(body, indent=8).encode(),
        json.dumps(dict(reversed(body.items()))).encode(),
    ]
    for raw in spelled:
        answer = post(lent, raw)
        assert (answer.status_code, answer.json()["code"]) == (403, "NOT_NARROWER")
    kept = kinds(lent, "delegation-refused")
    assert [entry["signed"]["body"] for entry in kept] == [canonical.decode()] * len(spelled)
    assert sum(len(json.dumps(entry)) for entry in entries(lent)) - before < len(spelled) * 8_192
    # what came canonical is verified with its proof
    claims = json.loads(unb64u(kept[0]["signed"]["proof"].split(".")[1]))
    assert claims["bdg"] == b64u(hashlib.sha256(kept[0]["signed"]["body"].encode()).digest())


def test_what_is_lent_and_voted_is_kept_in_its_canonical_form_too(lent):
    request = issue_request("planner", lent.scope(), purpose="q")
    body = {"request": request, "evidence": lent.planner.evidence("alice", request)}
    assert post(lent, json.dumps(body, indent=8).encode(), who="alice", path="/tokens", token=None).status_code == 201
    assert kinds(lent, "token-issued")[-1]["signed"]["body"] == rfc8785.dumps(body).decode()
    post(lent, b'{  "vote" :  "a.b.c"}', path=f"/approvals/{'ab' * 16}/votes")
    assert kinds(lent, "vote-refused")[-1]["signed"]["body"] == '{"vote":"a.b.c"}'


def score(world):
    agents = world.people["alice"].agents()
    return next(agent for agent in agents if agent["id"] == "planner")["trust_by"].get("alice", 800)


def test_refusals_have_a_budget_that_costs_trust(lent):
    slip = Restriction()  # nothing less is asked for: a slip, which alone costs next to nothing
    assert {attempt(lent, slip) for _ in range(BUDGET)} == {"NOT_NARROWER"}
    assert len(kinds(lent, "delegation-refused")) == BUDGET
    before, size = score(lent), len(entries(lent))
    assert attempt(lent, slip) == "REFUSALS_SPENT"
    assert score(lent) < before
    (spent,) = kinds(lent, "refusals-spent")
    assert (spent["agent"], spent["number"], spent["window_s"]) == ("planner", BUDGET, WINDOW_MS // 1_000)
    spent = score(lent)
    for _ in range(10):
        assert attempt(lent, slip) == "REFUSALS_SPENT"
    assert attempt(lent) == "REFUSALS_SPENT"
    assert len(entries(lent)) == size + 1
    assert score(lent) == spent
    # what is granted still is
    assert lent.planner.delegate(lent.token, lent.mover, SLOWER, purpose="p").token


def test_the_budget_is_full_again_after_its_window_and_is_each_agents_own(lent):
    for _ in range(BUDGET + 2):
        attempt(lent)
    own = lent.people["alice"].issue(lent.mover, lent.scope(), purpose="p").token
    with pytest.raises(ClientError) as caught:
        lent.mover.delegate(own, lent.planner, WIDER, purpose="p")
    assert caught.value.code != "REFUSALS_SPENT"
    lent.clock.at_s += WINDOW_MS / 1_000 - 1
    lent.token = lent.people["alice"].issue(lent.planner, lent.scope(), purpose="p").token
    lent.mover.attest()
    assert attempt(lent) == "REFUSALS_SPENT"
    lent.clock.at_s += 1
    assert attempt(lent) == "NOT_NARROWER"


def test_an_agents_votes_are_of_the_same_budget(lent):
    """A sibling: an agent may not vote, and every attempt was kept."""
    body = rfc8785.dumps({"vote": "a.b.c"})
    codes = [post(lent, body, path=f"/approvals/{'ab' * 16}/votes").json()["code"] for _ in range(BUDGET + 3)]
    assert codes[BUDGET:] == ["REFUSALS_SPENT"] * 3
    assert "REFUSALS_SPENT" not in codes[:BUDGET]
    assert len(kinds(lent, "vote-refused")) == BUDGET


def test_what_one_refusal_keeps_is_bounded(lent):
    many = Restriction(grants=tuple(Grant("ur3e", f"operation-{n:02d}-{'x' * 200}") for n in range(64)))
    assert attempt(lent, many) == "NOT_NARROWER"
    (kept,) = kinds(lent, "delegation-refused")
    assert len(kept["widenings"]) <= WIDENINGS
    assert kept["signed"]["body"] == ""
    assert kept["signed"]["proof"].count(".") == 2, "the proof names the body's digest"
    assert max(len(json.dumps(entry)) for entry in entries(lent)) < 32_768
