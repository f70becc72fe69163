"""Robot's word about itself, from the real controller and client: true, in time, else unknown."""

import asyncio
import dataclasses
import socket
import threading
import time
from functools import partial
from types import SimpleNamespace

import pytest
from pep.base.clock import SystemClock
from pep.base.errors import ConfigError, PepFault, RobotError
from pep.rtde.judge.command_requests import ToolSetup
from pep.rtde.robot.connections import RTDE
from pep.rtde.robot.dashboard import RemoteControl
from pep.rtde.robot.primary_line import PrimaryLine
from pep.rtde.robot.readiness import OWN_POSE_M, PLAYING, RobotReadiness
from pep.rtde.robot.state_receiver import JointState
from pep.world.held_object import CommittedGrip
from pep.world.world import tool_position
from policies.evidence.evidence import RobotReading
from tests.pep.rtde.packages import package, received
from tests.pep.pit.robot.test_calibration import ARMS, NOMINAL, spelled
from tests.pep.rtde.own.test_own_lines import Served
from tests.ursim.cell import HOME, until
from ursim.ports.launch import SimulatedController

from pep.pit import NOMINAL_ERROR_M, Calibration, CellParameters, Robot
from pep.rtde.command import command_values as v
from ztpm.point import robot as composition

pytest.importorskip("rtde_receive", reason="ur_rtde is not installed")
pytestmark = pytest.mark.e2e

ROBOT = Robot.load("ur3e")
READY = RobotReading(7, 1, True, True, 1_000, 1_000, True)


@pytest.fixture
def cell():
    with SimulatedController.start(joints=HOME) as controller:
        yield controller


class Held:
    """The readiness of the tools' own lines with everything behind it, and those lines, which a test may misuse."""

    def __init__(self, cell, parameters=None, robot=ROBOT):
        holding = CommittedGrip(robot, parameters or CellParameters())
        self.served = Served(
            cell.host, ToolSetup((*robot.tool.tcp_m, 0.0, 0.0, 0.0), holding.carried_kg, holding.centre_m)
        )
        until(lambda: self.served.own.up)
        self.served.free = False  # what has been disturbed is not begun anew
        self.readiness = composition.readiness(
            self.served.ports.state,
            RemoteControl(cell.host),
            self.served.own,
            lambda: True,
            robot=robot,
            holding=holding,
        )

    def says(self, command):
        """The controller has taken the command."""
        return self.served.do(self.served.own._done(self.served.own._line, command))

    def becomes(self, **changes):
        expected = dataclasses.replace(READY, **changes)
        until(lambda: self.readiness.reading() == expected, deadline_s=5.0)

    def close(self):
        self.readiness.close()
        self.served.close()


@pytest.fixture
def held(cell):
    one = Held(cell)
    one.becomes()
    yield one
    one.close()


def test_a_person_switches_to_local_control_and_back(cell, held):
    cell.fault("local_control")
    held.becomes(remote_control=False)
    cell.fault("remote_control")
    held.becomes()


def test_a_program_of_somebody_else_is_seen_and_stays_seen(cell, held):
    with socket.create_connection((cell.host, 30003)) as script:
        script.sendall(b"def rtde_control():\n while True:\n  sync()\n end\nend\n")
        held.becomes(exclusive=False)
        until(lambda: held.served.ports.state.newest().runtime_state == PLAYING)  # its name is ours, and it runs
        assert not held.readiness.reading().exclusive
        script.sendall(b"stop program\n")
        until(lambda: held.served.ports.state.newest().runtime_state != PLAYING)
    assert not held.readiness.reading().exclusive


def test_a_paused_program_is_not_ours_to_use(cell, held):
    """Nor is it when it goes on: the tools begin their own anew."""
    with socket.create_connection((cell.host, 29999)) as dashboard:
        dashboard.recv(256)
        dashboard.sendall(b"pause\n")
        held.becomes(exclusive=False)
        dashboard.sendall(b"play\n")
    assert not held.readiness.reading().exclusive
    held.served.free = True
    held.becomes()


def test_a_lost_primary_connection_hides_programs(cell, held):
    primary = held.served.ports._primary
    lost = primary._robot._robot
    held.served.loop.call_soon_threadsafe(lost._transport.abort)
    held.becomes(exclusive=False)
    until(lambda: primary._robot._robot is not lost and primary.hears)
    assert not held.readiness.reading().exclusive


def test_payload_and_tool_are_what_the_controller_says(held):
    assert held.says(v.SetPayload(1.25, (0.0, 0.0, 0.06)))
    held.becomes(payload_g=1_250)
    assert held.says(v.SetPayload(1.0, (0.0, 0.0, 0.058)))
    assert held.says(v.SetTcp((0.0, 0.0, 0.1769, 0.0, 0.0, 0.0)))  # 0.2 mm
    held.becomes(frames_match=False)
    assert held.says(v.SetTcp((0.0, 0.0, 0.1767, 0.0, 0.0, 0.0)))
    held.becomes()
    assert held.says(v.SetTcp((0.0, 0.0, 0.1767, 0.0, 0.0, 0.01)))
    held.becomes(frames_match=False)
    assert held.says(v.SetTcp((0.0, 0.0, 0.1767, 0.0, 0.0, 0.0)))
    held.becomes()


def test_a_held_part_is_reckoned_with_from_the_start(cell):
    one = Held(cell, CellParameters(payload_kg=0.5))
    one.becomes(payload_g=1_500, expected_payload_g=1_500)
    one.close()


def test_with_an_unknown_part_the_robot_reckons_with_all_that_it_may_carry(cell):
    one = Held(cell, CellParameters(payload_kg=None))
    one.becomes(expected_payload_g=3_000, payload_g=3_000)
    one.close()


def test_a_protective_stop_and_an_emergency_stop(cell, held):
    cell.fault("protective_stop")
    held.becomes(safety_mode=3, exclusive=False)
    cell.fault("emergency_stop")
    held.becomes(safety_mode=7, robot_mode=3, exclusive=False)


def test_a_controller_that_has_gone_is_unknown(cell, held):
    cell.process.kill()
    until(lambda: held.readiness.reading() == RobotReading(-1, 11, None, False, 0, 1_000, False), deadline_s=5.0)


def test_a_reading_never_waits(cell, held):
    cell.process.send_signal(19)  # SIGSTOP: connections stay open, nothing answers
    try:
        slowest, unknown = 0.0, False
        due = time.monotonic() + 10.0
        while not unknown and time.monotonic() < due:
            begun = time.monotonic()
            unknown = held.readiness.reading().remote_control is None
            slowest = max(slowest, time.monotonic() - begun)
        assert unknown
        assert slowest < 0.5  # it asks nobody; a loaded host may pause it
        assert held.readiness.reading().robot_mode == -1
    finally:
        cell.process.send_signal(18)


def test_an_answer_of_the_dashboard_grows_old(cell, monkeypatch):
    monkeypatch.setattr("pep.rtde.robot.dashboard.PERIOD_S", 30.0)
    remote = RemoteControl(cell.host)
    until(lambda: remote.state() is True)
    until(lambda: remote.state() is None, deadline_s=5.0)
    remote.close()


def test_the_receiver_waits_for_a_package_that_is_newer(cell):
    state = received(cell.host)
    asked = state._clock.monotonic_ms()
    assert state.next().arrived_ms >= asked
    state.close()
    until(lambda: state.current() is None)
    with pytest.raises(RobotError) as raised:
        state.next()
    assert raised.value.code is PepFault.ROBOT_STALLED


@pytest.mark.clause("RTDE-18")
def test_a_state_comes_back_with_the_controller_each_time(cell):
    state = received(cell.host)
    for _ in range(3):
        cell.fault("drop_connections")
        until(lambda: not came(state), deadline_s=5.0)
        until(lambda: came(state), deadline_s=5.0)
        assert state.read().q_rad == pytest.approx(HOME, abs=1e-6)
        assert state.newest().stamp_s > 0.0
    state.close()


def came(state):
    """True where a package came now."""
    try:
        return state.read() is not None
    except RobotError as error:
        assert error.code is PepFault.ROBOT_STALLED
        return False


@pytest.mark.clause("RTDE-18")
def test_a_state_waits_for_no_controller_that_says_nothing(cell, monkeypatch):
    """It is asked anew, and heard again once one speaks."""
    state, silent = received(cell.host), Speaker(b"", cell.host)
    state._listener._where = silent.server.getsockname()
    cell.fault("drop_connections")
    until(lambda: len(silent.links) >= 2, deadline_s=10.0)
    assert not came(state)
    state._listener._where = (cell.host, RTDE)
    until(lambda: came(state), deadline_s=5.0)
    state.close()
    silent.close()


def test_a_controller_that_cannot_be_had_is_unreachable(monkeypatch):
    monkeypatch.setattr("pep.rtde.robot.state_receiver.CONNECT_S", 0.2)
    begun = time.monotonic()
    with pytest.raises(RobotError) as raised:
        received("127.0.0.9")
    assert raised.value.code is PepFault.ROBOT_UNREACHABLE
    assert time.monotonic() - begun < 5.0


class Speaker:
    """A port that says what a test wants to each client, and then waits."""

    def __init__(self, said, host="127.0.0.1"):
        self.server = socket.create_server((host, 0))
        self.said, self.links = said, []
        threading.Thread(target=self.serve, daemon=True).start()

    def serve(self):
        while True:
            try:
                link, _ = self.server.accept()
            except OSError:
                return
            self.links.append(link)
            link.sendall(self.said)

    def close(self):
        self.server.close()
        for link in self.links:
            link.close()


@pytest.mark.parametrize("said", [b"", b"hello\n", b"\nmaybe\n", b"\nTRUE!\n", b"\n" + b"true" * 200])
def test_a_dashboard_that_says_something_else_says_nothing(monkeypatch, said):
    speaker = Speaker(said)
    monkeypatch.setattr("pep.rtde.robot.dashboard.PORT", speaker.server.getsockname()[1])
    remote = RemoteControl("127.0.0.1")
    until(lambda: speaker.links)
    due = time.monotonic() + 0.5
    while time.monotonic() < due:
        assert remote.state() is None
    remote.close()
    speaker.close()


@pytest.mark.parametrize("said", [b"\0" * 64, b"\xff" * 64, b"\0\0\0\3\0", b"GET / HTTP/1.1\r\n\r\n"])
def test_a_primary_port_that_speaks_something_else_tells_of_no_program(monkeypatch, said):
    speaker, told = Speaker(said), []
    monkeypatch.setattr("pep.rtde.robot.primary_line.PRIMARY", speaker.server.getsockname()[1])

    async def listen():
        line = PrimaryLine("127.0.0.1", clock=SystemClock(), told=told.append, lost=lambda: None)
        await line.begin()
        async with asyncio.timeout(5):
            while len(speaker.links) < 2:  # given up, and tried again
                assert not line.hears
                await asyncio.sleep(0.005)
        line.close()

    asyncio.run(listen())
    assert told == []
    speaker.close()


def test_the_tool_is_where_the_model_has_it():
    offset, q = (*ROBOT.tool.tcp_m, 0.0, 0.0, 0.0), HOME
    where = tool_position(ROBOT, q)

    class Fixed:
        def __init__(self, pose):
            self.pose = pose

        def current(self):
            here = JointState(q, (0.0,) * 6, 7, 1)
            return package(here, tool_pose=(*self.pose, 0.0, 0.0, 0.0), tcp_offset=offset)

    def match(pose, pose_m=NOMINAL_ERROR_M):
        return RobotReadiness(
            state=Fixed(pose),
            remote=Said(True),
            program=Undisturbed(),
            commanding=lambda: True,
            tool_position=partial(tool_position, ROBOT),
            tcp_m=ROBOT.tool.tcp_m,
            pose_m=pose_m,
            expected_payload_g=lambda: 1_000,
        ).reading()

    class Said:
        def __init__(self, word):
            self.word = word

        def state(self):
            return self.word

    class Undisturbed:
        def undisturbed(self):
            return True

    assert match(where) == READY
    assert match((where[0] + 0.004, *where[1:])) == READY
    assert not match((where[0] + 0.005, *where[1:])).frames_match
    assert match((where[0] + 0.00029, *where[1:]), OWN_POSE_M) == READY
    assert not match((where[0] + 0.00031, *where[1:]), OWN_POSE_M).frames_match
    assert not match((float("nan"), *where[1:])).frames_match


@pytest.mark.parametrize("arm", [NOMINAL, *ARMS.values()])
def test_a_calibration_of_another_arm_is_seen_by_what_the_controller_says(cell, arm):
    """The simulated controller's arm is nominal: a calibration that says so is its own, every other one is not."""
    own = Robot.load("ur3e", calibration=Calibration.from_yaml(spelled(arm)))
    held = Held(cell, robot=own)
    try:
        if arm is NOMINAL:
            composition.confirm_kinematics(held.readiness)
            held.becomes()
            return
        with pytest.raises(ConfigError) as raised:
            composition.confirm_kinematics(held.readiness)
        assert raised.value.detail.startswith("calibration_file")
        held.becomes(frames_match=False)
    finally:
        held.close()


def test_a_controller_that_says_nothing_confirms_nothing():
    class Silent:
        def next(self):
            raise RobotError(PepFault.ROBOT_STALLED, "")

    readiness = RobotReadiness(
        state=Silent(), remote=None, program=None, commanding=None, tool_position=None, tcp_m=(0.0,) * 3,
        pose_m=OWN_POSE_M, expected_payload_g=None,
    )  # fmt: skip
    with pytest.raises(RobotError):
        readiness.confirmed(within_s=0.0)


def test_a_controller_with_another_tool_is_told_as_that():
    class Other:
        def next(self):
            return SimpleNamespace(tcp_offset=(0.0, 0.0, 0.2, 0.0, 0.0, 0.0))

    readiness = RobotReadiness(
        state=Other(), remote=None, program=None, commanding=None, tool_position=None, tcp_m=(0.0,) * 3,
        pose_m=OWN_POSE_M, expected_payload_g=None,
    )  # fmt: skip
    with pytest.raises(ConfigError) as raised:
        readiness.confirmed(within_s=0.0)
    assert raised.value.code is PepFault.CONFIG_INVALID
