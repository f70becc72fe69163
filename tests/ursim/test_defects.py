"""Defects of ur_rtde 1.6.5 and its script on a robot, each shown on the simulated one by the real client."""

import json
import math
import signal
import subprocess
import sys
import threading
import time

import pytest
from tests.ursim.cell import HOME, let_go, until
from ursim.ports.launch import SimulatedController

rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")
rtde_receive = pytest.importorskip("rtde_receive", reason="ur_rtde is not installed")
rtde_io = pytest.importorskip("rtde_io", reason="ur_rtde is not installed")

pytestmark = pytest.mark.e2e

PLAYING = 2

MOVE_AND_HANG = """
import json, sys, time, rtde_control
control = rtde_control.RTDEControlInterface(sys.argv[1])
getattr(control, sys.argv[2])(*json.loads(sys.argv[3]))
print("moving", flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize(
    ("method", "arguments", "axis"),
    [("speedL", [[0, 0, 0.02, 0, 0, 0], 0.5, 0.0], 2), ("jogStart", [[0, 0, 0.02, 0, 0, 0]], 2)],
)
def test_a_stream_outlives_its_client(cell, receive, method, arguments, axis):
    """Defect 1, beside `speedJ`, which is shown in test_ur_rtde."""
    command = [sys.executable, "-c", MOVE_AND_HANG, cell.host, method, json.dumps(arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as client:
        try:
            assert client.stdout.readline() == "moving\n"
            until(lambda: receive.getActualTCPSpeed()[axis] == pytest.approx(0.02, abs=1e-3))
        finally:
            client.send_signal(signal.SIGKILL)
    since = receive.getTimestamp()
    until(lambda: receive.getTimestamp() - since > 1.0)
    assert receive.getActualTCPSpeed()[axis] == pytest.approx(0.02, abs=1e-3)
    assert receive.getRuntimeState() == PLAYING


def test_servoc_outlives_its_client_too(cell, receive):
    pose = receive.getActualTCPPose()
    goal = [pose[0], pose[1], pose[2] + 0.1, *pose[3:]]
    command = [sys.executable, "-c", MOVE_AND_HANG, cell.host, "servoC", json.dumps([goal, 0.05, 0.5, 0.0])]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as client:
        assert client.stdout.readline() == "moving\n"
        until(lambda: receive.getActualTCPSpeed()[2] > 0.04)
        client.kill()
    until(lambda: math.dist(receive.getActualTCPPose()[:3], goal[:3]) < 1e-4)


def test_servoc_poisons_the_handshake(control, receive):
    """Defect 2: the client never clears the command, so the script never sees the next: a stop is not executed."""
    pose = receive.getActualTCPPose()
    goal = [pose[0], pose[1], pose[2] + 0.12, *pose[3:]]
    assert control.servoC(goal, 0.05, 0.5, 0.0)
    until(lambda: receive.getActualTCPSpeed()[2] == pytest.approx(0.05, abs=1e-3))
    begun = time.monotonic()
    control.stopL(10.0)
    assert time.monotonic() - begun > 3.0  # it waited for a script that was ready for nothing
    until(lambda: math.dist(receive.getActualTCPPose()[:3], goal[:3]) < 1e-3)  # as if nobody had said stop
    assert control.isProgramRunning()


@pytest.mark.parametrize("version", ["5.11", "5.22"])
def test_the_upper_registers_work_below_5_23(version):
    """Defect 3 begins with PolyScope 5.23, which is not simulated."""
    with SimulatedController.start(joints=HOME, version=version) as cell:
        control = rtde_control.RTDEControlInterface(
            cell.host,
            500.0,
            rtde_control.RTDEControlInterface.FLAG_UPLOAD_SCRIPT
            | rtde_control.RTDEControlInterface.FLAG_UPPER_RANGE_REGISTERS,
        )
        receive = rtde_receive.RTDEReceiveInterface(cell.host)
        lower = rtde_io.RTDEIOInterface(cell.host)
        assert control.moveJ([0.1, *HOME[1:]], 2.0, 8.0)
        until(lambda: receive.getActualQ()[0] == pytest.approx(0.1, abs=1e-5))
        let_go(lower, control, receive)


def test_a_getter_without_a_wait_gives_what_another_asked_for(control):
    """Defect 4."""
    pose = control.getForwardKinematics()
    assert control.getStepTime() == pytest.approx(pose[0])
    until(lambda: control.getStepTime() == pytest.approx(0.002))


def test_packages_of_the_wrong_length_change_nothing(control, receive):
    """Defect 5: `setExternalForceTorque` sends 52 bytes for 56. What the controller of a robot does is not known."""
    before = receive.getRuntimeState()
    for _ in range(50):
        assert control.setExternalForceTorque([1.0] * 6)
    assert receive.getRuntimeState() == before == PLAYING
    assert receive.getActualTCPForce() == [0.0] * 6
    assert control.moveJ([0.05, *HOME[1:]], 2.0, 8.0)


def test_a_synchronous_stopl_stops_the_joints_until_an_asynchronous_stop_came(control, receive):
    """Defect 6: the type of the stop is shared, and only an asynchronous one sets it."""

    def slowed(stop):
        """Deceleration of the leading joint while it brakes, rad/s2, by the controller's own clock.

        Shoulder and wrist turn against each other, so that the tool does not: its own turning would rule its stop.
        """
        base, shoulder, elbow, wrist, *tool = receive.getActualQ()
        assert control.moveJ([base, shoulder + 0.7, elbow, wrist - 0.7, *tool], 0.6, 8.0, True)
        until(lambda: receive.getActualQd()[1] == pytest.approx(0.6))
        seen, over = [], threading.Event()

        def look():
            while not over.is_set():
                seen.append((receive.getTimestamp(), receive.getActualQd()[1]))
                time.sleep(0.001)

        looking = threading.Thread(target=look)
        looking.start()
        stop()
        until(lambda: receive.getActualQd() == [0.0] * 6)
        over.set()
        looking.join()
        braking = [(stamp, speed) for stamp, speed in seen if 0.1 < speed < 0.5]
        return (braking[0][1] - braking[-1][1]) / (braking[-1][0] - braking[0][0])

    assert slowed(lambda: control.stopL(1.0, False)) == pytest.approx(1.0, rel=0.05)  # rad/s2, of the leading joint
    slowed(lambda: control.stopL(1.0, True))
    until(lambda: control.getAsyncOperationProgress() < 0)
    assert slowed(lambda: control.stopL(1.0, False)) > 1.5  # 1 m/s2 at the tool's distance from the axis


def test_the_analog_channel_that_is_not_named_stays(cell, receive):
    """Defect 8: the client sends uninitialised memory for it."""
    io = rtde_io.RTDEIOInterface(cell.host)
    assert io.setAnalogOutputVoltage(0, 0.75)
    until(lambda: receive.getStandardAnalogOutput0() == pytest.approx(7.5))
    for level in (0.1, 0.2, 0.3):
        assert io.setAnalogOutputVoltage(1, level)
        until(lambda level=level: receive.getStandardAnalogOutput1() == pytest.approx(10 * level))
        assert receive.getStandardAnalogOutput0() == pytest.approx(7.5)
    let_go(io)
