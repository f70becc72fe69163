"""Suspending: the agent and all through it wait until a person restores it; what is retired never comes back."""

from __future__ import annotations

import json

import pytest
from tests.ztpm_idp.domain.test_bounds import fetched
from tests.ztpm_idp.journals import Journal
from tests.ztpm_idp.test_conduct import listed, probed
from tests.ztpm_idp.test_lending import refused, tree
from tests.ztpm_idp.test_revoking import index
from tests.ztpm_idp.world import SLOWER

pytestmark = pytest.mark.long


def kinds(world):
    lines = world.people["alice"].export_ledger().splitlines()[:-1]
    return [line["kind"] for line in map(json.loads, lines)]


def test_a_suspended_agent_waits_and_goes_on_where_it_was(world):
    planner, mover, lent = tree(world)
    alice = world.people["alice"]
    before = fetched(world).version
    alice.suspend_agent("planner", "it asks oddly")
    told = fetched(world)
    assert (told.suspended, index(world).registry_version) == (("planner",), told.version)
    assert told.version > before
    assert listed(world, "planner")["status"] == "suspended"
    for act in (planner.nonce, planner.attest):
        assert refused(act).code == "AGENT_SUSPENDED"
    assert refused(planner.delegate, lent.token, mover, SLOWER, purpose="p").code == "AGENT_SUSPENDED"
    alice.suspend_agent("planner", "again")
    alice.restore_agent("planner", "looked at")
    assert (fetched(world).suspended, listed(world, "planner")["status"]) == ((), "active")
    assert refused(alice.restore_agent, "planner", "r").code == "NOTHING_TO_RESTORE"
    planner.delegate(lent.token, mover, SLOWER, purpose="the same token")
    assert [kind for kind in kinds(world) if "suspen" in kind] == ["agent-suspended", "suspension-ended"]


def test_nothing_is_lent_to_a_suspended_agent_nor_on_from_below_it(world):
    planner, mover, lent = tree(world)
    helper = world.agent("helper")
    narrower = planner.delegate(lent.token, mover, SLOWER, purpose="p")
    alice = world.people["alice"]
    evidence = helper.evidence("mover", {"any": "request"})
    alice.suspend_agent("helper", "odd")
    assert refused(mover.delegate_with, narrower.token, "helper", SLOWER, purpose="p", evidence=evidence).code == (
        "AGENT_SUSPENDED"
    )
    alice.suspend_agent("planner", "odd")
    alice.restore_agent("helper", "fine")
    assert refused(mover.delegate, narrower.token, helper, SLOWER, purpose="p").code == "REVOKED"


def test_a_suspended_agent_may_still_give_up_what_it_holds(world):
    planner, _, lent = tree(world)
    world.people["alice"].suspend_agent("planner", "odd")
    assert planner.revoke("token", lent.token_id, "mine, and over") == 1


def test_what_was_never_attested_is_restored_to_that(world):
    helper = world.agent("helper", attested=False)
    world.people["alice"].suspend_agent("helper", "odd")
    assert refused(helper.attest).code == "AGENT_SUSPENDED"
    world.people["alice"].restore_agent("helper", "fine")
    assert listed(world, "helper")["status"] == "registered"
    helper.attest()


@pytest.mark.parametrize("suspended", [False, True])
def test_a_retired_agent_never_comes_back(world, suspended):
    helper, alice = world.agent("helper"), world.people["alice"]
    if suspended:
        alice.suspend_agent("helper", "odd")
    epoch = alice.retire_agent("helper", "gone")
    assert [(e.epoch, e.kind, e.id) for e in index(world).entries] == [(epoch, "agent", "helper")]
    assert (fetched(world).suspended, listed(world, "helper")["status"]) == ((), "revoked")
    for act in (alice.restore_agent, alice.suspend_agent, world.people["dan"].restore_agent):
        assert refused(act, "helper", "r").code == "AGENT_INACTIVE"
    assert refused(helper.attest).code == "CALLER_INACTIVE"


def test_one_word_restores_what_was_suspended_and_deviated(world):
    planner, mover, lent = tree(world)
    world.second = planner.delegate(lent.token, mover, SLOWER, purpose="p").token
    world.journal = Journal(world)
    probed(world)
    alice = world.people["alice"]
    alice.suspend_agent("mover", "it asks oddly")
    alice.restore_agent("mover", "looked at")
    row = listed(world, "mover")
    assert (row["status"], row["conduct"]["contracted"]) == ("active", False)
    assert kinds(world)[-2:] == ["suspension-ended", "agent-restored"]


def test_only_those_in_charge_suspend_and_restore(world):
    world.pep()
    helper = world.agent("helper")
    for caller in (world.people["bob"], world.people["carol"], world.peps["cell-1"], helper):
        assert refused(caller._post, "/agents/helper/suspend", {"reason": "r"}).code == "NOT_PERMITTED"
    for person, agent, code in (
        ("alice", "nobody", "NOT_FOUND"), ("bob", "nobody", "NOT_PERMITTED"), ("dan", "cell-1", "NOT_FOUND"),
    ):  # fmt: skip
        assert refused(world.people[person].suspend_agent, agent, "r").code == code
    for person in ("alice", "dan"):
        world.people[person].suspend_agent("helper", "r")
        for caller in (world.people["bob"], world.peps["cell-1"]):
            assert (
                refused(caller._post, "/agents/helper/restore", {"reason": "r", "relearn": False}).code
                == "NOT_PERMITTED"
            )
        world.people[person].restore_agent("helper", "r")
