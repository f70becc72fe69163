"""Held object: as a body of the robot, as the sensors see it, and as a guess from their view.

A held object moves with the arm, so it is no obstacle but a part of it: a capsule or ball in the flange's frame, with
its mass. Sightings of it where it is held are not counted twice; sightings elsewhere are.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, assert_never

import numpy as np

from pep.pit.geometry.clearance import core_distance, segment_segment
from pep.pit.geometry.solids import cores_of, rotation_of
from pep.pit.robot.enclosing_capsule import capsule_around_points
from pep.pit.robot.gripped_object import GrippedObject
from pep.pit.robot.kinematics import link_frames
from pep.pit.scene.scene import Box, Capsule, Convex, Sphere

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.pit.base.motion import Floats, Joints
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters, Part
    from pep.pit.scene.scene import Scene, Shape, Thing, Vector


def unknown_part(robot: Robot, cell: CellParameters) -> GrippedObject:
    """Body for a held object that nothing is known of: the whole payload, about the tip."""
    return GrippedObject("", Sphere(robot.tool.tcp_m, cell.unknown_part_m), None)


def declared_part(robot: Robot, cell: CellParameters, part: Part) -> GrippedObject:
    """Body for a known part that nobody has seen in the gripper.

    It has the part's mass, in a ball about its centre that holds an unknown part at the tip.
    """
    centre = part.centre_m or robot.tool.tcp_m
    radius_m = cell.unknown_part_m + math.dist(centre, robot.tool.tcp_m)
    return GrippedObject(part.object, Sphere(centre, radius_m), part.mass_kg, part.blunt).checked()


def gripped(robot: Robot, q: Joints, objects: Iterable[Thing], cell: CellParameters) -> GrippedObject | None:
    """The one object that is between the fingers, as held; None when there is none or more than one.

    What several sensors show under one name is one object: the held body contains every sight of it.

    Args:
        robot: the arm, holding nothing yet.
        q: measured joint angles, rad.
        objects: as the sensors show them in the base frame at that configuration; not the surveyed ones, which nobody
            lifts, though the fingers may be near them.
        cell: distance that counts as near, and known properties of parts.

    None is to be treated as `unknown_part`: the gripper says that it holds something.
    """
    rotation, origin = _flange(robot, q)
    x, y, z = robot.tool.tcp_m
    pads = np.array([(x, y, z - robot.tool.pad_m), (x, y, z)]) @ rotation.T + origin
    near: list[Thing] = []
    for thing in objects:
        cores, radius = cores_of([thing.shape])
        distance, _ = core_distance(pads[None], cores)
        if float(distance[0] - radius[0]) <= cell.grip_reach_m + thing.uncertainty_m:
            near.append(thing)
    if len({thing.id for thing in near}) != 1:
        return None
    thing, *others = near
    a, b, radius_m = _capsule_around(thing.shape)
    # Where it was seen, give or take: the ball of the uncertainty around every point of it.
    sights_m = [_outermost(other.shape, np.array([a, b])) + other.uncertainty_m for other in others]
    radius_m = max([radius_m + thing.uncertainty_m, *sights_m])
    start, end = (_vector((point - origin) @ rotation) for point in (a, b))
    if any(sight.age_s > cell.perception_age_limit_s for sight in near):
        return None  # where it was so long ago is not where it is gripped
    known = next((part for part in cell.parts if part.object == thing.id), None)
    return GrippedObject(
        object=thing.id,
        shape=Sphere(start, radius_m) if start == end else Capsule(start, end, radius_m),
        mass_kg=None if known is None else known.mass_kg,
        blunt=known is not None and known.blunt,
    ).checked()


def without_held(scene: Scene, robot: Robot, q: Joints, *, tolerance_m: float) -> Scene:
    """The scene without the held object, where it is seen in the gripper of the arm at `q`.

    Seen there means: no point of the seen shape is more than `tolerance_m` outside the held one. The same object seen
    elsewhere stays an obstacle: then one of the two is wrong, and both count.
    """
    held = robot.held
    if held is None or not any(thing.id == held.object for thing in scene.objects):
        return scene
    rotation, origin = _flange(robot, q)
    axis = np.array(held.ends_m) @ rotation.T + origin
    limit = held.shape.radius_m + tolerance_m

    def in_the_gripper(thing: Thing) -> bool:
        return thing.id == held.object and _outermost(thing.shape, axis) <= limit

    return replace(scene, objects=tuple(thing for thing in scene.objects if not in_the_gripper(thing)))


def _flange(robot: Robot, q: Joints) -> tuple[Floats, Floats]:
    rotation, origin = link_frames(robot, np.array([q]))
    return rotation[0, -1], origin[0, -1]


def _vector(point: Floats) -> Vector:
    x, y, z = point.tolist()
    return (x, y, z)


def _outermost(shape: Shape, axis: Floats) -> float:
    """Largest distance of any point of the shape from the axis.

    Distance is convex, so it is at an end or a corner.
    """
    match shape:
        case Capsule(a, b, radius):
            points, radius_m = np.array([a, b]), radius
        case Sphere(center, radius):
            points, radius_m = np.array([center]), radius
        case Box(center, half, quaternion):
            corners = np.array(list(product((-1, 1), repeat=3))) * np.array(half)
            points, radius_m = corners @ rotation_of(quaternion).T + np.array(center), 0.0
        case Convex(vertices, radius):
            points, radius_m = np.array(vertices), radius
        case _:
            assert_never(shape)
    count = len(points)
    first, last = (np.tile(end, (count, 1)) for end in axis)
    on_point, on_axis = segment_segment(points, points, first, last)
    return float(np.linalg.norm(on_point - on_axis, axis=1).max()) + radius_m


def _capsule_around(shape: Shape) -> tuple[Floats, Floats, float]:
    """Ends and radius of a capsule that contains the shape."""
    match shape:
        case Capsule(a, b, radius):
            return np.array(a), np.array(b), radius
        case Sphere(center, radius):
            return np.array(center), np.array(center), radius
        case Box(center, half, quaternion):
            order = np.argsort(half)
            longest = int(order[-1])
            way = rotation_of(quaternion)[:, longest] * half[longest]
            middle = np.array(center)
            across = math.hypot(half[int(order[0])], half[int(order[1])])
            return middle - way, middle + way, across
        case Convex(vertices, radius):
            start, end, around = capsule_around_points(np.array(vertices))
            return start, end, around + radius
        case _:
            assert_never(shape)
