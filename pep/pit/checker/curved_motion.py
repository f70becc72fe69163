"""Record of a curved motion, read: a course with its timing, or a fixed answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pep.pit.checker.robot import JOINTS
from pep.pit.checker.stance import stance
from pep.pit.checker.trace_pieces import PLACE
from pep.pit.checker.verdict import Code, need

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.checker.course import CheckerCourse
    from pep.pit.checker.motion import Timing
    from pep.pit.checker.robot import CheckerRobot
    from pep.pit.checker.stance import CheckerStance, Six

RECORD: Final = ("limit", "edges", "second", "third", "nodes", "until", "ahead", "seconds")
NOT_TRACED: Final[dict[str, Any]] = {
    "limit": False, "edges": [], "second": [], "third": [], "nodes": [], "until": 0, "ahead": None, "seconds": None,
}  # fmt: skip
"""Record of a motion that needs no course."""
NONE: Final[tuple[float, ...]] = (0.0,) * JOINTS


@dataclass(frozen=True, slots=True)
class FixedAnswer:
    """A motion whose answer is fixed: none at all, or beyond a joint's limit.

    Attributes:
        moves: whether it is a motion.
    """

    moves: bool


STILL: Final = FixedAnswer(moves=False)
PAST_LIMIT: Final = FixedAnswer(moves=True)


@dataclass(frozen=True, slots=True)
class CheckerTimedCourse:
    """A course with its timing.

    Attributes:
        course: where the joints go.
        timing: how fast.
        push: the greatest s'' that the motion itself asks for, 1/s^2, forward and backward.
        tool_speed: that is commanded for the tool point, m/s.
        end: joint angles where it ends.
    """

    course: CheckerCourse
    timing: Timing
    push: tuple[float, float]
    tool_speed: float
    end: Six


def fixed(row: dict[str, Any], answer: FixedAnswer) -> FixedAnswer:
    """A fixed answer, of which nothing is recorded.

    Raises:
        Refusal: something is.
    """
    types = type(row["until"]) is int and type(row["limit"]) is bool
    need(types and row == NOT_TRACED | {"limit": answer.moves}, Code.ANSWER_WRONG, PLACE)
    return answer


def beyond(robot: CheckerRobot, q: Sequence[float], around: Sequence[float] = NONE) -> bool:
    """True where a joint may be beyond its range when each is within `around` of `q`, rad."""
    rows = zip(q, around, robot.ranges, strict=True)
    return not all(low <= angle - room and angle + room <= high for angle, room, (low, high) in rows)


def standing(robot: CheckerRobot, q: Six) -> CheckerStance:
    """Course of an arm that stands.

    Raises:
        Refusal: no joint rates make its tool go as it likes there.
    """
    here = stance(robot, q)
    need(here is not None, Code.NODE_OFF, "where the arm stands: singular")
    assert here is not None
    return here
