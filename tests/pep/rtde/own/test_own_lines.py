"""Tools' own lines at a controller: they move it as ur_rtde would, give way, and come back.

They say nothing unexpected.
"""

import asyncio
import socket
import threading
import time

import pytest
from pep.base.clock import SystemClock
from pep.base.errors import RobotError
from pep.base.stop_model import STOP_DECELERATION_RAD_S2
from pep.rtde.command.command_table import encode
from pep.rtde.command.io_commands import Bank, SetDigitalOutputs
from pep.rtde.judge.command_requests import ToolSetup
from pep.rtde.line.command_registers import DONE, READY
from pep.rtde.line.controller_ports import LeasedPorts
from pep.rtde.own.local_line import OFFSET, OwnCommands
from pep.rtde.own.tool_lease import OwnLease, OwnLines
from pep.rtde.robot.connections import DASHBOARD, RTDE, SECONDARY
from pep.rtde.robot.telemetry import Telemetry
from pep.rtde.script.control_script import allow_list, installed_body
from policies.words.reason_table import Reason
from tests.ursim.cell import HOME, until
from ursim.ports.launch import SimulatedController
from ztpm.stage.samples import StateRecorder

from pep.rtde.command import command_values as v

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(60), pytest.mark.clause("LSD-9")]

FITTED = ToolSetup((0.0, 0.0, 0.15, 0.0, 0.0, 0.0), 0.9, (0.0, 0.0, 0.05))
THERE = (0.4, *HOME[1:])


class Program:
    """A program's lease, and its end of a line."""

    credentials = None

    def send(self, content):
        pass

    def close(self):
        pass

    def tell(self, text):
        pass


class Served:
    """Ports of a controller and our own lines there, on a loop in a thread; also the ports' judge."""

    def __init__(self, host, fitted=FITTED):
        self.fitted = fitted
        self.host, self.free, self.able, self.asked, self.failed = host, True, True, [], []
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self.thread.start()
        self.do(self.open())

    def do(self, what):
        return asyncio.run_coroutine_threadsafe(what, self.loop).result(20)

    async def open(self):
        scripts = allow_list(installed_body)
        self.ports = LeasedPorts(
            self.host, self, scripts=scripts, stop_deceleration_rad_s2=STOP_DECELERATION_RAD_S2, clock=SystemClock(),
            closed=lambda lease, _: self.own.give_way() if isinstance(lease, OwnLease) else None,
        )  # fmt: skip
        self.own = OwnLines(
            self.ports,
            fitted=lambda: self.fitted,
            free=lambda: self.free,
            able=lambda: self.able,
            failed=self.failed.append,
        )
        await self.ports.begin()
        self.keeping = asyncio.create_task(self.own.keep())

    def judge(self, held):
        self.asked.append(held.command)
        self.own.judge(held)

    def withdrawn(self, held):
        self.own.withdrawn(held)

    def refused(self, holder, refused, what):
        self.own.refused(holder, refused, what)

    def close(self):
        async def over():
            await self.own.end()
            self.keeping.cancel()
            self.ports.close()
            await asyncio.wait(asyncio.all_tasks() - {asyncio.current_task()}, timeout=1)  # what was cancelled ends

        self.do(over())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join(10)


@pytest.fixture(scope="module")
def robot():
    with SimulatedController.start(joints=HOME) as controller:
        yield controller


@pytest.fixture
def served(robot):
    served = Served(robot.host)
    until(lambda: served.own.up)
    yield served
    served.close()


@pytest.fixture
def eyes(robot):
    with StateRecorder(robot.host) as eyes:
        yield eyes


def at(eyes, q):
    until(lambda: eyes.now().still and max(abs(a - b) for a, b in zip(eyes.now().q_rad, q, strict=True)) < 1e-3)


def home(served, eyes):
    served.own.control.moveJ(HOME, 3.0, 6.0, True)
    at(eyes, HOME)


def moving(eyes, rad_s=0.2):
    until(lambda: eyes.now().commanded_rad_s > rad_s)


def test_a_move_is_begun_and_made(served, eyes):
    began = time.monotonic()
    assert served.own.control.moveJ(THERE, 1.0, 4.0, True) is True
    assert time.monotonic() - began < 0.5, "asynchronous"
    at(eyes, THERE)
    home(served, eyes)


def test_the_controller_has_our_tool_and_payload(served):
    telemetry = Telemetry(served.host)
    try:
        posture = until(lambda: telemetry.next())
        assert (posture.tcp_offset, posture.payload_kg) == (pytest.approx(FITTED.tcp_m_rad), FITTED.payload_kg)
        assert served.own.control.setPayload(1.2, (0.0, 0.0, 0.06)) is True
        assert telemetry.next().payload_kg == 1.2
    finally:
        telemetry.close()


def test_speeds_are_held_and_end(served, eyes):
    control = served.own.control
    assert control.setWatchdog(5.0) is True
    assert control.speedJ((0.3, *(0.0,) * 5), 2.0, 0.0) is True
    moving(eyes)
    for _ in range(20):
        assert control.speedJ((0.3, *(0.0,) * 5), 2.0, 0.0) is True
        time.sleep(0.02)
    assert eyes.now().commanded_rad_s == pytest.approx(0.3)
    control.speedStop(8.0)
    until(lambda: eyes.now().still)
    assert control.setWatchdog(1e-6) is True
    home(served, eyes)


def test_speeds_that_are_said_no_more_end(served, eyes):
    """As with the controller's own watchdog: no motion outlives the word of its mover."""
    control = served.own.control
    control.setWatchdog(5.0)
    control.speedJ((0.3, *(0.0,) * 5), 2.0, 0.0)
    moving(eyes)
    until(lambda: eyes.now().still, 2.0)
    until(lambda: served.own.up)
    home(served, eyes)


@pytest.mark.parametrize("stop", ["stopJ", "stopL"])
def test_a_stop_ends_a_move_at_once(served, eyes, stop):
    control = served.own.control
    control.moveJ(THERE, 1.0, 4.0, True)
    moving(eyes)
    told_s = time.monotonic()
    getattr(control, stop)(8.0 if stop == "stopJ" else 10.0, False)
    until(lambda: eyes.now().still)
    stood = next(s for s in eyes.since(told_s) if s.still)
    assert stood.arrived_s - told_s < 0.5
    assert stood.q_rad[0] < THERE[0] - 0.05
    until(lambda: served.own.up)
    home(served, eyes)


def test_a_stop_that_meets_a_move_leaves_an_arm_that_stands(served, eyes):
    """From two threads, again and again: whichever comes first, nothing moves afterwards."""
    control = served.own.control
    for i in range(15):
        until(lambda: served.own.up)
        mover = threading.Thread(target=control.moveJ, args=(THERE if i % 2 else HOME, 0.5, 4.0, True))
        mover.start()
        time.sleep(0.001 * i)
        control.stopJ(8.0, False)
        mover.join()
        control.stopJ(8.0, False)
        until(lambda: eyes.now().still)
        stood = eyes.now().q_rad
        time.sleep(0.05)
        assert eyes.now().q_rad == pytest.approx(stood, abs=1e-4)
    until(lambda: served.own.up)
    home(served, eyes)


def test_a_move_that_waits_for_its_turn_is_not_begun_after_a_stop():
    async def scenario():
        line, written = OwnCommands(), []
        line.write = written.append

        def heard(said):
            line._newest = {"runtime_state": 2, "output_int_register_0": said}
            line._look()

        heard(DONE)
        move = asyncio.create_task(line.say(v.MoveJ(THERE, 0.5, 4.0, asynchronous=True)))
        await asyncio.sleep(0)
        stop = asyncio.create_task(line.say(v.StopJ(8.0, asynchronous=False)))
        await asyncio.sleep(0)
        assert [values["input_int_register_0"] for values in written] == [34], "it has not said that of the stop"
        heard(READY)
        for _ in range(5):
            await asyncio.sleep(0)
        heard(DONE)
        assert (await move, await stop) == (False, True)
        assert [values["input_int_register_0"] for values in written] == [34, 0]

    asyncio.run(scenario())


def test_a_permit_is_for_one_command(served, eyes):
    assert served.own.control.moveJ(HOME, 1.0, 4.0, True) is True
    at(eyes, HOME)
    again = v.MoveJ(HOME, 1.0, 4.0, asynchronous=True)
    count = served.asked.count(again)

    async def written():
        served.own._commands.write(encode(again, OFFSET))

    served.do(written())
    until(lambda: served.asked.count(again) > count)
    assert served.own._commands.refused

    async def clear():
        served.own._commands.clear()

    served.do(clear())


def test_outputs_and_the_slider_are_set(served):
    telemetry = Telemetry(served.host)
    try:
        for level in (True, False):
            assert served.own.switches.setStandardDigitalOut(3, level) is True
            until(lambda level=level: (telemetry.next().output_bits >> 3 & 1) == level)
        for fraction in (0.5, 0.25, 1.0):
            assert served.own.switches.setSpeedSlider(fraction) is True
            until(lambda fraction=fraction: served.ports.feed.newest.slider == pytest.approx(fraction))
    finally:
        telemetry.close()


@pytest.mark.parametrize(
    "unasked",
    [
        v.MoveJ(THERE, 1.0, 4.0, asynchronous=True),
        v.SetTcp((0.0, 0.0, 0.3, 0.0, 0.0, 0.0)),
        v.SpeedJ((0.3, *(0.0,) * 5), 2.0, 0.0),
    ],
    ids=lambda command: type(command).__name__,
)
def test_what_nobody_was_permitted_is_not_said(served, eyes, unasked):
    async def written():
        served.own._commands.write(encode(unasked, OFFSET))

    before = eyes.now().q_rad
    served.do(written())
    until(lambda: unasked in served.asked)
    time.sleep(0.1)
    assert eyes.now().q_rad == pytest.approx(before, abs=1e-4)

    async def clear():
        served.own._commands.clear()

    served.do(clear())
    until(lambda: served.own.up)
    assert served.own.control.moveJ(HOME, 1.0, 4.0, True) is True, "and what is permitted is said afterwards"


def test_a_move_and_an_output_at_once_are_both_said(served, eyes):
    """An expected answer on one line is none to the question on the other."""
    for i in range(10):
        mover = threading.Thread(target=served.own.control.moveJ, args=(HOME, 1.0, 4.0, True))
        mover.start()
        assert served.own.switches.setStandardDigitalOut(1, bool(i % 2)) is True
        mover.join()
    assert served.own._commands.refused is served.own._switches.refused is False
    at(eyes, HOME)


def test_an_output_that_nobody_was_permitted_is_not_set(served):
    async def written():
        served.own._switches.say(SetDigitalOutputs(Bank.STANDARD, 1, 1))

    served.do(written())
    until(lambda: served.own._switches.refused)
    telemetry = Telemetry(served.host)
    try:
        assert until(lambda: telemetry.next()).output_bits & 1 == 0
    finally:
        telemetry.close()


def test_they_give_way_while_they_move_and_come_back(served, eyes):
    served.own.control.moveJ(THERE, 0.5, 4.0, True)
    moving(eyes)

    async def give_way():
        served.free = False
        served.own.give_way()
        return await served.ports.open(Program(), RTDE, Program())

    line = served.do(give_way())
    assert not isinstance(line, Reason), "a program's line is there in the same moment"
    until(lambda: eyes.now().still)
    stood = eyes.now().q_rad
    assert not served.own.up
    assert not served.own.undisturbed()
    assert served.own.control.moveJ(THERE, 1.0, 4.0, True) is False
    assert served.own.switches.setStandardDigitalOut(3, True) is False
    time.sleep(1.0)
    assert served.own._lease is None, "while the program has its lease"
    assert eyes.now().q_rad == pytest.approx(stood, abs=1e-4)
    served.loop.call_soon_threadsafe(line.left)
    served.free = True
    until(lambda: served.own.up)
    home(served, eyes)


def test_a_program_that_comes_while_they_are_being_brought_has_the_arm(served):
    async def program():
        served.free = False
        served.own.give_way()
        back = Program()
        return back, await served.ports.open(back, RTDE, back)

    for step in range(12):
        served.free = True
        until(lambda: served.own._lease is not None)
        time.sleep(0.03 * step)
        lease, line = served.do(program())
        assert not isinstance(line, Reason)
        time.sleep(0.1)
        assert served.own._lease is None
        assert not served.own.up
        assert served.ports._tenant.lease is lease
        assert line in served.ports._tenant.lines, "it was not cut by what was still on its way"
        served.loop.call_soon_threadsafe(line.left)
    served.free = True
    until(lambda: served.own.up)


@pytest.mark.parametrize("how", ["script", "dashboard"])
def test_whoever_stops_the_arm_stops_ours_and_we_come_back(served, eyes, how):
    served.own.control.moveJ(THERE, 0.5, 4.0, True)
    moving(eyes)
    if how == "script":
        with socket.create_connection((served.host, SECONDARY)) as link:
            link.sendall(b"stopj(8.0)\n")
            until(lambda: eyes.now().still)
    else:
        with socket.create_connection((served.host, DASHBOARD)) as link:
            link.recv(100)
            link.sendall(b"stop\n")
            until(lambda: eyes.now().still)
    stood = eyes.now().q_rad
    until(lambda: served.own.up)
    assert eyes.now().q_rad == pytest.approx(stood, abs=1e-4), "what was stopped does not go on"
    home(served, eyes)


def test_an_arm_that_could_not_move_is_left_alone(served):
    served.able = False
    served.do(_given_way(served))
    time.sleep(0.3)
    assert not served.own.up
    assert served.own._lease is None
    served.able = True
    until(lambda: served.own.up)


async def _given_way(served):
    served.own.give_way()


def test_a_controller_that_refuses_is_tried_again(served, robot, monkeypatch):
    tried = []

    async def failing(self, ports, lease):
        tried.append(lease)
        raise RobotError("ROBOT_UNREACHABLE", "as tested")

    with monkeypatch.context() as patch:
        patch.setattr("pep.rtde.own.local_line.OwnLine.open", failing)
        served.do(_given_way(served))
        until(lambda: len(served.failed) > 1)
    assert str(served.failed[-1]) == "ROBOT_UNREACHABLE: as tested"
    assert len(set(map(id, tried))) == len(tried), "each try is another lease"
    assert isinstance(tried[0], OwnLease)
    until(lambda: served.own.up)
