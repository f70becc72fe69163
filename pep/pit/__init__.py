"""The physics room: what could this command do to people, things and the robot, before it is sent?

`assess` gives a proven upper bound of the physical impact index over the whole motion, or a fault. It claims no safety
function: the robot's own safety configuration stays in force, and the tier decides authorisation, not protection.
"""

from pep.pit.adult import Build, adult_at_distance, standing_adult
from pep.pit.assess import assess
from pep.pit.assessment import Assessment, Certificate
from pep.pit.cell import CellParameters, StaticObject, StaticZone
from pep.pit.errors import CellError, ModelError, PitError, SceneError
from pep.pit.motion import GripperMove, Motion, MoveJ
from pep.pit.robot import Robot
from pep.pit.scene import Box, Capsule, Person, Region, Scene, Sphere, Thing, Workspace, Zone, observed

__all__ = [
    "Assessment",
    "Box",
    "Build",
    "Capsule",
    "CellError",
    "CellParameters",
    "Certificate",
    "GripperMove",
    "ModelError",
    "Motion",
    "MoveJ",
    "Person",
    "PitError",
    "Region",
    "Robot",
    "Scene",
    "SceneError",
    "Sphere",
    "StaticObject",
    "StaticZone",
    "Thing",
    "Workspace",
    "Zone",
    "adult_at_distance",
    "assess",
    "observed",
    "standing_adult",
]
