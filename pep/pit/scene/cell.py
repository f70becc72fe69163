"""Parameters of a cell: the arm's stop, people's movement, bands and limits, surveyed objects.

All of them are named, have a default with its source, and may be set in the cell's file; none comes from a call.
Sources: PHY-n is a clause of docs/physics.md (bands chosen so that the paper's three cells keep their tiers); the other
marks are in its list of sources.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal

from pep.base.stop_model import STOP_DECELERATION_RAD_S2, STOP_DELAY_S
from pep.pit.base.errors import CellError
from pep.pit.base.strict import STRICT, FormError, read_table, read_toml
from pep.pit.robot.calibration import NOMINAL_ERROR_M
from pep.pit.robot.gripped_object import SIZE_LIMIT_M
from pep.pit.scene.scene import Box, Capsule, Convex, Scene, Shape, Sphere, Thing, Vector, Workspace, Zone

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic import ConfigDict

TRACKING_M: Final = 0.003  # PHY-11: distance of a moving arm from its command
CALIBRATED_ERROR_M: Final = 0.002  # PHY-11: error of the arm's own kinematics at the tool
CALIBRATED_UNCERTAINTY_M: Final = CALIBRATED_ERROR_M + TRACKING_M
NOMINAL_UNCERTAINTY_M: Final = NOMINAL_ERROR_M + TRACKING_M
HIGHEST_PIN: Final = 17  # U12: 8 standard, 8 configurable and 2 tool outputs
FINEST_STEP: Final = 0.01  # of a robot's own slider: whole percents
_ONE_OF: Final = "exactly one of box, capsule, convex, sphere"


def _the_shape(*stated: Shape | None) -> Shape:
    given = [shape for shape in stated if shape is not None]
    if len(given) != 1:
        raise CellError("PARAMETERS_WRONG", _ONE_OF)
    return given[0]


@dataclass(frozen=True, slots=True)
class StaticObject:
    """Surveyed object: a name, a kind, and one shape."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    name: str
    kind: Literal["fragile", "rigid"] = "rigid"
    capsule: Capsule | None = None
    sphere: Sphere | None = None
    box: Box | None = None
    convex: Convex | None = None

    @property
    def shape(self) -> Shape:
        """The one shape that is given."""
        return _the_shape(self.capsule, self.sphere, self.box, self.convex)


@dataclass(frozen=True, slots=True)
class StaticZone:
    """A zone: hard when no tier is given, else entering it has that tier."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    name: str
    tier: Literal[1, 2, 3, 4] | None = None
    capsule: Capsule | None = None
    sphere: Sphere | None = None
    box: Box | None = None
    convex: Convex | None = None

    @property
    def shape(self) -> Shape:
        """The one shape that is given."""
        return _the_shape(self.capsule, self.sphere, self.box, self.convex)


@dataclass(frozen=True, slots=True)
class Contact:
    """Object that may be touched on purpose, by the tool or by the held part. Never a person."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    object: str
    by: Literal["tool", "payload"]


@dataclass(frozen=True, slots=True)
class Part:
    """Known properties of an object that the robot may carry.

    Attributes:
        object: its id in the scene.
        mass_kg: more than 0.
        blunt: it is known to have no edges.
        centre_m: centre of its mass in the flange frame while a program says that it is held; None is the tool's tip.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    object: str
    mass_kg: float
    blunt: bool = False
    centre_m: Vector | None = None


@dataclass(frozen=True, slots=True)
class Output:
    """Digital output: its pin, its device, and the tier of switching it."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    pin: int
    tier: Literal[0, 1, 2, 3, 4]
    name: str


TABLE: Final = StaticObject(
    name="table",
    box=Box(
        (-0.3, 0.0, -0.06),  # the embedded demo cell: in front of the arm, top 10 mm below the flange of the base
        (0.5, 0.5, 0.05),  # likewise: 1 m x 1 m x 0.1 m
    ),
)


@dataclass(frozen=True)
class CellParameters:
    """Everything about a cell but the robot and the present view. SI units, unit in each name."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    tool: str = "robotiq_2f85"
    payload_kg: float | None = 0.0  # held part; None is unknown and counts as the robot's whole payload
    objects: tuple[StaticObject, ...] = (TABLE,)
    zones: tuple[StaticZone, ...] = ()
    workspace: Workspace | None = None
    contacts: tuple[Contact, ...] = ()
    parts: tuple[Part, ...] = ()
    outputs: tuple[Output, ...] = ()

    # stopping: one model for the index, every stop sent and the simulator
    stop_deceleration_rad_s2: float = STOP_DECELERATION_RAD_S2
    stop_delay_s: float = STOP_DELAY_S
    watch_age_limit_s: float = 0.15  # PHY-2: least age in the model
    reaction_s: float = 0.06  # PHY-2: 0.03 s computing and 0.03 s on the wire
    watch_time_limit_s: float = 0.15  # PHY-13: an answer about a moving arm that is older than the watch allows is none
    tracking_tolerance_m: float = TRACKING_M  # PHY-13: its share of `robot_uncertainty_m`; farther is off the path

    # slowing by the speed slider instead of stopping (PHY-50)
    slider_delay_s: float = 0.1  # ours: judging, sending, and the first package that shows it; later is a stop
    slider_change_per_s: float = 4.0  # measured on the simulated controller: from full speed to none in 0.25 s
    slider_step: float = 0.05  # ours: settings of the slider in steps of 5 %; a robot's own has 1 %
    slowest_fraction: float = 0.1  # ours: slower is no motion worth waiting for, and a stop tells people so
    pacing_time_limit_s: float = (
        0.03  # PHY-2: computing's half of `reaction_s`; a stop waits no longer for a slower speed
    )
    restore_dwell_s: float = 0.5  # ours: a way that was clear for so long is; longer than a step to the side takes
    restore_gain: float = 0.1  # ours: two steps; less is not worth a change of speed

    # people
    person_speed_m_s: float = 1.6  # ISO 13855 walking speed, as N1 restates it
    intrusion_tracked_m: float = 0.10  # PHY-3: reach of a tracked limb before it is seen
    intrusion_untracked_m: float = 0.85  # PHY-3: reach of an arm when only the trunk is tracked
    person_uncertainty_m: float = 0.05  # PHY-3: Z_d
    warn_band_m: float = 0.30  # PHY-5: policy band
    penetration_band_m: float = 0.05  # PHY-5: path through a person, full scale
    harm_ratio_body: float = 2.0  # PHY-5: phi4 of trunk and limbs: four times the energy of pain onset
    harm_ratio_head: float = 1.0  # PHY-5: phi4 of head, face, neck, and of any tool that is not blunt
    contact_area_m2: float = 1.96e-4  # N6: the 1.4 cm x 1.4 cm probe behind the pressure limits

    # things
    robot_uncertainty_m: float = NOMINAL_UNCERTAINTY_M  # PHY-11: `CALIBRATED_UNCERTAINTY_M` for kinematics of its own
    object_uncertainty_m: float = 0.010  # PHY-11: observed object, with a calibrated robot's 5 mm in all 15 mm
    surveyed_uncertainty_m: float = 0.0  # surveyed objects: only the robot's own uncertainty is left
    fragile_band_m: float = 0.25  # PHY-6: policy band
    rigid_band_m: float = 0.02  # PHY-6: policy band
    overlap_limit_m: float = 0.05  # PHY-6: deeper than capsules can pretend, in the arm itself; in a thing at most
    fragile_break_force_n: float = 20.0  # G1: the gripper's least force; unknown strength breaks at it

    # contact that is meant
    contact_speed_m_s: float = 0.05  # DESIGN section 6, PHY-12: at most this
    contact_near_m: float = 0.03  # DESIGN section 6, PHY-12: while nearer than this
    contact_depth_m: float = 0.02  # PHY-12: fingers rise 13.5 mm on closing (G3), a calibrated arm errs 5; more presses

    # the held object
    held_tolerance_m: float = 0.03  # PHY-14: an object seen this near to the grip is the held one
    grip_reach_m: float = 0.01  # PHY-14: a gripped object is this near to the fingers' pads
    unknown_part_m: float = 0.1  # PHY-14: radius, about the tool point, of an unseen held part

    # limits that the robot's own safety configuration also holds
    tcp_speed_limit_m_s: float = 1.5  # PHY-1: from memory of the default row; read it from the installation
    elbow_speed_limit_m_s: float = 1.5  # likewise
    momentum_limit_kg_m_s: float = 25.0  # likewise

    # perception
    perception_age_limit_s: float = 0.5  # PHY-8: older is unknown
    unknown_floor: float = 3.0  # PHY-8: index floor without a valid view

    # retreat of a stuck arm
    retreat_joint_speed_rad_s: float = math.pi / 6  # U5: recovery mode, 30 deg/s
    retreat_speed_m_s: float = 0.25  # U5: recovery mode, 250 mm/s
    retreat_tolerance_m: float = 0.001  # numerical room of the proof that no violated clearance shrinks

    time_limit_s: float = 2.0  # ours: far more than an answer takes on a loaded machine; later is a fault

    def __hash__(self) -> int:
        """Hash over all numbers, kept: many caches have the cell as their key."""
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash(tuple(getattr(self, field.name) for field in fields(self)))

    @staticmethod
    def from_toml(text: str) -> CellParameters:
        """Parameters that a TOML text spells; a missing one keeps its default.

        Raises:
            CellError: unknown keys, wrong types, numbers that are not finite or out of any sense.
        """
        try:
            return CellParameters.from_table(read_toml(text))
        except FormError as error:
            raise CellError("PARAMETERS_WRONG", str(error)) from error

    @staticmethod
    def from_table(table: Mapping[str, Any]) -> CellParameters:
        """The same, from an already parsed table (the `[cell]` part of a larger file).

        Raises:
            CellError: as above.
        """
        try:
            cell = read_table(CellParameters, table)
        except FormError as error:
            raise CellError("PARAMETERS_WRONG", str(error)) from error
        wrong = cell.defect()
        if wrong is not None:
            raise CellError("PARAMETERS_WRONG", wrong)
        return cell

    def slowing_s(self, running: float) -> float:
        """Longest time from measuring an arm that runs at this fraction of its speed until it has slowed down."""
        return self.slider_delay_s + running / self.slider_change_per_s

    def defect(self) -> str | None:
        """Defect that makes these parameters unfit, or None.

        Each number is finite, at least 0, and above 0 where it divides.
        """
        return self._defect

    @cached_property
    def _defect(self) -> str | None:  # asked with every question, and a cell has one
        return _defect(self)

    @cached_property
    def surveyed(self) -> Scene:
        """Scene without any perception: the surveyed part of the cell."""
        surveyed = tuple(Thing(o.name, o.kind, o.shape, self.surveyed_uncertainty_m) for o in self.objects)
        zones = tuple(Zone(z.name, z.shape, z.tier) for z in self.zones)
        return Scene(objects=surveyed, zones=zones, workspace=self.workspace)


def _defect(cell: CellParameters) -> str | None:
    dividing = {
        "stop_deceleration_rad_s2",
        "person_speed_m_s",
        "warn_band_m",
        "penetration_band_m",
        "harm_ratio_body",
        "harm_ratio_head",
        "contact_area_m2",
        "fragile_band_m",
        "rigid_band_m",
        "fragile_break_force_n",
        "tcp_speed_limit_m_s",
        "elbow_speed_limit_m_s",
        "momentum_limit_kg_m_s",
        "time_limit_s",
        "watch_time_limit_s",
        "contact_speed_m_s",
        "unknown_part_m",
        "slider_change_per_s",
        "slider_step",
        "slowest_fraction",
        "restore_gain",
    }
    for field in fields(cell):
        value = getattr(cell, field.name)
        if not isinstance(value, (int, float)):
            continue
        if not (math.isfinite(value) and value >= 0 and (value > 0 or field.name not in dividing)):
            return f"{field.name} is out of range"
    if not max(cell.slider_step, cell.slowest_fraction, cell.restore_gain) <= 1:
        return "a fraction of the speed above 1"
    if not cell.slider_step >= FINEST_STEP:
        return "slider_step is finer than a slider"
    names = [o.name for o in cell.objects] + [z.name for z in cell.zones]
    once = (names, cell.contacts, [p.object for p in cell.parts], [o.pin for o in cell.outputs])
    if any(len(set(each)) != len(each) for each in (*once, [o.name for o in cell.outputs])):
        return "names, contacts, parts or outputs repeat"
    if not all(contact.object and contact.by in ("tool", "payload") for contact in cell.contacts):
        return "a contact without an object, or by neither tool nor payload"
    if not all(abs(n) <= SIZE_LIMIT_M for part in cell.parts for n in part.centre_m or ()):
        return "parts.centre_m"
    if not all(math.isfinite(part.mass_kg) and part.mass_kg > 0 for part in cell.parts):
        return "a part without mass"
    if not all(0 <= o.pin <= HIGHEST_PIN and o.tier in (0, 1, 2, 3, 4) for o in cell.outputs):
        return "an output with a pin or tier that does not exist"
    if cell.tracking_tolerance_m > cell.robot_uncertainty_m:
        return "tracking_tolerance_m is more than the robot's whole uncertainty"
    try:
        return cell.surveyed.defect()
    except CellError as error:
        return error.detail


__all__ = ["TABLE", "CellError", "CellParameters", "Contact", "Output", "Part", "StaticObject", "StaticZone", "Vector"]
