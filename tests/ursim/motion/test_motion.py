"""Motion: kinematics against the textbook, trapezoids against their formulas, and that every stop is finite."""

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from tests.ursim.cell import HOME, TICK_S
from ursim.motion.arm import Arm
from ursim.motion.drive import Drive
from ursim.motion.motion import (
    ZERO,
    Brake,
    Kinetic,
    MotionError,
    MoveJoints,
    MoveTool,
    ServoJoints,
    SpeedJoints,
    Trapezoid,
)
from ursim.motion.spatial import IDENTITY, from_vector, to_vector
from ursim.motion.values import ScriptRuntimeError

ARM = Arm.load()
FLANGE = ((0.0, 0.0, 0.0), IDENTITY)
angles = st.tuples(*[st.floats(-3.0, 3.0)] * 6)

# Denavit-Hartenberg parameters as the vendor's article lists them: a [m], d [m], alpha [rad].
DH_A = (0.0, -0.24355, -0.2132, 0.0, 0.0, 0.0)
DH_D = (0.15185, 0.0, 0.0, 0.13105, 0.08535, 0.0921)
DH_ALPHA = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)


def textbook(q):
    rows = [[float(i == j) for j in range(4)] for i in range(4)]
    for theta, a, d, alpha in zip(q, DH_A, DH_D, DH_ALPHA, strict=True):
        c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
        step = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        rows = [[sum(rows[i][k] * step[k][j] for k in range(4)) for j in range(4)] for i in range(4)]
    return rows


@given(angles)
def test_forward_kinematics_is_the_textbooks(q):
    rows = textbook(q)
    position, rotation = ARM.tool(q, FLANGE)
    assert position == pytest.approx([rows[i][3] for i in range(3)], abs=1e-12)
    assert rotation == pytest.approx([rows[i][j] for i in range(3) for j in range(3)], abs=1e-12)


def test_the_reported_dh_is_the_textbooks():
    assert ARM.dh == (pytest.approx(DH_A), pytest.approx(DH_D), pytest.approx(DH_ALPHA))


@settings(deadline=None, max_examples=50)
@given(angles, st.tuples(*[st.floats(-0.1, 0.1)] * 6))
def test_inverse_kinematics_reaches_what_is_near(q, off):
    assume(abs(math.sin(q[4])) > 0.2)
    assume(abs(math.sin(q[2])) > 0.2)
    goal = ARM.tool(q, FLANGE)
    found = ARM.reach(goal, [a + b for a, b in zip(q, off, strict=True)], FLANGE)
    assume(found is not None)  # a shoulder singularity in between
    assert ARM.tool(found, FLANGE)[0] == pytest.approx(goal[0], abs=1e-9)


def test_what_is_out_of_reach_has_no_joint_angles():
    assert ARM.reach(((2.0, 0.0, 0.0), IDENTITY), HOME, FLANGE) is None


@given(st.tuples(*[st.floats(-1.7, 1.7)] * 3))
def test_rotation_vectors_survive_their_matrix(v):
    assume(math.hypot(*v) < 3.1)
    assert to_vector(from_vector(v)) == pytest.approx(v, abs=1e-9)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0.8, 0), (0, -0.6, 0.8)])
def test_a_half_turn_has_its_axis(axis):
    half = tuple(math.pi * x for x in axis)
    found = to_vector(from_vector(half))
    assert found == pytest.approx(half, abs=1e-7) or found == pytest.approx([-x for x in half], abs=1e-7)


@given(st.floats(0.001, 6.0), st.floats(0.01, 3.0), st.floats(0.05, 40.0))
def test_a_trapezoid_takes_the_time_of_its_formula(distance, speed, acceleration):
    profile = Trapezoid(distance, speed, acceleration)
    long_enough = distance >= speed**2 / acceleration
    expected = distance / speed + speed / acceleration if long_enough else 2 * math.sqrt(distance / acceleration)
    assert profile.duration_s == pytest.approx(expected)
    samples = [profile.at(expected * i / 200) for i in range(201)]
    assert samples[-1][0] == pytest.approx(distance)
    assert all(b[0] >= a[0] - 1e-12 for a, b in zip(samples, samples[1:], strict=False))
    assert max(v for _, v, _ in samples) <= speed * (1 + 1e-9)
    middle = profile.at(expected / 2)
    assert middle[0] == pytest.approx(distance / 2)


def run(drive, limit=10_000):
    for count in range(1, limit):
        drive.advance(TICK_S)
        if not drive.moving:
            return count
    raise AssertionError("never at rest")


@settings(deadline=None, max_examples=20)
@given(angles, angles, st.floats(0.2, 3.0), st.floats(0.5, 20.0))
def test_a_joint_motion_is_straight_and_ends_on_its_target(start, target, speed, acceleration):
    drive = Drive(ARM, start, stop_deceleration_rad_s2=8.0)
    move = MoveJoints(ARM, start, target, speed_rad_s=speed, acceleration_rad_s2=acceleration)
    drive.take("me", move)
    leading = max(abs(b - a) for a, b in zip(start, target, strict=True))
    assume(leading > 0.05)
    count = 0
    while drive.moving:
        drive.advance(TICK_S)
        count += 1
        parts = [(q - a) / (b - a) for q, a, b in zip(drive.now.q, start, target, strict=True) if abs(b - a) > 1e-3]
        assert max(parts) - min(parts) < 1e-6
        assert all(abs(v) <= j.speed_limit_rad_s + 1e-9 for v, j in zip(drive.now.qd, ARM.joints, strict=True))
    assert drive.now.q == target
    assert count * TICK_S == pytest.approx(move.profile.duration_s, abs=TICK_S * 1.001)


@pytest.mark.parametrize(("speed", "deceleration"), [(3.0, 8.0), (1.0, 2.0), (0.3, 0.5), (6.0, 40.0)])
def test_a_brake_travels_v2_over_2a_in_v_over_a(speed, deceleration):
    drive = Drive(ARM, HOME, stop_deceleration_rad_s2=8.0)
    drive.now = Kinetic(HOME, (0.0, 0.0, 0.0, 0.0, -speed, speed / 2), ZERO)
    drive.take("me", Brake(drive.now, deceleration))
    ticks = run(drive)
    assert drive.now.q[4] - HOME[4] == pytest.approx(-(speed**2) / (2 * deceleration))
    assert drive.now.q[5] - HOME[5] == pytest.approx(speed**2 / (4 * deceleration))  # straight: half as far
    assert ticks * TICK_S == pytest.approx(speed / deceleration, abs=TICK_S * 1.001)


def moving(speed=1.0, *, stop=8.0, start=HOME):
    drive = Drive(ARM, start, stop_deceleration_rad_s2=stop)
    motion = SpeedJoints(ARM)
    motion.aim((speed, 0.0, 0.0, 0.0, 0.0, 0.0), 40.0)
    drive.take("owner", motion)
    for _ in range(100):
        drive.advance(TICK_S)
    assert drive.now.qd[0] == pytest.approx(speed)
    return drive


def test_a_motion_without_an_owner_brakes():
    drive = moving()
    at = drive.now.q[0]
    drive.release("owner")
    run(drive)
    assert drive.now.q[0] - at == pytest.approx(1.0 / 16)


def test_a_stop_taken_over_in_the_same_tick_is_as_weak_as_it_asks():
    drive = moving()
    at = drive.now.q[0]
    drive.release("owner")
    drive.braking("another", 2.0)
    run(drive)
    assert drive.now.q[0] - at == pytest.approx(1.0 / 4)


def test_a_weak_stop_never_weakens_the_brake_that_is_under_way():
    drive = moving()
    at = drive.now.q[0]
    drive.release("owner")
    drive.advance(TICK_S)
    assert drive.braking("another", 0.1).deceleration_rad_s2 == 8.0
    run(drive)
    assert drive.now.q[0] - at == pytest.approx(1.0 / 16)


def test_a_weak_stop_whose_owner_leaves_becomes_a_full_one():
    drive = moving()
    at = drive.now.q[0]
    drive.braking("owner", 0.1)
    drive.halt()
    run(drive)
    assert drive.now.q[0] - at == pytest.approx(1.0 / 16)


def test_two_threads_cannot_move_the_arm_at_once():
    drive = moving()
    with pytest.raises(ScriptRuntimeError):
        drive.take("another", ServoJoints(ARM))
    with pytest.raises(ScriptRuntimeError):
        drive.braking("another", 2.0)


@pytest.mark.parametrize("speed", [0.2, 1.0, 3.0])
@pytest.mark.parametrize("stop", [2.0, 8.0])
def test_the_arm_stops_before_a_joint_limit(speed, stop):
    limit = ARM.joints[0].position_limit_rad
    drive = moving(speed, stop=stop, start=(limit - 3.5, *HOME[1:]))
    with pytest.raises(MotionError):
        for _ in range(20_000):
            drive.advance(TICK_S)
    run(drive)
    assert limit - 0.02 < drive.now.q[0] <= limit


def test_a_target_outside_the_limits_is_never_begun():
    with pytest.raises(MotionError):
        MoveJoints(ARM, HOME, (7.0, *HOME[1:]), speed_rad_s=1.0, acceleration_rad_s2=1.0)


def test_the_speed_slider_slows_a_motion_without_a_jump():
    drive = Drive(ARM, HOME, stop_deceleration_rad_s2=8.0)
    target = (1.0, *HOME[1:])
    drive.take("me", MoveJoints(ARM, HOME, target, speed_rad_s=1.0, acceleration_rad_s2=2.0))
    for _ in range(300):
        drive.advance(TICK_S)
    drive.slider, before = 0.25, drive.now.qd[0]
    for _ in range(150):
        drive.advance(TICK_S)
        assert abs(drive.now.qd[0] - before) < 0.02
        before = drive.now.qd[0]
    assert drive.now.qd[0] == pytest.approx(0.25)
    run(drive)
    assert drive.now.q == target


def test_a_suspended_motion_goes_on_to_its_target():
    drive = Drive(ARM, HOME, stop_deceleration_rad_s2=8.0)
    move = MoveJoints(ARM, HOME, (1.0, *HOME[1:]), speed_rad_s=1.0, acceleration_rad_s2=2.0)
    drive.take("me", move)
    for _ in range(300):
        drive.advance(TICK_S)
    drive.suspend()
    run(drive)
    assert drive.now.q[0] < 0.5
    drive.resume()
    assert drive.motion is move
    run(drive)
    assert drive.now.q[0] == 1.0


def test_a_line_is_straight():
    start = (0.3, -1.4, 1.5, -1.6, -1.4, 0.2)
    (x, y, z), rotation = ARM.tool(start, FLANGE)
    drive = Drive(ARM, start, stop_deceleration_rad_s2=8.0)
    drive.take(
        "me", MoveTool(ARM, FLANGE, start, ((x, y + 0.05, z + 0.1), rotation), speed_m_s=0.2, acceleration_m_s2=1.0)
    )
    while drive.moving:
        drive.advance(TICK_S)
        (a, b, c), turned = ARM.tool(drive.now.q, FLANGE)
        assert a == pytest.approx(x, abs=1e-8)
        assert b - y == pytest.approx((c - z) / 2, abs=1e-8)
        assert turned == pytest.approx(rotation, abs=1e-8)
    assert c - z == pytest.approx(0.1, abs=1e-8)
