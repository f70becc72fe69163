"""Comparison of a controller with the word on it: arm, version, tool, load and kinematics."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.base.stop_model import SAFE_MODES
from pep.pit import Calibration, ModelError, Robot
from pep.pit.robot.calibration import Placement, calibrated, nominal_error_m
from pep.pit.robot.controller_kinematics import ControllerKinematics, same_arm, told_calibration
from pep.rtde.command.limits import OFFSET_M, OFFSET_RAD
from pep.rtde.robot.dashboard import SAID_OF
from pep.rtde.robot.readiness import OWN_POSE_M
from pep.world.world import tool_position
from policies.primitives.tools import RUNNING
from ztpm.cell.addresses import SetupError

if TYPE_CHECKING:
    from pep.pit.robot.model import Model, RobotTool
    from pep.rtde.robot.controller_survey import ControllerSurvey

POLYSCOPE: Final = re.compile(r"\b(\d{1,3})\.(\d{1,3})\.")
MAJOR: Final = 5
"""PolyScope that the gateway speaks with."""
TRIED: Final = ((5, 11), (5, 22))
"""First and last release that is simulated and tried (docs/deployment.md)."""
GRAM_KG: Final = 0.001
"""Difference of loads that is none; motions are refused beyond it (`PAYLOAD_MISMATCH`)."""
CENTRE_M: Final = 0.001
"""Likewise of their centres; ours."""


class RobotDiffersError(SetupError):
    """A controller that is not as it was said."""


@dataclass(frozen=True, slots=True)
class FittedRobot:
    """Arm of a controller as a cell takes it.

    Attributes:
        model: nominal.
        calibration: its own kinematics; None where it has the nominal ones, or does not tell.
        told: what a person should know besides, a sentence each.
    """

    model: Model
    calibration: Calibration | None
    told: tuple[str, ...]


def named_model(survey: ControllerSurvey, stated: Model | None) -> Model:
    """Model of the controller's arm, which is the stated one where one is stated.

    Raises:
        RobotDiffersError: the controller says that its arm is another one, or one that no shipped model is.
    """
    if stated is None:
        if survey.shipped is None:
            known = ", ".join(SAID_OF)
            raise RobotDiffersError(f"model: the controller says {survey.model!r} of its arm; shipped are {known}")
        from pep.pit.robot.model import Model

        return Model.shipped(survey.shipped)
    wanted = SAID_OF.get(stated.name, b"").decode()
    if not wanted:
        raise RobotDiffersError(f"model: no controller is known of an arm named {stated.name}")
    if survey.model != wanted:
        raise RobotDiffersError(
            f"model: the controller says {survey.model!r} of its arm, and {stated.name} would be {wanted!r}"
        )
    return stated


def fitted_robot(survey: ControllerSurvey, model: Model, *, tool: str, own: Calibration | None) -> FittedRobot:
    """The arm as the cell takes it, when everything that the controller tells agrees.

    Args:
        survey: of the controller.
        model: nominal, of its arm.
        tool: name of the mounted tool.
        own: kinematics that a person says are the arm's; None: those of the controller are.

    Raises:
        RobotDiffersError: naming what is another one, and by how much.
    """
    told = list(_version(survey))
    try:
        mounted = Robot.from_model(model, tool=tool).tool
    except ModelError as error:
        known = ", ".join(each.name for each in model.tools)
        raise RobotDiffersError(f"tool: {error.detail}; {model.name} has {known}") from error
    _check_tool(survey, mounted)
    calibration = _kinematics(survey, model, own, told)
    try:
        taken = model if calibration is None else calibrated(model, calibration)
        robot = Robot.from_model(taken, tool=tool)
    except ModelError as error:
        raise RobotDiffersError(f"calibration: {error.detail}") from error
    sure = calibration is not None or survey.kinematics is not None
    most = OWN_POSE_M if sure else nominal_error_m(model)
    apart = math.dist(tool_position(robot, survey.q_rad), survey.tool_pose[:3])
    if not apart <= most:
        raise RobotDiffersError(
            f"calibration: the controller has the tool {apart * 1e3:.1f} mm from where these kinematics have it, "
            f"and {most * 1e3:.1f} mm is the most"
        )
    told += [*_standing(survey), *_limits(survey, model)]
    told.append(
        "safety planes and the limits of the safety configuration are told by no port: read them at the pendant"
    )
    return FittedRobot(model, calibration, tuple(told))


def _version(survey: ControllerSurvey) -> list[str]:
    found = POLYSCOPE.search(survey.polyscope)
    if found is None or int(found[1]) != MAJOR:
        raise RobotDiffersError(f"version: the controller says {survey.polyscope!r}, and PolyScope {MAJOR} is needed")
    release = int(found[1]), int(found[2])
    if not TRIED[0] <= release <= TRIED[1]:
        first, last = (f"{major}.{minor}" for major, minor in TRIED)
        return [f"PolyScope {release[0]}.{release[1]} was never tried; {first} to {last} were"]
    return []


def _check_tool(survey: ControllerSurvey, tool: RobotTool) -> None:
    x, y, z = tool.tcp_m
    offset, turn = math.dist(survey.tcp_offset[:3], (x, y, z)), math.hypot(*survey.tcp_offset[3:])
    wanted = f"{tool.name} has its point at ({x * 1e3:g}, {y * 1e3:g}, {z * 1e3:g}) mm, not turned"
    if not (offset <= OFFSET_M and turn <= OFFSET_RAD):
        raise RobotDiffersError(
            f"tool: the controller's TCP is {offset * 1e3:.1f} mm and {turn * 1e3:.0f} mrad off; {wanted}: set it in "
            "the installation, or name the tool that is mounted"
        )
    centre = math.dist(survey.payload_cog_m, tool.com_m)
    if not (abs(survey.payload_kg - tool.mass_kg) <= GRAM_KG and centre <= CENTRE_M):
        at = ", ".join(f"{each * 1e3:g}" for each in tool.com_m)
        raise RobotDiffersError(
            f"payload: the controller has {survey.payload_kg:.3f} kg, its centre {centre * 1e3:.1f} mm off; "
            f"{tool.name} has {tool.mass_kg:.3f} kg at ({at}) mm: set it in the installation, or name what is mounted"
        )


def _kinematics(survey: ControllerSurvey, model: Model, own: Calibration | None, told: list[str]) -> Calibration | None:
    """Kinematics of this arm by the controller, or by the person where the controller does not tell."""
    if survey.kinematics is None:
        told.append("the controller does not tell its kinematics in a known form: the tool's place was compared alone")
        return own
    stated = survey.kinematics
    spoken = ControllerKinematics(stated.theta, stated.a, stated.d, stated.alpha)
    try:
        found = told_calibration(model, spoken)
    except ModelError as error:
        raise RobotDiffersError(f"calibration: {error.detail}") from error
    if own is not None and not same_arm(own, found or _nominal(model)):
        raise RobotDiffersError(
            f"calibration: the file ({own.signature}) is not of this arm ({spoken.signature}): leave it out, the "
            "controller tells its own"
        )
    if found is None:
        told.append("the controller has nominal kinematics: its arm is not calibrated, and more uncertainty is granted")
    return found


def _nominal(model: Model) -> Calibration:
    return Calibration(tuple(Placement(joint.offset_m, joint.rpy_rad) for joint in model.joints), "calib_0")


def _standing(survey: ControllerSurvey) -> list[str]:
    """Reasons for which the arm does not move now, each ended by a person at the pendant."""
    found = [] if survey.remote is not False else ["it is in local control: choose Remote at the pendant"]
    if survey.robot_mode != RUNNING:
        found.append("its arm is not powered, or its brakes are on: start it at the pendant")
    if survey.safety_mode not in SAFE_MODES:
        found.append("it is in a safety stop: end that at the pendant")
    return found


def _limits(survey: ControllerSurvey, model: Model) -> list[str]:
    """Joints whose limits in the controller are narrower than the model's."""
    if survey.configuration is None:
        return []
    places, motions = survey.configuration.position_limits, survey.configuration.motion_limits
    found = []
    for index, joint in enumerate(model.joints):
        low, high = places[2 * index : 2 * index + 2]
        speed = motions[2 * index]
        narrower = high < joint.range_rad[1] - OFFSET_RAD or low > joint.range_rad[0] + OFFSET_RAD
        if narrower or speed < joint.speed_limit_rad_s - OFFSET_RAD:
            found.append(f"{joint.name}: the controller allows {low:.2f} to {high:.2f} rad at {speed:.2f} rad/s, less "
                         "than the model: what goes beyond ends in a stop of its own")  # fmt: skip
    return found
