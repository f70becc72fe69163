"""Arm and surroundings as pinocchio's and coal's geometry, built once for a number of things of these kinds."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, Final

import coal
import numpy as np
import pinocchio

from pep.pit.geometry.coal_shapes import Core, core_of
from pep.pit.scene.scene import Capsule

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.geometry.coal_shapes import Kind
    from pep.pit.robot.robot import Robot


GJK_TOLERANCE: Final = 1e-9  # relative: 0.1 um at 100 m, where coal's own 1e-6 is more than engines may differ by


@dataclass(frozen=True, eq=False)
class Stage:
    """Coal's bodies and pairs for one robot and a number of things of these kinds; their poses change.

    Attributes:
        geometry, found: pinocchio's geometry model and its data.
        kinematics: pinocchio's kinematic data.
        distances: of each pair, where coal writes what it found.
        turns, origins: of all links, where pinocchio writes their poses, (links, 3, 3) and (links, 3).
        things: each thing's body, and its shape.
        placed: present meaning of each of these; None while it is half placed.
        own_radius: radii of the arm's own pairs, which stand last.
        own_body, own_link, own_center, own_half: of the arm's own pairs: the moving body, and the capsule it must mind:
            its link, its middle there and half its axis.
        link, reference, ends, radius, half: of the robot's bodies.
        moved_by: 1 where the joint moves the body as seen from its reference link, (bodies, joints).
    """

    geometry: Any
    found: Any
    kinematics: Any
    distances: tuple[Any, ...]
    turns: Floats
    origins: Floats
    things: tuple[tuple[Any, Any], ...]
    placed: list[Core | None]
    own_radius: Floats
    own_body: NDArray[np.intp]
    own_link: NDArray[np.intp]
    own_center: Floats
    own_half: Floats
    link: NDArray[np.intp]
    reference: NDArray[np.intp]
    moved_by: Floats
    ends: Floats
    radius: Floats
    half: Floats

    @cached_property
    def blocks(self) -> tuple[Floats, NDArray[np.int64], Floats, NDArray[np.int64]]:
        """Numbers of all bodies and of the arm's own pairs, in the columns of `pep.pit.second.compiled_sight`."""
        bodies, pairs = len(self.link), len(self.own_radius)
        return (
            np.column_stack([self.ends.reshape(bodies, -1), self.radius, self.half]),
            np.column_stack([self.link, self.reference]).astype(np.int64),
            np.column_stack([self.own_center.reshape(pairs, -1), self.own_half, self.own_radius]),
            np.column_stack([self.own_link, self.own_body]).astype(np.int64).reshape(pairs, -1),
        )

    def put(self, cores: Sequence[Core]) -> None:
        """Puts these things into the scene, without touching the earlier ones."""
        if self.placed == [*cores]:  # each is itself alone
            return
        for k, core in enumerate(cores):
            if self.placed[k] is not core:
                self.placed[k] = None
                core.put_into(*self.things[k])
                self.placed[k] = core


def _in_one(parts: Sequence[Floats]) -> Floats:
    """One array over parts that lie in memory at equal distances.

    No copy, so that it always has the parts' values.

    Raises:
        ValueError: the parts lie otherwise.
    """
    at = [part.ctypes.data for part in parts]
    step, first = at[1] - at[0], parts[0]
    if at != [at[0] + k * step for k in range(len(at))] or any(part.strides != first.strides for part in parts):
        raise ValueError("the parts do not lie at equal distances")
    return np.lib.stride_tricks.as_strided(first, (len(parts), *first.shape), (step, *first.strides), writeable=False)


def _request() -> Any:
    """Request to coal with the same first guess each time; pinocchio's own keep that of the last question.

    With it an answer would depend on what was asked before.
    """
    request = coal.DistanceRequest()
    request.gjk_initial_guess = coal.GJKInitialGuess.DefaultGuess
    request.gjk_tolerance = GJK_TOLERANCE
    return request


def _built(robot: Robot, kinds: tuple[Kind, ...]) -> Stage:
    geometry = pinocchio.GeometryModel()

    def added(name: str, link: int, core: Core) -> int:
        return int(geometry.addGeometryObject(pinocchio.GeometryObject(name, link, core.pose, core.built())))

    on_robot = {
        capsule.name: added(capsule.name, capsule.link, core_of(Capsule(capsule.a_m, capsule.b_m, capsule.radius_m)))
        for capsule in robot.capsules
    }
    moving = [on_robot[b.name] for b in robot.bodies[: robot.world_bodies]]
    unplaced = {"capsule": (1.0,), "point": (), "box": (1.0, 1.0, 1.0), "convex": ()}
    things = tuple(
        added(f"thing{k}", 0, Core(kind, unplaced[kind], pinocchio.SE3.Identity(), 0.0, corners))
        for k, (kind, corners) in enumerate(kinds)
    )
    for thing in things:
        for mover in moving:
            geometry.addCollisionPair(pinocchio.CollisionPair(mover, thing))
    own: list[float] = []
    for body_index, capsule in robot.self_pairs:
        body = robot.bodies[body_index]
        geometry.addCollisionPair(pinocchio.CollisionPair(on_robot[capsule.name], on_robot[body.name]))
        own.append(capsule.radius_m + body.radius_m)
    ends = np.array([(b.a_m, b.b_m) for b in robot.bodies])
    found, kinematics = geometry.createData(), robot.pinocchio.createData()
    for k in range(len(found.distanceRequests)):
        found.distanceRequests[k] = _request()
    inner = np.array([(capsule.a_m, capsule.b_m) for _, capsule in robot.self_pairs])
    return Stage(
        geometry=geometry,
        found=found,
        kinematics=kinematics,
        distances=tuple(found.distanceResults),
        turns=_in_one([frame.rotation for frame in kinematics.oMi]),
        origins=_in_one([frame.translation for frame in kinematics.oMi]),
        things=tuple((body, body.geometry) for body in map(geometry.geometryObjects.__getitem__, things)),
        placed=[None] * len(things),
        own_radius=np.array(own),
        own_body=np.array([index for index, _ in robot.self_pairs], dtype=np.intp),
        own_link=np.array([capsule.link for _, capsule in robot.self_pairs], dtype=np.intp),
        own_center=inner.mean(axis=1),
        own_half=0.5 * np.linalg.norm(inner[:, 1] - inner[:, 0], axis=1),
        link=np.array([b.link for b in robot.bodies]),
        reference=np.array([b.reference for b in robot.bodies]),
        moved_by=np.array(
            [[float(b.reference <= k < b.link) for k in range(len(robot.model.joints))] for b in robot.bodies]
        ),
        ends=ends,
        radius=np.array([b.radius_m for b in robot.bodies]),
        half=0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1),
    )


class _Stages(threading.local):
    """Set of stages for one thread: a stage is changed by each question."""

    def __init__(self) -> None:
        self.of = lru_cache(maxsize=16)(_built)  # people come and go: a handful of kinds in a cell


STAGES: Final = _Stages()
