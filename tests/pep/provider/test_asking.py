"""Asks and answers on the wire: the double of the provider verifies proofs and asks, and tells every lie."""

import asyncio
import json

import httpx2
import pytest
from pep.base.clock import SystemClock
from pep.base.errors import PepError, PepFault
from capabilities import tracing
from pep.people.asks import Asks
from pep.people.deferral import AskState
from pep.provider.ask_client import AskClient
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep.kit import MOVE, reading
from tests.pep.people.test_approvals import NEAR, People, closing

from capabilities.values import trace_context

pytestmark = pytest.mark.real_time


@pytest.fixture
def rig(tmp_path):
    rig = People(tmp_path)
    yield rig
    closing(rig)


@pytest.fixture
def live(tmp_path):
    rig = People(tmp_path, clock=SystemClock())
    yield rig
    closing(rig)


def test_an_ask_is_posted_with_proof_before_the_caller_is_told(rig):
    asked = rig.ask()
    assert rig.issuer.asks == {asked.ask_id: asked.text}
    assert rig.asks.unposted() == ()


def test_an_ask_and_its_records_are_of_the_requests_trace_also_after_a_restart(rig):
    ids = trace_context.TraceIds("0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331")
    rig.issuer.down = True
    with tracing.rejoined(ids):
        asked = rig.go().ask
    assert [record["body"]["trace_id"] for record in rig.records("ask") + rig.records("decision")] == [ids.trace_id] * 2
    again = Asks(
        clock=rig.clock, journal=rig.journal, timeout_ms=60_000, asker=rig.asks._asker, approvers=rig.asks._approvers, caps=rig.asks._caps,
    )  # fmt: skip
    again.recover(rig.records())
    (left,) = again.unposted()
    assert (left.ask_id, left.trace_id) == (asked.ask_id, ids.trace_id)
    rig.issuer.down, rig.issuer.traces = False, []
    asyncio.run(rig.asking._post(left))
    assert [trace_context.read(each).trace_id for each in rig.issuer.traces] == [ids.trace_id]


def test_outside_of_a_trace_records_name_none(rig):
    rig.ask()
    assert not any("trace_id" in record["body"] for record in rig.records())
    assert rig.issuer.traces == [None]


def test_a_spent_budget_is_a_denial_on_record_and_is_not_tried_again_at_once(rig):
    rig.issuer.refuses = (429, "ASK_BUDGET_SPENT")
    answer = rig.go()
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.ASK_BUDGET_SPENT)
    assert [r["kind"] for r in rig.records()] == ["ask", "ask-refused", "decision"]
    assert rig.records("ask-refused")[0]["body"]["reason"] == "ASK_BUDGET_SPENT"
    assert rig.decisions()[-1]["decision"]["reason"] == "ASK_BUDGET_SPENT"
    again = rig.go()
    assert (again.decision.reason, len(rig.records("ask"))) == (Reason.ASK_BUDGET_SPENT, 1)
    rig.issuer.refuses = None
    rig.clock.advance(10_001)
    assert rig.go().decision.effect is Effect.DEFER
    assert rig.sent == []


@pytest.mark.parametrize("refusal", [(429, "TOO_MANY_REQUESTS"), (500, ""), (409, "ASK_DIFFERS"), (401, "PROOF_STALE")])
def test_any_other_refusal_leaves_the_deferral_open_and_is_an_incident(rig, refusal):
    rig.issuer.refuses = refusal
    answer = rig.go()
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DEFER, Reason.TIER_NEEDS_APPROVAL)
    assert [error.code for error in rig.incidents] == [PepFault.ASK_NOT_TAKEN]
    assert [ask.ask_id for ask in rig.asks.unposted()] == [answer.ask.ask_id]


async def until(condition):
    async with asyncio.timeout(20):
        while not condition():
            await asyncio.sleep(0.02)


def test_a_provider_that_was_down_gets_it_later_and_its_answer_is_fetched(live):
    async def scenario():
        live.issuer.down = True
        running = asyncio.create_task(live.asking.run())
        answer = await live.gate.run(live.call(live.holder), live.effect)
        assert answer.decision.effect is Effect.DEFER
        await until(lambda: PepFault.FEED_UNREACHABLE in {error.code for error in live.incidents})
        live.issuer.down = False
        await until(lambda: live.issuer.asks)
        live.text, live.ask_id = live.issuer.asks[answer.ask.ask_id], answer.ask.ask_id
        live.issuer.cast(live.ask_id, live.vote())
        await until(lambda: live.asks.state_of(live.ask_id) is AskState.GRANTED)
        moved = await live.gate.run(live.call(live.holder), live.effect)
        running.cancel()
        return moved

    assert asyncio.run(scenario()).decision.effect is Effect.PERMIT
    assert len(live.sent) == 1


def test_an_opening_is_noticed_without_any_ask(live):
    async def scenario():
        running = asyncio.create_task(live.asking.run())
        live.issuer.openings = [live.people["carol"].opening(at=live.clock.wall_s())]
        await until(live.asks.matter)
        running.cancel()

    asyncio.run(scenario())


def test_a_provider_that_does_not_answer_holds_neither_caller_nor_slot(rig):
    never = asyncio.Event

    async def silence(_):
        await never().wait()

    async def scenario():
        rig.asking._http = httpx2.AsyncClient(transport=httpx2.MockTransport(silence))
        waiting = asyncio.create_task(rig.gate.run(rig.call(rig.holder), rig.effect))
        await until(lambda: rig.records("ask") and rig.slot.holder is None)
        assert not waiting.done()
        rig.physics.answer = reading(1, 900)
        other = await rig.gate.run(rig.call(rig.holder, arguments={**MOVE, "speed_rad_s": 0.4}), rig.effect)
        async with asyncio.timeout(10):
            return other, await waiting

    other, deferred = asyncio.run(scenario())
    assert (other.decision.effect, deferred.decision.effect) == (Effect.PERMIT, Effect.DEFER)


LIES = {
    "nonce": (lambda issuer: issuer.answers_lie.update(nonce="x" * 32), PepFault.FEED_WRONG_NONCE),
    "audience": (
        lambda issuer: issuer.answers_lie.update(audience="http://127.0.0.1:1/mcp"),
        PepFault.ANSWERS_WRONG_AUDIENCE,
    ),
    "issuer": (lambda issuer: issuer.answers_lie.update(issuer="http://127.0.0.1:1/x"), PepFault.FEED_WRONG_ISSUER),
    "signed by the ledger": (
        lambda issuer: setattr(issuer, "answers_signer", issuer.made["ledger"]),
        PepFault.FEED_UNTRUSTED,
    ),
    "signed by the feed": (
        lambda issuer: setattr(issuer, "answers_signer", issuer.made["feed"]),
        PepFault.FEED_UNTRUSTED,
    ),
    "a flipped byte": (
        lambda issuer: setattr(issuer, "spoil", lambda text: text[:-9] + ("A" if text[-9] != "A" else "B") + text[-8:]),
        PepFault.FEED_UNTRUSTED,
    ),
    "not ASCII": (lambda issuer: setattr(issuer, "spoil", lambda text: text + "ü"), PepFault.FEED_UNTRUSTED),
    "oversized": (lambda issuer: setattr(issuer, "spoil", lambda text: text * 500), PepFault.FEED_UNTRUSTED),
    "nothing": (lambda issuer: setattr(issuer, "down", True), PepFault.FEED_UNREACHABLE),
}


@pytest.mark.parametrize("name", LIES)
def test_a_word_that_is_refused_changes_nothing(rig, name):
    tell, code = LIES[name]
    rig.ask()
    rig.issuer.cast(rig.ask_id, rig.vote())
    tell(rig.issuer)
    with pytest.raises(PepError) as raised:
        rig.pull()
    assert raised.value.code is code
    assert rig.state() is AskState.OPEN
    assert rig.go().decision.effect is Effect.DEFER


def test_the_age_of_a_word_runs_from_sending_its_nonce(rig):
    """A provider that holds its answer back for two seconds has said nothing of now."""
    rig.ask()
    rig.issuer.cast(rig.ask_id, rig.vote())
    honest = rig.issuer.answers

    def slow(**query):
        text = honest(**query)
        rig.clock.advance(2_001)
        return text

    rig.issuer.answers = slow
    rig.pull()
    answer = rig.go()
    assert answer.decision.reason is Reason.APPROVAL_NOT_USABLE
    assert [d["what"] for d in answer.decision.findings[0].detail["differs"]] == ["age_ms"]
    rig.issuer.answers = honest
    rig.pull()
    assert rig.go().decision.effect is Effect.PERMIT


def test_a_refusal_of_enormous_length_is_no_answer(rig):
    rig.issuer.refuses = (429, "ASK_BUDGET_SPENT" + " " * 10_000)
    assert rig.go().decision.effect is Effect.DEFER
    assert rig.incidents


def test_what_is_posted_is_exactly_the_text(rig):
    sent = []
    honest = rig.issuer.take_ask
    rig.issuer.take_ask = lambda request: sent.append(json.loads(request.content)) or honest(request)
    asked = rig.ask()
    assert sent == [{"ask": asked.text}]
    assert isinstance(rig.asking, AskClient)
    assert rig.physics.answer is NEAR
