"""Simulated arm that a force or a hand leads."""

import math

import pytest
from tests.ursim.cell import Bench
from ursim.motion.led import STIFFNESS_N_M, TOUCH_N, Surface
from ursim.ports.faults import FaultError, PlannedFault

UP = (0.0, 0.0, 1.0)
PRESS = "force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,{force},0,0,0], 2, [0.01,0.01,{speed},0.1,0.1,0.1])"
HOLD = "def p():\n{}\n sleep(60)\nend\n"


def pressing(force=-10, speed=0.02, depth_m=0.01):
    """An arm whose tool is that high above a face, and goes for it."""
    bench = Bench()
    x, y, z = bench.robot.tool_pose[:3]
    bench.robot.surfaces.append(Surface((x, y, z - depth_m), UP))
    assert bench.load(HOLD.format(" " + PRESS.format(force=force, speed=speed))) is None
    return bench, (x, y, z)


def test_a_tool_goes_at_its_limit_until_it_touches_and_then_presses_as_hard_as_asked():
    bench, (x, y, z) = pressing()
    bench.tick(200)
    assert bench.robot.tool_speed()[2] == pytest.approx(-0.02, rel=1e-3)
    assert bench.robot.tool_force() == (0.0,) * 6
    bench.tick(1_000)
    assert bench.robot.tool_force()[2] == pytest.approx(10.0, rel=1e-3)
    assert bench.robot.tool_pose[:2] == pytest.approx((x, y), abs=1e-4)
    assert bench.robot.tool_pose[2] == pytest.approx(z - 0.01 - 10.0 / STIFFNESS_N_M, abs=1e-5)
    assert max(map(abs, bench.robot.drive.now.qd)) < 1e-6


def test_the_end_of_force_mode_stops_the_arm():
    bench = Bench()
    text = "def p():\n {}\n sleep(0.2)\n end_force_mode()\n sleep(60)\nend\n"
    assert bench.load(text.format(PRESS.format(force=-10, speed=0.02))) is None
    bench.tick(150)
    assert not bench.robot.drive.moving
    assert bench.exceptions == []


def test_a_weaker_gain_and_a_stronger_damping_are_slower():
    speeds = []
    for setting in ("", "force_mode_set_gain_scaling(0.2)", "force_mode_set_damping(0.9)"):
        bench = Bench()
        assert bench.load(HOLD.format(f" {setting}\n " + PRESS.format(force=-2, speed=0.2))) is None
        bench.tick(200)
        speeds.append(-bench.robot.tool_speed()[2])
    assert speeds[0] > 3 * speeds[1] > 0
    assert speeds[0] > 3 * speeds[2] > 0


@pytest.mark.parametrize("mode", ["freedrive_mode()", "teach_mode()"])
def test_a_hand_moves_an_arm_that_may_be_led_and_no_other(mode):
    bench = Bench()
    bench.robot.hand = (0.1, 0.0, 0.0, 0.0, 0.0, -0.2)
    before = bench.robot.drive.now.q
    bench.tick(100)
    assert bench.robot.drive.now.q == before
    end = mode.replace("freedrive", "end_freedrive").replace("teach", "end_teach")
    assert bench.load(f"def p():\n {mode}\n sleep(1)\n {end}\n sleep(60)\nend\n") is None
    bench.tick(600)
    moved = [b - a for a, b in zip(before, bench.robot.drive.now.q, strict=True)]
    assert moved == pytest.approx([0.1, 0.0, 0.0, 0.0, 0.0, -0.2], abs=0.01)
    assert not bench.robot.drive.moving


def test_a_hand_moves_it_along_the_free_axes_alone():
    bench = Bench()
    bench.robot.hand = (0.0, 0.1, 0.0, 0.0, 0.0, 0.0)
    x, y, z = bench.robot.tool_pose[:3]
    assert bench.load(HOLD.format(" freedrive_mode([0, 0, 1, 0, 0, 0])")) is None
    bench.tick(500)
    there = bench.robot.tool_pose
    assert abs(there[2] - z) > 0.01
    assert math.hypot(there[0] - x, there[1] - y) < 1e-3


SEEK = """def p():
 n = 0
 while n == 0:
  speedl([0, 0, {speed}, 0, 0, 0], a=1, t=0.002)
  n = tool_contact({direction})
 end
 stopl(3)
 movel(get_actual_joint_positions_history(n), a=1.2, v=0.25)
 write_output_integer_register(0, 1)
end
"""


def sought(direction="[0, 0, -1, 0, 0, 0]", speed=-0.02, depth_m=0.01):
    bench = Bench()
    x, y, z = bench.robot.tool_pose[:3]
    bench.robot.surfaces.append(Surface((x, y, z - depth_m), UP))
    assert bench.load(SEEK.format(direction=direction, speed=speed)) is None
    return bench, z - depth_m


@pytest.mark.parametrize("direction", ["", "[0, 0, 0, 0, 0, 0]", "[0, 0, -1, 0, 0, 0]", "get_target_tcp_speed()"])
def test_a_tool_that_meets_a_face_has_a_contact_and_finds_back_to_it(direction):
    bench, face_m = sought(direction)
    bench.tick(150)
    assert bench.out(0) == 0, "there is nothing in the open"
    bench.until(lambda: bench.out(0) == 1, 1_000)
    assert bench.exceptions == []
    assert bench.robot.tool_pose[2] == pytest.approx(face_m - TOUCH_N / STIFFNESS_N_M, abs=1e-4)


def test_a_face_is_no_contact_in_a_direction_that_leads_away_from_it():
    bench, face_m = sought("[0, 0, 1, 0, 0, 0]")
    bench.tick(500)
    assert bench.robot.tool_pose[2] < face_m
    assert bench.out(0) == 0


def test_a_tool_that_has_left_a_face_touches_it_no_more():
    bench, _ = sought(speed=0.02, depth_m=-0.001)
    bench.tick()
    assert bench.robot.touching_since((0.0, 0.0, 0.0)) is not None
    bench.robot.surfaces.clear()
    bench.tick()
    assert bench.robot.touching_since((0.0, 0.0, 0.0)) is None


@pytest.mark.parametrize("text", ["push=4,0,0,0,0,0", "push=1,2", "surface=11", "surface=nan"])
def test_a_hand_or_a_face_that_cannot_be_is_refused(text):
    with pytest.raises(FaultError):
        PlannedFault.parse(text)
