"""Follower of motions: each kind of end, slower motion where that suffices, and stops that end everything."""

from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace

import pytest
from capabilities.values.errors import Fault, FaultCode
from pep.base.ports import RemainingVerdict
from pep.base.stop_model import ESCALATE_MS
from pep.perception.sensor_frames import Distrusted, FrameFault, RejectedFrame, Seen, Unseen
from pep.rtde.command import command_values as v
from pep.rtde.motion import standstill
from pep.rtde.motion.governed_move import SpeedControl, least_fraction, put_back
from pep.rtde.motion.motion_follower import (
    BEGINS_MS,
    RESTS_MS,
    SETTLED_MS,
    SLACK,
    SLACK_MS,
    ContactProgress,
    HandOver,
    MotionFollower,
    Over,
    SettledProgress,
    TargetProgress,
    TimedProgress,
    TimeLimit,
)
from pep.rtde.robot.newest_state import SILENCE_MS, NewestState
from pep.rtde.robot.state_receiver import JointState
from pep.watch.governor import Governor, Offer, ReportedSpeeds
from pep.watch.watch import MotionOutcome, WatchAges
from policies.words.reason_table import Reason
from tests.pep.rtde.motion.moved_arm import HERE, PACING, THERE, Scene

REVOKED = Fault(FaultCode.REVOKED, "TOK-9")


@pytest.fixture
def scene():
    return Scene()


def at(q):
    return lambda q_rad: abs(q_rad[0] - q) <= 1e-3


def follower_of(scene, *, speed=0.5, governed=False, permit=None, target=THERE, sends=True):
    """The follower of a move under way, and its permit."""
    permit = permit or scene.permit()
    arm = NewestState(scene.arm, scene.clock)
    governor = None
    if governed:
        least = least_fraction(speed, 1.4)
        governor = SpeedControl(scene.arm, PACING).governor(arm, least=least, clock=scene.clock)
    watch = scene.watching(permit, governor=governor)
    if sends:
        scene.arm.take(v.MoveJ(target, speed, 1.4, asynchronous=True))
    arm.sent()
    follower = MotionFollower(
        arm,
        watch,
        permit,
        brake=scene.arm.brake,
        stopper=scene.arm,
        newest=scene.arm.newest,
        clock=scene.clock,
        pause=scene.pause,
        governor=governor,
    )
    return follower, permit


def followed(scene, courses=None, **changes):
    follower, permit = follower_of(scene, **changes)
    return follower.follow(courses or (TargetProgress(at(THERE[0])),)), permit


# ------------------------------------------------------------------------------------------------- how a motion ends


def test_it_arrives_and_nothing_is_stopped(scene):
    end, permit = followed(scene)
    assert (end.end, end.q_rad[0], end.reason) == (MotionOutcome.REACHED, pytest.approx(0.5, abs=1e-3), "")
    assert (scene.arm.stops, scene.arm.hard, permit.watched) == ([], [], None)


def test_a_stop_of_somebody_else_ends_it(scene):
    def stopped():
        scene.arm.stopped_ms = scene.clock.mono
        scene.arm.halt()

    scene.past(0.1, stopped)
    end, _ = followed(scene)
    assert (end.end, scene.arm.stops, scene.arm.hard) == (MotionOutcome.STOPPED, [], [])
    assert 0.1 < end.q_rad[0] < 0.2


def test_a_stop_of_somebody_else_that_does_not_help_is_followed_by_ours(scene):
    scene.past(0.1, lambda: setattr(scene.arm, "stopped_ms", scene.clock.mono))
    end, _ = followed(scene, speed=0.1)
    assert (end.end, scene.arm.stops) == (MotionOutcome.STOPPED, [Reason.VERDICT_EXPIRED])
    assert end.q_rad[0] == pytest.approx(0.1 + 0.1 * ESCALATE_MS / 1000, abs=0.005)


def test_a_stop_before_its_request_is_none_of_it(scene):
    scene.arm.stopped_ms = scene.clock.mono - 1
    assert followed(scene)[0].end is MotionOutcome.REACHED


@pytest.mark.parametrize(
    ("change", "outcome", "reason"),
    [
        (lambda s: setattr(s, "fault", REVOKED), "authority_lost", "REVOKED"),
        (lambda s: setattr(s, "seen", Seen((), 151)), "world_changed", Reason.WATCH_BLIND),
        (
            lambda s: setattr(s, "seen", Distrusted(RejectedFrame(FrameFault.UNTRUSTED, "c"))),
            "world_changed",
            Reason.PERCEPTION_INVALID,
        ),
        (
            lambda s: setattr(s, "rest", RemainingVerdict(False, 2_400, "person bob", "", 20)),
            "world_changed",
            Reason.IMPACT_ROSE,
        ),
        (
            lambda s: setattr(s, "rest", RemainingVerdict(False, None, "", "ENGINES_DISAGREE", 20)),
            "world_changed",
            Reason.ENGINES_DISAGREE,
        ),
    ],
)
def test_what_the_watch_sees_ends_it_and_the_record_is_told(scene, change, outcome, reason):
    scene.past(0.1, lambda: change(scene))
    end, permit = followed(scene)
    assert (end.end, end.reason) == (outcome, reason)
    assert (scene.arm.stops, scene.arm.hard) == ([reason], [])
    watched = permit.watched
    assert (watched["outcome"], watched["reason"], watched["authorised_milli"]) == (outcome, reason, 1_000)
    assert watched["index_milli"] == (2_400 if reason is Reason.IMPACT_ROSE else None)
    assert 0.1 < watched["q_at_stop_rad"][0] <= watched["q_at_standstill_rad"][0] == scene.arm.q < 0.2
    assert watched["t_seen_ms"] <= scene.clock.mono


def test_a_watch_that_looks_too_late_ends_it(scene):
    scene.limits = WatchAges(150, 2_000, 3)
    end, _ = followed(scene)
    assert (end.end, end.reason) == (MotionOutcome.WORLD_CHANGED, Reason.WATCH_LATE)


def test_what_was_permitted_unseen_goes_on_unseen(scene):
    scene.seen = Unseen()
    assert followed(scene, permit=scene.permit(sighted=False))[0].end is MotionOutcome.REACHED


def test_whoever_goes_away_leaves_it_standing(scene):
    follower, _ = follower_of(scene)
    scene.past(0.1, follower.leave)
    assert follower.follow((TargetProgress(at(0.5)),)).end is MotionOutcome.STOPPED
    assert (scene.arm.target, scene.arm.stops) == (None, [Reason.VERDICT_EXPIRED])


def test_a_silent_arm_is_stopped_in_time(scene):
    silent_ms = []

    def silent():
        scene.arm.silent = True
        silent_ms.append(scene.clock.mono)

    scene.past(0.1, silent)
    scene.when(lambda: scene.arm.stops, lambda: setattr(scene.arm, "silent", False))
    scene.when(lambda: scene.arm.stops, lambda: silent_ms.append(scene.clock.mono))
    end, _ = followed(scene)
    assert (end.end, end.reason, scene.arm.stops) == ("robot_failed", "ROBOT_STALLED", [Reason.EVIDENCE_MISSING])
    assert SILENCE_MS < silent_ms[1] - silent_ms[0] < SILENCE_MS + 20


def test_an_arm_that_does_not_begin_is_stopped_in_time(scene):
    scene.arm.sticks, began_ms = True, scene.clock.mono
    end, _ = followed(scene)
    assert (end.end, end.reason) == (MotionOutcome.ROBOT_FAILED, "moved False")
    assert (scene.arm.target, scene.arm.stops) == (None, [Reason.EFFECT_FAILED])
    assert BEGINS_MS < scene.clock.mono - began_ms < BEGINS_MS + 30


def test_an_arm_that_rests_on_its_way_is_stopped_in_time(scene):
    rests_ms = []

    def rest():
        scene.arm.sticks = True
        rests_ms.append(scene.clock.mono)

    scene.past(0.1, rest)
    end, _ = followed(scene)
    assert (end.end, end.reason) == (MotionOutcome.ROBOT_FAILED, "moved True")
    assert RESTS_MS < scene.clock.mono - rests_ms[0] < RESTS_MS + 30


def test_a_protective_stop_is_told_at_once(scene):
    began_ms = scene.clock.mono
    scene.arm.mode, scene.arm.sticks = 3, True
    end, _ = followed(scene)
    assert (end.end, end.reason) == (MotionOutcome.ROBOT_FAILED, "safety mode 3")
    assert scene.arm.hard == [Reason.ROBOT_SAFETY_STOP], "a paused program hears no register"
    assert scene.clock.mono - began_ms < 30


def test_what_was_said_before_it_was_sent_says_nothing(scene):
    """The arm stands where it is to go, by the package from before: that is no arrival."""
    scene.arm.q, scene.arm.silent = 0.5, True
    scene.when(
        lambda: scene.clock.mono > scene.arm.said.stamp_s * 1000 + 50, lambda: setattr(scene.arm, "silent", False)
    )
    began_ms = scene.clock.mono
    end, _ = followed(scene)
    assert end.end is MotionOutcome.REACHED
    assert scene.clock.mono - began_ms > 50


# ---------------------------------------------------------------------------------------------------------- the ladder


def test_an_arm_that_does_not_hear_its_line_is_stopped_harder_in_time(scene):
    scene.arm.deaf, stops_ms = True, []
    scene.past(0.1, lambda: setattr(scene, "fault", REVOKED))
    scene.when(lambda: scene.arm.stops, lambda: stops_ms.append(scene.clock.mono))
    scene.when(lambda: scene.arm.hard, lambda: stops_ms.append(scene.clock.mono))
    end, _ = followed(scene, speed=0.1)
    assert (end.end, scene.arm.stops, scene.arm.hard) == ("authority_lost", [Reason.REVOKED], [Reason.REVOKED])
    assert ESCALATE_MS - 10 < stops_ms[1] - stops_ms[0] < ESCALATE_MS + 20


def test_an_arm_that_nobody_sees_stand_has_failed(scene):
    scene.arm.unstoppable = True
    scene.past(0.1, lambda: setattr(scene, "fault", REVOKED))
    end, permit = followed(scene, speed=0.01, target=(0.2, *HERE[1:]))
    assert (end.end, end.reason) == (MotionOutcome.ROBOT_FAILED, "no standstill was seen")
    assert permit.watched["q_at_standstill_rad"] is None


@pytest.mark.parametrize("where", ["view", "left", "standing"])
def test_a_watch_that_breaks_leaves_nothing_moving(scene, where):
    def broken(*_, **__):
        raise ZeroDivisionError

    permit = scene.permit()
    scene.past(0.1, lambda: setattr(*((permit, "_standing") if where == "standing" else (scene, where)), broken))
    if where == "left":
        end, _ = followed(scene, permit=permit)
        assert (end.end, end.reason) == (MotionOutcome.WORLD_CHANGED, Reason.PHYSICS_FAULT)
    else:
        with pytest.raises(ZeroDivisionError):
            followed(scene, permit=permit)
        assert scene.arm.hard == [Reason.EFFECT_FAILED]
    assert scene.arm.target is None
    assert 0.1 < scene.arm.q < 0.2


def test_how_long_nobody_has_looked_counts_while_it_moves_alone(scene):
    follower, _ = follower_of(scene)
    seen = [follower.unseen_ms]
    scene.past(0.1, lambda: (setattr(scene.clock, "mono", scene.clock.mono + 40), seen.append(follower.unseen_ms)))
    follower.follow((TargetProgress(at(0.5)),))
    scene.clock.mono += 1_000
    assert (seen[0], follower.unseen_ms) == (0, 0)
    assert 40 <= seen[1] < 60


# ------------------------------------------------------------------------------------------------------------- its time


def test_it_may_take_its_time_by_half_and_three_seconds(scene):
    lasts_ms = 1000 * 0.5 / 0.5
    for speed, outcome in ((0.5 / 4.3, MotionOutcome.REACHED), (0.5 / 4.7, MotionOutcome.ROBOT_FAILED)):
        scene = Scene()
        limit = TimeLimit(lasts_ms, None, scene.clock)
        end, _ = followed(scene, (TargetProgress(at(0.5), limit.late),), speed=speed)
        assert (end.end, end.reason) == (outcome, "" if outcome is MotionOutcome.REACHED else "too slow")
    assert lasts_ms * SLACK + SLACK_MS == 4_500


def test_time_slowed_down_counts_less(scene):
    ordered = SimpleNamespace(ordered=0.1)
    limit = TimeLimit(1_000, ordered, scene.clock)
    scene.clock.mono += 44_000
    assert not limit.late()
    scene.clock.mono += 2_000
    assert limit.late()


def test_what_lasts_for_a_time_is_ended_in_time_and_may_be_prolonged_before(scene):
    until_ms = scene.clock.mono + 500
    course = TimedProgress(until_ms, scene.clock)
    scene.past(0.1, lambda: course.prolong(until_ms - 100))  # is no longer than it was
    scene.past(0.2, lambda: course.prolong(until_ms + 300))
    end, _ = followed(scene, (course,), target=(9.0, *HERE[1:]))
    assert (end.end, end.reason, scene.arm.stops) == (MotionOutcome.ENDED, "", [Reason.VERDICT_EXPIRED])
    assert end.q_rad[0] == pytest.approx(0.4, abs=0.01)
    assert not course.prolong(scene.clock.mono + 1_000), "its end has been told"


def test_an_arm_that_stands_for_its_time_has_not_failed(scene):
    end, _ = followed(scene, (TimedProgress(scene.clock.mono + 2_000, scene.clock),), sends=False)
    assert end.end is MotionOutcome.ENDED


# ------------------------------------------------------------------------------------------------------------- its legs


def legs(scene, taken, *, stopped=False):
    """Two legs, the second of which is taken as that says, 40 ms after it was sent."""
    sending = Future()

    def second():
        def answered():
            if taken:
                scene.arm.take(v.MoveJ((0.1, *HERE[1:]), 0.5, 1.4, asynchronous=True))
            sending.set_result(taken)

        sent_ms = scene.clock.mono
        scene.when(lambda: scene.clock.mono >= sent_ms + 40, answered)
        return HandOver(sending, lambda: stopped)

    yield TargetProgress(at(0.3))
    yield second()
    yield TargetProgress(at(0.1))


def test_each_leg_is_followed_when_the_one_before_was_reached(scene):
    end, _ = followed(scene, legs(scene, taken=True), target=(0.3, *HERE[1:]))
    assert (end.end, end.q_rad[0], scene.arm.stops) == (MotionOutcome.REACHED, pytest.approx(0.1, abs=1e-3), [])


def test_a_leg_that_was_not_taken_ends_it(scene):
    end, _ = followed(scene, legs(scene, taken=False), target=(0.3, *HERE[1:]))
    assert (end.end, end.reason) == (MotionOutcome.ROBOT_FAILED, "a leg was not taken")
    assert scene.arm.q == pytest.approx(0.3)


def test_a_stop_between_two_legs_is_told_as_one(scene):
    scene.when(lambda: scene.arm.q == 0.3, scene.arm.brake)
    end, _ = followed(scene, legs(scene, taken=False, stopped=True), target=(0.3, *HERE[1:]))
    assert end.end is MotionOutcome.STOPPED


def test_the_watch_goes_on_between_two_legs(scene):
    scene.when(lambda: scene.arm.q == 0.3, lambda: setattr(scene, "fault", REVOKED))
    end, _ = followed(scene, legs(scene, taken=True), target=(0.3, *HERE[1:]))
    assert (end.end, end.reason) == (MotionOutcome.AUTHORITY_LOST, "REVOKED")


# ------------------------------------------------------------------------------------------------------------ its speed

FULL_SPEED = RemainingVerdict(holds=True, index_milli=900, cause="", fault="", age_ms=20, pace=1.0)
NOT_SO_FAST = RemainingVerdict(holds=False, index_milli=2_100, cause="person", fault="", age_ms=20, pace=0.4)
SLOW_IS_WELL = RemainingVerdict(holds=True, index_milli=900, cause="", fault="", age_ms=20, pace=0.4)


def slowed(scene, told=NOT_SO_FAST):
    """From 0.05 rad on the motion is told to be slower."""
    scene.asked = []

    def left(request, q_rad, *, authorised_milli, touch, running, oldest_ms):
        scene.asked.append(running)
        if q_rad[0] <= 0.05:
            return FULL_SPEED
        return told if running > 0.4 else SLOW_IS_WELL

    scene.left = left


def test_it_is_slowed_and_arrives_and_the_slider_is_where_it_was(scene):
    scene.arm.slider = scene.arm.scaling = 0.9  # where a person has it
    slowed(scene)
    end, permit = followed(scene, governed=True)
    assert end.end is MotionOutcome.REACHED
    assert [(c.fraction, c.cause) for c in end.changes] == [(0.4, "person"), (1.0, "ended")]
    assert all(c.confirmed_ms is not None for c in end.changes)
    assert scene.arm.sliders == [pytest.approx(0.399), 0.9]
    assert (scene.asked[0], scene.asked[-1]) == (1.0, 0.4)
    watched = permit.watched
    assert watched["outcome"] == "reached"
    assert [(c["percent"], c["cause"]) for c in watched["speed"]] == [(40, "person"), (100, "ended")]
    assert watched["speed"][0]["t_ms"] <= watched["speed"][0]["t_confirmed_ms"] <= scene.clock.mono


def test_without_a_governor_nobody_asks_about_another_speed(scene):
    slowed(scene)
    scene.left = lambda *_, running, **__: scene.asked.append(running) or NOT_SO_FAST
    end, _ = followed(scene)
    assert (end.end, end.changes, scene.arm.sliders) == (MotionOutcome.WORLD_CHANGED, (), [])
    assert set(scene.asked) == {None}


@pytest.mark.parametrize(("refuses", "seen"), [(False, "not slowed"), (True, "not set")])
def test_a_slider_that_does_nothing_ends_it(scene, refuses, seen):
    scene.arm.stuck, scene.arm.failed = True, refuses
    slowed(scene)
    end, permit = followed(scene, speed=0.3, governed=True)
    assert (end.end, end.reason) == (MotionOutcome.WORLD_CHANGED, Reason.IMPACT_ROSE)
    assert seen in permit.watched["seen"]
    assert permit.watched["speed"][0]["t_confirmed_ms"] is None
    assert 0 < scene.arm.q < THERE[0]


def test_nothing_slower_ends_it_and_no_slider_is_touched(scene):
    slowed(scene, replace(NOT_SO_FAST, pace=None))
    end, permit = followed(scene, governed=True)
    assert (end.end, end.reason, end.changes) == (MotionOutcome.WORLD_CHANGED, Reason.IMPACT_ROSE, ())
    assert scene.arm.sliders == []
    assert "speed" not in permit.watched


@pytest.mark.parametrize("how", ["stopped", "forsaken"])
def test_a_slowed_move_that_is_ended_leaves_the_slider_where_it_was(scene, how):
    slowed(scene)
    follower, _ = follower_of(scene, speed=0.3, governed=True)
    scene.when(lambda: scene.arm.scaling < 0.41, scene.arm.brake if how == "stopped" else follower.leave)
    end = follower.follow((TargetProgress(at(0.5)),))
    assert end.end is MotionOutcome.STOPPED
    assert scene.arm.sliders == [pytest.approx(0.399), 1.0]


@pytest.mark.parametrize("how", ["silent", "unstoppable"])
def test_an_arm_that_may_still_move_is_not_let_faster(scene, how, monkeypatch):
    """No standstill was seen, or the arm is seen to move: the slider stays low, and the record says so."""
    monkeypatch.setattr(standstill, "STOP_LIMIT_MS", 300)
    slowed(scene)

    def worse():
        setattr(scene.arm, how, True)
        scene.fault = REVOKED

    scene.when(lambda: scene.arm.scaling < 0.41, worse)
    end, _ = followed(scene, speed=0.3, governed=True)
    assert end.end is MotionOutcome.ROBOT_FAILED
    assert [change.cause for change in end.changes] == ["person"]
    assert scene.arm.sliders == [pytest.approx(0.399)]


def test_a_watch_that_breaks_after_it_slowed_down_stops_the_arm_before_it_may_be_faster(scene):
    slowed(scene)

    def broken(*, oldest_ms):
        raise ZeroDivisionError

    stood = []
    honest = scene.arm.set
    scene.arm.set = lambda fraction: (stood.append(scene.arm.target is None), honest(fraction))
    scene.when(lambda: scene.arm.scaling < 0.41, lambda: setattr(scene, "view", broken))
    with pytest.raises(ZeroDivisionError):
        followed(scene, speed=0.3, governed=True)
    assert (scene.arm.sliders, stood) == ([pytest.approx(0.399), 1.0], [False, True])


@pytest.mark.parametrize(("silent_ms", "put"), [(SILENCE_MS, True), (SILENCE_MS + 1, False)])
def test_an_arm_that_stood_when_it_was_last_heard_may_move_by_now(scene, silent_ms, put):
    governor = Governor(scene.arm, pacing=PACING, least=0.0, speeds=ReportedSpeeds(1.0, 1.0, 0), now_ms=0)
    governor.take(Offer(False, 0.4, 2_100, "person"), running=1.0, heard_ms=0, now_ms=0)
    arm = SimpleNamespace(
        look=lambda: True, silent_ms=silent_ms, state=scene.arm.read(), speeds=ReportedSpeeds(1.0, 1.0, 0)
    )
    put_back(governor, arm, clock=scene.clock, pause=scene.pause)
    assert [change.cause for change in governor.changes] == ["person", *(["ended"] if put else [])]


@pytest.mark.parametrize(
    ("speed", "acceleration", "least"), [(1.0, 1.4, 0.0189), (0.004, 1.4, 0.5), (1.0, 0.01, 0.2236), (0.002, 1.4, 1.0)]
)
def test_a_move_is_not_slowed_to_what_looks_like_standstill(speed, acceleration, least):
    assert least_fraction(speed, acceleration) == pytest.approx(least, abs=1e-4)


# ------------------------------------------------------------------------------------- paths, and ways until a contact


class Told:
    """Says what a test says."""

    def __init__(self, over=None):
        self.over, self.now_ms = over, 0

    def look(self, state):
        return self.over

    def monotonic_ms(self):
        return self.now_ms


def state(moving):
    return JointState((0.0,) * 6, (1.0 if moving else 0.0, *(0.0,) * 5), 7, 1)


@pytest.mark.clause("LSD-16")
def test_a_path_is_over_once_the_arm_has_moved_and_rests_at_its_end():
    told = Told(Over(MotionOutcome.REACHED))
    path = SettledProgress(told, told)
    assert path.look(state(moving=False)) is None  # it leads back to where it begins
    path.look(state(moving=True))
    assert path.look(state(moving=False)) is None  # it may go on from its end
    told.now_ms += SETTLED_MS - 1
    told.over = None
    assert path.look(state(moving=True)) is None
    told.over = Over(MotionOutcome.REACHED)
    told.now_ms += 2
    assert path.look(state(moving=False)) is None
    told.now_ms += SETTLED_MS
    assert path.look(state(moving=False)).outcome is MotionOutcome.REACHED


@pytest.mark.clause("LSD-16")
def test_a_path_that_fails_is_over_at_once():
    told = Told(Over(MotionOutcome.ROBOT_FAILED))
    assert SettledProgress(told, told).look(state(moving=True)).outcome is MotionOutcome.ROBOT_FAILED


@pytest.mark.clause("LSD-17")
def test_a_way_until_a_contact_is_over_with_its_command_or_its_time():
    clock, carried = Told(), []
    way = ContactProgress(TimedProgress(1_000, clock), lambda: bool(carried))
    assert way.look(state(moving=False)) is None  # it presses on something, and the script goes on
    carried.append(True)
    assert way.look(state(moving=True)) is None
    assert way.look(state(moving=False)).outcome is MotionOutcome.REACHED
    carried.clear()
    clock.now_ms = 1_000
    over = way.look(state(moving=False))
    assert (over.outcome, over.stop) == (MotionOutcome.ENDED, Reason.VERDICT_EXPIRED)
