"""`ztpm rtde sim`: a simulated controller in the foreground, in words or as JSON."""

import json
import signal
import socket
import subprocess
import sys

import pytest

pytestmark = pytest.mark.e2e

HOST = "127.93.0.3"


def started(*options):
    command = [sys.executable, "-c", "from ztpm.cli import main; main()", "rtde", "sim", "--host", HOST, *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


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
