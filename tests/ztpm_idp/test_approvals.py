"""Asking people over the wire: an ask is shown, answered by signed votes, told to its PEP, and ends."""

from __future__ import annotations

import json
import secrets
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import httpx2
import pytest
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import Tier
from capabilities.values.units import INT_LIMIT
from tests.ztpm_idp.asks import AGENT, AT_ONCE, PEP, Cell
from tests.ztpm_idp.routes.test_endpoints import checked
from tests.ztpm_idp.world import AUDIENCE, ISSUER, World
from ztpm_idp.domain.asking.asks import OPENINGS, STANDING_ASKS, Answer, Asked, AskRecord, OpeningRecord, VoteRecord
from ztpm_idp.domain.events import VoteCast
from ztpm_idp.keys.key_files import SettingsError
from ztpm_idp.settings import check_settings
from ztpm_idp.store.approvals import Approvals

from capabilities.keys import keys
from capabilities.statements import registry
from capabilities.statements.people import answers, ask, opening, vote
from ztpm_idp import ledger_file
from ztpm_idp.client import ClientError, Operator
from ztpm_idp.provider import feed
from ztpm_idp.store import ConflictError

pytestmark = pytest.mark.long

ROUNDS = 8
ELSEWHERE = "http://127.0.0.1:8801/mcp"


@pytest.fixture
def cell(world):
    return Cell(world)


def code_of(action):
    with pytest.raises(ClientError) as caught:
        action()
    return caught.value.code


def opened(cell, who="carol", **changes):
    stated = dict(audience=AUDIENCE, agent=AGENT, object="ur3e", operation="move_joint")
    return cell.world.people[who].open_tier_4(**(stated | changes))


def states(cell):
    return {told.ask_id: told.state for told in cell.answers().asks}


# --- the way of an ask -------------------------------------------------------------------------------------------------


def test_an_ask_is_taken_once_shown_answered_and_told(cell):
    carol, text = cell.world.people["carol"], cell.text()
    first = cell.post(PEP, "/approvals", {"ask": text})
    ask_id = first.json()["ask_id"]
    assert (first.status_code, first.json()["url"]) == (201, f"{ISSUER}/approvals/{ask_id}/page")
    again = cell.post(PEP, "/approvals", {"ask": text})
    assert (again.status_code, again.json()) == (200, first.json())
    assert [entry["kind"] for entry in cell.ledger()].count("ask-taken") == 1

    assert [row["ask_id"] for row in carol.approvals()] == [ask_id]
    found = carol.approval(ask_id)
    assert (found["ask"], found["state"], found["votes"]) == (text, "open", [])
    assert found["ask_digest"] == vote.digest_of(text)
    pep_key = keys.public_raw(cell.world.private[PEP])
    stated = ask.open(text, {pep_key}, DEFAULT)
    assert found["shown"]["values"][0] == {"name": "q0", "unit": "urad", "value": -1_570_796}
    assert (found["shown"]["index_milli"], found["shown"]["tier"]) == (stated.index_milli, int(stated.tier))
    assert json.loads(json.dumps(found["shown"])).keys() == set(ask.NAMES)
    assert cell.told(ask_id) == answers.AnsweredAsk(ask_id, "open", ())

    assert carol.approve(ask_id, uses=3, lifetime_s=60, shown=found["ask_digest"]) == {
        "ask_id": ask_id,
        "state": "granted",
    }
    told = cell.told(ask_id)
    assert told.state == "granted"
    with cell.world.known() as http:
        snapshot = registry.open(
            http.get(ISSUER + "/registry", params={"audience": AUDIENCE}).text, cell.world.trust.registry, DEFAULT
        )
    cast = vote.open(told.votes[0], {snapshot.approver("carol").key}, DEFAULT)
    assert cast == vote.Vote(
        ask_id, stated.nonce, vote.digest_of(text), "approve", "carol", False, 3, cell.now + 60, cell.now
    )  # fmt: skip
    assert carol.approvals() == []
    assert [row["ask_id"] for row in carol.approvals("granted")] == [ask_id]
    assert carol.approval(ask_id)["votes"] == list(told.votes)


def test_answers_are_signed_for_one_audience_and_echo_the_nonce(cell):
    nonce = secrets.token_urlsafe(24)
    found = cell.answers(nonce=nonce)
    assert (found.issuer, found.audience, found.nonce, found.as_of_ms) == (ISSUER, AUDIENCE, nonce, cell.now * 1_000)
    cell.world.private["cell-2"] = keys.generate()
    cell.world.people["alice"].register_pep("cell-2", keys.public_raw(cell.world.private["cell-2"]), [ELSEWHERE])
    ask_id, _ = cell.taken()
    theirs = cell.get("cell-2", f"/approvals/answers?audience={ELSEWHERE}&nonce={nonce}")
    assert answers.open(theirs.text, cell.world.trust.registry, DEFAULT).asks == ()
    assert cell.told(ask_id) is not None
    path = f"/approvals/answers?audience={AUDIENCE}&nonce={nonce}"
    for who in ("cell-2", "alice", "carol", AGENT):
        assert checked(cell.get(who, path), status=403)["code"] == "NOT_PERMITTED", who
    with cell.world.anonymous() as http:
        checked(http.get(ISSUER + path), status=401)
    for query in ("", f"?audience={AUDIENCE}", f"?nonce={nonce}", f"?audience={AUDIENCE}&nonce=short",
                  f"?audience={AUDIENCE}&nonce={nonce}&more=1", f"?audience={AUDIENCE}&nonce={nonce}&nonce={nonce}"):  # fmt: skip
        assert checked(cell.get(PEP, "/approvals/answers" + query), status=400)["code"] == "QUERY_MALFORMED", query


def test_only_people_read_asks(cell):
    ask_id, _ = cell.taken()
    for path in ("/approvals?state=open", f"/approvals/{ask_id}", "/openings"):
        for who in (PEP, AGENT):
            assert checked(cell.get(who, path), status=403)["code"] == "NOT_PERMITTED"
        with cell.world.anonymous() as http:
            checked(http.get(ISSUER + path), status=401)
        for who in cell.world.ROLES:
            assert cell.get(who, path).status_code == 200
    for query in ("", "?state=", "?state=all", "?state=open&state=open", "?x=1"):
        assert checked(cell.get("carol", "/approvals" + query), status=400)["code"] == "QUERY_MALFORMED"
    for path in (f"/approvals/{'0' * 32}", "/approvals/x", f"/approvals/{'A' * 32}", f"/approvals/{'0' * 32}/page"):
        assert checked(cell.get("carol", path), status=404)["code"] == "ASK_UNKNOWN"


def test_silence_ends_an_ask_and_nobody_has_to_do_anything(cell):
    ask_id, _ = cell.taken()
    cell.world.clock.at_s += 599.999
    assert cell.told(ask_id).state == "open"
    cell.world.clock.at_s += 0.001
    assert cell.told(ask_id).state == "expired"
    cell.world.clock.at_s += 600
    assert cell.told(ask_id).state == "expired"
    cell.world.clock.at_s += 1
    assert cell.told(ask_id) is None
    assert cell.world.people["carol"].approval(ask_id)["state"] == "expired"


def test_an_approval_outlives_its_ask_and_then_lapses(cell):
    ask_id, _ = cell.taken(expires_at=cell.now + 10)
    cell.world.people["carol"].approve(ask_id, lifetime_s=120)
    cell.world.clock.at_s += 120
    assert cell.told(ask_id).state == "granted"
    cell.world.clock.at_s += 1
    assert cell.told(ask_id).state == "expired"
    cell.world.clock.at_s += 599
    assert cell.told(ask_id).state == "expired"
    cell.world.clock.at_s += 1
    assert cell.told(ask_id) is None


def test_one_denial_ends_an_ask_even_one_that_was_granted(cell):
    (one, _), (two, _) = cell.taken(), cell.taken()
    alice, carol = cell.world.people["alice"], cell.world.people["carol"]
    assert carol.deny(one)["state"] == "denied"
    assert alice.approve(two)["state"] == "granted"
    assert carol.deny(two)["state"] == "denied"
    assert alice.withdraw(two)["state"] == "denied", "taking back stays possible"
    assert states(cell) == {one: "denied", two: "denied"}
    assert [vote.split(".")[0] != "" for vote in cell.told(two).votes] == [True] * 3


def test_whoever_approved_may_take_it_back(cell):
    ask_id, _ = cell.taken()
    carol = cell.world.people["carol"]
    carol.approve(ask_id)
    assert carol.withdraw(ask_id)["state"] == "withdrawn"
    told = cell.told(ask_id)
    key = keys.public_raw(cell.world.private["carol"])
    assert (told.state, [vote.open(text, {key}, DEFAULT).answer for text in told.votes]) == (
        "withdrawn", ["approve", "withdraw"],
    )  # fmt: skip


def test_a_withdrawal_is_taken_when_the_ask_is_long_over(cell):
    ask_id, _ = cell.taken(expires_at=cell.now + 10)
    carol = cell.world.people["carol"]
    carol.approve(ask_id, lifetime_s=20)
    cell.world.clock.at_s += 100
    assert carol.withdraw(ask_id)["state"] == "withdrawn"


def test_what_was_not_seen_needs_an_approver_who_sees_it(cell):
    for perception in ("stale", "missing"):
        ask_id, _ = cell.taken(perception=perception, perception_age_ms=None)
        assert code_of(lambda i=ask_id: cell.world.people["carol"].approve(i)) == "CLEAR_NOT_SEEN"
        assert cell.world.people["carol"].approve(ask_id, sees_clear=True)["state"] == "granted"
    ask_id, _ = cell.taken(perception="missing", perception_age_ms=None)
    assert cell.world.people["carol"].deny(ask_id)["state"] == "denied"


def test_an_act_without_a_robot_needs_nobody_who_sees_a_cell(cell):
    nothing = {"start_urad": (), "contributors": (), "index_milli": 0, "perception_age_ms": None}
    ask_id, _ = cell.taken(perception="none", **nothing)
    assert cell.world.people["carol"].approve(ask_id)["state"] == "granted"


@pytest.mark.parametrize("stated", [{"index_milli": 1}, {"start_urad": (0,) * 6}, {"perception_age_ms": 3}])
def test_an_act_without_a_robot_has_no_physics(cell, stated):
    nothing = {"start_urad": (), "contributors": (), "index_milli": 0, "perception_age_ms": None}
    refused = cell.post(PEP, "/approvals", {"ask": cell.text(perception="none", **{**nothing, **stated})})
    assert (refused.status_code, refused.json()["code"]) == (400, "STATEMENT_MALFORMED")


# --- tier 4 ------------------------------------------------------------------------------------------------------------


def test_a_safety_critical_act_needs_an_opening_and_two_people(cell):
    opening_id = opened(cell)
    text = cell.answers().openings[0]
    assert opening.open(text, {keys.public_raw(cell.world.private["carol"])}, DEFAULT).opening_id == opening_id
    ask_id, _ = cell.taken(tier=Tier(4), approvers=2, opening_id=opening_id)
    assert cell.world.people["alice"].approve(ask_id)["state"] == "open"
    assert code_of(lambda: cell.world.people["alice"].approve(ask_id)) == "VOTED_BEFORE"
    assert cell.told(ask_id).state == "open"
    assert cell.world.people["carol"].approve(ask_id)["state"] == "granted"
    assert len(cell.told(ask_id).votes) == 2


def test_two_approvals_that_never_held_together_are_not_two(cell):
    ask_id, _ = cell.taken(approvers=2)
    cell.world.people["alice"].approve(ask_id, lifetime_s=30)
    cell.world.clock.at_s += 31
    assert cell.told(ask_id).state == "expired"
    assert code_of(lambda: cell.world.people["carol"].approve(ask_id)) == "ASK_OVER"


def test_the_first_of_two_approvals_to_lapse_ends_both(cell):
    ask_id, _ = cell.taken(approvers=2)
    cell.world.people["alice"].approve(ask_id, lifetime_s=30)
    cell.world.people["carol"].approve(ask_id, lifetime_s=300)
    cell.world.clock.at_s += 30
    assert cell.told(ask_id).state == "granted"
    cell.world.clock.at_s += 1
    assert cell.told(ask_id).state == "expired"


def test_an_opening_is_made_listed_and_closed_once(cell):
    text = cell.opening("alice")
    first, again = (cell.post("alice", "/openings", {"opening": text}) for _ in range(2))
    assert (first.status_code, again.status_code, again.json()) == (201, 200, first.json())
    opening_id = first.json()["opening_id"]
    (listed,) = cell.world.people["bob"].openings()
    assert (listed["opening_id"], listed["opener"], listed["opening"]) == (opening_id, "alice", text)
    carol = cell.world.people["carol"]
    carol.close_opening(opening_id, "not today")
    carol.close_opening(opening_id, "again")
    assert carol.openings() == []
    assert cell.answers().openings == ()
    closed = [entry["body"] for entry in cell.ledger() if entry["kind"] == "opening-closed"]
    assert [(each["opening_id"], each["reason"]) for each in closed] == [(opening_id, "not today")]
    assert cell.post("alice", "/openings", {"opening": text}).status_code == 200, "and it stays closed"
    assert carol.openings() == []


def test_an_opening_ends_by_itself(cell):
    opened(cell, lifetime_s=60)
    cell.world.clock.at_s += 60
    assert len(cell.answers().openings) == 1
    cell.world.clock.at_s += 1
    assert cell.answers().openings == ()
    assert cell.world.people["carol"].openings() == []


def test_openings_are_bounded(cell):
    made = [opened(cell) for _ in range(OPENINGS)]
    assert code_of(lambda: opened(cell)) == "TOO_MANY_OPENINGS"
    cell.world.people["alice"].close_opening(made[0], "room")
    opened(cell)
    assert len(cell.answers().openings) == OPENINGS


# --- people who are not approvers any more -----------------------------------------------------------------------------


def test_an_approval_by_somebody_disabled_since_does_not_count(cell):
    alice = cell.world.people["alice"]
    cell.world.person("erin", "approver")
    erin = cell.world.caller(Operator, "erin")
    (one, _), (two, _) = cell.taken(), cell.taken(approvers=2)
    erin.approve(one)
    erin.approve(two)
    cell.world.end("erin")
    assert states(cell) == {one: "open", two: "open"}
    assert alice.approve(two)["state"] == "open"
    assert cell.world.people["carol"].approve(two)["state"] == "granted"
    assert code_of(lambda: erin.deny(one)) == "CALLER_INACTIVE"


def test_the_registry_version_grows_with_the_approvers(cell):
    def snapshot():
        with cell.world.known() as http:
            text = http.get(ISSUER + "/registry", params={"audience": AUDIENCE}).text
        return registry.open(text, cell.world.trust.registry, DEFAULT)

    first = snapshot()
    assert [entry.id for entry in first.approvers] == ["alice", "carol"]
    cell.world.person("frank", "sponsor", "admin")
    assert snapshot().version == first.version
    cell.world.person("erin", "approver")
    second = snapshot()
    assert second.version > first.version
    assert second.approver("erin").key == keys.public_raw(cell.world.private["erin"])
    cell.world.end("erin")
    third = snapshot()
    assert third.version > second.version
    assert third.approver("erin") is None


# --- the budget --------------------------------------------------------------------------------------------------------


def refused(cell, **changes):
    return checked(cell.post(PEP, "/approvals", {"ask": cell.text(**changes)}), status=429)["code"]


def test_one_agent_has_a_third_of_the_budget(cell):
    cell.world.agent("other")
    taken = [cell.taken() for _ in range(8)]
    assert refused(cell) == "ASK_BUDGET_SPENT"
    assert cell.post(PEP, "/approvals", {"ask": taken[0][1]}).status_code == 200, "what was taken is taken"
    cell.taken(agent="other")
    # An answer makes room, and so does silence.
    cell.world.people["carol"].deny(taken[0][0])
    cell.taken()
    assert refused(cell) == "ASK_BUDGET_SPENT"
    cell.world.people["carol"].approve(taken[1][0])
    cell.taken()
    assert refused(cell) == "ASK_BUDGET_SPENT"
    cell.world.clock.at_s += 600
    cell.taken()


def test_the_whole_budget_and_what_is_never_budgeted(cell):
    for agent in ("a1", "a2", "a3"):
        cell.world.agent(agent)
        for _ in range(8):
            cell.taken(agent=agent)
    assert refused(cell) == "ASK_BUDGET_SPENT"
    alice = cell.world.people["alice"]
    opening_id = opened(cell)
    alice.close_opening(opening_id, "no")
    assert alice.retire_agent("a1", "odd") == 1
    assert len(cell.answers().asks) == 24


@pytest.mark.parametrize(("budget", "share"), [(1, 1), (3, 1), (6, 2)])
def test_the_budget_is_a_setting(tmp_path, budget, share):
    with World(tmp_path, settings_changes={"open_asks": budget}) as world:
        cell = Cell(world)
        for _ in range(share):
            cell.taken()
        assert refused(cell) == "ASK_BUDGET_SPENT"


@pytest.mark.parametrize("asks", [0, -1, STANDING_ASKS + 1, "24", True, 1.5])
def test_a_budget_out_of_range_is_refused(asks):
    stated = {"issuer": ISSUER, "host": "127.0.0.1", "port": 1, "database_url": "sqlite+aiosqlite:////tmp/x", "root_key_id": 1}  # fmt: skip
    with pytest.raises(SettingsError) as caught:
        check_settings(stated | {"open_asks": asks})
    assert caught.value.setting == "open_asks"


def test_more_than_can_be_told_is_not_taken(cell, monkeypatch):
    """Granted asks wait for nobody, and still must fit what their enforcement point is told."""
    most = 9
    monkeypatch.setattr("ztpm_idp.domain.asking.approvals.STANDING_ASKS", most)
    taken = []
    for _ in range(most):
        taken.append(cell.taken()[0])
        cell.world.people["carol"].approve(taken[-1], lifetime_s=3_600)
    assert refused(cell) == "ASK_BUDGET_SPENT"
    assert states(cell) == dict.fromkeys(taken, "granted")
    cell.world.people["carol"].withdraw(taken[0])
    cell.taken()


LONG = "n" * 256
NAME = "n" * 63
"""The longest name of a party (`wire.Name`)."""


def record(n, votes=(), **changes):
    stated = AskRecord(f"{n:032x}", "0" * 32, "0" * 64, PEP, AUDIENCE, AGENT, "alice", 2, True, 0, INT_LIMIT // 1_000)
    return Asked(replace(stated, **changes), tuple(votes))


def longest_vote(answer="withdraw"):
    stated = vote.Vote("f" * 32, "f" * 32, "f" * 64, answer, NAME, False, 100, INT_LIMIT, INT_LIMIT)
    return VoteRecord(NAME, Answer(answer), INT_LIMIT // 1_000, True, vote.sign(stated, keys.generate()))


def longest_opening():
    url = "http://" + "h" * 249
    text = opening.sign(
        opening.Opening("f" * 32, NAME, url, NAME, LONG, LONG, LONG, 100, INT_LIMIT - 1, INT_LIMIT), keys.generate()
    )
    return OpeningRecord("f" * 32, "f" * 64, NAME, url, NAME, LONG, LONG, 0, INT_LIMIT // 1_000, False, text)


def test_all_that_stands_fits_one_answer_whatever_is_over(cell, monkeypatch):
    """With the longest votes and openings, every open or granted ask is told whole, then the latest others."""
    approval = longest_vote("approve")
    standing = [record(n, [approval, replace(approval, approver="o" * 63)]) for n in range(STANDING_ASKS)]
    over = [record(1_000 + n, [longest_vote("deny")] * 5) for n in range(500)]

    async def asks(self, *, since_s, audience):
        return [*standing, *over]

    async def openings(self, *, since_s, audience):
        return (longest_opening(),) * OPENINGS

    monkeypatch.setattr(Approvals, "not_long_over", asks)
    monkeypatch.setattr(Approvals, "openings", openings)
    found = cell.answers()
    assert {told.ask_id for told in found.asks if told.state == "granted"} == {asked.ask.ask_id for asked in standing}
    assert all(len(told.votes) == 2 for told in found.asks if told.state == "granted")
    assert len(found.openings) == OPENINGS
    rest = [told.ask_id for told in found.asks if told.state == "denied"]
    assert rest == [asked.ask.ask_id for asked in reversed(over)][: len(rest)]
    standing.clear()
    assert len(cell.answers().asks) > len(rest)


# --- once only ---------------------------------------------------------------------------------------------------------


def together(actions):
    def attempt(action):
        try:
            return action()["state"]
        except ClientError as error:
            return error.code

    with ThreadPoolExecutor(len(actions)) as pool:
        return sorted(pool.map(attempt, actions))


def test_one_person_votes_once_however_often_at_the_same_time(cell):
    ask_id, _ = cell.taken(approvers=2)
    carol = cell.world.people["carol"]
    codes = together([lambda: carol.approve(ask_id)] * 32 + [lambda: carol.deny(ask_id)] * 32)
    assert [code for code in codes if code != "VOTED_BEFORE"] in (["open"], ["denied"])
    assert len(codes) == 64
    assert len(cell.told(ask_id).votes) == 1
    assert sum(entry["kind"] == "vote-cast" for entry in cell.ledger()) == 1


@pytest.mark.parametrize(("approvers", "one", "other"), AT_ONCE)
def test_two_people_at_the_same_time_make_one_outcome_of_which_both_are_told(cell, approvers, one, other):
    for _ in range(ROUNDS):
        cell.world.clock.at_s += 150  # how many may be asked is bounded by the hour
        ask_id, text = cell.taken(approvers=approvers)
        said = cell.together(ask_id, text, {"alice": one, "carol": other})
        assert said in AT_ONCE[approvers, one, other]
        told = cell.told(ask_id)
        assert told.state == ("denied" if "denied" in said else "granted")
        assert len(told.votes) == sum(each.islower() for each in said)
        assert {cell.world.people[who].approval(ask_id)["state"] for who in ("alice", "carol")} == {told.state}
    cast = [entry["body"]["vote"] for entry in cell.ledger() if entry["kind"] == "vote-cast"]
    assert len(cast) == len(set(cast)) >= ROUNDS


def test_one_ask_id_is_taken_once(cell):
    ask_id = secrets.token_hex(16)
    texts = [cell.text(ask_id=ask_id, index_milli=n) for n in range(32)]
    with ThreadPoolExecutor(32) as pool:
        found = list(pool.map(lambda text: cell.post(PEP, "/approvals", {"ask": text}), texts))
    assert sorted(response.status_code for response in found) == [201] + [409] * 31
    assert {response.json()["code"] for response in found if response.status_code == 409} == {"ASK_DIFFERS"}


def test_the_budget_holds_however_many_ask_at_the_same_time(cell):
    texts = [cell.text() for _ in range(64)]
    with ThreadPoolExecutor(64) as pool:
        found = list(pool.map(lambda text: cell.post(PEP, "/approvals", {"ask": text}).status_code, texts))
    assert sorted(found) == [201] * 8 + [429] * 56


def test_the_database_itself_takes_one_answer_of_each_person(cell):
    """The domain decided on an older view: the table refuses, and nothing of the transaction holds."""
    ask_id, text = cell.taken(approvers=2)
    store = cell.world.provider.store
    first = cell.vote(text)
    again = VoteRecord("carol", Answer.DENY, cell.now + 1, True, cell.vote(text, answer="deny"))

    async def cast(place, record):
        async with store.write() as transaction:
            await transaction.append((VoteCast(ask_id, place, record, None),), actor="carol", at_ms=1)

    assert cell.post("carol", f"/approvals/{ask_id}/votes", {"vote": first}).status_code == 201
    for place, changed in ((2, again), (1, replace(again, approver="alice"))):
        with pytest.raises((ConflictError, AttributeError)) as caught:
            cell.world.on_loop(cast(place, changed))
        assert caught.type is ConflictError
    assert cell.told(ask_id).votes == (first,)


# --- what remains ------------------------------------------------------------------------------------------------------


def test_asks_votes_and_openings_survive_a_restart(cell):
    opening_id = opened(cell)
    closed = opened(cell)
    cell.world.people["alice"].close_opening(closed, "no")
    asked = [cell.taken() for _ in range(4)]
    cell.taken(tier=Tier(4), approvers=2, opening_id=opening_id)
    carol = cell.world.people["carol"]
    carol.approve(asked[0][0])
    carol.deny(asked[1][0])
    carol.approve(asked[2][0])
    carol.withdraw(asked[2][0])
    before = cell.answers()
    assert sorted(told.state for told in before.asks) == ["denied", "granted", "open", "open", "withdrawn"]
    cell.world.stop()
    cell.world.start()
    cell.world.people = {name: cell.world.caller(Operator, name) for name in cell.world.ROLES}
    assert cell.answers() == before
    assert code_of(lambda: cell.world.people["carol"].deny(asked[0][0])) == "VOTED_BEFORE"
    assert cell.world.people["alice"].approve(asked[3][0])["state"] == "granted"


def test_the_ledger_holds_every_act_as_it_was_signed(cell):
    world = cell.world
    opening_id = opened(cell)
    ask_id, text = cell.taken(tier=Tier(4), approvers=2, opening_id=opening_id)
    world.people["alice"].approve(ask_id)
    bad = cell.vote(text, AGENT)
    assert cell.post(AGENT, f"/approvals/{ask_id}/votes", {"vote": bad}).status_code == 403
    world.people["carol"].deny(ask_id)
    world.people["carol"].close_opening(opening_id, "done")
    lines = world.people["carol"].export_ledger().splitlines()
    assert isinstance(ledger_file.verify(lines, world.trust), ledger_file.Verified)
    entries = [entry for entry in map(json.loads, lines[:-1]) if entry["kind"].startswith(("ask", "vote", "opening"))]
    assert [(entry["kind"], entry["actor"]) for entry in entries] == [
        ("opening-made", "carol"),
        ("ask-taken", PEP),
        ("vote-cast", "alice"),
        ("vote-refused", AGENT),
        ("vote-cast", "carol"),
        ("opening-closed", "carol"),
    ]
    public = {name: {keys.public_raw(world.private[name])} for name in ("alice", "carol", PEP)}
    assert opening.open(entries[0]["body"]["opening"], public["carol"], DEFAULT).opening_id == opening_id
    assert ask.open(entries[1]["body"]["ask"], public[PEP], DEFAULT).ask_id == ask_id
    digest = vote.digest_of(entries[1]["body"]["ask"])
    for entry, name, state in ((entries[2], "alice", "open"), (entries[4], "carol", "denied")):
        assert vote.open(entry["body"]["vote"], public[name], DEFAULT).ask_digest == digest
        assert entry["body"]["state"] == state
    refusal = entries[3]["body"]
    assert (refusal["code"], refusal["by"], refusal["digest"]) == ("NOT_PERMITTED", AGENT, vote.digest_of(bad))
    assert json.loads(refusal["signed"]["body"]) == {"vote": bad}
    for n in range(len(lines)):
        if b'"vote-cast"' in lines[n]:
            cut = [
                *lines[:n],
                lines[n].replace(b'"denied"', b'"granted"').replace(b'"open"', b'"opem"'),
                *lines[n + 1 :],
            ]
            assert isinstance(ledger_file.verify(cut, world.trust), ledger_file.Defect)


# --- the person's side -------------------------------------------------------------------------------------------------


class Liar(httpx2.BaseTransport):
    """Passes everything through, but changes what `GET /approvals/{ask_id}` answers; keeps what is posted."""

    def __init__(self, inner, change):
        self.inner, self.change, self.posted = inner, change, []

    def handle_request(self, request):
        response = self.inner.handle_request(request)
        if request.method == "POST":
            self.posted.append(request)
            return response
        return httpx2.Response(200, json=self.change(response.json()))


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("another text by another key", "ASK_CHANGED"),
        ("another key", "ANSWER_MALFORMED"),
        ("another ask", "ANSWER_MALFORMED"),
        ("a vote", "ANSWER_MALFORMED"),
        ("no ask", "ANSWER_MALFORMED"),
        ("no key", "ANSWER_MALFORMED"),
        ("a key that is none", "ANSWER_MALFORMED"),
        ("a list", "ANSWER_MALFORMED"),
        ("a flipped text", "ANSWER_MALFORMED"),
    ],
)
def test_nothing_is_signed_but_what_was_shown(cell, name, code):
    ask_id, text = cell.taken()
    other_key = keys.generate()
    changes = {
        "another text by another key": lambda a: a | {"ask": ask.sign(cell.ask(ask_id=ask_id, index_milli=1), other_key), "pep_key": keys.b64u(keys.public_raw(other_key))},
        "another key": lambda a: a | {"pep_key": keys.b64u(keys.public_raw(other_key))},
        "another ask": lambda a: a | {"ask": cell.text()},
        "a vote": lambda a: a | {"ask": cell.vote(text), "pep_key": keys.b64u(keys.public_raw(cell.world.private["carol"]))},
        "no ask": lambda a: {k: v for k, v in a.items() if k != "ask"},
        "no key": lambda a: a | {"pep_key": None},
        "a key that is none": lambda a: a | {"pep_key": "A" * 43},
        "a list": lambda a: [a],
        "a flipped text": lambda a: a | {"ask": a["ask"].replace(a["ask"].split(".")[1][:8], "AAAAAAAA")},
    }  # fmt: skip
    digest = cell.world.people["carol"].approval(ask_id)["ask_digest"]
    liar = Liar(cell.world.transport, changes[name])
    carol = Operator("carol", cell.world.private["carol"], ISSUER, transport=liar, now=cell.world.clock)
    assert code_of(lambda: carol.approve(ask_id, shown=digest)) == code
    assert liar.posted == []
    assert cell.told(ask_id).votes == ()


def test_a_lie_that_is_signed_is_no_vote_on_what_was_asked(cell):
    """Without the digest of the shown text the lie is signed, and the vote fits no ask of the PEP."""
    ask_id, _ = cell.taken()
    other = keys.generate()
    lie = ask.sign(cell.ask(ask_id=ask_id, index_milli=1), other)
    liar = Liar(cell.world.transport, lambda a: a | {"ask": lie, "pep_key": keys.b64u(keys.public_raw(other))})
    carol = Operator("carol", cell.world.private["carol"], ISSUER, transport=liar, now=cell.world.clock)
    assert code_of(lambda: carol.approve(ask_id)) == "VOTE_NOT_FOR_THIS_ASK"


def test_an_id_never_leaves_its_place_in_the_path(cell):
    ask_id, _ = cell.taken()
    carol = cell.world.people["carol"]
    for hostile in ("../agents", f"../openings?x={ask_id}", "", "a/b", "%2e%2e/agents"):
        assert code_of(lambda h=hostile: carol.approval(h)) in {"ASK_UNKNOWN", "PATH_UNKNOWN", "ANSWER_MALFORMED"}
        assert code_of(lambda h=hostile: carol.close_opening(h, "r")) in {"OPENING_UNKNOWN", "PATH_UNKNOWN", "METHOD_NOT_ALLOWED", "PROOF_NOT_FOR_THIS_REQUEST"}  # fmt: skip


def test_the_feed_keeps_the_words_of_the_statement():
    from ztpm_idp.domain.asking.asks import AskState

    assert {state.value for state in AskState} == answers.STATES
    assert {answer.value for answer in Answer} == vote.ANSWERS
    assert feed.answers_for


def test_people_are_asked_so_often_in_a_minute_and_in_an_hour_and_no_more(tmp_path):
    """Two approvers here: twice two asks a minute, twice three an hour."""
    with World(tmp_path, settings_changes={"asks_a_minute": 2, "asks_an_hour": 3}) as world:
        cell = Cell(world)
        began = world.clock.at_s

        def taken(at_s):
            world.clock.at_s = began + at_s
            answer = cell.post("cell-1", "/approvals", {"ask": cell.text(expires_at=cell.now + 20)})
            return answer.status_code == 201 or answer.json()["code"]

        assert [taken(at) for at in (0, 21, 30, 42, 59)] == [True, True, True, True, "ASK_BUDGET_SPENT"]
        assert [taken(at) for at in (61, 82, 600)] == [True, True, "ASK_BUDGET_SPENT"]
        assert [taken(at) for at in (3_599, 3_601)] == ["ASK_BUDGET_SPENT", True]
