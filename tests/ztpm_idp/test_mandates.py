"""Mandates over the wire: signed once, drawn from for days, and ended at once."""

from __future__ import annotations

import json

import pytest
from capabilities.keys import keys
from capabilities.statements.people import mandate as mandate_statement
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Tier
from capabilities.statements.revocation import RevocationView
from capabilities.token.token_text import token_from_text
from capabilities.token.verify import verify
from tests.ztpm_idp.test_lending import chain_of, refused
from tests.ztpm_idp.world import AUDIENCE, SLOWER, START_S

pytestmark = pytest.mark.long

DAY_S = 86_400
WEEK_S = 7 * DAY_S


def signed(world, agent="planner", by="alice", **changes):
    scope = world.scope(not_after=int(world.clock()) + WEEK_S, **changes)
    return world.people[by].sign_mandate(agent, scope, purpose="tidy the hall")


def draws(world, mandate_id, by="alice"):
    return world.people[by].mandate(mandate_id)["draws"]


def dead(world, token):
    """The fault of a token under every revocation that the provider knows."""

    async def read():
        async with world.provider.store.read() as view:
            return await view.revocations.every()

    view = RevocationView(epoch=0, age_ms=0, revoked=world.on_loop(read()))
    found = verify(
        token_from_text(token, DEFAULT), at=world.clock(), audience=AUDIENCE, view=view, lease_ms=1, trust=world.trust,
        caps=DEFAULT,
    )  # fmt: skip
    return found.code if isinstance(found, Fault) else None


def test_an_agent_draws_for_days_and_nobody_is_asked(world):
    planner, mover = world.agent("planner", role="planner", vouched=True), world.agent("mover")
    mandate_id = signed(world)
    for day in range(7):
        world.clock.at_s = START_S + day * DAY_S + 10
        drawn = planner.draw(mandate_id)
        chain = chain_of(world, drawn.token)
        assert (chain.mandate_id, chain.sponsor.subject) == (mandate_id, "alice")
        # The sponsor was there when the mandate was signed, and has not been since.
        assert chain.sponsor.authenticated_at == START_S
        assert chain.leaf.attestation.at == int(world.clock())
        assert chain.scope.not_after == int(world.clock()) + 3_600
        assert chain.leaf.purpose == "tidy the hall"
        if not day:
            less = chain_of(world, planner.delegate(drawn.token, mover, SLOWER, purpose="move").token)
            assert (less.mandate_id, less.scope.not_after) == (mandate_id, chain.scope.not_after)
    told = draws(world, mandate_id)
    assert [each["token_id"] for each in told][0] == drawn.token_id
    assert [each["live"] for each in told] == [True] + [False] * 6
    # Each draw is in the ledger, with the agent's signed request.
    entries = [json.loads(line) for line in world.people["alice"].export_ledger().splitlines()]
    drawn_entries = [entry for entry in entries if entry.get("kind") == "token-drawn"]
    assert len(drawn_entries) == 7
    assert {entry["body"]["mandate_id"] for entry in drawn_entries} == {mandate_id}
    (entry,) = (entry for entry in entries if entry.get("kind") == "mandate-signed")
    by = {keys.public_raw(world.private["alice"])}
    assert mandate_statement.open(entry["body"]["mandate"], by, DEFAULT).agent == "planner"


def test_the_last_token_ends_with_the_mandate(world):
    planner, mover = world.agent("planner", role="planner", vouched=True), world.agent("mover")
    mandate_id = signed(world)
    world.clock.at_s = START_S + WEEK_S - 600
    drawn = planner.draw(mandate_id)
    less = planner.delegate(drawn.token, mover, SLOWER, purpose="m")
    assert drawn.expires_at == less.expires_at == START_S + WEEK_S
    world.clock.at_s = START_S + WEEK_S
    assert refused(planner.draw, mandate_id).code == "MANDATE_OVER"
    assert world.people["alice"].mandates()[0]["state"] == "over"
    assert dead(world, drawn.token) is FaultCode.EXPIRED


@pytest.mark.parametrize("by", ["alice", "planner", "dan"])
def test_revoking_the_mandate_ends_what_was_drawn(world, by):
    planner, mover = world.agent("planner", role="planner"), world.agent("mover")
    mandate_id = signed(world)
    drawn = planner.draw(mandate_id)
    less = planner.delegate(drawn.token, mover, SLOWER, purpose="m")
    issued = world.people["alice"].issue(planner, world.scope(), purpose="p")
    who = planner if by == "planner" else world.people[by]
    assert who.revocation("mandate", mandate_id, "enough").known
    assert dead(world, drawn.token) is dead(world, less.token) is FaultCode.REVOKED
    assert dead(world, issued.token) is None
    assert refused(planner.draw, mandate_id).code == "MANDATE_REVOKED"
    assert refused(planner.delegate, drawn.token, mover, SLOWER, purpose="m").code == "REVOKED"
    assert world.people["alice"].mandate(mandate_id)["state"] == "revoked"


def test_others_neither_see_nor_revoke_nor_draw(world):
    planner, mover = world.agent("planner"), world.agent("mover")
    mandate_id = signed(world)
    for other in (mover, world.people["bob"], world.people["carol"]):
        assert other.mandates() == []
        assert refused(other.mandate, mandate_id).code == "MANDATE_UNKNOWN"
        assert refused(other.revoke, "mandate", mandate_id, "r").code == "NOT_PERMITTED"
    assert [row["mandate_id"] for row in world.people["dan"].mandates()] == [mandate_id]
    assert [row["mandate_id"] for row in planner.mandates()] == [mandate_id]
    request = {"lifetime_s": 60, "mandate_id": mandate_id}
    body = {"request": request, "evidence": mover.evidence("alice", request)}
    assert refused(mover._post, f"/mandates/{mandate_id}/tokens", body).code == "MANDATE_NOT_YOURS"
    # Evidence for one mandate draws from no other, and none twice.
    second = signed(world)
    theirs = {"request": request | {"mandate_id": second}, "evidence": planner.evidence("alice", request)}
    assert refused(planner._post, f"/mandates/{second}/tokens", theirs).code == "ATTESTATION_INVALID"
    assert refused(planner._post, f"/mandates/{mandate_id}/tokens", theirs).code == "MANDATE_UNKNOWN"
    mine = {"request": request, "evidence": planner.evidence("alice", request)}
    planner._post(f"/mandates/{mandate_id}/tokens", mine)
    assert refused(planner._post, f"/mandates/{mandate_id}/tokens", mine).code == "ATTESTATION_INVALID"


def test_two_tokens_are_live_at_most(world):
    planner = world.agent("planner")
    mandate_id = signed(world)
    first = planner.draw(mandate_id, lifetime_s=600)
    planner.draw(mandate_id, lifetime_s=900)
    assert refused(planner.draw, mandate_id).code == "MANDATE_TOKENS_LIVE"
    assert world.people["alice"].mandates()[0]["live"] == 2
    # One that the agent gives up, or that is over, makes room.
    planner.revoke("token", first.token_id, "done")
    planner.draw(mandate_id, lifetime_s=600)
    assert refused(planner.draw, mandate_id).code == "MANDATE_TOKENS_LIVE"
    world.clock.at_s += 600
    planner.draw(mandate_id)


def test_what_stops_the_sponsor_or_the_agent_stops_a_draw(world):
    planner = world.agent("planner", sponsor="bob")
    mandate_id = signed(world, by="bob")
    drawn = planner.draw(mandate_id)
    world.people["bob"].suspend_agent("planner", "a look")
    assert refused(planner.draw, mandate_id).code == "AGENT_SUSPENDED"
    assert world.people["bob"].mandates()[0]["state"] == "suspended"
    world.people["bob"].restore_agent("planner", "fine")
    planner.draw(mandate_id)
    # Off-boarding the sponsor ends the mandate, whatever was drawn, and the sponsor's agents.
    world.people["alice"].revoke("sponsor", "bob", "left")
    assert dead(world, drawn.token) is FaultCode.REVOKED
    assert world.people["dan"].mandates()[0]["state"] == "ended"
    other = world.agent("other", sponsor="alice")
    mine = signed(world, agent="other")
    world.people["alice"].retire_agent("other", "old")
    assert refused(other.draw, mine).code == "CALLER_INACTIVE"


def test_another_persons_agent_draws_until_the_sponsor_leaves(world):
    planner = world.agent("planner", sponsor="alice")
    mandate_id = signed(world, by="bob")
    planner.draw(mandate_id)
    world.people["alice"].revoke("sponsor", "bob", "left")
    request = {"lifetime_s": 60, "mandate_id": mandate_id}
    body = {"request": request, "evidence": planner.evidence("bob", request)}
    assert refused(planner._post, f"/mandates/{mandate_id}/tokens", body).code == "SPONSOR_INACTIVE"


def test_a_persons_key_takes_its_mandates_along(world):
    planner = world.agent("planner", sponsor="bob")
    second = keys.generate()
    bob, first = world.people["bob"], world.private["bob"]
    world.people["dan"].confirm_change(bob.propose_key(keys.public_raw(second)))
    mandate_id = signed(world, by="bob")
    drawn = planner.draw(mandate_id)
    world.private["bob"] = second
    later = world.caller(type(bob), "bob")
    kept = later.sign_mandate("planner", world.scope(not_after=int(world.clock()) + 60), purpose="p")
    later.revoke("key", keys.thumbprint(keys.public_raw(first)), "lost")
    assert dead(world, drawn.token) is FaultCode.REVOKED
    assert refused(planner.draw, mandate_id).code == "MANDATE_REVOKED"
    planner.draw(kept)


def test_a_dead_audience_is_left_out_of_a_draw(world):
    planner, other = world.agent("planner"), "http://127.0.0.1:8801/mcp"
    mandate_id = signed(world, audiences=frozenset({AUDIENCE, other}))
    world.people["alice"].revoke("audience", other, "gone")
    assert chain_of(world, planner.draw(mandate_id).token).scope.audiences == {AUDIENCE}
    world.people["alice"].revoke("audience", AUDIENCE, "gone")
    assert refused(planner.draw, mandate_id).code == "MANDATE_LEAVES_NOTHING"


def test_the_evidence_bounds_the_ceiling_of_a_draw(world):
    planner, platform = world.agent("planner"), world.agent("vision", vouched=True)
    whole = {"ceiling": Tier(4)}
    assert chain_of(world, planner.draw(signed(world, **whole)).token).scope.ceiling is Tier(3)
    assert chain_of(world, platform.draw(signed(world, agent="vision", **whole)).token).scope.ceiling is Tier(4)


def test_signing_again_is_one_mandate_and_another_text_none(world):
    world.agent("planner")
    alice, key = world.people["alice"], world.private["alice"]
    mandate_id = signed(world)
    told = alice.mandate(mandate_id)
    assert alice._post("/mandates", {"mandate": told["mandate"]}) == {"mandate_id": mandate_id}
    promised = mandate_statement.read_again(told["mandate"])
    other = mandate_statement.sign(_with(promised, purpose="more"), key)
    assert refused(alice._post, "/mandates", {"mandate": other}).code == "MANDATE_DIFFERS"
    assert len(alice.mandates()) == 1
    for body in ({}, {"mandate": 1}, {"mandate": "a.b.c"}, {"mandate": told["mandate"] + "A"}):
        assert refused(alice._post, "/mandates", body).status in {400, 403}
    for path in ("/mandates/x", "/mandates/" + "0" * 32, "/mandates/" + "A" * 32):
        assert refused(alice._send, "GET", path, b"", None).code == "MANDATE_UNKNOWN"


def _with(promised, **changes):
    from msgspec import structs

    return structs.replace(promised, **changes)
