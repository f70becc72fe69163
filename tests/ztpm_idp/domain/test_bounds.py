"""A registry snapshot always fits one statement, and a person ends with its agents."""

from __future__ import annotations

import json
import time

import pytest
from capabilities.statements.revocation import RevocationView
from capabilities.token.verify import token_from_text, verify
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Tier
from tests.ztpm_idp.test_revoking import index
from tests.ztpm_idp.world import AUDIENCE, ISSUER, SLOWER
from ztpm_idp.domain.events import AgentSuspended, PartyRegistered, ToolRegistered, TrustStated
from ztpm_idp.domain.parties import (
    PersonRole,
    RegisteredAgent,
    RegisteredPep,
    RegisteredPerson,
    RegisteredSensor,
    RegisteredTool,
    Standing,
)

from capabilities.keys import keys
from capabilities.statements import registry as snapshot
from ztpm_idp import ledger_file
from ztpm_idp.client import ClientError
from ztpm_idp.domain import registry


def full(ask, *args, **more):
    with pytest.raises(ClientError) as caught:
        ask(*args, **more)
    assert (caught.value.code, caught.value.status) == ("REGISTRY_FULL", 409)


def fresh():
    return keys.public_raw(keys.generate())


def register(world, name, *, by="alice"):
    world.people[by].register_agent(name, fresh(), software_digest="0" * 64, model="m", role="r")


def fetched(world):
    with world.known() as http:
        text = http.get(ISSUER + "/registry", params={"audience": AUDIENCE}).text
    return snapshot.open(text, world.trust.registry, DEFAULT)


def test_a_sponsor_has_a_bounded_number_of_living_agents(world, monkeypatch):
    monkeypatch.setattr(registry, "AGENTS_OF_ONE", 2)
    register(world, "one")
    register(world, "two")
    full(register, world, "three")
    full(
        world.people["dan"].register_agent,
        "three",
        fresh(),
        software_digest="0" * 64,
        model="m",
        role="r",
        sponsor="alice",
    )
    register(world, "bobs", by="bob")  # another sponsor has its own
    world.people["alice"].retire_agent("one", "r")
    register(world, "three")


def test_a_sponsor_states_trust_in_a_bounded_number_of_agents(world, monkeypatch):
    monkeypatch.setattr(registry, "TRUSTED_OF_ONE", 2)
    for name in ("one", "two", "three"):
        register(world, name, by="bob")
    bob = world.people["bob"]
    bob.set_trust("one", 1)
    bob.set_trust("two", 2)
    full(bob.set_trust, "three", 3)
    full(world.people["dan"].set_trust, "three", 3)
    bob.set_trust("two", 200)  # stating it anew adds nobody
    register(world, "alices")
    world.people["alice"].set_trust("alices", 4)
    bob.retire_agent("one", "r")
    bob.set_trust("three", 3)
    assert {entry.agent: entry.permille for entry in fetched(world).trust} == {"two": 200, "three": 3, "alices": 4}


def test_suspended_agents_are_bounded_by_sponsor_and_over_all(world, monkeypatch):
    monkeypatch.setattr(registry, "SUSPENDED_OF_ONE", 1)
    monkeypatch.setattr(snapshot, "SUSPENDED", 2)
    for name, by in (("one", "bob"), ("two", "bob"), ("three", "alice"), ("four", "carla")):
        if by == "carla":
            world.person("carla", "sponsor")
            world.people["carla"] = world.caller(type(world.people["bob"]), "carla")
        register(world, name, by=by)
    alice, bob, carla = (world.people[name] for name in ("alice", "bob", "carla"))
    bob.suspend_agent("one", "r")
    bob.suspend_agent("one", "again adds nobody")
    full(bob.suspend_agent, "two", "r")
    alice.suspend_agent("three", "r")
    full(carla.suspend_agent, "four", "r")
    assert fetched(world).suspended == ("one", "three")
    bob.retire_agent("one", "r")
    carla.suspend_agent("four", "r")
    assert fetched(world).suspended == ("four", "three")


def test_trust_is_bounded_over_all_sponsors(world, monkeypatch):
    monkeypatch.setattr(snapshot, "AGENTS", 2)
    for name, by in (("one", "alice"), ("two", "bob"), ("three", "bob")):
        register(world, name, by=by)
    world.people["alice"].set_trust("one", 1)
    world.people["bob"].set_trust("two", 1)
    full(world.people["bob"].set_trust, "three", 1)
    assert len(fetched(world).trust) == 2


@pytest.mark.long
def test_tools_sensors_peps_and_approvers_are_bounded(world, monkeypatch):
    alice = world.people["alice"]

    def tool(name, audience=AUDIENCE):
        alice.register_tool(audience=audience, name=name, definition_digest="1" * 64, operation="move", base_tier=1)

    def sensor(name, audience=AUDIENCE):
        alice.register_sensor(name, fresh(), calibration="1" * 64, transit_ms=20, audience=audience)

    def pep(name, *audiences):
        alice.register_pep(name, fresh(), audiences)

    for name in ("TOOLS", "SENSORS", "PEPS"):
        monkeypatch.setattr(snapshot, name, 1)
    monkeypatch.setattr(snapshot, "APPROVERS", 3)
    tool("one")
    tool("one")  # a new definition takes the place of the old one
    full(tool, "two")
    tool("two", AUDIENCE + "/other")
    sensor("eye-1")
    full(sensor, "eye-2")
    sensor("eye-2", AUDIENCE + "/other")
    before = fetched(world)
    pep("door-1", AUDIENCE + "/third")
    full(pep, "door-2", AUDIENCE + "/fourth", AUDIENCE + "/third")
    pep("door-2", AUDIENCE + "/fourth")
    found = fetched(world)
    assert found.version == before.version + 2
    assert found.peps == before.peps  # they serve others than this audience
    world.person("erin", "approver")  # alice and carol are the others
    full(world.person, "frank", "sponsor", "approver")
    full(world.people["carol"].propose_key, fresh())
    world.person("frank", "sponsor")
    world.end("erin")
    alice.confirm_change(world.people["carol"].propose_key(fresh()))
    full(world.person, "grace", "approver")
    assert [entry.id for entry in fetched(world).approvers] == ["alice", "carol", "carol"]


def largest():
    """Events that register as many of everything as may be, with the longest names."""
    name = lambda kind, n: f"{kind}{n:04}".ljust(63, "x")
    party = lambda: (raw := fresh(), keys.thumbprint(raw))
    for n in range(snapshot.APPROVERS - 2):
        yield PartyRegistered(
            RegisteredPerson(name("p", n), *party(), Standing.ACTIVE, "P", frozenset({PersonRole.APPROVER}))
        )
    for n in range(snapshot.PEPS):
        yield PartyRegistered(RegisteredPep(name("e", n), *party(), Standing.ACTIVE, frozenset({AUDIENCE})))
    for n in range(snapshot.SENSORS):
        yield PartyRegistered(
            RegisteredSensor(name("s", n), *party(), Standing.ACTIVE, bytes([255]) * 32, 10_000, AUDIENCE)
        )
    for n in range(snapshot.TOOLS):
        yield ToolRegistered(RegisteredTool(AUDIENCE, name("t", n), bytes([255]) * 32, name("o", n), Tier(4)))
    for n in range(snapshot.AGENTS):
        yield PartyRegistered(
            RegisteredAgent(name("a", n), *party(), Standing.ACTIVE, bytes(32), "m", "r", "alice", None)
        )
        yield TrustStated(name("a", n), 1_000)
    for n in range(snapshot.SUSPENDED):
        yield AgentSuspended(name("a", n), "r")


@pytest.mark.long
@pytest.mark.timeout(300)
def test_the_largest_registry_is_one_statement(world):
    async def fill():
        async with world.provider.store.write() as transaction:
            await transaction.append(tuple(largest()), actor="test", at_ms=0)

    world.on_loop(fill())
    found = fetched(world)
    assert len(found.trust) == snapshot.AGENTS
    assert len(found.approvers) == snapshot.APPROVERS
    assert len(found.tools) == snapshot.TOOLS
    assert len(found.sensors) == snapshot.SENSORS
    assert len(found.peps) == snapshot.PEPS
    assert len(found.suspended) == snapshot.SUSPENDED
    # One more of anything is refused at the door, whoever asks.
    alice = world.people["alice"]
    full(alice.register_tool, audience=AUDIENCE, name="more", definition_digest="1" * 64, operation="o", base_tier=1)
    full(alice.register_sensor, "more", fresh(), calibration="1" * 64, transit_ms=20, audience=AUDIENCE)
    full(alice.register_pep, "more", fresh(), [AUDIENCE])
    full(alice.propose_person, "more", "More", fresh(), ["approver"])
    register(world, "bobs", by="bob")
    full(world.people["bob"].set_trust, "bobs", 1)


# --- a person and its agents ------------------------------------------------------------------------------------------------


def judged(world, text):
    found = index(world)
    view = RevocationView(epoch=found.epoch, age_ms=0, revoked=frozenset((e.kind, e.id) for e in found.entries))
    return verify(
        token_from_text(text, DEFAULT), at=world.clock(), audience=AUDIENCE, view=view, lease_ms=0, trust=world.trust,
        caps=DEFAULT,
    )  # fmt: skip


def revoked_of(world):
    return [(e.epoch, e.kind, e.id) for e in index(world).entries]


@pytest.mark.long
def test_a_disabled_persons_agents_end_in_other_peoples_trees(world):
    planner, mover = world.agent("planner"), world.agent("mover", sponsor="bob")
    world.agent("helper", sponsor="bob")
    lent = world.people["alice"].issue(planner, world.scope(), purpose="p")
    below = planner.delegate(lent.token, mover, SLOWER, purpose="p")
    assert isinstance(judged(world, below.token), Chain)
    epoch = world.people["dan"].disable_person("bob", "left")
    assert revoked_of(world) == [(1, "sponsor", "bob"), (2, "agent", "helper"), (3, "agent", "mover")]
    assert epoch == 3
    found = judged(world, below.token)
    assert isinstance(found, Fault)
    assert found.code is FaultCode.REVOKED
    assert isinstance(judged(world, lent.token), Chain), "alice's own tree stands above it"
    for agent in (mover, world.agents["helper"]):
        with pytest.raises(ClientError) as caught:
            agent.attest()
        assert caught.value.code == "CALLER_INACTIVE"
    lines = world.people["alice"].export_ledger().splitlines()
    assert isinstance(ledger_file.verify(lines, world.trust), ledger_file.Verified)
    recorded = [e["body"] for e in map(json.loads, lines) if e.get("kind") == "revoked"]
    assert [(body["kind"], body["id"]) for body in recorded] == [row[1:] for row in revoked_of(world)]
    assert {body["reason"] for body in recorded} == {"left"}
    assert {row["id"]: row["status"] for row in world.people["alice"].agents()} == {
        "planner": "active", "mover": "revoked", "helper": "revoked"
    }  # fmt: skip


def test_ending_a_person_again_or_its_agents_before_gives_no_entry_twice(world):
    for name in ("mover", "helper"):
        world.agent(name, sponsor="bob")
    world.people["bob"].retire_agent("mover", "r")
    assert world.people["bob"].revoke("sponsor", "bob", "r") == 3  # a person may end itself, by either door
    assert revoked_of(world) == [(1, "agent", "mover"), (2, "sponsor", "bob"), (3, "agent", "helper")]
    for ask in (
        lambda: world.people["dan"].disable_person("bob", "r"),
        lambda: world.people["dan"].revoke("sponsor", "bob", "r"),
    ):
        assert ask() == 3
    assert len(revoked_of(world)) == 3


def test_what_an_earlier_version_left_is_ended_by_asking_again(world):
    world.agent("mover", sponsor="bob")
    world.people["dan"].disable_person("bob", "r")

    async def undo():
        import sqlalchemy as sa

        async with world.provider.store.write() as transaction:
            await transaction._connection.execute(sa.text("DELETE FROM revocations WHERE kind = 'agent'"))

    world.on_loop(undo())
    assert world.people["dan"].disable_person("bob", "r") == 3
    assert revoked_of(world)[-1][1:] == ("agent", "mover")


def test_all_or_nothing(world, monkeypatch):
    """A store that fails half way through leaves neither the person nor any agent revoked."""
    from ztpm_idp.store import transaction

    for number in range(5):
        register(world, f"agent-{number}", by="bob")
    seal, seen = transaction.seal, []

    def fails(**entry):
        seen.append(entry)
        if len(seen) == 4:
            raise OSError("disk full")
        return seal(**entry)

    monkeypatch.setattr(transaction, "seal", fails)
    with pytest.raises(ClientError) as caught:
        world.people["dan"].disable_person("bob", "r")
    assert caught.value.code == "STORE_UNAVAILABLE"
    monkeypatch.undo()
    assert revoked_of(world) == []
    assert {row["status"] for row in world.people["alice"].agents()} == {"registered"}
    assert world.people["dan"].disable_person("bob", "r") == 6


@pytest.mark.timeout(300)
def test_a_person_with_the_most_agents_ends_in_one_go(world):
    async def fill():
        made = (
            PartyRegistered(RegisteredAgent(f"a{n}", raw := fresh(), keys.thumbprint(raw), Standing.ACTIVE, bytes(32), "m", "r", "bob", None))
            for n in range(registry.AGENTS_OF_ONE)
        )  # fmt: skip
        async with world.provider.store.write() as transaction:
            await transaction.append(tuple(made), actor="test", at_ms=0)

    world.on_loop(fill())
    began = time.perf_counter()
    assert world.people["dan"].disable_person("bob", "r") == 1 + registry.AGENTS_OF_ONE
    print(f"{registry.AGENTS_OF_ONE} agents ended in {time.perf_counter() - began:.3f} s")
    assert len(revoked_of(world)) == 1 + registry.AGENTS_OF_ONE
