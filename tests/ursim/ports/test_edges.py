"""Ports before any client: a broken protocol ends that connection, and nothing else."""

import json
import random
import socket
import struct
import subprocess
import sys

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pep.rtde.wire.codec import Recipe
from pep.rtde.wire.messages import FrameKind
from pep.rtde.wire.variables import INPUTS, OUTPUTS, VariableType
from tests.ursim.cell import HOME, until, upload
from tests.ursim.plain import Plain
from ursim.ports.launch import LaunchError, SimulatedController

from pep.rtde.wire import codec as c
from pep.rtde.wire import messages as m

pytestmark = pytest.mark.e2e

DASHBOARD, PRIMARY, SECONDARY, REALTIME, RTDE, GRIPPER = 29999, 30001, 30002, 30003, 30004, 63352


@pytest.fixture(scope="module")
def cell():
    """One controller for all of this: it must survive everything here."""
    with SimulatedController.start(joints=HOME) as controller:
        yield controller
        assert controller.process.poll() is None
    assert controller.process.returncode == 0


def alive(cell):
    with Plain(cell.host) as client:
        return client.ask(m.AskControlVersion()) == m.ControlVersion(5, 11, 6, 1010327)


def test_set_up_as_the_protocol_says(cell):
    names = ("timestamp", "actual_q", "no_such_output")
    with Plain(cell.host) as client:
        assert client.ask(m.Start()) == m.StartAnswer(False)
        refused = client.ask(m.SetupOutputs(names, 500.0))
        assert refused.types == (VariableType.DOUBLE, VariableType.VECTOR6D, VariableType.NOT_FOUND)
        assert client.ask(m.Start()) == m.StartAnswer(False)
        good = client.ask(m.SetupOutputs(names[:2], 500.0))
        assert client.ask(m.Start()) == m.StartAnswer(True)
        recipe = Recipe(names[:2], good.types)
        stamps = []
        for _ in range(100):
            package = client.next()
            assert package.recipe == good.recipe
            values = recipe.unpack(package.packed)
            assert values["actual_q"] == pytest.approx(HOME)
            stamps.append(round(values["timestamp"] / 0.002))
        assert stamps == list(range(stamps[0], stamps[0] + 100))  # none skipped
        client.send(m.Pause())
        until(lambda: client.next() == m.PauseAnswer(True), pause_s=0)


def test_protocol_one(cell):
    with Plain(cell.host, protocol=1) as client:
        answer = client.ask(m.SetupOutputs(("robot_mode", "timestamp"), None))
        assert answer == m.OutputsAnswer((VariableType.INT32, VariableType.DOUBLE), None)
        assert client.ask(m.Start()) == m.StartAnswer(True)
        package = client.next()
        assert Recipe(("robot_mode", "timestamp"), answer.types).unpack(package.packed)["robot_mode"] == 7


def test_the_trailing_comma_of_ur_rtde(cell):
    with Plain(cell.host) as client:
        payload = struct.pack(">d", 500.0) + b"timestamp,robot_mode,"
        client.socket.sendall(c.RtdeFrame(FrameKind.SETUP_OUTPUTS, payload).encode())
        assert client.next() == m.OutputsAnswer((VariableType.DOUBLE, VariableType.INT32), 1)


def test_an_input_has_one_owner_until_it_leaves(cell):
    mine = m.SetupInputs(("input_int_register_30", "input_double_register_30"))
    with Plain(cell.host) as first, Plain(cell.host) as second:
        assert first.ask(mine).recipe == 1
        assert first.ask(m.SetupInputs(("input_int_register_30",))).recipe == 2  # its own, again
        answer = second.ask(mine)
        assert answer == m.InputsAnswer((VariableType.IN_USE, VariableType.IN_USE), 0)
        assert second.ask(m.SetupInputs(("nothing",))) == m.InputsAnswer((VariableType.NOT_FOUND,), 0)
        first.socket.close()
        until(lambda: second.ask(mine).recipe == 1)


def test_inputs_are_written_without_a_start_and_a_wrong_length_is_ignored(cell):
    names = ("input_int_register_40", "input_double_register_40")
    recipe = Recipe(names, [INPUTS[name] for name in names])
    with Plain(cell.host) as writer, Plain(cell.host) as reader:
        number = writer.ask(m.SetupInputs(names)).recipe
        good = recipe.pack({names[0]: -7, names[1]: 2.5})
        writer.send(m.Values(number, good))
        writer.send(m.Values(number, good[:-1]))
        writer.send(m.Values(number + 1, good))
        reader.ask(m.SetupOutputs(names, 500.0))
        reader.ask(m.Start())
        until(lambda: recipe.unpack(reader.next().packed) == {names[0]: -7, names[1]: 2.5}, pause_s=0)
        assert writer.ask(m.AskControlVersion()) == m.ControlVersion(5, 11, 6, 1010327)


@pytest.mark.parametrize(
    "sent",
    [
        b"\0\0V",
        b"\0\2V",
        b"\xff\xffU",
        b"\x10\x01U",
        b"\0\3Z",
        b"GET / HTTP/1.1\r\nHost: x\r\n\r\n",
        b"\0\3U",
        b"\0\4S\0",
        b"\0\3I",
        b"\0\6Ia,,",
        c.RtdeFrame(FrameKind.SETUP_INPUTS, b"input_int_register_1,input_int_register_1").encode(),
        c.RtdeFrame(FrameKind.SETUP_OUTPUTS, struct.pack(">d", float("nan")) + b"timestamp").encode(),
        c.RtdeFrame(FrameKind.SETUP_OUTPUTS, struct.pack(">d", 500.0) + b"timestamp").encode()
        + b"\0\3S"
        + b"\0\5V\0\1",
        c.RtdeFrame(FrameKind.SETUP_OUTPUTS, struct.pack(">d", 500.0) + b"timestamp").encode() * 2
        + b"\0\3S"
        + c.RtdeFrame(FrameKind.SETUP_OUTPUTS, struct.pack(">d", 500.0) + b"timestamp").encode(),
    ],
)
def test_a_broken_protocol_ends_that_connection_alone(cell, sent):
    with Plain(cell.host) as bystander, Plain(cell.host) as client:
        client.socket.sendall(sent)
        assert client.ended()
        assert bystander.ask(m.AskControlVersion()) is not None


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.one_of(
            st.binary(max_size=60),
            st.builds(
                lambda kind, payload: c.RtdeFrame(kind, payload).encode(),
                st.sampled_from(list(FrameKind)),
                st.binary(max_size=60),
            ),
        ),
        max_size=8,
    )
)
def test_any_bytes_leave_the_controller_alive(cell, pieces):
    with socket.create_connection((cell.host, RTDE), timeout=5) as client:
        try:
            for piece in pieces:
                client.sendall(piece)
        except ConnectionError:
            pass
    assert alive(cell)


def test_a_flood_of_writes_is_slowed_and_the_clock_goes_on(cell):
    names = ("input_double_register_41",)
    with Plain(cell.host) as writer, Plain(cell.host) as reader:
        number = writer.ask(m.SetupInputs(names)).recipe
        reader.ask(m.SetupOutputs(("timestamp",), 500.0))
        reader.ask(m.Start())
        writer.socket.sendall(
            b"".join(c.encode_request(m.Values(number, struct.pack(">d", i)), 2) for i in range(20_000))
        )
        first = struct.unpack(">d", reader.next().packed)[0]
        until(lambda: struct.unpack(">d", reader.next().packed)[0] > first + 0.2, pause_s=0)
        assert writer.ask(m.AskControlVersion()) is not None


def test_a_reader_that_does_not_read_disturbs_nobody(cell):
    names = tuple(name for name, kind in OUTPUTS.items() if kind is VariableType.VECTOR6D)
    with Plain(cell.host) as sleeper, Plain(cell.host) as reader:
        for client in (sleeper, reader):
            client.ask(m.SetupOutputs(names, 500.0))
            client.send(m.Start())
        assert reader.next() == m.StartAnswer(True)
        count = [0]

        def read():
            count[0] += reader.next() is not None
            return count[0] > 1000

        until(read, deadline_s=20.0, pause_s=0)


def test_more_connections_than_a_port_takes(cell):
    held = [socket.create_connection((cell.host, GRIPPER), timeout=5) for _ in range(40)]
    closed = 0
    for one in held[-8:]:
        closed += one.recv(1) == b""
    assert closed == 8
    for one in held:
        one.close()

    def free():
        with socket.create_connection((cell.host, GRIPPER), timeout=5) as client:
            client.sendall(b"GET STA\n")
            return client.recv(64) == b"STA 0\n"

    until(free)


# -- dashboard


class Lines:
    """A client of a line protocol."""

    def __init__(self, cell, port):
        self.socket = socket.create_connection((cell.host, port), timeout=5)
        self.file = self.socket.makefile("rwb")
        if port == DASHBOARD:
            assert self.read() == "Connected: Universal Robots Dashboard Server"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.file.close()
        self.socket.close()

    def read(self):
        return self.file.readline().decode().rstrip("\n")

    def ask(self, line):
        self.file.write(line.encode() + b"\n")
        self.file.flush()
        return self.read()


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("stop", "Stopped"),
        ("play", "Failed to execute: play"),
        ("pause", "Failed to execute: pause"),
        ("running", "Program running: false"),
        ("robotmode", "Robotmode: RUNNING"),
        ("safetymode", "Safetymode: NORMAL"),
        ("safetystatus", "Safetystatus: NORMAL"),
        ("is in remote control", "true"),
        ("get robot model", "UR3"),
        ("version", "5.11.6.1010327"),
        ("load a.urp", "File not found: a.urp"),
        ("get loaded program", "No program loaded"),
        ("popup hello", "showing popup"),
        ("close popup", "closing popup"),
        ("addToLog x", "Added log message"),
        ("close safety popup", "closing safety popup"),
        ("unlock protective stop", "Protective stop releasing"),
        ("set operational mode automatic", "Operational mode AUTOMATIC is set"),
        ("get operational mode", "AUTOMATIC"),
        ("clear operational mode", "No longer controlling the operational mode. Current operational mode: 'NONE'."),
        ("programState", "STOPPED <unnamed>"),
        ("isProgramSaved", "false <unnamed>"),
        ("load installation default.installation", "File not found: default.installation"),
        ("setUserRole operator", "Setting user role: operator"),
        ("setUserRole king", "Failed setting user role: king"),
        ("getUserRole", "OPERATOR"),
        ("PolyscopeVersion", "URSoftware 5.11.6.1010327 (Apr 01 2022)"),
        ("get serial number", "20235300001"),
        ("generate flight report system", "Flight Report generated with id: 1"),
        ("generate support file /programs", "Completed successfully: /programs/ur_20235300001_2022-04-01_00-00-00.zip"),
        ("saveLog", "Log saved to disk"),
        ("power on", "Powering on"),
        ("brake release", "Brake releasing"),
    ],
)
def test_dashboard_answers(cell, line, answer):
    with Lines(cell, DASHBOARD) as client:
        assert client.ask(line) == answer


@pytest.mark.parametrize(
    "line",
    [
        "",
        "STOP",
        "stop now",
        "load a.urp; reboot",
        "load $(reboot)",
        "load a b",
        "loadx",
        "generate flight report all",
        "generate support file /programs; reboot",
        "set operational mode AUTOMATIC",
        "get serial number x",
        "\x00",
        "é",
    ],
)
def test_dashboard_understands_nothing_outside_its_grammar(cell, line):
    with Lines(cell, DASHBOARD) as client:
        assert client.ask(line).startswith("could not understand: '")
        assert client.ask("get serial number").isdigit()


def test_dashboard_quit_and_a_line_that_is_too_long(cell):
    with Lines(cell, DASHBOARD) as client:
        assert client.ask("quit") == "Disconnected"
        assert client.read() == ""
    with Lines(cell, DASHBOARD) as client:
        client.file.write(b"x" * 2000)
        client.file.flush()
        assert client.read() == ""


def test_dashboard_pauses_and_plays_a_program(cell):
    with Lines(cell, DASHBOARD) as client, socket.create_connection((cell.host, REALTIME), timeout=5) as script:
        script.sendall(b"def waits():\n while True:\n  sync()\n end\nend\n")
        until(lambda: client.ask("programState") == "PLAYING waits")
        assert client.ask("pause") == "Pausing program"
        until(lambda: client.ask("programState") == "PAUSED waits")
        assert client.ask("play") == "Starting program"
        until(lambda: client.ask("running") == "Program running: true")
        assert client.ask("stop") == "Stopped"
        assert client.ask("running") == "Program running: false"


# -- script ports


def frames(client, wanted):
    """Primary frames until `wanted(kind, body)`."""
    held = b""

    def read():
        nonlocal held
        while len(held) < 4 or len(held) < struct.unpack(">i", held[:4])[0]:
            received = client.recv(65536)
            if not received:
                raise AssertionError("closed")
            held += received
        size, kind = struct.unpack(">iB", held[:5])
        body, held = held[5:size], held[size:]
        return body if wanted(kind, body) else None

    return until(read, pause_s=0)


def test_the_primary_interface_greets_tells_the_state_and_what_programs_do(cell):
    with socket.create_connection((cell.host, PRIMARY), timeout=5) as client:
        greeting = frames(client, lambda kind, body: kind == 20)
        assert greeting[9] == 3
        assert b"URControl" in greeting
        state = frames(client, lambda kind, body: kind == 16)
        parts = {}
        while state:
            size, kind = struct.unpack(">iB", state[:5])
            parts[kind], state = state[5:size], state[size:]
        assert set(parts) == {0, 1, 2, 3, 4, 5, 6, 7, 8}
        assert len(parts[0]) + 5 == 47  # urx goes by this size
        assert struct.unpack(">d", parts[1][41:49])[0] == pytest.approx(HOME[1])
        client.sendall(b"def short():\n sleep(0.02)\nend\n")
        frames(client, lambda kind, body: kind == 20 and b"PROGRAM_XXX_STARTEDshort" in body)
        frames(client, lambda kind, body: kind == 20 and b"PROGRAM_XXX_STOPPEDshort" in body)
        client.sendall(b"def bad():\n x = [1]\n y = x[3]\nend\n")
        told = frames(client, lambda kind, body: kind == 20 and body[9] == 10)
        assert struct.unpack(">i", told[10:14])[0] == 3
        client.sendall(b"def worse(:\n")
        client.sendall(b"end\n")
        frames(client, lambda kind, body: kind == 20 and body[9] == 10)


def test_the_realtime_interface_has_its_documented_length(cell):
    with socket.create_connection((cell.host, REALTIME), timeout=5) as client:
        data = b""
        while len(data) < 2440:
            data += client.recv(65536)
        assert struct.unpack(">i", data[:4])[0] == 1220
        assert struct.unpack(">i", data[1220:1224])[0] == 1220
        assert struct.unpack(">6d", data[252:300]) == pytest.approx(HOME)  # q actual: the 32nd double


@pytest.mark.parametrize("sent", [b"def x():\n" + b"y = 1\n" * 100_000, b"x" * 600_000])
@pytest.mark.parametrize("port", [PRIMARY, SECONDARY, REALTIME])
def test_what_is_no_program_ends_that_connection_alone(cell, sent, port):
    with socket.create_connection((cell.host, port), timeout=5) as client:
        try:
            client.sendall(sent)
            while client.recv(65536):
                pass
        except ConnectionError:
            pass
    assert alive(cell)


def test_hostile_programs_leave_the_clock_ticking(cell):
    hostile = [
        "def a():\nwhile True:\nend\nend\n",
        "def a():\ndef f():\nf()\nf()\nend\nf()\nend\n",
        "def a():\nx = [1]\nwhile True:\nx = [x, x]\nend\nend\n",
        "def a():\nx = 9 ^ 9 ^ 9 ^ 9\nend\n",
        "def a():\nx = " + "(" * 200 + "1" + ")" * 200 + "\nend\n",
        "def a():\n" + "while True:\n" * 30 + "sync()\n" + "end\n" * 31,
    ]
    with socket.create_connection((cell.host, REALTIME), timeout=5) as script, Plain(cell.host) as reader:
        reader.ask(m.SetupOutputs(("timestamp",), 500.0))
        reader.ask(m.Start())
        for program in hostile:
            script.sendall(program.encode())
            before = struct.unpack(">d", reader.next().packed)[0]
            until(lambda before=before: struct.unpack(">d", reader.next().packed)[0] > before + 0.1, pause_s=0)
    with Lines(cell, DASHBOARD) as client:
        until(lambda: client.ask("running") == "Program running: false")


def test_a_program_runs_however_it_was_torn(cell):
    text = upload().encode()
    rng = random.Random(7)
    with socket.create_connection((cell.host, SECONDARY), timeout=5) as client, Lines(cell, DASHBOARD) as dashboard:
        at = 0
        while at < len(text):
            cut = at + rng.randint(1, 4000)
            client.sendall(text[at:cut])
            at = cut
        until(lambda: dashboard.ask("programState") == "PLAYING rtde_control")
        client.sendall(b"stop program\n")
        until(lambda: dashboard.ask("running") == "Program running: false")


# -- gripper


class Answers:
    """A client of the gripper, which takes what one `recv` gives for the answer, as most do."""

    def __init__(self, cell):
        self.socket = socket.create_connection((cell.host, GRIPPER), timeout=5)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def ask(self, line):
        self.socket.sendall(line.encode() + b"\n")
        return self.socket.recv(1024).decode().rstrip("\n")


def test_the_gripper_closes_in_the_time_its_speed_takes():
    with SimulatedController.start(joints=HOME, gripper_object_m=0.040) as cell, Answers(cell) as gripper:
        assert gripper.ask("GET STA") == "STA 0"
        assert gripper.ask("SET ACT 1") == "ack"
        assert gripper.ask("GET STA") == "STA 1"
        until(lambda: gripper.ask("GET STA") == "STA 3")
        assert gripper.ask("SET POS 100 SPE 0 FOR 10 GTO 1") == "ack"
        assert gripper.ask("GET OBJ") == "OBJ 0"
        assert gripper.ask("GET PRE") == "PRE 100"
        seen = []

        def arrived():
            seen.append(int(gripper.ask("GET POS").split()[1]))
            return gripper.ask("GET OBJ") == "OBJ 3"

        until(arrived)
        assert seen == sorted(seen)
        assert len(set(seen)) > 10  # it takes 1.9 s: finite speed
        assert gripper.ask("GET POS") == "POS 100"
        assert gripper.ask("SET POS 255 SPE 255") == "ack"
        until(lambda: gripper.ask("GET OBJ") == "OBJ 2")
        position = int(gripper.ask("GET POS").split()[1])
        assert 0.085 * (1 - position / 228) == pytest.approx(0.040, abs=0.0003)
        assert gripper.ask("SET POS 0") == "ack"
        until(lambda: gripper.ask("GET OBJ") == "OBJ 3")
        for bad in (
            "SET POS 256",
            "SET POS -1",
            "SET POS",
            "SET STA 3",
            "GET NOPE",
            "HELLO",
            "SET POS 1 SPE",
            "GET POS POS",
        ):
            assert gripper.ask(bad) == "?"
        assert gripper.ask("GET PRE") == "PRE 0"
        gripper.socket.sendall(b"x" * 300)
        assert gripper.socket.recv(1) == b""


# -- the process


def test_a_port_that_is_taken_is_named(cell):
    with pytest.raises(LaunchError):
        SimulatedController.start(host=cell.host)
    told = subprocess.run(
        [sys.executable, "-m", "ursim", f"--host={cell.host}"], capture_output=True, text=True, timeout=30
    )
    assert told.returncode == 1
    assert json.loads(told.stdout) == {"ready": False, "error": "PORT_UNUSABLE", "address": f"{cell.host}:29999"}
    assert f"{cell.host}:29999" in told.stderr


@pytest.mark.parametrize(
    "options",
    [
        ["--joints=9,0,0,0,0,0"],
        ["--joints=nan,0,0,0,0,0"],
        ["--stop-deceleration=0"],
        ["--polyscope=5.23"],
        ["--joints=1,2"],
    ],
)
def test_settings_that_cannot_be_are_refused(options):
    told = subprocess.run(
        [sys.executable, "-m", "ursim", "--host=127.93.0.1", *options], capture_output=True, text=True, timeout=30
    )
    assert told.returncode == 2


def test_shutdown_ends_the_process_and_timing_is_reported():
    with SimulatedController.start(joints=HOME) as cell:
        with Lines(cell, DASHBOARD) as client:
            assert client.ask("shutdown") == "Shutting down"
        assert cell.process.wait(10) == 0
        assert cell.stop() == 0
        assert cell.report["ticks"] > 0
        assert cell.report["period_us"]["p50"] > 0
