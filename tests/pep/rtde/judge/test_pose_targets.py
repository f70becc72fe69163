"""Commands that name a pose or joint angles alone: what is judged is written."""

from dataclasses import replace

import numpy as np
import pytest
from pep.pit.robot.inverse_kinematics import stance
from pep.rtde.judge.pose_targets import rewritten
from pep.rtde.robot.state_receiver import JointState
from pep.rtde.wire.refusal import InputRefusal
from pep.world.cell_stream import JointAngles, JointSpeeds
from policies.evidence.evidence import ImpactFault
from policies.words.reason_table import Reason
from tests.pep.kit import reading
from tests.pep.pit.lines import pose_of
from tests.pep.pit.scenes import HOME, ROBOT
from tests.pep.rtde.leased import POSES, House, leased_scope, played, until

from pep.rtde.command import command_values as v

pytestmark = [pytest.mark.real_time, pytest.mark.clause("LSD-14")]  # what is seen of the arm is old in 50 ms

THERE = tuple(q + 0.1 for q in HOME)
JOINTS = v.MoveJIk(pose_of(THERE), 0.5, 1.4, False)
LINE = v.MoveLFk(THERE, 0.1, 0.5, True)
FAR = (1.5, 0.0, 0.3, 0.0, 3.1, 0.0)
SERVO = v.ServoL(pose_of(THERE), 0.008, 0.1, 300.0)


@pytest.fixture
def house(tmp_path):
    house = House(tmp_path)
    house.starts = HOME
    house.arm.here = lambda: JointState(HOME, (0.0,) * 6, 7, 1)
    yield house
    house.gate.close()
    house.journal.close()


def decided(house, held):
    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers)

    played(house, scenario)
    return held


def test_a_pose_becomes_the_nearest_joint_angles_on_the_grid():
    found = rewritten(JOINTS, POSES, HOME)
    assert isinstance(found, v.MoveJ)
    assert (found.speed_rad_s, found.acceleration_rad_s2, found.asynchronous) == (0.5, 1.4, False)
    assert found.q_rad == tuple(round(q, 6) for q in found.q_rad)
    assert found.q_rad == pytest.approx(THERE, abs=1e-6)


def test_joint_angles_of_a_line_become_their_pose():
    found = rewritten(LINE, POSES, HOME)
    assert isinstance(found, v.MoveL)
    assert found.pose_m_rad == pytest.approx(pose_of(THERE), abs=1e-6)
    assert (found.speed_m_s, found.asynchronous) == (0.1, True)


def test_whatever_says_its_own_target_stays_as_it_is():
    for command in (v.MoveJ(THERE, 0.5, 1.4, False), SERVO, v.Clear()):
        assert rewritten(command, POSES, HOME) is command


def test_a_pose_without_joint_angles_is_refused():
    found = rewritten(replace(JOINTS, pose_m_rad=FAR), POSES, HOME)
    assert isinstance(found, InputRefusal)
    assert found.reason is Reason.UNPROVEN


def test_what_is_sent_is_what_was_decided(house):
    held = decided(house, house.held(JOINTS, before=house.arm.halt))
    assert held.answers == ["forward"]
    assert held.written == rewritten(JOINTS, POSES, HOME)
    (decision,) = house.records("decision")
    assert decision["body"]["request"]["operation"] == "move_joint"
    line = decided(house, house.held(LINE, before=house.arm.halt))
    assert line.written == rewritten(LINE, POSES, HOME)


def test_the_limits_of_the_operation_that_it_becomes_hold(house):
    house.holder = house.agent(scope=leased_scope(house.clock.wall_s(), without=("move_joint",)))
    assert decided(house, house.held(JOINTS)).answers == [Reason.NOT_GRANTED]


def test_an_unreachable_pose_is_refused_before_anything_is_asked(house):
    held = decided(house, house.held(replace(JOINTS, pose_m_rad=FAR)))
    assert held.answers == [Reason.UNPROVEN]
    assert not house.records("decision")
    assert held.written is None


# --------------------------------------------------------------------------------------------------- streams of poses


def opened(house, play, command=SERVO):
    held = house.held(command)

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers)
        play(held)

    played(house, scenario)
    return held


@pytest.mark.clause("LSD-15")
def test_each_pose_is_judged_and_written_as_joint_angles(house):
    house.physics.answer = reading(1, 900)

    def play(held):
        assert held.written == v.ServoJ(held.written.q_rad, 0.008, 0.1, 300.0)
        assert held.written.q_rad == pytest.approx(THERE, abs=1e-9)
        later = replace(SERVO, pose_m_rad=pose_of(tuple(q + 0.01 for q in THERE)))
        assert held.steps.step(later) is None
        assert held.steps.written(later).q_rad == pytest.approx([q + 0.01 for q in THERE], abs=1e-9)

    held = opened(house, play)
    assert held.answers == ["forward"]
    judged = [value for value, *_ in house.certifying.values]
    assert all(isinstance(value, JointAngles) for value in judged)
    assert judged[-1].q_rad == pytest.approx([q + 0.01 for q in THERE], abs=1e-9)


@pytest.mark.clause("LSD-15")
@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        (FAR, Reason.LIMIT_EXCEEDED_BY_REQUEST),
        ((0.9, *SERVO.pose_m_rad[1:]), Reason.UNPROVEN),
        (pose_of((*THERE[:4], 1e-3, THERE[5])), Reason.UNPROVEN),
    ],
)
def test_a_pose_outside_of_the_grant_or_without_clear_joint_angles_ends_the_stream(house, pose, reason):
    def play(held):
        assert held.steps.step(replace(SERVO, pose_m_rad=pose)) is reason
        assert held.steps.step(SERVO) is reason

    opened(house, play)


@pytest.mark.clause("LSD-15")
def test_a_pose_that_physics_does_not_take_ends_the_stream(house):
    def play(held):
        house.certifying.answer = ImpactFault(Reason.ROBOT_LIMIT, "too far")
        assert held.steps.step(SERVO) is Reason.ROBOT_LIMIT

    opened(house, play)


# --------------------------------------------------------------------------------------------------- streams of tool speeds

TOOL = v.SpeedL((0.05, 0.0, 0.0, 0.0, 0.0, 0.0), 0.25, 0.4)
TURNED = v.SpeedL((0.0, -0.03, 0.02, 0.0, 0.1, 0.2), 0.25, 0.4)
STILL = (0.0,) * 6
STRAIGHT = (*HOME[:4], 0.0, HOME[5])
"""Joint angles at which the wrist is singular."""


def twist_of(written, q=HOME):
    """Tool speed that written joint speeds make at joint angles."""
    return stance(ROBOT, np.array(q)).jacobian @ np.array(written.qd_rad_s)


@pytest.mark.clause("LSD-29")
def test_each_tool_speed_is_judged_and_written_as_the_joint_speeds_that_make_it(house):
    def play(held):
        assert twist_of(held.written) == pytest.approx(TOOL.xd_m_s_rad_s, abs=1e-9)
        assert held.steps.step(TURNED) is None, "another value follows without a request of its own"
        written = held.steps.written(TURNED)
        assert twist_of(written) == pytest.approx(TURNED.xd_m_s_rad_s, abs=1e-9)
        assert written.acceleration_rad_s2 / max(map(abs, written.qd_rad_s)) == pytest.approx(0.25 / 0.2)
        assert written.time_s <= 0.02, "the script hears of newer ones"
        still = replace(TOOL, xd_m_s_rad_s=(0.0,) * 6)
        assert held.steps.step(still) is None
        assert held.steps.written(still).qd_rad_s == (0.0,) * 6

    held = opened(house, play, TOOL)
    assert held.answers == ["forward"]
    assert len(house.records("decision")) == 1
    judged = [value for value, *_ in house.certifying.values]
    assert all(isinstance(value, JointSpeeds) for value in judged)
    assert judged[0].qd_rad_s == held.written.qd_rad_s


@pytest.mark.clause("LSD-29")
def test_a_tool_speed_that_stands_is_written_anew_for_where_the_arm_is(house):
    there = tuple(q + 0.05 for q in HOME)
    written = []

    async def scenario(judge):
        held = house.held(TOOL)
        judge.judge(held)
        await until(lambda: held.answers)
        assert held.steps.renewed() is None, "it was judged just now"
        house.arm.here = lambda: JointState(there, held.written.qd_rad_s, 7, 1)
        await until(lambda: written.extend(filter(None, [held.steps.renewed()])) or len(written) > 2)
        house.certifying.answer = replace(house.certifying.answer, index_milli=1_001)
        await until(lambda: house.outcomes())
        assert held.steps.renewed() is None

    played(house, scenario)
    assert twist_of(written[-1], there) == pytest.approx(TOOL.xd_m_s_rad_s, abs=1e-9)
    assert house.arm.stops[0] is Reason.IMPACT_ROSE


@pytest.mark.clause("LSD-29")
def test_a_tool_speed_that_is_not_given_anew_is_ended_in_time(house):
    async def scenario(judge):
        held = house.held(replace(TOOL, time_s=0.1))
        judge.judge(held)
        await until(lambda: held.steps is not None)
        await until(lambda: held.steps.renewed() is None and house.outcomes())

    played(house, scenario)
    assert house.outcomes()[0]["result"]["outcome"] == "ended"
    assert house.arm.stops[0] is Reason.VERDICT_EXPIRED


@pytest.mark.clause("LSD-29")
@pytest.mark.parametrize(
    ("value", "reason"),
    [((9.0, *STILL[1:]), Reason.LIMIT_EXCEEDED_BY_REQUEST), ((*STILL[:4], 3.0, 0.0), Reason.UNPROVEN)],
)
def test_a_tool_speed_outside_of_the_grant_or_too_fast_for_a_joint_ends_the_stream(house, value, reason):
    def play(held):
        assert held.steps.step(replace(TOOL, xd_m_s_rad_s=value)) is reason
        assert held.steps.step(TOOL) is reason

    opened(house, play, TOOL)


@pytest.mark.clause("LSD-29")
def test_a_tool_speed_at_a_singular_wrist_moves_nothing(house):
    house.starts, house.arm.here = STRAIGHT, lambda: JointState(STRAIGHT, STILL, 7, 1)
    assert decided(house, house.held(TURNED)).answers == [Reason.UNPROVEN]
