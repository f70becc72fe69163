"""Faults on request, each as a client meets it; and what is refused as none."""

import json
import socket
import struct
import time
from itertools import accumulate

import pytest
from pep.rtde.wire.codec import Recipe
from pep.rtde.wire.variables import VariableType
from tests.ursim.cell import HOME, let_go, until
from tests.ursim.plain import Plain
from ursim.ports.faults import FaultError, Faults
from ursim.ports.launch import SimulatedController
from ursim.ports.server import Settings, Simulator

from pep.rtde.wire import messages as m

rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")
rtde_receive = pytest.importorskip("rtde_receive", reason="ur_rtde is not installed")

pytestmark = pytest.mark.e2e

PLAYING, STOPPED, PAUSED = 2, 1, 4
POWER_OFF, RUNNING = 3, 7
NAMES = ("timestamp", "actual_q", "robot_mode")


class Stream(Plain):
    """A started stream of outputs."""

    def __init__(self, cell, names=NAMES):
        super().__init__(cell.host)
        self.recipe = Recipe(names, self.ask(m.SetupOutputs(names, 500.0)).types)
        assert self.ask(m.Start()) == m.StartAnswer(True)

    def values(self):
        return super().values(self.recipe)


@pytest.fixture(scope="module")
def cell():
    """One controller that is mended after every fault."""
    with SimulatedController.start(joints=HOME) as controller:
        yield controller
    assert controller.process.returncode == 0


@pytest.fixture
def sound(cell):
    yield cell
    cell.fault("sound_network")


def test_an_arm_that_is_placed_stands_elsewhere_at_once(cell):
    there = [0.1, -1.7, 1.3, -1.1, -1.5, 6.0]
    receive = rtde_receive.RTDEReceiveInterface(cell.host)
    try:
        cell.fault("placed", joints_rad=there)
        until(lambda: receive.getActualQ() == pytest.approx(there))
        assert receive.getActualQd() == [0.0] * 6
        cell.fault("placed", joints_rad=HOME)
        until(lambda: receive.getActualQ() == pytest.approx(HOME))
    finally:
        let_go(receive)


def test_a_delay_holds_every_answer_back_and_loses_none(sound):
    with Stream(sound) as client:
        sound.fault("delay", seconds=0.2)

        def late():
            begun = time.monotonic()
            client.ask(m.AskControlVersion())
            return time.monotonic() - begun > 0.19

        until(late, pause_s=0)
        sound.fault("sound_network")
        stamps = [round(client.values()["timestamp"] / 0.002) for _ in range(300)]
        assert stamps == list(range(stamps[0], stamps[0] + 300))


def test_torn_frames_come_in_two_halves_and_are_whole_in_the_end(sound):
    with Stream(sound) as client:
        client.values()
        whole, begun = 3 + 1 + client.recipe.size, len(client.pieces)

        def torn(since=0):
            """Some piece has ended within a frame; the half before it and the one after may come in one piece."""
            return any(size % whole for size in list(accumulate(client.pieces[begun:]))[since:])

        for _ in range(20):
            client.values()
        assert not torn()
        sound.fault("torn_frames")
        until(lambda: client.values() and torn(), pause_s=0)
        had = len(client.pieces) - begun
        stamps = [round(client.values()["timestamp"] / 0.002) for _ in range(200)]
        assert stamps == list(range(stamps[0], stamps[0] + 200))
        assert torn(had)


def test_ur_rtde_lives_with_torn_and_late_frames(sound):
    sound.fault("torn_frames")
    sound.fault("delay", seconds=0.02)
    control = rtde_control.RTDEControlInterface(sound.host)
    receive = rtde_receive.RTDEReceiveInterface(sound.host)
    assert control.moveJ([0.1, *HOME[1:]], 2.0, 8.0)
    until(lambda: receive.getActualQ()[0] == pytest.approx(0.1, abs=1e-5))
    assert control.moveJ(list(HOME), 2.0, 8.0)
    let_go(control, receive)


def test_slow_frames_skip_what_is_old(sound):
    """As a controller that is short of time: packages are left out, and none is stale or broken."""
    with Stream(sound) as client:
        sound.fault("slow_frames", bytes_per_tick=16)

        def skipped():
            first, second = client.values()["timestamp"], client.values()["timestamp"]
            return second - first > 0.005

        until(skipped, pause_s=0)
        sound.fault("sound_network")

        def all_again():
            first, second = client.values()["timestamp"], client.values()["timestamp"]
            return second - first == pytest.approx(0.002)

        until(all_again, pause_s=0)


def test_an_input_of_a_field_bus_is_in_use_until_it_is_given_up(cell):
    cell.fault("in_use", inputs=["input_int_register_0"])
    wanted = m.SetupInputs(("input_double_register_3", "input_int_register_0"))
    with Stream(cell) as client:
        until(lambda: client.ask(wanted) == m.InputsAnswer((VariableType.DOUBLE, VariableType.IN_USE), 0))
        with pytest.raises(RuntimeError):
            rtde_control.RTDEControlInterface(cell.host)
        cell.fault("inputs_free")
        until(lambda: client.ask(wanted).recipe == 1)
    until(lambda: _connects(cell))


def _connects(cell):
    try:
        rtde_control.RTDEControlInterface(cell.host).disconnect()
    except RuntimeError:
        return False
    return True


def test_every_stop_by_its_own_mode_bits_and_aftermath(cell):
    control = rtde_control.RTDEControlInterface(cell.host)
    receive = rtde_receive.RTDEReceiveInterface(cell.host)

    def moving():
        assert control.moveJ([2.0, *HOME[1:]], 0.5, 8.0, True)
        until(lambda: receive.getActualQd()[0] == pytest.approx(0.5))

    def back():
        with socket.create_connection((cell.host, 30001)) as panel:
            panel.sendall(b"set robotmode run\n")
            until(lambda: receive.getRobotMode() == RUNNING)
        assert control.reuploadScript()
        until(control.isProgramRunning)
        assert control.moveJ(list(HOME), 2.0, 8.0)

    moving()
    cell.fault("stop")
    until(lambda: receive.getRuntimeState() == STOPPED)
    until(lambda: receive.getActualQd() == [0.0] * 6)
    assert receive.getSafetyStatusBits() == 1
    back()

    moving()
    cell.fault("safeguard_stop")
    until(lambda: receive.getRuntimeState() == PAUSED)
    assert (receive.getSafetyMode(), receive.getSafetyStatusBits()) == (5, 1 << 4 | 1 << 10)
    assert receive.getRobotMode() == RUNNING
    assert not control.moveJ(list(HOME), 1.0, 1.0)
    cell.fault("release_safeguard_stop")
    until(lambda: receive.getSafetyMode() == 1)
    assert receive.getRuntimeState() == PAUSED  # nothing moves by itself
    back()

    for fault, mode, bits in (
        ("emergency_stop", 7, 1 << 6 | 1 << 7 | 1 << 10),
        ("system_emergency_stop", 6, 1 << 5 | 1 << 7 | 1 << 10),
    ):
        moving()
        cell.fault(fault)
        until(lambda: receive.getRobotMode() == POWER_OFF)
        assert (receive.getSafetyMode(), receive.getSafetyStatusBits()) == (mode, bits)
        assert receive.isEmergencyStopped()
        cell.fault("release_emergency_stop")
        until(lambda: receive.getSafetyMode() == 1)
        assert receive.getRobotMode() == POWER_OFF
        back()

    for fault, mode, bit in (("violation", 8, 8), ("fault", 9, 9)):
        moving()
        cell.fault(fault)
        until(lambda: receive.getRobotMode() == POWER_OFF)
        assert (receive.getSafetyMode(), receive.getSafetyStatusBits()) == (mode, 1 << bit | 1 << 10)
        cell.fault("release_emergency_stop")  # no button was pressed
        with socket.create_connection((cell.host, 29999)) as panel, panel.makefile("rwb") as lines:
            lines.readline()
            lines.write(b"brake release\nrobotmode\nrestart safety\n")
            lines.flush()
            told = [lines.readline() for _ in range(3)]
        assert told == [b"Brake releasing\n", b"Robotmode: POWER_OFF\n", b"Restarting safety\n"]
        until(lambda: receive.getSafetyMode() == 1)
        back()
    let_go(control, receive)


@pytest.mark.parametrize(
    "line",
    [
        "",
        "[]",
        "{}",
        '{"fault": "meteor"}',
        '{"fault": ["stop"]}',
        '{"fault": "stop", "now": true}',
        '{"fault": "placed"}',
        '{"fault": "placed", "joints_rad": [0, 0, 0]}',
        '{"fault": "placed", "joints_rad": [0, 0, 0, 0, 0, NaN]}',
        '{"fault": "placed", "joints_rad": [0, 0, 0, 0, 0, 7]}',
        '{"fault": "delay"}',
        '{"fault": "delay", "seconds": -1}',
        '{"fault": "delay", "seconds": NaN}',
        '{"fault": "delay", "seconds": "1"}',
        '{"fault": "slow_frames", "bytes_per_tick": 0}',
        '{"fault": "slow_frames", "bytes_per_tick": true}',
        '{"fault": "in_use", "inputs": ["actual_q"]}',
        '{"fault": "in_use", "inputs": 3}',
    ],
)
def test_what_asks_for_no_known_fault_is_refused(line):
    simulator = Simulator(Settings("127.93.0.2"), lambda: None)
    try:
        with pytest.raises(FaultError):
            Faults(simulator).inject(line)
        assert simulator.delivery.sound
    finally:
        for port in simulator.ports:
            port.close()


def test_a_wrong_line_disturbs_nothing(cell):
    cell.process.stdin.write("nonsense\n" + json.dumps({"fault": "meteor"}) + "\n")
    cell.process.stdin.flush()
    with Stream(cell, ("timestamp",)) as client:
        assert struct.calcsize(">d") == client.recipe.size
        assert client.values()["timestamp"] < client.values()["timestamp"]
