"""e2: what a message between agents reads as, each fault from a real input; and that each is heard once."""

from __future__ import annotations

import threading

import pytest
from capabilities.statements.claims import BODY_BYTES
from hypothesis import given
from hypothesis import strategies as st
from pep.context.messages import ConversationBook, MessageDirection, TurnResult
from policies.evidence.content_readings import MessageReading
from tests.capabilities.world import NOW, key_of
from tests.pep.context.context_kit import CAPS, FORMS, chain_to, replaced, resigned, said, wanted
from tests.pep.kit import ManualClock

from capabilities.statements.context import message as statement
from pep.context import messages

pytestmark = pytest.mark.clause("STM-6")

CHAIN = chain_to("robotic", "vision")
"""alice -> orchestrator -> robotic -> vision."""
LINE = MessageDirection("robotic", CHAIN.hops[0].hop_id, "c" * 22)
GOOD = MessageReading("", "orchestrator", "robotic", True, True, True, True, True, 1)


def book():
    return ConversationBook(ManualClock(NOW))


def read(text, *, chain=CHAIN, addressee="robotic", heard=None, at=NOW + 1):
    kept = heard or book()
    return messages.read(text, chain=chain, addressee=addressee, conversations=kept, forms=FORMS, at=at, caps=CAPS)


def test_the_next_message_of_the_delegating_holder():
    found = read(said(CHAIN))
    assert found.reading == GOOD
    assert (found.hop, found.line) == (CHAIN.hops[0], LINE)
    assert found.until_s == CHAIN.hops[0].scope.not_after + CAPS.skew_s


def test_a_holder_answers_under_its_own_hop():
    found = read(said(CHAIN, hop=1, sender="robotic", addressee="orchestrator"), addressee="orchestrator")
    assert found.reading == MessageReading("", "robotic", "orchestrator", True, True, True, True, True, 1)


OTHER = chain_to("gripper")
UNBELIEVED = {
    "by a stranger": (lambda: said(CHAIN, key=key_of("mallory")), "STATEMENT_UNTRUSTED"),
    "with the sponsor's key": (lambda: said(CHAIN, key=key_of("alice")), "STATEMENT_UNTRUSTED"),
    "by an agent of another chain": (lambda: said(CHAIN, key=key_of("gripper")), "STATEMENT_UNTRUSTED"),
    "a person's intent": (wanted, "STATEMENT_WRONG_KIND"),
    "an intent under a hop's key": (lambda: wanted(key=key_of("orchestrator")), "STATEMENT_WRONG_KIND"),
    "over its size": (lambda: said(CHAIN, {"operation": "x" * BODY_BYTES}), "STATEMENT_MALFORMED"),
    "over the size of a statement": (lambda: said(CHAIN) + "A" * CAPS.statement_bytes, "STATEMENT_MALFORMED"),
    "a member twice": (
        lambda: resigned(said(CHAIN), lambda c: b'{"at":1,"at":2}', key_of("orchestrator")), "STATEMENT_MALFORMED"),
    "NaN": (lambda: resigned(said(CHAIN), lambda c: b'{"at":NaN}', key_of("orchestrator")), "STATEMENT_MALFORMED"),
    "a fraction": (lambda: resigned(said(CHAIN), lambda c: b'{"at":0.5}', key_of("orchestrator")), "STATEMENT_MALFORMED"),
    "a homoglyph of its sender": (
        lambda: resigned(said(CHAIN), lambda c: {**c, "sender": "\u043erchestrator"}, key_of("orchestrator")),
        "STATEMENT_MALFORMED"),
    "an addressee that turns the line": (
        lambda: resigned(said(CHAIN), lambda c: {**c, "addressee": "robotic\u202e"}, key_of("orchestrator")),
        "STATEMENT_MALFORMED"),
    "to a role": (lambda: said(CHAIN, addressee="role:robotic"), "STATEMENT_MALFORMED"),
    "nothing": (lambda: "", "STATEMENT_MALFORMED"),
}  # fmt: skip


@pytest.mark.parametrize("name", UNBELIEVED)
def test_what_no_hop_signed_is_not_believed(name):
    make, fault = UNBELIEVED[name]
    found = read(make())
    assert found.reading == MessageReading(fault, "", "", False, False, False, False, False, None)
    assert (found.message, found.hop, found.line) == (None, None, None)


def test_without_a_chain_nothing_is_believed():
    assert read(said(CHAIN), chain=None).reading.fault == "STATEMENT_UNTRUSTED"


JUDGED = {
    "said under another hop than signed it": (
        {"hop_id": CHAIN.hops[1].hop_id},
        {"by_holder": False, "in_delegation": False},
    ),
    "said for another sender": ({"sender": "vision"}, {"sender": "vision", "by_holder": False, "in_delegation": False}),
    "said under another token": ({"token_id": "w" * 22}, {"by_holder": False, "in_delegation": False}),
    "to another agent": ({"addressee": "vision"}, {"addressee": "vision", "addressed": False}),
    "of a form that nobody knows": ({"schema": "task/9"}, {"in_schema": False, "in_delegation": False}),
    "of an instruction's form": ({"schema": "sort/1"}, {"in_schema": False, "in_delegation": False}),
    "the second before the first": ({"sequence": 2}, {"in_sequence": False}),
    "not yet": ({"at": NOW + 7}, {"fault": "NOT_YET_VALID", "age_s": None}),
    "a little early": ({"at": NOW + 6}, {"age_s": -5}),
    "over": ({"at": NOW - 60, "not_after": NOW + 1}, {"fault": "EXPIRED", "age_s": 61}),
}


@pytest.mark.parametrize("name", JUDGED)
def test_what_is_wrong_with_a_message_is_read_alone(name):
    change, reading = JUDGED[name]
    assert read(said(CHAIN, **change)).reading == replaced(GOOD, **reading)


@pytest.mark.parametrize(
    ("hop", "body", "inside"),
    [
        (0, {"operation": "gripper_move"}, True),
        (1, {"operation": "gripper_move"}, False),
        (1, {"operation": "stop"}, True),
        (2, {"operation": "stop"}, False),
        (0, {"operation": "reboot"}, False),
        (0, {"operation": "move_joint", "speed_urad_s": 1_000_000}, True),
        (1, {"operation": "move_joint", "speed_urad_s": 1_000_000}, False),
        (1, {"operation": "move_joint", "speed_urad_s": 500_000}, True),
        (0, {"operation": "move_joint", "speed_urad_s": 1_000_001}, False),
        (0, {"operation": "read_state", "speed_urad_s": 1}, False),
    ],
)
def test_nobody_asks_for_what_its_own_hop_does_not_grant(hop, body, inside):
    """By the sender's hop: neither what is above it nor what is below it counts."""
    to = "gripper"
    assert read(said(CHAIN, body, hop=hop, addressee=to), addressee=to).reading.in_delegation is inside


def test_a_reading_agrees_with_the_clause():
    """[STM-6] once as one fault and once part by part: the same messages are in their place."""
    for name, (change, _) in {"as it should be": ({}, {}), **JUDGED}.items():
        found = read(said(CHAIN, **change))
        place = statement.ExpectedMessage("orchestrator", "robotic", CHAIN.token_id, CHAIN.hops[0].hop_id, "c" * 22, 0)
        fault = statement.refusal(found.message, place, at=NOW + 1, caps=CAPS)
        reading = found.reading
        parts = reading.by_holder and reading.addressed and reading.in_sequence and not reading.fault
        assert parts is (fault is None), name


@given(st.text(max_size=200))
def test_no_text_raises(text):
    assert read(text).reading.fault


# --- in turn ---------------------------------------------------------------------------------------------------------


def test_a_turn_is_taken_once_and_in_order():
    kept = book()
    assert kept.take(LINE, 2, until_s=NOW + 9) is TurnResult.OUT_OF_TURN
    assert kept.take(LINE, 1, until_s=NOW + 9) is TurnResult.TAKEN
    assert kept.take(LINE, 1, until_s=NOW + 9) is TurnResult.OUT_OF_TURN
    assert kept.take(LINE, 3, until_s=NOW + 9) is TurnResult.OUT_OF_TURN
    assert kept.take(LINE, 2, until_s=NOW + 9) is TurnResult.TAKEN
    assert kept.heard(LINE) == 2
    for other in (
        MessageDirection("vision", *_rest()),
        MessageDirection("robotic", "0" * 32, LINE.conversation),
        replaced(LINE, conversation="d" * 22),
    ):
        assert kept.heard(other) == 0
    assert read(said(CHAIN, sequence=2), heard=kept).reading.in_sequence is False
    assert read(said(CHAIN, sequence=3), heard=kept).reading.in_sequence is True
    assert read(said(CHAIN, sequence=4), heard=kept).reading.in_sequence is False


def _rest():
    return LINE.hop_id, LINE.conversation


def test_reading_takes_no_turn():
    kept = book()
    for _ in range(3):
        assert read(said(CHAIN), heard=kept).reading.in_sequence


def test_one_of_many_takes_the_turn():
    kept, results = book(), []
    threads = [threading.Thread(target=lambda: results.append(kept.take(LINE, 1, until_s=NOW + 9))) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(10)
    assert sorted(results, key=str) == sorted([TurnResult.TAKEN] + [TurnResult.OUT_OF_TURN] * 15, key=str)


def test_nothing_is_forgotten_early_and_what_is_over_makes_room():
    clock = ManualClock(NOW)
    kept = ConversationBook(clock, capacity=3, of_a_hop=2)
    lines = [MessageDirection("robotic", f"{n // 2:032x}", f"{n:022}") for n in range(6)]
    assert [kept.take(line, 1, until_s=NOW + 10 + n) for n, line in enumerate(lines[:3])] == [TurnResult.TAKEN] * 3
    assert kept.take(lines[3], 1, until_s=NOW + 60) is TurnResult.FULL
    assert kept.take(lines[0], 2, until_s=NOW + 60) is TurnResult.TAKEN
    clock.advance(11_000)
    assert kept.take(lines[3], 1, until_s=NOW + 60) is TurnResult.TAKEN
    assert (kept.heard(lines[0]), kept.heard(lines[1])) == (2, 0)


def test_a_later_message_that_ends_sooner_does_not_shorten_a_conversation():
    clock = ManualClock(NOW)
    kept = ConversationBook(clock, capacity=1)
    assert kept.take(LINE, 1, until_s=NOW + 100) is TurnResult.TAKEN
    assert kept.take(LINE, 2, until_s=NOW + 1) is TurnResult.TAKEN
    clock.advance(50_000)
    assert kept.take(replaced(LINE, conversation="d" * 22), 1, until_s=NOW + 100) is TurnResult.FULL
    assert kept.heard(LINE) == 2


def test_one_hop_does_not_fill_the_book():
    kept = ConversationBook(ManualClock(NOW), of_a_hop=2)
    lines = [replaced(LINE, conversation=f"{n:022}") for n in range(3)]
    assert [kept.take(line, 1, until_s=NOW + 9) for line in lines] == [
        TurnResult.TAKEN,
        TurnResult.TAKEN,
        TurnResult.FULL,
    ]
    assert kept.take(replaced(lines[2], hop_id="0" * 32), 1, until_s=NOW + 9) is TurnResult.TAKEN


def test_what_is_remembered_is_heard():
    kept = book()
    kept.remember(LINE, 4, until_s=NOW + 9)
    kept.remember(LINE, 3, until_s=NOW + 9)
    assert kept.heard(LINE) == 4
    assert kept.take(LINE, 4, until_s=NOW + 9) is TurnResult.OUT_OF_TURN
