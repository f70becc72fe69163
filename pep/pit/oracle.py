"""The second engine: pinocchio moves the arm, coal measures, and the certified answer has to hold for what they say.

It shares with the kernel the model file, the scene and the index functions, and nothing else: not the kinematics, not
the distances, not the speeds, not the profile's form. All pairs are asked at the witness and at a few configurations
that nobody can foresee (seeded by the command's digest). Cores have radius 0 here, and meeting cores count as 0 apart:
penetration depth differs between engines.

Never ask coal's broad-phase for a distance: in 3.0.3 it is wrong for capsules and spheres (a regression test watches
the cause).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, assert_never

import coal
import numpy as np
import pinocchio

from pep.pit.certify import VIOLATION_RESOLUTION_M
from pep.pit.scene import Box, Capsule, Sphere
from pep.pit.solids import rotation_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.certify import Certified, Witness
    from pep.pit.motion import Floats, Profile
    from pep.pit.pairs import Pairs
    from pep.pit.path import Path
    from pep.pit.robot import Robot
    from pep.pit.scene import Scene, Shape, Vector
    from pep.pit.separation import Stopping

INTERIOR: Final = 3  # configurations besides the witness
DISTANCE_TOLERANCE_M: Final = 5e-6  # coal's GJK stops at 1e-6; five times that is given
SPEED_TOLERANCE_M_S: Final = 1e-6  # rounding of two ways to the same velocity
INDEX_TOLERANCE: Final = 1e-6  # rounding of the index functions
POINT_M: Final = 1e-9  # an axis shorter than this is a point
SEED_BYTES: Final = 8  # per configuration
_Z: Final = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class Disagreement:
    """What the second engine found that cannot be if the first is right."""

    what: str


@dataclass(frozen=True, slots=True)
class Agreement:
    """The second engine found nothing above the certified answer.

    Attributes:
        asked: how many configurations it was asked at.
        highest: the highest index it found.
    """

    asked: int
    highest: float


def cross_check(
    path: Path,
    pairs: Pairs,
    scene: Scene,
    profile: Profile,
    stop: Stopping,
    *,
    certified: Certified,
    rows: NDArray[np.intp],
    seed: bytes,
) -> Agreement | Disagreement:
    """Ask pinocchio and coal about every pair at the witnesses and at the seeded configurations.

    Args:
        path: the joint path.
        pairs: what could meet what; of it only the laws are used.
        scene: the same scene, from which coal's geometry is built anew.
        profile: the path's timing.
        stop: how the motion ends when it must.
        certified: the answer in question.
        rows: the pairs that `certified` speaks of.
        seed: digest of the command.
    """
    world = _World(path.robot, scene, pairs)
    watched: list[Witness] = list(certified.witnesses[:1])
    watched += certified.violated.values()
    every = np.arange(len(pairs))
    for witness in watched:
        clearance, speed = world.ask(path, *profile.at(profile.time_of(witness.s)))
        kernel = path.clearance_at(pairs, witness.key, every)
        kernel[witness.pair] = witness.clearance_m
        if not (np.abs(clearance - kernel) <= DISTANCE_TOLERANCE_M).all():
            return Disagreement("clearance at the witness")
        if witness.index > 0 and not abs(speed[witness.pair] - witness.speed_m_s) <= SPEED_TOLERANCE_M_S:
            return Disagreement("speed at the witness")
    times = [profile.time_of(w.s) for w in watched] + [f * profile.duration_s for f in _fractions(seed)]
    highest = 0.0
    for time_s in times:
        clearance, speed = world.ask(path, *profile.at(time_s))
        index = pairs.index(rows, clearance[rows] + DISTANCE_TOLERANCE_M, speed[rows], stop)
        highest = max(highest, float(index.max(initial=0)))
        if not highest <= certified.upper + INDEX_TOLERANCE:
            return Disagreement("index above the certified one")
        deepest = clearance[rows] + DISTANCE_TOLERANCE_M + VIOLATION_RESOLUTION_M
        below = deepest < pairs.violated_below[rows]
        if any(pairs.kind_of(int(row)) not in certified.violated for row in rows[below]):
            return Disagreement("a violation that was not found")
    return Agreement(len(times), highest)


def cross_check_rest(path: Path, pairs: Pairs, scene: Scene, clearance: Floats) -> Agreement | Disagreement:
    """Ask coal about every pair at the start of the path, where the kernel found `clearance`."""
    found, _ = _World(path.robot, scene, pairs).ask(path, 0.0, 0.0)
    if not (np.abs(found - clearance) <= DISTANCE_TOLERANCE_M).all():
        return Disagreement("clearance at rest")
    return Agreement(1, 0.0)


def _fractions(seed: bytes) -> list[float]:
    """Times as fractions of the motion, from the seed."""
    stream = hashlib.sha256(b"interior" + seed).digest()
    words = [stream[k * SEED_BYTES : (k + 1) * SEED_BYTES] for k in range(INTERIOR)]
    return [int.from_bytes(word) / 256**SEED_BYTES for word in words]  # 256: values of a byte


def _placement(a: Vector, b: Vector) -> tuple[Any, float]:
    """Pose whose z axis runs along ab through its middle, and the length of ab."""
    start, end = np.array(a), np.array(b)
    way = end - start
    length = float(np.linalg.norm(way))
    if length <= POINT_M:
        return pinocchio.SE3(np.eye(3), (start + end) / 2), 0.0
    turn = pinocchio.Quaternion.FromTwoVectors(_Z, way)
    return pinocchio.SE3(turn.toRotationMatrix(), (start + end) / 2), length


@lru_cache(maxsize=1024)  # a robot and its cell many times over; people move and drop out
def _core(shape: Shape) -> tuple[Any, Any, float]:
    """Coal's shape of radius 0, its pose, and the radius that is left out."""
    match shape:
        case Capsule(a, b, radius):
            pose, length = _placement(a, b)
            return (coal.Capsule(0.0, length) if length > 0 else coal.Sphere(0.0)), pose, radius
        case Sphere(center, radius):
            return coal.Sphere(0.0), pinocchio.SE3(np.eye(3), np.array(center)), radius
        case Box(center, half, quaternion):
            pose = pinocchio.SE3(rotation_of(quaternion), np.array(center))
            return coal.Box(*(2 * h for h in half)), pose, 0.0
        case _:
            assert_never(shape)


class _World:
    """Robot and scene for pinocchio and coal; its pairs stand in the order of `Pairs`."""

    def __init__(self, robot: Robot, scene: Scene, pairs: Pairs) -> None:
        self.robot, self.scene, self.pairs = robot, scene, pairs
        model = robot.pinocchio
        geometry = pinocchio.GeometryModel()
        on_robot: dict[str, int] = {}
        for capsule in robot.capsules:
            shape, pose, _ = _core(Capsule(capsule.a_m, capsule.b_m, capsule.radius_m))
            on_robot[capsule.name] = geometry.addGeometryObject(
                pinocchio.GeometryObject(capsule.name, capsule.link, pose, shape)
            )
        moving = [on_robot[b.name] for b in robot.bodies[: robot.world_bodies]]
        shapes: list[Shape] = [s for person in scene.people for _, s in person.regions]
        shapes += scene.solid_shapes
        radius: list[float] = []
        for number, each in enumerate(shapes):
            shape, pose, left_out = _core(each)
            at = geometry.addGeometryObject(pinocchio.GeometryObject(f"scene{number}", 0, pose, shape))
            for mover in moving:
                geometry.addCollisionPair(pinocchio.CollisionPair(mover, at))
            radius += [left_out + b.radius_m for b in robot.bodies[: robot.world_bodies]]
        for body_index, capsule in robot.self_pairs:
            body = robot.bodies[body_index]
            geometry.addCollisionPair(pinocchio.CollisionPair(on_robot[capsule.name], on_robot[body.name]))
            radius.append(capsule.radius_m + body.radius_m)
        self.radius = np.array(radius)
        self.geometry, self.geometry_data = geometry, geometry.createData()
        self.model, self.data = model, model.createData()
        self.ends = np.array([(b.a_m, b.b_m) for b in robot.bodies])
        self.link = [b.link for b in robot.bodies]
        self.reference = [b.reference for b in robot.bodies]
        self.body_radius = np.array([b.radius_m for b in robot.bodies])

    def ask(self, path: Path, s: float, rate: float) -> tuple[Floats, Floats]:
        """Signed clearance and surface speed of every pair at path parameter `s` when it grows at `rate`."""
        q = path.q(s)
        pinocchio.forwardKinematics(self.model, self.data, q, path.delta * rate)
        pinocchio.computeDistances(self.model, self.data, self.geometry, self.geometry_data, q)
        core = np.array([r.min_distance for r in self.geometry_data.distanceResults])
        clearance = np.maximum(core, 0) - self.radius
        ends, speed = self._motion()
        workspace = self.scene.workspace
        if workspace is not None:
            bodies = slice(0, self.robot.world_bodies)
            room = [np.array(workspace.high_m) - ends[bodies].max(axis=1), ends[bodies].min(axis=1) - workspace.low_m]
            faces = [room[side][:, axis] - self.body_radius[bodies] for axis in range(3) for side in (0, 1)]
            clearance = np.concatenate([clearance, *faces])
        return clearance, speed[self.pairs.body]

    def _motion(self) -> tuple[Floats, Floats]:
        """World positions of all bodies' ends and surface speeds relative to their reference links, by pinocchio."""
        rotation = np.array([m.rotation for m in self.data.oMi])
        origin = np.array([m.translation for m in self.data.oMi])
        linear = np.einsum("kij,kj->ki", rotation, np.array([v.linear for v in self.data.v]))
        angular = np.einsum("kij,kj->ki", rotation, np.array([v.angular for v in self.data.v]))
        link, reference = self.link, self.reference
        ends = np.einsum("bij,bej->bei", rotation[link], self.ends) + origin[link][:, None]

        def velocity(of: list[int]) -> Floats:
            arm = ends - origin[of][:, None]
            return np.asarray(linear[of][:, None] + np.cross(angular[of][:, None], arm))

        relative = velocity(link) - velocity(reference)
        spin = np.linalg.norm(angular[link] - angular[reference], axis=1)
        return ends, np.linalg.norm(relative, axis=2).max(axis=1) + self.body_radius * spin
