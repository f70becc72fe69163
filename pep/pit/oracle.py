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
import math
import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, TypeAlias, assert_never

import coal
import numpy as np
import pinocchio

from pep.pit.certify import VIOLATION_RESOLUTION_M
from pep.pit.hull import hull_of
from pep.pit.scene import Box, Capsule, Convex, Sphere
from pep.pit.solids import rotation_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from pep.pit.certify import Certified, Witness
    from pep.pit.motion import Floats, Profile
    from pep.pit.pairs import Pairs
    from pep.pit.path import Path
    from pep.pit.robot import Robot
    from pep.pit.scene import Scene, Shape, Vector
    from pep.pit.separation import Stopping

Kind: TypeAlias = "tuple[str, tuple[Vector, ...]]"
"""What coal builds anew for: the kind of a shape, and of a polytope its corners."""

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
    every = np.arange(len(pairs))
    at = [profile.at(profile.time_of(w.s)) for w in watched]
    clearance, speed = world.ask_all([(path.q(s), path.delta * rate) for s, rate in at])
    for witness, measured, moving in zip(watched, clearance, speed, strict=True):
        kernel = path.clearance_at(pairs, witness.key, every)
        kernel[witness.pair] = witness.clearance_m
        if not (np.abs(measured - kernel) <= DISTANCE_TOLERANCE_M).all():
            return Disagreement("clearance at the witness")
        if witness.index > 0 and not abs(moving[witness.pair] - witness.speed_m_s) <= SPEED_TOLERANCE_M_S:
            return Disagreement("speed at the witness")
    known = judged(pairs, stop, certified, rows, clearance=clearance[:, rows], speed=speed[:, rows])
    if isinstance(known, Disagreement):
        return known
    # Nobody can foresee these places. Only what the balls around both do not settle there needs a distance.
    unforeseen = [profile.at(share * profile.duration_s) for share in fractions(seed)]
    places = [(path.q(s), path.delta * rate) for s, rate in unforeseen]
    clearance, speed = world.at_least(
        places, settled=lambda near, moving: _settled(pairs, stop, certified, near, moving)
    )
    found = judged(pairs, stop, certified, rows, clearance=clearance[:, rows], speed=speed[:, rows])
    if isinstance(found, Disagreement):
        return found
    return Agreement(known.asked + found.asked, max(known.highest, found.highest))


def _settled(pairs: Pairs, stop: Stopping, certified: Certified, near: Floats, speed: Floats) -> NDArray[np.bool_]:
    """Which pairs (places, pairs) with a clearance of at least `near` are neither above the answer nor a violation."""
    asked = np.tile(np.arange(len(pairs)), len(near))
    index = pairs.index(asked, near.ravel(), speed.ravel(), stop)
    clear = near.ravel() >= pairs.violated_below[asked]
    return np.asarray((clear & (index <= certified.upper)).reshape(near.shape))


def judged(
    pairs: Pairs, stop: Stopping, certified: Certified, rows: NDArray[np.intp], *, clearance: Floats, speed: Floats
) -> Agreement | Disagreement:
    """Whether the certified answer holds for what was measured of `rows`, both of shape (places, rows)."""
    if not clearance.size:
        return Agreement(0, 0.0)
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
    """A shape of radius 0 for coal: its kind and size, its pose, and the radius that is left out.

    Each set of `corners` is a kind of its own: coal's polytopes keep theirs.
    """

    kind: str
    size: tuple[float, ...]
    pose: Any
    radius: float
    corners: tuple[Vector, ...] = ()

    def built(self) -> Any:
        """A shape of coal's of this kind and size."""
        match self.kind:
            case "capsule":
                return coal.Capsule(0.0, 2 * self.size[0])
            case "point":
                return coal.Sphere(0.0)
            case "convex":
                return _polytope(self.corners)
            case _:
                return coal.Box(*(2 * half for half in self.size))

    @property
    def ball(self) -> tuple[Floats, float]:
        """Centre and radius of a ball around the core."""
        if self.corners:
            corners = np.array(self.corners)
            center = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
            return center, float(np.linalg.norm(corners - center, axis=1).max()) + POINT_M
        return np.array(self.pose.translation), math.hypot(*self.size)

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
        case Convex(vertices, radius):
            return _Core("convex", (), pinocchio.SE3.Identity(), radius, vertices)
        case _:
            assert_never(shape)


@lru_cache(maxsize=1024)  # all that stands in a few cells
def _polytope(corners: tuple[Vector, ...]) -> Any:
    """Coal's body of the same corners.

    It measures by the corners alone; the faces tell it at most which of many corners are neighbours. Its own way to
    faces (`convexHull`) is not used: qhull brings the process down where the corners are all but flat.
    """
    hull = hull_of(corners)
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(hull.vertices))
    faces.extend([coal.Triangle(*face) for face in hull.faces.tolist()])
    return coal.Convex(points, faces)


@dataclass(frozen=True, slots=True, eq=False)
class _Stage:
    """Coal's bodies and pairs for one robot and so many things of these kinds; where the things are changes.

    Attributes:
        geometry, found: pinocchio's geometry model and its data.
        data: pinocchio's kinematic data.
        things: index of each thing's body.
        own_radius: radii of the arm's own pairs, which stand last.
        own_body, own_link, own_center, own_half: of the arm's own pairs: the moving body, and the capsule it must mind:
            its link, its middle there and half its axis.
        link, reference, ends, radius, half: of the robot's bodies.
        holds: the scene whose things stand there.
    """

    geometry: Any
    found: Any
    data: Any
    things: tuple[int, ...]
    own_radius: Floats
    own_body: NDArray[np.intp]
    own_link: NDArray[np.intp]
    own_center: Floats
    own_half: Floats
    link: NDArray[np.intp]
    reference: NDArray[np.intp]
    ends: Floats
    radius: Floats
    half: Floats
    holds: dict[str, Scene]


def _built(robot: Robot, kinds: tuple[Kind, ...]) -> _Stage:
    geometry = pinocchio.GeometryModel()

    def added(name: str, link: int, core: _Core) -> int:
        return int(geometry.addGeometryObject(pinocchio.GeometryObject(name, link, core.pose, core.built())))

    on_robot = {
        capsule.name: added(capsule.name, capsule.link, _core(Capsule(capsule.a_m, capsule.b_m, capsule.radius_m)))
        for capsule in robot.capsules
    }
    moving = [on_robot[b.name] for b in robot.bodies[: robot.world_bodies]]
    unplaced = {"capsule": (1.0,), "point": (), "box": (1.0, 1.0, 1.0), "convex": ()}
    things = tuple(
        added(f"thing{k}", 0, _Core(kind, unplaced[kind], pinocchio.SE3.Identity(), 0.0, corners))
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
    inner = np.array([(capsule.a_m, capsule.b_m) for _, capsule in robot.self_pairs])
    return _Stage(
        geometry=geometry,
        found=geometry.createData(),
        data=robot.pinocchio.createData(),
        things=things,
        own_radius=np.array(own),
        own_body=np.array([index for index, _ in robot.self_pairs], dtype=np.intp),
        own_link=np.array([capsule.link for _, capsule in robot.self_pairs], dtype=np.intp),
        own_center=inner.mean(axis=1),
        own_half=0.5 * np.linalg.norm(inner[:, 1] - inner[:, 0], axis=1),
        link=np.array([b.link for b in robot.bodies]),
        reference=np.array([b.reference for b in robot.bodies]),
        ends=ends,
        radius=np.array([b.radius_m for b in robot.bodies]),
        half=0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1),
        holds={},
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
        self.stage = _STAGES.of(robot, tuple((core.kind, core.corners) for core in cores))
        if self.stage.holds.get("scene") is not scene:
            self.stage.holds.clear()  # half placed it holds none
            for core, body in zip(cores, self.stage.things, strict=True):
                core.put_into(self.stage.geometry.geometryObjects[body])
            self.stage.holds["scene"] = scene
        moving = self.stage.radius[: robot.world_bodies]
        left_out = np.array([core.radius for core in cores])
        balls = [core.ball for core in cores]
        self.centers = np.array([center for center, _ in balls]).reshape(-1, 3)
        self.around = np.array([radius for _, radius in balls])
        self.radius = np.concatenate([(left_out[:, None] + moving).ravel(), self.stage.own_radius])

    def ask(self, q: Floats, qd: Floats) -> tuple[Floats, Floats]:
        """Signed clearance and surface speed of every pair at joint angles `q` (6,), rad, and speeds `qd`, rad/s."""
        clearance, speed = self.ask_all([(q, qd)])
        return clearance[0], speed[0]

    def ask_all(self, places: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
        """The same at several joint angles and speeds: clearance and speed, each of shape (places, pairs)."""
        if not places:  # every pair leads away, so there is no witness
            nowhere = np.zeros((0, len(self.pairs)))
            return nowhere, nowhere
        model, stage = self.robot.pinocchio, self.stage
        core, moving = [], []
        for q, qd in places:
            moving.append(self._moved(q, qd))
            pinocchio.computeDistances(model, stage.data, stage.geometry, stage.found, q)
            core.append([result.min_distance for result in stage.found.distanceResults])
        ends, _, speed = self._motion(moving)
        clearance = np.maximum(np.array(core), 0) - self.radius
        return np.concatenate([clearance, *self._faces(ends)], axis=1), speed[:, self.pairs.body]

    def at_least(
        self, places: Sequence[tuple[Floats, Floats]], settled: Callable[[Floats, Floats], NDArray[np.bool_]]
    ) -> tuple[Floats, Floats]:
        """What `ask_all` answers, where `settled` wants to know; elsewhere a clearance that is no greater.

        Args:
            places: joint angles and speeds.
            settled: of clearances and speeds, each (places, pairs), those of which it is enough to know that the
                clearance is no smaller.
        """
        model, stage = self.robot.pinocchio, self.stage
        moving = [self._moved(q, qd) for q, qd in places]
        ends, frames, speed = self._motion(moving)
        near = np.concatenate([self._balls(ends, frames), *self._faces(ends)], axis=1)
        speed = speed[:, self.pairs.body]
        asked = ~settled(near, speed)[:, : len(self.radius)]
        for place in np.flatnonzero(asked.any(axis=1)).tolist():
            pinocchio.updateGeometryPlacements(model, stage.data, stage.geometry, stage.found, places[place][0])
            for pair in np.flatnonzero(asked[place]).tolist():
                core = pinocchio.computeDistance(stage.geometry, stage.found, pair).min_distance
                near[place, pair] = max(core, 0.0) - self.radius[pair]
        return near, speed

    def _moved(self, q: Floats, qd: Floats) -> tuple[Floats, Floats]:
        """Poses (links, 4, 4) and velocities (links, 6) of all links, by pinocchio."""
        data = self.stage.data
        pinocchio.forwardKinematics(self.robot.pinocchio, data, q, qd)
        # copied at once: they are views of what the next place overwrites
        return np.array([frame.homogeneous for frame in data.oMi]), np.array([velocity.vector for velocity in data.v])

    def _balls(self, ends: Floats, frames: Floats) -> Floats:
        """Clearance of the balls around all bodies' and things' cores, (places, pairs of bodies): at most their own."""
        stage, count = self.stage, self.robot.world_bodies
        centers = ends.mean(axis=2)
        away = centers[:, None, :count] - self.centers[:, None]
        apart = np.sqrt(np.einsum("ptbi,ptbi->ptb", away, away)) - self.around[:, None] - stage.half[:count]
        own = np.einsum("pkij,kj->pki", frames[:, stage.own_link, :3, :3], stage.own_center)
        inner = own + frames[..., :3, 3][:, stage.own_link] - centers[:, stage.own_body]
        apart_own = np.sqrt(np.einsum("pki,pki->pk", inner, inner)) - stage.own_half - stage.half[stage.own_body]
        return np.asarray(np.concatenate([apart.reshape(len(ends), -1), apart_own], axis=1) - self.radius)

    def _faces(self, ends: Floats) -> list[Floats]:
        """Clearance from each face of the room, (places, moving bodies) each."""
        workspace = self.scene.workspace
        if workspace is None:
            return []
        bodies = slice(0, self.robot.world_bodies)
        high = np.array(workspace.high_m) - ends[:, bodies].max(axis=2)
        low = ends[:, bodies].min(axis=2) - np.array(workspace.low_m)
        radius = self.stage.radius[bodies]
        return [room[:, :, axis] - radius for axis in range(3) for room in (high, low)]

    def _motion(self, moved: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats, Floats]:
        """World positions of all bodies' ends, poses of the links, and surface speeds relative to reference links.

        Args:
            moved: per place the poses (links, 4, 4) and the velocities (links, 6), linear then angular, in the links'
                own frames.
        """
        poses, velocities = np.array([pose for pose, _ in moved]), np.array([velocity for _, velocity in moved])
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
        return ends, poses, np.linalg.norm(relative, axis=3).max(axis=2) + self.stage.radius * spin
