"""Stop at the gateway's own address: it begins before a body is read, and a known person's word latches."""

from __future__ import annotations

import asyncio
import json
import secrets
import time
from types import SimpleNamespace

import httpx2
import pytest
from capabilities.statements.people.stop import LIFETIME_S, Stop
from capabilities.values.caps import DEFAULT as CAPS
from pep.base.caller_place import EXTENSION
from pep.journal.file_journal import FileJournal
from pep.journal.replay_cache import ReplayCache, proof_name
from pep.people.ask_composer import Asker
from pep.people.latch_file import LatchFile
from pep.people.latches import Latches
from pep.people.stop_words import StopPlace, StopWords
from pep.rtde.judge.latching import Latching
from pep.rtde.lease.lease import LeaseEnding
from tests.pep.kit import AUDIENCE, FailingJournal, ManualClock, Person, Registry
from ztpm.point.open_stop import OpenStop
from ztpm.point.stop_door import BODY_BYTES, StopDoor

from capabilities.keys import keys
from capabilities.statements.people import stop as statement

pytestmark = pytest.mark.clause("LIV-7")
ISSUER = "https://idp.example/ztpm"
BASE = "http://gateway.example:8900"


class House:
    """A gateway's stop with a real latch, journal and reader of words; a test says when its arm stands."""

    def __init__(self, path):
        self.clock, self.registry, self.bob = ManualClock(), Registry(), Person("bob")
        self.registry.people = {self.bob.raw: "bob"}
        self.journal = FileJournal.open(path / "journal.ndjson", pep_id="pep-1", clock=self.clock)
        self.told, self.done, self.stands = [], [], asyncio.Event()
        self.stands.set()
        self.leases = SimpleNamespace(current=SimpleNamespace(agent="mover"))
        self.latches = Latches(
            LatchFile(path / "latch.json"),
            journal=self.journal,
            clock=self.clock,
            author=Asker(pep="pep-1", audience=AUDIENCE, issuer=ISSUER, key=keys.generate()),
            robot="ur3e",
            causes=frozenset(),
            approvers=self.registry,
            caps=CAPS,
            new_id=lambda: secrets.token_hex(16),
        )
        self.latching = Latching(
            self.latches,
            starts=None,
            ways=None,
            newest=lambda: None,
            halted=lambda: True,
            under_way=lambda: None,
            counted=lambda: self.done.append("permits void"),
            audience=AUDIENCE,
            clock=self.clock,
            failed=self.told.append,
        )
        self.stop_ = OpenStop(
            leases=self.leases,
            tools=self,
            latching=self.latching,
            words=StopWords(
                StopPlace(ISSUER, AUDIENCE, "ur3e", self.clock.wall_s() - 60),
                people=self.registry,
                replay=ReplayCache(self.clock),
                clock=self.clock,
                caps=CAPS,
            ),
            gate=self,
            end=self.end,
        )
        self.http = httpx2.AsyncClient(transport=httpx2.ASGITransport(StopDoor(self.stop_)), base_url=BASE)

    async def stop(self):
        self.done.append("stop")
        await self.stands.wait()
        return SimpleNamespace(end="stopped")

    async def end(self, ending):
        assert ending is LeaseEnding.STOPPED
        self.leases.current = None
        self.done.append("lease over")

    async def record(self, kind, body):
        self.journal.append(kind, body)

    def records(self, kind):
        return [record["body"] for record in self.journal.records() if record["kind"] == kind]

    def word(self, key=None, **changes):
        at = int(self.clock.wall_s())
        members = dict(stop_id=secrets.token_hex(16), issuer=ISSUER, audience=AUDIENCE, robot="ur3e", person="bob",
                       reason="a glove", not_after=at + LIFETIME_S, at=at)  # fmt: skip
        return statement.sign(Stop(**(members | changes)), key or self.bob.key)

    async def asked(self, content, **headers):
        answer = await self.http.post("/stop", content=content, headers=headers)
        await self.stop_.close()
        return answer


def in_house(tmp_path, scenario):
    async def inside():
        house = House(tmp_path)
        try:
            await scenario(house)
        finally:
            house.latching.close()
            house.journal.close()

    asyncio.run(inside())


def said(word):
    return json.dumps({"stop": True, "word": word})


def test_a_known_persons_word_latches_and_is_on_record_before_it_is_answered(tmp_path):
    async def scenario(house):
        house.stands.clear()  # the arm still moves
        text = house.word()
        answer = (await house.http.post("/stop", content=said(text))).json()
        latch = house.latches.in_force.latch
        assert (answer["stopped"], answer["by"], answer["person"], answer["fault"]) == (True, "gateway", "bob", "")
        assert (answer["latch"]["latch_id"], answer["latch"]["person"]) == (latch.latch_id, "bob")
        (record,) = house.records("stop")
        assert record == {
            "person": "bob",
            "reason": "a glove",
            "latch_id": latch.latch_id,
            "proof": proof_name(house.bob.raw, statement.open(text, [house.bob.raw], CAPS).stop_id).hex(),
            "word": text,
        }
        assert [kind for kind in ("latched", "stop", "outcome") if house.records(kind)] == ["latched", "stop"]
        house.stands.set()
        await house.stop_.close()
        (outcome,) = house.records("outcome")
        assert (outcome["stop"]["caller"], outcome["stop"]["fault"], outcome["stop"]["asked"]) == (
            "bob",
            None,
            "gateway",
        )
        assert house.done == ["stop", "permits void", "lease over"]

    in_house(tmp_path, scenario)


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (b"", ""),
        (b'{"stop":true}', ""),
        (b'{"stop":true,"word":""}', ""),
        (b"stop", "STATEMENT_MALFORMED"),
        (b"{" * 100, "STATEMENT_MALFORMED"),
        (b'{"stop":false}', "STATEMENT_MALFORMED"),
        (b'{"stop":true,"word":7}', "STATEMENT_MALFORMED"),
        (b'{"stop":true,"stop":true}', "STATEMENT_MALFORMED"),
        (b'{"stop":true,"x":1}', "STATEMENT_MALFORMED"),
        (b"[true]", "STATEMENT_MALFORMED"),
        (b" " * (BODY_BYTES + 1), "STATEMENT_MALFORMED"),
        (b'{"stop":true,"word":"\\ud800"}', "STATEMENT_MALFORMED"),
        (b"\xff\xfe", "STATEMENT_MALFORMED"),
    ],
)
def test_whatever_the_body_says_the_arm_stops_and_without_a_word_that_counts_nothing_latches(tmp_path, content, fault):
    async def scenario(house):
        answer = await house.asked(content)
        assert answer.status_code == 200
        assert answer.json() == {
            "stopped": True, "by": "gateway", "lease": "mover", "person": "", "fault": fault, "latch": {"latched": False},
        }  # fmt: skip
        assert house.done == ["stop", "lease over"]
        (outcome,) = house.records("outcome")
        assert (outcome["stop"]["caller"], outcome["stop"]["fault"]) == (None, fault or None)
        assert house.records("stop") == []

    in_house(tmp_path, scenario)


def test_a_bad_word_stops_the_arm_and_its_code_is_told_and_on_record(tmp_path):
    async def scenario(house):
        used = house.word()
        await house.asked(said(used))
        latch_id = house.latches.latch_id
        now = int(house.clock.wall_s())
        for text, fault in (
            (used, "STOP_USED"),
            (house.word(robot="ur5e"), "STOP_NOT_FOR_THIS_ROBOT"),
            (house.word(person="carol"), "STOP_NOT_YOURS"),
            (house.word(at=now - 31, not_after=now - 1), "STOP_OUT_OF_TIME"),
            (house.word(key=keys.generate()), "STATEMENT_UNTRUSTED"),
        ):
            house.done.clear()
            assert (await house.asked(said(text))).json()["fault"] == fault
            assert house.done == ["stop"]
            assert house.records("outcome")[-1]["stop"]["fault"] == fault
            assert house.latches.latch_id == latch_id
        assert len(house.records("stop")) == 1
        assert (await house.asked(b"")).json()["latch"] == {"latched": True}, "a stranger is told no more of it"

    in_house(tmp_path, scenario)


def test_the_arm_is_stopping_before_a_byte_of_the_body_came_and_a_body_that_never_ends_holds_nothing_up(tmp_path):
    async def scenario(house):
        seen, never = [], asyncio.Event()

        async def receive():
            seen.append(list(house.done))
            await never.wait()

        async def send(message):
            seen.append(message)

        place = SimpleNamespace(stopping=lambda: seen.append("a place of stops"))
        scope = {"type": "http", "method": "POST", "path": "/stop", "headers": [], "query_string": b""}
        scope |= {"extensions": {EXTENSION: place}}
        began = time.monotonic()
        await StopDoor(house.stop_)(scope, receive, send)
        assert time.monotonic() - began < 3
        assert (seen[0], seen[1][0]) == ("a place of stops", "stop")
        assert seen[2]["status"] == 200
        assert json.loads(seen[3]["body"])["fault"] == "STATEMENT_MALFORMED"
        await house.stop_.close()
        assert house.records("outcome")

    in_house(tmp_path, scenario)


def test_no_browser_stops_it_here_and_no_other_method_does(tmp_path):
    async def scenario(house):
        for origin in ("http://evil.example", "null", BASE, ""):
            answer = await house.asked(b'{"stop":true}', origin=origin)
            assert (answer.status_code, answer.json()["code"]) == (403, "WRONG_ORIGIN")
        for method in ("GET", "PUT", "OPTIONS", "HEAD"):
            assert (await house.http.request(method, "/stop")).status_code == 405
        assert house.done == []

    in_house(tmp_path, scenario)


def test_a_disk_that_is_full_keeps_nobody_from_stopping_and_latching(tmp_path):
    async def scenario(house):
        house.latches._journal = FailingJournal(house.journal)
        house.journal.append = FailingJournal(house.journal).append
        answer = (await house.asked(said(house.word()))).json()
        assert (answer["person"], answer["latch"]["latched"]) == ("bob", True)
        assert len(house.told) == 1
        assert house.done[0] == "stop"

    in_house(tmp_path, scenario)
