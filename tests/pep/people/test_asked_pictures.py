"""Picture of a question where it is asked: named by the ask and sent with it, or nobody is asked."""

from __future__ import annotations

import asyncio

import pytest
from msgspec import structs
from capabilities.statements.claims import malformed
from pep.people.deferral import AskState
from pep.world.questions import KEPT, AssessedQuestions
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.capabilities.statements.people.test_pictures import SHOWN
from tests.pep.people.test_approvals import People
from tests.pep.pit.picture.test_shown_form import answer, where
from tests.pep.pit.scenes import ROBOT, sweep

from capabilities.keys import keys
from capabilities.statements.people import ask, picture
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import FaultCode, StatementError
from pep.pit import OutputSet

pytestmark = pytest.mark.clause("STM-25")
TEXT = picture.write(SHOWN)


class Pictures:
    """Gives what a test says, and remembers for which requests."""

    def __init__(self, text):
        self.text, self.asked = text, []

    def shown(self, request_id):
        self.asked.append(request_id)
        if self.text is None or isinstance(self.text, str):
            return self.text
        raise self.text


class Seeing(People):
    """Rig whose point shows pictures."""

    def __init__(self, tmp, text):
        self.pictures = Pictures(text)
        super().__init__(tmp)

    def asked_text(self):
        return ask.open(self.text, [keys.public_raw(self.pep_key)], DEFAULT)


def test_an_ask_names_the_picture_that_is_sent_with_it(tmp_path):
    rig = Seeing(tmp_path, TEXT)
    notice = rig.ask()
    assert rig.pictures.asked == [notice.ask_id]
    assert rig.asked_text().picture_digest == picture.digest_of(TEXT)
    assert rig.issuer.pictures[notice.ask_id] == TEXT
    rig.cast(rig.vote())
    assert rig.state() is AskState.GRANTED


def test_a_vote_on_another_picture_is_none(tmp_path):
    rig = Seeing(tmp_path, TEXT)
    rig.ask()
    other = structs.replace(rig.asked_text(), picture_digest=picture.digest_of(TEXT + " "))
    kept, rig.text = rig.text, ask.sign(other, rig.pep_key)
    lie = rig.vote()
    rig.text = kept
    rig.cast(lie)
    assert (rig.state(), rig.faults()) == (AskState.OPEN, ["VOTE_NOT_FOR_THIS_ASK"])


def test_an_act_without_motion_names_none(tmp_path):
    rig = Seeing(tmp_path, None)
    notice = rig.ask()
    assert rig.asked_text().picture_digest == ""
    assert rig.issuer.pictures[notice.ask_id] is None


def test_without_a_picture_of_a_motion_nobody_is_asked(tmp_path):
    rig = Seeing(tmp_path, malformed("no picture"))
    told = rig.go()
    assert (told.decision.effect, told.decision.reason) == (Effect.DENY, Reason.STATEMENT_MALFORMED)
    assert rig.issuer.asks == {}
    assert rig.sent == []


def test_after_a_restart_the_ask_goes_without_it(tmp_path):
    rig = Seeing(tmp_path, TEXT)
    rig.issuer.down = True
    asked = rig.go().ask
    rig.restart()
    (left,) = rig.asks.unposted()
    assert (left.ask_id, left.text, left.picture) == (asked.ask_id, asked.text, "")


def lost(tmp_path):
    """Point that ended before its question came to the provider, started again; and that question."""
    rig = Seeing(tmp_path, TEXT)
    rig.issuer.down = True
    asked = rig.go().ask
    rig.restart()
    rig.issuer.down = False
    return rig, asked


def test_a_question_whose_picture_a_restart_lost_is_put_anew_at_once(tmp_path):
    rig, before = lost(tmp_path)
    told = rig.go()
    assert (told.decision.effect, told.decision.reason) == (Effect.DEFER, Reason.TIER_NEEDS_APPROVAL)
    assert told.ask.ask_id != before.ask_id
    assert rig.issuer.asks == {told.ask.ask_id: told.ask.text}
    assert rig.issuer.pictures[told.ask.ask_id] == TEXT
    (ended,) = rig.records("ask-refused")
    assert (ended["body"]["ask_id"], ended["body"]["reason"]) == (before.ask_id, "ASK_PICTURE_DIFFERS")
    assert rig.go().ask.ask_id == told.ask.ask_id, "one question at a time"
    rig.restart()
    assert rig.asks.state_of(before.ask_id) is None
    rig.text, rig.ask_id = told.ask.text, told.ask.ask_id
    rig.cast(rig.vote())
    assert rig.go().decision.effect is Effect.PERMIT
    assert len(rig.sent) == 1


def test_a_question_that_came_to_the_provider_before_the_restart_stands(tmp_path):
    rig = Seeing(tmp_path, TEXT)
    notice = rig.ask()
    rig.restart()
    assert rig.go().ask.ask_id == notice.ask_id
    assert (rig.records("ask-refused"), rig.asks.unposted()) == ([], ())
    rig.cast(rig.vote())
    assert rig.go().decision.effect is Effect.PERMIT


def test_the_loop_that_posts_ends_a_lost_question_before_anybody_asks_again(tmp_path):
    rig, before = lost(tmp_path)
    (left,) = rig.asks.unposted()
    asyncio.run(rig.asking._post(left))
    assert rig.asks.state_of(before.ask_id) is AskState.LOST
    assert rig.go().ask.ask_id != before.ask_id
    assert len(rig.records("ask-refused")) == 1


def test_a_provider_that_refuses_a_picture_that_was_sent_is_asked_again_later(tmp_path):
    rig = Seeing(tmp_path, TEXT)
    rig.issuer.refuses = (409, "ASK_PICTURE_DIFFERS")
    assert rig.go().decision.effect is Effect.DEFER
    assert rig.records("ask-refused") == []
    assert len(rig.asks.unposted()) == 1


def test_an_ask_that_names_no_picture_has_lost_none_whatever_the_provider_says(tmp_path):
    rig = Seeing(tmp_path, None)
    rig.issuer.refuses = (409, "ASK_PICTURE_DIFFERS")
    told = rig.go()
    assert told.decision.effect is Effect.DEFER
    assert rig.asks.state_of(told.ask.ask_id) is AskState.OPEN
    assert (len(rig.records("ask")), rig.records("ask-refused")) == (1, [])


def test_what_was_assessed_is_shown_and_the_oldest_is_forgotten():
    questions = AssessedQuestions()
    situation, found = where(), answer(sweep())
    questions.keep("moves", ROBOT, situation, sweep(), found)
    shown = picture.read(questions.shown("moves"))
    assert shown.places[0].index_milli == found.contributions[0].index_milli
    questions.keep("switches", ROBOT, situation, OutputSet(3, True), found)
    assert questions.shown("switches") is None
    for number in range(KEPT):
        questions.keep(f"later-{number}", ROBOT, situation, OutputSet(3, True), found)
    with pytest.raises(StatementError) as raised:
        questions.shown("moves")
    assert raised.value.code is FaultCode.STATEMENT_MALFORMED
