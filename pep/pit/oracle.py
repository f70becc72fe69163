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
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np
import pinocchio

from pep.pit.certify import VIOLATION_RESOLUTION_M
from pep.pit.cores import Core, core_of
from pep.pit.scene import Capsule

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pep.pit.certify import Certified, Witness
    from pep.pit.motion import Floats, Profile
    from pep.pit.pairs import Pairs
    from pep.pit.path import Path
    from pep.pit.robot import Robot
    from pep.pit.scene import Scene, Vector
    from pep.pit.separation import Stopping

Kind: TypeAlias = "tuple[str, tuple[Vector, ...]]"
"""What coal builds anew for: the kind of a shape, and of a polytope its corners."""

INTERIOR: Final = 3  # configurations besides the witness
DISTANCE_TOLERANCE_M: Final = 5e-6  # coal's GJK stops at 1e-6; five times that is given
SPEED_TOLERANCE_M_S: Final = 1e-6  # rounding of two ways to the same velocity
INDEX_TOLERANCE: Final = 1e-6  # rounding of the index functions
SEED_BYTES: Final = 8  # per configuration
_CROSS: Final = np.array(  # of w, the matrix by which a row p becomes that of w x p, in one row of nine
    [[0, 0, 0, 0, 0, 1, 0, -1, 0], [0, 0, -1, 0, 0, 0, 1, 0, 0], [0, 1, 0, -1, 0, 0, 0, 0, 0]], dtype=float
)


@dataclass(frozen=True, slots=True)
class Disagreement:
    """What the second engine found that cannot be if the first is right."""

    what: str


@dataclass(frozen=True, slots=True)
class Agreement:
    """The second engine found nothing above the certified answer.

    Attributes:
        asked: how many configurations it was asked at.
        highest: the highest index of all that was judged or, where balls left doubts, of what was measured for them.
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
    at = [profile.at(profile.time_of(w.s)) for w in watched]
    at += [profile.at(share * profile.duration_s) for share in fractions(seed)]  # nobody can foresee these places
    places = [(path.q(s), path.delta * rate) for s, rate in at]
    clearance, speed = world.at_least(places, exactly=len(watched))
    every = np.arange(len(pairs))
    for witness, met, moving in zip(watched, clearance, speed, strict=False):
        kernel = path.clearance_at(pairs, witness.key, every)
        kernel[witness.pair] = witness.clearance_m
        if not (np.abs(met - kernel) <= DISTANCE_TOLERANCE_M).all():
            return Disagreement("clearance at the witness")
        if witness.index > 0 and not abs(moving[witness.pair] - witness.speed_m_s) <= SPEED_TOLERANCE_M_S:
            return Disagreement("speed at the witness")
    return judged_where_near(
        world, places, clearance, speed, stop=stop, certified=certified, rows=rows, since=len(watched)
    )


def judged_where_near(
    world: World,
    places: Sequence[tuple[Floats, Floats]],
    clearance: Floats,
    speed: Floats,
    *,
    stop: Stopping,
    certified: Certified,
    rows: NDArray[np.intp],
    since: int,
) -> Agreement | Disagreement:
    """As `judged`, where only what the balls around both bodies do not settle needs a distance, and gets it.

    Args:
        world: the second engine.
        places: joint angles and speeds.
        clearance: what `World.at_least` says of all pairs there; measured in place.
        speed: likewise.
        stop: how the motion ends when it must.
        certified: the answer in question.
        rows: the pairs that `certified` speaks of.
        since: the first place that was not measured.
    """
    pairs = world.pairs
    asked = np.zeros(len(pairs), dtype=bool)
    asked[rows] = True
    every = np.tile(np.arange(len(pairs)), len(places))
    found = _doubted(pairs, stop, certified, every, clearance.ravel(), speed.ravel())
    which = (found.above | found.below).reshape(clearance.shape) & asked
    if not which.any():
        return Agreement(len(places), float(found.indices.max(initial=0)))
    world.measure(clearance, places, which, since=since)
    return _told(_doubted(pairs, stop, certified, np.nonzero(which)[1], clearance[which], speed[which]), len(places))


def judged(
    pairs: Pairs, stop: Stopping, certified: Certified, rows: NDArray[np.intp], *, clearance: Floats, speed: Floats
) -> Agreement | Disagreement:
    """Whether the certified answer holds for what was measured of `rows`, both of shape (places, rows)."""
    asked = np.tile(rows, len(clearance))
    return _told(_doubted(pairs, stop, certified, asked, clearance.ravel(), speed.ravel()), len(clearance))


def _told(found: _Doubted, places: int) -> Agreement | Disagreement:
    if found.above.any():
        return Disagreement("index above the certified one")
    if found.below.any():
        return Disagreement("a violation that was not found")
    return Agreement(places, float(found.indices.max(initial=0)))


class _Doubted(NamedTuple):
    """Of pairs at some clearances: their index, where it is above the certified one, and violations not found."""

    indices: Floats
    above: NDArray[np.bool_]
    below: NDArray[np.bool_]


def _doubted(  # noqa: PLR0917 - one column each
    pairs: Pairs, stop: Stopping, certified: Certified, asked: NDArray[np.intp], clearance: Floats, speed: Floats
) -> _Doubted:
    """What speaks against the certified answer: of a clearance that is at least so much, no less does."""
    near = clearance + DISTANCE_TOLERANCE_M
    index = pairs.index(asked, near, speed, stop)
    below = near + VIOLATION_RESOLUTION_M < pairs.violated_below[asked]
    for row in np.flatnonzero(below).tolist():
        below[row] = pairs.kind_of(int(asked[row])) not in certified.violated
    return _Doubted(index, ~(index <= certified.upper + INDEX_TOLERANCE), below)


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


@dataclass(frozen=True, slots=True, eq=False)
class _Stage:
    """Coal's bodies and pairs for one robot and so many things of these kinds; where the things are changes.

    Attributes:
        geometry, found: pinocchio's geometry model and its data.
        data: pinocchio's kinematic data.
        distances: of each pair, where coal writes what it found.
        turns, origins: of each link, where pinocchio writes its pose.
        things: each thing's body, and its shape.
        placed: what each of these stands for now; None while it is half placed.
        own_radius: radii of the arm's own pairs, which stand last.
        own_body, own_link, own_center, own_half: of the arm's own pairs: the moving body, and the capsule it must mind:
            its link, its middle there and half its axis.
        link, ends, radius, half: of the robot's bodies.
        moved_by: 1 where the joint moves the body as seen from its reference link, (bodies, joints).
    """

    geometry: Any
    found: Any
    data: Any
    distances: tuple[Any, ...]
    turns: tuple[Floats, ...]
    origins: tuple[Floats, ...]
    things: tuple[tuple[Any, Any], ...]
    placed: list[Core | None]
    own_radius: Floats
    own_body: NDArray[np.intp]
    own_link: NDArray[np.intp]
    own_center: Floats
    own_half: Floats
    link: NDArray[np.intp]
    moved_by: Floats
    ends: Floats
    radius: Floats
    half: Floats

    def put(self, cores: Sequence[Core]) -> None:
        """These things stand there; what stood there before is not touched."""
        for k, core in enumerate(cores):
            if self.placed[k] is not core:
                self.placed[k] = None
                core.put_into(*self.things[k])
                self.placed[k] = core


def _built(robot: Robot, kinds: tuple[Kind, ...]) -> _Stage:
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
    found, data = geometry.createData(), robot.pinocchio.createData()
    inner = np.array([(capsule.a_m, capsule.b_m) for _, capsule in robot.self_pairs])
    return _Stage(
        geometry=geometry,
        found=found,
        data=data,
        distances=tuple(found.distanceResults),
        turns=tuple(frame.rotation for frame in data.oMi),
        origins=tuple(frame.translation for frame in data.oMi),
        things=tuple((body, body.geometry) for body in map(geometry.geometryObjects.__getitem__, things)),
        placed=[None] * len(things),
        own_radius=np.array(own),
        own_body=np.array([index for index, _ in robot.self_pairs], dtype=np.intp),
        own_link=np.array([capsule.link for _, capsule in robot.self_pairs], dtype=np.intp),
        own_center=inner.mean(axis=1),
        own_half=0.5 * np.linalg.norm(inner[:, 1] - inner[:, 0], axis=1),
        link=np.array([b.link for b in robot.bodies]),
        moved_by=np.array(
            [[float(b.reference <= k < b.link) for k in range(len(robot.model.joints))] for b in robot.bodies]
        ),
        ends=ends,
        radius=np.array([b.radius_m for b in robot.bodies]),
        half=0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1),
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
        cores = [core_of(shape) for person in scene.people for _, shape in person.regions]
        cores += [core_of(shape) for shape in scene.solid_shapes]
        self.stage = _STAGES.of(robot, tuple([(core.kind, core.corners) for core in cores]))
        self.stage.put(cores)
        numbers = [(*core.ball[0], core.ball[1], core.radius) for core in cores]
        balls = np.array(numbers).reshape(-1, 5)  # there may be none
        self.centers, self.around, left_out = balls[:, :3], balls[:, 3], balls[:, 4]
        moving = self.stage.radius[: robot.world_bodies]
        self.radius = np.concatenate([(left_out[:, None] + moving).ravel(), self.stage.own_radius])

    def ask(self, q: Floats, qd: Floats) -> tuple[Floats, Floats]:
        """Signed clearance and surface speed of every pair at joint angles `q` (6,), rad, and speeds `qd`, rad/s."""
        clearance, speed = self.ask_all([(q, qd)])
        return clearance[0], speed[0]

    def ask_all(self, places: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
        """The same at several joint angles and speeds: clearance and speed, each of shape (places, pairs)."""
        ends, _, _, speed = self._motion(places)
        near = self._unmeasured(ends)
        for row, (q, _) in zip(near, places, strict=True):
            self._measure(row, q)
        return near, speed[:, self.pairs.body]

    def at_least(self, places: Sequence[tuple[Floats, Floats]], *, exactly: int) -> tuple[Floats, Floats]:
        """What `ask_all` answers at so many places, the first ones; at the others a clearance that is no greater."""
        ends, turns, origins, speed = self._motion(places)
        near, later = self._unmeasured(ends), slice(exactly, None)
        near[later, : len(self.radius)] = self._balls(ends[later], turns[later], origins[later])
        for row, (q, _) in zip(near, places[:exactly], strict=False):
            self._measure(row, q)
        return near, speed[:, self.pairs.body]

    def measure(
        self, near: Floats, places: Sequence[tuple[Floats, Floats]], which: NDArray[np.bool_], *, since: int
    ) -> None:
        """In `near`, (places, pairs), the clearances of `which` at the places from `since` on become coal's own."""
        stage, of = self.stage, pinocchio.computeDistance
        for place in range(since, len(places)):
            rows = np.flatnonzero(which[place, : len(self.radius)])
            if rows.size:
                q = places[place][0]
                pinocchio.updateGeometryPlacements(self.robot.pinocchio, stage.data, stage.geometry, stage.found, q)
                found = [of(stage.geometry, stage.found, pair).min_distance for pair in rows.tolist()]
                near[place, rows] = np.maximum(found, 0.0) - self.radius[rows]

    def _unmeasured(self, ends: Floats) -> Floats:
        """Room for the clearances of all pairs, those from the faces of the room already there."""
        near = np.empty((len(ends), len(self.pairs)))
        near[:, len(self.radius) :] = self._faces(ends)
        return near

    def _measure(self, near: Floats, q: Floats) -> None:
        """Coal's clearances of all pairs of cores stand in `near`, (pairs,)."""
        stage = self.stage
        pinocchio.computeDistances(self.robot.pinocchio, stage.data, stage.geometry, stage.found, q)
        found = np.array([result.min_distance for result in stage.distances])
        near[: len(found)] = np.maximum(found, 0.0) - self.radius

    def _balls(self, ends: Floats, turns: Floats, origins: Floats) -> Floats:
        """Clearance of the balls around all bodies' and things' cores, (places, pairs of bodies): at most their own."""
        stage, count = self.stage, self.robot.world_bodies
        centers = 0.5 * (ends[:, :, 0] + ends[:, :, 1])
        away = centers[:, None, :count] - self.centers[:, None]
        apart = np.sqrt(np.einsum("ptbi,ptbi->ptb", away, away)) - self.around[:, None] - stage.half[:count]
        own = np.einsum("pkij,kj->pki", turns[:, stage.own_link], stage.own_center)
        inner = own + origins[:, stage.own_link] - centers[:, stage.own_body]
        apart_own = np.sqrt(np.einsum("pki,pki->pk", inner, inner)) - stage.own_half - stage.half[stage.own_body]
        return np.asarray(np.concatenate([apart.reshape(len(ends), apart[0].size), apart_own], axis=1) - self.radius)

    def _faces(self, ends: Floats) -> Floats:
        """Clearance from each face of the room, (places, faces times moving bodies)."""
        workspace = self.scene.workspace
        if workspace is None:
            return np.empty((len(ends), 0))
        bodies = slice(0, self.robot.world_bodies)
        high = np.array(workspace.high_m) - ends[:, bodies].max(axis=2)
        low = ends[:, bodies].min(axis=2) - np.array(workspace.low_m)
        radius = self.stage.radius[bodies]
        return np.concatenate([room[:, :, axis] - radius for axis in range(3) for room in (high, low)], axis=1)

    def _motion(self, places: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats, Floats, Floats]:
        """Where all bodies' ends are, how the links are turned and where, and surface speeds relative to references.

        Pinocchio's Jacobian has a column per joint: the turning, and the speed of what is at the base's origin, that it
        gives all links behind it.
        """
        model, stage = self.robot.pinocchio, self.stage
        count, links = len(places), len(stage.turns)
        turns, origins = np.empty((count, links, 3, 3)), np.empty((count, links, 3))
        gives = np.empty((count, links - 1, 6))  # velocity and spin
        for k, (q, qd) in enumerate(places):
            columns = pinocchio.computeJointJacobians(model, stage.data, q)
            turns[k], origins[k] = stage.turns, stage.origins
            np.multiply(columns.T, qd[:, None], out=gives[k])
        ends = np.einsum("pbij,bej->pbei", turns[:, stage.link], stage.ends) + origins[:, stage.link, None]
        twist = stage.moved_by @ gives
        spin = twist[..., 3:]
        velocity = ends @ (spin @ _CROSS).reshape(*spin.shape, 3) + twist[:, :, None, :3]
        square = np.einsum("pbei,pbei->pbe", velocity, velocity).max(axis=2)
        turning = np.sqrt(np.einsum("pbi,pbi->pb", spin, spin))
        return ends, turns, origins, np.sqrt(square) + stage.radius * turning
