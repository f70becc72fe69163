"""Motion as instants 8 ms apart, and the measurements of pinocchio and coal there."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, assert_never, cast

import numpy as np

from evaluation.harness.absent import package
from pep.pit.base.motion import (
    BlendedPath,
    GripperMove,
    JointPath,
    JointTrajectory,
    LinePath,
    MoveJ,
    MoveL,
    OutputSet,
    ServoJ,
    SpeedJ,
    SpeedL,
    profile_of,
)
from pep.pit.geometry.hull import hull_of
from pep.pit.scene.scene import Box, Capsule, Convex, Sphere

if TYPE_CHECKING:
    from collections.abc import Iterator

    from evaluation.pit.question import Question
    from pep.pit import Motion, Robot
    from pep.pit.base.motion import Floats, Joints, Pose
    from pep.pit.scene.scene import Shape

STEP_S: Final = 0.008
NAME: Final = "pinocchio and coal"
EXACT: Final = 1e-10
_NEWTON: Final = 30
_LENGTHLESS_M: Final = 1e-9


def pinocchio() -> Any:
    """The library; installed wherever the room is."""
    return package("pinocchio", "pin")[0]


def instants(question: Question) -> list[tuple[Floats, Floats]]:
    """Joint angles and joint speeds every 8 ms of the motion, its end included."""
    return list(_instants(question.robot, question.motion))


def _instants(robot: Robot, motion: Motion) -> Iterator[tuple[Floats, Floats]]:
    match motion:
        case MoveJ():
            profile = profile_of(motion)
            if profile is None:
                raise ValueError("a move that goes nowhere")
            start, delta = np.array(motion.start), np.array(motion.target) - np.array(motion.start)
            for t in _times(profile.duration_s):
                s, rate = profile.at(t)
                yield start + s * delta, rate * delta
        case JointPath():
            at = motion.start
            for leg in motion.legs:
                yield from _instants(robot, MoveJ(at, leg.target, leg.speed_rad_s, leg.acceleration_rad_s2))
                at = leg.target
        case MoveL():
            yield from _along(robot, motion)
        case ServoJ():
            # Beside the rest of the envelope, the arm may at least go on at its speed for a period.
            start, qd = np.array(motion.start), np.array(motion.qd_rad_s)
            for t in (0.0, motion.period_s):
                yield start + t * qd, qd
        case SpeedJ() | SpeedL() | LinePath() | JointTrajectory() | GripperMove() | OutputSet() | BlendedPath():
            raise ValueError("nothing of this is measured")
        case _:
            assert_never(motion)


def _times(duration_s: float) -> list[float]:
    return [*(k * STEP_S for k in range(math.ceil(duration_s / STEP_S))), duration_s]


def _tool(robot: Robot, scratch: Any, q: Floats) -> tuple[Floats, Floats]:
    pin = pinocchio()
    pin.forwardKinematics(robot.pinocchio, scratch, q)
    frame = scratch.oMi[len(robot.model.joints)]
    return frame.act(np.array(robot.tool.tcp_m)), frame.rotation.copy()


def pose_of(robot: Robot, q: Joints) -> Pose:
    """Pose of the tool at these joint angles, by pinocchio."""
    position, rotation = _tool(robot, robot.pinocchio.createData(), np.array(q))
    return cast("Pose", (*position.tolist(), *pinocchio().log3(rotation).tolist()))


def _along(robot: Robot, motion: MoveL) -> Iterator[tuple[Floats, Floats]]:
    """A line that does not turn, by Newton from instant to instant with pinocchio's own Jacobian."""
    pin, scratch, q = pinocchio(), robot.pinocchio.createData(), np.array(motion.start)
    first, rotation = _tool(robot, scratch, q)
    line = np.array(motion.target[:3]) - first
    length = float(np.linalg.norm(line))
    timing = profile_of(MoveJ((0.0,) * 6, (length, *(0.0,) * 5), motion.speed_m_s, motion.acceleration_m_s2))
    if timing is None:
        raise ValueError("a line that goes nowhere")
    for t in _times(timing.duration_s):
        s, rate = timing.at(t)
        for _ in range(_NEWTON):
            position, turned = _tool(robot, scratch, q)
            error = np.concatenate([first + s * line - position, pin.log3(rotation @ turned.T)])
            q = q + np.linalg.solve(_jacobian(robot, scratch, q, turned), error)
            if np.abs(error).max() < EXACT:
                break
        _, turned = _tool(robot, scratch, q)
        yield q, np.linalg.solve(_jacobian(robot, scratch, q, turned), np.concatenate([rate * line, np.zeros(3)]))


def _jacobian(robot: Robot, scratch: Any, q: Floats, rotation: Floats) -> Floats:
    """Velocity of the tool point and of its turning, in the base frame, by joint speeds, (6, 6)."""
    local = pinocchio().computeJointJacobian(robot.pinocchio, scratch, q, len(robot.model.joints))
    linear, angular = rotation @ local[:3], rotation @ local[3:]
    lever = rotation @ np.array(robot.tool.tcp_m)
    return np.concatenate([linear + np.cross(angular.T, lever).T, angular])


class SampledByCoal:
    """Pairs of one question in coal's geometry, shapes with their radii, in the order of `pep.pit.scene.pairs`."""

    def __init__(self, question: Question) -> None:
        """Built once; asking does not change it."""
        pin, robot, scene = pinocchio(), question.robot, question.scene
        self._pin, self._model = pin, robot.pinocchio
        self._kinematics = robot.pinocchio.createData()
        geometry = pin.GeometryModel()

        def added(name: str, link: int, shape: Shape) -> int:
            built, pose = _built(shape)
            return int(geometry.addGeometryObject(pin.GeometryObject(name, link, pose, built)))

        on_robot = {c.name: added(c.name, c.link, Capsule(c.a_m, c.b_m, c.radius_m)) for c in robot.capsules}
        shapes = [shape for person in scene.people for _, shape in person.regions] + list(scene.solid_shapes)
        for k, shape in enumerate(shapes):
            thing = added(f"thing{k}", 0, shape)
            for body in robot.bodies[: robot.world_bodies]:
                geometry.addCollisionPair(pin.CollisionPair(on_robot[body.name], thing))
        for index, capsule in robot.self_pairs:
            geometry.addCollisionPair(pin.CollisionPair(on_robot[capsule.name], on_robot[robot.bodies[index].name]))
        self._geometry, self._found = geometry, geometry.createData()
        self.pairs = len(geometry.collisionPairs)

    def least(self, angles: list[Floats]) -> float:
        """Least clearance of any pair at any of these configurations, metre; this call is timed."""
        measure, model, kinematics = self._pin.computeDistances, self._model, self._kinematics
        geometry, found, least = self._geometry, self._found, math.inf
        for q in angles:
            nearest = measure(model, kinematics, geometry, found, q)
            least = min(least, found.distanceResults[nearest].min_distance)
        return least

    def each(self, angles: list[Floats]) -> Floats:
        """The clearance of every pair at every configuration, (n, pairs)."""
        rows = []
        for q in angles:
            self._pin.computeDistances(self._model, self._kinematics, self._geometry, self._found, q)
            rows.append([result.min_distance for result in self._found.distanceResults])
        return np.array(rows)


def _built(shape: Shape) -> tuple[Any, Any]:
    """The shape in coal, and its pose."""
    pin, coal = pinocchio(), package("coal", "coal")[0]
    match shape:
        case Sphere(center, radius):
            return coal.Sphere(radius), pin.SE3(np.eye(3), np.array(center))
        case Capsule(a, b, radius):
            way = np.array(b) - np.array(a)
            length, middle = float(np.linalg.norm(way)), (np.array(a) + np.array(b)) / 2
            if length <= _LENGTHLESS_M:
                return coal.Sphere(radius), pin.SE3(np.eye(3), middle)
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), way)
            return coal.Capsule(radius, length), pin.SE3(turn.toRotationMatrix(), middle)
        case Box(center, half, (w, x, y, z)):
            turn = pin.Quaternion(w, x, y, z)
            return coal.Box(*(2 * h for h in half)), pin.SE3(turn.toRotationMatrix(), np.array(center))
        case Convex(vertices, radius):
            hull, points, faces = hull_of(vertices), coal.StdVec_Vec3s(), coal.StdVec_Triangle()
            points.extend(list(hull.vertices))
            faces.extend([coal.Triangle(*face) for face in hull.faces.tolist()])
            body = coal.Convex(points, faces)
            body.setSweptSphereRadius(radius)
            return body, pin.SE3.Identity()
        case _:
            assert_never(shape)
