"""Latching and its causes: ends of motions and leases, safety modes, a process that ended in between."""

import asyncio
import secrets
from dataclasses import replace
from types import SimpleNamespace

import pytest
from capabilities.statements.people.latch import LatchCause
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Tier
from pep.base.errors import JournalError, PepFault
from pep.base.ports import Assessed, RemainingVerdict
from pep.journal.file_journal import FileJournal
from pep.people.ask_composer import Asker
from pep.people.latch_file import LatchFile
from pep.people.latches import LATCHED, RETREAT, Latches
from pep.perception.sensor_frames import Seen
from pep.rtde.command import command_values as v
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.judge.latching import Latching, interrupted, lost_with, stop_of
from pep.rtde.motion.motion_follower import TargetProgress
from pep.rtde.motion.motions import Motions
from pep.rtde.motion.standstill import MotionEnd
from pep.rtde.robot.newest_state import NewestState
from pep.watch.watch import MotionOutcome
from policies.evidence.evidence import NOT_COLLECTED
from tests.pep.kit import AUDIENCE, FailingJournal, Registry, reading
from tests.pep.rtde.motion.moved_arm import HERE, THERE, Scene

from capabilities.keys import keys

pytestmark = pytest.mark.clause("LSD-21")
END = MotionEnd(MotionOutcome.REACHED, HERE)
PERMIT = SimpleNamespace(tier=Tier.CONSEQUENTIAL, request_id="ab" * 16, watched=None)


def ended(outcome, reason=""):
    return replace(END, end=outcome, reason=reason)


@pytest.mark.parametrize(
    ("end", "options", "cause"),
    [
        (ended(MotionOutcome.REACHED), {}, None),
        (ended(MotionOutcome.ENDED), {}, None),
        (ended(MotionOutcome.STOPPED), {}, None),
        (ended(MotionOutcome.STOPPED), {"late": True}, LatchCause.WATCH),
        (ended(MotionOutcome.WORLD_CHANGED, "IMPACT_ROSE"), {}, LatchCause.WATCH),
        (ended(MotionOutcome.AUTHORITY_LOST, "REVOKED"), {}, LatchCause.AUTHORITY),
        (ended(MotionOutcome.ROBOT_FAILED, "moved True"), {}, LatchCause.ROBOT_FAILED),
        (ended(MotionOutcome.ROBOT_FAILED, "safety mode 3"), {"safety_mode": 3}, LatchCause.SAFETY_STOP),
        (ended(MotionOutcome.STOPPED), {"safety_mode": 7}, LatchCause.SAFETY_STOP),
        (ended(MotionOutcome.REACHED), {"safety_mode": 2}, None),
        (ended(MotionOutcome.REACHED), {"safety_mode": None}, None),
        (None, {}, LatchCause.ROBOT_FAILED),
    ],
)
def test_each_end_of_a_motion_latches_as_it_says(end, options, cause):
    stop = stop_of(end, PERMIT, **{"late": False, "safety_mode": 1, **options})
    assert (None if stop is None else stop.cause) is cause
    if stop is not None:
        assert (stop.tier, stop.request_id) == (Tier.CONSEQUENTIAL, "ab" * 16)
        assert " " not in stop.reason


def test_the_tier_is_the_acts_or_the_higher_one_that_was_seen():
    end = ended(MotionOutcome.WORLD_CHANGED, "IMPACT_ROSE")

    def tier(**changes):
        permit = SimpleNamespace(**{**vars(PERMIT), **changes})
        return stop_of(end, permit, late=False, safety_mode=1).tier

    assert tier(watched={"index_milli": 3_001}) is Tier.SAFETY_CRITICAL
    assert tier(watched={"index_milli": 9_000}) is Tier.SAFETY_CRITICAL
    assert tier(watched={"index_milli": 100}) is Tier.CONSEQUENTIAL
    assert tier(watched={"index_milli": None}) is Tier.CONSEQUENTIAL
    assert tier(tier=None) is None


@pytest.mark.parametrize(
    ("ending", "cause"),
    [
        (LeaseEnding.CLOSED, None),
        (LeaseEnding.GATEWAY, None),
        (LeaseEnding.STOPPED, None),
        (LeaseEnding.LEFT, LatchCause.CLIENT_LOST),
        (LeaseEnding.CUT, LatchCause.CLIENT_LOST),
        (LeaseEnding.SILENT, LatchCause.CLIENT_LOST),
        (LeaseEnding.MALFORMED, LatchCause.CLIENT_LOST),
        (LeaseEnding.AUTHORITY, LatchCause.AUTHORITY),
        (LeaseEnding.ROBOT, LatchCause.ROBOT_FAILED),
    ],
)
def test_each_end_of_a_lease_in_the_midst_of_a_motion(ending, cause):
    stop = lost_with(ending, PERMIT)
    assert (None if stop is None else stop.cause) is cause


def record(kind, request_id, *, operation="move_joint", tier=2, effect="PERMIT"):
    if kind == "outcome":
        return {"kind": kind, "body": {"request_id": request_id}}
    request = {"id": request_id, "object": "ur3e", "operation": operation}
    return {"kind": kind, "body": {"request": request, "decision": {"effect": effect, "tier": tier}}}


def test_a_motion_without_an_outcome_was_interrupted():
    records = [
        record("decision", "done"),
        record("outcome", "done"),
        record("decision", "denied", effect="DENY"),
        record("decision", "looked", operation="read_state"),
        {"kind": "incident", "body": {}},
        record("decision", "left", tier=3),
        record("decision", "unknown", tier=None),
    ]
    assert [(stop.request_id, stop.tier) for stop in interrupted(records)] == [
        ("left", Tier.HIGH_CONSEQUENCE),
        ("unknown", None),
    ]


class Robot:
    """The latch of a scene's arm, with a journal and a file."""

    def __init__(self, path):
        self.scene = scene = Scene()
        self.path, self.impact, self.halted, self.counts, self.told = path, reading(), True, 0, []
        self.causes = frozenset(LatchCause)
        self.journal = FileJournal.open(path / "journal.ndjson", pep_id="pep-1", clock=scene.clock)
        self.latching = self.made(self.journal)
        self.motions = Motions(
            starts=scene,
            hurry=lambda moving: None,
            state=scene.arm,
            stopper=scene.arm,
            clock=scene.clock,
            pause=scene.pause,
            ended=lambda *args, **named: self.latching.after(*args, **named),
        )

    def made(self, journal):
        self.latches = Latches(
            LatchFile(self.path / "latch.json"),
            journal=journal,
            clock=self.scene.clock,
            author=Asker(pep="pep-1", audience=AUDIENCE, issuer="https://idp.example", key=keys.generate()),
            robot="ur3e",
            causes=self.causes,
            approvers=Registry(),
            caps=CAPS,
            new_id=lambda: secrets.token_hex(16),
        )
        return Latching(
            self.latches,
            starts=self.scene,
            ways=self,
            newest=self.scene.arm.newest,
            halted=lambda: self.halted,
            under_way=lambda: self.motions.under_way,
            counted=self.count,
            audience=AUDIENCE,
            clock=self.scene.clock,
            failed=self.told.append,
        )

    def assess(self, request, *, touch):
        return Assessed(self.impact, NOT_COLLECTED)

    def count(self):
        assert self.latches.latch_id is not None, "in force before earlier permits are void"
        self.counts += 1

    def kinds(self):
        return [record["kind"] for record in self.journal.records()]

    def moved(self, event=None, *, brake=None, **permit):
        """A motion to its end, with an event on its way."""
        scene = self.scene
        if event is not None:
            scene.past(0.1, event)
        made = scene.permit(name="ab" * 16, tier=Tier.CONSEQUENTIAL, **permit)

        async def go():
            arm = NewestState(scene.arm, scene.clock)
            watch = scene.watching(made)
            scene.arm.take(v.MoveJ(THERE, 0.5, 1.4, asynchronous=True))
            arm.sent()
            course = TargetProgress(lambda q_rad: abs(q_rad[0] - THERE[0]) <= 1e-3)
            assert self.motions.under_way is None
            try:
                return await self.motions.follow((course,), arm, watch, made, brake=brake or scene.arm.brake)
            finally:
                assert self.motions.under_way is None

        return asyncio.run(go())

    def look(self):
        """One turn of what the gateway does beside everything."""

        async def once():
            running = asyncio.create_task(self.latching.run())
            await asyncio.sleep(0)
            for _ in range(400):
                await asyncio.sleep(0.005)
                if self.latches.in_force is None or self.latches.in_force.text or self.told:
                    break
            running.cancel()

        asyncio.run(once())


@pytest.fixture
def robot(tmp_path):
    robot = Robot(tmp_path)
    yield robot
    robot.latching.close()
    robot.motions.close()
    robot.journal.close()


def test_an_ordinary_motion_latches_nothing_and_writes_nothing(robot):
    assert robot.moved().end is MotionOutcome.REACHED
    assert (robot.latches.latch_id, robot.counts, robot.kinds()) == (None, 0, [])


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda s: setattr(s, "seen", Seen((), 151)), LatchCause.WATCH),
        (lambda s: setattr(s, "rest", RemainingVerdict(False, 3_400, "person bob", "", 20)), LatchCause.WATCH),
        (lambda s: setattr(s, "fault", Fault(FaultCode.REVOKED, "TOK-9")), LatchCause.AUTHORITY),
        (lambda s: setattr(s.arm, "mode", 3), LatchCause.SAFETY_STOP),
    ],
)
def test_a_motion_that_was_stopped_has_its_latch_on_disk_before_anybody_learns_its_end(robot, change, cause):
    robot.moved(lambda: change(robot.scene))
    latch = robot.latches.in_force.latch
    assert (latch.cause, latch.request_id, robot.counts) == (cause, "ab" * 16, 1)
    assert latch.tier is (Tier.SAFETY_CRITICAL if robot.scene.rest.index_milli == 3_400 else Tier.CONSEQUENTIAL)
    assert robot.kinds() == [LATCHED]
    assert (robot.path / "latch.json").exists()


def test_a_program_that_is_lost_latches_while_its_motion_is_still_being_stopped(robot):
    def lost():
        robot.latching.lease_ended(LeaseEnding.CUT)
        robot.scene.arm.stopped_ms = robot.scene.clock.mono
        robot.scene.arm.halt()

    assert robot.moved(lost).end is MotionOutcome.STOPPED
    assert robot.latches.in_force.latch.cause is LatchCause.CLIENT_LOST
    assert robot.kinds() == [LATCHED]


def test_a_safety_stop_that_is_seen_before_its_motion_has_ended_is_of_the_motions_tier(robot):
    def stopped():
        robot.scene.arm.mode = 3
        robot.latching.look()

    robot.moved(stopped)
    latch = robot.latches.in_force.latch
    assert (latch.cause, latch.tier, latch.request_id) == (LatchCause.SAFETY_STOP, Tier.CONSEQUENTIAL, "ab" * 16)


@pytest.mark.clause("LIV-2", "LSD-21")
def test_a_stop_whose_caller_nobody_knows_latches_where_the_policies_name_it_and_nowhere_else(robot):
    def stopped():
        robot.latching.asked()
        robot.scene.arm.stopped_ms = robot.scene.clock.mono
        robot.scene.arm.halt()

    robot.causes = frozenset(LatchCause) - {LatchCause.ASKED}
    robot.latching.close()
    robot.latching = robot.made(robot.journal)
    assert robot.moved(stopped).end is MotionOutcome.STOPPED
    assert robot.latches.latch_id is None
    robot.causes = frozenset({LatchCause.ASKED})
    robot.latching.close()
    robot.latching = robot.made(robot.journal)
    robot.latching.asked()
    latch = robot.latches.in_force.latch
    assert (latch.cause, latch.tier, latch.request_id) == (LatchCause.ASKED, Tier.NO_EFFECT, "")


@pytest.mark.clause("LIV-7", "LSD-21")
@pytest.mark.parametrize("later_ms", [None, 60_000, 60_001])
def test_a_known_persons_word_latches_with_the_act_that_it_or_a_stop_just_before_it_has_ended(robot, later_ms):
    """The signature comes after the stop, and the latch is of the act that was stopped."""
    robot.causes = frozenset()
    robot.latching.close()
    robot.latching = robot.made(robot.journal)

    def stopped():
        robot.latching.asked("bob" if later_ms is None else "")
        robot.scene.arm.stopped_ms = robot.scene.clock.mono
        robot.scene.arm.halt()

    robot.moved(stopped)
    if later_ms is not None:
        assert robot.latches.latch_id is None, "nobody is known yet"
        robot.latching._asked = robot.latching._asked[0], robot.scene.clock.monotonic_ms()
        robot.scene.clock.advance(later_ms)
        robot.latching.asked("bob")
    latch = robot.latches.in_force.latch
    stopped_act = (Tier.CONSEQUENTIAL, "ab" * 16) if later_ms != 60_001 else (Tier.NO_EFFECT, "")
    assert (latch.cause, latch.person, (latch.tier, latch.request_id)) == (LatchCause.ASKED, "bob", stopped_act)
    assert robot.counts == 1
    asyncio.run(robot.latching.keep())
    assert robot.kinds() == [LATCHED]


def test_a_program_that_leaves_a_standing_arm_latches_nothing(robot):
    robot.latching.lease_ended(LeaseEnding.LEFT)
    assert robot.latches.latch_id is None


def test_a_safety_stop_of_a_standing_arm_latches_once(robot):
    robot.latching.look()
    assert robot.latches.latch_id is None
    robot.scene.arm.mode = 7
    robot.latching.look()
    first = robot.latches.latch_id
    assert robot.latches.in_force.latch.cause is LatchCause.SAFETY_STOP
    robot.look()
    assert robot.latches.latch_id == first, "the same stop is no further one"


@pytest.mark.clause("LSD-23")
def test_the_way_out_is_worked_out_once_the_arm_stands(robot):
    robot.moved(lambda: setattr(robot.scene, "seen", Seen((), 151)))
    robot.look()
    found = robot.latches.in_force
    (way,) = found.latch.retreat
    assert way.target_urad == (0,) * 6, "back to where it began, as mild as any other"
    assert found.text
    assert robot.kinds() == [LATCHED, RETREAT]


@pytest.mark.clause("LSD-23")
def test_while_a_stop_is_under_way_none_is_worked_out_and_in_the_end_people_are_told_all_the_same(robot):
    robot.halted = False
    robot.moved(lambda: setattr(robot.scene, "seen", Seen((), 151)))
    assert not robot.latching.stands
    robot.look()
    robot.scene.clock.advance(20_000)
    robot.look()
    assert (robot.latches.in_force.latch.no_retreat, bool(robot.latches.in_force.text)) == ("ROBOT_NOT_RUNNING", True)


def test_a_disk_that_is_full_keeps_it_latched_and_is_told(robot):
    robot.latching = robot.made(FailingJournal(robot.journal))
    robot.moved(lambda: setattr(robot.scene, "seen", Seen((), 151)))
    assert robot.latches.latch_id is not None
    (error,) = robot.told
    assert isinstance(error, JournalError)
    assert error.code is PepFault.JOURNAL_BROKEN
