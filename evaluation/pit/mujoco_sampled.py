"""Sampling in MuJoCo at the same instants: every pair by `mj_geomDistance`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.harness.absent import package
from pep.pit.scene.scene import Box, Capsule, Convex, Sphere

if TYPE_CHECKING:
    from evaluation.pit.question import Question
    from pep.pit.base.motion import Floats
    from pep.pit.scene.scene import Shape, Vector

NAME: Final = "MuJoCo"
FARTHEST_M: Final = 10.0
_LENGTHLESS_M: Final = 1e-9


class SampledByMujoco:
    """The pairs of one question among MuJoCo's geoms."""

    def __init__(self, question: Question) -> None:
        """Built once.

        Raises:
            AbsentError: without MuJoCo.
        """
        self._mj, _ = package("mujoco", "mujoco")
        mj, robot = self._mj, question.robot
        self._spec = spec = mj.MjSpec()
        self._rounded: dict[str, float] = {}
        links = [spec.worldbody]
        for joint, rotation in zip(robot.model.joints, robot.rotations, strict=True):
            turn = np.zeros(4)
            mj.mju_mat2Quat(turn, np.ascontiguousarray(rotation).flatten())
            link = links[-1].add_body(pos=joint.offset_m, quat=turn)
            link.add_joint(type=mj.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
            link.mass, link.inertia, link.explicitinertial = 1.0, [1.0, 1.0, 1.0], True
            links.append(link)
        for capsule in robot.capsules:
            self._round(links[capsule.link], capsule.name, capsule.a_m, capsule.b_m, capsule.radius_m)
        scene = question.scene
        shapes = [shape for person in scene.people for _, shape in person.regions] + list(scene.solid_shapes)
        for k, shape in enumerate(shapes):
            self._thing(spec.worldbody, f"/{k}", shape)
        self._model = spec.compile()
        self._state = mj.MjData(self._model)

        def geom(name: str) -> int:
            return int(mj.mj_name2id(self._model, mj.mjtObj.mjOBJ_GEOM, name))

        moving = robot.bodies[: robot.world_bodies]
        # MuJoCo's meshes have no rounding: the missing radius stands beside each pair.
        self._pairs = [
            (geom(body.name), geom(f"/{k}"), self._rounded.get(f"/{k}", 0.0))
            for k in range(len(shapes))
            for body in moving
        ]
        own = ((geom(capsule.name), geom(robot.bodies[index].name)) for index, capsule in robot.self_pairs)
        self._pairs += [(inner, outer, 0.0) for inner, outer in own]

    def _round(self, parent: Any, name: str, a: Vector, b: Vector, radius: float) -> None:
        kinds = self._mj.mjtGeom
        if np.linalg.norm(np.array(b) - np.array(a)) <= _LENGTHLESS_M:
            parent.add_geom(name=name, type=kinds.mjGEOM_SPHERE, size=[radius, 0, 0], pos=a)
        else:
            parent.add_geom(name=name, type=kinds.mjGEOM_CAPSULE, size=[radius, 0, 0], fromto=[*a, *b])

    def _thing(self, parent: Any, name: str, shape: Shape) -> None:
        match shape:
            case Box(center, half, quaternion):
                box = self._mj.mjtGeom.mjGEOM_BOX
                parent.add_geom(name=name, type=box, size=half, pos=center, quat=quaternion)
            case Sphere(center, radius):
                self._round(parent, name, center, center, radius)
            case Capsule(a, b, radius):
                self._round(parent, name, a, b, radius)
            case Convex(vertices, radius):
                mesh = self._mj.mjtGeom.mjGEOM_MESH
                self._spec.add_mesh(name=name, uservert=np.array(vertices).ravel())
                parent.add_geom(name=name, type=mesh, meshname=name)
                self._rounded[name] = radius

    def least(self, angles: list[Floats]) -> float:
        """Least clearance of any pair at any of these configurations, metre; this call is timed."""
        mj, model, state, least = self._mj, self._model, self._state, FARTHEST_M
        for q in angles:
            state.qpos[:] = q
            mj.mj_kinematics(model, state)
            least = min(
                least, *(mj.mj_geomDistance(model, state, a, b, FARTHEST_M, None) - out for a, b, out in self._pairs)
            )
        return least
