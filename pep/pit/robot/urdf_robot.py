"""Arm of a URDF as a model like the shipped ones: six joints in a row, each about z.

A joint may turn about any axis of its frame, and fixed joints may stand between. Each link gets a frame whose z axis is
that of the joint that carries it, and every number is carried over into it; the last one is the flange's own, which
therefore has to stand on the last axis. Links on fixed joints become one link with the one that carries them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from pep.pit.base.errors import ModelError
from pep.pit.robot.enclosing_capsule import capsule_around
from pep.pit.robot.frames import angles_of, frame_on, inverse, matrix_of, upright, vector_of
from pep.pit.robot.model import JOINTS, SCHEMA, LinkCapsule, Model, RobotJoint, SourceFile, validated
from pep.pit.robot.robot import Robot
from pep.pit.robot.self_clearance import checked, spelled, watched
from pep.pit.robot.urdf import UrdfMesh, described

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from pep.pit.base.motion import Floats
    from pep.pit.robot.mesh_cover import Line
    from pep.pit.robot.outfit import Outfit
    from pep.pit.robot.urdf import Description, Inertial, Link, UrdfJoint, UrdfLimits

CAPSULES: Final = 64  # ours: of the arm; the UR3e has 11
TURN_LIMIT_RAD: Final = 4 * math.pi  # ours: two turns either way; a larger number is in degrees
STATED_LIMIT_RAD: Final = 32 * math.pi  # ours: sixteen turns either way, where a person states them
FLANGE_TOLERANCE_RAD: Final = 1e-5  # ours: angles written with six digits
FLANGE_TOLERANCE_M: Final = 1e-5  # ours: with a tool of 0.3 m both together are 13 um at its end
LEAST_MASS_KG: Final = 1e-3  # ours: a link of an arm that weighs less is in another unit
MOVING: Final = "six moving joints in a row are needed"


def robot_of(urdf: str, outfit: Outfit, *, tool: str) -> Robot:
    """Robot that a URDF and a person's outfit describe, with one of its tools.

    Args:
        urdf: the file's text.
        outfit: the person's outfit of the arm.
        tool: name of one of the outfit's tools.

    Raises:
        ModelError: anything that PHY-42 or PHY-43 refuses; the detail names it.
    """
    model = model_of(described(urdf, outfit), outfit)
    return checked(Robot.from_model(model, tool=tool), spelled(outfit, model.capsules))


Fitter: TypeAlias = "Callable[[str, UrdfMesh, Floats], Iterable[Line]]"
"""Capsules around the mesh of a link, given the mesh's frame in which they are wanted, 4 x 4."""


def model_of(description: Description, outfit: Outfit, fitter: Fitter | None = None) -> Model:
    """Model of the described arm, with all pairs but those that the outfit names.

    Args:
        description: of the arm.
        outfit: the person's outfit of it.
        fitter: encloses meshes; without it there are none.

    Raises:
        ModelError: as above, as far as no sampling is needed.
    """
    fixed, groups = _chain(description, outfit.base)
    frames = [np.eye(4), *(upright(np.array(group.joint.axis)) for group in groups[:-1])]
    frames.append(_flange(groups[-1], outfit.flange))
    capsules = _capsules([fixed, *(group.links for group in groups)], frames, fitter)
    joints = [
        _joint(group, inverse(before) @ group.stands @ frame, inverse(frame))
        for group, (before, frame) in zip(groups, pairwise(frames), strict=True)
    ]
    return validated(
        Model(
            schema=SCHEMA,
            name=description.name,
            payload_limit_kg=outfit.payload_limit_kg,
            acceleration_limit_rad_s2=outfit.acceleration_limit_rad_s2,
            joints=tuple(joints),
            capsules=tuple(capsules),
            self_pairs=watched(capsules, spelled(outfit, capsules)),
            tools=outfit.tools,
            derived_from=(SourceFile("urdf", description.sha256),),
        )
    )


_Placed: TypeAlias = "list[tuple[Link, Floats]]"  # links with their frames in that of their group, 4 x 4


@dataclass(frozen=True, slots=True)
class _Group:
    """Links that move as one.

    Attributes:
        joint: that carries them.
        limits: of the joint.
        stands: the joint's frame in that of the group before, or of the base, 4 x 4.
        links: those that fixed joints hold together; the group's frame is the joint's.
    """

    joint: UrdfJoint
    limits: UrdfLimits
    stands: Floats
    links: _Placed


def _chain(description: Description, base: str) -> tuple[_Placed, list[_Group]]:
    """Fixed links, seen from the one that the controller calls its base, and six groups in a row."""
    links = description.links
    above: dict[str, list[UrdfJoint]] = {name: [] for name in links}
    hanging = set()
    for joint in description.joints.values():
        if joint.parent not in links or joint.child not in links or joint.child in hanging:
            raise ModelError("PHYSICS_FAULT", f"{joint.name}: joins no two links, or one that hangs already")
        above[joint.parent].append(joint)
        hanging.add(joint.child)
    roots = [name for name in links if name not in hanging]
    if len(roots) != 1:
        raise ModelError("PHYSICS_FAULT", "exactly one link must hang on no joint")
    fixed, leaving = _held_together(roots[0], links, above)
    reached = len(fixed)
    groups: list[_Group] = []
    while leaving:
        if len(leaving) > 1 or len(groups) == JOINTS:
            raise ModelError("PHYSICS_FAULT", MOVING)
        joint, limits, stands = leaving[0]
        members, leaving = _held_together(joint.child, links, above)
        groups.append(_Group(joint, limits, stands, members))
        reached += len(members)
    if len(groups) != JOINTS or reached != len(links):  # a ring of links is never reached
        raise ModelError("PHYSICS_FAULT", MOVING)
    back = inverse(_frame_of(base or roots[0], fixed))
    groups[0] = replace(groups[0], stands=back @ groups[0].stands)
    return [(link, back @ frame) for link, frame in fixed], groups


def _held_together(
    root: str, links: Mapping[str, Link], above: Mapping[str, list[UrdfJoint]]
) -> tuple[_Placed, list[tuple[UrdfJoint, UrdfLimits, Floats]]]:
    """Links that fixed joints join to `root`, in its frame, and the moving joints that leave them."""
    members: _Placed = []
    leaving: list[tuple[UrdfJoint, UrdfLimits, Floats]] = []
    waiting = [(root, np.eye(4))]
    while waiting:
        name, frame = waiting.pop()
        members.append((links[name], frame))
        for joint in above[name]:
            at = frame @ matrix_of(joint.pose)
            if joint.limits is None:
                waiting.append((joint.child, at))
            else:
                leaving.append((joint, joint.limits, at))
    return members, leaving


def _frame_of(name: str, placed: _Placed) -> Floats:
    for link, frame in placed:
        if link.name == name:
            return frame
    raise ModelError("PHYSICS_FAULT", f"{name}: no link of this name where it must be")


def _flange(group: _Group, name: str) -> Floats:
    """Frame of the flange in that of the last joint, put exactly onto the joint's axis."""
    frame = _frame_of(name, group.links)
    axis, origin = np.array(group.joint.axis), frame[:3, 3]
    on_axis = (origin @ axis) * axis
    tilt = np.linalg.norm(frame[:3, 2] - axis)
    if not (tilt <= FLANGE_TOLERANCE_RAD and np.linalg.norm(origin - on_axis) <= FLANGE_TOLERANCE_M):
        raise ModelError("PHYSICS_FAULT", f"{name}: the flange must stand on the last axis, z along it")
    return frame_on(axis, frame[:3, 0], on_axis)


def _capsules(groups: list[_Placed], frames: list[Floats], fitter: Fitter | None) -> list[LinkCapsule]:
    """All shapes of all links as capsules, each in the frame of its group's link."""
    found = []
    for k, (placed, frame) in enumerate(zip(groups, frames, strict=True)):
        for link, at in placed:
            into = inverse(frame) @ at
            lines: list[Line] = []
            for pose, shape in link.shapes:
                if isinstance(shape, UrdfMesh):
                    lines += _fitted(link.name, shape, into @ matrix_of(pose), fitter)
                    continue
                a, b, radius_m = capsule_around(pose, shape)
                lines.append((*(into[:3, :3] @ end + into[:3, 3] for end in (a, b)), radius_m))  # type: ignore[arg-type]
            for number, (a, b, radius_m) in enumerate(lines, start=1):
                name = link.name if len(lines) == 1 else f"{link.name}.{number}"
                found.append(LinkCapsule(name, k, vector_of(a), vector_of(b), radius_m))
    if len(found) > CAPSULES:
        raise ModelError("PHYSICS_FAULT", f"more than {CAPSULES} shapes")
    return found


def _fitted(link: str, mesh: UrdfMesh, frame: Floats, fitter: Fitter | None) -> Iterable[Line]:
    if fitter is None:
        raise ModelError("PHYSICS_FAULT", f"{link}: a mesh; enclose it in capsules with `ztpm robot fit`")
    return fitter(link, mesh, frame)


def _joint(group: _Group, stands: Floats, back: Floats) -> RobotJoint:
    limits = group.limits
    most = STATED_LIMIT_RAD if limits.stated else TURN_LIMIT_RAD
    if not max(-limits.low_rad, limits.high_rad) <= most:
        told = f"{group.joint.name}: position limits beyond {most / (2 * math.pi):.0f} turns"
        raise ModelError(
            "PHYSICS_FAULT", f"{told}; are they in degrees? Several turns are stated in the outfit's ranges"
        )
    mass, com, tensor = _mass_of(group, back)
    return RobotJoint(
        name=group.joint.name,
        offset_m=vector_of(stands[:3, 3]),
        rpy_rad=angles_of(stands[:3, :3]),
        position_limit_rad=limits.high_rad,
        speed_limit_rad_s=limits.speed_rad_s,
        torque_limit_nm=limits.torque_nm,
        mass_kg=mass,
        com_m=vector_of(com),
        inertia_kg_m2=vector_of(np.diag(tensor)),
        position_low_rad=limits.low_rad,
        inertia_products_kg_m2=(float(tensor[0, 1]), float(tensor[0, 2]), float(tensor[1, 2])),
    )


def _mass_of(group: _Group, back: Floats) -> tuple[float, Floats, Floats]:
    """Mass, centre of mass and tensor about it of a group's links, in the frame of `back`."""
    parts = [(link.inertial, back @ frame) for link, frame in group.links if link.inertial is not None]
    mass = sum(inertial.mass_kg for inertial, _ in parts)
    if not mass >= LEAST_MASS_KG:
        raise ModelError("PHYSICS_FAULT", f"{group.joint.name}: carries no mass, or one in another unit")
    placed = [(inertial.mass_kg, *_tensor(inertial, frame)) for inertial, frame in parts]
    com = sum((m * at for m, at, _ in placed), np.zeros(3)) / mass
    tensor = np.zeros((3, 3))
    for m, at, own in placed:
        way = at - com
        tensor += own + m * (way @ way * np.eye(3) - np.outer(way, way))  # parallel axes
    return mass, com, tensor


def _tensor(inertial: Inertial, frame: Floats) -> tuple[Floats, Floats]:
    """Centre of mass and tensor about it, in the outer frame of `frame`."""
    at = frame @ matrix_of(inertial.pose)
    xx, xy, xz, yy, yz, zz = inertial.tensor_kg_m2
    turn = at[:3, :3]
    return at[:3, 3], turn @ np.array([(xx, xy, xz), (xy, yy, yz), (xz, yz, zz)]) @ turn.T
