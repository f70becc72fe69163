"""`ztpm rtde sim`: a simulated controller in the foreground, in words or as JSON."""

import contextlib
import json
import signal
import socket
import struct
import subprocess
import sys
import time

import pytest
from ursim.ports.faults import FaultError, PlannedFault

pytestmark = pytest.mark.e2e

HOST = "127.93.0.3"


def started(*options):
    command = [sys.executable, "-c", "from ztpm.cli import main; main()", "rtde", "sim", "--host", HOST, *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


@contextlib.contextmanager
def faulty(*options):
    """Simulator that is killed in the end: waiting for it would hide a test's finding."""
    with started(*options) as process:
        try:
            yield process
        finally:
            process.kill()


def ended(process):
    process.send_signal(signal.SIGINT)
    rest, _ = process.communicate(timeout=20)
    return process.returncode, rest.splitlines()


def panel(line):
    with socket.create_connection((HOST, 29999), timeout=5) as client, client.makefile("rwb") as lines:
        lines.readline()
        lines.write(line)
        lines.flush()
        return lines.readline()


def test_it_says_when_it_is_ready_as_json_and_is_the_version_it_was_told_to_be():
    with started("--json", "--polyscope", "5.15.1", "--joints=0,-1.5,1.5,-1.5,-1.5,0") as process:
        ready = json.loads(process.stdout.readline())
        assert (ready["ready"], ready["host"], ready["polyscope"]) == (True, HOST, "5.15")
        assert set(ready["ports"]) == {29999, 30001, 30002, 30003, 30004, 30011, 30012, 30013, 63352}
        assert panel(b"version\n") == b"5.15.1.0\n"
        status, rest = ended(process)
    assert status == 0
    assert json.loads(rest[-1])["ready"] is False


def test_it_says_it_in_words():
    with started() as process:
        assert HOST in process.stdout.readline()
        status, rest = ended(process)
    assert status == 0
    assert rest
    with pytest.raises(ValueError, match="Expecting value"):
        json.loads(rest[-1])


def test_a_version_that_is_not_simulated_is_refused():
    with started("--json", "--polyscope", "5.23") as process:
        told, _ = process.communicate(timeout=20)
    assert process.returncode == 2
    assert json.loads(told)["error"] == "SETTINGS"


def rtde(kind, payload=b""):
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


def exactly(client, count):
    held = b""
    while len(held) < count:
        received = client.recv(count - len(held))
        assert received
        held += received
    return held


def frame(client):
    """The next RTDE frame, whole, without its length."""
    return exactly(client, struct.unpack(">H", exactly(client, 2))[0] - 2)


def torn(client):
    """True once a version comes in two halves: 2 ms apart, so a late reader sees them as one."""
    for _ in range(10):
        client.sendall(rtde("v"))
        first = client.recv(64)
        assert (first + exactly(client, 19 - len(first)))[:3] == b"\0\x13v"
        if len(first) < 19:
            return True
    return False


def test_faults_of_the_command_line_come_and_those_with_a_time_come_then():
    faults = ("delay=0.1", "torn_frames", "in_use=input_int_register_0,input_int_register_1", "drop_connections@4")
    with faulty(*[f"--fault={each}" for each in faults]) as process:
        process.stdout.readline()
        begun = time.monotonic()
        with socket.create_connection((HOST, 30004), timeout=10) as client:
            client.sendall(rtde("V", b"\0\2"))
            assert frame(client) == b"V\1"
            assert time.monotonic() - begun >= 0.1
            for name in (b"input_int_register_0", b"input_int_register_1"):
                client.sendall(rtde("I", name))
                assert frame(client) == b"I\0IN_USE"
            client.sendall(rtde("I", b"input_int_register_2"))
            assert frame(client) == b"I\1INT32"
            assert torn(client)
            assert client.recv(64) == b""
            assert 3.9 < time.monotonic() - begun < 12
        status, _ = ended(process)
    assert status == 0


def test_a_stop_of_the_command_line_is_a_fault_like_any_other():
    with faulty("--fault", "protective_stop") as process:
        process.stdout.readline()
        due = time.monotonic() + 10
        while panel(b"safetymode\n") != b"Safetymode: PROTECTIVE_STOP\n":
            assert time.monotonic() < due
        assert ended(process)[0] == 0


@pytest.mark.parametrize(
    "fault",
    [
        "meteor", "", "torn_frames=1", "delay", "delay=", "delay=-1", "delay=nan", "delay=61", "delay=soon", "slow_frames=0",
        "slow_frames=1.5", "in_use=actual_q", "in_use=", "stop@", "stop@-1", "stop@nan", "stop@1e9", "stop@1@2",
        "delay=1;stop",
    ],
)  # fmt: skip
def test_what_is_no_fault_is_refused_with_its_reason(fault):
    with pytest.raises(FaultError):
        PlannedFault.parse(fault)


def test_a_wrong_fault_is_refused_before_anything_listens():
    with faulty("--fault", "meteor") as process:
        told, _ = process.communicate(timeout=20)
    assert process.returncode == 2
    assert not told
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((HOST, 29999), timeout=5)
