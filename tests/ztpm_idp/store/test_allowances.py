"""Allowances: how much one sponsor may have, counted over rows, and told to it; nobody else has less for that."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest
from capabilities.values.chain import Sponsor
from tests.ztpm_idp.asks import PEP, Cell
from tests.ztpm_idp.oauth.speaking import StockClient, refusal
from tests.ztpm_idp.test_lending import SLOWER, refused
from tests.ztpm_idp.world import World

from capabilities.keys import keys
from ztpm_idp.client import ClientError
from ztpm_idp.domain.events import TokenDelegated, TokenIssued
from ztpm_idp.domain.lending import allowances
from ztpm_idp.domain.lending.amounts import Used
from ztpm_idp.domain.state import State, Wanted
from ztpm_idp.provider import joint_work

CODE = "ALLOWANCE_SPENT"
BOUNDED = {
    "live_tokens": 3, "tokens_an_hour": 5, "delegations": 3, "mandates": 2, "agents": 4,
    "sponsors": {"bob": {"live_tokens": 1}},
}  # fmt: skip


@pytest.fixture
def world(tmp_path):
    with World(tmp_path, settings_changes={"allowances": BOUNDED}) as made:
        yield made


def told(world, sponsor="alice", *, by=None):
    return {
        row["name"]: (row["used"], row["most"]) for row in world.people[by or sponsor].allowances(sponsor)
    }  # fmt: skip


def test_tokens_are_bounded_at_once_and_by_the_hour_and_what_ends_makes_room(world):
    alice, bob = world.people["alice"], world.people["bob"]
    planner = world.agent("planner")
    minute = lambda: world.scope(not_after=int(world.clock()) + 60)  # noqa: E731
    made = [alice.issue(planner, minute(), purpose="p") for _ in range(3)]
    error = refused(alice.issue, planner, minute(), purpose="p")
    assert (error.code, error.status) == (CODE, 429)
    assert told(world)["live_tokens"] == (3, 3)
    # Another sponsor has its own, and one that is named has others.
    runner = world.agent("runner", sponsor="bob")
    bob.issue(runner, minute(), purpose="p")
    assert refused(bob.issue, runner, minute(), purpose="p").code == CODE
    assert told(world, "bob")["live_tokens"] == (1, 1)
    # A revoked one is not live, and neither is one that is over.
    alice.revoke("token", made[0].token_id, "not needed")
    alice.issue(planner, minute(), purpose="p")
    assert refused(alice.issue, planner, minute(), purpose="p").code == CODE
    world.clock.at_s += 61
    alice.issue(planner, minute(), purpose="p")
    assert told(world)["live_tokens"] == (1, 3)
    assert told(world)["tokens_an_hour"] == (5, 5)
    assert refused(alice.issue, planner, minute(), purpose="p").code == CODE
    world.clock.at_s += 3_540  # the first four are an hour old
    alice.issue(planner, minute(), purpose="p")
    assert told(world, by="dan")["tokens_an_hour"] == (2, 5)


def test_a_tree_a_sponsors_mandates_and_agents_are_bounded(world):
    alice = world.people["alice"]
    planner, first, second, third = (world.agent(name) for name in ("planner", "first", "second", "third"))
    assert refused(world.agent, "fifth", attested=False).code == CODE
    lent = alice.issue(planner, world.scope(), purpose="p")
    for agent in (first, second):
        planner.delegate(lent.token, agent, SLOWER, purpose="p")
    assert refused(planner.delegate, lent.token, third, SLOWER, purpose="p").code == CODE
    for agent in ("planner", "first"):
        alice.sign_mandate(agent, world.scope(), purpose="p")
    assert refused(alice.sign_mandate, "second", world.scope(), purpose="p").code == CODE
    assert told(world) == {
        "live_tokens": (1, 3), "tokens_an_hour": (1, 5), "delegations": (3, 3), "mandates": (2, 2),
        "agents": (4, 4), "asks": (0, 24),
    }  # fmt: skip
    # To take back is never bounded, and makes room.
    alice.revoke("token", lent.token_id, "done")
    assert told(world)["live_tokens"] == (0, 3)


def test_requests_that_share_a_transaction_are_counted_one_after_another(world, monkeypatch):
    alice, agents = world.people["alice"], [world.agent(f"agent-{n}") for n in range(4)]

    async def all_there(waiting):
        while len(waiting) < len(agents):
            await asyncio.sleep(0)

    def issue(agent):
        try:
            return alice.issue(agent, world.scope(), purpose="p").token_id
        except ClientError as error:
            return error.code

    monkeypatch.setattr(joint_work, "gathered", all_there)
    with ThreadPoolExecutor(len(agents)) as pool:
        found = list(pool.map(issue, agents))
    assert found.count(CODE) == 1
    assert told(world)["live_tokens"] == (3, 3)


def test_the_tokens_and_hops_of_a_transaction_are_told_from_others():
    tree = "g" * 22
    issued = TokenIssued("t" * 22, Sponsor("https://idp.example/ztpm", "alice", "m", 1), None, None, "", None)
    hop = TokenDelegated(SimpleNamespace(token_id=tree), None, None, None, "", None)
    counted = allowances.after(State(), Wanted(lent_by="alice"), [issued, hop, issued]).used
    assert counted == Used(live_tokens=2, tokens_an_hour=2)
    counted = allowances.after(State(), Wanted(tree=tree), [issued, hop]).used
    assert counted == Used(delegations=1)
    assert allowances.after(State(), Wanted(lent_by="bob"), [issued]).used == Used()
    assert allowances.after(State(), Wanted(), [issued]).used == Used()


def test_clients_of_oauth_draw_on_the_same_allowance_and_are_told_so(world):
    viewer = StockClient(world, "viewer", key=keys.generate())
    viewer.register()
    viewer.mandate(ceiling=1)
    assert [viewer.credentials().status_code for _ in range(4)] == [200, 200, 200, 429]
    assert refusal(viewer.credentials()) == (429, "temporarily_unavailable")


def test_asks_of_one_sponsor_leave_room_for_those_of_another(tmp_path):
    with World(tmp_path, settings_changes={"allowances": {"sponsors": {"alice": {"asks": 1}}}}) as world:
        cell = Cell(world)
        cell.taken()
        answer = cell.post(PEP, "/approvals", {"ask": cell.text()})
        assert (answer.status_code, answer.json()["code"]) == (429, "ASK_BUDGET_SPENT")
        assert told(world)["asks"] == (1, 1)


def test_only_the_sponsor_and_administrators_are_told(world):
    assert refused(world.people["bob"].allowances, "alice").code == "NOT_PERMITTED"
    assert refused(world.people["dan"].allowances, "nobody").code == "NOT_FOUND"
    world.agent("planner")
    with world.known("planner") as http:
        assert http.get("/people/alice/allowances").json()["code"] == "NOT_PERMITTED"
