"""The second engine: pinocchio moves the arm, coal measures, and the certified answer has to hold for what they say.

It shares with the kernel the model file, the scene and the laws of an index, and nothing else: not the kinematics, not
the distances, not the speeds, not the profile's form. All pairs are asked at the witness and at a few configurations
that nobody can foresee (seeded by the command's digest). Cores have radius 0 here, and meeting cores count as 0 apart:
penetration depth differs between engines.

Never ask coal's broad-phase for a distance: in 3.0.3 it is wrong for capsules and spheres (a regression test watches
the cause).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import coal
import numpy as np
import pinocchio

from pep.pit.certify import VIOLATION_RESOLUTION_M
from pep.pit.engine import NUMPY, chosen
from pep.pit.stage import STAGES
from pep.pit.tier import MOVING

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from numpy.typing import NDArray

    from pep.pit.certify import Certified, Witness
    from pep.pit.motion import Floats, Profile
    from pep.pit.obstacles import Kind
    from pep.pit.pairs import Pairs
    from pep.pit.path import Path
    from pep.pit.robot import Robot
    from pep.pit.scene import Scene
    from pep.pit.separation import Stopping

INTERIOR: Final = 3  # configurations besides the witness
DISTANCE_TOLERANCE_M: Final = 5e-6  # coal's GJK stops at 1e-6; five times that is given
SPEED_TOLERANCE_M_S: Final = 1e-6  # rounding of two ways to the same velocity
INDEX_TOLERANCE: Final = 1e-6  # rounding of the index functions
SEED_BYTES: Final = 8  # per configuration
_LEAST: Final = coal.DistanceResult.min_distance.fget  # hundreds of results are read, twice as fast as by the name
_CROSS: Final = np.array(  # of w, the matrix by which a row p becomes that of w x p, in one row of nine
    [[0, 0, 0, 0, 0, 1, 0, -1, 0], [0, 0, -1, 0, 0, 0, 1, 0, 0], [0, 1, 0, -1, 0, 0, 0, 0, 0]], dtype=float
)


@dataclass(frozen=True, slots=True)
class Disagreement:
    """What the second engine found that cannot be if the first is right."""

    what: str


@dataclass(frozen=True, slots=True)
class Agreement:
    """The second engine found nothing above the certified answer, at so many configurations."""

    asked: int


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
    met = np.array(at)
    q, qd = path.start + met[:, :1] * path.delta, path.delta * met[:, 1:]
    kernel, every = np.empty((len(watched), len(pairs))), np.arange(len(pairs))
    for told, witness in zip(kernel, watched, strict=True):
        told[:] = path.clearance_at(pairs, witness.key, every)
        told[witness.pair] = witness.clearance_m
    sight = world.look(q, qd, kernel, stop=stop, since=0, upper=certified.upper)
    if not sight.agrees:
        return Disagreement("clearance at the witness")
    for moving, witness in zip(sight.speed, watched, strict=False):
        if witness.index > 0 and not abs(moving[pairs.body[witness.pair]] - witness.speed_m_s) <= SPEED_TOLERANCE_M_S:
            return Disagreement("speed at the witness")
    return judged_where_near(world, sight, stop=stop, certified=certified, rows=rows)


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What the second engine sees at some places.

    Attributes:
        q: joint angles of the places, (places, 6), rad.
        measured: how many of the places coal measured, the first ones.
        near: signed clearances, (places, pairs); where nobody measured, what they are at least.
        speed: surface speeds, (places, bodies).
        agrees: whether the first engine found the same clearances where coal measured.
        open: rows of (place, pair) that may be violated for all that this says, or count more: where coal measured than
            any motion does, elsewhere than the first engine's answer.
    """

    q: Floats
    measured: int
    near: Floats
    speed: Floats
    agrees: bool
    open: NDArray[np.intp]


def judged_where_near(
    world: World, sight: Sight, *, stop: Stopping, certified: Certified, rows: NDArray[np.intp]
) -> Agreement | Disagreement:
    """As `judged`, where only what the balls around both bodies do not settle needs a distance, and gets it.

    Args:
        world: the second engine.
        sight: what it saw; what is open is measured in place.
        stop: how the motion ends when it must.
        certified: the answer in question; it counts at least as much as any motion.
        rows: the pairs that `certified` speaks of.
    """
    pairs, doubts = world.pairs, sight.open
    if len(rows) < len(pairs):
        doubts = doubts[np.isin(doubts[:, 1], rows)]
    if not len(doubts):
        return Agreement(len(sight.q))
    world.measure(sight, doubts)
    place, pair = doubts.T
    clearance, speed = sight.near[place, pair], sight.speed[place, pairs.body[pair]]
    found = _doubted(pairs, stop, pair, clearance, speed, upper=certified.upper, violated=certified.violated)
    return _told(found, len(sight.q))


def judged(
    pairs: Pairs, stop: Stopping, certified: Certified, rows: NDArray[np.intp], *, clearance: Floats, speed: Floats
) -> Agreement | Disagreement:
    """Whether the certified answer holds for what was measured of `rows`, both of shape (places, rows)."""
    asked, upper, violated = np.tile(rows, len(clearance)), certified.upper, certified.violated
    found = _doubted(pairs, stop, asked, clearance.ravel(), speed.ravel(), upper=upper, violated=violated)
    return _told(found, len(clearance))


def _told(found: _Doubted, places: int) -> Agreement | Disagreement:
    if found.above.any():
        return Disagreement("index above the certified one")
    if found.below.any():
        return Disagreement("a violation that was not found")
    return Agreement(places)


class _Doubted(NamedTuple):
    """Of pairs at some clearances: where the index is above the certified one, and violations that were not found."""

    above: NDArray[np.bool_]
    below: NDArray[np.bool_]


def _doubted(
    pairs: Pairs,
    stop: Stopping,
    asked: NDArray[np.intp],
    clearance: Floats,
    speed: Floats,
    *,
    upper: float | Floats,
    violated: Container[Kind],
) -> _Doubted:
    """What speaks against an answer: of a clearance that is at least so much, no less does.

    Args:
        pairs: of them the laws.
        stop: how the motion ends when it must.
        asked: a pair each.
        clearance: how far it is apart at least, metre.
        speed: of its body, m/s.
        upper: the index that none may exceed, or that of each.
        violated: kinds of which violations were found.
    """
    near = clearance + DISTANCE_TOLERANCE_M
    index = pairs.index(asked, near, speed, stop)
    below = near + VIOLATION_RESOLUTION_M < pairs.violated_below[asked]
    for row in np.flatnonzero(below).tolist():
        below[row] = pairs.kind_of(int(asked[row])) not in violated
    return _Doubted(~(index <= upper + INDEX_TOLERANCE), below)


def cross_check_rest(path: Path, pairs: Pairs, scene: Scene, clearance: Floats) -> Agreement | Disagreement:
    """Ask coal about every pair at the start of the path, where the kernel found `clearance`."""
    found, _ = World(path.robot, scene, pairs).ask(path.q(0.0), np.zeros_like(path.delta))
    if not (np.abs(found - clearance) <= DISTANCE_TOLERANCE_M).all():
        return Disagreement("clearance at rest")
    return Agreement(1)


def fractions(seed: bytes) -> list[float]:
    """Times as fractions of the motion, from the seed."""
    stream = hashlib.sha256(b"interior" + seed).digest()
    words = [stream[k * SEED_BYTES : (k + 1) * SEED_BYTES] for k in range(INTERIOR)]
    return [int.from_bytes(word) / 256**SEED_BYTES for word in words]  # 256: values of a byte


class World:
    """Robot and scene for pinocchio and coal; its pairs stand in the order of `Pairs`."""

    def __init__(self, robot: Robot, scene: Scene, pairs: Pairs) -> None:
        self.robot, self.scene, self.pairs = robot, scene, pairs
        cast = scene.cast
        self.stage = STAGES.of(robot, cast.kinds)
        self.stage.put(cast.cores)
        self.balls = balls = cast.balls
        self.centers, self.around, left_out = balls[:, :3], balls[:, 3], balls[:, 4]
        moving = self.stage.radius[: robot.world_bodies]
        self.radius = np.concatenate([(left_out[:, None] + moving).ravel(), self.stage.own_radius])

    def ask(self, q: Floats, qd: Floats) -> tuple[Floats, Floats]:
        """Signed clearance and surface speed of every pair at joint angles `q` (6,), rad, and speeds `qd`, rad/s."""
        clearance, speed = self.ask_all([(q, qd)])
        return clearance[0], speed[0]

    def ask_all(self, places: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
        """The same at several joint angles and speeds: clearance and speed, each of shape (places, pairs)."""
        ends, _, _, speed = self._motion(*np.array(places).swapaxes(0, 1))
        near = self._unmeasured(ends)
        for row, (q, _) in zip(near, places, strict=True):
            self._measure(row, q)
        return near, speed[:, self.pairs.body]

    def look(self, q: Floats, qd: Floats, kernel: Floats, *, stop: Stopping, since: int, upper: float) -> Sight:
        """What is seen at these places; coal measures at the first ones.

        Args:
            q: joint angles, (places, 6), rad.
            qd: their speeds, (places, 6), rad/s.
            kernel: the first engine's clearances at the first places, (measured, pairs).
            stop: how the motion ends when it must.
            since: the first place of which what is open counts.
            upper: the index that the first engine proved of the motion.
        """
        if chosen() is NUMPY or self.pairs.solids.hulls:
            return self._look(q, qd, kernel, stop=stop, since=since, upper=upper)
        from pep.pit.kernel.confirm import sight  # here, since numba may be missing

        return Sight(q, len(kernel), *sight(self, q, qd, kernel, stop=stop, since=since, upper=upper))

    def _look(self, q: Floats, qd: Floats, kernel: Floats, *, stop: Stopping, since: int, upper: float) -> Sight:
        ends, turns, origins, speed = self._motion(q, qd)
        near, later, pairs = self._unmeasured(ends), slice(len(kernel), None), self.pairs
        near[later, : len(self.radius)] = self._balls(ends[later], turns[later], origins[later])
        for row, angles in zip(near, q[: len(kernel)], strict=False):
            self._measure(row, angles)
        agrees = bool((np.abs(near[: len(kernel)] - kernel) <= DISTANCE_TOLERANCE_M).all())
        allowed = np.where(np.arange(len(q)) < len(kernel), MOVING, upper)[since:]
        every, speeds = np.tile(np.arange(len(pairs)), len(allowed)), speed[since:, pairs.body].ravel()
        found = _doubted(
            pairs, stop, every, near[since:].ravel(), speeds, upper=allowed.repeat(len(pairs)), violated=()
        )
        place, pair = np.nonzero((found.above | found.below).reshape(-1, len(pairs)))
        return Sight(q, len(kernel), near, speed, agrees, np.stack([place + since, pair], axis=1))

    def distances(self, q: Floats) -> Floats:
        """Coal's distances of the cores of all pairs of bodies."""
        stage = self.stage
        pinocchio.computeDistances(self.robot.pinocchio, stage.data, stage.geometry, stage.found, q)
        return np.fromiter(map(_LEAST, stage.distances), float, len(stage.distances))

    def measure(self, sight: Sight, doubts: NDArray[np.intp]) -> None:
        """Of these rows of (place, pair) the clearances become coal's own, where they are not yet."""
        stage, of = self.stage, pinocchio.computeDistance
        place, pair = doubts[(doubts[:, 0] >= sight.measured) & (doubts[:, 1] < len(self.radius))].T
        placed, distances = -1, []
        for at, which in zip(place.tolist(), pair.tolist(), strict=True):
            if at != placed:
                placed = at
                pinocchio.updateGeometryPlacements(
                    self.robot.pinocchio, stage.data, stage.geometry, stage.found, sight.q[at]
                )
            distances.append(_LEAST(of(stage.geometry, stage.found, which)))
        sight.near[place, pair] = np.maximum(distances, 0.0) - self.radius[pair]

    def _unmeasured(self, ends: Floats) -> Floats:
        """Room for the clearances of all pairs, those from the faces of the room already there."""
        near = np.empty((len(ends), len(self.pairs)))
        near[:, len(self.radius) :] = self._faces(ends)
        return near

    def _measure(self, near: Floats, q: Floats) -> None:
        """Coal's clearances of all pairs of cores stand in `near`, (pairs,)."""
        found = self.distances(q)
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

    def _motion(self, q: Floats, qd: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Where all bodies' ends are, how the links are turned and where, and surface speeds relative to references.

        Pinocchio's Jacobian has a column per joint: the turning, and the speed of what is at the base's origin, that it
        gives all links behind it.
        """
        model, stage = self.robot.pinocchio, self.stage
        count, links = len(q), len(stage.turns)
        turns, origins = np.empty((count, links, 3, 3)), np.empty((count, links, 3))
        gives = np.empty((count, links - 1, 6))  # velocity and spin
        for k, (angles, rates) in enumerate(zip(q, qd, strict=True)):
            columns = pinocchio.computeJointJacobians(model, stage.data, angles)
            turns[k], origins[k] = stage.turns, stage.origins
            np.multiply(columns.T, rates[:, None], out=gives[k])
        ends = np.einsum("pbij,bej->pbei", turns[:, stage.link], stage.ends) + origins[:, stage.link, None]
        twist = stage.moved_by @ gives
        spin = twist[..., 3:]
        velocity = ends @ (spin @ _CROSS).reshape(*spin.shape, 3) + twist[:, :, None, :3]
        square = np.einsum("pbei,pbei->pbe", velocity, velocity).max(axis=2)
        turning = np.sqrt(np.einsum("pbi,pbi->pb", spin, spin))
        return ends, turns, origins, np.sqrt(square) + stage.radius * turning
