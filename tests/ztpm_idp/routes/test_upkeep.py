"""Enforcement points, sensors, tools and keys are kept up by those who may, and what is over stays over."""

from __future__ import annotations

import json

import pytest
from tests.ztpm_idp.domain.test_bounds import fetched
from tests.ztpm_idp.test_lending import refused, tree
from tests.ztpm_idp.test_mandates import signed
from tests.ztpm_idp.test_revoking import index
from tests.ztpm_idp.world import AUDIENCE, LOWER, World

from capabilities.keys import keys

SENSOR = {"calibration": "ab" * 32, "transit_ms": 20, "audience": AUDIENCE}
TOOL = {"definition_digest": "cd" * 32, "operation": "open_valve", "base_tier": 1}


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    with World(tmp_path_factory.mktemp("upkeep")) as made:
        made.pep()
        alice, raw = made.people["alice"], keys.public_raw(keys.generate())
        alice.register_sensor("camera-1", raw, **SENSOR)
        alice.register_tool(audience=AUDIENCE, name="open_valve", **TOOL)
        yield made


def fresh():
    return keys.public_raw(keys.generate())


def standing(world, kind, id_):
    rows = {"pep": "peps", "sensor": "sensors", "tool": "tools", "agent": "agents"}
    found = getattr(world.people["alice"], rows[kind])()
    return {row.get("id", row.get("name")): row["status"] for row in found}.get(id_)


def kinds(world, about):
    lines = world.people["alice"].export_ledger().splitlines()[:-1]
    return [line["kind"] for line in map(json.loads, lines) if about in line["kind"]]


@pytest.mark.parametrize(("kind", "id_", "of"), [("pep", "cell-1", "peps"), ("sensor", "camera-1", "sensors")])
def test_a_suspended_part_is_in_no_registry_until_it_is_restored(world, kind, id_, of):
    alice, before = world.people["alice"], fetched(world)
    assert id_ in {entry.id for entry in getattr(before, of)}
    alice.suspend_part(kind, id_, "it looks odd")
    told = fetched(world)
    assert (standing(world, kind, id_), {entry.id for entry in getattr(told, of)}) == ("suspended", set())
    assert told.version > before.version
    alice.suspend_part(kind, id_, "again")
    assert fetched(world).version == told.version
    alice.restore_part(kind, id_, "looked at")
    assert standing(world, kind, id_) == "active"
    assert getattr(fetched(world), of) == getattr(before, of)
    assert refused(alice.restore_part, kind, id_, "r").code == "NOTHING_TO_RESTORE"
    assert kinds(world, f"{kind}-")[-2:] == [f"{kind}-suspended", f"{kind}-restored"]


def test_a_suspended_point_hears_nothing_and_changes_nothing(world):
    point, alice = world.peps["cell-1"], world.people["alice"]
    with world.known("cell-1") as http:
        assert http.get("registry", params={"audience": AUDIENCE}).status_code == 200
        alice.suspend_part("pep", "cell-1", "odd")
        answer = http.get("registry", params={"audience": AUDIENCE})
    assert (answer.status_code, answer.json()["code"]) == (403, "CALLER_SUSPENDED")
    assert refused(point.revoke, "token", "A" * 22, "r").code == "CALLER_SUSPENDED"
    alice.restore_part("pep", "cell-1", "fine")


def test_a_suspended_tool_is_one_that_nobody_reviewed_and_a_retired_one_is_gone(world):
    alice = world.people["alice"]
    for act, listed, told in (
        ("suspend", "suspended", ()), ("suspend", "suspended", ()), ("restore", "active", ("open_valve",)),
        ("suspend", "suspended", ()), ("retire", None, ()),
    ):  # fmt: skip
        alice.change_tool(act, AUDIENCE, "open_valve", "why")
        assert (standing(world, "tool", "open_valve"), tuple(tool.name for tool in fetched(world).tools)) == (
            listed,
            told,
        )
    assert refused(alice.change_tool, "restore", AUDIENCE, "open_valve", "r").code == "NOT_FOUND"
    alice.register_tool(audience=AUDIENCE, name="open_valve", **TOOL)
    assert refused(alice.change_tool, "restore", AUDIENCE, "open_valve", "r").code == "NOTHING_TO_RESTORE"
    assert kinds(world, "tool-") == [
        "tool-registered", "tool-suspended", "tool-restored", "tool-suspended", "tool-retired", "tool-registered",
    ]  # fmt: skip


@pytest.mark.parametrize(("kind", "of"), [("pep", "peps"), ("sensor", "sensors")])
def test_a_parts_key_is_replaced_and_the_old_one_is_revoked_for_ever(world, kind, of):
    alice, id_ = world.people["alice"], f"new-{kind}"
    old, new = fresh(), fresh()
    if kind == "pep":
        alice.register_pep(id_, old, [AUDIENCE])
    else:
        alice.register_sensor(id_, old, **SENSOR)
    epoch = alice.replace_key(kind, id_, new, "stolen")
    assert {entry.id: entry.key for entry in getattr(fetched(world), of)}[id_] == new
    last = index(world).entries[-1]
    assert (last.epoch, last.kind, last.id) == (epoch, "key", keys.thumbprint(old))
    for key in (old, new):
        assert refused(alice.register_pep, f"other-{kind}", key, [AUDIENCE]).code == "KEY_IN_USE"
    assert refused(alice.replace_key, kind, id_, old, "r").code == "KEY_IN_USE"
    assert alice.replace_key(kind, id_, new, "its answer was lost") == epoch
    assert alice.retire_part(kind, id_, "old") == epoch + 1
    assert (standing(world, kind, id_), alice.retire_part(kind, id_, "again")) == ("revoked", epoch + 1)
    for act in (alice.suspend_part, alice.restore_part):
        assert refused(act, kind, id_, "r").code == "PARTY_ENDED"
    assert refused(alice.replace_key, kind, id_, fresh(), "r").code == "PARTY_ENDED"


def test_an_agents_new_key_ends_all_that_the_old_one_held(tmp_path):
    with World(tmp_path) as world:
        planner, _, lent = tree(world)
        alice, old = world.people["alice"], keys.thumbprint(keys.public_raw(world.private["planner"]))
        mandate = signed(world, "mover")
        agent = alice.mandate(mandate)["agent"]
        before = keys.thumbprint(keys.public_raw(world.private[agent]))
        world.private[agent] = keys.generate()
        alice.replace_key("agent", agent, keys.public_raw(world.private[agent]), "its machine was lost")
        assert [(entry.kind, entry.id) for entry in index(world).entries] == [("key", before), ("mandate", mandate)]
        assert alice.mandate(mandate)["state"] == "revoked"
        assert standing(world, "agent", agent) == "registered"
        again = world.caller(type(planner), agent, planner.measurement)
        again.attest()
        assert standing(world, "agent", agent) == "active"
        world.private["planner"] = keys.generate()
        alice.suspend_agent("planner", "odd")
        alice.replace_key("agent", "planner", keys.public_raw(world.private["planner"]), "stolen")
        assert index(world).entries[-1].id == old
        alice.restore_agent("planner", "fine")
        assert standing(world, "agent", "planner") == "registered"
        assert refused(planner.nonce).code == "CALLER_UNKNOWN"
        anew = world.caller(type(planner), "planner", planner.measurement)
        anew.attest()
        assert refused(anew.delegate, lent.token, again, LOWER, purpose="p").code == "REVOKED"


STRANGERS = ("bob", "carol", "cell-1")


@pytest.mark.parametrize("who", STRANGERS)
def test_only_administrators_and_for_agents_their_sponsors_keep_up(world, who):
    caller = world.people.get(who) or world.peps[who]
    if "helper" not in world.agents:
        world.agent("helper")
    acts = [
        (caller.suspend_part, "pep", "cell-1", "r"), (caller.restore_part, "sensor", "camera-1", "r"),
        (caller.retire_part, "pep", "cell-1", "r"), (caller.replace_key, "pep", "cell-1", fresh(), "r"),
        (caller.replace_key, "agent", "helper", fresh(), "r"), (caller.replace_key, "agent", "nobody", fresh(), "r"),
        (caller.change_tool, "retire", AUDIENCE, "open_valve", "r"),
    ]  # fmt: skip
    assert {refused(act, *more).code for act, *more in acts} == {"NOT_PERMITTED"}
    if who == "cell-1":
        assert {refused(act).code for act in (caller.peps, caller.sensors, caller.tools)} == {"NOT_PERMITTED"}


def test_what_is_no_such_part_is_not_found(world):
    alice = world.people["alice"]
    for kind, id_ in (("pep", "camera-1"), ("sensor", "cell-1"), ("pep", "alice"), ("sensor", "nobody")):
        for act in (alice.suspend_part, alice.restore_part, alice.retire_part):
            assert refused(act, kind, id_, "r").code == "NOT_FOUND"
        assert refused(alice.replace_key, kind, id_, fresh(), "r").code == "NOT_FOUND"
    assert refused(alice.change_tool, "retire", AUDIENCE, "nothing", "r").code == "NOT_FOUND"


def test_a_provider_gives_nobody_its_own_key(world):
    own = keys.public_raw(world.idp_keys.feed)
    assert refused(world.people["alice"].replace_key, "pep", "cell-1", own, "r").code == "KEY_IN_USE"
