"""Other requests of a cell to its controller, by the unmodified clients.

Streams, lines, paths, outputs, safety, slider, gripper, panel.
"""

import math
import socket
import time

import pytest
from pep.rtde.robot.gripper import RobotiqGripper
from tests.ursim.cell import HOME, let_go, until
from ursim.ports.launch import SimulatedController

rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")
rtde_io = pytest.importorskip("rtde_io", reason="ur_rtde is not installed")
dashboard_client = pytest.importorskip("dashboard_client", reason="ur_rtde is not installed")

pytestmark = pytest.mark.e2e

PLAYING, PAUSED = 2, 4
PROTECTIVE_STOPPED, NORMAL = 1 << 2, 1 << 0


def at_rest(receive):
    return all(speed == 0.0 for speed in receive.getActualQd())


def test_a_servoj_stream_at_500_hz_is_followed(control, receive):
    """The arm follows 0.5 s of a half cosine with its lookahead's lag and ends at the target."""
    way, goal = 0.2, list(HOME)
    begun = receive.getTimestamp()
    for i in range(250):
        period = control.initPeriod()
        goal[0] = way * 0.5 * (1 - math.cos(math.pi * (i + 1) / 250))
        assert control.servoJ(goal, 0.0, 0.0, 0.002, 0.03, 300)
        control.waitPeriod(period)
    assert receive.getTimestamp() - begun >= 0.5 - 0.01
    until(lambda: receive.getActualQ()[0] == pytest.approx(way, abs=1e-3), deadline_s=2.0)
    control.servoStop(8.0)
    until(lambda: at_rest(receive), deadline_s=2.0)
    assert receive.getActualQ()[0] == pytest.approx(way, abs=1e-3)
    assert receive.getActualQ()[1:] == pytest.approx(HOME[1:], abs=1e-6)
    assert control.moveJ(list(HOME), 1.0, 4.0)


def test_a_servoj_stream_that_stops_coming_holds_its_last_target(control, receive):
    goal = [0.1, *HOME[1:]]
    assert control.servoJ(goal, 0.0, 0.0, 0.002, 0.03, 300)
    until(lambda: receive.getActualQ()[0] == pytest.approx(0.1, abs=1e-4))
    until(lambda: max(map(abs, receive.getActualQd())) < 1e-3)


def test_movel_is_straight_and_exact(control, receive):
    start = receive.getActualTCPPose()
    goal = [start[0] + 0.05, start[1] - 0.04, start[2] + 0.03, *start[3:]]
    length = math.dist(start[:3], goal[:3])
    assert control.moveL(goal, 0.1, 0.5, True)
    off = []

    def arrived():
        pose = receive.getActualTCPPose()
        along = sum((p - s) * (g - s) for p, s, g in zip(pose[:3], start[:3], goal[:3], strict=True)) / length
        foot = [s + along * (g - s) / length for s, g in zip(start[:3], goal[:3], strict=True)]
        off.append(math.dist(pose[:3], foot))
        return pose == pytest.approx(goal, abs=1e-6) and at_rest(receive)

    until(arrived)
    assert len(off) > 20
    assert max(off) < 1e-6
    assert not control.moveL([5.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.1, 0.5)  # out of reach: a protective stop, no motion


def test_a_path_goes_through_each_of_its_waypoints_in_order(control, receive):
    turns = (0.1, -0.1, 0.15, 0.0)
    path = [[turn, *HOME[1:], 1.0, 4.0, 0.0] for turn in turns]
    assert control.moveJ(path, True)
    seen = []

    def over():
        seen.append(receive.getActualQ()[0])
        return len(seen) > 20 and at_rest(receive) and seen[-1] == pytest.approx(turns[-1], abs=1e-6)

    until(over)
    passed = [next(i for i, q in enumerate(seen) if abs(q - turn) < 0.02) for turn in turns[:-1]]
    assert passed == sorted(passed)
    assert max(seen) == pytest.approx(0.15, abs=1e-3)
    assert min(seen) == pytest.approx(-0.1, abs=1e-3)


def test_a_path_may_mix_lines_and_joint_moves(control, receive):
    from rtde_control import Path, PathEntry

    pose = receive.getActualTCPPose()
    pose[2] += 0.04
    path = Path()
    path.addEntry(PathEntry(PathEntry.MoveJ, PathEntry.PositionJoints, [0.1, *HOME[1:], 1.0, 4.0, 0.0]))
    path.addEntry(PathEntry(PathEntry.MoveL, PathEntry.PositionTcpPose, [*pose, 0.25, 1.2, 0.0]))
    assert control.movePath(path)
    # A turn of nearly pi has two vectors; the place has one.
    until(lambda: receive.getActualTCPPose()[:3] == pytest.approx(pose[:3], abs=1e-6))
    assert max(abs(q - h) for q, h in zip(receive.getActualQ(), HOME, strict=True)) < 0.5


def test_every_digital_output_of_each_kind(cell, receive):
    io = rtde_io.RTDEIOInterface(cell.host)
    for pin in range(8):
        assert io.setStandardDigitalOut(pin, True)
        until(lambda pin=pin: receive.getActualDigitalOutputBits() == (1 << (pin + 1)) - 1, deadline_s=2.0)
    for pin in (0, 7):
        assert io.setConfigurableDigitalOut(pin, True)
    for pin in (0, 1):
        assert io.setToolDigitalOut(pin, True)
    until(lambda: receive.getActualDigitalOutputBits() == 0xFF | 1 << 8 | 1 << 15 | 3 << 16, deadline_s=2.0)
    assert io.setStandardDigitalOut(3, False)
    assert io.setToolDigitalOut(0, False)
    until(lambda: receive.getActualDigitalOutputBits() == 0xF7 | 1 << 8 | 1 << 15 | 2 << 16, deadline_s=2.0)
    let_go(io)


def dashboard_of(cell):
    client = dashboard_client.DashboardClient(cell.host)
    client.connect()
    return client


def test_a_protective_stop_in_a_move_is_told_and_a_person_recovers_from_it(cell, control, receive):
    assert control.moveJ([2.0, *HOME[1:]], 0.5, 8.0, True)
    until(lambda: receive.getActualQd()[0] == pytest.approx(0.5))
    cell.fault("protective_stop")
    until(receive.isProtectiveStopped)
    assert receive.getSafetyStatusBits() & PROTECTIVE_STOPPED
    assert not receive.getSafetyStatusBits() & NORMAL
    assert receive.getRobotStatus() & 1  # power stays on
    until(lambda: at_rest(receive))
    until(lambda: receive.getRuntimeState() == PAUSED)
    assert receive.getRobotStatus() & 2 == 0  # no program runs
    stopped_at = receive.getActualQ()[0]
    assert 0.0 < stopped_at < 2.0

    dashboard = dashboard_of(cell)
    assert dashboard.safetystatus().endswith("PROTECTIVE_STOP")
    with pytest.raises(RuntimeError):
        dashboard.unlockProtectiveStop()  # not within the first 5 s
    assert receive.isProtectiveStopped()
    cell.fault("protective_stop_ages")

    def unlocked():
        try:
            dashboard.unlockProtectiveStop()
        except RuntimeError:
            return False
        return True

    until(unlocked, pause_s=0.1)
    until(lambda: not receive.isProtectiveStopped())
    assert receive.getActualQ()[0] == stopped_at  # an unlock moves nothing
    dashboard.stop()
    assert control.reuploadScript()
    until(control.isProgramRunning)
    assert control.moveJ(list(HOME), 1.0, 4.0)
    dashboard.disconnect()


def test_half_the_slider_is_half_the_speed(cell, control, receive):
    io = rtde_io.RTDEIOInterface(cell.host)

    def cruise(target):
        assert control.moveJ([target, *HOME[1:]], 0.6, 8.0, True)
        speeds = []

        def over():
            speeds.append(abs(receive.getActualQd()[0]))
            return len(speeds) > 5 and max(speeds) > 0.0 and at_rest(receive)

        until(over)
        return max(speeds)

    assert cruise(0.3) == pytest.approx(0.6, rel=1e-6)
    assert io.setSpeedSlider(0.5)
    until(lambda: receive.getSpeedScaling() == pytest.approx(0.5))
    assert cruise(0.0) == pytest.approx(0.3, rel=1e-6)
    assert io.setSpeedSlider(1.0)
    until(lambda: receive.getSpeedScaling() == pytest.approx(1.0))
    assert cruise(0.3) == pytest.approx(0.6, rel=1e-6)
    let_go(io)


def test_the_gripper_learns_its_stroke_and_a_stop_ends_that(cell):
    gripper = RobotiqGripper(cell.host)
    asked = []
    grip = gripper.activate(stopped=lambda: asked.append(0) or len(asked) > 5)
    assert not grip.arrived
    assert grip.width_um < 85_000
    stands = ask(cell, "GET POS")
    due = time.monotonic() + 0.2
    while time.monotonic() < due:
        assert ask(cell, "GET POS") == stands  # not active, and nowhere on its way
    assert ask(cell, "GET STA") == "STA 0"

    grip = gripper.activate()
    assert grip.arrived
    assert ask(cell, "GET POS") == "POS 0"
    assert gripper.move(width_um=40_000, speed_um_s=150_000, force_mn=20_000, stopped=lambda: False).arrived
    assert gripper.activate().width_um == pytest.approx(40_000, abs=500)  # it is active: nothing moves


def test_the_gripper_says_whether_it_holds_something():
    with SimulatedController.start(joints=HOME, gripper_object_m=0.050) as cell:
        gripper = RobotiqGripper(cell.host)
        asked = {"speed_um_s": 150_000, "force_mn": 20_000, "stopped": lambda: False}
        gripper.activate()
        assert not gripper.move(width_um=60_000, **asked).object
        assert not gripper.holds()
        assert gripper.move(width_um=10_000, **asked).object
        assert gripper.holds()
        assert ask(cell, "SET ACT 0") == "ack"
        assert not gripper.holds()  # without power to its fingers it says nothing


def test_the_stroke_of_activation_ends_at_what_lies_between_the_fingers():
    with SimulatedController.start(joints=HOME, gripper_object_m=0.050) as cell:
        widest = []
        assert ask(cell, "SET ACT 1") == "ack"

        def active():
            widest.append(int(ask(cell, "GET POS").split()[1]))
            return ask(cell, "GET STA") == "STA 3"

        until(active)
        assert max(widest) <= round(228 * (1 - 0.050 / 0.085))
        assert max(widest) > 60
        assert widest[-1] == 0 or ask(cell, "GET POS") == "POS 0"


def ask(cell, line):
    with socket.create_connection((cell.host, 63352), timeout=5) as client:
        client.sendall(line.encode() + b"\n")
        return client.recv(64).decode().strip()


def test_local_control_takes_no_program_and_what_runs_goes_on(cell, control, receive):
    dashboard = dashboard_of(cell)
    assert dashboard.isInRemoteControl()
    cell.fault("local_control")
    until(lambda: not dashboard.isInRemoteControl())
    assert control.moveJ([0.1, *HOME[1:]], 1.0, 4.0)  # its script was running before
    with socket.create_connection((cell.host, 30003)) as script:
        script.sendall(b"def other():\n movej([0.5,-1.57,1.57,-1.57,-1.57,0])\nend\n")
        assert control.moveJ(list(HOME), 1.0, 4.0)
    assert dashboard.programState().startswith("PLAYING")
    control.disconnect()
    with pytest.raises(RuntimeError):
        rtde_control.RTDEControlInterface(cell.host)
    cell.fault("remote_control")
    until(dashboard.isInRemoteControl)
    successor = rtde_control.RTDEControlInterface(cell.host)
    assert successor.moveJ([0.1, *HOME[1:]], 1.0, 4.0)
    let_go(successor)
    dashboard.disconnect()


def test_a_time_given_to_speedj_ends_nothing(control, receive):
    """The script repeats the motion until it is told to stop: that time is no dead man."""
    assert control.speedJ([0.2, 0.0, 0.0, 0.0, 0.0, 0.0], 4.0, 0.1)
    until(lambda: receive.getActualQ()[0] > 0.2)  # a second later
    assert receive.getActualQd()[0] == pytest.approx(0.2)
    control.speedStop(8.0)
    until(lambda: at_rest(receive))


def test_payload_and_tool_are_told_as_they_were_set(control, receive):
    assert control.setPayload(1.25, [0.0, 0.01, 0.06])
    until(lambda: receive.getPayload() == 1.25)
    assert receive.getPayloadCog() == pytest.approx([0.0, 0.01, 0.06])
    before = receive.getActualTCPPose()
    assert control.setTcp([0.0, 0.0, 0.1767, 0.0, 0.0, 0.0])
    until(lambda: math.dist(receive.getActualTCPPose()[:3], before[:3]) == pytest.approx(0.1767, abs=1e-9))
    assert control.getTCPOffset() == pytest.approx([0.0, 0.0, 0.1767, 0.0, 0.0, 0.0])
