"""A leased program before the real physics: lines, tool speeds and streams, and what the signed view does to them."""

import math
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from pep.pit.assessment.readiness import compile_all
from pep.pit.robot.inverse_kinematics import solved, stance
from pep.pit.robot.twist import Twist, turn_of
from pep.rtde.robot.state_receiver import JointState
from pep.watch.watch import Watch, WatchAges
from pep.world.arrival import arrived
from pep.world.cell_stream import CellStream, JointAngles, JointSpeeds, Judged
from pep.world.held_object import CommittedGrip
from policies.evidence.evidence import ImpactFault
from policies.words.reason_table import Reason
from tests.pep.pit.scenes import FRONT, HOME, ROBOT
from tests.pep.rtde.leased import played, until
from tests.pep.rtde.world import CELL, World

from pep.pit import JointLeg, JointPath, MoveJ, MoveL, SpeedL, adult_at_distance
from pep.rtde.command import command_values as v

pytestmark = pytest.mark.real_time

STILL = (0.0,) * 6
ANY = 4_000
SEED = b"a request's digest"
compile_all()


def pose(q=HOME, dz=0.0):
    here = stance(ROBOT, np.array(q))
    x, y, z = here.position.tolist()
    numbers = (x, y, z + dz, *turn_of(here.rotation).tolist())
    return tuple(round(number, 6) for number in numbers)


@pytest.fixture
def world(tmp_path, monkeypatch):
    monkeypatch.setattr("pep.gate.gate.PHYSICS_TIMEOUT_S", 60.0)
    monkeypatch.setattr("pep.world.cell_stream.STEP_S", 20.0)
    world = World(tmp_path)
    world.judging = ThreadPoolExecutor(1)
    yield world
    world.judging.shutdown()
    world.gate.close()
    world.journal.close()


LINE = v.MoveL(pose(dz=0.05), 0.1, 0.5, True)
TOOL_SPEED = v.SpeedL((0.0, 0.0, 0.05, 0.0, 0.0, 0.0), 0.5, 0.2)
SERVO = v.ServoJ((HOME[0] + 0.001, *HOME[1:]), 0.008, 0.1, 300.0)
SPEEDS = v.SpeedJ((0.1, 0.0, 0.0, 0.0, 0.0, 0.0), 0.5, 0.1)
NEAR = adult_at_distance(0.5, bearing_rad=FRONT)


def index_of(world):
    return world.records("decision")[-1]["body"]["decision"]["index_milli"]


@pytest.mark.parametrize("command", [LINE, TOOL_SPEED, SERVO, SPEEDS], ids=lambda c: type(c).__name__)
def test_in_an_empty_cell_it_is_forwarded_and_near_a_person_it_is_asked(world, command):
    world.at()
    assert world.decided(command).answers == ["forward"]
    free = index_of(world)
    assert 0 < free <= 2_000
    world.at(NEAR)
    answers = world.decided(replace(command, speed_m_s=0.5) if command is LINE else command).answers
    assert index_of(world) > free
    assert command is not LINE or answers == ["defer"]


def test_an_unreachable_line_is_refused(world):
    world.at()
    far = (0.9, *LINE.pose_m_rad[1:])
    assert world.decided(replace(LINE, pose_m_rad=far)).answers == [Reason.UNPROVEN]


def test_a_servo_target_that_no_joint_can_follow_is_refused(world):
    world.at()
    assert world.decided(replace(SERVO, q_rad=(HOME[0] + 1.5, *HOME[1:]))).answers == [Reason.ROBOT_LIMIT]


def test_a_tool_speed_is_assessed_for_as_long_as_the_controller_would_hold_it(world):
    world.at()
    world.decided(TOOL_SPEED)
    (motion,) = world.physics._motions.values()
    assert isinstance(motion, SpeedL)
    assert motion.duration_s == pytest.approx(0.2 + 0.3)


@pytest.mark.clause("LSD-29")
def test_a_tool_that_turns_as_it_goes_is_decided_as_the_joint_speeds_that_it_is_written_as(world):
    world.at()
    held = world.decided(replace(TOOL_SPEED, xd_m_s_rad_s=(0.0, 0.0, 0.05, 0.0, 0.1, 0.1)))
    assert held.answers == ["forward"]
    (motion,) = world.physics._motions.values()
    made = np.array(motion.target) - np.array(motion.start)
    assert made / np.abs(made).max() == pytest.approx(
        np.array(held.written.qd_rad_s) / max(map(abs, held.written.qd_rad_s)), abs=1e-6
    )


@pytest.mark.parametrize("command", [v.SetTcp((0.0, 0.0, 0.163, 0.0, 0.0, 0.0)), v.SetPayload(0.925, (0.0,) * 3)])
def test_what_changes_nothing_has_the_impact_of_an_arm_that_stands(world, command):
    world.at(NEAR)
    assert world.decided(command).answers == ["forward"]
    assert index_of(world) == 0


class Runner:
    """An arm that carries out what is forwarded to it, by the model."""

    def __init__(self, arm):
        self.arm, self.motion, self.began_s, self.q = arm, None, 0.0, HOME
        arm.here, arm.take, arm.halt = self.here, self.take, self.halt

    def take(self, command):
        self.q, self.began_s, self.motion = self.here().q_rad, time.monotonic(), command

    def halt(self):
        self.q, self.motion = self.here().q_rad, None
        self.arm.stopped_ms = self.arm.clock.monotonic_ms()

    def here(self):
        q, ahead = self._at(time.monotonic()), self._at(time.monotonic() + 0.001)
        qd = tuple((b - a) / 0.001 for a, b in zip(q, ahead, strict=True))
        return JointState(q, qd, 7, 1)

    def _at(self, now_s):
        done_s = now_s - self.began_s
        match self.motion:
            case v.MoveL(pose, speed):
                twist = Twist.between(ROBOT, self.q, pose)
                found = solved(ROBOT, twist.at(min(1.0, done_s * speed / twist.way_m)), np.array(self.q))
                return tuple(found.q.tolist())
            case v.MoveJ(there, speed):
                whole_s = max(abs(b - a) for a, b in zip(self.q, there, strict=True)) / speed
                done = min(1.0, done_s / whole_s) if whole_s else 1.0
                return tuple(a + done * (b - a) for a, b in zip(self.q, there, strict=True))
            case v.SpeedJ(qd):
                return tuple(q + done_s * speed for q, speed in zip(self.q, qd, strict=True))
            case _:
                return self.q


@pytest.mark.parametrize(
    ("command", "outcome"), [(replace(LINE, speed_m_s=0.05), "reached"), (replace(SPEEDS, time_s=0.5), "ended")]
)
def test_what_is_permitted_goes_on_to_its_end_under_the_watch(world, command, outcome):
    world.at()
    Runner(world.arm)
    world.arrived = world.physics.arrived
    limits = WatchAges(20_000, 20_000, 20_000)
    world.watching = lambda permit, *, remaining: Watch(
        permit,
        remaining=world.physics if remaining is world else remaining,
        views=world.frames,
        limits=limits,
        clock=world.clock,
        submit=world.judging.submit,
    )
    held = world.held(command)

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers)
        await until(world.outcomes)

    played(world, scenario)
    assert held.answers == ["forward"]
    assert world.outcomes()[0]["result"]["outcome"] == outcome


# -------------------------------------------------------------------------------------------------- the stream by itself


def stream(world, *people):
    world.at(*people)
    made = world.begin_stream(frozenset())
    made.see(HOME)
    return made


def at(qd=STILL):
    return JointState(HOME, qd, 7, 1)


def test_faster_is_never_less_and_a_person_nearby_is_more(world):
    def asked(made, speed):
        return made.judge(JointSpeeds((speed, *STILL[1:]), 1.0), at(), authorised_milli=ANY, seed=SEED).index_milli

    empty, crowded = stream(world), stream(world, NEAR)
    speeds = (0.0, 0.05, 0.1, 0.3, 0.6)
    assert [asked(empty, s) for s in speeds] == sorted(asked(empty, s) for s in speeds)
    assert asked(crowded, 0.6) > asked(empty, 0.6)


def test_how_the_arm_moves_now_counts_as_what_is_asked(world):
    made = stream(world)
    slow = made.judge(JointSpeeds(STILL, 1.0), at(), authorised_milli=ANY, seed=SEED)
    fast = made.judge(JointSpeeds(STILL, 1.0), at((0.6, *STILL[1:])), authorised_milli=ANY, seed=SEED)
    assert isinstance(slow, Judged)
    assert fast.index_milli > slow.index_milli
    assert fast.tcp_speed_m_s > 0.1


def test_speeds_that_the_arm_turns_to_are_judged_by_both_ways_at_once(world):
    made = stream(world)

    def asked(now):
        found = made.judge(JointSpeeds((0.2, *STILL[1:]), 1.0), at((now, *STILL[1:])), authorised_milli=ANY, seed=SEED)
        return found.index_milli

    assert asked(0.1) == asked(0.0)  # it takes them up
    assert asked(-0.6) > asked(0.0)


def test_a_value_that_takes_too_long_to_judge_is_a_fault(world, monkeypatch):
    monkeypatch.setattr("pep.world.cell_stream.STEP_S", 1e-6)
    made = stream(world)
    settled = made.judge(JointSpeeds((0.1, *STILL[1:]), 1.0), at(), authorised_milli=1_000, seed=SEED)
    assert isinstance(settled, Judged)
    asked = made.judge(JointSpeeds((0.1, *STILL[1:]), 1.0), at((-0.9, *STILL[1:])), authorised_milli=1_000, seed=SEED)
    assert asked.reason == Reason.PHYSICS_FAULT


def test_a_target_is_judged_by_the_speed_that_makes_for_it(world):
    made = stream(world)
    near, far = (
        made.judge(JointAngles((HOME[0] + by, *HOME[1:]), 0.008, 0.1), at(), authorised_milli=ANY, seed=SEED)
        for by in (0.001, 0.05)
    )
    assert near.index_milli < far.index_milli


def test_a_stream_with_another_part_is_another_stream(world):
    world.at()
    holding = CommittedGrip(ROBOT, CELL)
    made = CellStream(holding=holding, cell=CELL, frames=world.frames, touch=frozenset(), clock=world.clock)
    made.see(HOME)
    holding.closed_on_unknown()
    found = made.judge(JointSpeeds(STILL, 1.0), at(), authorised_milli=ANY, seed=SEED)
    assert isinstance(found, ImpactFault)
    assert found.reason == Reason.PHYSICS_FAULT


def test_a_forged_view_is_no_view(world):
    made = stream(world)
    world.frames.admit(b"x")
    assert made.see(HOME).reason == Reason.PERCEPTION_INVALID


def test_a_person_who_comes_ends_the_stream_that_stands(world):
    world.at()
    world.watching = lambda permit, *, remaining: Watch(
        permit,
        remaining=remaining,
        views=world.frames,
        limits=WatchAges(20_000, 20_000, 20_000),
        clock=world.clock,
        submit=world.submit,
    )
    held = world.held(replace(SPEEDS, qd_rad_s=(0.5, *STILL[1:]), time_s=1.0))

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers)
        assert held.forwarded
        world.show(adult_at_distance(0.45, bearing_rad=FRONT))
        await until(world.outcomes)

    played(world, scenario)
    (outcome,) = world.outcomes()
    assert outcome["result"]["outcome"] == "world_changed"
    assert world.arm.stops[0] in {Reason.IMPACT_ROSE, Reason.PHYSICS_VIOLATION}


# ------------------------------------------------------------------------------------------------------------- arrival


def test_an_arm_has_arrived_where_the_motion_leads_and_nowhere_else():
    other = (HOME[0] + 0.5, *HOME[1:])
    near, off = (HOME[0] + 0.0009, *HOME[1:]), (HOME[0] + 0.0011, *HOME[1:])
    for motion in (
        MoveJ(other, HOME, 1.0, 1.0),
        JointPath(other, (JointLeg(other, 1.0, 1.0), JointLeg(HOME, 1.0, 1.0))),
    ):
        assert arrived(motion, ROBOT, near)
        assert not arrived(motion, ROBOT, off)
    line = MoveL(other, pose(), 0.1, 0.5)
    assert arrived(line, ROBOT, HOME)
    assert not arrived(line, ROBOT, (HOME[0] + 0.03, *HOME[1:]))  # 8 mm beside it
    assert not arrived(line, ROBOT, (*HOME[:5], HOME[5] + 0.03))  # turned
    assert not arrived(SpeedL(HOME, STILL, 1.0, 1.0), ROBOT, HOME)
    assert not arrived(None, ROBOT, HOME)
    assert math.dist(pose()[:3], pose(off)[:3]) < 0.001
