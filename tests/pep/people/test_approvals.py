"""People's answers at the gate: real, verified statements; a use counts once; a bad one moves nothing."""

import asyncio
import secrets
import threading
from dataclasses import replace

import pytest
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import Tier
from pep.base.errors import ActuationRefusedError, JournalError, PepError
from pep.people.asks import CAPACITY
from pep.people.deferral import AskState
from pep.world.sequence import Sequence
from policies.decision.policy import PolicySet
from policies.evidence.evidence import Contribution
from policies.evidence.model import Effect
from policies.words.parameters import Parameters
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE, MOVE, FailingJournal, Person, Rig, full_scope, reading

from capabilities.keys import keys
from capabilities.statements.people import ask as ask_statement

PERSON = Contribution("person", 2_500, "wrist_3", "dave", 100, 400_000, 200_000, "camera-1")
BOX = Contribution("rigid", 800, "gripper", "box", 100, 100_000, 200_000)
NEAR = reading(3, 2_500, contributions=(PERSON, BOX))


class People(Rig):
    """Rig with a person near the arm, and people who answer."""

    tier = 3

    def __post_init__(self):
        super().__post_init__()
        self.physics.answer = NEAR
        self.holder = self.agent(scope=full_scope(self.clock.wall_s(), ceiling=Tier(self.tier)))

    def go(self, holder=None, **options):
        return asyncio.run(self.gate.run(self.call(holder or self.holder, **options), self.effect))

    def ask(self):
        """The deferral of the move, asked and posted."""
        answer = self.go()
        assert answer.decision.effect is Effect.DEFER
        self.text = self.issuer.asks[answer.ask.ask_id]
        self.ask_id = answer.ask.ask_id
        return answer.ask

    def vote(self, person="bob", **changes):
        at = changes.pop("at", self.clock.wall_s())
        who = self.people[person] if isinstance(person, str) else person
        return who.vote(self.text, at=at, **changes)

    def cast(self, *votes):
        self.issuer.cast(self.ask_id, *votes)
        self.pull()

    def state(self):
        return self.asks.state_of(self.ask_id)

    def decisions(self):
        return [r["body"] for r in self.records("decision")]

    def faults(self):
        return [r["body"]["fault"] for r in self.records("incident")]


class Critical(People):
    """Tier 4, opened beforehand."""

    tier = 4

    def __init__(self, tmp):
        super().__init__(tmp, caps=replace(DEFAULT, key_evidence_ceiling=4))

    def __post_init__(self):
        super().__post_init__()
        self.physics.answer = reading(4, 3_500, contributions=(PERSON,))
        self.open()

    def open(self, person="carol", **changes):
        self.issuer.openings = [self.people[person].opening(at=self.clock.wall_s(), **changes)]
        self.pull()


def closing(rig):
    rig.gate.close()
    rig.journal.close()


@pytest.fixture
def rig(tmp_path):
    rig = People(tmp_path)
    yield rig
    closing(rig)


@pytest.fixture
def four(tmp_path):
    rig = Critical(tmp_path)
    yield rig
    closing(rig)


# -- the way it goes


def test_one_approver_moves_it_once_and_the_second_time_is_asked_anew(rig):
    asked = rig.ask()
    assert asked.url.endswith(f"/approvals/{asked.ask_id}/page")
    rig.cast(rig.vote())
    answer = rig.go()
    assert (answer.decision.effect, answer.decision.tier, len(rig.sent)) == (Effect.PERMIT, Tier(3), 1)
    assert (answer.decision.approval.ask_id, answer.decision.approval.use) == (rig.ask_id, 1)
    permit = rig.decisions()[-1]
    assert permit["approval"] == {"ask_id": rig.ask_id, "use": 1}
    assert "consume approval" in permit["decision"]["obligations"]
    again = rig.go()
    assert (again.decision.effect, again.decision.reason) == (Effect.DEFER, Reason.APPROVAL_USED)
    assert again.ask.ask_id != rig.ask_id
    assert len(rig.issuer.asks) == 2
    # the new question stands by itself now, and can be answered
    assert rig.go().decision.reason is Reason.TIER_NEEDS_APPROVAL
    rig.ask_id, rig.text = again.ask.ask_id, rig.issuer.asks[again.ask.ask_id]
    rig.cast(rig.vote("carol"))
    assert rig.go().decision.effect is Effect.PERMIT
    assert len(rig.sent) == 2


def test_an_approval_is_of_the_mandate_and_outlives_the_token(rig):
    """A renewed token uses it; one of another mandate, or of none, is asked anew."""
    mandate, scope = "0a" * 16, full_scope(rig.clock.wall_s(), ceiling=Tier(3))
    rig.holder = rig.agent(scope=scope, mandate_id=mandate)
    rig.ask()
    asked = ask_statement.open(rig.text, [keys.public_raw(rig.pep_key)], DEFAULT)
    assert asked.mandate_id == mandate
    rig.cast(rig.vote())
    for other in (None, "0b" * 16):
        answer = rig.go(rig.agent(scope=scope, key=rig.holder.key, mandate_id=other))
        assert (answer.decision.effect, answer.ask.ask_id != rig.ask_id) == (Effect.DEFER, True)
    renewed = rig.go(rig.agent(scope=scope, key=rig.holder.key, mandate_id=mandate))
    assert (renewed.decision.effect, renewed.decision.approval.ask_id) == (Effect.PERMIT, rig.ask_id)


def test_what_is_asked_is_what_was_decided_on(rig):
    rig.ask()
    asked = ask_statement.open(rig.text, [keys.public_raw(rig.pep_key)], DEFAULT)
    decision = rig.decisions()[0]
    assert asked.ask_id == decision["request"]["id"]
    assert asked.request_digest == decision["request"]["digest"]
    assert [[v.name, str(v.unit), v.value] for v in asked.values] == decision["request"]["values"]
    assert (asked.agent, asked.agent_key) == ("robotic", keys.thumbprint(keys.public_raw(rig.holder.key)))
    assert (asked.sponsor, asked.audience, asked.approvers, asked.opening_id) == ("alice", AUDIENCE, 1, "")
    assert (asked.tier, asked.index_milli, asked.reasons) == (
        Tier(3),
        2_500,
        ("TIER_NEEDS_APPROVAL", "SEQUENCE_NEEDS_APPROVAL"),
    )
    assert [(c.kind, c.object, c.source) for c in asked.contributors] == [
        ("person", "dave", "camera-1"),
        ("rigid", "box", ""),
    ]
    assert (asked.start_urad, asked.model_digest, asked.policy_digest) == (
        NEAR.start_urad,
        NEAR.model_digest,
        rig.policies.digest,
    )


def test_it_is_on_record_before_it_is_posted_and_an_answer_before_it_counts(rig):
    rig.ask()
    kinds = [r["kind"] for r in rig.records()]
    assert kinds == ["ask", "decision"]
    assert rig.records("ask")[0]["body"]["ask"] == rig.text
    rig.cast(rig.vote())
    (answered,) = rig.records("ask-answered")
    assert (answered["body"]["state"], answered["body"]["approvers"]) == ("granted", ["bob"])
    rig.pull()
    assert len(rig.records("ask-answered")) == 1


def test_what_cannot_be_recorded_is_not_asked(rig):
    rig.build(FailingJournal(rig.journal))
    answer = rig.go()
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.RECORD_FAILED)
    assert rig.issuer.asks == {}


def test_an_answer_that_cannot_be_recorded_does_not_count(rig):
    rig.build(FailingJournal(rig.journal, fail_from=2))
    rig.ask()
    with pytest.raises(JournalError):
        rig.cast(rig.vote())
    assert rig.state() is AskState.OPEN


def test_several_uses_are_given_one_by_one(rig):
    rig.ask()
    rig.cast(rig.vote(uses=3))
    answers = [rig.go() for _ in range(4)]
    assert [a.decision.approval and a.decision.approval.use for a in answers] == [1, 2, 3, None]
    assert answers[3].decision.reason is Reason.APPROVAL_USED


def test_trust_below_theta_is_resolved_by_a_person(rig):
    rig.physics.answer = reading(2, 1_500)
    rig.registry.trust = {"robotic": 500}
    asked = rig.ask()
    assert asked.reason == "TRUST_TOO_LOW"
    rig.cast(rig.vote())
    assert rig.go().decision.effect is Effect.PERMIT


def test_an_unseen_cell_moves_slowly_when_the_approver_sees_it_clear(rig):
    rig.physics.answer = reading(3, 3_000, perception="missing", perception_age_ms=None)
    rig.ask()
    rig.cast(rig.vote(sees_clear=True))
    assert rig.go().decision.effect is Effect.PERMIT


def test_tier_4_with_an_opening_and_two_people(four):
    answer = four.go()
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DEFER, Reason.TIER_SAFETY_CRITICAL)
    four.ask()
    four.cast(four.vote("alice"))
    one = four.go()
    assert (one.decision.effect, one.decision.reason, one.ask.ask_id) == (
        Effect.DEFER,
        Reason.TIER_SAFETY_CRITICAL,
        four.ask_id,
    )
    assert four.sent == []
    four.cast(four.vote("bob"))
    assert four.go().decision.effect is Effect.PERMIT
    assert len(four.sent) == 1
    # the opening had one use
    assert (four.go().decision.effect, four.go().decision.reason) == (Effect.DENY, Reason.TIER_SAFETY_CRITICAL)


def test_tier_4_without_an_opening_asks_nobody(four):
    four.issuer.openings = []
    four.pull()
    answer = four.go()
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.TIER_SAFETY_CRITICAL)
    assert four.issuer.asks == {}


# -- no is no


def test_one_deny_ends_it(rig):
    rig.ask()
    rig.cast(rig.vote("carol", answer="deny"))
    answer = rig.go()
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.APPROVAL_DENIED)
    rig.cast(rig.vote("bob"))
    assert rig.go().decision.reason is Reason.APPROVAL_DENIED
    rig.clock.advance(60_000)
    assert rig.go().decision.effect is Effect.DEFER
    assert rig.sent == []


def test_a_deny_after_an_approval_ends_it(rig):
    rig.ask()
    rig.cast(rig.vote("bob"))
    rig.cast(rig.vote("carol", answer="deny"))
    assert rig.go().decision.reason is Reason.APPROVAL_DENIED
    assert [r["body"]["state"] for r in rig.records("ask-answered")] == ["granted", "denied"]


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_withdrawal_counts_in_whatever_order_it_comes(rig, order):
    rig.ask()
    votes = [rig.vote(), rig.vote(answer="withdraw")]
    rig.cast(*(votes[i] for i in order))
    answer = rig.go()
    assert (answer.decision.effect, rig.sent) == (Effect.DEFER, [])
    assert rig.state() is AskState.WITHDRAWN
    assert answer.ask.ask_id != rig.ask_id


def test_what_was_heard_is_not_unheard(rig):
    """A provider that no longer tells of a withdrawal does not bring the approval back."""
    rig.ask()
    approval = rig.vote()
    rig.cast(approval, rig.vote(answer="withdraw"))
    rig.issuer.votes[rig.ask_id] = [approval]
    rig.pull()
    assert rig.go().decision.effect is Effect.DEFER
    assert rig.sent == []


def test_silence_denies_once_and_a_vote_after_it_is_too_late(rig):
    rig.ask()
    vote = rig.vote()
    rig.clock.advance(60_000)
    rig.cast(vote)
    late = rig.go()
    assert (late.decision.effect, late.decision.reason) == (Effect.DENY, Reason.APPROVAL_TIMEOUT)
    assert rig.go().decision.effect is Effect.DEFER
    assert rig.sent == []


def test_an_approval_that_no_longer_fits_counts_again_when_what_was_shown_is_so_again(rig):
    rig.ask()
    rig.cast(rig.vote())
    stranger = replace(PERSON, object="erin")
    rig.physics.answer = replace(NEAR, contributions=(*NEAR.contributions, stranger))
    changed = rig.go()
    assert (changed.decision.effect, changed.decision.reason) == (Effect.DEFER, Reason.APPROVAL_NOT_USABLE)
    assert changed.ask.ask_id != rig.ask_id
    assert rig.go().ask.ask_id == changed.ask.ask_id
    rig.physics.answer = NEAR
    assert rig.go().decision.approval.ask_id == rig.ask_id


# -- a use is given once


def known(rig, call):
    """Evidence that the gate would have collected beside the cheap part."""
    impact, robot = rig.physics.answer, rig.readiness.answer
    sequence = Sequence(rig.clock).reading(call.request, agent="robotic", impact=impact, robot=robot, unfinished=False)
    return {"impact": impact, "perception": rig.physics.perception, "robot": robot, "sequence": sequence}


def test_two_simultaneous_requests_cannot_both_use_the_last_use(rig):
    rig.ask()
    rig.cast(rig.vote())
    start, won = threading.Barrier(16), []
    calls = [rig.call(rig.holder) for _ in range(16)]
    from policies.decision.pdp import decide

    def grab(call):
        start.wait()
        seen = rig.gate._cheap(call)
        seen = replace(seen, **known(rig, call))
        decision = decide(call.request, rig.asks.witness(call.request, seen), rig.policies)
        if decision.effect is Effect.PERMIT and rig.asks.consume(decision):
            won.append(decision.approval)

    threads = [threading.Thread(target=grab, args=(call,)) for call in calls]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(won) == 1


def test_a_reserved_use_lapses_and_cannot_be_consumed_late(rig):
    from policies.decision.pdp import decide

    rig.ask()
    rig.cast(rig.vote())

    def reserved():
        call = rig.call(rig.holder)
        seen = replace(rig.gate._cheap(call), **known(rig, call))
        return decide(call.request, rig.asks.witness(call.request, seen), rig.policies)

    first, second = reserved(), reserved()
    assert (first.effect, second.effect) == (Effect.PERMIT, Effect.DEFER)
    rig.clock.advance(5_001)
    rig.pull()
    third = reserved()
    assert third.effect is Effect.PERMIT
    assert not rig.asks.consume(first)
    assert rig.asks.consume(third)
    assert not rig.asks.consume(third)
    rig.asks.release(third.request_id)
    assert reserved().reason is Reason.APPROVAL_USED


def test_a_use_that_another_request_takes_in_between_is_not_given_twice(rig):
    rig.ask()
    rig.cast(rig.vote())
    honest, stolen = rig.asks.consume, []

    def steal(decision):
        if not stolen:
            stolen.append(decision)
            rig.asks._deferrals[rig.ask_id].reserved.clear()
            rig.asks._deferrals[rig.ask_id].used[1] = "another request"
        return honest(decision)

    rig.asks.consume = steal
    answer = rig.go()
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DEFER, Reason.APPROVAL_USED)
    assert rig.sent == []


@pytest.mark.parametrize(
    ("answer", "then"),
    [("approve", (Effect.PERMIT, Reason.PERMITTED)), ("deny", (Effect.DENY, Reason.APPROVAL_DENIED))],
)
def test_an_answer_that_comes_while_a_request_is_judged_is_no_reason_to_ask_again(rig, answer, then):
    rig.ask()
    witness = rig.asks.witness

    def answered_right_after(request, evidence):
        seen = witness(request, evidence)
        person = threading.Thread(target=rig.cast, args=(rig.vote(answer=answer),))
        person.start()
        person.join()
        return seen

    rig.asks.witness = answered_right_after
    late = rig.go()
    assert (late.decision.effect, late.ask.ask_id) == (Effect.DEFER, rig.ask_id)
    rig.asks.witness = witness
    assert len(rig.issuer.asks) == 1
    heard = rig.go()
    assert (heard.decision.effect, heard.decision.reason) == then


def test_a_late_verdict_returns_its_use_on_record_and_the_next_attempt_takes_it(rig):
    slow, late = rig.journal.append, [51]

    class SlowOnce:
        def append(self, kind, body):
            done = slow(kind, body)
            if kind == "decision" and body["decision"]["effect"] == "PERMIT":
                rig.clock.advance(late.pop() if late else 1)
            return done

    rig.build(SlowOnce())
    rig.ask()
    rig.cast(rig.vote())
    answer = rig.go()
    assert (answer.decision.effect, answer.decision.approval.use, len(rig.sent)) == (Effect.PERMIT, 1, 1)
    refused, done = (r["body"] for r in rig.records("outcome"))
    assert (refused["outcome"], refused["returned"]) == ("refused", {"ask_id": rig.ask_id, "use": 1})
    assert "returned" not in done
    assert rig.go().decision.reason is Reason.APPROVAL_USED


async def sent_twice(permit):
    permit.spend(digest=permit.digest, stopped_ms=None)
    permit.spend(digest=permit.digest, stopped_ms=None)


async def refused_unsent(permit):
    raise ActuationRefusedError(Reason.EFFECT_FAILED)


async def boom(permit):
    raise RuntimeError("boom")


@pytest.mark.parametrize(("effect", "returned"), [(sent_twice, False), (refused_unsent, True), (boom, False)])
def test_a_use_comes_back_only_where_nothing_was_sent(rig, effect, returned):
    rig.ask()
    rig.cast(rig.vote())
    asyncio.run(rig.gate.run(rig.call(rig.holder), effect))
    assert ("returned" in rig.records("outcome")[-1]["body"]) is returned
    assert (rig.go().decision.effect is Effect.PERMIT) is returned


def test_a_permit_whose_use_was_returned_can_never_be_spent(rig):
    kept = []

    async def keep(permit):
        kept.append(permit)
        raise ActuationRefusedError(Reason.EFFECT_FAILED)

    rig.ask()
    rig.cast(rig.vote())
    asyncio.run(rig.gate.run(rig.call(rig.holder), keep))
    with pytest.raises(ActuationRefusedError):
        kept[0].spend(digest=kept[0].digest, stopped_ms=None)


def test_a_caller_who_goes_takes_the_use_along(rig):
    rig.ask()
    rig.cast(rig.vote())

    async def scenario():
        begun = asyncio.Event()

        async def slow(_):
            begun.set()
            await asyncio.Event().wait()

        running = asyncio.create_task(rig.gate.run(rig.call(rig.holder), slow))
        await begun.wait()
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running

    asyncio.run(scenario())
    assert rig.go().decision.reason is Reason.APPROVAL_USED


def test_no_room_for_more_questions_denies(rig, monkeypatch):
    monkeypatch.setattr("pep.people.asks.CAPACITY", 1)
    rig.ask()
    other = rig.go(arguments={**MOVE, "speed_rad_s": 0.4})
    assert (other.decision.effect, other.decision.reason) == (Effect.DENY, Reason.ASK_BUDGET_SPENT)
    assert len(rig.issuer.asks) == 1
    assert CAPACITY == 256


# -- sixty ways in which an approval does not count

EVE = Person("eve")


def votes(**changes):
    return lambda rig: rig.cast(rig.vote(**changes))


def then(change):
    """An approval that would count, and then `change`."""

    def spoil(rig):
        rig.cast(rig.vote())
        change(rig)

    return spoil


def world_of(**changes):
    def change(rig):
        rig.physics.answer = replace(rig.physics.answer, **changes)

    return then(change)


def moved(**joints):
    start = list(NEAR.start_urad)
    for name, by in joints.items():
        start[int(name[1:])] += by
    return world_of(start_urad=tuple(start))


def lying(**lie):
    def spoil(rig):
        rig.issuer.answers_lie = lie
        with pytest.raises(PepError):
            rig.cast(rig.vote())

    return spoil


def spoilt(spoil_text):
    def spoil(rig):
        rig.issuer.spoil = spoil_text
        with pytest.raises(PepError):
            rig.cast(rig.vote())

    return spoil


def replayed(rig):
    """An old word of the provider, from before the withdrawal."""
    before = rig.vote()
    rig.issuer.cast(rig.ask_id, before)
    old = []
    rig.issuer.spoil = lambda text: old.append(text) or text
    rig.pull()
    rig.cast(rig.vote(answer="withdraw"))
    rig.issuer.spoil = lambda _: old[0]
    with pytest.raises(PepError):
        rig.pull()


def another_ask(rig):
    """A vote on another ask of the same agent, told under this one."""
    mine = rig.ask_id, rig.text
    other = rig.go(arguments={**MOVE, "speed_rad_s": 0.4}).ask.ask_id
    rig.text = rig.issuer.asks[other]
    vote = rig.vote()
    rig.ask_id, rig.text = mine
    rig.cast(vote)


def disabled(rig):
    rig.registry.people = {k: n for k, n in rig.registry.people.items() if n != "bob"}


def rekeyed(rig):
    others = {k: n for k, n in rig.registry.people.items() if n != "bob"}
    rig.registry.people = {**others, keys.public_raw(keys.generate()): "bob"}


def policy_changed(rig):
    rig.policies = PolicySet("paper-default", 2, rig.policies.policies, Parameters())
    rig.gate._policies = rig.policies


def agents_key(rig):
    rig.registry.people = {**rig.registry.people, keys.public_raw(rig.holder.key): "bob"}
    rig.cast(rig.vote(key=rig.holder.key))


def other_agent(rig):
    rig.cast(rig.vote())
    rig.holder = rig.agent(name="vision")


def new_key(rig):
    rig.cast(rig.vote())
    rig.holder = rig.agent()


def other_sponsor(rig):
    rig.cast(rig.vote())
    old = rig.holder
    from tests.pep.kit import agent

    fresh = keys.generate
    try:
        keys.generate = lambda: old.key
        rig.holder = agent(rig.made, rig.clock.wall_s(), sponsor="bob")
    finally:
        keys.generate = fresh


def unheard(rig):
    """The provider falls silent: its last word grows older than motion may rest on."""
    rig.cast(rig.vote())
    rig.clock.advance(2_001)


def dropped(rig):
    """The provider no longer tells of this ask."""
    rig.cast(rig.vote())
    rig.issuer.asks.pop(rig.ask_id)
    for _ in range(5):
        rig.clock.advance(500)
        rig.pull()


def over(rig):
    rig.cast(rig.vote(not_after=int(rig.clock.wall_s()) + 3))
    rig.clock.advance(4_000)
    rig.pull()


def clock_set_back(rig):
    """Over is over, also when the wall clock is set back."""
    over(rig)
    rig.go()
    rig.clock.wall -= 10


def used_up(rig):
    rig.cast(rig.vote())
    rig.go()
    assert rig.sent
    rig.sent.clear()


def wrong_names(rig):
    rig.cast(rig.vote("carol", approver="bob"))


DEFECTS = {
    # the vote
    "nobody voted": (lambda rig: rig.pull(), "TIER_NEEDS_APPROVAL"),
    "for another ask": (another_ask, "VOTE_NOT_FOR_THIS_ASK"),
    "another ask id": (votes(ask_id="ab" * 16), "VOTE_NOT_FOR_THIS_ASK"),
    "another digest": (votes(ask_digest="ab" * 32), "VOTE_NOT_FOR_THIS_ASK"),
    "another nonce": (votes(nonce="ab" * 16), "VOTE_NOT_FOR_THIS_ASK"),
    "by somebody unregistered": (votes(person=EVE), "STATEMENT_UNTRUSTED"),
    "in the name of an approver": (votes(person=EVE, approver="bob"), "STATEMENT_UNTRUSTED"),
    "by an approver in another's name": (wrong_names, "VOTE_NOT_YOURS"),
    "in an unregistered name": (votes(approver="mallory"), "VOTE_NOT_YOURS"),
    "by an agent's key": (lambda rig: rig.cast(rig.vote(key=rig.holder.key)), "STATEMENT_UNTRUSTED"),
    "by the asking agent's key, registered as a person's": (agents_key, "NOT_PERMITTED"),
    "by the PEP's own key": (lambda rig: rig.cast(rig.vote(key=rig.pep_key)), "STATEMENT_UNTRUSTED"),
    "by the provider's key": (lambda rig: rig.cast(rig.vote(key=rig.made["registry"])), "STATEMENT_UNTRUSTED"),
    "by somebody disabled meanwhile": (then(disabled), "state"),
    "by a key that was replaced meanwhile": (then(rekeyed), "state"),
    "signed before it was asked": (votes(at=1_000), "VOTE_OUT_OF_TIME"),
    "signed in the future": (lambda rig: rig.cast(rig.vote(at=int(rig.clock.wall_s()) + 7)), "VOTE_OUT_OF_TIME"),
    "valid for longer than an hour": (
        lambda rig: rig.cast(rig.vote(not_after=int(rig.clock.wall_s()) + 3_700)),
        "VOTE_OUT_OF_TIME",
    ),
    "over before it begins": (lambda rig: rig.cast(rig.vote(not_after=int(rig.clock.wall_s()))), "VOTE_OUT_OF_TIME"),
    "a denial": (votes(answer="deny"), "APPROVAL_DENIED"),
    "a denial by another": (then(lambda rig: rig.cast(rig.vote("carol", answer="deny"))), "APPROVAL_DENIED"),
    "withdrawn": (then(lambda rig: rig.cast(rig.vote(answer="withdraw"))), "state"),
    "over": (over, "state"),
    "over, and the clock set back": (clock_set_back, "TIER_NEEDS_APPROVAL"),
    "used up": (used_up, "APPROVAL_USED"),
    "a statement of another kind": (lambda rig: rig.cast(rig.text), "STATEMENT_WRONG_KIND"),
    "one bit of it flipped": (lambda rig: rig.cast(rig.vote()[:-8] + "AAAAAAAA"), "STATEMENT_"),
    "no statement": (lambda rig: rig.cast("nonsense"), "STATEMENT_MALFORMED"),
    "not ASCII": (lambda rig: rig.cast("vöte"), "STATEMENT_MALFORMED"),
    # the provider's word
    "to another nonce": (lying(nonce="x" * 32), "TIER_NEEDS_APPROVAL"),
    "for another audience": (lying(audience="http://127.0.0.1:1/mcp"), "TIER_NEEDS_APPROVAL"),
    "of another issuer": (lying(issuer="http://127.0.0.1:1/ztpm"), "TIER_NEEDS_APPROVAL"),
    "malformed": (spoilt(lambda text: text + "."), "TIER_NEEDS_APPROVAL"),
    "empty": (spoilt(lambda _: ""), "TIER_NEEDS_APPROVAL"),
    "oversized": (spoilt(lambda text: text + "A" * 300_000), "TIER_NEEDS_APPROVAL"),
    "replayed": (replayed, "state"),
    "too old": (unheard, "age_ms"),
    "no longer told": (dropped, "age_ms"),
    # the world and the request
    "another policy": (then(policy_changed), "policy_digest"),
    "another model": (world_of(model_digest="1d" * 32), "model_digest"),
    "index 51 higher": (world_of(index_milli=2_551), "index_milli"),
    "a lower tier": (world_of(tier=Tier(2), index_milli=1_900), None),
    "a higher tier": (world_of(tier=Tier(4)), "ABOVE_CEILING"),
    "start moved 3 mrad": (moved(q1=3_000), "start_urad"),
    "start moved 3 mrad back": (moved(q5=-3_000), "start_urad"),
    "a second person": (world_of(contributions=(PERSON, BOX, replace(PERSON, object="erin"))), "contributors"),
    "another person": (world_of(contributions=(replace(PERSON, object="erin"),)), "contributors"),
    "a new object": (world_of(contributions=(PERSON, BOX, replace(BOX, object="vase"))), "contributors"),
    "a known object in another way": (world_of(contributions=(PERSON, replace(BOX, kind="fragile"))), "contributors"),
    "perception went stale": (world_of(perception="stale"), "reasons"),
    "perception went missing": (world_of(perception="missing"), "reasons"),
    "trust fell meanwhile": (then(lambda rig: rig.registry.trust.update(robotic=500)), "reasons"),
    "a violation": (world_of(violations=("zone",)), "PHYSICS_VIOLATION"),
    "too fast": (world_of(tcp_speed_um_s=250_001), "APPROVED_TOO_FAST"),
    "too hard a contact": (world_of(contact_permille=1_001), "APPROVED_TOO_FAST"),
    "revoked meanwhile": (then(lambda rig: rig.feed.revoke("agent", "robotic")), "REVOKED"),
    "another agent": (other_agent, "TIER_NEEDS_APPROVAL"),
    "the same agent with another key": (new_key, "TIER_NEEDS_APPROVAL"),
    "another sponsor": (other_sponsor, "sponsor"),
}


def shows(rig, why):
    """The journal says why: in the last decision, or in an incident."""
    last = rig.decisions()[-1]["decision"]
    said = [f["reason"] for f in last["findings"]]
    said += [d["what"] for f in last["findings"] for d in f["detail"].get("differs", ())]
    return any(word.startswith(why) for word in [*said, *rig.faults()])


@pytest.mark.parametrize("name", [name for name, (_, why) in DEFECTS.items() if why is not None])
def test_a_defective_approval_moves_nothing_and_the_journal_says_why(rig, name):
    spoil, why = DEFECTS[name]
    rig.ask()
    spoil(rig)
    answer = rig.go()
    assert answer.decision.effect in {Effect.DEFER, Effect.DENY}
    assert rig.sent == []
    assert shows(rig, why), (rig.decisions()[-1]["decision"], rig.faults())


def test_a_milder_world_needs_no_approval_and_consumes_none(rig):
    """The one change of the table that permits: by itself, and not because people said so."""
    rig.ask()
    DEFECTS["a lower tier"][0](rig)
    answer = rig.go()
    assert (answer.decision.effect, answer.decision.approval) == (Effect.PERMIT, None)


def test_sees_clear_is_wanted_of_every_approver_in_an_unseen_cell(rig):
    rig.physics.answer = reading(3, 3_000, perception="stale", perception_age_ms=900)
    rig.ask()
    rig.cast(rig.vote())
    answer = rig.go()
    assert (answer.decision.reason, rig.sent) == (Reason.APPROVAL_NOT_USABLE, [])
    assert shows(rig, "sees_clear")


def opened(**changes):
    """Two approvals that would count, and then an opening in place of the one that was named."""

    def spoil(rig):
        rig.cast(rig.vote("alice"), rig.vote("bob"))
        rig.open(**changes)

    return spoil


def twice(rig):
    rig.cast(rig.vote("bob"), rig.vote("bob", uses=2))


def two_keys(rig):
    second = keys.generate()
    rig.registry.people = {**rig.registry.people, keys.public_raw(second): "bob"}
    rig.cast(rig.vote("bob"), rig.vote("bob", key=second))


def closed(rig):
    rig.cast(rig.vote("alice"), rig.vote("bob"))
    rig.issuer.openings = []
    rig.pull()


def opener_gone(rig):
    rig.cast(rig.vote("alice"), rig.vote("bob"))
    rig.registry.people = {k: n for k, n in rig.registry.people.items() if n != "carol"}


def opening_used_elsewhere(rig):
    """Another act has taken the one use of the opening."""
    rig.cast(rig.vote("alice"), rig.vote("bob"))
    rig.asks._leaves.recover(rig.opening_id, "another request")


CRITICAL = {
    "one of two": (lambda rig: rig.cast(rig.vote("bob")), "TIER_SAFETY_CRITICAL"),
    "the sponsor alone": (lambda rig: rig.cast(rig.vote("alice")), "TIER_SAFETY_CRITICAL"),
    "one person twice": (twice, "TIER_SAFETY_CRITICAL"),
    "one person with two keys": (two_keys, "TIER_SAFETY_CRITICAL"),
    "the second by somebody unregistered": (
        lambda rig: rig.cast(rig.vote("bob"), rig.vote(EVE)),
        "STATEMENT_UNTRUSTED",
    ),
    "one of two withdrawn": (
        lambda rig: rig.cast(rig.vote("alice"), rig.vote("bob"), rig.vote("bob", answer="withdraw")),
        "state",
    ),
    "one of two denies": (lambda rig: rig.cast(rig.vote("alice"), rig.vote("bob", answer="deny")), "APPROVAL_DENIED"),
    "opening withdrawn": (closed, "TIER_SAFETY_CRITICAL"),
    "another opening": (opened(), "opening"),
    "opening of another agent": (opened(agent="vision"), "TIER_SAFETY_CRITICAL"),
    "opening of another operation": (opened(operation="gripper_move"), "TIER_SAFETY_CRITICAL"),
    "opening of another object": (opened(object="ur5e"), "TIER_SAFETY_CRITICAL"),
    "opening of another audience": (opened(audience="http://127.0.0.1:1/mcp"), "OPENING_NOT_FOR_US"),
    "opening by nobody registered": (opened(key=keys.generate()), "STATEMENT_UNTRUSTED"),
    "opening in another's name": (opened(opener="bob"), "VOTE_NOT_YOURS"),
    "opening not begun": (opened(not_before=4_000_000_000, not_after=4_000_000_001), "TIER_SAFETY_CRITICAL"),
    "opening over": (opened(not_before=1, not_after=2), "TIER_SAFETY_CRITICAL"),
    "opening used up elsewhere": (opening_used_elsewhere, "TIER_SAFETY_CRITICAL"),
    "opener no approver any more": (opener_gone, "TIER_SAFETY_CRITICAL"),
}


@pytest.mark.parametrize("name", CRITICAL)
def test_a_defective_dual_authorisation_moves_nothing(four, name):
    spoil, why = CRITICAL[name]
    four.ask()
    four.opening_id = four.asks._deferrals[four.ask_id].question.opening_id
    spoil(four)
    answer = four.go()
    assert answer.decision.effect in {Effect.DEFER, Effect.DENY}
    assert four.sent == []
    assert shows(four, why), (four.decisions()[-1]["decision"], four.faults())


def test_a_flood_of_rejected_votes_is_recorded_boundedly(rig):
    rig.ask()
    for _ in range(4):
        rig.issuer.votes[rig.ask_id] = [rig.vote(EVE, nonce=secrets.token_hex(16)) for _ in range(16)]
        rig.pull()
    assert len(rig.faults()) == 16
