"""Watch: each cause ends a motion at the first look that can know of it, and nothing else does.

Time, frames, authority and physics are injected; a look is one call.
"""

import random
from concurrent.futures import Future
from dataclasses import dataclass, field

import pytest
from capabilities.values.errors import Fault, FaultCode
from pep.base.ports import RemainingVerdict
from pep.perception.sensor_frames import Distrusted, FrameFault, RejectedFrame, Seen, Unseen
from pep.request.permit import Permit
from pep.watch.governor import Governor, Pacing, ReportedSpeeds
from pep.watch.watch import LOOK_MS, UNCHANGED_PERIOD_MS, Alarm, MotionOutcome, Watch, WatchAges
from policies.words.reason_table import Reason
from tests.pep.kit import ManualClock

from pep.pit import CellParameters

HERE = (0.0,) * 6
TRANSIT_MS = 20
FRAME_MS = 50
AUTHORISED = 1_200
LIMITS = WatchAges.of(CellParameters())
PACING = Pacing.of(CellParameters())


@dataclass
class Shown:
    """A frame, as far as the watch looks at one."""

    sequence: int
    arrived_ms: int
    people: tuple = ()
    objects: tuple = ()
    complete: bool = True
    sensor: str = "camera-1"

    @property
    def observation(self):
        return self


@dataclass
class World:
    """Everything around one watch. `step` is one pause and one look."""

    clock: ManualClock = field(default_factory=ManualClock)
    fault: Fault | None = None
    silent: bool = False
    override: object = None
    slow_ms: int = 0
    sighted: bool = True
    request: object = "the request"
    walking: bool = False
    governed: bool = False
    speeds: tuple = (1.0, 1.0)

    def __post_init__(self):
        self.slider, self.runnings = [], []
        self.failed = False
        self.governor = None
        if self.governed:
            self.governor = Governor(
                self, pacing=PACING, least=0.0, speeds=self.heard(), now_ms=self.clock.monotonic_ms()
            )

        self.frame = Shown(1, self.clock.mono)
        self.rest = lambda: {"holds": True, "index_milli": 1_000, "cause": "", "fault": ""}
        self.left_asked, self.pending = [], []
        self.watch = Watch(
            self.permit(),
            remaining=self,
            views=self,
            limits=LIMITS,
            clock=self.clock,
            submit=self.submit,
            governor=self.governor,
        )

    def heard(self):
        return ReportedSpeeds(*self.speeds, self.clock.mono)

    def set(self, fraction):
        self.slider.append(fraction)

    def permit(self):
        return Permit(
            request_id="r",
            digest="d",
            since_ms=self.clock.mono,
            deadline_ms=self.clock.mono,
            clock=self.clock,
            standing=self.standing,
            request=self.request,
            index_milli=AUTHORISED,
            sighted=self.sighted,
            touch=frozenset({"table"}),
        )

    def standing(self):
        return self.fault

    def view(self, *, oldest_ms=None):
        if self.override is not None:
            return self.override
        if oldest_ms is not None and self.age_ms > oldest_ms:
            return Unseen()
        return Seen((self.frame,), self.age_ms)

    @property
    def age_ms(self):
        return self.clock.mono - self.frame.arrived_ms + TRANSIT_MS

    def left(self, request, q_rad, *, authorised_milli, touch, running, oldest_ms):
        assert oldest_ms == (None if self.sighted else LIMITS.view_ms)
        assert (request, authorised_milli, touch) == ("the request", AUTHORISED, frozenset({"table"}))
        self.left_asked.append((self.clock.mono, q_rad))
        self.runnings.append(running)
        rest = self.rest()
        if isinstance(rest, Exception):
            raise rest
        return RemainingVerdict(**{"age_ms": self.age_ms, "shown": self.view().content, **rest})

    def submit(self, judge):
        """The judgement is made now, and known `slow_ms` later."""
        judging = Future()
        try:
            self.pending.append((self.clock.mono + self.slow_ms, judging, judge(), None))
        except Exception as error:
            self.pending.append((self.clock.mono + self.slow_ms, judging, None, error))
        self.finish()
        return judging

    def finish(self):
        for due, judging, rest, error in self.pending:
            if due <= self.clock.mono and not judging.done():
                judging.set_exception(error) if error else judging.set_result(rest)

    def step(self, ms=LOOK_MS, q_rad=HERE):
        self.clock.advance(ms)
        while not self.silent and self.clock.mono - self.frame.arrived_ms >= FRAME_MS:
            people = (self.frame.sequence + 1,) if self.walking else self.frame.people
            self.frame = Shown(self.frame.sequence + 1, self.frame.arrived_ms + FRAME_MS, people)
        self.finish()
        return self.watch.look(q_rad, self.heard())

    def run(self, ms, step_ms=LOOK_MS):
        """Looks for so long; the first alarm, or None."""
        until = self.clock.mono + ms
        while self.clock.mono < until:
            alarm = self.step(step_ms)
            if alarm is not None:
                return alarm
        return None


@pytest.fixture
def world():
    return World()


def told(alarm):
    assert isinstance(alarm, Alarm), "nothing was seen"
    return alarm.end, alarm.reason


def test_what_goes_on_as_authorised_goes_on(world):
    assert world.run(10_000) is None


@pytest.mark.parametrize("code", [FaultCode.REVOKED, FaultCode.REVOCATION_VIEW_STALE, FaultCode.EXPIRED])
@pytest.mark.parametrize("sighted", [True, False])
def test_lost_authority_is_seen_at_the_next_look(code, sighted):
    world = World(sighted=sighted)
    assert world.run(1_000) is None
    world.fault, lost_ms = Fault(code, "TOK-9"), world.clock.mono
    alarm = world.run(1_000)
    assert told(alarm) == (MotionOutcome.AUTHORITY_LOST, str(code))
    assert alarm.seen_ms - lost_ms <= LOOK_MS


def test_a_silent_sensor_is_seen_when_its_last_frame_is_too_old(world):
    assert world.run(1_000) is None
    world.silent = True
    alarm = world.run(1_000)
    assert told(alarm) == (MotionOutcome.WORLD_CHANGED, Reason.WATCH_BLIND)
    assert LIMITS.view_ms < world.age_ms <= LIMITS.view_ms + LOOK_MS


def test_the_age_of_a_view_counts_its_transit(world):
    world.silent, world.override = True, Seen((world.frame,), LIMITS.view_ms)
    assert world.step() is None
    world.override = Seen((world.frame,), LIMITS.view_ms + 1)
    assert told(world.step()) == (MotionOutcome.WORLD_CHANGED, Reason.WATCH_BLIND)


def test_a_lost_view_is_blindness(world):
    world.override = Unseen()
    assert told(world.step()) == (MotionOutcome.WORLD_CHANGED, Reason.WATCH_BLIND)


@pytest.mark.parametrize("sighted", [True, False])
def test_a_frame_that_must_not_be_believed_ends_every_motion(sighted):
    world = World(sighted=sighted)
    world.override = Distrusted(RejectedFrame(FrameFault.UNTRUSTED, "camera-1"))
    assert told(world.step()) == (MotionOutcome.WORLD_CHANGED, Reason.PERCEPTION_INVALID)


def test_an_index_above_the_authorised_one_is_seen_with_the_frame_that_shows_it(world):
    assert world.run(1_000) is None
    changed_ms, world.walking = world.clock.mono, True
    world.rest = lambda: {"holds": False, "index_milli": 2_600, "cause": "person bob", "fault": ""}
    alarm = world.run(1_000)
    assert told(alarm) == (MotionOutcome.WORLD_CHANGED, Reason.IMPACT_ROSE)
    assert (alarm.index_milli, alarm.authorised_milli, alarm.what) == (2_600, AUTHORISED, "person bob")
    assert alarm.seen_ms - changed_ms <= FRAME_MS + 2 * LOOK_MS


def test_every_frame_that_shows_something_else_is_judged():
    world = World(walking=True)
    shown = []
    for _ in range(100):
        world.step()
        shown.append(world.frame.arrived_ms)
    judged = [at_ms for at_ms, _ in world.left_asked]
    for arrived_ms in sorted(set(shown))[:-1]:
        assert any(0 <= at_ms - arrived_ms <= 2 * LOOK_MS for at_ms in judged), arrived_ms


def test_what_shows_the_same_is_judged_again_from_where_the_arm_is(world):
    for n in range(100):
        assert world.step(q_rad=(n * 0.01,) * 6) is None
    asked = world.left_asked
    assert all(0 <= b[0] - a[0] - UNCHANGED_PERIOD_MS <= LOOK_MS for a, b in zip(asked, asked[1:]))
    assert len({q_rad for _, q_rad in asked}) == len(asked) > 5


def test_the_same_scene_stays_judged_while_its_frames_are_new():
    world = World(slow_ms=LIMITS.judged_ms - TRANSIT_MS - FRAME_MS - LOOK_MS)
    assert world.run(5_000) is None
    assert len(world.left_asked) < 5_000 / 100


def test_somebody_who_comes_and_goes_between_two_judgements_is_not_taken_for_nobody():
    """A held judgement rests on the frame of `left` itself, and that frame is compared."""
    world = World(slow_ms=40)
    assert world.run(500) is None
    asked = len(world.left_asked)
    world.frame = Shown(98, world.clock.mono, ("bob",))
    assert world.step() is None
    assert world.step(25) is None
    assert len(world.left_asked) > asked


@pytest.mark.parametrize("fault", [Reason.PERCEPTION_INVALID, Reason.PHYSICS_FAULT, Reason.ENGINES_DISAGREE])
def test_a_fault_of_physics_is_no_index(world, fault):
    world.rest = lambda: {"holds": True, "index_milli": 0, "cause": "", "fault": str(fault)}
    assert told(world.run(1_000)) == (MotionOutcome.WORLD_CHANGED, fault)


def test_physics_that_breaks_is_a_fault(world):
    world.rest = lambda: ZeroDivisionError()
    assert told(world.run(1_000)) == (MotionOutcome.WORLD_CHANGED, Reason.PHYSICS_FAULT)


def test_slow_physics_delays_no_look_at_authority():
    world = World(slow_ms=LIMITS.judged_ms - TRANSIT_MS - FRAME_MS - 4 * LOOK_MS)
    world.run(80)
    world.fault, lost_ms = Fault(FaultCode.REVOKED, "TOK-9"), world.clock.mono
    alarm = world.run(1_000)
    assert told(alarm) == (MotionOutcome.AUTHORITY_LOST, "REVOKED")
    assert alarm.seen_ms - lost_ms <= LOOK_MS


def test_a_judgement_that_does_not_come_is_late():
    world = World(slow_ms=10_000)
    began_ms = world.clock.mono
    alarm = world.run(2_000)
    assert told(alarm) == (MotionOutcome.WORLD_CHANGED, Reason.WATCH_LATE)
    assert LIMITS.judged_ms < alarm.seen_ms - began_ms <= LIMITS.judged_ms + LOOK_MS


def test_a_judgement_of_frames_that_were_too_old_is_late(world):
    assert world.run(500) is None
    world.walking, older = True, Seen((Shown(1, 0, ("older",)),), 0).content
    judged = {"holds": True, "index_milli": 0, "cause": "", "fault": "", "age_ms": LIMITS.judged_ms + 1, "shown": older}
    world.rest = lambda: judged
    assert told(world.run(500)) == (MotionOutcome.WORLD_CHANGED, Reason.WATCH_LATE)


def test_a_motion_that_nobody_can_judge_does_not_last():
    assert told(World(request=None).run(1_000)) == (MotionOutcome.WORLD_CHANGED, Reason.WATCH_LATE)


def test_a_watch_that_looks_too_seldom_is_blind_itself(world):
    assert world.run(500) is None
    world.frame = Shown(99, world.clock.mono + LIMITS.look_ms)
    assert world.step(LIMITS.look_ms) is None
    world.frame = Shown(100, world.clock.mono + LIMITS.look_ms)
    assert told(world.step(LIMITS.look_ms + 1)) == (MotionOutcome.WORLD_CHANGED, Reason.WATCH_LATE)


def test_lost_authority_leads_a_late_look(world):
    world.fault = Fault(FaultCode.REVOKED, "TOK-9")
    assert told(world.step(LIMITS.look_ms + 1)) == (MotionOutcome.AUTHORITY_LOST, "REVOKED")


def test_what_was_permitted_without_a_view_is_watched_for_what_can_be_seen():
    world = World(sighted=False)
    world.override = Unseen()
    assert world.run(2_000) is None
    world.override, world.silent = None, True
    assert world.run(2_000) is None, "a view that grows old is no more than what it was given on"
    world.silent = False
    assert world.run(1_000) is None
    world.rest = lambda: {"holds": False, "index_milli": 3_500, "cause": "person bob", "fault": ""}
    assert told(world.run(1_000)) == (MotionOutcome.WORLD_CHANGED, Reason.IMPACT_ROSE)


def test_the_limits_are_those_of_the_stop_model():
    cell = CellParameters()
    assert LIMITS == WatchAges(view_ms=150, judged_ms=210, look_ms=150)
    assert LIMITS.judged_ms == (cell.watch_age_limit_s + cell.reaction_s) * 1000


@pytest.mark.parametrize("seed", range(20))
def test_whatever_comes_when_it_is_seen_in_time(seed):
    """Random pace of looks, of physics and of frames; one random cause at a random instant."""
    chance = random.Random(seed)
    world = World(slow_ms=chance.randrange(0, 60))

    def pause():
        return chance.randrange(1, 25)

    until = world.clock.mono + chance.randrange(100, 3_000)
    while world.clock.mono < until:
        assert world.step(pause()) is None
    cause, at_ms = chance.choice(["authority", "blind", "rose", "invalid"]), world.clock.mono
    match cause:
        case "authority":
            world.fault, bound_ms = Fault(FaultCode.REVOKED, "TOK-9"), 25
            expected = (MotionOutcome.AUTHORITY_LOST, "REVOKED")
        case "blind":
            world.silent, bound_ms = True, LIMITS.view_ms + 25
            expected = (MotionOutcome.WORLD_CHANGED, Reason.WATCH_BLIND)
        case "rose":
            world.rest = lambda: {"holds": False, "index_milli": 2_000, "cause": "", "fault": ""}
            # the judgement under way, the period or the next frame, the judgement that shows it, and a look
            bound_ms = 2 * world.slow_ms + FRAME_MS + 3 * 25
            expected = (MotionOutcome.WORLD_CHANGED, Reason.IMPACT_ROSE)
        case _:
            world.override, bound_ms = Distrusted(RejectedFrame(FrameFault.UNTRUSTED, "")), 25
            expected = (MotionOutcome.WORLD_CHANGED, Reason.PERCEPTION_INVALID)
    alarm = None
    while alarm is None and world.clock.mono - at_ms < 5_000:
        alarm = world.step(pause())
    assert told(alarm) == expected
    assert alarm.seen_ms - at_ms <= bound_ms, (seed, cause)


SLOWER = {"holds": False, "index_milli": 2_100, "cause": "person", "fault": "", "pace": 0.4}


def test_without_a_governor_nothing_is_asked_about_other_speeds(world):
    world.run(500)
    assert set(world.runnings) == {None}
    world.rest = lambda: SLOWER
    assert told(world.run(500)) == (MotionOutcome.WORLD_CHANGED, Reason.IMPACT_ROSE)


def test_a_motion_that_may_go_slower_goes_on_and_is_judged_as_fast_as_it_is():
    world = World(governed=True, walking=True)
    assert world.run(500) is None
    assert set(world.runnings) == {1.0}
    world.rest = lambda: SLOWER
    assert world.step(FRAME_MS) is None
    assert world.step() is None
    assert len(world.slider) == 1
    assert world.slider[0] < 0.4
    world.rest = lambda: {"holds": True, "index_milli": 1_000, "cause": "", "fault": "", "pace": 0.4}
    for scaling in (0.9, 0.7, 0.5, world.slider[0]):
        world.speeds = (world.slider[0], scaling)
        assert world.run(2 * FRAME_MS) is None
        assert world.runnings[-1] == max(0.4, scaling)
    assert world.run(5_000) is None
    assert [change.fraction for change in world.governor.changes] == [0.4]


def test_a_motion_that_does_not_go_slower_ends_with_what_was_seen():
    world = World(governed=True, walking=True)
    assert world.run(500) is None
    world.rest, asked_ms = lambda: SLOWER, world.clock.mono
    alarm = world.run(2_000)
    assert told(alarm) == (MotionOutcome.WORLD_CHANGED, Reason.IMPACT_ROSE)
    assert "not slowed" in alarm.what
    assert alarm.seen_ms - asked_ms <= 350 + 2 * FRAME_MS


def test_no_speed_is_looked_for_where_there_is_none():
    world = World(governed=True, walking=True)
    assert world.run(500) is None
    world.rest = lambda: {**SLOWER, "pace": None}
    alarm = world.run(500)
    assert told(alarm) == (MotionOutcome.WORLD_CHANGED, Reason.IMPACT_ROSE)
    assert (alarm.index_milli, alarm.what) == (2_100, "person")
    assert world.slider == []


def test_an_arm_that_is_faster_again_than_it_was_slowed_to_ends():
    world = World(governed=True, walking=True)
    world.rest = lambda: SLOWER
    assert world.run(100) is None
    world.speeds = (0.39, 0.39)
    world.rest = lambda: {"holds": True, "index_milli": 1_000, "cause": "", "fault": "", "pace": 0.4}
    assert world.run(500) is None
    world.speeds = (0.41, 0.39)
    alarm = world.step()
    assert told(alarm) == (MotionOutcome.WORLD_CHANGED, Reason.IMPACT_ROSE)
    assert "faster" in alarm.what


def test_lost_authority_and_blindness_end_a_slowed_motion_too():
    for lose, reason in (
        (lambda world: setattr(world, "fault", Fault(FaultCode.REVOKED, "TOK-9")), "REVOKED"),
        (lambda world: setattr(world, "silent", True), Reason.WATCH_BLIND),
        (lambda world: setattr(world, "override", Unseen()), Reason.WATCH_BLIND),
        (lambda world: setattr(world, "rest", lambda: ZeroDivisionError()), Reason.PHYSICS_FAULT),
    ):
        world = World(governed=True, walking=True)
        world.rest = lambda: SLOWER
        assert world.run(100) is None
        lose(world)
        assert told(world.run(1_000))[1] == reason


def test_slow_physics_delays_no_look_at_the_speed():
    """A robot that does not slow down is seen while the judgement is still being made."""
    world = World(governed=True, walking=True)
    world.rest = lambda: SLOWER
    assert world.run(100) is None
    world.slow_ms, asked_ms = 80, world.clock.mono
    assert "not slowed" in world.run(1_000).what
    assert world.clock.mono - asked_ms <= 350


def test_the_time_to_slow_down_runs_from_the_question_not_from_its_answer():
    world = World(governed=True, walking=True, slow_ms=48)
    assert world.run(300) is None
    world.rest, known = lambda: SLOWER, len(world.left_asked)
    alarm = world.run(2_000)
    assert "not slowed" in alarm.what
    asked_ms = world.left_asked[known][0]
    assert world.governor.changes[0].at_ms >= asked_ms + 48
    assert asked_ms + 350 < alarm.seen_ms <= asked_ms + 350 + LOOK_MS
