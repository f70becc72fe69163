"""A cell whose arm is a UR5e: the same programs, its own physics, and no gateway for another arm."""

import socket

import pytest
from pep.rtde.robot.connections import DASHBOARD
from tests.e2e.test_gateway import House, Run
from ztpm.base.processes import ChildError
from ztpm.stage.samples import StateRecorder
from ztpm.stage.stage import until

from pep.pit import Robot
from pep.world.world import tool_position

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(120)]

ARM = "ur5e"


def settled(layout, arm=ARM):
    """The gateway's configuration, which states the arm and its stop."""
    text = layout.gateway_config.read_text()
    head, _, _ = text.replace(f'robot = "{ARM}"\n', "").partition("\n[cell]\n")
    robot = f'\nrobot = "{arm}"' if arm else ""
    layout.gateway_config.write_text(f"{head}{robot}\n[cell]\nstop_deceleration_rad_s2 = 4.0\n")


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    house = House(tmp_path_factory.mktemp("ur5e"), settled=settled)
    house.agent("mover")
    yield house
    house.stage.close()
    house.cell.stop()


def said(host, words):
    with socket.create_connection((host, DASHBOARD), timeout=5) as link, link.makefile("rwb") as lines:
        lines.readline()
        lines.write(words + b"\n")
        lines.flush()
        return lines.readline().strip()


@pytest.mark.campaign
def test_a_program_moves_the_ur5e_within_its_own_physics(house):
    """A permitted move is done, a refused one is not; the tool is where the UR5e's kinematics have it."""
    eyes = StateRecorder(house.cell.addresses.host)
    with Run(
        house,
        """
        there = [q[0] + 0.1, *q[1:]]
        say(moves(control.moveJ, there, 0.4, 1.0), abs(receive.getActualQ()[0] - there[0]) < 1e-3)
        say(*receive.getActualTCPPose()[:3])
        say(control.moveJ(q, 2.5, 1.0))   # faster than the token says
    """,
    ) as run:
        status, lines, errors = run.ended()
    assert (status, lines[0], lines[2]) == (0, "True True", "False"), (lines, errors)
    until(lambda: eyes.now().still, "standstill")
    at, q = [float(x) for x in lines[1].split()], eyes.now().q_rad
    eyes.close()
    place = {name: tool_position(Robot.load(name), q) for name in (ARM, "ur3e")}
    assert at == pytest.approx(list(place[ARM]), abs=1e-4)
    assert max(abs(a - b) for a, b in zip(at, place["ur3e"], strict=True)) > 0.2
    assert said(house.cell.addresses.host, b"get robot model") == b"UR5"


@pytest.mark.parametrize("arm", ["ur10e", ""])
def test_no_gateway_takes_it_for_another_arm(house, arm):
    """Neither for a stated one nor for the UR3e, which is meant where none is stated."""
    house.cell.end("gateway")
    settled(house.cell.layout, arm)
    try:
        with pytest.raises(ChildError) as caught:
            house.cell.start_gateway()
    finally:
        settled(house.cell.layout)
    assert "CONFIG_INVALID" in str(caught.value)
    assert "UR5" in str(caught.value)
