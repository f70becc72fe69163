"""Facts of sensors over a real socket: absent, fresh, stale, forged, and what an act's tier is then."""

import asyncio
import secrets
from dataclasses import replace

import pytest
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.scope import Grant, Tier
from pep.base.declaration import row
from pep.base.fact_declaration import Fact
from pep.base.ports import RegisteredTool
from pep.mcp.mapping import to_request
from pep.perception.fact_feed import FactFeed
from pep.request.call import Call
from policies.decision.load import load_shipped
from policies.evidence import case_json
from policies.evidence.evidence import ToolReading
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE, CALIBRATION, Rig, full_scope, own_choice

from capabilities.keys import keys
from capabilities.statements import checkpoint, observation
from capabilities.statements.people import ask

FRESH_MS = 500
TRANSIT_MS = 20
PRESS = row(
    "press",
    "close_press",
    {},
    base_tier=1,
    exact=False,
    when={"zone-a/people": Fact(at_least={1: 3}, fresh_ms=FRESH_MS)},
)


FILLED = row(
    "press",
    "close_press",
    {},
    base_tier=1,
    exact=False,
    when={"zone-a/people": Fact(at_least={1: 3}), "zone-a/level": Fact(at_most={10: 3}, unit="permille")},
)


class Plant:
    """A gate without a robot that hears its sensors on TCP, and one sensor."""

    def __init__(self, tmp_path):
        self.rig = Rig(tmp_path)
        self.rig.policies = load_shipped("tools")
        self.key = self.rig.registry.add_sensor("zone-a", transit_ms=TRANSIT_MS)
        self.told, self.sequence = [], 0
        self.feed = FactFeed(
            self.rig.registry, clock=self.rig.clock, caps=CAPS, incident=lambda *what: self.told.append(what)
        )
        self.rig.build()
        self.rig.gate._robot, self.rig.gate._facts = None, self.feed
        self.rig.registry.tools["close_press"] = RegisteredTool("close_press", "d" * 64, "close_press", Tier(1))
        scope = replace(full_scope(self.rig.clock.wall_s()), grants=(Grant("press", "close_press"),))
        self.holder = self.rig.agent(scope=scope)

    async def __aenter__(self):
        self.port = await self.feed.listen(PRESS.facts, host="127.0.0.1", port=0)
        return self

    async def __aexit__(self, *failed):
        await self.feed.close()

    def frame(self, *stated, key=None, **changes):
        self.sequence += 1
        seen = observation.Observation(
            sensor="zone-a",
            boot_id="0" * 32,
            sequence=self.sequence,
            captured_ms=int(self.rig.clock.wall_s() * 1000),
            calibration=CALIBRATION,
            complete=False,
            people=(),
            objects=(),
            facts=tuple(observation.ObservedFact(*each) for each in stated),
        )
        for name, value in changes.items():
            seen = type(seen)(**{**{n: getattr(seen, n) for n in seen.__struct_fields__}, name: value})
        return observation.sign(seen, key or self.key).encode()

    async def push(self, text):
        """Sends one line over a connection of its own, and waits until it was judged."""
        _, writer = await asyncio.open_connection("127.0.0.1", self.port)
        judged, admit = asyncio.Event(), self.feed._frames.admit

        def heard(line):
            verdict = admit(line)
            judged.set()
            return verdict

        self.feed._frames.admit = heard
        writer.write(text + b"\n")
        await asyncio.wait_for(judged.wait(), 10)
        self.feed._frames.admit = admit
        writer.close()

    async def close_press(self, row=PRESS):
        request = to_request(row, {}, request_id=secrets.token_hex(16), audience=AUDIENCE, at=self.rig.clock.wall_s())
        call = Call(
            request=request,
            operation=row,
            tool=ToolReading("close_press", "d" * 64, "d" * 64, Tier(1)),
            credentials=self.rig.credentials(self.holder),
            arrived_ms=self.rig.clock.monotonic_ms(),
            readiness=None,
            context=own_choice(request),
        )
        return (await self.rig.gate.run(call, self.rig.effect)).decision

    def end(self):
        self.rig.gate.close()
        self.rig.journal.close()


@pytest.fixture
def plant(tmp_path):
    made = Plant(tmp_path)
    yield made
    made.end()


def used(decision):
    (fact,) = decision.evidence.impact.facts
    return fact.state, fact.fault, fact.value, fact.age_ms


@pytest.mark.clause("FCT-2", "FCT-3")
def test_an_act_follows_what_the_sensor_says(plant):
    """Absent: people are asked. Nobody there: permitted. One person, or an old word: tier 3."""

    async def story():
        async with plant:
            absent = await plant.close_press()
            assert (absent.effect, absent.tier, used(absent)) == (Effect.DEFER, 3, ("missing", "", None, None))
            assert [f.reason for f in absent.findings[:2]] == [Reason.TIER_NEEDS_APPROVAL, Reason.PERCEPTION_MISSING]
            assert plant.rig.sent == []

            await plant.push(plant.frame(("people", "count", 0)))
            nobody = await plant.close_press()
            assert (nobody.effect, nobody.tier, used(nobody)) == (Effect.PERMIT, 1, ("fresh", "", 0, TRANSIT_MS))
            assert len(plant.rig.sent) == 1

            await plant.push(plant.frame(("people", "count", 1)))
            somebody = await plant.close_press()
            assert (somebody.effect, somebody.tier, used(somebody)[2]) == (Effect.DEFER, 3, 1)
            assert [f.reason for f in somebody.findings] == [Reason.TIER_NEEDS_APPROVAL]
            assert somebody.findings[0].detail["raised_by"] == ["zone-a/people"]

            await plant.push(plant.frame(("people", "count", 0)))
            plant.rig.clock.advance(FRESH_MS - TRANSIT_MS)
            assert (await plant.close_press()).effect is Effect.PERMIT, "as old as it may be"
            plant.rig.clock.advance(1)
            stale = await plant.close_press()
            assert (stale.effect, stale.tier, used(stale)) == (Effect.DEFER, 3, ("stale", "", 0, FRESH_MS + 1))

    asyncio.run(story())
    records = [r["body"] for r in plant.rig.records() if r["kind"] == "decision"]
    facts = [body["evidence"]["impact"]["facts"] for body in records]
    assert [(f["fact"], f["state"], f["value"], f["age_ms"]) for (f,) in facts] == [
        ("zone-a/people", "missing", None, None), ("zone-a/people", "fresh", 0, TRANSIT_MS),
        ("zone-a/people", "fresh", 1, TRANSIT_MS), ("zone-a/people", "fresh", 0, FRESH_MS),
        ("zone-a/people", "stale", 0, FRESH_MS + 1),
    ]  # fmt: skip
    back = case_json.read({name: records[1][name] for name in ("form", "request", "evidence")})
    assert back.evidence.digest == records[1]["decision"]["evidence_digest"], "it can be decided again"


SPOILT = {
    "unsigned": (lambda p: b"people=0", "invalid", "MALFORMED"),
    "a stranger's key": (lambda p: p.frame(("people", "count", 0), key=keys.generate()), "invalid", "UNTRUSTED"),
    "another kind of statement": (
        lambda p: checkpoint.sign(checkpoint.Checkpoint("https://i.example/a", 0, "0" * 64, 1), p.key).encode(),
        "invalid",
        "MALFORMED",
    ),
    "another calibration": (
        lambda p: p.frame(("people", "count", 0), calibration="cd" * 32),
        "invalid",
        "WRONG_CALIBRATION",
    ),
    "an old frame again": (lambda p: p.frame(("people", "count", 0), sequence=1), "invalid", "NOT_NEWER"),
    "a recording": (lambda p: p.frame(("people", "count", 0), captured_ms=1, sequence=9), "invalid", "NOT_NEWER"),
    "an unregistered sensor": (
        lambda p: p.frame(("people", "count", 0), sensor="zone-b"),
        "invalid",
        "UNKNOWN_SENSOR",
    ),
    "another unit": (lambda p: p.frame(("people", "permille", 0)), "invalid", "WRONG_UNIT"),
    "another fact": (lambda p: p.frame(("cats", "count", 0)), "missing", "NOT_STATED"),
    "no fact": (lambda p: p.frame(), "missing", "NOT_STATED"),
}


@pytest.mark.clause("FCT-2", "FCT-3")
def test_what_must_not_be_believed_needs_a_person_until_the_sensor_speaks_again(plant):
    async def story():
        async with plant:
            for name, (text, state, fault) in SPOILT.items():
                await plant.push(plant.frame(("people", "count", 0)))
                assert (await plant.close_press()).effect is Effect.PERMIT, name
                await plant.push(text(plant))
                spoilt = await plant.close_press()
                assert (spoilt.effect, spoilt.tier, *used(spoilt)[:2]) == (Effect.DEFER, 3, state, fault), name

    asyncio.run(story())
    assert {fault for _, fault, _, _ in plant.told} >= {"MALFORMED", "UNTRUSTED", "NOT_NEWER"}, "and is an incident"


@pytest.mark.clause("FCT-2")
@pytest.mark.parametrize("registered", [None, "with another key"])
def test_a_sensor_that_is_retired_says_nothing(plant, registered):
    async def story():
        async with plant:
            await plant.push(plant.frame(("people", "count", 0)))
            assert (await plant.close_press()).effect is Effect.PERMIT
            plant.rig.registry.known = {}
            if registered:
                plant.rig.registry.add_sensor("zone-a")
            retired = await plant.close_press()
            fault = "" if registered else "UNKNOWN_SENSOR"
            assert (retired.effect, retired.tier, used(retired)[:3]) == (Effect.DEFER, 3, ("missing", fault, None))

    asyncio.run(story())


def test_nobody_is_heard_before_the_feed_listens_nor_where_there_is_none(plant):
    unheard = asyncio.run(plant.close_press())
    assert (unheard.effect, unheard.tier, used(unheard)) == (Effect.DEFER, 3, ("missing", "", None, None))
    plant.rig.gate._facts = None
    assert used(asyncio.run(plant.close_press())) == ("missing", "", None, None)


def test_an_approval_of_a_seen_person_is_none_for_an_unseen_zone(plant):
    """An approval given with a person in sight is none where nothing is seen."""

    async def story():
        async with plant:
            await plant.push(plant.frame(("people", "count", 1)))
            await plant.close_press()
            ((ask_id, text),) = plant.rig.issuer.asks.items()
            plant.rig.issuer.cast(ask_id, plant.rig.people["bob"].vote(text, at=plant.rig.clock.wall_s()))
            await asyncio.to_thread(plant.rig.pull)
            (shown,) = ask.open(text, [keys.public_raw(plant.rig.pep_key)], CAPS).facts
            assert (shown.fact, shown.state, shown.value, shown.raises) == ("zone-a/people", "fresh", 1, True)
            plant.rig.clock.advance(FRESH_MS)
            assert (await plant.close_press()).reason is Reason.APPROVAL_NOT_USABLE
            await plant.push(plant.frame(("people", "count", 1)))
            assert (await plant.close_press()).effect is Effect.PERMIT

    asyncio.run(story())


def test_an_approval_of_an_unseen_zone_is_none_for_a_seen_person(plant):
    """An unseen zone was approved; a person who stands there is news."""

    async def story():
        async with plant:
            await plant.close_press()
            ((ask_id, text),) = plant.rig.issuer.asks.items()
            plant.rig.issuer.cast(ask_id, plant.rig.people["bob"].vote(text, at=plant.rig.clock.wall_s()))
            await asyncio.to_thread(plant.rig.pull)
            await plant.push(plant.frame(("people", "count", 1)))
            answer = await plant.close_press()
            assert (answer.effect, answer.reason) == (Effect.DEFER, Reason.APPROVAL_NOT_USABLE)

    asyncio.run(story())


def test_an_approval_for_one_fact_is_none_for_another(plant):
    """A low tank was approved; a person beside it is another question, which shows both."""

    async def story():
        async with plant:
            await plant.push(plant.frame(("people", "count", 0), ("level", "permille", 3)))
            assert (await plant.close_press(FILLED)).effect is Effect.DEFER
            ((ask_id, text),) = plant.rig.issuer.asks.items()
            plant.rig.issuer.cast(ask_id, plant.rig.people["bob"].vote(text, at=plant.rig.clock.wall_s()))
            await asyncio.to_thread(plant.rig.pull)
            await plant.push(plant.frame(("people", "count", 1), ("level", "permille", 3)))
            assert (await plant.close_press(FILLED)).reason is Reason.APPROVAL_NOT_USABLE
            (again,) = (text for name, text in plant.rig.issuer.asks.items() if name != ask_id)
            shown = ask.open(again, [keys.public_raw(plant.rig.pep_key)], CAPS).facts
            assert [(fact.fact, fact.value, fact.raises) for fact in shown] == [
                ("zone-a/level", 3, True), ("zone-a/people", 1, True),
            ]  # fmt: skip
            await plant.push(plant.frame(("people", "count", 0), ("level", "permille", 2)))
            assert (await plant.close_press(FILLED)).effect is Effect.PERMIT, "what was approved is still so"

    asyncio.run(story())
