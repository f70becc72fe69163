"""Robot and scene as pinocchio and coal see them.

Cores have radius 0 here, and meeting cores count as 0 apart: penetration depth differs between engines.

Never ask coal's broad-phase for a distance: in 3.0.3 it is wrong for capsules and spheres (a regression test watches
the cause).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import coal
import numpy as np
import pinocchio

from pep.pit.search.certify import VIOLATION_RESOLUTION_M
from pep.pit.second.collision_model import STAGES

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.base.travel import Stopping
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.obstacles import PairKind
    from pep.pit.scene.pairs import Pairs
    from pep.pit.scene.scene import Scene

DISTANCE_TOLERANCE_M: Final = 5e-6  # far above what coal's GJK leaves (`collision_model.GJK_TOLERANCE`)
SPEED_TOLERANCE_M_S: Final = 1e-6  # rounding of two ways to the same velocity
INDEX_TOLERANCE: Final = 1e-6  # rounding of the index functions
_LEAST: Final = coal.DistanceResult.min_distance.fget  # hundreds of results are read, twice as fast as by the name
_CROSS: Final = np.array(  # of w, the matrix by which a row p becomes that of w x p, in one row of nine
    [[0, 0, 0, 0, 0, 1, 0, -1, 0], [0, 0, -1, 0, 0, 0, 1, 0, 0], [0, 1, 0, -1, 0, 0, 0, 0, 0]], dtype=float
)


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """View of the second engine at some places.

    Attributes:
        q: joint angles of the places, (places, 6), rad.
        measured: number of the places that coal measured, the first ones.
        near: signed clearances, (places, pairs); where nothing was measured, a lower bound.
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


class Doubted(NamedTuple):
    """Doubts about pairs at some clearances: an index above the certified one, or a violation that was not found."""

    above: NDArray[np.bool_]
    below: NDArray[np.bool_]


def doubted(
    pairs: Pairs,
    stop: Stopping,
    asked: NDArray[np.intp],
    clearance: Floats,
    speed: Floats,
    *,
    upper: float | Floats,
    violated: Container[PairKind],
) -> Doubted:
    """Doubts about an answer at these clearances; a lower bound of a clearance raises no fewer.

    Args:
        pairs: of them the laws.
        stop: the stop of the motion.
        asked: a pair each.
        clearance: lower bound of its clearance, metre.
        speed: of its body, m/s.
        upper: the index that none may exceed, or that of each.
        violated: kinds of which violations were found.
    """
    near = clearance + DISTANCE_TOLERANCE_M
    index = pairs.index(asked, near, speed, stop)
    below = near + VIOLATION_RESOLUTION_M < pairs.violated_below[asked]
    for row in np.flatnonzero(below).tolist():
        below[row] = pairs.kind_of(int(asked[row])) not in violated
    return Doubted(~(index <= upper + INDEX_TOLERANCE), below)


class SecondWorld:
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

    def distances(self, q: Floats) -> Floats:
        """Coal's distances of the cores of all pairs of bodies."""
        stage = self.stage
        pinocchio.computeDistances(self.robot.pinocchio, stage.kinematics, stage.geometry, stage.found, q)
        return np.fromiter(map(_LEAST, stage.distances), float, len(stage.distances))

    def measure(self, sight: Sight, doubts: NDArray[np.intp]) -> None:
        """Measures the clearances of these rows of (place, pair) by coal, where that is not done yet."""
        stage, of = self.stage, pinocchio.computeDistance
        place, pair = doubts[(doubts[:, 0] >= sight.measured) & (doubts[:, 1] < len(self.radius))].T
        placed, distances = -1, []
        for at, which in zip(place.tolist(), pair.tolist(), strict=True):
            if at != placed:
                placed = at
                pinocchio.updateGeometryPlacements(
                    self.robot.pinocchio, stage.kinematics, stage.geometry, stage.found, sight.q[at]
                )
            distances.append(_LEAST(of(stage.geometry, stage.found, which)))
        sight.near[place, pair] = np.maximum(distances, 0.0) - self.radius[pair]

    def _unmeasured(self, ends: Floats) -> Floats:
        """Array for the clearances of all pairs, filled for the faces of the room."""
        near = np.empty((len(ends), len(self.pairs)))
        near[:, len(self.radius) :] = self._faces(ends)
        return near

    def _measure(self, near: Floats, q: Floats) -> None:
        """Writes coal's clearances of all pairs of cores into `near`, (pairs,)."""
        found = self.distances(q)
        near[: len(found)] = np.maximum(found, 0.0) - self.radius

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
        """Ends of all bodies, turns and origins of the links, and surface speeds relative to references.

        Pinocchio's Jacobian has a column per joint: its turn, and the speed of a point at the base's origin that moves
        with the links behind the joint.
        """
        model, stage = self.robot.pinocchio, self.stage
        count, links = len(q), len(stage.turns)
        turns, origins = np.empty((count, links, 3, 3)), np.empty((count, links, 3))
        gives = np.empty((count, links - 1, 6))  # velocity and spin
        for k, (angles, rates) in enumerate(zip(q, qd, strict=True)):
            columns = pinocchio.computeJointJacobians(model, stage.kinematics, angles)
            turns[k], origins[k] = stage.turns, stage.origins
            np.multiply(columns.T, rates[:, None], out=gives[k])
        ends = np.einsum("pbij,bej->pbei", turns[:, stage.link], stage.ends) + origins[:, stage.link, None]
        twist = stage.moved_by @ gives
        spin = twist[..., 3:]
        velocity = ends @ (spin @ _CROSS).reshape(*spin.shape, 3) + twist[:, :, None, :3]
        square = np.einsum("pbei,pbei->pbe", velocity, velocity).max(axis=2)
        turning = np.sqrt(np.einsum("pbi,pbi->pb", spin, spin))
        return ends, turns, origins, np.sqrt(square) + stage.radius * turning
