"""An unmodified ur_rtde program in a lease: its four interfaces, carried to a simulated controller and back."""

import asyncio
import sys
import textwrap

import pytest
from pep.base.clock import SystemClock
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.robot.connections import PORTS
from tests.pep.rtde.packages import Ports
from tests.pep.kit import HOST, Rig
from tests.pep.rtde.lease.test_lease import OWN, House, until
from tests.pep.rtde.whole_commands import WholeCommands
from tests.pep.test_cell import Child
from ztpm.program.program_ports import ProgramPorts

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(120)]
START = (-0.8, -1.62, 1.25, -1.2, -1.57, 0.0)
PROGRAM = """
    import sys
    from dashboard_client import DashboardClient
    from rtde_control import RTDEControlInterface
    from rtde_io import RTDEIOInterface
    from rtde_receive import RTDEReceiveInterface

    host = sys.argv[1]
    control, seen, io = RTDEControlInterface(host), RTDEReceiveInterface(host), RTDEIOInterface(host)
    dashboard = DashboardClient(host)
    dashboard.connect()
    q = seen.getActualQ()
    q[0] += 0.3
    assert control.moveJ(q, 1.0, 2.0)
    assert io.setStandardDigitalOut(3, True)
    for _ in range(100):
        start = control.initPeriod()
        q[0] -= 0.001
        assert control.servoJ(q, 0.0, 0.0, 0.002, 0.1, 300)
        control.waitPeriod(start)
    control.servoStop()
    control.stopScript()
    print(dashboard.robotmode(), seen.getActualQ()[0], seen.getDigitalOutState(3), flush=True)
    control.disconnect()
    seen.disconnect()
"""


class Relay:
    """Every port of a controller as it is, with no say in what passes."""

    def __init__(self, host):
        self.host = host

    async def open(self, lease, port, back):
        reader, writer = await asyncio.open_connection(self.host, port)

        async def pump():
            while content := await reader.read(65_536):
                back.send(content)
            back.close()

        task = asyncio.create_task(pump())

        class Line:
            def received(self, content):
                writer.write(content)

            def left(self):
                task.cancel()
                writer.close()

        return Line()


class Permits(WholeCommands):
    """Permits everything, and keeps what it was asked, and by whom."""

    def __init__(self):
        self.asked = []

    def judge(self, held):
        self.asked.append((held.lease.agent, type(held.command).__name__))
        assert held.forward(self)

    def judged(self, command):
        self.asked.append((None, type(command).__name__))

    def ended(self):
        pass

    def withdrawn(self, held):
        pass

    def refused(self, holder, refused, what):
        raise AssertionError(refused)


@pytest.fixture(scope="module")
def controller():
    child = Child("ursim", "--host", HOST, "--joints=" + ",".join(map(str, START)))
    yield child
    child.end()


def test_an_unmodified_program_runs_in_its_lease(controller, tmp_path):
    async def scenario():
        async with asyncio.timeout(90), House(Rig(tmp_path, SystemClock()), Relay(HOST)) as house:
            lease_id, opened = await house.lease(house.rig.agent())
            over, host = [], f"{HOST.rsplit('.', 1)[0]}.12"
            ports = ProgramPorts(opened, lease_id, clock=house.rig.clock, user=OWN, ended=over.append, told=over.append)
            await ports.begin(gateway=house.address, host=host, ports=PORTS)
            program = await asyncio.create_subprocess_exec(
                sys.executable, "-c", textwrap.dedent(PROGRAM), host, stdout=asyncio.subprocess.PIPE
            )
            out, _ = await program.communicate()
            assert program.returncode == 0, out
            mode, q0, output = out.decode().splitlines()[-1].rsplit(" ", 2)
            assert mode == "Robotmode: RUNNING"
            assert START[0] + 0.18 < float(q0) < START[0] + 0.28  # what was served; servoj lags behind its target
            assert output == "True"
            assert over == []
            ports.close()
            await until(lambda: over and house.over)
            assert house.over == [("robotic", LeaseEnding.CLOSED)]

    asyncio.run(scenario())


@pytest.mark.clause("RTDE-11", "RTDE-12", "RTDE-14")
def test_it_runs_when_each_of_its_commands_is_judged_and_its_lease_ends_with_its_control_connection(
    controller, tmp_path
):
    async def scenario():
        rig, judge, house = Rig(tmp_path, SystemClock()), Permits(), None
        ports = Ports(HOST, judge, closed=lambda lease, ending: house.port.end(ending))
        await ports.begin()
        async with asyncio.timeout(90), House(rig, ports, ended=ports.over) as house:
            lease_id, opened = await house.lease(rig.agent())
            over, host = [], f"{HOST.rsplit('.', 1)[0]}.12"
            program_ports = ProgramPorts(
                opened, lease_id, clock=rig.clock, user=OWN, ended=over.append, told=over.append
            )
            await program_ports.begin(gateway=house.address, host=host, ports=PORTS)
            program = await asyncio.create_subprocess_exec(
                sys.executable, "-c", textwrap.dedent(PROGRAM), host, stdout=asyncio.subprocess.PIPE
            )
            out, _ = await program.communicate()
            assert out.decode().splitlines()[-1].endswith(" True")
            await until(lambda: over and house.over)
            assert (house.over, over) == ([("robotic", LeaseEnding.LEFT)], [LeaseEnding.LEFT])
            assert judge.asked[:3] == [("robotic", "MoveJ"), ("robotic", "SetDigitalOutputs"), ("robotic", "ServoJ")]
            later = judge.asked[
                3:
            ]  # values that come while the first waits for its judge are judged as the last of them
            assert later == [(None, "ServoJ")] * len(later)
            assert 90 <= len(later) <= 99
        ports.close()

    asyncio.run(scenario())
