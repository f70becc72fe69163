"""The unmodified ur_rtde wheel against the controller process: what it reads, moves, stops, and survives."""

import math
import os
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from tests.ursim.cell import HOME, let_go, until
from ursim.ports.launch import SimulatedController

rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")
rtde_receive = pytest.importorskip("rtde_receive", reason="ur_rtde is not installed")
rtde_io = pytest.importorskip("rtde_io", reason="ur_rtde is not installed")

pytestmark = pytest.mark.e2e

TARGET = [0.5, *HOME[1:]]
PLAYING, STOPPED = 2, 1


def speed(receive):
    return max(map(abs, receive.getActualQd()))


def running(control):
    return control.getAsyncOperationProgress() >= 0


def test_receive_tells_the_state(receive):
    assert receive.getActualQ() == pytest.approx(HOME, abs=1e-12)
    assert receive.getRobotMode() == 7
    assert receive.getSafetyMode() == 1
    assert receive.getRuntimeState() == STOPPED
    assert receive.getPayload() == 0.0
    assert math.dist(receive.getActualTCPPose()[:3], (-0.29854944, -0.13104966, 0.30330031)) < 1e-7


def test_the_timestamp_is_steps_of_two_milliseconds_and_no_package_is_skipped(receive):
    seen = []

    def collect():
        seen.append(receive.getTimestamp())
        return len(seen) > 200

    until(collect, pause_s=0.001)
    steps = [t / 0.002 for t in seen]
    assert steps[0] > 20_000  # above 40 s from the start
    assert all(abs(s - round(s)) < 1e-5 for s in steps)


def snapshot(receive):
    """Time, angle and speed of the first joint out of one package."""
    while True:
        found = (receive.getTimestamp(), receive.getActualQ()[0], receive.getActualQd()[0])
        if receive.getTimestamp() == found[0]:
            return found


def record(receive):
    """Samples from the first motion to the next rest; a loaded host may miss some."""
    samples = []

    def rest():
        samples.append(snapshot(receive))
        return samples[-1][2] == 0.0

    until(lambda: speed(receive) > 0.0, pause_s=0.0005)
    until(rest, pause_s=0.0005)
    return samples


def test_movej_reaches_its_target(control, receive):
    assert control.moveJ(TARGET, 1.0, 2.0)
    until(lambda: receive.getActualQ() == pytest.approx(TARGET, abs=1e-4), deadline_s=1.0)
    assert control.isSteady()


def test_movej_takes_the_time_of_its_trapezoid(control, receive):
    v, a = 1.0, 2.0
    assert control.moveJ(TARGET, v, a, True)
    samples = record(receive)
    rising = next(s for s in samples if 0.0 < s[2] < v - 1e-6 and s[1] < 0.25)
    falling = [s for s in samples if 0.0 < s[2] < v - 1e-6 and s[1] > 0.25][-1]
    begun = rising[0] - math.sqrt(2 * rising[1] / a)  # exact, however late the first sample came
    ended = falling[0] + math.sqrt(2 * (TARGET[0] - falling[1]) / a)
    assert ended - begun == pytest.approx(TARGET[0] / v + v / a, abs=1e-5)


def test_an_async_move_is_polled_to_its_end(control, receive):
    assert control.moveJ(TARGET, 1.0, 4.0, True)
    until(lambda: running(control))
    assert not control.isSteady()
    until(lambda: not running(control))
    assert control.isSteady()
    until(lambda: receive.getActualQ() == pytest.approx(TARGET, abs=1e-4), deadline_s=1.0)


@pytest.mark.parametrize("deceleration", [1.0, 8.0])
@pytest.mark.parametrize("asynchronous", [False, True])
def test_stopj_brakes_as_hard_as_it_says(control, receive, deceleration, asynchronous):
    assert control.moveJ([3.0, *HOME[1:]], 1.0, 8.0, True)
    until(lambda: receive.getActualQd()[0] == pytest.approx(1.0))
    with ThreadPoolExecutor() as pool:
        samples = pool.submit(record, receive)
        control.stopJ(deceleration, asynchronous)
        slowing = [s for s in samples.result() if s[2] < 1.0 - 1e-6]
    (t0, q0, v0), (t1, _, v1) = slowing[0], slowing[-2]
    assert v0 > v1 > 0.0
    assert (v0 - v1) / (t1 - t0) == pytest.approx(deceleration, rel=1e-4)
    assert slowing[-1][1] - q0 == pytest.approx(v0**2 / (2 * deceleration), abs=1e-6)
    assert slowing[-1][0] - t0 < v0 / deceleration + 0.05


def test_streams_and_getters(control, receive):
    assert control.isPoseWithinSafetyLimits(receive.getActualTCPPose())
    assert not control.isJointsWithinSafetyLimits([7.0, *HOME[1:]])
    assert control.getForwardKinematics() == pytest.approx(receive.getActualTCPPose(), abs=1e-9)
    goal = list(HOME)
    for i in range(100):
        begun = control.initPeriod()
        goal[0] = 0.001 * i
        assert control.servoJ(goal, 0.0, 0.0, 0.002, 0.05, 300)
        control.waitPeriod(begun)
    until(lambda: receive.getActualQ()[0] == pytest.approx(0.099, abs=1e-3))
    control.servoStop()
    until(lambda: speed(receive) == 0.0, deadline_s=1.0)
    pose = receive.getActualTCPPose()
    pose[2] += 0.03
    assert control.moveL(pose, 0.2, 1.0)
    until(lambda: receive.getActualTCPPose() == pytest.approx(pose, abs=1e-6), deadline_s=1.0)


MOVE_AND_HANG = """
import sys, time, rtde_control
control = rtde_control.RTDEControlInterface(sys.argv[1])
control.speedJ([0.3, 0, 0, 0, 0, 0], 2.0, 0.0)
print("moving", flush=True)
time.sleep(60)
"""


def test_motion_outlives_its_client_until_somebody_stops_it(cell, receive):
    with subprocess.Popen(
        [sys.executable, "-c", MOVE_AND_HANG, cell.host], stdout=subprocess.PIPE, text=True
    ) as client:
        try:
            assert client.stdout.readline() == "moving\n"
            until(lambda: receive.getActualQd()[0] == pytest.approx(0.3))
        finally:
            client.send_signal(signal.SIGKILL)
        client.wait()
    at, since = receive.getActualQ()[0], receive.getTimestamp()
    until(lambda: receive.getTimestamp() - since > 1.0)
    assert receive.getActualQ()[0] - at == pytest.approx(0.3, abs=0.02)
    assert receive.getRuntimeState() == PLAYING
    with socket.create_connection((cell.host, 30003)) as script:
        script.sendall(b"def ender():\n  stopj(4.0)\nend\n")
        until(lambda: speed(receive) == 0.0, deadline_s=2.0)
        until(lambda: receive.getRuntimeState() == STOPPED)
    successor = rtde_control.RTDEControlInterface(cell.host)  # what the dead client owned is free
    assert successor.moveJ(list(HOME), 1.0, 4.0)
    let_go(successor)


def test_a_client_that_takes_over_from_a_dead_one_stops_its_motion(cell, receive):
    with subprocess.Popen(
        [sys.executable, "-c", MOVE_AND_HANG, cell.host], stdout=subprocess.PIPE, text=True
    ) as client:
        assert client.stdout.readline() == "moving\n"
        client.kill()
    successor = rtde_control.RTDEControlInterface(cell.host)
    successor.stopJ(4.0)
    until(lambda: speed(receive) == 0.0, deadline_s=1.0)
    assert successor.moveJ(list(HOME), 1.0, 4.0)
    let_go(successor)


def test_speedj_is_ended_by_speedstop(control, receive):
    assert control.speedJ([0.0, 0.0, 0.0, 0.0, 0.0, 1.0], 8.0, 0.0)
    until(lambda: speed(receive) == pytest.approx(1.0))
    control.speedStop(4.0)
    until(lambda: speed(receive) == 0.0, deadline_s=1.0)


def test_inputs_have_one_owner_and_are_free_again_when_it_leaves(cell, control):
    with pytest.raises(RuntimeError):
        rtde_control.RTDEControlInterface(cell.host)
    assert control.isConnected()
    assert control.moveJ([0.05, *HOME[1:]], 1.0, 4.0)
    control.disconnect()
    successor = rtde_control.RTDEControlInterface(cell.host)
    assert successor.moveJ(list(HOME), 1.0, 4.0)
    let_go(successor)


def test_receive_comes_back_after_its_connection_was_dropped(cell, receive):
    # Not so the control interface: its automatic reconnection crashes the client's process (ur_rtde 1.6.5).
    cell.fault("drop_connections")
    until(lambda: not receive.isConnected())
    assert receive.reconnect()
    before = receive.getTimestamp()
    until(lambda: receive.getTimestamp() > before)


def test_the_watchdog_stops_the_arm_when_nobody_kicks_it(control, receive):
    assert control.setWatchdog(10.0)
    assert control.moveJ([3.0, *HOME[1:]], 1.0, 8.0, True)

    def kick():
        control.kickWatchdog()
        return receive.getActualQd()[0] > 0.99

    until(kick, pause_s=0.02)
    until(lambda: receive.getRuntimeState() != PLAYING, deadline_s=2.0)
    until(lambda: speed(receive) == 0.0, deadline_s=2.0)
    assert receive.getActualQ()[0] < 1.5


def test_a_protective_stop_brakes_and_movej_says_false(control, receive):
    assert control.moveJ([3.0, *HOME[1:]], 1.0, 8.0, True)
    until(lambda: receive.getActualQd()[0] == pytest.approx(1.0))
    control.triggerProtectiveStop()
    until(receive.isProtectiveStopped)
    until(lambda: speed(receive) == 0.0)
    at = receive.getActualQ()
    assert not control.moveJ(list(HOME), 1.0, 1.0)
    assert receive.getActualQ() == at


def test_io_interface_sets_outputs_and_slider(cell, control, receive):
    io = rtde_io.RTDEIOInterface(cell.host)
    assert io.setStandardDigitalOut(2, True)
    until(lambda: receive.getDigitalOutState(2))
    assert io.setToolDigitalOut(1, True)
    until(lambda: receive.getActualDigitalOutputBits() == 1 << 2 | 1 << 17)
    assert io.setSpeedSlider(0.5)
    until(lambda: receive.getTargetSpeedFraction() == pytest.approx(0.5))
    begun = receive.getTimestamp()
    assert control.moveJ([0.2, *HOME[1:]], 1.0, 8.0)
    assert receive.getTimestamp() - begun > 2 * 0.2  # half as fast
    let_go(io)


def test_a_path_and_a_custom_script(control, receive):
    path = [[0.1, *HOME[1:], 2.0, 4.0, 0.0], [-0.1, *HOME[1:], 2.0, 4.0, 0.0]]
    assert control.moveJ(path)
    until(lambda: receive.getActualQ()[0] == pytest.approx(-0.1, abs=1e-4), deadline_s=1.0)
    assert control.sendCustomScriptFunction("there", "movej([0.1,-1.5708,1.5708,-1.5708,-1.5708,0],a=4,v=2)\n")
    until(lambda: receive.getActualQ()[0] == pytest.approx(0.1, abs=1e-4), deadline_s=1.0)
    assert control.moveJ(list(HOME), 1.0, 4.0)


def test_clients_connect_quickly(cell):
    begun = time.monotonic()
    receive = rtde_receive.RTDEReceiveInterface(cell.host)
    control = rtde_control.RTDEControlInterface(cell.host)
    assert time.monotonic() - begun < 5.0  # some 0.15 s on an idle host; the client itself gives up after 5
    let_go(control, receive)


@pytest.mark.parametrize("version", ["5.15", "5.22"])
def test_younger_versions(version):
    with SimulatedController.start(joints=HOME, version=version) as cell:
        control = rtde_control.RTDEControlInterface(cell.host)
        receive = rtde_receive.RTDEReceiveInterface(cell.host)
        assert control.moveJ([0.1, *HOME[1:]], 1.0, 4.0)
        until(lambda: receive.getActualQ()[0] == pytest.approx(0.1, abs=1e-4), deadline_s=1.0)
        let_go(control, receive)


def test_a_slower_stream_is_as_slow_as_it_asked(cell):
    receive = rtde_receive.RTDEReceiveInterface(cell.host, 125.0)
    seen = {receive.getTimestamp()}

    def collect():
        seen.add(receive.getTimestamp())
        return len(seen) > 60

    until(collect, pause_s=0.0005)
    let_go(receive)
    gaps = sorted(b - a for a, b in zip(sorted(seen), sorted(seen)[1:], strict=False))
    assert gaps[len(gaps) // 2] == pytest.approx(0.008, abs=1e-6)
    assert gaps[0] > 0.007


def test_the_process_ends_with_its_parent_and_by_signal(cell):
    assert cell.process.poll() is None
    os.kill(cell.process.pid, signal.SIGINT)
    assert cell.process.wait(10) == 0
