"""Where the arm's bodies are along a straight joint path and how fast they go, and bounds between the nodes (PHY-9)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pep.pit.checker.robot import JOINTS, bends
from pep.pit.checker.space import ORIGIN, cross, dot, length, minus, plus, product, transposed, turned

if TYPE_CHECKING:
    from pep.pit.checker.motion import Run
    from pep.pit.checker.robot import Body, Robot
    from pep.pit.checker.space import Mat, Vec

GRID: Final = 2**24  # parts of the path: an interval of the greatest depth has an exact middle
SLACK: Final = 32  # 1 / (8 * 2^2): a curve leaves its chord by at most A h^2 / 8, and a third node halves h
IDENTITY: Final[Mat] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

Frames = tuple[list["Mat"], list["Vec"]]
Pose = tuple["Vec", "Vec", float, float]  # both ends (metre), speed of the faster one and spin, per unit of s


class Sweep:
    """A robot on a path; every configuration and every body there is computed once."""

    def __init__(self, robot: Robot, run: Run) -> None:
        """Nothing is computed yet."""
        self._robot, self._run, self._ways = robot, run, run.ways
        # Bodies are named by their identity: all of them are the robot's, which is kept.
        self._frames: dict[int, Frames] = {}
        self._poses: dict[tuple[int, int], Pose] = {}
        self._twists: dict[tuple[int, int, int], tuple[Vec, Vec]] = {}
        self._bends: dict[int, tuple[float, float, float]] = {}
        self._rush: dict[tuple[int, int, int], float] = {}

    def sag(self, body: Body, low: int, high: int) -> float:
        """How far an end of the body can be from the chords between the interval's ends and middle, metre."""
        h = (high - low) / GRID
        return self._bend(body)[0] * h * h / SLACK

    def rush(self, body: Body, low: int, high: int) -> float:
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

    def pose(self, body: Body, node: int) -> Pose:
        """The body at path parameter node / GRID, in the frame of its reference link."""
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

    def _bend(self, body: Body) -> tuple[float, float, float]:
        found = self._bends.get(id(body))
        if found is None:
            found = self._bends[id(body)] = bends(body, self._ways)
        return found

    def _twist(self, body: Body, node: int) -> tuple[Vec, Vec]:
        """How the link turns as seen from the reference: the velocity of p is spin x p + moment."""
        key = (body.reference, body.link, node)
        found = self._twists.get(key)
        if found is None:
            turns, origins = self._at(node)
            spin, moment = ORIGIN, ORIGIN
            for joint in range(body.reference + 1, body.link + 1):
                x, y, z = turns[joint]
                axis, way = (x[2], y[2], z[2]), self._ways[joint - 1]
                spin = plus(spin, axis, way)
                moment = plus(moment, cross(origins[joint], axis), way)
            found = self._twists[key] = (spin, moment)
        return found

    def _at(self, node: int) -> Frames:
        """Rotation and origin of every link in the base frame, link 0 first."""
        found = self._frames.get(node)
        if found is None:
            share = node / GRID
            turns: list[Mat] = [IDENTITY]
            origins: list[Vec] = [ORIGIN]
            for joint in range(JOINTS):
                origins.append(plus(turned(turns[joint], self._robot.offsets[joint]), origins[joint]))
                angle = self._run.start[joint] + share * self._ways[joint]
                c, s = math.cos(angle), math.sin(angle)
                x, y, z = product(turns[joint], self._robot.turns[joint])
                turns.append(
                    (
                        (x[0] * c + x[1] * s, x[1] * c - x[0] * s, x[2]),
                        (y[0] * c + y[1] * s, y[1] * c - y[0] * s, y[2]),
                        (z[0] * c + z[1] * s, z[1] * c - z[0] * s, z[2]),
                    )
                )
            found = self._frames[node] = (turns, origins)
        return found


def lowest(poses: tuple[Pose, Pose, Pose], direction: Vec) -> float:
    """The least extent along the direction of a body's axis at three nodes."""
    return min(min(dot(pose[0], direction), dot(pose[1], direction)) for pose in poses)
