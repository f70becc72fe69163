"""Limits of the arm: it stops as the robot does, and says why. Ticked by the test, without a clock."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.ursim.cell import HOME, TICK_S, Bench
from ursim.motion.arm import Arm, Body
from ursim.motion.dynamics import joint_torques
from ursim.motion.motion import ZERO, Kinetic, ServoTool
from ursim.motion.robot import FLANGE, RobotMode, RuntimeState, SafetyMode
from ursim.motion.spatial import to_frame

ARM = Arm.load()
STRETCHED = (0.0, 0.0, 0.0, 0.0, -1.5708, 0.0)  # the arm straight out: most torque, and an elbow singularity
angles = st.tuples(*[st.floats(-3.0, 3.0)] * 6)


def after(text, joints=HOME, ticks=3000):
    """A bench whose program has ended one way or another."""
    bench = Bench(joints)
    assert bench.load(f"def t():\n{text}\nend\n") is None
    bench.until(lambda: bench.robot.runtime in {RuntimeState.STOPPED, RuntimeState.PAUSED}, ticks)
    return bench


def protective(bench):
    return bench.robot.safety is SafetyMode.PROTECTIVE_STOP and bench.now.at_rest


@pytest.mark.parametrize(
    ("text", "joints"),
    [
        ("movej([0, 0, 3.2, 0, 0, 0])", HOME),  # the elbow's limit
        ("movej([7, -1.57, 1.57, -1.57, -1.57, 0])", HOME),
        ("movel(p[1.5, 0, 0.3, 0, 3.14, 0])", HOME),  # out of reach
        ("movel([0.4, -1.2, 1.2, -1.5708, -1.5708, 0], v=3, a=150)", HOME),  # faster than the joints
        ("movel(pose_trans(get_actual_tcp_pose(), p[0, 0, 0.3, 0, 0, 0]))", (0.0, -0.1, 0.2, -1.6, -1.5708, 0.0)),
        ("speedj([3, 0, 0, 0, 0, 0], a=40)\nsleep(4)", HOME),  # runs into its limit
        (
            "set_payload(1)\nmovej([0, -0.5, 0, 0, -1.5708, 0], a=40, v=3)",
            STRETCHED,
        ),  # more torque than the shoulder has
    ],
)
def test_what_the_arm_cannot_do_is_a_protective_stop(text, joints):
    bench = after(text, joints)
    assert protective(bench)
    assert bench.robot.runtime is RuntimeState.PAUSED
    ((_, told),) = bench.exceptions
    assert told.startswith("protective stop")
    assert all(abs(q) <= joint.position_limit_rad for q, joint in zip(bench.now.q, ARM.joints, strict=True))


@pytest.mark.parametrize("text", ["get_inverse_kin(p[2, 0, 0, 0, 0, 0])", "movej(p[2, 0, 0, 0, 0, 0])"])
def test_a_pose_without_joint_angles_ends_the_program(text):
    bench = after(text)
    assert bench.robot.safety is SafetyMode.NORMAL
    assert bench.robot.runtime is RuntimeState.STOPPED
    assert len(bench.exceptions) == 1


def test_a_payload_takes_its_torque_and_what_is_too_heavy_is_refused():
    move = "movej([0, -0.4, 0, 0, -1.5708, 0], a={}, v=2)"
    assert after(move.format(14), STRETCHED).robot.safety is SafetyMode.NORMAL
    assert protective(after("set_payload(3, [0, 0, 0.15])\n" + move.format(14), STRETCHED))
    bench = after("set_payload(3.1)")
    assert len(bench.exceptions) == 1
    assert bench.robot.payload_kg == 0.0


def test_no_stop_is_refused_for_its_torque():
    bench = Bench(STRETCHED, stop_deceleration=40.0)
    bench.load("def t():\nset_payload(3, [0, 0, 0.15])\nspeedj([0, -1, 0, 0, 0, 0], a=2)\nstopj(40)\nend\n")
    bench.until(lambda: bench.robot.runtime is RuntimeState.STOPPED)
    assert bench.robot.safety is SafetyMode.NORMAL
    assert bench.now.at_rest


def test_the_torque_of_every_tick_of_a_move_is_inside_the_limits_or_it_stops():
    bench = Bench(STRETCHED)
    bench.load("def t():\nmovej([0, -1.5, 1, 0, -1.5708, 0], a=6, v=2)\nend\n")
    bench.tick(2)
    while bench.robot.runtime is RuntimeState.PLAYING:
        bench.tick()
        for torque, joint in zip(bench.robot.torques(), ARM.joints, strict=True):
            assert abs(torque) <= joint.torque_limit_nm
    assert bench.robot.safety is SafetyMode.NORMAL


@settings(deadline=None, max_examples=50)
@given(angles, angles, angles, st.floats(0.0, 3.0))
def test_torques_are_pinocchios(q, qd, qdd, mass):
    pinocchio = pytest.importorskip("pinocchio")
    load = Body(mass, (0.01, -0.02, 0.06), (0.01, 0.02, 0.015, 0.001, 0.002, 0.003))
    model, parent = pinocchio.Model(), 0
    for joint in ARM.joints:
        place = pinocchio.SE3(np.array(joint.turn).reshape(3, 3), np.array(joint.offset_m))
        parent = model.addJoint(parent, pinocchio.JointModelRZ(), place, f"j{parent}")
        body = joint.body
        link = pinocchio.Inertia(body.mass_kg, np.array(body.com_m), np.diag(body.inertia_kg_m2[:3]))
        model.appendBodyToJoint(parent, link, pinocchio.SE3.Identity())
    xx, yy, zz, xy, xz, yz = load.inertia_kg_m2
    if mass > 0.0:
        held = pinocchio.Inertia(mass, np.array(load.com_m), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
        model.appendBodyToJoint(parent, held, pinocchio.SE3.Identity())
    model.gravity.linear = np.array([0.0, 1.0, -9.0])
    expected = pinocchio.rnea(model, model.createData(), np.array(q), np.array(qd), np.array(qdd))
    found = joint_torques(ARM, ARM.frames(q), Kinetic(q, qd, qdd), load, (0.0, -1.0, 9.0))
    assert found == pytest.approx(list(expected), abs=1e-9)


def test_servoc_goes_straight_slows_down_and_arrives():
    now = Kinetic(HOME, ZERO, ZERO)
    servo = ServoTool(ARM, FLANGE, now)
    start, turn = ARM.tool(HOME, FLANGE)
    goal = (start[0] + 0.06, start[1] - 0.08, start[2])
    servo.aim((goal, turn), speed_m_s=0.2, acceleration_m_s2=0.8)
    top, ticks = 0.0, 0
    while servo.left_m(now) > 1e-6:
        now, done = servo.advance(now, TICK_S, 1.0)
        ticks += 1
        assert not done
        assert ticks < 1000
        twist = ARM.twist(ARM.frames(now.q), now.qd, FLANGE)
        top = max(top, math.hypot(*twist[:3]))
        place = ARM.tool(now.q, FLANGE)[0]
        along = ((place[0] - start[0]) * 0.6 - (place[1] - start[1]) * 0.8) / 1.0
        foot = (start[0] + 0.6 * along, start[1] - 0.8 * along, start[2])
        assert math.dist(place, foot) < 1e-3
    assert top == pytest.approx(0.2, rel=0.01)
    assert ticks * TICK_S == pytest.approx(0.1 / 0.2 + 0.2 / 0.8, abs=0.15)
    now, _ = servo.advance(now, TICK_S, 1.0)
    assert max(map(abs, now.qd)) < 1e-3


def test_a_servoc_that_is_replaced_by_another_turns_without_a_jump():
    bench = Bench()
    pose = bench.robot.tool_pose
    first, second = (
        f"p[{', '.join(map(str, (pose[0] + x, pose[1], pose[2] + z, *pose[3:])))}]" for x, z in ((0.1, 0), (0.1, 0.1))
    )
    bench.load(f"def t():\nservoc({first}, a=1, v=0.1, r=0.02)\nservoc({second}, a=1, v=0.1, r=0.001)\nstopl(2)\nend\n")
    bench.tick()
    jumps = []
    while bench.robot.runtime is RuntimeState.PLAYING:
        before = bench.robot.tool_speed()
        bench.tick()
        jumps.append(math.dist(before[:3], bench.robot.tool_speed()[:3]))
    assert max(jumps) < 3 * 2.0 * TICK_S
    # It stopped within the blend of the second, and its own braking distance.
    assert math.dist(bench.robot.tool_pose[:3], to_frame((pose[0] + 0.1, pose[1], pose[2] + 0.1, *pose[3:]))[0]) < 0.006


def test_a_wrench_is_the_clients_while_it_comes_and_the_program_pauses_when_it_does_not():
    bench = Bench()
    bench.load("def t():\nenable_external_ft_sensor(True, 0.1, [0, 0, 0], [0, 0, 0])\nsleep(10)\nend\n")
    bench.tick(2)
    for _ in range(10):  # every 60 ms
        bench.controller.write({"external_force_torque": (3.0, 4.0, 0.0, 0.1, 0.2, 0.3)})
        bench.tick(30)
    assert bench.robot.runtime is RuntimeState.PLAYING
    assert bench.robot.read("actual_TCP_force") == (3.0, 4.0, 0.0, 0.1, 0.2, 0.3)
    assert bench.robot.read("tcp_force_scalar") == 5.0
    assert 20 <= bench.until(lambda: bench.robot.runtime is RuntimeState.PAUSED) <= 25
    bench = Bench()
    bench.load("def t():\nft_rtde_input_enable(True)\nft_rtde_input_enable(False)\nsleep(1)\nend\n")
    bench.tick(400)
    assert bench.robot.runtime is RuntimeState.PLAYING
    assert bench.robot.read("actual_TCP_force") == ZERO


def test_a_watchdog_that_is_set_takes_the_place_of_the_one_over_the_wrench():
    bench = Bench()
    watch = 'rtde_set_watchdog("input_int_register_0", 1, "stop")\n'
    bench.load(f"def t():\n{watch}enable_external_ft_sensor(True)\nsleep(10)\nend\n")
    bench.tick(400)
    assert bench.robot.runtime is RuntimeState.PLAYING
    bench.until(lambda: bench.robot.runtime is RuntimeState.STOPPED, 200)


def test_contact_is_told_in_steps_back_and_found_in_the_history():
    bench = Bench()
    program = "speedj([0.5, 0, 0, 0, 0, 0], a=8, t=0.5)\nn = 0\nwhile n == 0:\nn = tool_contact()\nspeedj([0.5, 0, 0, 0, 0, 0], t=0.002)\nend\n"
    program += "q = get_actual_joint_positions_history(n)\nwrite_output_float_register(0, q[0])\nstopj(8)\n"
    bench.load(f"def t():\n{program}end\n")
    bench.tick(300)
    bench.robot.touched_at, where = bench.robot.step, bench.now.q[0]
    bench.until(lambda: bench.robot.runtime is RuntimeState.STOPPED)
    assert bench.robot.values["output_double_register_0"] == pytest.approx(where, abs=0.5 * 2 * TICK_S)
    assert bench.now.q[0] > where + 0.005


@pytest.mark.parametrize(
    "text",
    [
        "force_mode(p[0, 0, 0, 0, 0, 0], [0, 0, 2, 0, 0, 0], [0, 0, 0, 0, 0, 0], 2, [0, 0, 0, 0, 0, 0])",
        "force_mode(p[0, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 0, 0, 0], 2, [0, 0, 0, 0, 0, 0])",
        "force_mode_set_damping(1.5)",
        "force_mode_set_gain_scaling(-1)",
        "freedrive_mode([1, 1, 1, 1, 1, 3])",
        "servoc(p[0, 0, 0, 0, 0, 0], v=0)",
        "tool_contact([1, 0])",
        "enable_external_ft_sensor(True, 99)",
    ],
)
def test_arguments_that_mean_nothing_end_the_program(text):
    bench = after(text)
    assert bench.robot.runtime is RuntimeState.STOPPED
    assert len(bench.exceptions) == 1


def test_power_comes_back_step_by_step_and_not_while_safety_forbids_it():
    bench = Bench()
    controller, robot = bench.controller, bench.robot
    controller.emergency_stop(SafetyMode.VIOLATION)
    bench.until(lambda: robot.mode is RobotMode.POWER_OFF)
    controller.brake_release()
    bench.tick(2000)
    assert robot.mode is RobotMode.POWER_OFF
    robot.alarm = "a stop on top changes nothing"
    bench.tick()
    assert robot.safety is SafetyMode.VIOLATION
    controller.restart_safety()
    controller.brake_release()
    seen = []
    while not seen or seen[-1] is not RobotMode.RUNNING:
        bench.tick()
        seen.append(robot.mode)
    assert list(dict.fromkeys(seen)) == [
        RobotMode.POWER_OFF,
        RobotMode.BOOTING,
        RobotMode.POWER_ON,
        RobotMode.IDLE,
        RobotMode.RUNNING,
    ]


def test_a_safeguard_stop_holds_and_nothing_goes_on_by_itself():
    bench = Bench()
    bench.load("def t():\nmovej([1, -1.5708, 1.5708, -1.5708, -1.5708, 0], a=4, v=1)\nend\n")
    bench.tick(200)
    bench.controller.safeguard_stop()
    bench.until(lambda: bench.robot.runtime is RuntimeState.PAUSED)
    assert bench.robot.read("safety_mode") == 5
    assert not bench.controller.play()
    bench.controller.release_safeguard_stop()
    bench.tick(500)
    assert bench.robot.runtime is RuntimeState.PAUSED
    assert bench.controller.play()
    bench.until(lambda: bench.robot.runtime is RuntimeState.STOPPED)
    assert bench.now.q[0] == pytest.approx(1.0)
