"""Line of the tools at a controller: it moves the arm by typed commands, gives way, and comes back."""

import asyncio
import socket
import threading
import time

import pytest
from pep.base.errors import RobotError
from pep.base.thread_priority import goes_first
from pep.rtde.command import command_values as v
from pep.rtde.command.io_commands import Bank, SetDigitalOutputs, SetSpeedSlider
from pep.rtde.judge.command_requests import ToolSetup
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.own.tool_lease import OwnLease, OwnLines
from pep.rtde.robot.connections import DASHBOARD, RTDE, SECONDARY
from tests.pep.rtde.packages import Ports, received
from policies.words.reason_table import Reason
from tests.ursim.cell import HOME, until
from ursim.ports.launch import SimulatedController
from ztpm.stage.samples import StateRecorder

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
    """Ports of a controller with our own line, on a loop in a thread; also their judge."""

    def __init__(self, host, fitted=FITTED):
        self.fitted = fitted
        self.host, self.free, self.able, self.asked, self.failed, self.ended = host, True, True, [], [], []
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()
        self.do(self.open())

    def run(self):
        goes_first()  # as the real gateway
        self.loop.run_forever()

    def do(self, what):
        return asyncio.run_coroutine_threadsafe(what, self.loop).result(20)

    def give(self, command):
        async def given():
            return await self.own.ready() and self.own.give(command)

        return self.do(given())

    def move(self, q, speed=1.0, acceleration=4.0):
        return self.give(v.MoveJ(q, speed, acceleration, asynchronous=True))

    def switch(self, command):
        async def switched():
            return self.own.switch(command)

        return self.do(switched())

    def output(self, pin, level):
        return self.switch(SetDigitalOutputs(Bank.STANDARD, 1 << pin, int(level) << pin))

    def closed(self, lease, ending):
        self.ended.append(ending)
        self.own.give_way()

    async def open(self):
        self.ports = Ports(self.host, self, closed=self.closed)
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

    def withdrawn(self, held):
        pass

    def refused(self, holder, refused, what):
        pass

    def close(self):
        async def over():
            self.own.end()
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
    assert served.move(HOME, 3.0, 6.0)
    at(eyes, HOME)


def moving(eyes, rad_s=0.2):
    until(lambda: eyes.now().commanded_rad_s > rad_s)


def test_a_move_is_begun_and_made(served, eyes):
    began = time.monotonic()
    assert served.move(THERE) is True
    assert time.monotonic() - began < 0.5, "asynchronous"
    at(eyes, THERE)
    home(served, eyes)
    assert served.asked == [], "nobody is asked again about what a permit was spent for"


def test_the_controller_has_our_tool_and_payload(served):
    state = received(served.host)
    try:
        posture = until(lambda: state.next())
        assert (posture.tcp_offset, posture.payload_kg) == (pytest.approx(FITTED.tcp_m_rad), FITTED.payload_kg)
        assert served.do(served.own.equip(1.2, (0.0, 0.0, 0.06))) is True
        assert state.next().payload_kg == 1.2
    finally:
        state.close()


SPEEDS = v.SpeedJ((0.3, *(0.0,) * 5), 2.0, 0.0)


def test_speeds_are_held_until_a_stop(served, eyes):
    assert served.give(SPEEDS) is True
    moving(eyes)
    time.sleep(0.4)  # longer than the watchdog waits
    assert eyes.now().commanded_rad_s == pytest.approx(0.3)
    served.own.stop()
    until(lambda: eyes.now().still)
    assert served.own.up, "the control script lives on"
    home(served, eyes)


def test_speeds_end_when_the_event_loop_hangs(served, eyes):
    """The controller's own watchdog: nothing is left that moves when nobody writes any more."""
    served.give(SPEEDS)
    moving(eyes)
    hung = threading.Event()
    served.loop.call_soon_threadsafe(hung.wait, 5)
    try:
        until(lambda: eyes.now().still, 2.0)
    finally:
        hung.set()
    until(lambda: not served.own.up)
    until(lambda: served.own.up)
    home(served, eyes)


def test_a_stop_ends_a_move_at_once_and_counts_at_once(served, eyes):
    served.move(THERE)
    moving(eyes)
    told_s, told_ms = time.monotonic(), served.ports.clock.monotonic_ms()
    served.own.stop()
    assert served.ports.stopped_ms >= told_ms, "earlier requests are void before the event loop knows of it"
    until(lambda: eyes.now().still)
    stood = next(s for s in eyes.since(told_s) if s.still)
    assert stood.arrived_s - told_s < 0.5
    assert stood.q_rad[0] < THERE[0] - 0.05
    until(lambda: served.own.up)
    home(served, eyes)


def test_a_stop_that_meets_a_move_leaves_an_arm_that_stands(served, eyes):
    """From two threads, again and again: whichever comes first, nothing moves afterwards."""
    for i in range(15):
        until(lambda: served.own.up)
        mover = threading.Thread(target=served.move, args=(THERE if i % 2 else HOME, 0.5))
        mover.start()
        time.sleep(0.001 * i)
        served.own.stop()
        mover.join()
        served.own.stop()
        until(lambda: eyes.now().still)
        stood = eyes.now().q_rad
        time.sleep(0.05)
        assert eyes.now().q_rad == pytest.approx(stood, abs=1e-4)
    until(lambda: served.own.up)
    home(served, eyes)


def test_outputs_and_the_slider_are_set(served):
    state = received(served.host)
    try:
        for level in (True, False):
            assert served.output(3, level) is True
            until(lambda level=level: (state.next().output_bits >> 3 & 1) == level)
        for fraction in (0.5, 0.25, 1.0):
            assert served.switch(SetSpeedSlider(fraction)) is True
            until(lambda fraction=fraction: state.read().slider == pytest.approx(fraction))
    finally:
        state.close()


def test_they_give_way_while_they_move_and_come_back(served, eyes):
    served.move(THERE, 0.5)
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
    assert served.move(THERE) is False
    assert served.output(3, True) is False
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
    served.move(THERE, 0.5)
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


def test_tools_that_give_way_to_nobody_stop_the_arm_and_one_that_could_not_move_is_left_alone(served, eyes):
    assert served.move(THERE, 0.5)
    moving(eyes)
    served.able = False
    served.do(_given_way(served))
    until(lambda: eyes.now().still, deadline_s=1.0)
    assert max(abs(a - b) for a, b in zip(eyes.now().q_rad, THERE, strict=True)) > 0.05, "stopped, not arrived"
    assert served.ports._tenant is None, "the lease ends with it"
    time.sleep(0.3)
    assert not served.own.up
    assert served.own._lease is None
    served.able = True
    until(lambda: served.own.up)
    home(served, eyes)


async def _given_way(served):
    served.own.give_way()


def test_a_controller_that_refuses_is_tried_again(served, robot, monkeypatch):
    tried = []

    async def failing(self, host, script):
        tried.append(self._tenant.lease)
        raise RobotError("ROBOT_UNREACHABLE", "as tested")

    with monkeypatch.context() as patch:
        patch.setattr("pep.rtde.own.tool_line.ToolLine.reach", failing)
        served.do(_given_way(served))
        until(lambda: len(served.failed) > 1)
    assert str(served.failed[-1]) == "ROBOT_UNREACHABLE: as tested"
    assert len(set(map(id, tried))) == len(tried), "each try is another lease"
    assert isinstance(tried[0], OwnLease)
    until(lambda: served.own.up)


@pytest.mark.parametrize("which", ["_registers", "_switches"])
def test_a_controller_that_closes_a_connection_ends_it_and_we_come_back(served, eyes, which):
    served.move(THERE, 0.5)
    moving(eyes)
    upstream = getattr(served.own._line, which).robot
    served.loop.call_soon_threadsafe(upstream._transport.abort)
    until(lambda: served.ended)
    assert served.ended == [LeaseEnding.ROBOT]
    until(lambda: eyes.now().still)
    assert eyes.now().q_rad[0] < THERE[0] - 0.02
    until(lambda: served.own.up)
    home(served, eyes)
