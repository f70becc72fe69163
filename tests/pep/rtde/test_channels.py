"""Channels to a controller at the addresses of gateway and leased program: closed, telling, or taking nothing.

The judge permits any request, so that an act that does not happen was refused by the lines alone. A relay before the
controller keeps what the gateway says to it, and eyes of our own see the robot.
"""

import asyncio
import contextlib
import random
import socket
import subprocess
import sys
import textwrap
import threading

import pytest
from pep.base.clock import SystemClock
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.line.gateway import FRAME_BYTES, Gateway
from pep.rtde.robot.connections import PORTS, PRIMARY, READ_ONLY, REALTIME, SECONDARY
from pep.rtde.robot.state_receiver import STILL_RAD_S
from pep.rtde.wire.frame_splitter import LENGTH, FrameSplitter
from pep.rtde.wire.recipes import control_recipes
from tests.pep.rtde.packages import Ports
from tests.pep.kit import Rig
from tests.pep.rtde.campaign.hostile import Hostile
from tests.pep.rtde.campaign.race import READY, Words
from tests.pep.rtde.lease.test_lease import OWN, House
from tests.pep.rtde.lease.test_lease_program import Permits
from tests.pep.rtde.line.test_leased_wire import AWAY, CYCLE_S
from tests.pep.rtde.relay import relay
from tests.pep.rtde.test_attacks import BREACHES
from tests.ursim.cell import HOME, until, upload
from ursim.ports.launch import SimulatedController
from ztpm.program.program_ports import ProgramPorts

rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")
rtde_receive = pytest.importorskip("rtde_receive", reason="ur_rtde is not installed")

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(60), pytest.mark.clause("RTDE-9", "RTDE-15")]

SCRIPTS = (PRIMARY, SECONDARY, REALTIME)
CLOSED = {
    "ssh": 22,
    "web": 80,
    "web over TLS": 443,
    "Modbus": 502,
    "EtherNet/IP's": 2222,
    "screen": 5900,
    "interpreter": 30020,
    "EtherNet/IP": 44818,
    "reverse": 50001,
    "script sender": 50002,
    "trajectory": 50003,
    "script commands": 50004,
    "gripper": 63352,
}
UNMOVED_S = 0.2
"""A hundred cycles of the controller: what it has not begun by then, it was not told."""
FRAMES = 2


def somewhere():
    return f"127.{random.randint(1, 254)}.{random.randint(0, 254)}.{random.randint(1, 254)}"


class Cell:
    """Controller, the relay and the gateway before it, and a lease for its holder."""

    def __init__(self, folder, robot, towards):
        self.folder, self.robot, self.towards, self.judge = folder, robot, towards, Permits()
        self.stranger, self.program = somewhere(), somewhere()
        self.eyes = rtde_receive.RTDEReceiveInterface(robot.host)

    @contextlib.contextmanager
    def serving(self):
        """The gateway runs, in a thread of its own, since the clients of this one wait."""
        served, ended = threading.Event(), asyncio.Event()

        async def serve():
            self.loop = asyncio.get_running_loop()
            rig = Rig(self.folder, SystemClock())
            ports = Ports(self.towards.host, self.judge, closed=lambda lease, ending: self.house.port.end(ending))
            await ports.begin()
            gateway = Gateway(ports)
            await gateway.listen(self.stranger)
            async with House(rig, ports, ended=ports.over) as self.house:
                served.set()
                await ended.wait()
            gateway.close()
            ports.close()
            rig.gate.close()
            rig.journal.close()

        thread = threading.Thread(target=lambda: asyncio.run(serve()))
        thread.start()
        try:
            assert served.wait(20)
            yield self
        finally:
            self.loop.call_soon_threadsafe(ended.set)
            thread.join(20)

    @contextlib.contextmanager
    def reached(self, leased):
        """Address of its ports, for the holder of a lease or for any client."""
        if not leased:
            yield self.stranger
            return

        async def lend():
            lease_id, opened = await self.house.lease(self.house.rig.agent())
            ports = ProgramPorts(
                opened,
                lease_id,
                clock=self.house.rig.clock,
                user=OWN,
                ended=lambda ending: None,
                told=lambda text: None,
            )
            await ports.begin(gateway=self.house.address, host=self.program)
            return ports

        async def give_back(ports):
            ports.close()

        ports = asyncio.run_coroutine_threadsafe(lend(), self.loop).result(20)
        try:
            yield self.program
        finally:
            asyncio.run_coroutine_threadsafe(give_back(ports), self.loop).result(20)
            until(lambda: self.house.leases.current is None)

    @property
    def now(self):
        """Place of the arm, and all that can be set without a command."""
        eyes = self.eyes
        return (
            eyes.getActualQ(), eyes.getActualDigitalOutputBits(), eyes.getTargetSpeedFraction(),
            eyes.getStandardAnalogOutput0(), eyes.getStandardAnalogOutput1(), eyes.getRuntimeState(),
        )  # fmt: skip

    def still(self):
        return max(map(abs, self.eyes.getActualQd())) < STILL_RAD_S

    def cycles(self):
        """The controller has gone on for `UNMOVED_S`."""
        begun_s = self.eyes.getTimestamp()
        until(lambda: self.eyes.getTimestamp() - begun_s >= UNMOVED_S)

    @contextlib.contextmanager
    def untouched(self):
        """Nothing of the robot changes meanwhile, and it is told nothing by a port that takes programs or none."""
        before, told, asked = self.now, self.told(), len(self.judge.asked)
        yield
        self.cycles()
        assert self.now == before
        assert self.told() == told
        assert len(self.judge.asked) == asked

    def told(self):
        """Bytes to the controller so far on the ports of programs."""
        return {port: b"".join(self.towards.said(port)) for port in (*SCRIPTS, *READ_ONLY)}


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("channels")
    with (
        SimulatedController.start(joints=HOME) as robot,
        relay(robot.host, folder / "said", PORTS) as towards,
        Cell(folder, robot, towards).serving() as cell,
    ):
        yield cell
        cell.eyes.disconnect()


def answers(host, port):
    """True where a server listens there."""
    try:
        socket.create_connection((host, port), timeout=2).close()
    except ConnectionRefusedError:
        return False
    return True


WHO = pytest.mark.parametrize("leased", [False, True], ids=["anybody", "in a lease"])


@WHO
def test_where_nothing_may_listen_nothing_does(cell, leased):
    everywhere = {port for port in CLOSED.values() if answers(somewhere(), port)}
    if everywhere:
        pytest.skip(f"somebody listens at all addresses of this machine: {everywhere}")
    with cell.reached(leased) as host:
        assert all(answers(host, port) for port in PORTS)
        # a lease has the gripper, whose every word is read: [LSD-28]
        assert {name for name, port in CLOSED.items() if answers(host, port)} == ({"gripper"} if leased else set())
    assert answers(cell.robot.host, CLOSED["gripper"])


def movej():
    return f"movej({list(AWAY)}, a=3, v=3)"


def text(*lines):
    return ("def external_control():\n" + "".join(f"  {line}\n" for line in lines) + "end\n").encode()


def frames(link, count):
    """So many frames of the port's stream of states have come from now on."""
    cutter, seen = FrameSplitter(LENGTH, FRAME_BYTES, itself=True), 0
    while seen < count:
        content = link.recv(65_536)
        assert content
        seen += len(cutter.feed(content))


@WHO
@pytest.mark.parametrize("port", READ_ONLY)
def test_what_only_tells_takes_nothing(cell, leased, port):
    with cell.untouched(), cell.reached(leased) as host, socket.create_connection((host, port), timeout=5) as link:
        frames(link, 1)
        link.sendall(text(movej(), "set_standard_digital_out(1, True)") + movej().encode() + b"\n")
        link.sendall(b"set speed 0.3\n" + text("stopj(2)") + b"stop program\n")  # not even a stop is taken there
        frames(link, FRAMES)


LISTENS = "socket_open('{here}', {port}, 'reverse_socket')"
READS = "params = socket_read_binary_integer(8, 'reverse_socket', 0.02)"
STREAMS = [
    "q = [params[1] / 1000000, params[2] / 1000000, params[3] / 1000000, 0, 0, 0]",
    "servoj(q, t=0.008, lookahead_time=0.1, gain=300)",
]
REVERSE = {
    "a loop over a reverse socket": [LISTENS, "while True:", READS, *STREAMS, "end"],
    "the socket alone": [LISTENS],
    "a motion, then the socket": ["movej([0.4, -1.57, 1.57, -1.57, -1.57, 0])", LISTENS],
    "a loop that asks nobody": ["while True:", "servoj([0.4, -1.57, 1.57, -1.57, -1.57, 0], t=0.008)", "end"],
}


@WHO
@pytest.mark.parametrize("port", SCRIPTS)
@pytest.mark.parametrize("back", [50001, 50002])
def test_no_program_comes_through_that_would_call_back(cell, leased, port, back):
    with cell.reached(leased) as host, socket.create_server((somewhere(), back)) as listener, cell.untouched():
        listener.setblocking(False)
        for lines in REVERSE.values():
            with socket.create_connection((host, port), timeout=5) as link:
                frames(link, 1)
                link.sendall(text(*lines).replace(b"{here}", listener.getsockname()[0].encode()).replace(
                    b"{port}", str(back).encode()
                ))  # fmt: skip
                if leased:
                    frames(link, FRAMES)  # a program's own script is refused, and its line stays ([LSD-30])
                    continue
                with contextlib.suppress(ConnectionResetError):
                    while link.recv(65_536):
                        pass  # to its end: it was closed
        cell.cycles()
        with pytest.raises(BlockingIOError):
            listener.accept()


CLIENT = """
    import os, sys
    from rtde_control import RTDEControlInterface
    control = RTDEControlInterface(sys.argv[1], 500.0, int(sys.argv[2]), 20_002)  # below the ports of connections
    print(control.moveJ([0.4, -1.57, 1.57, -1.57, -1.57, 0.0], 1.0, 2.0), flush=True)
    os._exit(0)
"""


@pytest.mark.parametrize("running", [False, True], ids=["nothing runs", "another's script runs"])
@pytest.mark.parametrize("flag", ["FLAG_CUSTOM_SCRIPT", "FLAG_USE_EXT_UR_CAP"])
def test_a_client_that_sends_no_control_script_commands_nothing(cell, flag, running):
    flags = sum(int(getattr(rtde_control.RTDEControlInterface, name)) for name in (flag, "FLAG_NO_WAIT"))
    with contextlib.ExitStack() as ends:
        if running:  # the very script, so that a register would be all that is missing
            link = ends.enter_context(socket.create_connection((cell.robot.host, REALTIME), timeout=5))
            words = ends.enter_context(Words(cell.robot.host))
            link.sendall(upload().encode())
            words.until(lambda said: said["output_int_register_0"] == READY)
        host = ends.enter_context(cell.reached(leased=True))
        ends.enter_context(cell.untouched())
        ran = subprocess.run(
            [sys.executable, "-c", textwrap.dedent(CLIENT), host, str(flags)],
            capture_output=True, text=True, timeout=20, check=False,
        )  # fmt: skip
        assert ran.returncode == 0, ran.stderr
        assert ran.stdout.split() == ["False"]


def test_the_same_loop_moves_a_robot_that_has_no_gateway_before_it(cell):
    """Else what was refused above might have moved nothing anyway."""
    q = cell.now[0]
    with socket.create_connection((cell.robot.host, SECONDARY), timeout=5) as link:
        link.sendall(text(*REVERSE["a loop that asks nobody"]))
        until(lambda: abs(cell.now[0][0] - q[0]) > 0.01)
        link.sendall(b"stop program\n")
        until(cell.still)


# ---- a violation


SPEED_RAD_S = 0.05


@contextlib.contextmanager
def moving(cell, host):
    """A program in a lease that moves the arm."""
    one = Hostile(host, offset=0, recipes=control_recipes(0)[:8])
    try:
        assert one.ready()
        one.say({one.int(0): 9, **{one.double(i): a for i, a in enumerate((SPEED_RAD_S, 0, 0, 0, 0, 0, 2.0, 0.0))}})
        until(lambda: cell.eyes.getActualQd()[0] > 0.9 * SPEED_RAD_S)
        yield one
    finally:
        one.close()
        until(cell.still)


def unbroken(packages):
    """True where each package is of the cycle after the one before."""
    stamps = [package["timestamp"] for package in packages]
    return all(abs(b - a - CYCLE_S) < CYCLE_S / 10 for a, b in zip(stamps, stamps[1:], strict=False))


@pytest.mark.clause("RTDE-13", "RTDE-14")
@pytest.mark.parametrize("breach", BREACHES)
def test_a_violation_ends_its_connection_and_what_that_moved_and_nobody_elses(cell, breach):
    with (
        cell.reached(leased=True) as host,
        Words(cell.stranger, ("timestamp",)) as stranger,
        moving(cell, host) as one,
    ):
        stranger.until(lambda said: True)
        one.socket.sendall(BREACHES[breach])
        until(cell.still, deadline_s=1.0)
        assert one.ended()
        until(lambda: cell.house.leases.current is None)
        assert cell.house.over[-1] == ("robotic", LeaseEnding.MALFORMED)
        last_s = cell.eyes.getTimestamp()
        assert unbroken(stranger.until(lambda said: said["timestamp"] > last_s + UNMOVED_S))


STRANGERS = [breach for breach in BREACHES if breach != "inputs after the start"]  # they have none at any time: in use


@pytest.mark.clause("RTDE-13")
@pytest.mark.parametrize("breach", STRANGERS)
def test_a_strangers_violation_ends_its_own_connection_and_nothing_of_a_lease(cell, breach):
    with (
        cell.reached(leased=True) as host,
        moving(cell, host) as one,
        Words(cell.stranger, ("timestamp",)) as stranger,
    ):
        stranger.until(lambda said: True)
        stranger.socket.sendall(BREACHES[breach])
        assert stranger.ended()
        q = cell.now[0][0]
        cell.cycles()
        assert cell.now[0][0] - q == pytest.approx(SPEED_RAD_S * UNMOVED_S, rel=0.5)
        one.hear()  # its connection stands
        assert one.runtime == 2
