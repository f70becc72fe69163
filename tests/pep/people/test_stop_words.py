"""Words of people on a stop: that of a known person counts once, just now, for this robot."""

from __future__ import annotations

import secrets

import pytest
from capabilities.statements.people.stop import LIFETIME_S, STOP_BYTES, Stop
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.errors import FaultCode
from pep.journal.replay_cache import ReplayCache
from pep.people.stop_words import SpokenStop, StopFault, StopPlace, StopWords
from tests.pep.kit import AUDIENCE, ManualClock, Person, Registry

from capabilities.keys import keys
from capabilities.statements import statement_form
from capabilities.statements.people import stop as statement

pytestmark = pytest.mark.clause("STM-26")
ISSUER = "https://idp.example/ztpm"


class Desk:
    """Reader of words at one robot, whose gateway began a minute ago."""

    def __init__(self):
        self.clock, self.registry, self.bob = ManualClock(), Registry(), Person("bob")
        self.registry.people = {self.bob.raw: "bob"}
        self.began = int(self.clock.wall_s()) - 60
        self.replay = ReplayCache(self.clock)
        self.words = self.made()

    def made(self):
        place = StopPlace(ISSUER, AUDIENCE, "ur3e", self.began)
        return StopWords(place, people=self.registry, replay=self.replay, clock=self.clock, caps=CAPS)

    def word(self, key=None, **changes):
        at = changes.get("at", int(self.clock.wall_s()))
        members = {
            "stop_id": secrets.token_hex(16),
            "issuer": ISSUER,
            "audience": AUDIENCE,
            "robot": "ur3e",
            "person": "bob",
            "reason": "a glove lies in its way",
            "not_after": at + LIFETIME_S,
            "at": at,
        }
        return statement.sign(Stop(**(members | changes)), key or self.bob.key)


@pytest.fixture
def desk():
    return Desk()


def test_a_known_persons_word_counts_once(desk):
    text = desk.word()
    found = desk.words.read(text)
    assert isinstance(found, SpokenStop)
    assert (found.stop.person, found.stop.reason, found.text, found.key) == (
        "bob", "a glove lies in its way", text, desk.bob.raw,
    )  # fmt: skip
    for _ in range(2):
        assert desk.words.read(text) is StopFault.STOP_USED
    assert isinstance(desk.words.read(desk.word()), SpokenStop), "another word of the same person"


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"issuer": "https://other.example/ztpm"}, StopFault.STOP_NOT_FOR_THIS_ROBOT),
        ({"audience": "https://other.example/mcp"}, StopFault.STOP_NOT_FOR_THIS_ROBOT),
        ({"robot": "ur5e"}, StopFault.STOP_NOT_FOR_THIS_ROBOT),
        ({"person": "carol"}, StopFault.STOP_NOT_YOURS),
    ],
)
def test_a_word_for_another_robot_or_in_anothers_name_counts_for_nobody(desk, changes, code):
    desk.registry.people[Person("carol").raw] = "carol"
    assert desk.words.read(desk.word(**changes)) is code


@pytest.mark.parametrize(
    ("after_s", "code"),
    [
        (-CAPS.skew_s, None),
        (-CAPS.skew_s - 1, StopFault.STOP_OUT_OF_TIME),
        (LIFETIME_S - 1, None),
        (LIFETIME_S + 1, StopFault.STOP_OUT_OF_TIME),
        (10**9, StopFault.STOP_OUT_OF_TIME),
    ],
)
def test_a_word_counts_from_its_signing_for_half_a_minute(desk, after_s, code):
    text = desk.word(at=int(desk.clock.wall_s()) - after_s)
    desk.began = 0
    found = desk.made().read(text)
    assert found is code if code else isinstance(found, SpokenStop)


def test_a_word_from_before_the_gateway_began_does_not_count_since_nobody_knows_whether_it_did(desk):
    text = desk.word()
    desk.began = int(desk.clock.wall_s()) + 1
    assert desk.made().read(text) is StopFault.STOP_OUT_OF_TIME


def test_a_word_is_remembered_for_longer_than_it_counts(desk):
    text = desk.word(at=int(desk.clock.wall_s()) + CAPS.skew_s)
    assert isinstance(desk.words.read(text), SpokenStop)
    seen = []
    for _ in range(LIFETIME_S + 2 * CAPS.skew_s):
        desk.clock.advance(1_000)
        seen.append(desk.words.read(text))
    assert set(seen[: LIFETIME_S + CAPS.skew_s - 1]) == {StopFault.STOP_USED}
    assert set(seen[LIFETIME_S + CAPS.skew_s :]) <= {StopFault.STOP_OUT_OF_TIME}


def test_a_person_whom_the_registry_no_longer_has_is_nobody(desk):
    text = desk.word()
    desk.registry.people = {}
    assert desk.words.read(text) is FaultCode.STATEMENT_UNTRUSTED


def test_a_passkey_makes_no_word(desk):
    desk.registry.held = {desk.bob.raw: "bob"}
    desk.registry.people = {}
    assert desk.words.read(desk.word()) is FaultCode.STATEMENT_UNTRUSTED


def test_any_byte_of_it_changed_is_no_word(desk):
    text = desk.word()
    for at in range(0, len(text), 11):
        other = text[:at] + ("A" if text[at] != "A" else "B") + text[at + 1 :]
        assert desk.words.read(other) in {
            FaultCode.STATEMENT_UNTRUSTED, FaultCode.STATEMENT_MALFORMED, FaultCode.STATEMENT_WRONG_KIND,
        }, at  # fmt: skip
    assert isinstance(desk.words.read(text), SpokenStop)


@pytest.mark.parametrize("text", ["", "?", "\ud800", "ä.ö.ü", "a.b.c", "\x00", "." * STOP_BYTES, "A" * 10**6])
def test_what_is_no_statement_has_a_code_and_breaks_nothing(desk, text):
    assert desk.words.read(text) is FaultCode.STATEMENT_MALFORMED


def test_another_statement_of_the_same_person_is_no_word(desk):
    claims = {"person": "bob"}
    assert desk.words.read(statement_form.sign("clearing", claims, desk.bob.key)) is FaultCode.STATEMENT_WRONG_KIND
    assert desk.words.read(statement_form.sign("stop", claims, desk.bob.key)) is FaultCode.STATEMENT_MALFORMED


def test_where_a_replay_cannot_be_excluded_it_does_not_count(desk):
    desk.replay = ReplayCache(desk.clock, capacity=0)
    assert desk.made().read(desk.word()) is StopFault.STOP_USED


def test_a_strangers_key_is_nobodys(desk):
    assert desk.words.read(desk.word(key=keys.generate())) is FaultCode.STATEMENT_UNTRUSTED
