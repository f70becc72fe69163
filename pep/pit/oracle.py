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
import threading
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
    from collections.abc import Sequence

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
    world = World(path.robot, scene, pairs)
    watched: list[Witness] = [*certified.witnesses[:1], *certified.violated.values()]
    times = [profile.time_of(w.s) for w in watched] + [f * profile.duration_s for f in fractions(seed)]
    places = [profile.at(time_s) for time_s in times]
    clearance, speed = world.ask_all([(path.q(s), path.delta * rate) for s, rate in places])
    every = np.arange(len(pairs))
    for witness, measured, moving in zip(watched, clearance, speed, strict=False):
        kernel = path.clearance_at(pairs, witness.key, every)
        kernel[witness.pair] = witness.clearance_m
        if not (np.abs(measured - kernel) <= DISTANCE_TOLERANCE_M).all():
            return Disagreement("clearance at the witness")
        if witness.index > 0 and not abs(moving[witness.pair] - witness.speed_m_s) <= SPEED_TOLERANCE_M_S:
            return Disagreement("speed at the witness")
    return judged(pairs, stop, certified, rows, clearance=clearance[:, rows], speed=speed[:, rows])


def judged(
    pairs: Pairs, stop: Stopping, certified: Certified, rows: NDArray[np.intp], *, clearance: Floats, speed: Floats
) -> Agreement | Disagreement:
    """Whether the certified answer holds for what was measured of `rows`, both of shape (places, rows)."""
    asked = np.tile(rows, len(clearance))
    near = clearance.ravel() + DISTANCE_TOLERANCE_M
    highest = float(pairs.index(asked, near, speed.ravel(), stop).max(initial=0))
    if not highest <= certified.upper + INDEX_TOLERANCE:
        return Disagreement("index above the certified one")
    below = near + VIOLATION_RESOLUTION_M < pairs.violated_below[asked]
    if any(pairs.kind_of(int(row)) not in certified.violated for row in asked[below]):
        return Disagreement("a violation that was not found")
    return Agreement(len(clearance), highest)


def cross_check_rest(path: Path, pairs: Pairs, scene: Scene, clearance: Floats) -> Agreement | Disagreement:
    """Ask coal about every pair at the start of the path, where the kernel found `clearance`."""
    found, _ = World(path.robot, scene, pairs).ask(path.q(0.0), np.zeros_like(path.delta))
    if not (np.abs(found - clearance) <= DISTANCE_TOLERANCE_M).all():
        return Disagreement("clearance at rest")
    return Agreement(1, 0.0)


def fractions(seed: bytes) -> list[float]:
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


@dataclass(frozen=True, slots=True)
class _Core:
    """A shape of radius 0 for coal: its kind and size, its pose, and the radius that is left out."""

    kind: str
    size: tuple[float, ...]
    pose: Any
    radius: float

    def built(self) -> Any:
        """A shape of coal's of this kind and size."""
        match self.kind:
            case "capsule":
                return coal.Capsule(0.0, 2 * self.size[0])
            case "point":
                return coal.Sphere(0.0)
            case _:
                return coal.Box(*(2 * half for half in self.size))

    def put_into(self, body: Any) -> None:
        """The body of the same kind has this size and pose from now on."""
        body.placement = self.pose
        match self.kind:
            case "capsule":
                body.geometry.halfLength = self.size[0]
            case "box":
                body.geometry.halfSide = np.array(self.size)
            case _:
                pass


@lru_cache(maxsize=1024)  # a robot and its cell many times over; people move and drop out
def _core(shape: Shape) -> _Core:
    match shape:
        case Capsule(a, b, radius):
            pose, length = _placement(a, b)
            return _Core("capsule" if length > 0 else "point", (0.5 * length,), pose, radius)
        case Sphere(center, radius):
            return _Core("point", (), pinocchio.SE3(np.eye(3), np.array(center)), radius)
        case Box(center, half, quaternion):
            return _Core("box", half, pinocchio.SE3(rotation_of(quaternion), np.array(center)), 0.0)
        case _:
            assert_never(shape)


@dataclass(frozen=True, slots=True, eq=False)
class _Stage:
    """Coal's bodies and pairs for one robot and so many things of these kinds; where the things are changes.

    Attributes:
        geometry, found: pinocchio's geometry model and its data.
        data: pinocchio's kinematic data.
        things: index of each thing's body.
        own_radius: radii of the arm's own pairs, which stand last.
        link, reference, ends, radius: of the robot's bodies.
    """

    geometry: Any
    found: Any
    data: Any
    things: tuple[int, ...]
    own_radius: Floats
    link: NDArray[np.intp]
    reference: NDArray[np.intp]
    ends: Floats
    radius: Floats


def _built(robot: Robot, kinds: tuple[str, ...]) -> _Stage:
    geometry = pinocchio.GeometryModel()

    def added(name: str, link: int, core: _Core) -> int:
        return int(geometry.addGeometryObject(pinocchio.GeometryObject(name, link, core.pose, core.built())))

    on_robot = {
        capsule.name: added(capsule.name, capsule.link, _core(Capsule(capsule.a_m, capsule.b_m, capsule.radius_m)))
        for capsule in robot.capsules
    }
    moving = [on_robot[b.name] for b in robot.bodies[: robot.world_bodies]]
    unplaced = {"capsule": (1.0,), "point": (), "box": (1.0, 1.0, 1.0)}
    things = tuple(
        added(f"thing{k}", 0, _Core(kind, unplaced[kind], pinocchio.SE3.Identity(), 0.0))
        for k, kind in enumerate(kinds)
    )
    for thing in things:
        for mover in moving:
            geometry.addCollisionPair(pinocchio.CollisionPair(mover, thing))
    own: list[float] = []
    for body_index, capsule in robot.self_pairs:
        body = robot.bodies[body_index]
        geometry.addCollisionPair(pinocchio.CollisionPair(on_robot[capsule.name], on_robot[body.name]))
        own.append(capsule.radius_m + body.radius_m)
    return _Stage(
        geometry=geometry,
        found=geometry.createData(),
        data=robot.pinocchio.createData(),
        things=things,
        own_radius=np.array(own),
        link=np.array([b.link for b in robot.bodies]),
        reference=np.array([b.reference for b in robot.bodies]),
        ends=np.array([(b.a_m, b.b_m) for b in robot.bodies]),
        radius=np.array([b.radius_m for b in robot.bodies]),
    )


class _Stages(threading.local):
    """One set of stages per thread: a stage is changed by each question."""

    def __init__(self) -> None:
        self.of = lru_cache(maxsize=16)(_built)  # people come and go: a handful of kinds in a cell


_STAGES: Final = _Stages()


class World:
    """Robot and scene for pinocchio and coal; its pairs stand in the order of `Pairs`."""

    def __init__(self, robot: Robot, scene: Scene, pairs: Pairs) -> None:
        self.robot, self.scene, self.pairs = robot, scene, pairs
        cores = [_core(shape) for person in scene.people for _, shape in person.regions]
        cores += [_core(shape) for shape in scene.solid_shapes]
        self.stage = _STAGES.of(robot, tuple(core.kind for core in cores))
        for core, body in zip(cores, self.stage.things, strict=True):
            core.put_into(self.stage.geometry.geometryObjects[body])
        moving = self.stage.radius[: robot.world_bodies]
        left_out = np.array([core.radius for core in cores])
        self.radius = np.concatenate([(left_out[:, None] + moving).ravel(), self.stage.own_radius])

    def ask(self, q: Floats, qd: Floats) -> tuple[Floats, Floats]:
        """Signed clearance and surface speed of every pair at joint angles `q` (6,), rad, and speeds `qd`, rad/s."""
        clearance, speed = self.ask_all([(q, qd)])
        return clearance[0], speed[0]

    def ask_all(self, places: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
        """The same at several joint angles and speeds: clearance and speed, each of shape (places, pairs)."""
        model, stage = self.robot.pinocchio, self.stage
        core, poses, velocities = [], [], []
        for q, qd in places:
            pinocchio.forwardKinematics(model, stage.data, q, qd)
            pinocchio.computeDistances(model, stage.data, stage.geometry, stage.found, q)
            core.append([result.min_distance for result in stage.found.distanceResults])
            poses.append(np.array([frame.homogeneous for frame in stage.data.oMi]))
            # copied at once: they are views of what the next place overwrites
            velocities.append(np.array([velocity.vector for velocity in stage.data.v]))
        ends, speed = self._motion(np.array(poses), np.array(velocities))
        clearance = np.maximum(np.array(core), 0) - self.radius
        workspace = self.scene.workspace
        if workspace is not None:
            bodies = slice(0, self.robot.world_bodies)
            high = np.array(workspace.high_m) - ends[:, bodies].max(axis=2)
            low = ends[:, bodies].min(axis=2) - np.array(workspace.low_m)
            radius = self.stage.radius[bodies]
            faces = [room[:, :, axis] - radius for axis in range(3) for room in (high, low)]
            clearance = np.concatenate([clearance, *faces], axis=1)
        return clearance, speed[:, self.pairs.body]

    def _motion(self, poses: Floats, velocities: Floats) -> tuple[Floats, Floats]:
        """World positions of all bodies' ends and surface speeds relative to their reference links, by pinocchio.

        Args:
            poses: shape (places, links, 4, 4).
            velocities: shape (places, links, 6), linear then angular, in the links' own frames.
        """
        rotation, origin = poses[..., :3, :3], poses[..., :3, 3]
        linear = np.einsum("pkij,pkj->pki", rotation, velocities[..., :3])
        angular = np.einsum("pkij,pkj->pki", rotation, velocities[..., 3:])
        link, reference = self.stage.link, self.stage.reference
        ends = np.einsum("pbij,bej->pbei", rotation[:, link], self.stage.ends) + origin[:, link, None]

        def velocity(of: NDArray[np.intp]) -> Floats:
            arm = ends - origin[:, of, None]
            return np.asarray(linear[:, of, None] + np.cross(angular[:, of, None], arm))

        relative = velocity(link) - velocity(reference)
        spin = np.linalg.norm(angular[:, link] - angular[:, reference], axis=2)
        return ends, np.linalg.norm(relative, axis=3).max(axis=2) + self.stage.radius * spin
