"""Places and speeds of the arm's bodies along a curved way, and bounds between the nodes (PHY-17, PHY-46)."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final

from pep.pit.checker.arm import GRID, SLACK, CheckerRoute
from pep.pit.checker.verdict import Code, Refusal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.checker.robot import CheckerBody, CheckerRobot
    from pep.pit.checker.stance import Six
    from pep.pit.checker.trace_pieces import CheckerPieceBounds

UNBOUNDED: Final = 1e30  # rad per s^3: more than any other bound allows, where the second derivative jumps
QUARTER: Final = 4  # the next of an interval's three nodes is at most a quarter of it away


@dataclass(frozen=True, slots=True)
class Tail:
    """Continuation of a course after its last traced place: straight in the joints.

    Attributes:
        since: its beginning, in 1 / GRID.
        q, dq: the joints there, rad, and their derivative by s.
    """

    since: int
    q: Six
    dq: Six

    def at(self, node: int) -> tuple[Six, Six]:
        """Joint angles and their derivative by s."""
        on = (node - self.since) / GRID
        return tuple(q + on * d for q, d in zip(self.q, self.dq, strict=True)), self.dq


class CheckerCourse(CheckerRoute):
    """Robot on a curved way, known at its nodes and bounded piece by piece."""

    met_by: ClassVar[int] = 2

    def __init__(
        self,
        robot: CheckerRobot,
        bounds: Sequence[CheckerPieceBounds],
        nodes: dict[int, tuple[Six, Six]],
        tail: Tail | None,
    ) -> None:
        """Makes a course of which nothing is computed yet.

        Args:
            robot: the arm.
            bounds: of the pieces, which tile the way.
            nodes: joint angles and their derivative by s at checked places.
            tail: its course after the last of them.
        """
        super().__init__(robot)
        self.bounds = bounds
        self._nodes, self._tail = nodes, tail
        self._lows, self._highs = [each.low for each in bounds], [each.high for each in bounds]
        self._known: dict[tuple[int, int], tuple[float, ...]] = {}
        self._worst_of: dict[tuple[int, int, int], tuple[float, ...]] = {}

    def angles(self, node: int) -> Sequence[float]:
        """Joint angles at path parameter node / GRID, rad.

        Raises:
            Refusal: a place that the document has no node for.
        """
        return self._known_at(node)[0]

    def rates(self, node: int) -> Sequence[float]:
        """Derivatives of the angles by s."""
        return self._known_at(node)[1]

    def _known_at(self, node: int) -> tuple[Six, Six]:
        found = self._nodes.get(node)
        if found is None and self._tail is not None and node >= self._tail.since:
            found = self._nodes[node] = self._tail.at(node)
        if found is None:
            raise Refusal(Code.NODE_MISSING, f"node {node}")
        return found

    def sag(self, body: CheckerBody, low: int, high: int) -> float:
        """Distance of a body's end from the chords between the interval's ends and middle, at most, metre."""
        h = (high - low) / GRID
        return self._worst(body, low, high)[0] * h * h / SLACK + self.stray(body, low, high)

    def stray(self, body: CheckerBody, low: int, high: int) -> float:
        """Distance of the body beside the course on the interval, at most, metre."""
        return self._worst(body, low, high)[4] if low < high else 0.0

    def rush(self, body: CheckerBody, low: int, high: int) -> float:
        """Bound on the body's surface speed on the interval, metre per unit of s.

        Between nodes by the chord lemma, or by the next node: whichever proves more.
        """
        _, third, spin_first, spin_second, _, hurry, spin_hurry = worst = self._worst(body, low, high)
        at = [self.pose(body, node) for node in (low, (low + high) // 2, high)]
        h = (high - low) / GRID
        speed = max(pose[2] for pose in at) + min(third * h * h / SLACK, worst[0] * h / QUARTER) + hurry
        spin = max(pose[3] for pose in at) + min(spin_second * h * h / SLACK, spin_first * h / QUARTER) + spin_hurry
        return speed + body.radius * spin

    def _worst(self, body: CheckerBody, low: int, high: int) -> tuple[float, ...]:
        """Worst bounds of the pieces that the interval meets."""
        first, last = bisect_right(self._highs, low), bisect_left(self._lows, high)
        key = (id(body), first, last)
        found = self._worst_of.get(key)
        if found is None:
            rows = [self._bends(body, piece) for piece in range(first, last)]
            found = self._worst_of[key] = tuple(map(max, *rows)) if len(rows) > 1 else rows[0]
        return found

    def _bends(self, body: CheckerBody, piece: int) -> tuple[float, ...]:
        """Bounds of a body on a piece.

        Second and third derivative of its ends, first and second of its spin, stray, hurry, and what hurries its spin.
        With S, A, D the sums of w, a and what strays up to a joint, |p''| <= sum lever (a + S_k^2 - S_(k-1)^2), and so
        on.
        """
        found = self._known.get((id(body), piece))
        if found is not None:
            return found
        of = self.bounds[piece]
        second = third = spin_first = spin_second = stray = hurry = spin_hurry = 0.0
        s = sa = sd = 0.0
        for joint in range(body.reference, body.link):
            w, a, b, d, e = of.first[joint], of.second[joint], of.third[joint], of.stray[joint], of.hurry[joint]
            s_in, sa_in, sd_in = s, sa, sd
            s, sa, sd = s + w, sa + a, sd + d
            lever = body.levers[joint]
            second += lever * (a + s * s - s_in * s_in)
            third += lever * (b + 3 * (s * sa - s_in * sa_in) + s * s * s - s_in * s_in * s_in)
            spin_first += a + w * s_in
            spin_second += b + 2 * a * s_in + w * (s_in * s_in + sa_in)
            stray += lever * d
            hurry += lever * (e + s * sd - s_in * sd_in)
            spin_hurry += e + w * sd_in
        found = (second, third, spin_first, spin_second, stray, hurry, spin_hurry)
        self._known[id(body), piece] = found
        return found
