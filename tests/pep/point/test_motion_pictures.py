"""Pictures of decided motions at a point: by a real process beside it, on record, and at the provider afterwards."""

from __future__ import annotations

import asyncio
import io
import pickle
from contextlib import asynccontextmanager, suppress
from itertools import count

import pytest
from capabilities.statements.people import picture
from pep.base.errors import FeedError, JournalError, PepFault
from pep.pit.base.errors import PitError
from pep.point.motion_pictures import A_MINUTE, AFTER_MS, KEPT, WAITING, MotionPictures
from pep.world.questions import AssessedQuestion, AssessedQuestions
from tests.pep.kit import ManualClock
from tests.pep.pit.picture.test_shown_form import answer, where
from tests.pep.pit.scenes import ROBOT, sweep

from pep.pit import OutputSet
from pep.point import motion_pictures, picture_drawer

pytestmark = pytest.mark.clause("CON-9")

SAYS = """
import os, sys
asked = sys.stdin.buffer
while head := asked.read(5):
    asked.read(int.from_bytes(head[1:], "big"))
    asked.read(int.from_bytes(asked.read(5)[1:], "big"))
    said = {said}
    sys.stdout.buffer.write(said)
    sys.stdout.buffer.flush()
"""
TOLD = 'b"T" + len(os.environ).to_bytes(4, "big") + b"x" * len(os.environ)'


class Point:
    """A point with questions of its own, its journal and its provider played by lists."""

    def __init__(self, monkeypatch, said: str | None = None) -> None:
        self.clock, self.questions, self.numbers = ManualClock(), AssessedQuestions(), count()
        self.records, self.sent, self.incidents = [], [], []
        self.in_ledger, self.status, self.broken = 0, 201, False
        drawer = {} if said is None else {"drawer": ("-c", SAYS.format(said=said))}
        self.pictures = MotionPictures(
            self.questions,
            clock=self.clock,
            record=self.record,
            shipped=lambda: (len(self.records), self.in_ledger),
            asking=self,
            incident=self.incidents.append,
            **drawer,
        )
        monkeypatch.setattr(motion_pictures, "AFTER_MS", 0)

    def record(self, kind, body):
        assert kind == "picture"
        if self.broken:
            raise JournalError(PepFault.JOURNAL_BROKEN)
        self.records.append(body)

    async def send(self, method, path, *, body, most_bytes):
        self.sent.append((method, path, body))
        if self.status == 0:
            raise FeedError(PepFault.FEED_UNREACHABLE)
        return self.status, b"{}"

    def decided(self, motion=None, *, moves=True) -> str:
        request_id = f"r{next(self.numbers)}"
        self.questions.keep(request_id, ROBOT, where(), sweep() if motion is None else motion, None)
        self.pictures(request_id, "d" * 64, moves=moves)
        return request_id

    async def until(self, true):
        async with asyncio.timeout(60):
            while not true():
                await asyncio.sleep(0.005)

    @asynccontextmanager
    async def running(self):
        task = asyncio.create_task(self.pictures.run())
        try:
            yield
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task

    @property
    def reasons(self):
        return [record.get("reason", "made") for record in self.records]


def test_a_picture_is_that_of_the_very_assessment_and_comes_to_the_provider_after_its_record(monkeypatch):
    """One real process makes it, for the second motion too, and ends with the point."""
    point, found = Point(monkeypatch), answer(sweep())

    async def story():
        async with point.running():
            point.questions.keep("asked", ROBOT, where(), sweep(), found)
            point.pictures("asked", "d" * 64, moves=True)
            point.decided(OutputSet(3, True))
            await point.until(lambda: point.records)
            assert not point.sent, "its record is not in the ledger yet"
            drawer = point.pictures._drawer
            point.decided()
            await point.until(lambda: len(point.records) == 2)
            assert point.pictures._drawer is drawer
            point.in_ledger = 1
            await point.until(lambda: point.sent)
            await point.pictures.bring()
            assert len(point.sent) == 1
        return await asyncio.wait_for(drawer.wait(), 10)

    ended = asyncio.run(story())
    assert ended != 0, "it was ended"
    whole = AssessedQuestion(ROBOT, where(), sweep(), found)
    shown = point.questions.shown("asked")
    assert point.records[0] == {
        "request_id": "asked", "decision": "d" * 64, "digest": picture.digest_of(shown), "bytes": len(shown)
    }  # fmt: skip
    assert point.records[1]["request_id"] == "r1", "what moves no arm has no picture, and no record of one"
    ((method, path, body),) = point.sent
    assert (method, path, shown in body.decode().replace("\\", "")) == ("POST", "/ledger/pictures", True)
    packed = picture_drawer.Packing().packed(whole)
    assert len(packed) < len(pickle.dumps(found)) / 2, "proofs stay here"


def test_what_was_not_assessed_or_is_forgotten_has_no_picture_and_no_record(monkeypatch):
    point = Point(monkeypatch)
    point.pictures("never", "d" * 64, moves=False)
    request_id = point.decided()
    point.questions.forget(request_id)
    point.pictures(request_id, "d" * 64, moves=True)
    assert [each.body["request_id"] for each in point.pictures._wanted] == [request_id], "the first word of it counts"


@pytest.mark.parametrize("moves", [True, False])
def test_of_more_motions_than_pictures_are_made_of_the_record_says_so(monkeypatch, moves):
    point = Point(monkeypatch, TOLD)

    async def story():
        for _ in range(WAITING + 2):
            point.decided(moves=moves)
        async with point.running():
            await point.until(lambda: len(point.records) == WAITING + 2)
            for _ in range(A_MINUTE[moves] - WAITING + 1):
                before = len(point.records)
                point.decided(moves=moves)
                await point.until(lambda n=before: len(point.records) > n)
            point.decided(moves=not moves)
            point.clock.advance(60_000)
            point.decided(moves=moves)
            await point.until(lambda: len(point.records) == A_MINUTE[moves] + 5)

    asyncio.run(story())
    told = [*["made"] * WAITING, *["PICTURE_CROWDED"] * 2, *["made"] * (A_MINUTE[moves] - WAITING), "PICTURE_CROWDED"]
    assert point.reasons == [*told, "made", "made"]


@pytest.mark.parametrize(
    "said", ["sys.exit(3)", "b'T' + (300_000).to_bytes(4, 'big')", "b'R' + bytes([0, 0, 0, 3]) + b'ODD'", "b'T' + bytes([0, 0, 0, 1, 255])"]
)  # fmt: skip
def test_a_process_that_fails_costs_the_picture_alone_and_is_started_anew(monkeypatch, said):
    point = Point(monkeypatch, said)

    async def story():
        async with point.running():
            for _ in range(2):
                point.decided()
            await point.until(lambda: len(point.records) == 2)
            assert point.pictures._drawer is None
            point.pictures._arguments = ("-c", SAYS.format(said=TOLD))
            point.decided()
            await point.until(lambda: len(point.records) == 3)

    asyncio.run(story())
    assert point.reasons == ["PICTURE_DRAWER_ENDED", "PICTURE_DRAWER_ENDED", "made"]


def test_a_question_that_cannot_be_packed_costs_its_picture_alone(monkeypatch):
    point = Point(monkeypatch, TOLD)

    async def story():
        async with point.running():
            point.decided(lambda: None)
            point.decided()
            await point.until(lambda: len(point.records) == 2)

    asyncio.run(story())
    assert point.reasons == ["PICTURE_IMPOSSIBLE", "made"]


def test_a_process_that_says_nothing_is_ended(monkeypatch):
    point = Point(monkeypatch, "b''")
    monkeypatch.setattr(motion_pictures, "PATIENCE_S", 0.3)

    async def story():
        async with point.running():
            point.decided()
            await point.until(lambda: point.records)

    asyncio.run(story())
    assert point.reasons == ["PICTURE_DRAWER_ENDED"]


def test_none_is_begun_while_its_command_may_be_on_its_way_and_a_journal_that_fails_is_an_incident(monkeypatch):
    point = Point(monkeypatch, TOLD)
    monkeypatch.setattr(motion_pictures, "AFTER_MS", AFTER_MS)
    slept = []

    async def sleep(seconds, real=asyncio.sleep):
        slept.append(seconds)
        await real(0)

    async def story():
        async with point.running():
            monkeypatch.setattr(asyncio, "sleep", sleep)
            point.decided()
            await point.until(lambda: point.records)
            point.broken = True
            point.decided()
            await point.until(lambda: point.incidents)

    asyncio.run(story())
    assert AFTER_MS / 1_000 in slept
    assert [error.code for error in point.incidents] == [PepFault.JOURNAL_BROKEN]


def test_the_process_gets_no_variable_of_ours(monkeypatch):
    point = Point(monkeypatch, TOLD)
    monkeypatch.setattr(motion_pictures.os, "environ", {"ZTPM_PASSPHRASE": "secret", "PATH": "/bin", "ONE": "1"})

    async def story():
        async with point.running():
            point.decided()
            await point.until(lambda: point.records)

    asyncio.run(story())
    assert point.records[0]["bytes"] in {2, 3}, "those of Python itself aside"


@pytest.mark.parametrize(
    ("status", "left", "told"), [(0, 1, []), (429, 1, []), (503, 1, []), (201, 0, []), (200, 0, []), (404, 0, ["PICTURE_NOT_TAKEN"])]
)  # fmt: skip
def test_what_the_provider_does_not_answer_is_brought_again_and_what_it_refuses_is_not(monkeypatch, status, left, told):
    point = Point(monkeypatch)
    point.status, point.in_ledger = status, 7
    point.pictures._unsent.append((7, "0" * 64, "{}"))
    point.pictures._unsent.append((8, "1" * 64, "{}"))
    assert asyncio.run(point.pictures.bring()) is (left == 0)
    assert len(point.pictures._unsent) == left + 1, "the second one's record is not in the ledger"
    assert [error.code for error in point.incidents] == told
    for number in range(KEPT + 5):
        point.pictures._unsent.append((number, "2" * 64, "{}"))
    assert len(point.pictures._unsent) == KEPT


def test_the_process_answers_each_question_and_ends_with_its_input(monkeypatch):
    questions = [AssessedQuestion(ROBOT, where(), motion, None) for motion in (sweep(), OutputSet(3, True), sweep())]
    packing, told = picture_drawer.Packing(), io.BytesIO()
    asked = b"".join(map(packing.packed, questions))
    picture_drawer.answer_all(io.BytesIO(asked[:-1]), told)
    text = told.getvalue()
    kind, length = picture_drawer.HEAD.unpack(text[:5])
    assert kind == picture_drawer.TEXT and picture.read(text[5 : 5 + length].decode())
    assert text[5 + length :] == picture_drawer.HEAD.pack(picture_drawer.NONE, 0), "half a question is none"

    def impossible(*_):
        raise PitError("MOTION_ODD", "")

    monkeypatch.setattr(picture_drawer, "shown_text", impossible)
    assert picture_drawer.drawn(*[None] * 4) == (picture_drawer.REASON, b"PICTURE_IMPOSSIBLE")
