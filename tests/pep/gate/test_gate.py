"""The gate on recorded evidence: which step comes when, and that nothing happens unless all of them agree."""

import asyncio
import threading
from dataclasses import replace
from types import SimpleNamespace

import pytest
import rfc8785
from capabilities.values.scope import Grant, Tier
from capabilities.values.units import Quantity, Unit
from pep.base.errors import ActuationRefusedError, JournalError, PepFault
from pep.base.operations import MOVE_JOINT
from pep.gate.gate import ATTEMPTS, EffectResult
from pep.journal.file_journal import record_hash
from pep.world.sequence import Sequence
from policies.evidence.evidence import NOT_COLLECTED, ImpactFault, PerceptionReading, SensorReading
from policies.evidence.model import Effect, Obligation, ObligationKind
from policies.words.reason_table import Reason
from tests.pep.kit import MOVE, FailingJournal, Rig, full_scope, reading

from pep.gate import gate as gate_module


@pytest.fixture
def rig(tmp_path):
    rig = Rig(tmp_path)
    yield rig
    rig.gate.close()
    rig.journal.close()


def run(rig, call, effect=None):
    return asyncio.run(rig.gate.run(call, effect or rig.effect))


def test_permit_moves_and_is_recorded_with_its_outcome(rig):
    answer = run(rig, rig.call(rig.agent()))
    assert (answer.decision.effect, answer.decision.reason, answer.decision.tier) == (
        Effect.PERMIT,
        Reason.PERMITTED,
        Tier.REVERSIBLE,
    )
    assert len(rig.sent) == 1
    assert [r["kind"] for r in rig.records()] == ["decision", "outcome"]
    decision, outcome = rig.records()
    assert outcome["body"]["decision"] == outcome["prev"]
    assert outcome["body"]["outcome"] == "done"
    assert decision["body"]["request"]["id"] == rig.sent[0]


def test_the_record_is_durable_before_the_effect_begins(rig):
    seen = []
    rig.before_effect = lambda: seen.extend(r["body"]["decision"]["effect"] for r in rig.records("decision"))
    run(rig, rig.call(rig.agent()))
    assert seen == ["PERMIT"]


def test_no_record_no_effect(rig):
    rig.build(FailingJournal(rig.journal))
    answer = run(rig, rig.call(rig.agent()))
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.RECORD_FAILED)
    assert rig.sent == []
    assert rig.slot.holder is None


@pytest.mark.parametrize(
    ("perception", "tier", "sighted"), [("fresh", 1, True), ("stale", 3, False), ("missing", 3, False)]
)
def test_a_permit_says_what_the_watch_has_to_hold(rig, monkeypatch, perception, tier, sighted):
    # Over the whole of its tier the decision would have been the same.
    # What a person approved unseen is permitted, too; here the decision stands in for the person.
    honest = gate_module.decide
    permitted = {"effect": Effect.PERMIT, "reason": Reason.PERMITTED, "lifetime_ms": 50}
    monkeypatch.setattr(gate_module, "decide", lambda *a: replace(honest(*a), **permitted))
    rig.physics.answer = reading(index_milli=940, perception=perception)
    given = []

    async def effect(permit):
        given.append(permit)
        return await rig.effect(permit)

    call = rig.call(rig.agent())
    run(rig, call, effect)
    (permit,) = given
    assert (permit.request, permit.index_milli, permit.sighted) == (call.request, 1_000 * tier, sighted)


SPEED = Quantity("speed", Unit.MICRORADIAN_PER_SECOND, 0)


@pytest.mark.parametrize(
    "obligation",
    [
        *(Obligation(k) for k in (ObligationKind.NOTIFY, ObligationKind.REATTEST, ObligationKind.LOWER_TRUST)),
        Obligation(ObligationKind.CLAMP, SPEED),
        Obligation(ObligationKind.CLAMP, replace(SPEED, unit=Unit.MICROMETRE_PER_SECOND, value=10**9)),
        Obligation(ObligationKind.CLAMP, replace(SPEED, name="force", value=10**9)),
    ],
    ids=lambda o: f"{o.kind} {o.at_most.name} {o.at_most.unit}" if o.at_most else str(o.kind),
)
def test_a_permit_with_an_obligation_that_is_not_fulfilled_here_is_void(rig, monkeypatch, obligation):
    """The obligation is unknown here, for a lower speed, or for a parameter that the request lacks."""
    honest = gate_module.decide
    monkeypatch.setattr(
        gate_module, "decide", lambda *a: replace(d := honest(*a), obligations=(*d.obligations, obligation))
    )
    answer = run(rig, rig.call(rig.agent()))
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.OBLIGATION_UNMET)
    assert answer.decision.findings[0].detail == {"obligation": str(obligation.kind)}
    assert rig.sent == []
    assert [r["body"]["decision"]["effect"] for r in rig.records("decision")] == ["DENY"]
    assert rig.slot.holder is None


def test_a_permit_says_up_to_which_speed_it_is_good(rig):
    call = rig.call(rig.agent())
    answer = run(rig, call)
    (clamp,) = (o for o in answer.decision.obligations if o.kind is ObligationKind.CLAMP)
    assert clamp.at_most in call.request.values
    assert clamp.at_most.name == "speed"


def test_what_the_watch_saw_is_in_the_record(rig):
    async def watched(permit):
        permit.spend(digest=permit.digest, stopped_ms=None)
        assert (permit.index_milli, permit.sighted) == (1_000, True)
        permit.watched = {"outcome": "world_changed", "q_at_stop_rad": (0.0, 1.0)}
        return EffectResult(value={"outcome": "world_changed"})

    run(rig, rig.call(rig.agent()), watched)
    (outcome,) = rig.records("outcome")
    assert outcome["body"]["watch"] == {"outcome": "world_changed", "q_at_stop_rad": [0.0, 1.0]}


def test_reading_needs_no_physics(rig):
    answer = run(rig, rig.call(rig.agent(), "read_state"), lambda permit: _done())
    assert answer.decision.effect is Effect.PERMIT
    assert rig.physics.asked == 0
    assert rig.records("decision")[0]["body"]["evidence"]["impact"] == "not collected"


async def _done():
    return EffectResult(value={})


CHEAP = {
    "revoked": (lambda rig, holder: rig.feed.revoke("hop", holder.hop_id), Reason.REVOKED),
    "stale": (lambda rig, _: setattr(rig.feed, "age_ms", 2_001), Reason.REVOCATION_VIEW_STALE),
    "expired": (lambda rig, _: rig.clock.advance(700_000), Reason.EXPIRED),
    "tool_unknown": (lambda rig, _: rig.registry.tools.pop("move_joint"), Reason.TOOL_UNKNOWN),
}


@pytest.mark.parametrize("name", CHEAP)
def test_physics_is_never_computed_for_what_cheap_evidence_denies(rig, name):
    change, reason = CHEAP[name]
    holder = rig.agent()
    credentials = rig.credentials(holder)
    change(rig, holder)
    answer = run(rig, rig.call(holder, credentials=credentials))
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, reason)
    assert rig.physics.asked == 0
    evidence = rig.records("decision")[0]["body"]["evidence"]
    assert evidence["impact"] == "not collected"
    assert evidence["trust"] == "not collected"
    assert rig.sent == []


def test_changed_definition_is_denied_before_physics(rig):
    answer = run(rig, rig.call(rig.agent(), digest="e" * 64))
    assert answer.decision.reason is Reason.TOOL_DEFINITION_CHANGED
    assert rig.physics.asked == 0


def test_limit_of_the_token_names_who_set_it(rig):
    holder = rig.agent(scope=full_scope(rig.clock.wall_s(), speed_high=300_000))
    answer = run(rig, rig.call(holder))
    assert answer.decision.reason is Reason.LIMIT_EXCEEDED_BY_REQUEST
    detail = answer.decision.findings[0].detail
    assert (detail["parameter"], detail["value"], detail["nearest_permitted"]) == ("speed", 500_000, 300_000)
    assert detail["set_by"]["agent"] == "robotic"
    assert rig.physics.asked == 0


def test_limit_of_the_robot_holds_whatever_the_token_says(rig):
    answer = run(rig, rig.call(rig.agent(), arguments={**MOVE, "q_rad": [6.4, 0.0, 0.0, 0.0, 0.0, 0.0]}))
    assert answer.decision.reason is Reason.ROBOT_LIMIT
    assert rig.physics.asked == 0


@pytest.mark.parametrize(
    ("impact", "effect", "reason"),
    [
        (reading(2, 1_500), Effect.PERMIT, Reason.PERMITTED),
        (reading(3, 2_500), Effect.DEFER, Reason.TIER_NEEDS_APPROVAL),
        (reading(4, 3_500), Effect.DENY, Reason.ABOVE_CEILING),
        (reading(1, 900, violations=("person",)), Effect.DENY, Reason.PHYSICS_VIOLATION),
        (ImpactFault("PERCEPTION_INVALID"), Effect.DENY, Reason.PERCEPTION_INVALID),
        (ImpactFault("PHYSICS_FAULT"), Effect.DENY, Reason.PHYSICS_FAULT),
    ],
)
def test_physics_selects_the_effect(rig, impact, effect, reason):
    rig.physics.answer = impact
    answer = run(rig, rig.call(rig.agent()))
    assert (answer.decision.effect, answer.decision.reason) == (effect, reason)
    assert bool(rig.sent) == (effect is Effect.PERMIT)


def test_untrusted_agent_is_deferred_at_tier_2(rig):
    rig.physics.answer = reading(2, 1_500)
    rig.registry.trust = {"robotic": 650}
    answer = run(rig, rig.call(rig.agent()))
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DEFER, Reason.TRUST_TOO_LOW)
    assert answer.ask is not None
    assert rig.sent == []


def test_physics_that_raises_is_denied_and_recorded(rig):
    rig.physics.answer = RuntimeError("boom")
    answer = run(rig, rig.call(rig.agent()))
    assert answer.decision.effect is Effect.DENY
    assert rig.sent == []
    assert rig.records("decision")[0]["body"]["decision"]["effect"] == "DENY"
    assert rig.slot.holder is None


class Broken:
    """A row whose limits break."""

    def __init__(self, row):
        self._row = row

    def __getattr__(self, name):
        return getattr(self._row, name)

    def refuse(self, request):
        raise RuntimeError("boom")


@pytest.mark.parametrize("broken", ["registry", "limits", "feed"])
def test_any_exception_on_the_way_is_denied(rig, broken, monkeypatch):
    def boom(*_, **__):
        raise RuntimeError("boom")

    call = rig.call(rig.agent())
    match broken:
        case "registry":
            monkeypatch.setattr(rig.registry, "trust_permille", boom)
        case "limits":
            call = replace(call, operation=Broken(MOVE_JOINT))
        case "feed":
            monkeypatch.setattr(rig.feed, "view", boom)
    answer = run(rig, call)
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.EVIDENCE_MISSING)
    assert rig.sent == []
    assert rig.records("decision")[0]["body"]["evidence"]["impact"] == "not collected"


def test_revocation_during_physics_denies(rig):
    holder = rig.agent()
    rig.physics.before = lambda: rig.feed.revoke("agent", "robotic")
    answer = run(rig, rig.call(holder))
    assert answer.decision.reason is Reason.REVOKED
    assert rig.sent == []


def test_a_record_that_outlasts_the_verdict_is_decided_afresh_then_denied(rig):
    slow = rig.journal.append

    class Slow:
        def append(self, kind, body):
            done = slow(kind, body)
            if kind == "decision":
                rig.clock.advance(51)
            return done

    rig.build(Slow())
    answer = run(rig, rig.call(rig.agent()))
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.VERDICT_EXPIRED)
    assert rig.sent == []
    assert rig.physics.asked == ATTEMPTS
    assert [r["body"]["reason"] for r in rig.records("outcome")] == ["VERDICT_EXPIRED"] * ATTEMPTS
    assert [r["body"]["decision"]["effect"] for r in rig.records("decision")] == ["PERMIT"] * ATTEMPTS + ["DENY"]


def test_a_record_that_is_late_once_is_no_denial(rig):
    slow, late = rig.journal.append, [51]

    class SlowOnce:
        def append(self, kind, body):
            done = slow(kind, body)
            if kind == "decision":
                rig.clock.advance(late.pop() if late else 1)
            return done

    rig.build(SlowOnce())
    assert run(rig, rig.call(rig.agent())).decision.effect is Effect.PERMIT
    assert len(rig.sent) == 1
    assert rig.physics.asked == 2


def test_an_effect_that_comes_too_late_is_refused(rig):
    rig.before_effect = lambda: rig.clock.advance(51)
    answer = run(rig, rig.call(rig.agent()))
    assert answer.decision.reason is Reason.VERDICT_EXPIRED
    assert rig.sent == []
    assert rig.records("outcome")[0]["body"]["outcome"] == "refused"


def test_another_digest_than_decided_is_refused(rig):
    async def other(permit):
        permit.spend(digest="0" * 64, stopped_ms=None)
        rig.sent.append("never")

    answer = run(rig, rig.call(rig.agent()), other)
    assert answer.decision.reason is Reason.NOT_WHAT_WAS_DECIDED
    assert rig.sent == []


def test_a_permit_is_spent_once(rig):
    async def twice(permit):
        permit.spend(digest=permit.digest, stopped_ms=None)
        permit.spend(digest=permit.digest, stopped_ms=None)

    assert run(rig, rig.call(rig.agent()), twice).decision.reason is Reason.NOT_WHAT_WAS_DECIDED


def test_one_winner_among_many_threads(rig):
    won = []

    async def race(permit):
        start = threading.Barrier(16)

        def grab():
            start.wait()
            try:
                permit.spend(digest=permit.digest, stopped_ms=None)
                won.append(1)
            except ActuationRefusedError:
                pass

        threads = [threading.Thread(target=grab) for _ in range(16)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return EffectResult(value={})

    run(rig, rig.call(rig.agent()), race)
    assert len(won) == 1


def test_a_stop_after_the_request_voids_its_permit(rig):
    async def stopped(permit):
        permit.spend(digest=permit.digest, stopped_ms=permit.since_ms + 1)

    assert run(rig, rig.call(rig.agent()), stopped).decision.reason is Reason.VERDICT_EXPIRED


def test_an_effect_that_raises_has_an_outcome(rig):
    async def boom(_):
        raise RuntimeError("boom")

    answer = run(rig, rig.call(rig.agent()), boom)
    assert answer.decision.reason is Reason.EFFECT_FAILED
    assert rig.records("outcome")[0]["body"]["outcome"] == "failed"


def test_a_new_motion_during_an_unfinished_one_is_busy(rig):
    async def both():
        begun, go_on = asyncio.Event(), asyncio.Event()

        async def slow(permit):
            begun.set()
            await go_on.wait()
            return await rig.effect(permit)

        first = asyncio.create_task(rig.gate.run(rig.call(holder), slow))
        await begun.wait()
        asked = rig.physics.asked
        second = await rig.gate.run(rig.call(holder), rig.effect)
        assert rig.physics.asked == asked
        look = await rig.gate.run(rig.call(holder, "read_state"), lambda _: _done())
        go_on.set()
        return await first, second, look

    holder = rig.agent()
    first, second, look = asyncio.run(both())
    assert first.decision.effect is Effect.PERMIT
    assert (second.decision.effect, second.decision.reason) == (Effect.DENY, Reason.BUSY)
    assert look.decision.effect is Effect.PERMIT
    assert len(rig.sent) == 1


def test_a_cancelled_effect_has_an_outcome_and_frees_the_slot(rig):
    async def cancelled():
        begun = asyncio.Event()

        async def slow(_):
            begun.set()
            await asyncio.Event().wait()

        task = asyncio.create_task(rig.gate.run(rig.call(rig.agent()), slow))
        await begun.wait()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(cancelled())
    rig.gate.close()
    assert rig.records("outcome")[0]["body"]["outcome"] == "cancelled"
    assert rig.slot.holder is None


def test_ceiling_denies_and_asks_nobody(rig):
    holder = rig.agent(scope=full_scope(rig.clock.wall_s(), ceiling=Tier.CONSEQUENTIAL))
    rig.physics.answer = reading(3, 2_500)
    answer = run(rig, rig.call(holder))
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.ABOVE_CEILING)
    assert answer.ask is None
    assert "ask" not in rig.records("decision")[0]["body"]


def test_a_deferral_is_asked_once_and_silence_denies(rig):
    rig.physics.answer = reading(3, 2_500)
    holder = rig.agent()
    first = run(rig, rig.call(holder))
    again = run(rig, rig.call(holder))
    assert first.decision.effect is again.decision.effect is Effect.DEFER
    assert first.ask.ask_id == again.ask.ask_id
    rig.clock.advance(59_999)
    assert rig.asks.expire() == ()
    rig.clock.advance(1)
    assert [ask.ask_id for ask in rig.asks.expire()] == [first.ask.ask_id]
    (expired,) = rig.records("ask-expired")
    assert expired["body"]["reason"] == "APPROVAL_TIMEOUT"
    late = run(rig, rig.call(holder))
    assert (late.decision.effect, late.decision.reason) == (Effect.DENY, Reason.APPROVAL_TIMEOUT)
    assert late.decision.tier is Tier.HIGH_CONSEQUENCE
    anew = run(rig, rig.call(holder))
    assert anew.decision.effect is Effect.DEFER
    assert anew.ask.ask_id != first.ask.ask_id
    assert rig.sent == []


def test_another_agent_or_request_is_another_question(rig):
    rig.physics.answer = reading(3, 2_500)
    one, two = rig.agent(), rig.agent(name="vision")
    asked = [
        run(rig, rig.call(one)),
        run(rig, rig.call(two)),
        run(rig, rig.call(one, arguments={**MOVE, "speed_rad_s": 0.4})),
    ]
    assert len({answer.ask.ask_id for answer in asked}) == 3


def test_silence_about_one_question_is_no_answer_to_another(rig):
    holder = rig.agent()
    rig.registry.trust = {"robotic": 500}
    rig.physics.answer = reading(2, 1_500)
    glass = run(rig, rig.call(holder))
    rig.clock.advance(60_000)
    rig.asks.expire()
    rig.physics.answer = reading(3, 2_500)
    person = run(rig, rig.call(holder))
    assert (glass.decision.reason, person.decision.reason) == (Reason.TRUST_TOO_LOW, Reason.TIER_NEEDS_APPROVAL)
    assert person.decision.effect is Effect.DEFER


def test_an_expiry_that_cannot_be_recorded_stays_open(rig):
    rig.build(FailingJournal(rig.journal, fail_from=1))
    rig.physics.answer = reading(3, 2_500)
    run(rig, rig.call(rig.agent()))
    rig.clock.advance(60_000)
    for _ in range(2):
        with pytest.raises(JournalError) as raised:
            rig.asks.expire()
        assert raised.value.code is PepFault.JOURNAL_BROKEN


def test_a_question_is_asked_beside_the_event_loop(rig):
    asked, consult = [], rig.asks.consult

    def remember(**question):
        asked.append(threading.current_thread())
        return consult(**question)

    rig.asks.consult = remember
    rig.physics.answer = reading(3, 2_500)
    assert run(rig, rig.call(rig.agent())).decision.effect is Effect.DEFER
    assert threading.main_thread() not in asked
    assert len(asked) == 1


def test_the_policies_say_what_is_physical_and_how_old_a_view_may_be(rig):
    # "impact" no longer leaves reading out: it has a physical dependency now, and the short lease.
    impact = next(policy for policy in rig.policies.policies if policy.id == "impact")
    wider = replace(impact, object=replace(impact.object, without=frozenset({"stop"})))
    others = tuple(policy for policy in rig.policies.policies if policy.id != "impact")
    rig.policies = replace(rig.policies, policies=(*others, wider))
    rig.build()
    holder = rig.agent()
    assert run(rig, rig.call(holder, "read_state"), lambda permit: _done()).decision.effect is Effect.PERMIT
    assert rig.physics.asked == 1
    credentials = rig.credentials(holder)
    rig.feed.age_ms = 2_001
    late = run(rig, rig.call(holder, "read_state", credentials=credentials), lambda permit: _done())
    assert late.decision.reason is Reason.REVOCATION_VIEW_STALE


def test_a_caller_who_goes_while_the_decision_is_recorded_leaves_an_outcome_behind_it(rig):
    writing, enough = threading.Event(), threading.Event()

    class Slow:
        def append(self, kind, body):
            if kind == "decision":
                writing.set()
                enough.wait(10)
            return rig.journal.append(kind, body)

    rig.build(Slow())

    async def scenario():
        running = asyncio.create_task(rig.gate.run(rig.call(rig.agent()), rig.effect))
        await asyncio.to_thread(writing.wait, 10)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running

    asyncio.run(scenario())
    enough.set()
    rig.gate.close()
    decision, outcome = rig.records()
    assert (decision["kind"], outcome["body"]["outcome"]) == ("decision", "cancelled")
    assert outcome["body"]["decision"] == outcome["prev"]
    assert rig.sent == []


def test_what_every_hop_lets_the_arm_touch_reaches_physics(rig):
    scope = full_scope(rig.clock.wall_s())
    grants = tuple(sorted((*scope.grants, Grant("table", "touch")), key=lambda g: (g.object, g.operation)))
    answer = run(rig, rig.call(rig.agent(scope=replace(scope, grants=grants))))
    assert answer.decision.effect is Effect.PERMIT
    assert rig.physics.touch == frozenset({"table"})
    run(rig, rig.call(rig.agent()))
    assert rig.physics.touch == frozenset()


@pytest.mark.parametrize(
    ("perception", "reason"),
    [
        (PerceptionReading((SensorReading("camera-1", "invalid", "UNTRUSTED", 10),)), Reason.PERCEPTION_INVALID),
        (NOT_COLLECTED, Reason.EVIDENCE_MISSING),
    ],
)
def test_nothing_moves_on_an_invalid_view_or_without_any_word_about_it(rig, perception, reason):
    rig.physics.perception = perception
    decision = run(rig, rig.call(rig.agent())).decision
    assert (decision.effect, decision.reason, decision.primitive) == (Effect.DENY, reason, "CII-4")
    assert rig.sent == []


NOT_READY = {
    "safety_stop": ({"safety_mode": 3}, Reason.ROBOT_SAFETY_STOP),
    "not_running": ({"robot_mode": 5}, Reason.ROBOT_NOT_RUNNING),
    "local": ({"remote_control": False}, Reason.ROBOT_NOT_REMOTE),
    "not_said": ({"remote_control": None}, Reason.ROBOT_NOT_REMOTE),
    "shared": ({"exclusive": False}, Reason.ROBOT_NOT_EXCLUSIVE),
    "payload": ({"payload_g": 1_001}, Reason.PAYLOAD_MISMATCH),
    "payload_unknown": ({"expected_payload_g": None}, Reason.PAYLOAD_MISMATCH),
    "frames": ({"frames_match": False}, Reason.FRAMES_MISMATCH),
}


@pytest.mark.parametrize("name", NOT_READY)
def test_a_robot_that_is_not_ready_is_asked_for_no_physics(rig, name):
    changes, reason = NOT_READY[name]
    rig.readiness.answer = replace(rig.readiness.answer, **changes)
    answer = run(rig, rig.call(rig.agent()))
    assert (answer.decision.effect, answer.decision.reason, answer.decision.primitive) == (
        Effect.DENY,
        reason,
        "TEA-5",
    )
    assert (rig.sent, rig.physics.asked, rig.slot.holder) == ([], 0, None)
    (key,) = changes
    assert rig.records("decision")[0]["body"]["evidence"]["robot"][key] == changes[key]


def test_who_has_not_the_arm_takes_no_slot_from_who_has(rig):
    rig.readiness.answer = replace(rig.readiness.answer, exclusive=False)
    assert rig.slot.reserve("another")
    rig.slot.reserve = None
    decision = run(rig, rig.call(rig.agent())).decision
    assert (decision.effect, decision.reason) == (Effect.DENY, Reason.ROBOT_NOT_EXCLUSIVE)
    assert rig.slot.holder == "another"


def test_others_who_command_the_same_robot_have_another_readiness_and_one_of_everything_else(rig):
    others = SimpleNamespace(reading=lambda: replace(rig.readiness.answer, exclusive=False))
    denied = run(rig, replace(rig.call(rig.agent()), readiness=others)).decision
    assert denied.reason is Reason.ROBOT_NOT_EXCLUSIVE
    assert run(rig, rig.call(rig.agent())).decision.effect is Effect.PERMIT
    assert [row["body"]["decision"]["reason"] for row in rig.records("decision")] == [denied.reason, Reason.PERMITTED]


def test_reading_and_stopping_ask_for_no_ready_robot(rig):
    rig.readiness.answer = replace(rig.readiness.answer, safety_mode=3, exclusive=False)
    assert run(rig, rig.call(rig.agent(), "read_state"), lambda permit: _done()).decision.effect is Effect.PERMIT
    assert rig.records("decision")[0]["body"]["evidence"]["robot"] == "not collected"


def test_a_policy_that_does_not_ask_for_readiness_gets_its_physics(rig):
    rig.readiness.answer = replace(rig.readiness.answer, exclusive=False)
    kept = tuple(policy for policy in rig.policies.policies if policy.id != "readiness")
    rig.policies = replace(rig.policies, policies=kept)
    rig.build()
    assert run(rig, rig.call(rig.agent())).decision.effect is Effect.PERMIT
    assert rig.physics.asked == 1


def asked_of_the_policies(rig, monkeypatch):
    """Evidence that the policies were asked about, in order."""
    asked, honest = [], gate_module.decide
    monkeypatch.setattr(gate_module, "decide", lambda *a: (asked.append(a[1]), honest(*a))[1])
    return asked


def test_the_policies_are_asked_once_for_each_piece_of_new_evidence(rig, monkeypatch):
    asked = asked_of_the_policies(rig, monkeypatch)
    assert run(rig, rig.call(rig.agent())).decision.effect is Effect.PERMIT
    ready, whole = asked
    assert (ready.robot, ready.impact) == (rig.readiness.answer, NOT_COLLECTED)
    assert whole.impact == rig.physics.answer


@pytest.mark.parametrize("case", ["busy", "not ready", "not ours", "a reading", "no grant"])
def test_nothing_is_asked_twice_on_the_way_to_an_early_answer(rig, monkeypatch, case):
    call = rig.call(rig.agent(scope=full_scope(rig.clock.wall_s(), speed_high=1) if case == "no grant" else None))
    if case == "busy":
        assert rig.slot.reserve("another")
    elif case == "not ready":
        rig.readiness.answer = replace(rig.readiness.answer, safety_mode=3)
    elif case == "not ours":
        rig.readiness.answer = replace(rig.readiness.answer, exclusive=False)
    elif case == "a reading":
        call = rig.call(rig.agent(), "read_state")
    asked = asked_of_the_policies(rig, monkeypatch)
    asyncio.run(rig.gate.run(call, rig.effect))
    assert len(asked) == 1
    assert rig.physics.asked == 0


def test_a_readiness_that_breaks_denies(rig):
    def broken():
        raise RuntimeError("boom")

    rig.readiness.reading = broken
    answer = run(rig, rig.call(rig.agent()))
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.EVIDENCE_MISSING)
    assert rig.sent == []


def test_an_outcome_that_cannot_be_recorded_denies_nothing_that_has_happened(rig):
    rig.build(FailingJournal(rig.journal, fail_from=1))
    answer = run(rig, rig.call(rig.agent()))
    assert (answer.decision.effect, answer.recorded) == (Effect.PERMIT, False)
    assert len(rig.sent) == 1
    assert answer.result is not None


def test_a_caller_who_goes_while_the_outcome_is_recorded_leaves_one_outcome(rig):
    writing, go_on, append = threading.Event(), threading.Event(), rig.journal.append

    def slow(kind, body):
        if kind == "outcome":
            writing.set()
            assert go_on.wait(10)
        return append(kind, body)

    rig.journal.append = slow

    async def scenario():
        running = asyncio.create_task(rig.gate.run(rig.call(rig.agent()), lambda permit: _done()))
        while not writing.is_set():
            await asyncio.sleep(0.005)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        go_on.set()

    asyncio.run(scenario())
    rig.gate.close()
    outcomes = [record["body"]["outcome"] for record in rig.records("outcome")]
    assert outcomes == ["done"]


@pytest.mark.parametrize(
    ("outcome", "failed", "effect", "reason"),
    [
        ("reached", False, Effect.DENY, Reason.SEQUENCE_DRIFT),
        ("authority_lost", False, Effect.PERMIT, Reason.PERMITTED),
        ("reached", True, Effect.PERMIT, Reason.PERMITTED),
    ],
)
def test_only_an_arm_that_arrived_is_known_to_stand_at_its_target(rig, outcome, failed, effect, reason):
    """The arm of the rig does not move: after a motion that arrived it is not where it should be."""
    rig.gate._robot = replace(rig.gate._robot, sequence=Sequence(rig.clock))

    async def ends(permit):
        return EffectResult({"outcome": outcome}, failed=failed)

    run(rig, rig.call(rig.agent()), ends)
    rig.clock.advance(60_000)
    rig.feed.age_ms = 0
    decision = run(rig, rig.call(rig.agent())).decision
    assert (decision.effect, decision.reason) == (effect, reason)


def test_who_reads_the_state_asks_from_there(rig):
    rig.gate._robot = replace(rig.gate._robot, sequence=Sequence(rig.clock))

    async def arrives(permit):
        return EffectResult({"outcome": "reached"})

    agent = rig.agent()
    run(rig, rig.call(agent), arrives)
    assert run(rig, rig.call(agent)).decision.reason is Reason.SEQUENCE_DRIFT
    assert run(rig, rig.call(agent, "read_state")).decision.effect is Effect.PERMIT
    assert run(rig, rig.call(agent)).decision.effect is Effect.PERMIT


@pytest.mark.clause("CON-9")
def test_a_picture_is_asked_for_once_its_decision_is_on_record_and_none_where_an_ask_has_one(rig):
    """An ask that the provider refused is none: its motion has a picture of its own."""
    told = []

    def pictured(request_id, record, moves):
        (newest,) = rig.records("decision")[-1:]
        told.append((request_id, moves, newest["body"]["request"]["id"], record == record_hash(rfc8785.dumps(newest))))

    rig.pictured = pictured
    permitted = rig.call(rig.agent())
    run(rig, permitted)
    refused = rig.call(rig.agent())
    rig.physics.answer = reading(index_milli=3_900)
    run(rig, refused)
    deferred = rig.call(rig.agent())
    rig.physics.answer = reading(index_milli=2_640)
    assert run(rig, deferred).ask is not None
    rig.issuer.refuses = (429, "ASK_BUDGET_SPENT")
    unasked = rig.call(rig.agent(), arguments=MOVE | {"speed_rad_s": 0.4})
    assert run(rig, unasked).decision.reason is Reason.ASK_BUDGET_SPENT
    ids = [(each.request.request_id, each is permitted) for each in (permitted, refused, unasked)]
    assert told == [(request_id, moves, request_id, True) for request_id, moves in ids]
