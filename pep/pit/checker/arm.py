"""Places and speeds of the arm's bodies along a way; on a straight one also between the nodes (PHY-9)."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar, Final

from pep.pit.checker.distances import ORIGIN, cross, dot, length, minus, plus, product, transposed, turned
from pep.pit.checker.robot import JOINTS, bends

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.checker.distances import Mat, Vec
    from pep.pit.checker.motion import CheckerRun
    from pep.pit.checker.robot import CheckerBody, CheckerRobot

GRID: Final = 2**24  # parts of the path: an interval of the greatest depth has an exact middle
SLACK: Final = 32  # 1 / (8 * 2^2): a curve leaves its chord by at most A h^2 / 8, and a third node halves h
IDENTITY: Final[Mat] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

Frames = tuple[list["Mat"], list["Vec"]]
Pose = tuple["Vec", "Vec", float, float]  # both ends (metre), speed of the faster one and spin, per unit of s


class CheckerRoute(ABC):
    """Robot on some way of its joints; every configuration and every body there is computed once.

    Attributes:
        met_by: number of places that name a met violation on it: one, or the ends of an interval.
    """

    met_by: ClassVar[int] = 1

    def __init__(self, robot: CheckerRobot) -> None:
        """Makes a route of which nothing is computed yet."""
        self.robot = robot
        # Bodies are named by their identity: all of them are the robot's, which is kept.
        self._frames: dict[int, Frames] = {}
        self._poses: dict[tuple[int, int], Pose] = {}
        self._twists: dict[tuple[int, int, int], tuple[Vec, Vec]] = {}

    @abstractmethod
    def angles(self, node: int) -> Sequence[float]:
        """Joint angles at path parameter node / GRID, rad."""

    @abstractmethod
    def rates(self, node: int) -> Sequence[float]:
        """Derivatives of the angles by s."""

    @abstractmethod
    def sag(self, body: CheckerBody, low: int, high: int) -> float:
        """Distance of a body's end from the chords between the interval's ends and middle, at most, metre."""

    @abstractmethod
    def rush(self, body: CheckerBody, low: int, high: int) -> float:
        """Bound on the body's surface speed on the interval, metre per unit of s."""

    def stray(self, body: CheckerBody, low: int, high: int) -> float:
        """Distance of the body beside this way on the interval, at most, metre; 0 at both ends."""
        del body, low, high
        return 0.0

    def pose(self, body: CheckerBody, node: int) -> Pose:
        """Body at path parameter node / GRID, in the frame of its reference link."""
        key = (id(body), node)
        found = self._poses.get(key)
        if found is not None:
            return found
        turns, origins = self._at(node)
        turn, origin = turns[body.link], origins[body.link]
        a = plus(turned(turn, body.a), origin)
        b = a if body.a == body.b else plus(turned(turn, body.b), origin)
        spin, moment = self._twist(body, node)
        speed = length(plus(cross(spin, a), moment))
        if a is not b:
            speed = max(speed, length(plus(cross(spin, b), moment)))
        if body.reference:
            back, seat = transposed(turns[body.reference]), origins[body.reference]
            a = turned(back, minus(a, seat))
            b = turned(back, minus(b, seat))
        pose = (a, b, speed, length(spin))
        self._poses[key] = pose
        return pose

    def _twist(self, body: CheckerBody, node: int) -> tuple[Vec, Vec]:
        """Motion of the link as seen from the reference: the velocity of p is spin x p + moment."""
        key = (body.reference, body.link, node)
        found = self._twists.get(key)
        if found is None:
            turns, origins = self._at(node)
            rates = self.rates(node)
            spin, moment = ORIGIN, ORIGIN
            for joint in range(body.reference + 1, body.link + 1):
                x, y, z = turns[joint]
                axis, rate = (x[2], y[2], z[2]), rates[joint - 1]
                spin = plus(spin, axis, rate)
                moment = plus(moment, cross(origins[joint], axis), rate)
            found = self._twists[key] = (spin, moment)
        return found

    def _at(self, node: int) -> Frames:
        found = self._frames.get(node)
        if found is None:
            found = self._frames[node] = frames(self.robot, self.angles(node))
        return found


class Sweep(CheckerRoute):
    """A robot on a straight joint path."""

    def __init__(self, robot: CheckerRobot, run: CheckerRun) -> None:
        """Makes a sweep of which nothing is computed yet."""
        super().__init__(robot)
        self._start, self._ways = run.start, run.ways
        self._bends: dict[int, tuple[float, float, float]] = {}
        self._rush: dict[tuple[int, int, int], float] = {}

    def angles(self, node: int) -> Sequence[float]:
        """Joint angles at path parameter node / GRID, rad."""
        share = node / GRID
        return tuple(start + share * way for start, way in zip(self._start, self._ways, strict=True))

    def rates(self, node: int) -> Sequence[float]:
        """Derivatives of the angles by s, everywhere the same."""
        del node
        return self._ways

    def sag(self, body: CheckerBody, low: int, high: int) -> float:
        """Distance of a body's end from the chords between the interval's ends and middle, at most, metre."""
        h = (high - low) / GRID
        return self._bend(body)[0] * h * h / SLACK

    def rush(self, body: CheckerBody, low: int, high: int) -> float:
        """Bound on the body's surface speed on the interval, metre per unit of s."""
        key = (id(body), low, high)
        if key not in self._rush:
            _, third, spin_second = self._bend(body)
            at = [self.pose(body, node) for node in (low, (low + high) // 2, high)]
            h = (high - low) / GRID
            slack = h * h / SLACK
            speed = max(pose[2] for pose in at) + third * slack
            spin = max(pose[3] for pose in at) + spin_second * slack
            self._rush[key] = speed + body.radius * spin
        return self._rush[key]

    def _bend(self, body: CheckerBody) -> tuple[float, float, float]:
        found = self._bends.get(id(body))
        if found is None:
            found = self._bends[id(body)] = bends(body, self._ways)
        return found


def frames(robot: CheckerRobot, q: Sequence[float]) -> Frames:
    """Rotation and origin of every link in the base frame at these joint angles (rad), link 0 first."""
    turns: list[Mat] = [IDENTITY]
    origins: list[Vec] = [ORIGIN]
    for joint in range(JOINTS):
        origins.append(plus(turned(turns[joint], robot.offsets[joint]), origins[joint]))
        c, s = math.cos(q[joint]), math.sin(q[joint])
        x, y, z = product(turns[joint], robot.turns[joint])
        turns.append(
            (
                (x[0] * c + x[1] * s, x[1] * c - x[0] * s, x[2]),
                (y[0] * c + y[1] * s, y[1] * c - y[0] * s, y[2]),
                (z[0] * c + z[1] * s, z[1] * c - z[0] * s, z[2]),
            )
        )
    return turns, origins


def lowest(poses: tuple[Pose, Pose, Pose], direction: Vec) -> float:
    """Least extent along the direction of a body's axis at three nodes."""
    return min(min(dot(pose[0], direction), dot(pose[1], direction)) for pose in poses)
