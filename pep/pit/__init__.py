"""Physics room: possible impact of a command on people, things and the robot, before it is sent.

`assess` gives a proven upper bound of the physical impact index over the whole motion, or a fault; `remaining` says of
a motion under way whether what is left of it stays inside what was authorised. They claim no safety function: the
robot's own safety configuration stays in force, and the tier decides authorisation, not protection.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from pep.pit.base.errors import CellError, ModelError, PitError, SceneError
from pep.pit.base.motion import (
    BlendedPath,
    GripperMove,
    JointLeg,
    JointPath,
    JointTrajectory,
    LineLeg,
    LinePath,
    Motion,
    MoveJ,
    MoveL,
    OutputSet,
    ServoJ,
    SpeedJ,
    SpeedL,
)
from pep.pit.robot.calibration import NOMINAL_ERROR_M, Calibration
from pep.pit.robot.gripped_object import GrippedObject
from pep.pit.robot.outfit import Outfit
from pep.pit.robot.robot import Robot
from pep.pit.robot.urdf_robot import robot_of
from pep.pit.scene.adult_body import Build, adult_at_distance, standing_adult
from pep.pit.scene.cell import (
    CALIBRATED_ERROR_M,
    CALIBRATED_UNCERTAINTY_M,
    NOMINAL_UNCERTAINTY_M,
    CellParameters,
    Contact,
    Output,
    Part,
    StaticObject,
    StaticZone,
)
from pep.pit.scene.grip_sightings import declared_part, gripped, unknown_part
from pep.pit.scene.observation import observed, scene_observed
from pep.pit.scene.scene import Box, Capsule, Convex, Person, Region, Scene, Sphere, Thing, Workspace, Zone
from pep.pit.scene.survey import SurveyError, SurveyFault, numbers_only, surveyed

if TYPE_CHECKING:
    from pep.pit.assessment.assess import assess
    from pep.pit.assessment.assessment import Assessment, Certificate
    from pep.pit.assessment.remaining import Pace, Remaining, remaining
    from pep.pit.assessment.stream import Bounded, Stream

__all__ = [
    "CALIBRATED_ERROR_M",
    "CALIBRATED_UNCERTAINTY_M",
    "NOMINAL_ERROR_M",
    "NOMINAL_UNCERTAINTY_M",
    "Assessment",
    "BlendedPath",
    "Bounded",
    "Box",
    "Build",
    "Calibration",
    "Capsule",
    "CellError",
    "CellParameters",
    "Certificate",
    "Contact",
    "Convex",
    "GrippedObject",
    "GripperMove",
    "JointLeg",
    "JointPath",
    "JointTrajectory",
    "LineLeg",
    "LinePath",
    "ModelError",
    "Motion",
    "MoveJ",
    "MoveL",
    "Outfit",
    "Output",
    "OutputSet",
    "Pace",
    "Part",
    "Person",
    "PitError",
    "Region",
    "Remaining",
    "Robot",
    "Scene",
    "SceneError",
    "ServoJ",
    "SpeedJ",
    "SpeedL",
    "Sphere",
    "StaticObject",
    "StaticZone",
    "Stream",
    "SurveyError",
    "SurveyFault",
    "Thing",
    "Workspace",
    "Zone",
    "adult_at_distance",
    "assess",
    "declared_part",
    "gripped",
    "numbers_only",
    "observed",
    "remaining",
    "robot_of",
    "scene_observed",
    "standing_adult",
    "surveyed",
    "unknown_part",
]

_ASKED: Final = {
    "Assessment": "assessment",
    "Bounded": "stream",
    "Certificate": "assessment",
    "Pace": "remaining",
    "Remaining": "remaining",
    "Stream": "stream",
    "assess": "assess",
    "remaining": "remaining",
}
"""Modules of the names that a question needs; their compiler takes half a second to load, which scenes do without."""


def __getattr__(name: str) -> Any:
    if name not in _ASKED:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"pep.pit.assessment.{_ASKED[name]}"), name)
