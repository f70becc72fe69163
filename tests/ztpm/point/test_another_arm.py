"""A gateway before another arm than the UR3e: its model, its stop, and the controller's own word on it."""

from importlib import resources

import numpy as np
import pytest
import rtde_receive
from pep.base.errors import ConfigError, PepFault, RobotError
from pep.pit.robot.calibration import nominal_error_m
from pep.pit.robot.kinematics import link_frames
from pep.rtde.robot.dashboard import confirm_model
from tests.pep.pit.robot.test_calibration import ARMS, spelled
from tests.ztpm.point.test_tool_config import FOREIGN, refused, toml
from ursim.ports.launch import SimulatedController
from ztpm.point.cell_config import read_robot
from ztpm.point.gateway_config import GatewayConfig

from pep.pit import NOMINAL_UNCERTAINTY_M, Robot

pytestmark = pytest.mark.long

STATED = "stop_deceleration_rad_s2 = 4.0"


def test_the_arm_is_the_ur3e_unless_another_one_is_stated(tmp_path):
    assert GatewayConfig.from_toml(toml()).robot == "ur3e"
    digests = set()
    for name in ("ur5e", "ur10e", "ur16e"):
        config = GatewayConfig.from_toml(toml(STATED, robot=f'"{name}"'))
        robot = read_robot(config, tool="robotiq_2f85")
        assert robot.model.name == name
        digests.add(robot.model_digest)
        # A longer arm with the same errors of its joints is known less well.
        assert config.cell.robot_uncertainty_m == nominal_error_m(robot.model) + 0.003 > NOMINAL_UNCERTAINTY_M
    assert len(digests) == 3
    file = tmp_path / "mine.toml"
    file.write_text((resources.files("pep.pit") / "robots" / "ur5e.toml").read_text())
    config = GatewayConfig.from_toml(toml(STATED, robot=f'"{file}"'))
    assert read_robot(config, tool="robotiq_2f85").model_digest == Robot.load("ur5e").model_digest


def test_the_stop_of_another_arm_is_stated():
    refused(toml(robot='"ur10e"'), "cell: state stop_deceleration_rad_s2")
    assert GatewayConfig.from_toml(toml(robot='"ur3e"')).robot == "ur3e"


@pytest.mark.parametrize(
    ("robot", "said"),
    [
        ("ur7e", "robot: no model named ur7e; shipped are ur10e, ur16e, ur3e, ur5e"),
        ("../ur3e", "robot: a model's name"),
        ("/nonexistent/arm.toml", "robot: FileNotFoundError"),
        ("/dev/zero.toml", "robot: "),
    ],
)
def test_an_arm_that_is_not_there_is_refused(robot, said):
    refused(toml(STATED, robot=f'"{robot}"'), said)


def test_a_model_file_that_is_none_is_refused(tmp_path):
    for text in ("", "schema = 1", "[[joints]]", "\xff"):
        (tmp_path / "arm.toml").write_text(text)
        refused(toml(STATED, robot=f'"{tmp_path}/arm.toml"'), "robot: ")


def test_another_arms_calibration_and_tool_are_refused(tmp_path):
    """A UR3e's calibration on a UR5e; a tool that the arm's model has not."""
    path = tmp_path / "arm.yaml"
    path.write_text(spelled(ARMS[FOREIGN], FOREIGN))
    config = GatewayConfig.from_toml(toml(STATED, robot='"ur5e"', calibration_file=f'"{path}"'))
    with pytest.raises(ConfigError) as raised:
        read_robot(config, tool="robotiq_2f85")
    assert raised.value.detail.startswith("calibration_file: ")
    assert "check that the arm is of this model" in raised.value.detail
    with pytest.raises(ConfigError) as raised:
        read_robot(GatewayConfig.from_toml(toml(STATED, robot='"ur5e"')), tool="claw")
    assert "ur5e has robotiq_2f85, robotiq_hande" in raised.value.detail


@pytest.mark.parametrize("name", ["ur5e", "ur16e"])
def test_the_controller_says_of_which_model_its_arm_is(name):
    """Its own is taken; every other one is refused with the controller's word."""
    with SimulatedController.start(robot=name, joints=(0.0, -1.57, 1.57, -1.57, -1.57, 0.0)) as controller:
        confirm_model(controller.host, name)
        for other in {"ur3e", "ur5e", "ur10e", "ur16e"} - {name}:
            with pytest.raises(ConfigError) as raised:
                confirm_model(controller.host, other)
            assert raised.value.code is PepFault.CONFIG_INVALID
            assert name.upper().removesuffix("E") in raised.value.detail
        with pytest.raises(ConfigError) as raised:
            confirm_model(controller.host, "boxes")
        assert "boxes" in raised.value.detail
        state = rtde_receive.RTDEReceiveInterface(controller.host)
        try:
            assert state.getActualTCPPose()[:3] == pytest.approx(flange(Robot.load(name), state.getActualQ()), abs=1e-6)
        finally:
            state.disconnect()
    with pytest.raises(RobotError):
        confirm_model(controller.host, name)


def flange(robot, q):
    _, origin = link_frames(robot, np.array([q]))
    return origin[0, 6].tolist()
