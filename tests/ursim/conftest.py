import pytest
from tests.ursim.cell import HOME, let_go
from ursim.ports.launch import SimulatedController

rtde_receive = pytest.importorskip("rtde_receive", reason="ur_rtde is not installed")
rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")


@pytest.fixture
def cell():
    """A controller process on an address of its own."""
    with SimulatedController.start(joints=HOME) as controller:
        yield controller
    assert controller.process.returncode == 0


@pytest.fixture
def receive(cell):
    client = rtde_receive.RTDEReceiveInterface(cell.host)
    yield client
    let_go(client)


@pytest.fixture
def control(cell):
    client = rtde_control.RTDEControlInterface(cell.host)
    yield client
    let_go(client)
