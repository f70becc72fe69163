"""A controller is taken as it was said, or refused by what is another one."""

from dataclasses import replace

import pytest
from pep.pit.robot.calibration import Calibration
from pep.pit.robot.model import Model
from pep.rtde.robot.controller_survey import ControllerSurvey
from pep.rtde.wire.primary_state import Configuration, Kinematics
from pep.world.world import tool_position
from tests.pep.pit.robot.test_calibration import ARMS, spelled
from tests.pep.pit.robot.test_controller_kinematics import denavit, nominal
from ztpm.cell.robot_check import RobotDiffersError, fitted_robot, named_model

from pep.pit import Robot

TOOL = "robotiq_2f85"
UR5E = Model.shipped("ur5e")
ZERO = (0.0,) * 6
Q = (0.1, -1.5, 1.4, -1.5, -1.5, 0.2)
OWN_SIGNATURE = next(iter(ARMS))
EXPORT = Calibration.from_yaml(spelled(ARMS[OWN_SIGNATURE], OWN_SIGNATURE))
OTHER = Calibration.from_yaml(spelled(*reversed(list(ARMS.items())[1])))


def stated(told):
    return Kinematics((0,) * 6, told.theta_rad, told.a_m, told.d_m, told.alpha_rad, 0)


def survey(name="ur5e", said="UR5"):
    model = Model.shipped(name)
    robot = Robot.from_model(model, tool=TOOL)
    places = tuple(x for joint in model.joints for x in joint.range_rad)
    motions = tuple(x for joint in model.joints for x in (joint.speed_limit_rad_s, 40.0))
    return ControllerSurvey(
        model=said, serial="20235300001", polyscope="URSoftware 5.15.2.1 (Apr 01 2023)", remote=True,
        kinematics=stated(nominal(name)),
        configuration=Configuration(places, motions, 1.0, 1.0, 1.0, 1.0, 0.1, ZERO, ZERO, ZERO, ZERO, 0, 0, 1, 1),
        q_rad=Q, tool_pose=(*tool_position(robot, Q), 0.0, 0.0, 0.0),
        tcp_offset=(*robot.tool.tcp_m, 0.0, 0.0, 0.0), payload_kg=robot.tool.mass_kg,
        payload_cog_m=robot.tool.com_m, robot_mode=7, safety_mode=1,
    )  # fmt: skip


def calibrated_ur3e():
    from pep.pit.robot.calibration import calibrated

    told = survey("ur3e", "UR3")
    own = Robot.from_model(calibrated(Model.shipped("ur3e"), EXPORT), tool=TOOL)
    return replace(told, kinematics=stated(denavit(EXPORT)), tool_pose=(*tool_position(own, Q), 0.0, 0.0, 0.0))


def test_an_arm_as_it_was_said_is_taken():
    told = survey()
    assert named_model(told, None) == named_model(told, UR5E) == UR5E
    fitted = fitted_robot(told, UR5E, tool=TOOL, own=None)
    assert (fitted.model, fitted.calibration) == (UR5E, None)


def test_an_arm_with_kinematics_of_its_own_brings_them():
    told = calibrated_ur3e()
    found = fitted_robot(told, Model.shipped("ur3e"), tool=TOOL, own=None).calibration
    assert found is not None
    assert fitted_robot(told, Model.shipped("ur3e"), tool=TOOL, own=EXPORT).calibration == found


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"tcp_offset": (0.0, 0.0, 0.1769, 0.0, 0.0, 0.0)}, "tool"),
        ({"tcp_offset": (0.0, 0.0, 0.1767, 0.0, 0.0, 0.01)}, "tool"),
        ({"payload_kg": 1.002}, "payload"),
        ({"payload_cog_m": (0.0, 0.0, 0.06)}, "payload"),
        ({"tool_pose": (0.3, 0.3, 0.3, 0.0, 0.0, 0.0)}, "calibration"),
        ({"kinematics": stated(nominal("ur10e"))}, "calibration"),
        ({"polyscope": "URSoftware 3.15.0.1 (Apr 01 2020)"}, "version"),
        ({"polyscope": "a word"}, "version"),
    ],
)
def test_what_is_another_one_is_refused_by_its_name(change, named):
    with pytest.raises(RobotDiffersError) as refused:
        fitted_robot(replace(survey(), **change), UR5E, tool=TOOL, own=None)
    assert str(refused.value).startswith(f"{named}:")


def test_a_calibration_of_another_arm_is_refused():
    ur3e = Model.shipped("ur3e")
    for told in (calibrated_ur3e(), survey("ur3e", "UR3")):
        with pytest.raises(RobotDiffersError) as refused:
            fitted_robot(told, ur3e, tool=TOOL, own=OTHER)
        assert str(refused.value).startswith("calibration:")


def test_a_controller_that_does_not_tell_its_kinematics_is_compared_by_the_tools_place():
    told = replace(calibrated_ur3e(), kinematics=None, configuration=None)
    assert fitted_robot(told, Model.shipped("ur3e"), tool=TOOL, own=EXPORT).calibration == EXPORT
    with pytest.raises(RobotDiffersError):
        fitted_robot(told, Model.shipped("ur3e"), tool=TOOL, own=OTHER)


@pytest.mark.parametrize(("said", "model"), [("UR3", "ur5e"), ("UR5", "ur10e"), ("UR20", None)])
def test_another_model_is_refused(said, model):
    with pytest.raises(RobotDiffersError) as refused:
        named_model(survey(said=said), None if model is None else Model.shipped(model))
    assert str(refused.value).startswith("model:")


def test_another_tool_than_the_models_is_refused():
    with pytest.raises(RobotDiffersError) as refused:
        fitted_robot(survey(), UR5E, tool="welder", own=None)
    assert str(refused.value).startswith("tool:")


def test_narrower_limits_and_untried_releases_are_told():
    told = survey()
    narrow = replace(told.configuration, position_limits=(-1.0, 1.0, *told.configuration.position_limits[2:]))
    before = len(fitted_robot(told, UR5E, tool=TOOL, own=None).told)
    after = fitted_robot(
        replace(told, configuration=narrow, polyscope="URSoftware 5.25.1.1"), UR5E, tool=TOOL, own=None
    ).told
    assert len(after) == before + 2
    idle = replace(told, remote=False, robot_mode=3, safety_mode=3)
    assert len(fitted_robot(idle, UR5E, tool=TOOL, own=None).told) == before + 3
    assert any("shoulder_pan" in sentence for sentence in after)
