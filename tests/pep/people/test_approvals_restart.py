"""Killed after any record, and in the middle of any: nothing is lost, nothing is asked or used twice."""

import asyncio
from collections import Counter

import pytest
from pep.people.deferral import AskState
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep.kit import reading
from tests.pep.people.test_approvals import PERSON, Critical, People, closing, refused_unsent


@pytest.fixture
def rig(tmp_path):
    rig = People(tmp_path)
    yield rig
    closing(rig)


def story(rig):
    """Two uses, one of them returned and taken again; a second ask of one use; a third that stays open."""
    rig.ask()
    rig.cast(rig.vote(uses=2))
    assert rig.go().decision.effect is Effect.PERMIT
    asyncio.run(rig.gate.run(rig.call(rig.holder), refused_unsent))
    assert rig.go().decision.effect is Effect.PERMIT
    second = rig.go().ask
    rig.issuer.cast(second.ask_id, rig.people["carol"].vote(second.text, at=rig.clock.wall_s()))
    rig.pull()
    assert rig.go().decision.effect is Effect.PERMIT
    assert rig.go().decision.reason is Reason.APPROVAL_USED


def given(rig):
    """Number of times that each use was given and not returned, by the journal."""
    uses = Counter()
    for record in rig.records():
        body = record["body"]
        if record["kind"] == "decision" and "approval" in body:
            uses[body["approval"]["ask_id"], body["approval"]["use"]] += 1
        if record["kind"] == "outcome" and "returned" in body:
            uses[body["returned"]["ask_id"], body["returned"]["use"]] -= 1
    return uses


def cuts(path):
    """Every length at which the file can have ended: after each record, and in the middle of each."""
    lines = path.read_bytes().splitlines(keepends=True)
    whole = [b"".join(lines[:n]) for n in range(len(lines) + 1)]
    return [*whole, *(before + line[: len(line) // 2] for before, line in zip(whole, lines, strict=False))]


@pytest.mark.long
def test_whatever_record_is_the_last_no_use_is_given_twice(rig):
    story(rig)
    assert set(given(rig).values()) == {1}
    for content in cuts(rig.path):
        rig.sent.clear()
        rig.restart(content)
        before = given(rig)
        asked = {r["body"]["ask_id"] for r in rig.records("ask")}
        rig.pull()
        for _ in range(5):
            rig.go()
        after = given(rig)
        assert set(after.values()) <= {0, 1}, content[-300:]
        assert len(rig.sent) == sum(after.values()) - sum(before.values())
        # each ask that was on record has exactly the uses that were granted, in all
        for ask_id in asked & rig.issuer.votes.keys():
            assert sum(n for (of, _), n in after.items() if of == ask_id) == (2 if ask_id == rig.ask_id else 1)


def test_an_open_ask_has_what_is_left_of_its_time_and_is_the_same_question(rig):
    asked = rig.ask()
    rig.clock.advance(20_000)
    rig.restart()
    assert rig.go().ask.ask_id == asked.ask_id
    assert len(rig.records("ask")) == 1
    rig.clock.advance(39_998)  # what is on disk is rounded to milliseconds
    assert rig.asks.expire() == ()
    rig.clock.advance(3)
    assert [ask.ask_id for ask in rig.asks.expire()] == [asked.ask_id]
    assert rig.go().decision.reason is Reason.APPROVAL_TIMEOUT


def test_an_ask_that_was_not_posted_yet_is_posted_by_the_next_process(rig):
    rig.issuer.down = True
    asked = rig.go().ask
    rig.issuer.down = False
    rig.restart()
    assert [ask.ask_id for ask in rig.asks.unposted()] == [asked.ask_id]
    assert rig.go().ask.ask_id == asked.ask_id
    assert rig.issuer.asks == {asked.ask_id: asked.text}


def test_an_ask_that_ended_while_nobody_ran_ends_on_record(rig):
    asked = rig.ask()
    rig.clock.advance(61_000)
    rig.restart()
    assert [r["body"]["ask_id"] for r in rig.records("ask-expired")] == [asked.ask_id]
    rig.restart()
    assert len(rig.records("ask-expired")) == 1


def test_a_clock_that_was_set_back_gives_no_more_time(rig):
    asked = rig.ask()
    rig.clock.advance(50_000)
    rig.journal.append("incident", {"what": "the newest record"})
    rig.clock.wall -= 3_600
    rig.restart()
    rig.clock.advance(10_001)  # what is on disk is rounded to milliseconds
    assert [ask.ask_id for ask in rig.asks.expire()] == [asked.ask_id]


def test_votes_count_again_once_they_are_fetched_again(rig):
    rig.ask()
    rig.cast(rig.vote())
    rig.restart()
    waiting = rig.go()
    assert (waiting.decision.effect, waiting.ask.ask_id, rig.sent) == (Effect.DEFER, rig.ask_id, [])
    assert waiting.decision.reason is Reason.TIER_NEEDS_APPROVAL
    assert len(rig.records("ask")) == 1
    rig.pull()
    assert rig.go().decision.effect is Effect.PERMIT
    rig.restart()
    rig.pull()
    assert rig.go().decision.reason is Reason.APPROVAL_USED
    assert len(rig.sent) == 1


def test_votes_that_come_before_the_registry_are_not_lost(rig):
    rig.ask()
    rig.cast(rig.vote())
    rig.restart()
    people, rig.registry.people = rig.registry.people, {}
    rig.pull()
    assert rig.go().decision.reason is Reason.TIER_NEEDS_APPROVAL
    rig.registry.people = people
    rig.pull()
    assert rig.go().decision.effect is Effect.PERMIT


def test_a_granted_ask_does_not_end_in_silence_after_a_restart(rig):
    rig.ask()
    rig.cast(rig.vote())
    rig.clock.advance(61_000)
    rig.restart()
    assert rig.records("ask-expired") == []
    rig.pull()
    assert rig.go().decision.effect is Effect.PERMIT


@pytest.mark.parametrize("answer", ["deny", "withdraw"])
def test_a_no_survives(rig, answer):
    rig.ask()
    rig.cast(rig.vote("bob"), rig.vote("bob", answer=answer))
    rig.restart()
    assert rig.go().decision.effect is (Effect.DENY if answer == "deny" else Effect.DEFER)
    rig.issuer.votes[rig.ask_id] = rig.issuer.votes[rig.ask_id][:1]
    rig.pull()
    rig.go()
    assert rig.sent == []
    assert rig.state() in {AskState.DENIED, AskState.WITHDRAWN}


def test_a_refused_ask_is_not_asked_again(rig):
    rig.issuer.refuses = (429, "ASK_BUDGET_SPENT")
    rig.go()
    rig.issuer.refuses = None
    rig.restart()
    assert rig.asks.unposted() == ()


def test_an_ask_that_another_key_signed_is_no_question_of_ours(rig):
    rig.ask()
    rig.cast(rig.vote())
    from capabilities.keys import keys

    rig.pep_key = keys.generate()
    rig.restart()
    assert rig.state() is None
    assert rig.go().ask.ask_id != rig.ask_id


def test_uses_of_an_opening_survive(tmp_path):
    four = Critical(tmp_path)
    four.open(uses=2)
    four.ask()
    four.cast(four.vote("alice", uses=5), four.vote("bob", uses=5))
    for left in (1, 0):
        assert four.go().decision.effect is Effect.PERMIT
        four.restart()
        four.pull()
        reading_of = four.asks.witness(four.call(four.holder).request, four.gate._cheap(four.call(four.holder))).opening
        assert (0 if reading_of is None else reading_of.uses_left) == left
        four.asks.release(four.call(four.holder).request.request_id)
        four.clock.advance(5_001)
        four.pull()
    assert (four.go().decision.effect, four.go().decision.reason) == (Effect.DENY, Reason.TIER_SAFETY_CRITICAL)
    assert len(four.sent) == 2
    closing(four)


def test_one_of_two_is_still_one_of_two_after_a_restart(tmp_path):
    four = Critical(tmp_path)
    four.ask()
    four.cast(four.vote("bob"))
    four.restart()
    four.pull()
    assert (four.go().decision.effect, four.sent) == (Effect.DEFER, [])
    four.cast(four.vote("alice"))
    assert four.go().decision.effect is Effect.PERMIT
    assert four.physics.answer == reading(4, 3_500, contributions=(PERSON,))
    closing(four)
