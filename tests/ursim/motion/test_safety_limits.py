"""Limits of tool, elbow and momentum: planned moves are slowed down to keep them, what exceeds them is a violation.

Ticked by the test, without a clock; what a client sees of a violation is tried on the wire.
"""

import math
import struct

import pytest
from tests.ursim.cell import HOME, TICK_S, Bench
from ursim.motion.arm import Arm
from ursim.motion.robot import RobotMode, RuntimeState, SafetyMode
from ursim.motion.spatial import to_frame
from ursim.ports.arm_kinds import KINDS
from ursim.ports.primary_messages import state_message

from ursim.motion import safety

ARM = Arm.load()
STRETCHED = (0.0, 0.0, 0.0, 0.0, -1.5708, 0.0)
LONG_TOOL = "set_tcp(p[0, 0, -0.6, 0, 0, 0])\n"  # a rod in the arm's own direction
BENT = (0.0, -0.6, 1.2, -0.6, -1.5708, 0.0)


def tool_speed(robot):
    """Of the tool centre point, from two poses: nothing of what the limits are computed with."""
    now = robot.drive.now
    later = tuple(q + 1e-6 * qd for q, qd in zip(now.q, now.qd, strict=True))
    return math.dist(robot.forward(now.q, robot.tcp)[:3], robot.forward(later, robot.tcp)[:3]) / 1e-6


def elbow_speed(robot):
    now = robot.drive.now
    later = tuple(q + 1e-6 * qd for q, qd in zip(now.q, now.qd, strict=True))
    return math.dist(ARM.frames(now.q)[2][0], ARM.frames(later)[2][0]) / 1e-6


def momentum(robot):
    """Of arm and payload, from two places of every centre of mass."""
    now = robot.drive.now
    later = tuple(q + 1e-6 * qd for q, qd in zip(now.q, now.qd, strict=True))
    total = [0.0, 0.0, 0.0]
    bodies = [(joint.body.mass_kg, joint.body.com_m) for joint in ARM.joints]
    for frames, sign in ((ARM.frames(later), 1.0), (ARM.frames(now.q), -1.0)):
        places = [*zip(frames, bodies, strict=True), (frames[-1], (robot.payload_kg, robot.payload_cog_m))]
        for (origin, r), (mass, com) in places:
            for i in range(3):
                total[i] += sign * mass * (origin[i] + sum(r[3 * i + k] * com[k] for k in range(3)))
    return math.hypot(*total) / 1e-6


def run(text, joints=STRETCHED, *, reduced=False, measure=tool_speed, limit=4000):
    """The bench at the end, the highest value measured, and the time_scale_source of every tick."""
    bench = Bench(joints)
    if reduced:
        bench.controller.reduced_mode(on=True)
        bench.tick(300)
    assert bench.load(f"def t():\n{text}\nend\n") is None
    top, sources = 0.0, []
    for _ in range(limit):
        bench.tick()
        top = max(top, measure(bench.robot))
        sources.append(bench.robot.read("time_scale_source"))
        if bench.robot.runtime in {RuntimeState.STOPPED, RuntimeState.PAUSED}:
            return bench, top, sources
    raise AssertionError("it goes on")


@pytest.mark.parametrize(
    ("move", "joints", "reduced", "limit"),
    [
        ("movej([2.5, 0, 0, 0, -1.5708, 0], a=4, v=3)", STRETCHED, False, 1.5),
        ("movej([2.5, 0, 0, 0, -1.5708, 0], a=40, v=3)", STRETCHED, False, 1.5),
        ("movej([2.5, 0, 0, 0, -1.5708, 0], a=40, v=3)", STRETCHED, True, 0.75),
        ("movel(pose_trans(p[0, 0.3, 0.1, 0, 0, 0], get_actual_tcp_pose()), a=40, v=3)", BENT, True, 0.75),
    ],
)
def test_a_planned_move_is_slowed_down_so_that_it_keeps_the_tool_speed(move, joints, reduced, limit):
    bench, top, sources = run(LONG_TOOL + move, joints, reduced=reduced)
    assert bench.robot.safety is (SafetyMode.REDUCED if reduced else SafetyMode.NORMAL)
    assert bench.robot.runtime is RuntimeState.STOPPED  # it came to its end
    assert top == pytest.approx(limit - 0.05, rel=0.01)  # no slower than it need be
    assert safety.Cause.TOOL_SPEED in sources
    assert sources[-1] == safety.Cause.NO_PROGRAM
    assert not bench.exceptions


def test_the_speed_scaling_tells_of_it_and_comes_back():
    bench, _, _ = run(LONG_TOOL + "movej([2.5, 0, 0, 0, -1.5708, 0], a=4, v=3)")
    bench.tick()
    assert bench.robot.read("speed_scaling") == 1.0
    bench.load("def t():\n movej([0, 0, 0, 0, -1.5708, 0], a=4, v=3)\nend\n")
    bench.until(lambda: bench.robot.read("time_scale_source") == safety.Cause.TOOL_SPEED)
    bench.until(lambda: bench.robot.read("speed_scaling") < 0.7)
    assert bench.robot.read("target_speed_fraction") == 1.0


def test_a_move_that_keeps_the_limits_is_not_slowed_down():
    bench, top, sources = run("movej([1.5, -1.5708, 1.5708, -1.5708, -1.5708, 0], a=8, v=3)", HOME)
    assert set(sources) == {safety.Cause.NOT_SLOWED, safety.Cause.NO_PROGRAM}
    assert bench.now.q[0] == 1.5
    assert 0.5 < top < 1.4


@pytest.mark.long
def test_elbow_and_momentum_are_kept_too(monkeypatch):
    """No e-Series limit of theirs can be reached by this arm within its joint speeds, so lower ones are set."""
    move = "set_payload(3, [0, 0, 0.1])\nmovej([0, -1.5, 0, 0, -1.5708, 0], a=2, v=2)"
    for name, measure, limit, tolerance, cause in (
        ("elbow_speed_m_s", elbow_speed, 0.2, 0.05, safety.Cause.ELBOW_SPEED),
        ("momentum_kg_m_s", momentum, 5.0, 3.0, safety.Cause.MOMENTUM),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(safety, "NORMAL", safety.NORMAL._replace(**{name: limit}))
            bench, top, sources = run(move, measure=measure)
        assert bench.robot.safety is SafetyMode.NORMAL
        assert bench.now.q[1] == -1.5
        assert top == pytest.approx(limit - tolerance, rel=0.02)
        assert cause in sources
    _, elbow, _ = run(move, measure=elbow_speed)
    _, swing, _ = run(move, measure=momentum)
    assert elbow > 0.25
    assert swing > 2.5


@pytest.mark.parametrize(
    ("text", "reduced"),
    [
        (LONG_TOOL + "speedj([2.5, 0, 0, 0, 0, 0], a=8)\nsleep(5)", False),
        (LONG_TOOL + "speedl([0, 2, 0, 0, 0, 0], a=10)\nsleep(5)", False),
        (
            LONG_TOOL + "while True:\nservoj([2, 0, 0, 0, -1.5708, 0], t=0.002, lookahead_time=0.1, gain=300)\nend",
            False,
        ),
        ("speedj([2.5, 0, 0, 0, 0, 0], a=8)\nsleep(5)", True),
    ],
)
def test_what_is_streamed_faster_than_the_limit_is_a_violation(text, reduced):
    bench = Bench(STRETCHED)
    robot = bench.robot
    if reduced:
        bench.controller.reduced_mode(on=True)
        bench.tick(300)
    bench.load(f"def t():\n{text}\nend\n")
    limit = 0.75 if reduced else 1.5
    bench.until(lambda: robot.safety not in {SafetyMode.NORMAL, SafetyMode.REDUCED}, 2000)
    assert robot.safety is SafetyMode.VIOLATION
    assert tool_speed(robot) == pytest.approx(limit, abs=0.06)  # at once: within the change of two ticks
    assert (robot.read("safety_mode"), robot.read("safety_status")) == (8, 8)
    assert robot.read("safety_status_bits") == 1 << 8 | 1 << 10
    bench.until(lambda: robot.mode is RobotMode.POWER_OFF)  # a stop of category 0 ends without power
    assert bench.now.at_rest
    assert robot.runtime is RuntimeState.STOPPED
    assert len(bench.exceptions) == 1
    assert not bench.controller.play()
    bench.controller.brake_release()
    bench.tick(2000)
    assert robot.mode is RobotMode.POWER_OFF  # the safety system must be restarted first
    bench.controller.restart_safety()
    bench.controller.brake_release()
    bench.until(lambda: robot.mode is RobotMode.RUNNING)
    assert robot.safety is (SafetyMode.REDUCED if reduced else SafetyMode.NORMAL)


def part(frame, wanted):
    """The body of one part of a state message."""
    body = frame[5:]
    while body:
        size, kind = struct.unpack_from(">iB", body)
        if kind == wanted:
            return body[5:size]
        body = body[size:]
    raise AssertionError("no such part")


@pytest.mark.parametrize("reduced", [False, True])
def test_the_primary_interface_says_which_mode(reduced):
    """Masterboard data: two ints, two bytes, two doubles, two bytes, two doubles, four floats, then safety and reduced."""
    bench = Bench(STRETCHED)
    bench.controller.reduced_mode(on=reduced)
    at = 8 + 2 + 16 + 2 + 16 + 16
    assert tuple(part(state_message(bench.robot, KINDS["ur3e"]), 3)[at : at + 2]) == ((2, 1) if reduced else (1, 0))
    bench.load(f"def t():\n{LONG_TOOL}speedj([2.5, 0, 0, 0, 0, 0], a=8)\nsleep(5)\nend\n")
    bench.until(lambda: bench.robot.mode is RobotMode.POWER_OFF)
    assert part(state_message(bench.robot, KINDS["ur3e"]), 3)[at] == 8


def test_reduced_mode_leaves_time_to_slow_down_and_comes_through_every_stop():
    bench = Bench(STRETCHED)
    robot = bench.robot
    bench.load(f"def t():\n{LONG_TOOL}movej([2.5, 0, 0, 0, -1.5708, 0], a=4, v=3)\nend\n")
    bench.until(lambda: tool_speed(robot) > 1.4)
    bench.controller.reduced_mode(on=True)
    assert (robot.read("safety_mode"), robot.read("safety_status_bits")) == (2, 1 << 1)
    speeds = [tool_speed(robot)]
    for _ in range(251):  # 0.5 s, the time that the manual gives
        bench.tick()
        speeds.append(tool_speed(robot))
    assert speeds[-1] == pytest.approx(0.7, rel=0.01)
    assert max(abs(b - a) for a, b in zip(speeds, speeds[1:], strict=False)) < 0.01  # it braked, and did not jump
    assert robot.safety is SafetyMode.REDUCED
    robot.alarm = "asked for"
    bench.tick()
    assert robot.safety is SafetyMode.PROTECTIVE_STOP
    bench.tick(round(5 / TICK_S) + 1)
    assert bench.controller.unlock_protective_stop()
    assert robot.safety is SafetyMode.REDUCED
    bench.controller.safeguard_stop()
    bench.controller.reduced_mode(on=False)
    assert robot.safety is SafetyMode.SAFEGUARD_STOP  # an input for limits ends no stop
    bench.controller.release_safeguard_stop()
    assert robot.safety is SafetyMode.NORMAL
    assert bench.controller.play()
    bench.until(lambda: robot.runtime is RuntimeState.STOPPED)
    assert bench.now.q[0] == 2.5


def test_no_stop_is_a_violation():
    """A strong stop of a fast arm swings its tool faster for a moment, and ends as a stop."""
    bench = Bench(STRETCHED)
    bench.load(
        f"def t():\n{LONG_TOOL}speedj([1.25, 0, 0, 0, 0, 0], a=8)\nset_tcp(p[0, 0, -1.2, 0, 0, 0])\nstopj(1)\nend\n"
    )
    bench.until(lambda: bench.robot.runtime is RuntimeState.STOPPED)
    assert bench.robot.safety is SafetyMode.NORMAL


@pytest.mark.parametrize(
    ("target", "within"),
    [("[2.5, 0, 0, 0, -1.5708, 0]", True), ("[7, 0, 0, 0, 0, 0]", False), ("p[1.5, 0, 0.3, 0, 3.14, 0]", False)],
)
def test_is_within_safety_limits_is_of_places_and_agrees_with_what_a_move_there_meets(target, within):
    """Speeds have no say in it: a place is reached within the limits because moves there are slowed down."""
    bench, _, _ = run(f"write_output_boolean_register(0, is_within_safety_limits({target}))", STRETCHED)
    assert bool(bench.robot.values["output_bit_registers0_to_31"] & 1) is within
    verb = "movel" if target.startswith("p") else "movej"
    bench, _, _ = run(f"{verb}({target}, a=4, v=3)", STRETCHED)
    assert (bench.robot.safety is SafetyMode.NORMAL) is within


def test_the_limits_are_of_the_flange_too():
    """A tool that reaches back to the base's axis moves hardly at all: the flange must keep the limit itself."""
    q = (0.0,) * 6
    flange = ARM.frames(q)[-1]
    back = tuple(-sum(flange[1][3 * k + i] * flange[0][k] for k in range(3)) for i in range(3))
    pose = ", ".join(map(str, (*back, 0.0, 0.0, 0.0)))

    def at_flange(robot):
        now = robot.drive.now
        later = tuple(a + 1e-6 * b for a, b in zip(now.q, now.qd, strict=True))
        return math.dist(ARM.frames(now.q)[-1][0], ARM.frames(later)[-1][0]) / 1e-6

    bench, top, _ = run(f"set_tcp(p[{pose}])\nmovej([2.5, 0, 0, 0, 0, 0], a=4, v=3.14)", q, measure=at_flange)
    assert top == pytest.approx(1.45, rel=0.01)
    assert to_frame(tuple(bench.robot.tool_pose))[0][:2] == pytest.approx((0.0, 0.0), abs=1e-6)
