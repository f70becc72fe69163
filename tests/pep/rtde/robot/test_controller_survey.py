"""A controller's word on itself, from three ports; one that does not answer, or answers otherwise, is no controller."""

import socket
import struct
import threading

import pytest
from pep.pit.robot.model import Model
from pep.rtde.robot.connections import DASHBOARD
from pep.rtde.robot.controller_survey import CONFIGURATION, KINEMATICS, parts_of, survey_controller
from pep.rtde.wire.messages import WireError, WireFault
from pep.rtde.wire.primary_state import Kinematics
from ursim.ports.launch import SimulatedController
from ztpm.base.loopback import free_host, is_free

from pep.base.errors import PepFault, RobotError

ZERO = (0.0,) * 6
TOLD = Kinematics((1, 2, 3, 4, 5, 6), ZERO, ZERO, ZERO, ZERO, 0)


def part(kind, body):
    return struct.pack(">IB", len(body) + 5, kind) + body


@pytest.mark.parametrize(("arm", "said"), [("ur3e", "UR3"), ("ur16e", "UR16")])
def test_everything_that_it_tells_is_read(arm, said):
    with SimulatedController.start(
        robot=arm, tcp_m=(0.0, 0.0, 0.1767), payload=(1.0, 0.0, 0.0, 0.058), version="5.15.2"
    ) as robot:
        told = survey_controller(robot.host)
    assert (told.model, told.shipped, told.remote) == (said, arm, True)
    assert told.serial.isdigit()
    assert "5.15.2" in told.polyscope
    assert told.tcp_offset == pytest.approx((0.0, 0.0, 0.1767, 0.0, 0.0, 0.0))
    assert (told.payload_kg, told.payload_cog_m) == (pytest.approx(1.0), pytest.approx((0.0, 0.0, 0.058)))
    assert told.kinematics.alpha[0] == pytest.approx(1.5707963)
    assert told.configuration.motion_limits[0] == pytest.approx(Model.shipped(arm).joints[0].speed_limit_rad_s)


def test_nobody_there_is_told_with_the_port():
    host = free_host(b"nobody", lambda host: is_free(host, DASHBOARD))
    with pytest.raises(RobotError) as refused:
        survey_controller(host)
    assert refused.value.code == PepFault.ROBOT_UNREACHABLE
    assert str(DASHBOARD) in refused.value.detail


def test_somebody_else_who_hangs_up_is_no_controller():
    host = free_host(b"somebody", lambda host: is_free(host, DASHBOARD))
    with socket.create_server((host, DASHBOARD)) as server:
        threading.Thread(target=lambda: server.accept()[0].close(), daemon=True).start()
        with pytest.raises(RobotError) as refused:
            survey_controller(host)
    assert refused.value.code == PepFault.ROBOT_UNREACHABLE


def test_parts_of_another_size_are_left_out_and_unknown_ones_passed_over():
    body = part(99, b"later") + part(KINEMATICS, TOLD.pack()) + part(CONFIGURATION, b"longer than it was")
    assert parts_of(body) == {KINEMATICS: TOLD}


@pytest.mark.parametrize(
    "body", [b"\0", b"\0\0\0\x02\x05", part(KINEMATICS, TOLD.pack())[:-1], b"\xff\xff\xff\xff\x05"]
)
def test_parts_that_do_not_fill_the_state_are_refused(body):
    with pytest.raises(WireError) as refused:
        parts_of(body)
    assert refused.value.code == WireFault.PAYLOAD
