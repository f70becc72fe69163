"""Operational modes and the two kinds of control: their rights on the wire, and the signs of a change."""

import socket
import struct

import pytest
from tests.ursim.cell import HOME, until
from ursim.ports.launch import SimulatedController

rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")

pytestmark = pytest.mark.e2e

DASHBOARD, PRIMARY, SECONDARY, REALTIME = 29999, 30001, 30002, 30003
STATE, MESSAGE, ERROR, EXCEPTION, KEY = 16, 20, 6, 10, 7
MASTERBOARD = 3
READ_ONLY, MODE_CHANGED = 210, 211
NONE, AUTOMATIC, MANUAL = 0, 1, 2  # the argument of message 211
NOT_REMOTE = "Command is not allowed due to safety reasons"


@pytest.fixture(scope="module")
def cell():
    with SimulatedController.start(joints=HOME) as controller:
        yield controller
    assert controller.process.returncode == 0


class Panel:
    """A dashboard client."""

    def __init__(self, cell):
        self.socket = socket.create_connection((cell.host, DASHBOARD), timeout=5)
        self.lines = self.socket.makefile("rwb")
        self.lines.readline()

    def ask(self, line):
        self.lines.write(line.encode() + b"\n")
        self.lines.flush()
        return self.lines.readline().decode().rstrip("\n")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.lines.close()
        self.socket.close()


class Watcher:
    """A primary client that reads frames with `struct` alone."""

    def __init__(self, cell):
        self.socket = socket.create_connection((cell.host, PRIMARY), timeout=5)
        self.held = b""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def frame(self):
        while len(self.held) < 5 or len(self.held) < struct.unpack_from(">i", self.held)[0]:
            received = self.socket.recv(65536)
            assert received
            self.held += received
        size, kind = struct.unpack_from(">iB", self.held)
        body, self.held = self.held[5:size], self.held[size:]
        return kind, body

    def error(self):
        """Code and argument of the next error message, within two seconds of states."""
        for _ in range(20):
            kind, body = self.frame()
            if kind == MESSAGE and body[9] == ERROR:
                return struct.unpack_from(">ii", body, 10)
            assert kind == STATE or body[9] not in {EXCEPTION, KEY}, "a program was taken"
        raise AssertionError("no error is told")

    def mode(self):
        """Operational mode in the Masterboard part of the next state."""
        for _ in range(20):
            kind, body = self.frame()
            while kind == STATE and body:
                size, part = struct.unpack_from(">iB", body)
                if part == MASTERBOARD:
                    return body[size - 3]  # before the enabling device and a reserved byte
                body = body[size:]
        raise AssertionError("no state is told")


def be(cell, panel, kind):
    """Brings the robot to `kind` from any state."""
    cell.fault("local_control" if kind == "local" else "remote_control")
    mode = kind if kind in {"manual", "automatic"} else None
    panel.ask(f"set operational mode {mode}" if mode else "clear operational mode")
    obeys = "false" if kind in {"local", "manual"} else "true"
    until(lambda: panel.ask("is in remote control") == obeys)


@pytest.fixture
def panel(cell):
    with Panel(cell) as client:
        yield client
        be(cell, client, "remote")
        client.ask("stop")


@pytest.mark.parametrize(
    ("line", "said", "mode", "number", "remote"),
    [
        ("set operational mode manual", "Operational mode MANUAL is set", "MANUAL", MANUAL, "false"),
        ("set operational mode automatic", "Operational mode AUTOMATIC is set", "AUTOMATIC", AUTOMATIC, "true"),
        (
            "clear operational mode",
            "No longer controlling the operational mode. Current operational mode: 'NONE'.",
            "NONE",
            NONE,
            "true",
        ),
    ],
)
def test_a_mode_is_set_asked_for_and_told(cell, panel, line, said, mode, number, remote):
    be(cell, panel, "automatic" if mode != "AUTOMATIC" else "manual")
    with Watcher(cell) as watcher:
        watcher.mode()
        assert panel.ask(line) == said
        assert panel.ask("get operational mode") == mode
        assert panel.ask("is in remote control") == remote
        assert watcher.error() == (MODE_CHANGED, number)
        until(lambda: watcher.mode() == number, pause_s=0)
        assert panel.ask(line) == said  # the same again is no change, so nothing is told of it
        assert panel.ask("set operational mode " + ("automatic" if mode == "MANUAL" else "manual"))
        assert watcher.error()[1] != number


@pytest.mark.parametrize(
    ("line", "remote"),
    [
        ("play", "Failed to execute: play"),
        ("load a.urp", "File not found: a.urp"),
        ("load installation a.installation", "File not found: a.installation"),
        ("power on", "Powering on"),
        ("brake release", "Brake releasing"),
        ("unlock protective stop", "Protective stop releasing"),
    ],
)
@pytest.mark.parametrize("kind", ["manual", "automatic", "local", "remote"])
def test_what_readies_or_moves_the_robot_is_for_remote_control(cell, panel, kind, line, remote):
    be(cell, panel, kind)
    told = panel.ask(line)
    if kind in {"manual", "local"}:
        assert told.startswith(NOT_REMOTE)
    else:
        assert told == remote


@pytest.mark.parametrize("kind", ["manual", "local"])
def test_stops_and_questions_are_for_everybody(cell, panel, kind):
    be(cell, panel, kind)
    assert panel.ask("stop") == "Stopped"
    assert panel.ask("robotmode") == "Robotmode: RUNNING"
    assert panel.ask("programState").startswith("STOPPED")


@pytest.mark.parametrize("port", [PRIMARY, SECONDARY, REALTIME])
@pytest.mark.parametrize("sent", ["def no():\n movej([1,-1.57,1.57,-1.57,-1.57,0])\nend\n", "power off\n"])
def test_in_manual_mode_scripts_and_orders_over_the_ports_are_refused_with_their_code(cell, panel, port, sent):
    be(cell, panel, "manual")
    with Watcher(cell) as watcher, socket.create_connection((cell.host, port), timeout=5) as script:
        watcher.mode()
        script.sendall(sent.encode())
        assert watcher.error() == (READ_ONLY, 0)
    assert panel.ask("running") == "Program running: false"
    assert panel.ask("robotmode") == "Robotmode: RUNNING"


def test_what_runs_goes_on_in_manual_mode_is_not_played_again_there_and_is_in_automatic(cell, panel):
    control = rtde_control.RTDEControlInterface(cell.host)
    be(cell, panel, "manual")
    assert control.moveJ([0.1, *HOME[1:]], 2.0, 8.0)
    assert panel.ask("pause") == "Pausing program"
    until(lambda: panel.ask("programState").startswith("PAUSED"))
    assert panel.ask("play").startswith(NOT_REMOTE)
    be(cell, panel, "automatic")
    assert panel.ask("play") == "Starting program"
    until(lambda: panel.ask("programState").startswith("PLAYING"))
    be(cell, panel, "manual")
    control.disconnect()
    with pytest.raises(RuntimeError):
        rtde_control.RTDEControlInterface(cell.host)
