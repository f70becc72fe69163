"""Servo targets of a trajectory: written in time, never faster than assessed, and the arm seen to follow them."""

import asyncio
import time

import numpy as np
import pytest
from pep.pit.path.timed_curve import curve_of
from pep.pit.search.trajectory_pieces import HOLD_RAD, LAG_S
from pep.rtde.own.trajectory_stream import (
    BESIDE_RAD,
    LATE_S,
    LOOKAHEAD_S,
    PERIOD_S,
    SEEN_S,
    SETTLES_MS,
    TargetWriter,
    TrajectoryProgress,
    target,
)
from pep.rtde.robot.state_receiver import JointState
from pep.watch.watch import MotionOutcome
from policies.words.reason_table import Reason
from tests.pep.kit import ManualClock
from tests.pep.rtde.own.test_own_lines import HOME, Served
from ursim.ports.launch import SimulatedController
from ztpm.stage.samples import StateRecorder

from pep.pit import JointTrajectory

pytestmark = [pytest.mark.timeout(60), pytest.mark.clause("LSD-25", "LSD-26")]

STILL = (0.0,) * 6


def plan(way=(0.8, 0.2, -0.3, 0.2, 0.0, 0.3), lasts_s=2.0, count=12):
    times = np.linspace(0, lasts_s, count)
    s = times / lasts_s
    points = np.array(HOME) + np.outer(10 * s**3 - 15 * s**4 + 6 * s**5, way)
    return JointTrajectory(tuple(times.tolist()), tuple(map(tuple, points.tolist())))


class Lines:
    """Takes targets; each write is so much later than the one before."""

    def __init__(self, *, steps_s=(), takes=10_000):
        self.taken, self.now_s, self.steps, self.takes = [], 0.0, list(steps_s), takes

    def now(self):
        self.now_s += self.steps.pop(0) if self.steps else 0.0
        return self.now_s

    def follow(self, command):
        if len(self.taken) >= self.takes:
            return False
        self.taken.append(command)
        return True


def written(lines, curve, monkeypatch, *, overslept_s=()):
    """Writes all targets on a clock that sleeping advances, and at times oversleeps."""
    late = list(overslept_s)

    async def sleep(seconds):
        lines.now_s += max(seconds, 0.0) + (late.pop(0) if late else 0.0)

    monkeypatch.setattr(asyncio, "sleep", sleep)
    writer = TargetWriter(curve, lines, lines.now)
    asyncio.run(writer.write())
    return writer


def test_targets_are_points_of_the_curve_each_four_milliseconds_to_the_last(monkeypatch):
    curve, lines = curve_of(plan()), Lines()
    writer = written(lines, curve, monkeypatch)
    assert (writer.done, writer.broken) == (True, False)
    assert len(lines.taken) == pytest.approx(curve.duration_s / PERIOD_S, abs=1)
    for number, command in enumerate(lines.taken[:-1], 1):
        assert command == target(curve.at(number * PERIOD_S)[0]) or command.q_rad == pytest.approx(
            curve.at(number * PERIOD_S)[0], abs=1e-12
        )
    assert lines.taken[-1].q_rad == tuple(curve.q[-1].tolist())
    assert {(each.time_s, each.lookahead_s) for each in lines.taken} == {(PERIOD_S, LOOKAHEAD_S)}


def test_what_a_late_writer_left_out_is_not_caught_up_with(monkeypatch):
    """No target is farther from the one before than the curve goes in `LATE_S`."""
    curve, lines = curve_of(plan()), Lines()
    writer = written(lines, curve, monkeypatch, overslept_s=[0.0] * 100 + [0.5, 0.0, 0.1] + [0.02] * 50)
    assert writer.done
    steps = np.abs(np.diff([each.q_rad for each in lines.taken], axis=0))
    assert (steps <= np.abs(curve.v).max(axis=0) * LATE_S + 1e-9).all()
    assert lines.now_s > curve.duration_s + 0.5


def test_a_target_that_is_not_taken_ends_it(monkeypatch):
    curve, lines = curve_of(plan()), Lines(takes=20)
    writer = written(lines, curve, monkeypatch)
    assert (writer.broken, writer.done, len(lines.taken)) == (True, False, 20)


def test_a_writer_that_fails_is_broken_too(monkeypatch):
    class Failing(Lines):
        def follow(self, command):
            raise ValueError("no form")

    lines = Failing()
    writer = TargetWriter(curve_of(plan()), lines, lines.now)
    with pytest.raises(ValueError, match="no form"):
        asyncio.run(writer.write())
    assert writer.broken


# ---- the arm beside it


class Told:
    """A writer that has come so far."""

    def __init__(self, curve, told_s, *, broken=False):
        self.told_s, self.broken, self.done = told_s, broken, told_s >= curve.duration_s


def progress(told_s, *, broken=False, clock=None):
    curve = curve_of(plan())
    return curve, TrajectoryProgress(curve, Told(curve, told_s, broken=broken), clock or ManualClock())


def state(q, qd=STILL):
    return JointState(tuple(float(x) for x in q), qd, 7, 1)


@pytest.mark.parametrize("behind_s", [0.0, 0.03, 0.1, SEEN_S])
def test_an_arm_that_follows_within_its_lag_goes_on(behind_s):
    curve, course = progress(1.0)
    assert course.look(state(curve.at(1.0 - behind_s)[0])) is None


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("side", [-1, 1])
def test_an_arm_that_leaves_the_tube_of_any_joint_is_stopped(joint, side):
    curve, course = progress(1.0)
    q = curve.at(0.97)[0].copy()
    room = 0.5 * np.abs(curve.a[:, joint]).max() * LAG_S**2 + HOLD_RAD + BESIDE_RAD
    reach = np.abs(curve.v[:, joint]).max() * SEEN_S
    q[joint] += side * (room + reach + 1e-6)
    over = course.look(state(q))
    assert (over.outcome, over.stop) == (MotionOutcome.ROBOT_FAILED, Reason.EFFECT_FAILED)


def test_an_arm_that_stands_still_while_its_targets_go_on_is_stopped():
    curve, course = progress(1.0)
    over = course.look(state(curve.q[0]))
    assert (over.outcome, over.stop) == (MotionOutcome.ROBOT_FAILED, Reason.EFFECT_FAILED)


def test_a_broken_writer_ends_it():
    curve, course = progress(1.0, broken=True)
    assert course.look(state(curve.at(1.0)[0])).outcome is MotionOutcome.ROBOT_FAILED


def test_it_has_arrived_once_it_stands_at_the_last_point_and_its_servo_is_ended():
    clock = ManualClock()
    curve, course = progress(2.0, clock=clock)
    assert course.look(state(curve.at(1.99)[0], qd=(0.1, *STILL[1:]))) is None
    over = course.look(state(curve.q[-1]))
    assert (over.outcome, over.stop) == (MotionOutcome.REACHED, Reason.VERDICT_EXPIRED)


def test_one_that_does_not_settle_is_stopped():
    clock = ManualClock()
    curve, course = progress(2.0, clock=clock)
    near = curve.q[-1] - [0.0015, 0, 0, 0, 0, 0]
    assert course.look(state(near)) is None
    clock.mono += SETTLES_MS + 1
    assert course.look(state(near)).outcome is MotionOutcome.ROBOT_FAILED


# ---- a real control script


@pytest.mark.e2e
def test_the_simulated_arm_is_within_the_assessed_tube_at_every_sample():
    """Targets go through the registers of the tools' own line, and a stop ends them."""
    curve = curve_of(plan())
    with SimulatedController.start(joints=HOME) as controller:
        served = Served(controller.host)
        try:
            until_s = time.monotonic() + 20
            while not served.own.up:
                assert time.monotonic() < until_s, served.failed
                served.do(asyncio.sleep(0.02))

            async def follow():
                assert await served.own.ready()
                assert not served.own.follow(target(curve.q[0])), "nothing is under way"
                assert served.own.give(target(curve.q[0]))
                writer = TargetWriter(curve, served.own, asyncio.get_running_loop().time)
                await writer.write()
                assert not writer.broken
                await asyncio.sleep(0.3)
                served.own.stop()
                await asyncio.sleep(0.2)
                assert not served.own.follow(target(curve.q[0])), "its stop has ended it"

            with StateRecorder(controller.host) as recorder:
                served.do(follow())
                seen = recorder.since(0.0)
        finally:
            served.close()
    times = np.linspace(0, curve.duration_s, 2001)
    places = np.array([curve.at(t)[0] for t in times])
    tube = 0.5 * np.abs(curve.a).max(axis=0) * LAG_S**2 + HOLD_RAD
    beside = [(np.abs(places - sample.q_rad) / tube).max(axis=1).min() for sample in seen]
    assert len(seen) > 500
    assert max(beside) <= 1
    fastest = np.abs([sample.qd_rad_s for sample in seen]).max(axis=0)
    assert (fastest <= 1.1 * np.abs(curve.v).max(axis=0) + 1e-3).all()
    assert seen[-1].q_rad == pytest.approx(curve.q[-1], abs=1e-3)
    assert seen[-1].still
