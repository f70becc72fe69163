"""The built-in functions of URScript that take time: motions, stops and waiting.

Each is a generator that yields once a tick and takes the execution first; `ursim.script.functions` has their rows.
"""

# ruff: noqa: PLR0917  the signatures are URScript's

from __future__ import annotations

import math
from collections.abc import Generator
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from ursim.motion.arc import MoveArc
from ursim.motion.motion import MoveJoints, MoveTool, ServoJoints, ServoTool, SpeedJoints, SpeedTool
from ursim.motion.spatial import to_frame
from ursim.motion.values import Pose, ScriptRuntimeError, Value, number, positive, six

if TYPE_CHECKING:
    from ursim.motion.arm import Joints
    from ursim.script.program import Execution

ARRIVED_M: Final = 1e-5  # where servoc without a blend is there: the repeatability of a UR3e is 3e-5 m

Steps: TypeAlias = Generator[None, None, Any]


def _joints(run: Execution, target: Value) -> Joints:
    """Joint angles, or the angles that reach a pose from here."""
    if type(target) is not Pose:
        return six(target, "q")
    return _reach(run, target, run.robot.drive.now.q)


def _reach(run: Execution, pose: Value, near: Joints) -> Joints:
    found = run.robot.arm.reach(to_frame(six(pose, "x")), near, run.robot.tcp)
    if found is None:
        raise ScriptRuntimeError("no inverse kinematics solution")
    return found


def movej(run: Execution, q: Value, a: Value = 1.4, v: Value = 1.05, t: Value = 0, r: Value = 0) -> Steps:
    """Moves the arm to joint angles, or to a pose, straight in joint space.

    `t` [s] over zero replaces `a` and `v`.
    """
    target, duration = _joints(run, q), number(t, "t")
    speed, acceleration = positive(v, "v"), positive(a, "a")
    number(r, "r")  # a blend is not simulated: the motion passes through its waypoints exactly
    yield from run.perform(
        lambda start: MoveJoints(
            run.robot.arm,
            start,
            target,
            speed_rad_s=speed,
            acceleration_rad_s2=acceleration,
            duration_s=duration,
        )
    )


def movel(run: Execution, pose: Value, a: Value = 1.2, v: Value = 0.25, t: Value = 0, r: Value = 0) -> Steps:
    """Moves the tool to a pose, or to that of joint angles, on a straight line.

    `t` [s] over zero replaces `a` and `v`.
    """
    robot = run.robot
    target = to_frame(six(pose, "pose")) if type(pose) is Pose else robot.arm.tool(six(pose, "pose"), robot.tcp)
    speed, acceleration, duration = positive(v, "v"), positive(a, "a"), number(t, "t")
    number(r, "r")

    def plan(start: Joints) -> MoveTool:
        move = MoveTool(robot.arm, robot.tcp, start, target, speed_m_s=speed, acceleration_m_s2=acceleration)
        length = move.profile.distance
        if duration <= 0.0 or length == 0.0:
            return move
        top, ramp = 2 * length / duration, 4 * length / duration**2
        return MoveTool(robot.arm, robot.tcp, start, target, speed_m_s=top, acceleration_m_s2=ramp)

    yield from run.perform(plan)


def movep(run: Execution, pose: Value, a: Value = 1.2, v: Value = 0.25, r: Value = 0) -> Steps:
    """The tool at a pose on a straight line; as blends are not simulated, this is `movel`'s motion."""
    yield from movel(run, pose, a, v, 0, r)


def movec(
    run: Execution,
    pose_via: Value,
    pose_to: Value,
    a: Value = 1.2,
    v: Value = 0.25,
    r: Value = 0,
    mode: Value = 0,
) -> Steps:
    """The tool at a pose, round a circle through another; `mode` 1 keeps its orientation to the arc's tangent."""
    robot = run.robot
    via, target = (
        to_frame(six(pose, name)) if type(pose) is Pose else robot.arm.tool(six(pose, name), robot.tcp)
        for pose, name in ((pose_via, "pose_via"), (pose_to, "pose_to"))
    )
    speed, acceleration = positive(v, "v"), positive(a, "a")
    number(r, "r")
    if mode not in (0, 1):
        raise ScriptRuntimeError("a mode of movec that does not exist")
    yield from run.perform(
        lambda start: MoveArc(
            robot.arm,
            robot.tcp,
            start,
            via[0],
            target,
            speed_m_s=speed,
            acceleration_m_s2=acceleration,
            fixed=mode == 1,
        )
    )


def stopj(run: Execution, a: Value = 2.0) -> Steps:
    """The arm at rest, its leading axis slowed at `a` [rad/s2]."""
    yield from run.brake(positive(a, "a"))


def stopl(run: Execution, a: Value = 10.0, a_rot: Value = None) -> Steps:
    """The arm at rest, in the time the tool needs at `a` [m/s2] and `a_rot` [rad/s2], whichever takes longer."""
    along, turning = positive(a, "a"), positive(a if a_rot is None else a_rot, "aRot")
    robot = run.robot
    speed = robot.tool_speed()
    duration = max(math.hypot(*speed[:3]) / along, math.hypot(*speed[3:]) / turning)
    leading = max(map(abs, robot.drive.now.qd))
    if duration > 0.0 and leading > 0.0:
        yield from run.brake(leading / duration)
    else:
        yield from run.brake(robot.drive.stop_deceleration_rad_s2)


def _follow(run: Execution, motion: SpeedJoints | SpeedTool, duration_s: float) -> Steps:
    """Returns after `duration_s`, or without one when the speed is reached; the arm moves on while the thread lives."""
    drive = run.robot.drive
    if duration_s > 0.0:
        yield from run.wait(duration_s)
        return
    yield
    while drive.motion is motion and not motion.reached(drive.now, drive.scaling):
        yield


def speedj(run: Execution, qd: Value, a: Value = 0.5, t: Value = 0) -> Steps:
    """The arm on its way to joint speeds `qd` [rad/s], the leading change at `a` [rad/s2]; returns like `_follow`."""
    target, acceleration, duration = six(qd, "qd"), positive(a, "a"), number(t, "t")
    drive = run.robot.drive
    motion = drive.motion if isinstance(drive.motion, SpeedJoints) else SpeedJoints(run.robot.arm)
    drive.take(run.current, motion)
    motion.aim(target, acceleration)
    yield from _follow(run, motion, duration)


def speedl(run: Execution, xd: Value, a: Value = 0.25, t: Value = 0, a_rot: Value = 0) -> Steps:
    """The tool on its way to the velocity `xd` [m/s, rad/s] at `a` [m/s2]; returns like `_follow`."""
    target, acceleration, duration = six(xd, "xd"), positive(a, "a"), number(t, "t")
    number(a_rot, "aRot")
    robot, drive = run.robot, run.robot.drive
    motion = drive.motion if isinstance(drive.motion, SpeedTool) else SpeedTool(robot.arm, robot.tcp, drive.now)
    drive.take(run.current, motion)
    motion.aim(target, acceleration)
    yield from _follow(run, motion, duration)


def servoj(
    run: Execution,
    q: Value,
    a: Value = 0,
    v: Value = 0,
    t: Value = 0.002,
    lookahead_time: Value = 0.1,
    gain: Value = 300,
) -> Steps:
    """Makes the arm follow joint angles `q` [rad] for `t` [s].

    It follows on while the thread lives and nothing else moves it.
    """
    del a, v  # unused by the real function too
    target = six(q, "q")
    if not run.robot.arm.inside(target):
        raise ScriptRuntimeError("servoj target outside the joint limits")
    lookahead, _ = positive(lookahead_time, "lookahead_time"), positive(gain, "gain")
    drive = run.robot.drive
    motion = drive.motion if isinstance(drive.motion, ServoJoints) else ServoJoints(run.robot.arm)
    drive.take(run.current, motion)
    motion.target, motion.lookahead_s = target, max(lookahead, 0.03)  # 0.03 s: the documented lower end
    yield from run.wait(number(t, "t"))


def servoc(run: Execution, pose: Value, a: Value = 1.2, v: Value = 0.25, r: Value = 0) -> Steps:
    """Moves the tool towards a pose, and returns within `r` [m] of it.

    The arm follows on while the thread lives.
    """
    target, speed, acceleration = to_frame(six(pose, "pose")), positive(v, "v"), positive(a, "a")
    blend, robot, drive = number(r, "r"), run.robot, run.robot.drive
    motion = drive.motion if isinstance(drive.motion, ServoTool) else ServoTool(robot.arm, robot.tcp, drive.now)
    drive.take(run.current, motion)
    motion.aim(target, speed_m_s=speed, acceleration_m_s2=acceleration)
    yield
    while drive.motion is motion and motion.left_m(drive.now) > max(blend, ARRIVED_M):
        yield


def protective_stop(run: Execution) -> Steps:
    """A protective stop, which the controller makes within this tick."""
    run.robot.alarm = "protective_stop() was called"
    yield


def popup(
    run: Execution,
    s: Value,
    title: Value = "Popup",
    warning: Value = False,  # noqa: FBT002
    error: Value = False,  # noqa: FBT002
    blocking: Value = False,  # noqa: FBT002
) -> Steps:
    """Shown on the pendant, where nobody is: one that blocks is never answered."""
    del run, s, title, warning, error
    while blocking:
        yield


def sleep(run: Execution, t: Value) -> Steps:
    """`t` [s] later, at least one tick."""
    yield from run.wait(number(t, "t"))


def sync(run: Execution) -> Steps:
    """One tick later."""
    del run
    yield
