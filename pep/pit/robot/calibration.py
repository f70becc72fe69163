"""Calibration of one arm: the vendor's file of its own kinematics, read strictly and laid over the model.

No two arms are alike; each leaves its factory with its own kinematics, and a person exports them from the controller
with the vendor's tool. The controller computes with them, so its joint angles are meaningful only on this chain. A file
that is farther from nominal than any arm we know of is another robot's, in another unit, or damaged.
"""

from __future__ import annotations

import hashlib
import math
import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
import pinocchio
import yaml

from pep.pit.base.errors import ModelError
from pep.pit.robot.model import JOINTS, SourceFile, Vector, validated

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pep.pit.robot.model import Model, RobotJoint

SIZE_LIMIT: Final = 16_384  # ours: characters; a file of the vendor's tool has about 1000
LINKS: Final = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")  # U2: names in the file
MEMBERS: Final = ("x", "y", "z", "roll", "pitch", "yaw")  # U2: metre and radian, as in a URDF origin
NUMBER: Final = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
SIGNATURE: Final = re.compile(r"calib_[0-9]{1,20}")  # U2: the controller's own checksum, 64 bits
CALIBRATION: Final = "calibration"  # `Source.kind`
OFFSET_LIMIT_M: Final = 0.002  # CAL: twice the farthest joint of four UR3e, 0.91 mm
TURN_LIMIT_RAD: Final = 0.014  # CAL: twice the farthest of them, 6.8 mrad
TIP_LIMIT_M: Final = 0.013  # CAL: twice the farthest of them by the same sum, 6.4 mm; of longer arms as much more


@dataclass(frozen=True, slots=True)
class Placement:
    """Place of one joint in the frame of the link before it."""

    offset_m: Vector
    rpy_rad: Vector


@dataclass(frozen=True, slots=True)
class Calibration:
    """One arm's own kinematics.

    Attributes:
        joints: from the base outwards, six.
        signature: the controller's checksum of them, as the file states it.
    """

    joints: tuple[Placement, ...]
    signature: str

    @staticmethod
    def from_yaml(text: str) -> Calibration:
        """Calibration in the form of the vendor's tool.

        Raises:
            ModelError: a file of any other form: a member too many, too few or twice, a number that is not finite,
                anchors, tags, lists, a second document, more than 16 kB.
        """
        if len(text) > SIZE_LIMIT:
            raise ModelError("PHYSICS_FAULT", "a calibration file of this length")
        try:
            return _read(yaml.parse(text, Loader=yaml.BaseLoader))
        except yaml.YAMLError as error:
            raise ModelError("PHYSICS_FAULT", "a calibration that is not YAML") from error

    @property
    def sha256(self) -> str:
        """Digest of every number, exact to the last bit, and of the signature."""
        numbers = [x.hex() for joint in self.joints for x in (*joint.offset_m, *joint.rpy_rad)]
        return hashlib.sha256("\n".join([self.signature, *numbers]).encode()).hexdigest()


def own_kinematics(model: Model) -> str | None:
    """Digest (hex) of the calibration that is laid over the model, or None for its nominal kinematics."""
    return next((source.sha256 for source in model.derived_from if source.kind == CALIBRATION), None)


NOMINAL_ERROR_M: Final = 0.0045  # CAL: error of nominal ones: 4.2 mm on the farthest of four UR3e, rounded up
SPAN_M: Final = 0.6713  # CAL: of these arms, as `span_of`


def span_of(model: Model) -> float:
    """Length of the arm beyond its first joint, stretched out, metre."""
    return sum(math.hypot(*joint.offset_m) for joint in model.joints[1:])


def longer(model: Model) -> float:
    """Factor by which the same turn of a joint carries the flange farther than on the arms that were measured."""
    return max(1.0, span_of(model) / SPAN_M)


def nominal_error_m(model: Model) -> float:
    """Distance of the tool from where the model has it that is granted to an arm, by its kinematics.

    No exports of other arms than the UR3e are known to us: a longer one is granted as much more.
    """
    return NOMINAL_ERROR_M * longer(model)


REMEDY: Final = (
    "take the file anew from this arm with the vendor's ur_calibration, and check that the arm is of this model, "
    "lengths are in metres and angles in radians"
)
"""Next step after a calibration that cannot be this arm's."""


def calibrated(model: Model, calibration: Calibration) -> Model:
    """The model with this arm's own kinematics; all that is derived from it follows.

    Raises:
        ModelError: a joint, or the tool point, farther from nominal than the bounds above; a model that is calibrated
            already.
    """
    if own_kinematics(model) is not None:
        raise ModelError("PHYSICS_FAULT", "calibrated twice")
    if len(calibration.joints) != JOINTS:
        raise ModelError("PHYSICS_FAULT", "a calibration of six joints is needed")
    tip = 0.0
    beyond = max(math.hypot(*tool.tcp_m) for tool in model.tools)
    # From the tip inwards: a turning joint sweeps at most all links beyond it.
    for joint, own in reversed(list(zip(model.joints, calibration.joints, strict=True))):
        offset, turn = _apart(joint, own)
        if not (offset <= OFFSET_LIMIT_M and turn <= TURN_LIMIT_RAD):
            found = f"{joint.name}: a calibration {offset:.4f} m and {turn:.4f} rad from nominal"
            raise ModelError("PHYSICS_FAULT", f"{found}, beyond {OFFSET_LIMIT_M} m or {TURN_LIMIT_RAD} rad; {REMEDY}")
        tip += offset + turn * beyond
        beyond += math.hypot(*own.offset_m)
    most = TIP_LIMIT_M * longer(model)
    if not tip <= most:
        found = f"a calibration that moves the tool point by up to {tip:.4f} m"
        raise ModelError("PHYSICS_FAULT", f"{found}, beyond {most:.3f} m; {REMEDY}")
    joints = tuple(
        replace(joint, offset_m=own.offset_m, rpy_rad=own.rpy_rad)
        for joint, own in zip(model.joints, calibration.joints, strict=True)
    )
    source = SourceFile(CALIBRATION, calibration.sha256)
    return validated(replace(model, joints=joints, derived_from=(*model.derived_from, source)))


def _apart(joint: RobotJoint, own: Placement) -> tuple[float, float]:
    """Distance of a joint's own place from nominal: metre, and radian about any one axis.

    Angles are compared as rotations: the same one has several spellings (roll pi, pitch pi, yaw pi is none at all).
    """
    offset = math.dist(joint.offset_m, own.offset_m)
    between = pinocchio.rpy.rpyToMatrix(*joint.rpy_rad).T @ pinocchio.rpy.rpyToMatrix(*own.rpy_rad)
    # For small turns the distance of the matrices is exact to the last bit, unlike their trace.
    turn = 2 * math.asin(min(1.0, float(np.linalg.norm(between - np.eye(3))) / (2 * math.sqrt(2))))
    return offset, turn


def _read(events: Iterator[yaml.Event]) -> Calibration:
    """Calibration that a YAML file spells.

    No tree is built: an unexpected event is refused.
    """

    def expect(kind: type[yaml.Event]) -> yaml.Event:
        event = next(events, None)
        tagged = getattr(event, "tag", None) is not None or getattr(event, "anchor", None) is not None
        if not isinstance(event, kind) or tagged:
            raise ModelError("PHYSICS_FAULT", "a calibration of another form")
        return event

    def word() -> str:
        return str(getattr(expect(yaml.ScalarEvent), "value", ""))

    for opening in (yaml.StreamStartEvent, yaml.DocumentStartEvent, yaml.MappingStartEvent):
        expect(opening)
    _equal(word(), "kinematics")
    expect(yaml.MappingStartEvent)
    found: dict[str, Placement] = {}
    signature = ""
    for _ in range(JOINTS + 1):
        name = word()
        if name == "hash":
            signature = word()
            if not SIGNATURE.fullmatch(signature):
                raise ModelError("PHYSICS_FAULT", "a calibration without its checksum")
            continue
        if name not in LINKS:
            raise ModelError("PHYSICS_FAULT", "a calibration names a link that it must not")
        expect(yaml.MappingStartEvent)
        numbers = {word(): _number(word()) for _ in MEMBERS}
        if set(numbers) != set(MEMBERS):
            raise ModelError("PHYSICS_FAULT", f"{name}: x, y, z, roll, pitch and yaw, each once")
        expect(yaml.MappingEndEvent)
        x, y, z, *rpy = (numbers[member] for member in MEMBERS)
        found[name] = Placement((x, y, z), (rpy[0], rpy[1], rpy[2]))
    for closing in (yaml.MappingEndEvent, yaml.MappingEndEvent, yaml.DocumentEndEvent, yaml.StreamEndEvent):
        expect(closing)
    if len(found) != JOINTS or not signature:  # a name twice is another one missing
        raise ModelError("PHYSICS_FAULT", "a calibration of six links and a checksum is needed")
    return Calibration(tuple(found[name] for name in LINKS), signature)


def _equal(found: str, wanted: str) -> None:
    if found != wanted:
        raise ModelError("PHYSICS_FAULT", f"a calibration begins with {wanted}")


def _number(text: str) -> float:
    if not NUMBER.fullmatch(text) or not math.isfinite(float(text)):
        raise ModelError("PHYSICS_FAULT", "a calibration with a number that is none")
    return float(text)
