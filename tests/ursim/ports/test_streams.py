"""The primary, secondary and real-time ports, their read-only twins, and RTDE as the vendor's own client speaks it."""

import math
import socket
import time

import pytest
from pep.rtde.wire.codec import Recipe
from pep.rtde.wire.variables import OUTPUTS, VariableType
from tests.ursim.cell import HOME, until
from tests.ursim.framers import PrimaryFramer, RealtimeFramer
from tests.ursim.plain import Plain
from ursim.ports.launch import SimulatedController

from pep.rtde.wire import messages as m
from pep.rtde.wire import primary_frames as f

pytestmark = [pytest.mark.e2e]

PRIMARY, SECONDARY, REALTIME, RTDE, DASHBOARD = 30001, 30002, 30003, 30004, 29999
READ_ONLY = 10


@pytest.fixture(scope="module")
def cell():
    with SimulatedController.start(joints=HOME) as controller:
        yield controller
    assert controller.process.returncode == 0


MINE = m.SetupInputs(("input_int_register_47",))


@pytest.fixture(scope="module", autouse=True)
def fell_asleep(cell):
    """Time from which a client does not read, while the other tests are made."""
    names = tuple(name for name, kind in OUTPUTS.items() if kind is VariableType.VECTOR6D)
    with Plain(cell.host) as sleeper, Plain(cell.host) as other:
        sleeper.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        assert sleeper.ask(MINE).recipe == 1
        assert sleeper.ask(m.SetupOutputs(names, 500.0)).recipe == 1
        sleeper.send(m.Start())
        assert other.ask(MINE).types == (VariableType.IN_USE,)
        yield time.monotonic()


class Reader:
    """A client of a primary, secondary or real-time port."""

    def __init__(self, cell, port):
        self.socket = socket.create_connection((cell.host, port), timeout=10)
        self.framer = RealtimeFramer() if port % READ_ONLY == 3 else PrimaryFramer()
        self.waiting = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def send(self, text):
        self.socket.sendall(text.encode())

    def next(self):
        while not self.waiting:
            received = self.socket.recv(65536)
            assert received
            self.waiting += self.framer.feed(received)
        return self.waiting.pop(0)

    def state(self):
        while not isinstance(frame := self.next(), f.PrimaryState):
            pass
        return {type(part).__name__: part for part in frame.parts}

    def told(self, kind, deadline_s=10.0):
        """The next message of that kind."""

        def heard():
            frame = self.next()
            return frame.content if isinstance(frame, f.PrimaryMessage) and isinstance(frame.content, kind) else None

        return until(heard, deadline_s, pause_s=0)

    def told_of(self, program):
        """The next message about that program; the end of one before may still come."""
        return until(lambda: key if (key := self.told(f.Key)).text == program else None, pause_s=0)


@pytest.mark.parametrize("port", [PRIMARY, SECONDARY, PRIMARY + READ_ONLY, SECONDARY + READ_ONLY])
def test_the_greeting_is_the_version_and_the_state_comes_ten_times_a_second(cell, port):
    with Reader(cell, port) as client:
        version = client.next().content
        assert (version.project, version.major, version.minor, version.bugfix) == ("URControl", 5, 11, 6)
        client.state()  # at once; from here on ten a second
        client.state()
        stamps = [client.state()["RobotMode"].timestamp_us for _ in range(6)]
        assert {b - a for a, b in zip(stamps, stamps[1:], strict=False)} == {100_000}


def test_the_state_is_the_robots(cell):
    with Reader(cell, PRIMARY) as client:
        state = client.state()
        assert set(state) == {
            "RobotMode", "Joints", "Tool", "Masterboard", "Cartesian", "Kinematics", "Configuration", "Force", "Additional",
        }  # fmt: skip
        mode = state["RobotMode"]
        assert (mode.connected, mode.powered, mode.emergency_stopped, mode.robot_mode) == (True, True, False, 7)
        assert [joint.q for joint in state["Joints"].joints] == pytest.approx(HOME)
        assert {joint.mode for joint in state["Joints"].joints} == {253}
        assert state["Cartesian"].pose[:3] == pytest.approx((-0.29854944, -0.13104966, 0.30330031), abs=1e-7)
        assert state["Kinematics"].a == pytest.approx((0.0, -0.24355, -0.2132, 0.0, 0.0, 0.0))
        assert state["Kinematics"].alpha == pytest.approx((math.pi / 2, 0, 0, math.pi / 2, -math.pi / 2, 0))
        limits = state["Configuration"]
        assert limits.position_limits[4:6] == pytest.approx((-math.pi, math.pi))
        assert limits.robot_type == 4
        assert state["Masterboard"].safety_mode == 1


def test_the_realtime_state_is_the_robots_at_every_tick(cell):
    for port in (REALTIME, REALTIME + READ_ONLY):
        with Reader(cell, port) as client:
            states = [client.next() for _ in range(100)]
        steps = [round(state.time_s / 0.002) for state in states]
        assert all(b > a for a, b in zip(steps, steps[1:], strict=False))
        assert steps[-1] - steps[0] < 150  # nearly all; a slow reader is skipped
        assert states[0].q == pytest.approx(HOME)
        assert (states[0].robot_mode, states[0].safety_mode, states[0].joint_modes[0]) == (7.0, 1.0, 253.0)
        assert math.dist(states[0].elbow_position, (0.0, 0.0, 0.15185)) == pytest.approx(0.24355, abs=1e-6)


def test_a_read_only_port_refuses_and_runs_nothing(cell):
    program = "def no():\n movej([1,-1.57,1.57,-1.57,-1.57,0])\nend\n"
    with Reader(cell, PRIMARY) as observer, Reader(cell, PRIMARY + READ_ONLY) as client:
        client.send(program)
        assert client.told(f.ErrorCode).code == f.READ_ONLY
        for port in (SECONDARY + READ_ONLY, REALTIME + READ_ONLY):
            with Reader(cell, port) as other:
                other.send(program)
                other.next()
        observer.send("def yes():\n sync()\nend\n")
        assert observer.told(f.Key) == f.Key(0, 0, "PROGRAM_XXX_STARTED", "yes")  # the first that started at all
        assert observer.told(f.Key) == f.Key(0, 0, "PROGRAM_XXX_STOPPED", "yes")


@pytest.mark.parametrize("port", [PRIMARY, SECONDARY, REALTIME])
def test_each_port_runs_programs_and_the_primary_one_tells_it(cell, port):
    with Reader(cell, PRIMARY) as observer, Reader(cell, port) as client:
        client.send("def here():\n sleep(0.02)\nend\n")
        assert observer.told_of("here") == f.Key(0, 0, "PROGRAM_XXX_STARTED", "here")
        assert observer.told(f.Key) == f.Key(0, 0, "PROGRAM_XXX_STOPPED", "here")
        client.send("def wrong():\n x = [1]\n y = x[3]\nend\n")
        assert observer.told(f.RuntimeException).line == 3


@pytest.mark.parametrize(
    "text", ["def hot():\n # 90 \u00b0\n sync()\nend\n", 'def hot():\n textmsg("90 \u00b0")\nend\n']
)
def test_a_script_in_latin_1_is_refused_and_the_connection_stays(cell, text):
    with Reader(cell, PRIMARY) as client:
        client.socket.sendall(text.encode("latin-1"))
        assert client.told(f.RuntimeException).line == 2
        client.send(text)
        assert client.told_of("hot") == f.Key(0, 0, "PROGRAM_XXX_STARTED", "hot")


def test_the_secondary_port_tells_states_alone(cell):
    with Reader(cell, PRIMARY) as primary, Reader(cell, SECONDARY) as client:
        assert isinstance(client.next().content, f.Version)
        primary.send("def heard():\n sync()\nend\n")
        assert primary.told_of("heard") == f.Key(0, 0, "PROGRAM_XXX_STARTED", "heard")
        assert all(isinstance(client.next(), f.PrimaryState) for _ in range(5))
        assert primary.told(f.Key) == f.Key(0, 0, "PROGRAM_XXX_STOPPED", "heard")


def test_text_commands(cell):
    with Reader(cell, PRIMARY) as client:
        client.send("def long():\n sleep(60)\nend\n")
        until(lambda: client.state()["RobotMode"].program_running, pause_s=0)
        client.send("stop program\n")
        until(lambda: not client.state()["RobotMode"].program_running, pause_s=0)
        client.send("power off\n")
        until(lambda: client.state()["RobotMode"].robot_mode == 3, pause_s=0)
        assert not client.state()["RobotMode"].powered
        client.send("def early():\n sync()\nend\n")
        assert client.told(f.RuntimeException).line == 0  # the robot is not ready
        client.send("power on\n")
        until(lambda: client.state()["RobotMode"].robot_mode == 5, pause_s=0)
        client.send("set robotmode run\n")
        until(lambda: client.state()["RobotMode"].robot_mode == 7, pause_s=0)
        client.send("def halts():\n protective_stop()\nend\n")
        until(lambda: client.state()["RobotMode"].protective_stopped, pause_s=0)
        client.send("set unlock protective stop\n")  # too soon
        assert client.state()["RobotMode"].protective_stopped
        cell.fault("protective_stop_ages")
        until(lambda: _unlocked(client), deadline_s=15.0, pause_s=0)
        client.send("stop program\n")


def _unlocked(client):
    client.send("set unlock protective stop\n")
    return not client.state()["RobotMode"].protective_stopped


def test_local_control_answers_a_script_with_the_code_for_that(cell):
    with Reader(cell, PRIMARY) as client, Reader(cell, REALTIME) as other:
        cell.fault("local_control")
        until(lambda: _dashboard(cell, "is in remote control") == "false")
        other.send("def no():\n sync()\nend\n")
        assert client.told(f.ErrorCode).code == f.READ_ONLY
        cell.fault("remote_control")
        until(lambda: _dashboard(cell, "is in remote control") == "true")


def _dashboard(cell, *lines):
    with socket.create_connection((cell.host, DASHBOARD), timeout=5) as client, client.makefile("rwb") as told:
        told.readline()
        for line in lines:
            told.write(line.encode() + b"\n")
            told.flush()
            answer = told.readline().decode().rstrip("\n")
    return answer


def test_several_clients_see_the_same_and_one_that_never_reads_disturbs_none(cell):
    sleepers = [Reader(cell, port) for port in (PRIMARY, SECONDARY, REALTIME, RTDE) for _ in range(2)]
    with Reader(cell, PRIMARY) as first, Reader(cell, PRIMARY) as second, Reader(cell, REALTIME) as third:
        first.state()
        second.state()
        stamps = [{reader.state()["RobotMode"].timestamp_us for _ in range(5)} for reader in (first, second)]
        assert len(stamps[0] & stamps[1]) >= 3
        begun = third.next().time_s
        until(lambda: third.next().time_s > begun + 0.5, pause_s=0)
    for sleeper in sleepers:
        sleeper.socket.close()


# ---------------------------------------------------------------------------------------------- RTDE, the vendor's client


@pytest.mark.parametrize("protocol", [1, 2])
def test_pause_and_start_again(cell, protocol):
    with Plain(cell.host, protocol) as client:
        frequency = 500.0 if protocol == 2 else None
        assert client.ask(m.Start()) == m.StartAnswer(False)  # no outputs yet
        types = client.ask(m.SetupOutputs(("timestamp",), frequency)).types
        recipe = Recipe(("timestamp",), types)
        for _ in range(3):
            assert client.ask(m.Start()) == m.StartAnswer(True)
            stamps = [recipe.unpack(client.next().packed)["timestamp"] for _ in range(20)]
            assert stamps == sorted(set(stamps))
            assert client.ask(m.Pause()) == m.PauseAnswer(True)
            client.socket.settimeout(0.05)
            with pytest.raises(TimeoutError):
                client.socket.recv(1)  # nothing comes while paused
            client.socket.settimeout(15)


def test_a_protocol_that_does_not_exist_is_refused_and_the_old_one_stays(cell):
    with Plain(cell.host, 1) as client:
        assert client.ask(m.RequestProtocol(3)) == m.ProtocolAnswer(False)
        assert client.ask(m.RequestProtocol(0)) == m.ProtocolAnswer(False)
        assert client.ask(m.SetupOutputs(("timestamp",), None)).recipe is None


def test_a_text_from_a_client_is_taken_and_a_broken_frame_is_told_in_one(cell):
    with Plain(cell.host) as client:
        client.send(m.RtdeMessage("hello", "a test", 3))
        assert client.ask(m.AskControlVersion()).major == 5
        client.socket.sendall(b"\0\3U")
        told = client.next()
        assert isinstance(told, m.RtdeMessage)
        assert (told.source, told.level) == ("RTDE", 1)
        assert client.next() is None


def test_a_client_that_does_not_read_is_dropped_after_ten_seconds_and_its_inputs_are_free(cell, fell_asleep):
    """Long before what waits for it grows too large: the patience alone ends it."""
    with Plain(cell.host) as other:
        until(lambda: other.ask(MINE).recipe, deadline_s=30.0, pause_s=0.2)
        assert time.monotonic() - fell_asleep > 9.0
