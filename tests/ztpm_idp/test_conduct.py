"""Trust and behaviour at the provider: from shipped records alone, with the ledger or not at all, told by versions."""

from __future__ import annotations

import json
import secrets

import pytest
from capabilities.values.caps import DEFAULT
from policies.conduct.behaviour import BehaviourState
from policies.conduct.report import Edge
from policies.conduct.trust import TrustState
from policies.conduct.trust_changes import CHARGES
from policies.decision.load import load_shipped
from policies.words.reason_table import Reason
from tests.ztpm_idp.journals import Journal
from tests.ztpm_idp.world import ISSUER, SLOWER

from capabilities.statements import conduct
from policies.conduct import behaviour, trust
from ztpm_idp.client import ClientError

pytestmark = pytest.mark.long

PARAMETERS = load_shipped("paper-default").parameters
WRONG, SLIP = (CHARGES[reason].milli for reason in (Reason.NOT_GRANTED, Reason.LIMIT_EXCEEDED_BY_REQUEST))
ONE_WRONG = round(800 * 20_000 / (20_000 + WRONG))
"""Trust in an edge whose agent did one plain wrong: the prior weighs 20 of them."""


@pytest.fixture
def lent(world):
    """planner has a token of alice's, mover one of planner's."""
    planner, mover = world.agent("planner", role="planner"), world.agent("mover")
    world.first = world.people["alice"].issue(planner, world.scope(), purpose="p").token
    world.second = planner.delegate(world.first, mover, SLOWER, purpose="p").token
    world.journal = Journal(world)
    return world


def told(world, since=0):
    nonce = secrets.token_urlsafe(24)
    with world.known() as http:
        answer = http.get(ISSUER + "/conduct", params={"since": str(since), "nonce": nonce})
    assert answer.status_code == 200, answer.text
    word = conduct.open(answer.text, world.trust.feed, DEFAULT)
    assert (word.issuer, word.nonce, word.since) == (ISSUER, nonce, since)
    return word


def scores(world):
    return {(e.delegator, e.delegate): e.score_permille for e in told(world).edges}


def listed(world, agent):
    (row,) = (row for row in world.people["carol"].agents() if row["id"] == agent)
    return row


def stored(world, table):
    return world.rows(table)


def held(world, agent):
    (row,) = (row for row in stored(world, "conduct") if row["agent"] == agent)
    states = TrustState.from_json(json.loads(row["trust"])), BehaviourState.from_json(json.loads(row["behaviour"]))
    assert [json.dumps(state.to_json()) for state in states] == [row["trust"], row["behaviour"]]
    return states


# --- what is reported ------------------------------------------------------------------------------------------------


def test_a_wrong_lowers_the_edge_into_the_agent_that_acted_and_no_other(lent):
    lent.journal.refused(lent.second)
    lent.journal.ship()
    assert scores(lent) == {("planner", "mover"): ONE_WRONG}
    assert listed(lent, "mover")["trust_by"] == {"planner": ONE_WRONG}
    assert listed(lent, "planner")["trust_by"] == {}


def test_what_the_states_hold_is_what_the_reducers_make_of_the_records(lent):
    """The same reports, reduced here one by one."""
    planner = held(lent, "planner")  # what the provider itself said of the delegation
    for _ in range(3):
        lent.journal.acted(lent.second, tier=2)
    lent.journal.refused(lent.second, "TIER_NEEDS_APPROVAL", "DEFER", tier=3)
    lent.journal.acted(lent.second, "failed", why="EFFECT_FAILED")
    lent.journal.refused(lent.second, "LIMIT_EXCEEDED_BY_REQUEST", speed=900_000)
    lent.journal.ship()
    trusted, behaves = held(lent, "mover")
    assert held(lent, "planner") == planner
    account = trusted.accounts[Edge("planner", "mover")]["cell-1"]
    assert (account.good, account.bad) == (3_000 * trust.GRAIN, SLIP * trust.GRAIN)
    assert behaviour.reading(behaves, "mover", 0, 0, PARAMETERS).samples == 6
    assert listed(lent, "mover")["conduct"]["samples"] == 6


def test_an_outcome_may_come_in_a_later_batch(lent):
    request = lent.journal.acted(lent.second, None)
    digest = lent.journal.prev
    lent.journal.ship()
    assert [row["request_id"] for row in stored(lent, "permits")] == [request.request_id]
    assert not any(row["agent"] == "mover" for row in stored(lent, "conduct"))
    from pep.gate import records

    lent.journal.record("outcome", records.outcome(request, digest, "failed", reason="NOT_WHAT_WAS_DECIDED"))
    lent.journal.ship()
    assert stored(lent, "permits") == []
    assert scores(lent) == {("planner", "mover"): ONE_WRONG}


def test_a_verdict_that_came_too_late_concludes_nothing(lent):
    from pep.gate import records

    request, body = lent.journal.decision(lent.second, tier=2)
    digest = lent.journal.record("decision", body)
    late = records.outcome(request, digest, "refused", reason="VERDICT_EXPIRED")
    lent.journal.record("outcome", late)
    again = lent.journal.record("decision", body)  # the gate decides afresh, for the same request
    lent.journal.ship()
    assert len(stored(lent, "permits")) == 1
    lent.journal.record("outcome", records.outcome(request, again, "done"))
    lent.journal.ship()
    trusted, _ = held(lent, "mover")
    assert trusted.accounts[Edge("planner", "mover")]["cell-1"].good == 1_000 * trust.GRAIN


def test_what_nobody_knows_the_outcome_of_is_no_report(lent):
    lent.journal.acted(lent.second, "unknown")
    lent.journal.ship()
    assert not any(row["agent"] == "mover" for row in stored(lent, "conduct"))


def test_a_permit_without_an_outcome_is_forgotten_in_the_end(lent, monkeypatch):
    monkeypatch.setattr("ztpm_idp.store.conduct.OPEN_RECORDS", 3)
    for _ in range(8):
        lent.journal.acted(lent.second, None)
    lent.journal.ship()
    assert [row["seq"] for row in stored(lent, "permits")] == [5, 6, 7, 8]


# --- what is not reported --------------------------------------------------------------------------------------------


def test_only_authority_that_was_lent_here_and_only_to_audiences_that_are_served(lent):
    """A hop that was never made, an edge that is another's, another audience, no proof: in the ledger, for nothing."""
    from dataclasses import replace

    chain = lent.journal.chain(lent.second)
    leaf = chain.leaf
    forged = replace(chain, hops=(*chain.hops[:-1], replace(leaf, hop_id="f" * 32)))
    other = replace(chain, hops=(*chain.hops[:-1], replace(leaf, agent="helper")))
    stolen = replace(chain, hops=(replace(chain.hops[0], agent="helper"), leaf))
    lent.agent("helper")
    for wrong in (forged, other, stolen):
        lent.journal.refused(lent.second, chain=wrong)
    lent.journal.refused(lent.second, audience="http://127.0.0.1:9/mcp")
    lent.journal.refused(lent.second, proof=False)
    assert lent.journal.ship() == 5
    assert scores(lent) == {}
    assert [row["agent"] for row in stored(lent, "conduct")] == ["planner"]


def test_a_state_that_cannot_be_read_is_not_forgiven(lent):
    lent.journal.refused(lent.second)
    lent.journal.ship()
    before = stored(lent, "ledger")
    lent.sql("UPDATE conduct SET behaviour = '{}' WHERE agent = 'mover'")
    lent.journal.refused(lent.second)
    with pytest.raises(ClientError) as caught:
        lent.journal.ship()
    assert (caught.value.code, caught.value.status) == ("STORE_UNAVAILABLE", 503)
    assert stored(lent, "ledger") == before
    lent.sql("DELETE FROM conduct WHERE agent = 'mover'")
    lent.journal.ship()


def test_an_id_that_no_database_can_look_for(lent):
    lent.journal.refused(lent.second, request_id="a\x00b")
    lent.journal.acted(lent.second, request_id="a\x00c")
    lent.journal.acted(lent.second, "failed", why="NOT_WHAT_WAS_DECIDED", request_id="\u202ex")
    assert lent.journal.ship() == 5
    assert scores(lent) == {}


BODIES = [
    {},
    {"decision": None},
    {"request": {}, "decision": {}, "evidence": {}},
    {"request": [], "decision": "PERMIT", "evidence": {"chain": {"type": "Chain", "hops": []}}},
    {"request_id": 7, "outcome": "done"},
    {"request_id": "r", "outcome": ["done"]},
    {"request_id": "r" * 10_000, "outcome": "done"},
]


@pytest.mark.parametrize("kind", ["decision", "outcome", "refusal", "incident"])
@pytest.mark.parametrize("body", BODIES, ids=range(len(BODIES)))
def test_a_record_of_any_other_shape_is_kept_and_counts_for_nothing(lent, kind, body):
    lent.journal.record(kind, body)
    assert lent.journal.ship() == 1
    assert scores(lent) == {}


def spoilt(body, path, value):
    if not path:
        return value
    copied = body.copy()
    copied[path[0]] = spoilt(copied[path[0]], path[1:], value)
    return copied


def places(value, path=()):
    yield path
    for name, member in (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    ):
        yield from places(member, (*path, name))


@pytest.mark.parametrize("share", [3, pytest.param(1, marks=pytest.mark.campaign)])
def test_no_place_of_a_record_can_be_spoilt_into_an_error_or_a_gain(lent, share):
    """Every place of a real record with strange values is taken, and counts at most one wrong."""
    _, body = lent.journal.decision(lent.second, "DENY", "NOT_GRANTED")
    wrong = [None, 2**53 - 1, 1.5, "", "x" * 300, [[]], True]
    number = 0
    for turn, path in enumerate(places(body)):
        if not path:
            continue
        for value in wrong[turn % share :: share]:
            lent.journal.record("decision", spoilt(body, path, value))
            number += 1
    made = lent.journal.made
    for at in range(0, len(made), 50):
        lent.journal.ship(made[at : at + 50])
    assert number > 500 / share
    assert set(scores(lent)) <= {("planner", "mover")}
    trusted, _ = held(lent, "mover")
    assert set(trusted.accounts) == {Edge("planner", "mover")}
    assert all(account.good == 0 for account in trusted.accounts[Edge("planner", "mover")].values())


def test_the_same_records_again_count_once(lent):
    for _ in range(2):
        lent.journal.refused(lent.second)
    lent.journal.ship()
    before = stored(lent, "conduct"), told(lent).version
    lent.journal.ship(lent.journal.made)
    lent.journal.ship(lent.journal.made[:1])
    assert (stored(lent, "conduct"), told(lent).version) == before


def test_the_same_request_twice_in_a_journal_counts_once(lent):
    _, body = lent.journal.decision(lent.second, "DENY", "NOT_GRANTED")
    for _ in range(5):
        lent.journal.record("decision", body)
    lent.journal.ship()
    assert scores(lent) == {("planner", "mover"): ONE_WRONG}


def test_a_report_from_the_future_does_not_count(lent):
    lent.journal.acted(lent.second, tier=2, at_s=lent.clock() + 3_600)
    lent.journal.refused(lent.second, at_s=lent.clock() + 6)
    lent.journal.ship()
    trusted, behaves = held(lent, "mover")
    assert not trusted.accounts
    assert not behaves.careers
    lent.journal.refused(lent.second, at_s=lent.clock() - 3_600)  # a late one does
    lent.journal.ship()
    assert set(scores(lent)) == {("planner", "mover")}


def test_a_refused_batch_changes_nothing_known_of_anybody(lent):
    lent.journal.refused(lent.second)
    lent.journal.refused(lent.second)
    with pytest.raises(ClientError) as caught:
        lent.journal.ship([lent.journal.made[0], lent.journal.made[1] | {"prev": "0" * 64}])
    assert caught.value.code == "RECORD_CHAIN_BROKEN"
    assert scores(lent) == {}
    assert [row["agent"] for row in stored(lent, "conduct")] == ["planner"]


def test_an_agent_cannot_report(lent):
    lent.journal.refused(lent.second)
    with pytest.raises(ClientError) as caught:
        lent.agents["mover"]._post("/ledger/records", {"records": lent.journal.made})
    assert caught.value.code == "NOT_PERMITTED"


# --- what is told ----------------------------------------------------------------------------------------------------


def test_only_news_is_told_and_only_since_the_version_that_is_known(lent):
    assert told(lent).version == 0
    lent.journal.acted(lent.second)
    lent.journal.ship()
    assert told(lent).version == 0, "a good act of an agent that is trusted already is no news"
    lent.journal.refused(lent.second)
    lent.journal.ship()
    first = told(lent)
    assert (first.version, len(first.edges), first.agents) == (1, 1, ())
    assert told(lent, since=1).edges == ()
    lent.journal.refused(lent.second)
    lent.journal.ship()
    second = told(lent, since=1)
    assert (second.version, second.through) == (2, 2)
    assert second.edges[0].score_permille < first.edges[0].score_permille
    assert len(told(lent).edges) == 1


def probed(world, *, times=60):
    """An agent that asks for what it has not, until that is a deviation."""
    for _ in range(times):
        world.journal.refused(world.second)
    world.journal.ship()


def test_a_deviation_is_told_until_a_person_restores_the_agent(lent):
    probed(lent)
    (standing,) = told(lent).agents
    assert (standing.agent, standing.contracted, standing.restored_at) == ("mover", True, None)
    assert "refusals" in {deviation.feature for deviation in standing.deviations}
    assert standing.deviated_at == int(lent.clock())
    assert listed(lent, "mover")["conduct"]["contracted"] is True
    lent.clock.at_s += 5
    lent.people["alice"].restore_agent("mover", "it was a test")
    (after,) = told(lent, since=told(lent).version - 1).agents
    assert (after.deviations, after.deviated_at, after.contracted) == ((), None, False)
    assert after.restored_at == int(lent.clock())
    kept = lent.people["carol"].export_ledger()
    assert b'"kind":"agent-restored"' in kept
    assert b"it was a test" in kept


def test_relearning_forgets_what_was_usual(lent):
    probed(lent)
    lent.people["alice"].restore_agent("mover", "new work", relearn=True)
    assert listed(lent, "mover")["conduct"]["samples"] == 0


@pytest.mark.parametrize(
    ("who", "code", "status"),
    [
        ("bob", "NOT_PERMITTED", 403),
        ("carol", "NOT_PERMITTED", 403),
        ("planner", "NOT_PERMITTED", 403),
        ("mover", "NOT_PERMITTED", 403),
        ("cell-1", "NOT_PERMITTED", 403),
        ("dan", None, 200),
        ("alice", None, 200),
    ],
)
def test_only_its_sponsor_or_an_administrator_restores_an_agent(lent, who, code, status):
    probed(lent)
    caller = {**lent.people, **lent.agents, **lent.peps}[who]
    ask = lambda: caller._post("/agents/mover/restore", {"reason": "r", "relearn": False})
    if code is None:
        assert ask() == {"id": "mover", "status": "restored"}
        return
    with pytest.raises(ClientError) as caught:
        ask()
    assert (caught.value.code, caught.value.status) == (code, status)
    assert listed(lent, "mover")["conduct"]["contracted"] is True


def test_what_cannot_be_restored(lent):
    alice, bob = lent.people["alice"], lent.people["bob"]

    def refused(person, agent):
        with pytest.raises(ClientError) as caught:
            person.restore_agent(agent, "r")
        return caught.value.code

    lent.agent("quiet")
    assert refused(alice, "quiet") == "NOTHING_TO_RESTORE"
    assert refused(alice, "nobody") == "NOT_FOUND"
    assert refused(bob, "nobody") == "NOT_PERMITTED"
    assert refused(alice, "cell-1") == "NOT_FOUND"
    probed(lent)
    alice.retire_agent("mover", "r")
    assert refused(alice, "mover") == "AGENT_INACTIVE"
    for body in ({"reason": "r", "relearn": 1}, {"relearn": True}, {"reason": "r", "extra": 1}):
        with pytest.raises(ClientError) as caught:
            alice._post("/agents/planner/restore", body)
        assert caught.value.status == 400


def test_the_dead_are_not_told_of(lent):
    probed(lent)
    assert told(lent).agents
    lent.people["alice"].retire_agent("mover", "r")
    assert told(lent).agents == ()
    assert told(lent).edges == ()


def test_what_the_dead_lent_is_not_told_of(lent):
    probed(lent)
    assert told(lent).edges
    lent.people["alice"].retire_agent("planner", "r")
    assert told(lent).edges == ()
    assert [standing.agent for standing in told(lent).agents] == ["mover"]


def test_a_word_that_cannot_hold_everything_is_cut_and_goes_on(lent, monkeypatch):
    world, alice = lent, lent.people["alice"]
    for number in range(5):
        name = f"arm-{number}"
        agent = world.agent(name)
        token = alice.issue(agent, world.scope(), purpose="p").token
        world.journal.refused(token)
    world.journal.ship()
    whole = told(world)
    assert (whole.through, len(whole.edges)) == (whole.version, 5)
    for name, value in (("ztpm_idp.provider.feed.INDEX_BYTES", 200), ("ztpm_idp.provider.feed.conduct.ENTRIES", 2)):
        with monkeypatch.context() as patch:
            patch.setattr(name, value)
            found, since = [], 0
            while True:
                page = told(world, since=since)
                assert page.version == whole.version
                found += page.edges
                if page.through == page.version:
                    break
                assert page.through > since
                since = page.through
            assert tuple(found) == whole.edges, name


@pytest.mark.parametrize(
    "query", [{"since": "-1"}, {"since": "01"}, {"since": "9" * 17}, {"nonce": "short"}, {"x": "1"}]
)
def test_a_question_of_any_other_form(world, query):
    with world.known() as http:
        answer = http.get(ISSUER + "/conduct", params={"since": "0", "nonce": "n" * 24} | query)
    assert (answer.status_code, answer.json()["code"]) == (400, "QUERY_MALFORMED")


def test_who_knows_more_than_the_store_is_told_so(world):
    with world.known() as http:
        answer = http.get(ISSUER + "/conduct", params={"since": "1", "nonce": "n" * 24})
    assert (answer.status_code, answer.json()["code"]) == (409, "EPOCH_AHEAD")


def test_a_store_that_cannot_commit_says_nothing(lent, monkeypatch):
    from ztpm_idp.store import Store, StoreUnavailableError

    async def broken(self):
        raise StoreUnavailableError

    monkeypatch.setattr(Store, "beat", broken)
    with lent.known() as http:
        assert http.get(ISSUER + "/conduct", params={"since": "0", "nonce": "n" * 24}).status_code == 503


# --- young agents ----------------------------------------------------------------------------------------------------


def worked(world, token, times, **changes):
    for number in range(times):
        world.clock.at_s += 1
        world.journal.acted(token, q0=200_000 + number % 7 * 10_000, **changes)
        if number % 25 == 24:
            world.journal.ship()
    world.journal.ship()


@pytest.mark.timeout(300)
def test_a_young_agent_is_compared_with_its_peers_alone(world, monkeypatch):
    """Others of its role and sponsor that have learned; not those of another sponsor, nor of another role."""
    alice, bob = world.people["alice"], world.people["bob"]
    world.journal = Journal(world)
    found = {}

    def looked_at(state, report, parameters, *, now, role):
        found[report.agent] = sorted(agent for agent in state.careers if agent != report.agent)
        return observe(state, report, parameters, now=now, role=role)

    observe = behaviour.observe
    old = world.agent("old")
    world.agent("planner", role="planner"), world.agent("bobs", sponsor="bob")
    worked(
        world,
        alice.issue(old, world.scope(not_after=int(world.clock()) + 3_000), purpose="p").token,
        PARAMETERS.behaviour_learn_count,
    )
    assert held(world, "old")[1].careers["old"].baseline is not None
    monkeypatch.setattr(behaviour, "observe", looked_at)
    for agent, person in (("new", alice), ("planner", alice), ("bobs", bob), ("old", alice)):
        holder = world.agents.get(agent) or world.agent(agent)
        worked(world, person.issue(holder, world.scope(), purpose="p").token, 1)
    assert found == {"new": ["old"], "planner": [], "bobs": [], "old": []}
    assert set(held(world, "new")[1].careers) == {"new"}, "what is stored is its own"
    alice.retire_agent("old", "r")
    worked(world, alice.issue(world.agents["new"], world.scope(), purpose="p").token, 1)
    assert found["new"] == []


def test_a_contracted_agent_loses_its_mandates_and_what_it_drew(lent):
    alice, mover = lent.people["alice"], lent.agents["mover"]
    week = lent.scope(not_after=int(lent.clock()) + 604_800)
    first, other = (alice.sign_mandate(agent, week, purpose="p") for agent in ("mover", "planner"))
    mover.draw(first)
    probed(lent)
    assert listed(lent, "mover")["conduct"]["contracted"] is True
    assert {row["mandate_id"]: row["state"] for row in alice.mandates()} == {first: "revoked", other: "in force"}
    lent.clock.at_s += 5
    alice.restore_agent("mover", "looked at")
    with pytest.raises(ClientError) as caught:
        mover.draw(first)
    assert caught.value.code == "MANDATE_REVOKED"
    mover.draw(alice.sign_mandate("mover", week, purpose="p"))


def test_nothing_is_promised_while_an_agent_is_contracted(lent):
    probed(lent)
    week = lent.scope(not_after=int(lent.clock()) + 604_800)
    with pytest.raises(ClientError) as caught:
        lent.people["alice"].sign_mandate("mover", week, purpose="p")
    assert (caught.value.code, caught.value.status) == ("SCOPE_CONTRACTED", 403)
