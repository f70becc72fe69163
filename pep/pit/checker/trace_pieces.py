"""Traced line of the tool: pieces that tile it, their bounds, and nodes on the joints' path.

All three are checked.

No step searches: middles, bounds and nodes are given, and forward kinematics with one inverse each says whether they
are right. The pieces are chained at their common nodes, so all of it is one continuous path from where the arm stands.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pep.pit.checker.arm import GRID
from pep.pit.checker.motion import ANGLE_MOST_RAD
from pep.pit.checker.piece import OFF, Lever, Piece, contraction
from pep.pit.checker.robot import JOINTS
from pep.pit.checker.stance import stance, times
from pep.pit.checker.text import exact, listed, whole
from pep.pit.checker.twist import apart
from pep.pit.checker.verdict import Code, need

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.checker.robot import CheckerRobot
    from pep.pit.checker.stance import CheckerStance, Six
    from pep.pit.checker.twist import CheckerTwist

PIECES_MOST: Final = 1024  # of one line; bounds the work
NODES_MOST: Final = 50_000  # of one line; likewise
BOUND_MOST: Final = 1e12  # of a derivative of a joint, rad; a larger one proves nothing
PLACE: Final = "proof.course"


@dataclass(frozen=True, slots=True)
class CheckerPieceBounds:
    """Bounds on one piece.

    Attributes:
        low, high: its ends, in 1 / GRID.
        dq, ddq: the joints' derivatives in its middle.
        first, second, third: bounds on the size of the derivatives, rad per power of s.
        stray: distance of the arm beside the course there, at most, rad, joint by joint.
        hurry: difference of its joint rates from the course's, at most.
    """

    low: int
    high: int
    dq: Six
    ddq: Six
    first: Six
    second: Six
    third: Six
    stray: Six
    hurry: Six


@dataclass(frozen=True, slots=True)
class CourseRecord:
    """A course as a document records it.

    Attributes:
        edges: of the pieces, rising, in 1 / GRID; one more than pieces.
        second, third: per piece bounds of the joints' derivatives.
        nodes: joint angles by place.
    """

    edges: tuple[int, ...]
    second: tuple[Six, ...]
    third: tuple[Six, ...]
    nodes: dict[int, Six]


def record_of(row: dict[str, Any]) -> CourseRecord:
    """Record of a course, read.

    Raises:
        Refusal: none.
    """
    edges = [
        whole(each, PLACE, low=0, high=GRID) for each in listed(row["edges"], PLACE, least=0, most=PIECES_MOST + 1)
    ]
    need(len(edges) != 1 and edges == sorted(set(edges)), Code.MEMBER_WRONG, f"{PLACE}.edges")
    pieces = max(len(edges) - 1, 0)
    second, third = (
        tuple(_six(each, low=0.0, high=BOUND_MOST) for each in listed(row[name], PLACE, least=pieces, most=pieces))
        for name in ("second", "third")
    )
    nodes: dict[int, Six] = {}
    last = -1
    for each in listed(row["nodes"], PLACE, least=0, most=NODES_MOST):
        key, q = listed(each, PLACE, least=2, most=2)
        key = whole(key, PLACE, low=last + 1, high=GRID)
        nodes[key] = _six(q, low=-ANGLE_MOST_RAD, high=ANGLE_MOST_RAD)
        last = key
    return CourseRecord(tuple(edges), second, third, nodes)


def _six(value: Any, *, low: float, high: float) -> Six:
    return tuple(exact(item, PLACE, low=low, high=high) for item in listed(value, PLACE, least=JOINTS, most=JOINTS))


class CheckerTracedLine:
    """Line whose trace was checked.

    Attributes:
        pieces: bounds of each piece, in order.
        nodes: the arm at every recorded place.
    """

    def __init__(self, robot: CheckerRobot, twist: CheckerTwist, start: Sequence[float], record: CourseRecord) -> None:
        """Checks every piece and every node.

        Raises:
            Refusal: one that does not.
        """
        self._robot, self._twist, self._lever = robot, twist, Lever(robot.tcp.levers)
        self.nodes: dict[int, CheckerStance] = {}
        need(record.edges[0] == 0 and record.nodes.get(0) == tuple(start), Code.NODE_OFF, "where the arm stands")
        for key, q in record.nodes.items():
            self.nodes[key] = self._on_line(key, q)
        need(max(record.nodes) <= record.edges[-1], Code.NODE_OFF, "a node beyond the pieces")
        keys = iter(sorted(record.nodes))
        key = next(keys)
        self.pieces: list[CheckerPieceBounds] = []
        for number, (low, high) in enumerate(zip(record.edges, record.edges[1:], strict=False)):
            own = [low]
            while key < high:
                if key > low:
                    own.append(key)
                key = next(keys, GRID + 1)
            need(key == high, Code.CELL_UNPROVEN, f"piece {number}: an end without a node")
            own.append(high)
            self.pieces.append(self._bounded(number, record, own))

    def rated(self) -> dict[int, tuple[Six, Six]]:
        """Joint angles and their derivative by s at every node."""
        return {key: (node.q, node.rates(self._twist.rate)) for key, node in self.nodes.items()}

    def _on_line(self, key: int, q: Six) -> CheckerStance:
        """Arm at `q`, whose tool is at its place on the line."""
        here = stance(self._robot, q)
        need(here is not None, Code.NODE_OFF, f"node {key}: singular")
        assert here is not None
        need(max(map(abs, apart(self._twist.at(key / GRID), here.pose))) <= OFF, Code.NODE_OFF, f"node {key}")
        return here

    def _bounded(self, number: int, record: CourseRecord, nodes: list[int]) -> CheckerPieceBounds:
        """Checks that the piece's bounds prove themselves, and that its nodes are on one path through its middle."""
        place, low, high = f"piece {number}", nodes[0], nodes[-1]
        a, b = record.second[number], record.third[number]
        middle = self.nodes.get((low + high) // 2)
        need((low + high) % 2 == 0 and middle is not None, Code.CELL_UNPROVEN, place)
        assert middle is not None
        piece = Piece(self._lever, self._twist, middle, low, high)
        need(all(x <= y for x, y in zip(piece.follows(a), a, strict=True)), Code.CELL_UNPROVEN, place)
        need(all(x <= y for x, y in zip(piece.follows_third(a, b), b, strict=True)), Code.CELL_UNPROVEN, place)
        w = piece.rates(a)
        slip = 0.0
        hurry: Six = (0.0,) * JOINTS
        for key in nodes:
            node = self.nodes[key]
            at, within = piece.near(key, a)
            inside = all(abs(q - x) <= y for q, x, y in zip(node.q, at, within, strict=True))
            shrinks = contraction(self._lever, node, within)
            need(inside and shrinks < 1, Code.NODE_OFF, f"node {key}: on another branch")
            # Newton's map from the node contracts and the path is in the box: so far is it from the node at most.
            missing = apart(self._twist.at(key / GRID), node.pose)
            off = max(map(abs, times(node.inverse, missing))) / (1 - shrinks)
            slip = max(slip, off)
            linear, angular = self._lever.first((off,) * JOINTS, w)
            hurry = tuple(max(x, g * linear + h * angular) for x, (g, h) in zip(hurry, node.gain, strict=True))
        return CheckerPieceBounds(low, high, piece.dq, piece.ddq, w, a, b, (slip,) * JOINTS, hurry)
