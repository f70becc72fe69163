"""A foreign program on the controller, while ours runs, gets no further word of ours."""

import socket

import pytest
from pep.rtde.robot.connections import SECONDARY
from tests.pep.rtde.packages import received
from tests.pep.rtde.leased_gateway import leased_gateway
from tests.ursim.cell import HOME, until
from ursim.ports.launch import SimulatedController

rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(120), pytest.mark.clause("RTDE-14")]

AWAY = (0.2, *HOME[1:])
OTHERS = b"def other():\n  while True:\n    sync()\n  end\nend\n"
"""The robot stands, and the controller says that a program is playing, before and after."""


def test_one_that_takes_the_place_of_ours_while_the_arm_stands_is_noticed(tmp_path):
    with (
        SimulatedController.start(joints=HOME) as controller,
        leased_gateway(controller.host, tmp_path / "said") as gateway,
    ):
        state = received(controller.host)
        control = rtde_control.RTDEControlInterface(gateway.host)
        assert control.moveJ(AWAY, 1.5, 3.0)
        asked = gateway.heard()

        with socket.create_connection((controller.host, SECONDARY)) as link:
            link.sendall(OTHERS)
            until(lambda: not control.isProgramRunning())
        assert not control.moveJ(HOME, 1.5, 3.0)
        assert gateway.heard() == asked
        assert state.read().q_rad == pytest.approx(AWAY, abs=1e-4)

        assert control.reuploadScript()
        until(control.isProgramRunning)
        assert control.moveJ(HOME, 1.5, 3.0)
        control.disconnect()
        state.close()
