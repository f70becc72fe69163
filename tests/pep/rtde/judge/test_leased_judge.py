"""Judge of a leased program's commands: it forwards only in the gate's effect, and watches to the end."""

import asyncio
import hashlib
import struct
from dataclasses import replace

import pytest
from capabilities.values.scope import Range, Tier
from pep.people.deferral import AskState
from pep.perception.sensor_frames import Distrusted, FrameFault, RejectedFrame, Unseen
from pep.world.cell_stream import JointAngles, JointSpeeds, Judged, Shown
from policies.evidence.evidence import ImpactFault
from policies.words.reason_table import Reason
from tests.pep.kit import FailingJournal, reading
from tests.pep.rtde.leased import FITTED, HERE, LIMITS, LOAD, THERE, leased_scope, played, until
from ztpm_idp.domain.ledger import RECORD_KINDS

from pep.rtde.command import command_values as v
from pep.rtde.command.gripper_commands import MoveFingers
from pep.rtde.command import io_commands as io
from pep.rtde.judge import command_judge, execution, stream_values

MOVE = v.MoveJ(THERE, 1.0, 1.4, True)
SLOW = v.MoveJ(THERE, 0.1, 1.4, True)
OTHER = v.MoveJ(THERE, 0.9, 1.4, True)
SERVO = v.ServoJ((0.2, 0.0, 0.0, 0.0, 0.0, 0.0), 0.002, 0.1, 300.0)
JOG = v.JogStart((0.0, 0.0, 0.02, 0.0, 0.0, 0.0), v.JogFrame.BASE, 0.5, (0.0,) * 6)
SPEEDS = v.SpeedJ((0.2, 0.0, 0.0, 0.0, 0.0, 0.0), 0.5, 0.4)
pytestmark = [pytest.mark.e2e, pytest.mark.clause("LSD-2")]  # verdicts last 50 ms of real time


def ended(house, command, **changes):
    """The answers to one command, its motion over."""
    held = house.held(command, **changes)

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers and (not held.forwarded or house.outcomes()))

    played(house, scenario)
    return held.answers


# ------------------------------------------------------------------------------------------------------------- one move


def test_a_permitted_move_is_forwarded_once_and_watched_until_it_stands(house):
    assert ended(house, MOVE) == ["forward"]
    assert house.arm.q == THERE[0]
    (outcome,) = house.outcomes()
    assert (outcome["outcome"], outcome["result"]["outcome"]) == ("done", "reached")
    assert house.hurried == [True, False]


@pytest.mark.clause("LSD-13")
def test_a_load_is_the_models_once_the_command_that_says_it_is_sent(house):
    assert ended(house, v.SetPayload(FITTED.payload_kg, FITTED.centre_m)) == ["forward"]
    assert house.loads == [], "it is so already"
    assert ended(house, v.SetPayload(LOAD.mass_kg + 0.001, LOAD.centre_m)) == [Reason.PAYLOAD_MISMATCH]
    assert ended(house, v.SetPayload(LOAD.mass_kg, LOAD.centre_m), waits=False) != ["forward"]
    assert house.loads == [], "it was not sent"
    assert ended(house, v.SetPayload(LOAD.mass_kg, LOAD.centre_m)) == ["forward"]
    assert house.loads == [LOAD]


GRIP = MoveFingers(255, 128, 30)


@pytest.mark.clause("LSD-28")
def test_permitted_fingers_move_once_by_the_gateways_own_line(house):
    assert ended(house, GRIP) == ["forward"]
    (grip,) = house.grips
    assert grip[0] == "gripper_move"
    assert grip[1] == pytest.approx((0.0, 0.085255, 45.294))
    (outcome,) = house.outcomes()
    assert (outcome["outcome"], outcome["result"]["object"]) == ("done", False)


@pytest.mark.clause("LSD-28")
@pytest.mark.parametrize(("force", "reason"), [(255, Reason.LIMIT_EXCEEDED_BY_REQUEST)])
def test_a_grip_beyond_the_token_moves_nothing(house, force, reason):
    assert ended(house, MoveFingers(255, 128, force)) == [reason]
    assert house.grips == []


@pytest.mark.clause("LSD-28")
def test_fingers_of_a_program_that_waits_no_longer_stay(house):
    held = house.held(GRIP, waits=False)

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: house.outcomes() or held.answers)

    played(house, scenario)
    assert house.grips == []


def test_its_decision_is_on_record_before_it_is_forwarded(house):
    seen = []
    ended(house, MOVE, before=lambda: seen.extend(r["body"]["decision"]["effect"] for r in house.records("decision")))
    assert seen == ["PERMIT"]
    (decision,) = house.records("decision")
    assert decision["body"]["request"]["points"] == ["e5"]
    assert decision["body"]["evidence"]["chain"]


def test_without_a_record_nothing_is_forwarded(house):
    house.build(FailingJournal(house.journal))
    assert ended(house, MOVE) == [Reason.RECORD_FAILED]


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda h: h.feed.revoke("token", h.credentials(h.holder).chain.token_id), Reason.REVOKED),
        (lambda h: setattr(h.feed, "age_ms", 2_001), Reason.REVOCATION_VIEW_STALE),
        (lambda h: setattr(h.physics, "answer", reading(1, 900, violations=("person",))), Reason.PHYSICS_VIOLATION),
        (lambda h: setattr(h.physics, "answer", ImpactFault("PERCEPTION_INVALID")), Reason.PERCEPTION_INVALID),
        (
            lambda h: setattr(h.readiness, "answer", replace(h.readiness.answer, frames_match=False)),
            Reason.FRAMES_MISMATCH,
        ),
        (lambda h: setattr(h.readiness, "answer", replace(h.readiness.answer, payload_g=1)), Reason.PAYLOAD_MISMATCH),
        (
            lambda h: setattr(h.readiness, "answer", replace(h.readiness.answer, exclusive=False)),
            Reason.ROBOT_NOT_EXCLUSIVE,
        ),
        (lambda h: setattr(h, "starts", (0.003, *HERE[1:])), Reason.NOT_WHAT_WAS_DECIDED),
        (lambda h: setattr(h, "starts", None), Reason.NOT_WHAT_WAS_DECIDED),
    ],
    ids=[
        "revoked",
        "stale view",
        "violation",
        "forged view",
        "tcp drift",
        "payload",
        "not ours",
        "elsewhere",
        "unknown start",
    ],
)
def test_what_the_gate_denies_is_not_forwarded(house, spoil, reason):
    held = house.held(MOVE)  # the lease is older than what spoils it
    spoil(house)

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers)

    played(house, scenario)
    assert held.answers == [reason]
    assert house.arm.q == 0.0


def test_a_program_is_told_what_physics_could_not_do(house):
    cause = "a blend takes more than half of a leg"
    house.physics.answer = ImpactFault("OUT_OF_RANGE", cause)
    held = house.held(MOVE)

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers)

    played(house, scenario)
    assert held.answers == [Reason.OUT_OF_RANGE]
    assert f"cause={cause}" in held.denied


def test_what_the_chain_does_not_grant_is_not_forwarded(house):
    at = house.clock.wall_s()
    bare = house.agent(scope=leased_scope(at, without=("move_joint", "servo_joint")))
    narrow = house.agent(scope=leased_scope(at, speed_high=100_000))
    assert ended(house, MOVE, holder=bare) == [Reason.NOT_GRANTED]
    assert ended(house, SERVO, holder=bare) == [Reason.NOT_GRANTED]
    assert ended(house, MOVE, holder=narrow) == [Reason.LIMIT_EXCEEDED_BY_REQUEST]


def test_what_no_operation_stands_for_is_refused_on_record_and_asks_nobody(house):
    assert ended(house, JOG) == [Reason.NOT_GRANTED]
    assert ended(house, v.MoveJ((0.1234567, *HERE[1:]), 1.0, 1.4, True)) == [Reason.NOT_ON_GRID]
    assert [r["body"]["where"]["command"] for r in house.records("refusal")] == ["JogStart", "MoveJ"]
    assert house.physics.asked == 0


@pytest.mark.parametrize("command", [v.StopJ(2.0, False), v.Clear(), v.Read(v.Reading.STEADY)])
def test_a_stop_is_never_subject_to_a_permit(house, command):
    house.feed.age_ms = 10**9
    held = house.held(command)

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers)

    played(house, scenario)
    assert held.answers == ["forward"]
    assert house.records("decision") == []


@pytest.mark.parametrize(
    "command", [io.SetDigitalOutputs(io.Bank.STANDARD, 1, 1), io.SetSpeedSlider(0.5), v.SetTcp(FITTED.tcp_m_rad)]
)
def test_what_is_switched_or_said_again_is_forwarded_and_on_record(house, command):
    assert ended(house, command) == ["forward"]
    assert house.outcomes()[0]["result"] == {"outcome": "sent"}


def test_a_registered_tool_of_its_name_may_raise_the_base_tier(house):
    registered = house.registry.tools["move_joint"]
    house.registry.tools["move_joint"] = replace(registered, base_tier=Tier.HIGH_CONSEQUENCE)
    assert ended(house, MOVE)[0] == "defer"
    house.registry.tools["move_joint"] = replace(registered, base_tier=Tier.NO_EFFECT)
    assert ended(house, MOVE)[0] == "forward"


def test_a_command_that_became_another_one_is_not_forwarded(house):
    held = house.held(MOVE)
    house.physics.before = lambda: setattr(held, "command", replace(MOVE, speed_rad_s=1.05))

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers)

    played(house, scenario)
    assert held.answers == [Reason.NOT_WHAT_WAS_DECIDED]


def test_a_stop_after_the_request_voids_it(house):
    house.physics.before = house.arm.halt
    assert ended(house, MOVE) == [Reason.VERDICT_EXPIRED]


def test_a_command_that_is_withdrawn_while_it_is_decided_is_not_forwarded(house):
    held = house.held(MOVE)

    async def scenario(judge):
        house.physics.before = lambda: loop.call_soon_threadsafe(judge.withdrawn, held)
        loop = asyncio.get_running_loop()
        judge.judge(held)
        await until(lambda: house.physics.asked and not judge._cases)

    played(house, scenario)
    assert held.answers == []
    assert house.slot.reserve("free")


def test_whoever_withdraws_may_name_it_by_an_equal(house):
    class Equal:
        def __eq__(self, other):
            return other is held

        __hash__ = None

    held = house.held(MOVE)
    house.physics.answer = reading(3, 2_500)

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers)
        judge.withdrawn(Equal())
        await until(lambda: not judge._cases)

    played(house, scenario)
    assert held.answers == ["defer"]


def test_one_that_waits_no_longer_has_sent_nothing(house):
    assert ended(house, MOVE, waits=False) == [Reason.VERDICT_EXPIRED]
    assert house.arm.q == 0.0


# ------------------------------------------------------------------------------------------------------ while it moves


def moving(house, command, during):
    """The outcome of a command during whose motion something happens."""
    held = house.held(command)

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers and abs(house.arm.here().q_rad[0]) > 0.005)
        await during(judge, held)
        await until(house.outcomes)

    played(house, scenario)
    assert house.arm.here().still
    return house.outcomes()[0]


async def passed(house, ms):
    since_ms = house.clock.monotonic_ms()
    await until(lambda: house.clock.monotonic_ms() - since_ms >= ms)


@pytest.mark.clause("LSD-5")
def test_a_revocation_in_the_middle_stops_the_arm(house):
    async def during(judge, held):
        house.feed.revoke("token", held.lease.credentials.chain.token_id)

    outcome = moving(house, SLOW, during)
    assert outcome["result"]["outcome"] == "authority_lost"
    assert outcome["watch"]["reason"] == "REVOKED"
    assert (house.arm.stops, house.arm.hard) == ([Reason.REVOKED], [Reason.EFFECT_FAILED])
    assert house.arm.q < 0.2


@pytest.mark.clause("LSD-5")
def test_an_expiry_in_the_middle_stops_the_arm(house):
    at = house.clock.wall_s()
    house.holder = house.agent(scope=leased_scope(at, lifetime_s=2))

    async def during(judge, held):
        pass

    outcome = moving(house, SLOW, during)
    assert (outcome["result"]["outcome"], outcome["watch"]["reason"]) == ("authority_lost", "EXPIRED")


@pytest.mark.clause("LSD-5")
@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda h: setattr(h.feed, "age_ms", 2_001), "REVOCATION_VIEW_STALE"),
        (lambda h: setattr(h, "seen", Unseen()), "WATCH_BLIND"),
        (
            lambda h: setattr(h, "seen", Distrusted(RejectedFrame(FrameFault.UNTRUSTED, "camera-1"))),
            "PERCEPTION_INVALID",
        ),
        (lambda h: setattr(h, "rest", replace(h.rest, holds=False, index_milli=3_000)), "IMPACT_ROSE"),
    ],
)
def test_what_the_watch_sees_stops_the_arm(house, change, reason):
    async def during(judge, held):
        change(house)

    outcome = moving(house, SLOW, during)
    assert outcome["result"]["reason"] == reason
    assert house.arm.stops[0] == reason


def test_an_arm_that_does_not_hear_its_line_is_stopped_harder(house):
    async def during(judge, held):
        house.arm.deaf = True
        house.feed.revoke("token", held.lease.credentials.chain.token_id)

    moving(house, v.MoveJ(THERE, 0.05, 1.4, True), during)
    assert house.arm.stops[0] is house.arm.hard[0] is Reason.REVOKED


def test_a_silent_robot_is_stopped(house):
    async def during(judge, held):
        house.arm.silent = True
        await until(lambda: house.arm.stops)
        house.arm.silent = False

    assert moving(house, SLOW, during)["result"] == {"outcome": "robot_failed", "q_rad": [], "reason": "ROBOT_STALLED"}


def test_a_safety_stop_is_told_at_once(house):
    async def during(judge, held):
        house.arm.mode = 3

    outcome = moving(house, SLOW, during)
    assert (outcome["outcome"], outcome["result"]["outcome"]) == ("failed", "robot_failed")


def test_a_stop_of_its_program_ends_it_without_ours(house):
    async def during(judge, held):
        house.arm.halt()

    assert moving(house, SLOW, during)["result"]["outcome"] == "stopped"
    assert (house.arm.stops, house.arm.hard) == ([], [Reason.EFFECT_FAILED])  # that of closing


def test_an_arm_that_halts_by_itself_is_stopped(house):
    async def during(judge, held):
        house.arm.sticks = True

    assert moving(house, SLOW, during)["result"]["reason"] == "moved True"


def test_an_arm_that_never_begins_is_stopped(house, monkeypatch):
    monkeypatch.setattr("pep.rtde.motion.motion_follower.BEGINS_MS", 100)
    house.arm.sticks = True
    assert ended(house, MOVE) == ["forward"]
    assert house.outcomes()[0]["result"]["reason"] == "moved False"
    assert house.arm.stops[0] is Reason.EFFECT_FAILED
    assert house.arm.target is None


@pytest.mark.clause("LSD-6")
def test_another_motion_meanwhile_is_busy_and_a_prompt_one_after_it_is_not(house, monkeypatch):
    other = house.held(MOVE)

    async def during(judge, held):
        judge.judge(other)
        await until(lambda: other.answers)

    moving(house, v.MoveJ(THERE, 0.4, 1.4, True), during)
    assert other.answers == [Reason.BUSY]

    async def scenario(judge):
        house.starts = THERE
        first, second = house.held(MOVE), house.held(MOVE)
        judge.judge(first)
        judge.judge(second)
        await until(lambda: second.answers)
        return first.answers, second.answers

    assert played(house, scenario) == (["forward"], ["forward"])


def test_closing_stops_what_moves(house):
    held = house.held(SLOW)

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers and house.arm.here().q_rad[0] > 0.005)

    played(house, scenario)
    assert house.arm.here().still
    assert house.outcomes()[0]["result"]["outcome"] == "stopped"


# --------------------------------------------------------------------------------------------------------- what people say


NEAR = reading(3, 2_500)


def deferred(house, then, command=MOVE):
    """Answers to a command near a person, after `then(judge, held, ask)`."""
    house.physics.answer = NEAR
    house.holder = house.agent(scope=leased_scope(house.clock.wall_s()))
    held = house.held(command)

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers)
        assert held.answers == ["defer"]
        (ask_id,) = house.issuer.asks
        await then(judge, held, ask_id)
        if held.forwarded:
            await until(house.outcomes)

    played(house, scenario)
    return held.answers


async def vote(house, ask_id, answer="approve"):
    text = house.issuer.asks[ask_id]
    house.issuer.cast(ask_id, house.people["bob"].vote(text, at=house.clock.wall_s(), answer=answer))
    await house.asking.pull()


@pytest.mark.clause("LSD-7")
def test_what_people_approve_is_decided_afresh_and_forwarded(house):
    async def then(judge, held, ask_id):
        asked = house.physics.asked
        await vote(house, ask_id)
        await until(lambda: len(held.answers) == 2)
        assert house.physics.asked == asked + 1

    assert deferred(house, then) == ["defer", "forward"]
    assert [r["body"]["decision"]["effect"] for r in house.records("decision")] == ["DEFER", "PERMIT"]
    assert house.asks.state_of(next(iter(house.issuer.asks))) is not AskState.OPEN


@pytest.mark.clause("LSD-7")
def test_what_people_refuse_is_denied(house):
    async def then(judge, held, ask_id):
        await vote(house, ask_id, "deny")
        await until(lambda: len(held.answers) == 2)

    assert deferred(house, then) == ["defer", Reason.APPROVAL_DENIED]


@pytest.mark.clause("LSD-7")
def test_what_was_approved_and_has_grown_worse_is_not_forwarded(house):
    async def then(judge, held, ask_id):
        house.physics.answer = reading(3, 2_900)
        await vote(house, ask_id)
        await until(lambda: len(held.answers) == 2)

    answers = deferred(house, then)
    assert answers[0] == "defer"
    assert "forward" not in answers


@pytest.mark.clause("LSD-7")
def test_a_command_that_is_cleared_while_people_think_is_not_forwarded(house):
    async def then(judge, held, ask_id):
        judge.withdrawn(held)
        await until(lambda: not judge._cases)
        await vote(house, ask_id)
        await asyncio.sleep(0)

    assert deferred(house, then) == ["defer"]


@pytest.mark.clause("LSD-7")
def test_whom_nobody_answers_is_denied_in_time_and_the_question_stays_open(house, monkeypatch):
    monkeypatch.setattr(command_judge, "HOLD_MS", 200)

    async def then(judge, held, ask_id):
        await until(lambda: len(held.answers) == 2)
        assert house.asks.state_of(ask_id) is AskState.OPEN

    assert deferred(house, then) == ["defer", Reason.APPROVAL_TIMEOUT]


@pytest.mark.clause("LSD-7")
def test_the_same_again_uses_the_answer_that_people_gave_meanwhile_and_once(house, monkeypatch):
    monkeypatch.setattr(command_judge, "HOLD_MS", 200)

    async def then(judge, held, ask_id):
        await until(lambda: len(held.answers) == 2)  # nobody had answered
        await vote(house, ask_id)
        other, again, once_more = house.held(OTHER), house.held(MOVE), house.held(MOVE)
        judge.judge(other)  # the answer is not about this one
        await until(lambda: other.answers)
        judge.withdrawn(other)
        await until(lambda: not judge._cases)
        assert other.answers == ["defer"]
        assert len(house.issuer.asks) == 2
        judge.judge(again)
        await until(lambda: again.answers and house.outcomes())
        assert again.answers == ["forward"]
        assert len(house.issuer.asks) == 2
        await until(lambda: house.arm.here().still)
        house.arm.q = HERE[0]  # somebody has brought it back: nothing is another than it was
        judge.judge(once_more)  # and the answer was about one
        await until(lambda: once_more.answers)
        assert once_more.answers == ["defer"]
        assert len(house.issuer.asks) == 3

    assert deferred(house, then) == ["defer", Reason.APPROVAL_TIMEOUT]
    assert [r["body"]["decision"]["effect"] for r in house.records("decision")] == ["DEFER", "DEFER", "PERMIT", "DEFER"]


# --------------------------------------------------------------------------------------------------------------- streams


def streamed(house, command, during, *, begun=None):
    """The held command and the outcome of a stream during which something happens."""
    held = house.held(command)

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers)
        if held.forwarded:
            await during(held.steps)
            await until(house.outcomes)

    played(house, scenario)
    assert house.arm.here().still
    return held


def nothing(_steps):
    return asyncio.sleep(0)


@pytest.mark.clause("LSD-3")
def test_a_stream_has_its_envelope_on_record_before_its_first_value(house):
    seen = []
    held = house.held(SERVO, before=lambda: seen.extend(r["kind"] for r in house.records()))

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers)
        held.steps.ended()
        await until(house.outcomes)

    played(house, scenario)
    assert seen == ["stream", "decision"]
    (envelope,) = house.records("stream")
    assert envelope["body"]["operation"] == "servo_joint"
    assert envelope["body"]["request_id"] == house.records("decision")[0]["body"]["request"]["id"]
    assert len(envelope["body"]["limits"]) == 9


@pytest.mark.clause("LSD-3")
def test_values_of_a_stream_are_certified_one_by_one_and_on_record_by_their_digest(house, monkeypatch):
    monkeypatch.setattr(execution, "BATCH_S", 0.02)
    exact = replace(SERVO, q_rad=(0.12345678, *HERE[1:]))

    async def during(steps):
        assert steps.step(exact) is None
        house.arm.take(exact)
        await until(lambda: house.records("stream-values"))
        assert steps.step(SERVO) is None
        steps.ended()

    streamed(house, SERVO, during)
    values = [value for value, _, _ in house.certifying.values]
    assert JointAngles(exact.q_rad, 0.002, 0.1) in values
    assert {authorised for *_, authorised in house.certifying.values} == {1_000}
    assert sum(r["body"]["values"] for r in house.records("stream-values")) == 3
    assert house.outcomes()[0]["result"]["outcome"] == "ended"
    assert house.arm.stops == []  # its program had stopped it


@pytest.mark.clause("LSD-3")
def test_the_digest_of_a_batch_is_of_each_value_and_when_it_was_taken(house):
    others = [replace(SERVO, q_rad=(angle, *HERE[1:])) for angle in (0.12345678, 0.2)]

    async def during(steps):
        steps.batch()
        assert steps.step(others[0]) is None
        await asyncio.sleep(0.003)
        assert steps.follow(others[1].q_rad) is None
        batch = steps.batch()
        assert batch["values"] == 2
        first, *later = (struct.pack(">6d3d", *each.q_rad, each.time_s, each.lookahead_s, each.gain) for each in others)
        began_ms = batch["first_ms"]
        assert batch["digest"] in {
            hashlib.sha256(
                struct.pack(">q", began_ms) + first + struct.pack(">q", began_ms + ms) + later[0]
            ).hexdigest()
            for ms in range(1, 1_000)
        }
        assert steps.batch() is None
        steps.ended()

    streamed(house, SERVO, during)


@pytest.mark.clause("LSD-3")
def test_the_ledger_takes_all_that_is_recorded(house, monkeypatch):
    monkeypatch.setattr(execution, "BATCH_S", 0.02)

    async def during(steps):
        await until(lambda: house.records("stream-values"))
        steps.ended()

    streamed(house, SERVO, during)
    ended(house, JOG)
    kinds = {record["kind"] for record in house.records()}
    assert {"decision", "outcome", "refusal", "stream", "stream-values"} <= kinds <= RECORD_KINDS


@pytest.mark.clause("LSD-3")
@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (Judged(1_001, (), 0.1, 0.0), Reason.IMPACT_ROSE),
        (Judged(900, ("person",), 0.1, 0.0), Reason.PHYSICS_VIOLATION),
        (ImpactFault("ROBOT_LIMIT"), Reason.ROBOT_LIMIT),
        (ImpactFault("some new word"), Reason.PHYSICS_FAULT),
    ],
)
def test_a_value_that_is_not_certified_ends_the_stream_for_good(house, answer, reason):
    async def during(steps):
        good, house.certifying.answer = house.certifying.answer, answer
        assert steps.step(replace(SERVO, q_rad=THERE)) is reason
        house.certifying.answer = good
        assert steps.step(SERVO) is reason

    streamed(house, SERVO, during)
    assert house.outcomes()[0]["result"]["outcome"] in {"stopped", "world_changed"}
    assert house.arm.stops[0] is reason


@pytest.mark.clause("LSD-3")
def test_a_first_value_that_is_not_certified_is_not_forwarded(house):
    house.certifying.answer = Judged(1_001, (), 0.1, 0.0)
    assert ended(house, SERVO) == [Reason.IMPACT_ROSE]
    house.certifying.shown = ImpactFault("PERCEPTION_INVALID")
    assert ended(house, SERVO) == [Reason.PERCEPTION_INVALID]


@pytest.mark.clause("LSD-3")
@pytest.mark.parametrize(
    "says", [lambda steps, q: steps.step(replace(SERVO, q_rad=q)), stream_values.LeasedStream.follow]
)
def test_a_value_outside_of_what_was_granted_ends_the_stream(house, says):
    at = house.clock.wall_s()
    limits = {"servo_joint": {**LIMITS["servo_joint"], "q0": Range(0, 300_000)}}
    house.holder = house.agent(scope=leased_scope(at, limits=limits))

    async def during(steps):
        assert says(steps, (0.2999994, *HERE[1:])) is None
        assert says(steps, (0.3000004, *HERE[1:])) is Reason.LIMIT_EXCEEDED_BY_REQUEST
        assert says(steps, (0.2, *HERE[1:])) is Reason.LIMIT_EXCEEDED_BY_REQUEST

    streamed(house, SERVO, during)


@pytest.mark.clause("LSD-3")
@pytest.mark.parametrize(
    ("command", "made"),
    [(SERVO, lambda six: JointAngles(six, 0.002, 0.1)), (SPEEDS, lambda six: JointSpeeds(six, 0.5))],
    ids=["angles", "speeds"],
)
def test_a_value_that_follows_is_the_last_command_with_other_numbers(house, command, made):
    """Of that command all else stays, and where it is another than before, of the newer one."""
    six = (0.11, *HERE[1:])

    async def during(steps):
        steps.batch()
        assert steps.step(command) is None
        assert steps.follow(six) is None
        assert steps.batch()["values"] == 2
        if command is SERVO:
            assert steps.step(replace(SERVO, lookahead_s=0.2)) is None
            assert steps.follow((0.12, *HERE[1:])) is None
        steps.ended()

    streamed(house, command, during)
    values = [value for value, _, _ in house.certifying.values]
    assert made(six) in values
    assert (JointAngles((0.12, *HERE[1:]), 0.002, 0.2) in values) is (command is SERVO)


@pytest.mark.clause("LSD-3")
def test_another_command_is_no_value_of_the_stream_and_nothing_follows_it(house):
    async def during(steps):
        assert steps.step(SPEEDS) is Reason.NOT_WHAT_WAS_DECIDED
        assert steps.follow(SPEEDS.qd_rad_s) is Reason.NOT_WHAT_WAS_DECIDED

    streamed(house, SERVO, during)


@pytest.mark.clause("LSD-3")
def test_what_stands_is_asked_about_again_in_every_new_view(house):
    async def during(steps):
        seen = len(house.certifying.values)
        await until(lambda: len(house.certifying.values) > seen + 2)
        house.certifying.answer = Judged(2_500, (), 0.1, 0.0)

    streamed(house, SPEEDS, during)
    outcome = house.outcomes()[0]
    assert (outcome["result"]["outcome"], outcome["watch"]["reason"]) == ("world_changed", "IMPACT_ROSE")
    assert isinstance(house.certifying.values[0][0], JointSpeeds)


@pytest.mark.clause("LSD-3")
def test_speeds_that_are_not_given_anew_end_in_time(house):
    streamed(house, SPEEDS, nothing)
    assert house.outcomes()[0]["result"]["outcome"] == "ended"
    assert 0.08 <= house.arm.q < 0.2
    assert house.arm.stops[0] is Reason.VERDICT_EXPIRED


@pytest.mark.clause("LSD-3")
def test_speeds_that_are_given_anew_go_on(house):
    async def during(steps):
        for _ in range(40):
            assert steps.step(SPEEDS) is None
            await passed(house, 20)

    streamed(house, SPEEDS, during)
    assert house.arm.q > 0.2


@pytest.mark.clause("LSD-3")
def test_a_stream_lasts_no_longer_than_it_may(house, monkeypatch):
    monkeypatch.setattr(stream_values, "LASTS_MS", 200)
    held = streamed(house, SERVO, nothing)
    assert house.outcomes()[0]["result"]["outcome"] == "ended"
    assert held.steps.step(SERVO) is Reason.VERDICT_EXPIRED


@pytest.mark.clause("LSD-3")
def test_after_a_stop_no_value_is_taken(house):
    async def during(steps):
        house.arm.halt()
        assert steps.step(SERVO) is Reason.VERDICT_EXPIRED

    streamed(house, SERVO, during)


@pytest.mark.clause("LSD-3")
def test_a_stream_of_a_robot_that_says_nothing_ends(house, monkeypatch):
    monkeypatch.setattr("pep.rtde.motion.motion_follower.SILENCE_MS", 10_000)
    monkeypatch.setattr("pep.watch.watch.FRAME_PERIOD_MS", 10_000)  # nobody but the next value asks

    async def during(steps):
        house.arm.silent = True
        await passed(house, stream_values.FRESH_MS + 20)
        assert (steps.step(SERVO), house.arm.stops, house.outcomes()) == (Reason.EVIDENCE_MISSING, [], [])
        house.arm.silent = False

    streamed(house, SERVO, during)
    assert house.arm.stops[0] is Reason.EVIDENCE_MISSING


@pytest.mark.clause("LSD-5")
def test_a_revocation_ends_a_stream(house):
    async def during(steps):
        house.feed.revoke("token", house.credentials(house.holder).chain.token_id)

    streamed(house, replace(SPEEDS, time_s=2.0), during)
    assert house.outcomes()[0]["result"]["outcome"] == "authority_lost"
    assert house.arm.stops[0] is Reason.REVOKED


@pytest.mark.clause("LSD-3")
def test_values_that_cannot_be_recorded_end_the_stream(house, monkeypatch):
    monkeypatch.setattr(execution, "BATCH_S", 0.02)
    house.build(FailingJournal(house.journal, fail_from=2))
    held = house.held(replace(SPEEDS, time_s=2.0))

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: house.arm.stops)
        await until(lambda: not judge._cases)

    played(house, scenario)
    assert house.arm.stops[0] is Reason.RECORD_FAILED


@pytest.mark.clause("LSD-3")
@pytest.mark.parametrize(
    ("judged", "reason"),
    [
        (Judged(2_500, (), 0.25, 1.0), None),
        (Judged(2_500, (), 0.2500011, 1.0), Reason.APPROVED_TOO_FAST),
        (Judged(2_500, (), 0.25, 1.0011), Reason.APPROVED_TOO_FAST),
    ],
)
def test_an_approved_stream_near_people_stays_as_slow_as_an_approved_move(house, judged, reason):
    seen = []

    async def then(judge, held, ask_id):
        await vote(house, ask_id)
        await until(lambda: len(held.answers) == 2)
        house.certifying.answer = judged
        seen.append(held.steps.step(SERVO))
        held.steps.ended()

    house.certifying.answer = Judged(2_500, (), 0.1, 0.5)
    assert deferred(house, then, SERVO) == ["defer", "forward"]
    assert seen == [reason]


def test_the_view_that_a_stream_began_in_is_what_it_is_asked_in(house):
    house.certifying.shown = Shown(None, None)

    async def during(steps):
        steps.ended()

    streamed(house, SERVO, during)
    assert house.certifying.seen >= 1
