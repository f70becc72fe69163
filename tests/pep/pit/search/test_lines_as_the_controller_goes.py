"""The simulated controller, whose kinematics and timing are its own, never leaves what was certified of it."""

from contextlib import suppress

import numpy as np
import pytest
from pep.pit.assessment.dispatch import drive_of
from pep.pit.base.errors import UnprovenError
from pep.pit.path.straight_path import GRID
from pep.pit.robot.twist import TURN_LEVER_M
from pep.pit.search.course_limits import Effort
from pep.pit.search.timed_course import TimedCourse
from tests.pep.pit.lines import placed, random_hold, random_line, random_servo
from tests.pep.pit.scenes import CELL, ROBOT
from tests.pep.pit.search.test_held_tool_speeds import unhurried
from ursim.motion.arm import Arm
from ursim.motion.motion import Brake, Kinetic, MotionError, MoveTool, ServoJoints, SpeedTool
from ursim.motion.spatial import IDENTITY, to_frame

ARM = Arm.load()
TCP = (tuple(float(x) for x in ROBOT.tool.tcp_m), IDENTITY)
TICK, STILL = 0.002, (0.0,) * 6
AGE = 0.1


def drive_for(motion):
    return drive_of(ROBOT, motion, CELL, perception_age_s=AGE, check_time=unhurried)


def ticks(plan, now, until_s):
    found, t = [], 0.0
    while t < until_s:
        now, done = plan.advance(now, TICK, 1.0)
        found.append(now)
        t += TICK
        if done:
            break
    return found


def inside(drive, states, slack_rad=1e-3):
    """Every state is beside the course by no more than it says, and no joint faster than proven."""
    course = drive.course
    places = np.linspace(0, 1, 1500)
    there = np.array([course.q(s) for s in places])
    stray = np.array([course.cells.stray[course.cells.holding(s * GRID)] for s in places])
    most = drive.joint_speeds_rad_s(drive.profile).max(axis=0)
    for state in states:
        q, qd = np.array(state.q), np.array(state.qd)
        assert np.maximum(np.abs(there - q) - stray, 0).max(axis=1).min() < slack_rad
        assert (np.abs(qd) <= most * 1.002 + 1e-6).all()


def test_the_controller_takes_at_least_the_certified_time_for_a_turn():
    assert MoveTool.TURN_LEVER_M >= TURN_LEVER_M


@pytest.mark.parametrize("seed", range(6))
def test_a_line_as_the_controller_goes_it(seed):
    move = random_line(np.random.default_rng(7000 + seed))
    drive = drive_for(move)
    assert isinstance(drive, TimedCourse)
    plan = MoveTool(
        ARM, TCP, move.start, to_frame(move.target), speed_m_s=move.speed_m_s, acceleration_m_s2=move.acceleration_m_s2
    )
    try:
        states = ticks(plan, Kinetic(move.start, STILL, STILL), 60.0)
    except MotionError:  # the controller stops: a joint would be too fast, as was told
        ratio = {r.name: r.ratio for r in Effort(ROBOT, drive, CELL).ratios(drive.profile)}
        assert ratio["joint_speed"] > 1
        return
    assert len(states) * TICK == pytest.approx(drive.profile.duration_s, abs=2 * TICK)
    inside(drive, states)
    speeds = Effort(ROBOT, drive, CELL).surface_speed_m_s(drive.profile)
    tool = [placed(s.q)[0] for s in states]
    fastest = max(np.linalg.norm(b - a) / TICK for a, b in zip(tool, tool[1:]))
    assert fastest <= speeds[ROBOT.body_index("tcp")] * 1.001 + 1e-6


@pytest.mark.parametrize("seed", range(6))
def test_a_held_tool_speed_as_the_controller_goes_it(seed):
    rng = np.random.default_rng(7100 + seed)
    while True:
        motion = random_hold(rng)
        with suppress(UnprovenError):
            drive = drive_for(motion)
            if isinstance(drive, TimedCourse):
                break
    now = Kinetic(motion.start, STILL, STILL)
    plan = SpeedTool(ARM, TCP, now)
    plan.aim(motion.twist, motion.acceleration_m_s2)
    states = ticks(plan, now, motion.duration_s + rng.uniform(0, CELL.stop_delay_s))
    states += ticks(Brake(states[-1], CELL.stop_deceleration_rad_s2), states[-1], 5.0)
    inside(drive, states, slack_rad=4e-3)  # the controller damps its inverse, and is a little behind the line


@pytest.mark.parametrize("seed", range(6))
def test_a_servo_target_as_the_controller_goes_for_it(seed):
    rng = np.random.default_rng(7200 + seed)
    motion = random_servo(rng)
    drive = drive_for(motion)
    assert isinstance(drive, TimedCourse)
    plan = ServoJoints(ARM)
    plan.target, plan.lookahead_s = motion.target, motion.lookahead_s
    states = ticks(plan, Kinetic(motion.start, motion.qd_rad_s, STILL), 0.21 + motion.period_s + CELL.stop_delay_s)
    states += ticks(Brake(states[-1], CELL.stop_deceleration_rad_s2), states[-1], 5.0)
    inside(drive, states)
