"""URDF, read strictly: links, joints and the shapes that enclose the links, and no other file.

A misread file would move another robot than the real one, so every element that could change its geometry and is not
read here is refused by name: meshes, unexpanded macros, quaternions, mimicked joints. An outfit may name joints, such
as a gripper's, that are left out with all that hangs on them. No other file is opened, ever; a mesh of a link's surface
is named for who encloses it in capsules, those that are only pictures are skipped unread. The usual reader takes a file
more lightly: it drops a `<capsule>` with a line on the standard error unless the file says that it is of version 1.1,
and a robot without shapes is "all clear" everywhere.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final, TypeAlias

from pep.pit.base.errors import ModelError
from pep.pit.geometry.xml_elements import (
    SHOWN,
    Element,
    members,
    name_of,
    needed,
    number,
    only,
    positive,
    refuse,
    tree,
    vector,
    without_vocabularies,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pep.pit.robot.model import Vector
    from pep.pit.robot.outfit import Outfit

VERSIONS: Final = ("1.0", "1.1", "1.2")  # A9: versions that urdfdom 6 reads; no version is 1.0
CAPSULES_FROM: Final = "1.1"  # A9: before, its reader drops them
AXIS_LENGTHS: Final = (1e-3, 1e3)  # ours: the format asks for 1; the direction of a much shorter one is noise
LISTED: Final = 400  # characters of names that a message repeats
UNREAD: Final = ("material", "transmission", "gazebo", "ros2_control")  # say nothing of kinematics or collisions


@dataclass(frozen=True, slots=True)
class Pose:
    """A frame in another one: metre, and radian about the fixed axes x, y, z in this order."""

    xyz_m: Vector = (0.0, 0.0, 0.0)
    rpy_rad: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class UrdfSphere:
    """A sphere about the origin of its pose."""

    radius_m: float


@dataclass(frozen=True, slots=True)
class UrdfCylinder:
    """Cylinder along z about the origin of its pose.

    Rounded: a capsule, whose caps come on top of the length.
    """

    radius_m: float
    length_m: float
    rounded: bool


@dataclass(frozen=True, slots=True)
class UrdfBox:
    """A box about the origin of its pose, by its full edges."""

    size_m: Vector


@dataclass(frozen=True, slots=True)
class UrdfMesh:
    """A mesh in a file of its own, and metres per unit along its axes."""

    file: str
    scale: Vector


Shape: TypeAlias = UrdfSphere | UrdfCylinder | UrdfBox


@dataclass(frozen=True, slots=True)
class Inertial:
    """Mass and inertia of one link.

    Attributes:
        tensor_kg_m2: xx, xy, xz, yy, yz, zz about the centre of mass, in the axes of `pose`.
    """

    pose: Pose
    mass_kg: float
    tensor_kg_m2: tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Link:
    """One link: its shapes in its own frame, and its mass where the file states one."""

    name: str
    shapes: tuple[tuple[Pose, Shape | UrdfMesh], ...]
    inertial: Inertial | None


@dataclass(frozen=True, slots=True)
class UrdfLimits:
    """Limits of a turning joint: rad, rad/s, Nm.

    Attributes:
        stated: a person states the range.
    """

    low_rad: float
    high_rad: float
    speed_rad_s: float
    torque_nm: float
    stated: bool = False


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """A joint. Without limits it is fixed; otherwise it turns about `axis`, of length 1, in its own frame."""

    name: str
    parent: str
    child: str
    pose: Pose
    axis: Vector
    limits: UrdfLimits | None


@dataclass(frozen=True, slots=True)
class Description:
    """A URDF file.

    Attributes:
        links, joints: by name.
        sha256: of the file's text.
    """

    name: str
    links: Mapping[str, Link]
    joints: Mapping[str, UrdfJoint]
    sha256: str


def described(text: str, outfit: Outfit | None = None, *, meshes: bool = False) -> Description:
    """The robot that a URDF spells.

    Args:
        text: of the file.
        outfit: says what is left out, and the ranges that the file leaves open.
        meshes: links may have meshes, which the caller encloses.

    Raises:
        ModelError: not XML, too large, a document type, or anything that this module does not read and that could
            matter; the detail names the place.
    """
    try:
        content = text.encode()
    except UnicodeEncodeError as error:
        raise ModelError("PHYSICS_FAULT", "a URDF that is no text") from error
    root = tree(content)
    if root.tag != "robot":
        refuse("a URDF that describes no robot")
    root = without_vocabularies(root, () if outfit is None else outfit.vocabularies_left_out)
    if outfit is not None:
        root = _without(root, outfit.left_out)
    _none_follows(root)
    members(root, attributes={"name"}, optional={"version"}, children=("link", "joint", *UNREAD))
    version = root.attributes.get("version", VERSIONS[0])
    if version not in VERSIONS:
        refuse("a URDF of another version")
    read = partial(_link, capsules=version >= CAPSULES_FROM, meshes=meshes)
    links = [read(e) for e in root.children if e.tag == "link"]
    joints = [_joint(e, outfit) for e in root.children if e.tag == "joint"]
    by_name = {link.name: link for link in links}, {joint.name: joint for joint in joints}
    if (len(by_name[0]), len(by_name[1])) != (len(links), len(joints)):
        refuse("a URDF with a name twice")
    return Description(name_of(root), *by_name, hashlib.sha256(content).hexdigest())


def _without(root: Element, left_out: Sequence[str]) -> Element:
    """The file without these joints and all that hangs on them."""
    joints = {e.attributes.get("name", ""): e for e in root.children if e.tag == "joint"}
    ends = {name: tuple(_end(e, tag) for tag in ("parent", "child")) for name, e in joints.items()}
    gone: set[str] = set()
    links: set[str] = set()
    for name in left_out:
        if name not in joints:
            refuse(f"left_out: {name[:SHOWN]} is no joint of the file; it has {', '.join(sorted(joints))[:LISTED]}")
        gone.add(name)
        links.add(ends[name][1])
    while more := {name for name, (parent, _) in ends.items() if parent in links} - gone:
        gone |= more
        links |= {ends[name][1] for name in more}
    kept = [
        e
        for e in root.children
        if not (e.tag == "joint" and e.attributes.get("name") in gone)
        and not (e.tag == "link" and e.attributes.get("name") in links)
    ]
    return Element(root.tag, root.attributes, kept)


def _end(joint: Element, tag: str) -> str:
    return needed(joint, tag).attributes.get("link", "")


def _none_follows(root: Element) -> None:
    """Refuses joints that mimic others, all by name."""
    names = [e.attributes.get("name", "") for e in root.children if e.tag == "joint" and only(e, "mimic") is not None]
    if names:
        refuse(
            f"{', '.join(names)[:LISTED]}: joints that mimic others; if they are a gripper's, name the joint at which "
            "it begins in the outfit's left_out, and state it as a tool"
        )


def _pose(element: Element) -> Pose:
    origin = only(element, "origin")
    if origin is None:
        return Pose()
    members(origin, optional={"xyz", "rpy"})
    xyz, rpy = (vector(origin, n) if n in origin.attributes else (0.0, 0.0, 0.0) for n in ("xyz", "rpy"))
    return Pose(xyz, rpy)


def _link(element: Element, *, capsules: bool, meshes: bool) -> Link:
    members(element, attributes={"name"}, children=("inertial", "visual", "collision"))
    name = name_of(element)
    shapes = []
    for collision in (child for child in element.children if child.tag == "collision"):
        members(collision, optional={"name"}, children=("origin", "geometry"))
        shapes.append((_pose(collision), _shape(needed(collision, "geometry"), name, capsules=capsules, meshes=meshes)))
    inertial = only(element, "inertial")
    return Link(name, tuple(shapes), None if inertial is None else _inertial(inertial))


def _shape(geometry: Element, link: str, *, capsules: bool, meshes: bool) -> Shape | UrdfMesh:
    members(geometry, children=("box", "sphere", "cylinder", "capsule", "mesh"))
    if len(geometry.children) != 1:
        refuse(f"{link}: exactly one shape in each <geometry>")
    (shape,) = geometry.children
    match shape.tag:
        case "box":
            members(shape, attributes={"size"})
            size = vector(shape, "size")
            if not min(size) > 0:
                refuse(f"{link}: a box without inside")
            return UrdfBox(size)
        case "sphere":
            members(shape, attributes={"radius"})
            return UrdfSphere(positive(shape, "radius"))
        case "cylinder" | "capsule":
            rounded = shape.tag == "capsule"
            if rounded and not capsules:
                refuse(f'{link}: a capsule counts from version="{CAPSULES_FROM}" on; other readers drop it here')
            members(shape, attributes={"radius", "length"})
            return UrdfCylinder(positive(shape, "radius"), positive(shape, "length"), rounded)
        case _:
            if not meshes:
                refuse(f"{link}: a mesh; enclose it in capsules with `ztpm robot fit`")
            members(shape, attributes={"filename"}, optional={"scale"})
            scale = vector(shape, "scale") if "scale" in shape.attributes else (1.0, 1.0, 1.0)
            if not min(scale) > 0:
                refuse(f"{link}: a mesh turned inside out by its scale")
            return UrdfMesh(shape.attributes["filename"], scale)


def _inertial(element: Element) -> Inertial:
    members(element, children=("origin", "mass", "inertia"))
    mass, inertia = needed(element, "mass"), needed(element, "inertia")
    members(mass, attributes={"value"})
    members(inertia, attributes={"ixx", "ixy", "ixz", "iyy", "iyz", "izz"})
    mass_kg = number(mass, "value")
    if not mass_kg >= 0:
        refuse("<mass>: value")
    xx, xy, xz, yy, yz, zz = (number(inertia, n) for n in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    return Inertial(_pose(element), mass_kg, (xx, xy, xz, yy, yz, zz))


def _joint(element: Element, outfit: Outfit | None) -> UrdfJoint:
    read, unread = ("origin", "parent", "child", "axis", "limit"), ("dynamics", "calibration", "safety_controller")
    members(element, attributes={"name", "type"}, children=(*read, *unread))
    name, kind = name_of(element), element.attributes["type"]
    if kind not in ("revolute", "continuous", "fixed"):
        refuse(
            f"{name}: a joint that neither turns nor is fixed; if it is a gripper's, name it in the outfit's left_out"
        )
    stated = None if outfit is None else outfit.range_of(name)
    if kind == "continuous" and stated is None:
        refuse(f"{name}: it turns without end; state its range in the outfit's ranges (joint, low_rad, high_rad)")
    ends = []
    for tag in ("parent", "child"):
        end = needed(element, tag)
        members(end, attributes={"link"})
        ends.append(name_of(end, "link"))
    parent, child = ends
    pose, axis = _pose(element), _axis(element)
    if kind == "fixed":
        return UrdfJoint(name, parent, child, pose, axis, None)
    limit = needed(element, "limit")
    ends_of_range = {"lower", "upper"}
    if kind == "continuous":  # the format says that a range there means nothing
        members(limit, attributes={"velocity", "effort"}, optional=ends_of_range)
    else:
        members(limit, attributes={*ends_of_range, "velocity", "effort"})
    speed, torque = positive(limit, "velocity"), positive(limit, "effort")
    if stated is None:
        limits = UrdfLimits(number(limit, "lower"), number(limit, "upper"), speed, torque)
    else:
        limits = UrdfLimits(stated.low_rad, stated.high_rad, speed, torque, stated=True)
        if kind == "revolute" and not number(limit, "lower") <= limits.low_rad <= limits.high_rad <= number(
            limit, "upper"
        ):
            refuse(f"{name}: the outfit's range is wider than the file's")
    return UrdfJoint(name, parent, child, pose, axis, limits)


def _axis(element: Element) -> Vector:
    """The axis, of length 1; x where the file states none, as the format has it."""
    axis = only(element, "axis")
    if axis is None:
        return (1.0, 0.0, 0.0)
    members(axis, attributes={"xyz"})
    x, y, z = vector(axis, "xyz")
    length = math.hypot(x, y, z)
    if not AXIS_LENGTHS[0] <= length <= AXIS_LENGTHS[1]:
        refuse(f"{element.attributes['name'][:SHOWN]}: an axis without direction")
    return x / length, y / length, z / length
